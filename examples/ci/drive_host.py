"""A small host of a velocity drive, with python-canopen: the code under test.

It knows nothing of tests. On a machine with an interface of Linux: ``python drive_host.py can0``.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import canopen

EDS = Path(__file__).with_name("drive.eds")
HEARTBEAT_MS = 20
SHUTDOWN, SWITCH_ON, ENABLE, RESET_FAULT, DISABLE_VOLTAGE = 0x06, 0x07, 0x0F, 0x80, 0x00
STATES = {0x40: "switch on disabled", 0x21: "ready", 0x23: "switched on", 0x27: "enabled", 0x08: "fault", 0x07: "stop"}
PROFILE_VELOCITY = 3


class DriveError(Exception):
    """The drive does not do what the host asks."""


class DriveHost:
    """Commands one drive; `network` is connected."""

    def __init__(self, network: canopen.Network, node_id: int) -> None:
        self.network = network
        self.node = network.add_node(node_id, str(EDS))
        self.emergencies: list[int] = []
        self.node.emcy.add_callback(lambda error: self.emergencies.append(error.code))
        self.node.sdo.RESPONSE_TIMEOUT, self.node.sdo.MAX_RETRIES = 0.5, 3

    def configure(self) -> None:
        """Check the device, then let it send heartbeats and start it."""
        device_type = self.node.sdo[0x1000].raw
        if device_type & 0xFFFF != 402:
            raise DriveError(f"node {self.node.id} is no drive: 1000h is {device_type:08X}h")
        self.node.sdo[0x1017].raw = HEARTBEAT_MS
        self.node.nmt.state = "OPERATIONAL"

    @property
    def state(self) -> str:
        """State of CiA 402, by its statusword."""
        word = self.node.sdo[0x6041].raw
        return STATES.get(word & 0x4F if word & 0x4F in (0x40, 0x08) else word & 0x6F, "not ready")

    def enable(self) -> None:
        """Enable the drive in mode profile velocity, at velocity 0."""
        self.node.sdo[0x6060].raw = PROFILE_VELOCITY
        self.node.sdo[0x60FF].raw = 0
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            self.node.sdo[0x6040].raw = word
        if self.state != "enabled":
            raise DriveError(f"node {self.node.id} is in state {self.state}")

    def run(self, velocity: int) -> None:
        """Command a velocity, by RPDO."""
        limit = self.node.sdo[0x607F].raw
        if abs(velocity) > limit:
            raise DriveError(f"velocity {velocity} is above 607Fh, {limit}")
        self.network.send_message(
            0x200 + self.node.id, ENABLE.to_bytes(2, "little") + velocity.to_bytes(4, "little", signed=True)
        )

    def read(self, timeout_s: float = 1.0) -> tuple[int, int]:
        """Return statusword and velocity, which the drive sends by TPDO after a SYNC."""
        answers: list[bytes] = []
        can_id = 0x180 + self.node.id
        self.network.subscribe(can_id, lambda _, data, __: answers.append(bytes(data)))
        self.network.sync.transmit()
        end = time.monotonic() + timeout_s
        while not answers and time.monotonic() < end:
            time.sleep(0.001)
        self.network.unsubscribe(can_id)
        if not answers:
            raise DriveError(f"node {self.node.id} does not answer SYNC")
        return int.from_bytes(answers[0][:2], "little"), int.from_bytes(answers[0][2:6], "little", signed=True)

    def alive(self, timeout_s: float = 1.0) -> bool:
        """Tell whether a heartbeat comes in time."""
        try:
            self.node.nmt.wait_for_heartbeat(timeout_s)
        except canopen.nmt.NmtError:
            return False
        return True

    def stop(self) -> None:
        """Switch the drive's voltage off, then stop the node."""
        self.node.sdo[0x6040].raw = DISABLE_VOLTAGE
        self.node.nmt.state = "STOPPED"


if __name__ == "__main__":
    network = canopen.Network()
    network.connect(interface="socketcan", channel=sys.argv[1])
    host = DriveHost(network, 5)
    host.configure()
    host.enable()
    print(host.read())
    host.stop()
    network.disconnect()
