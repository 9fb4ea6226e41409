"""The classic loop: a `canopen` Network, its Notifier thread, PDO objects, and the law in Python.

For comparison with the data plane.

``python -m benchmarks.canopen_loop SETTINGS`` brings the nodes up, asks for the same real-time
rights for both of its threads, cycles, and prints one line of JSON with the figures of
`benchmarks.contestants.Run`.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import canopen

from benchmarks.contestants import bring_up_patiently
from benchmarks.load import start_load
from coulombus.eds.cia301 import CobId
from coulombus.host.laws.laws import karnopp
from coulombus.host.setup.control_plane import RealControlPlane
from coulombus.rigs.rig import Rig, load_rig
from coulombus.system.realtime import ask_for_real_time, die_with_parent, set_fifo
from coulombus.wire.address import parse_address
from coulombus.wire.can_interface import CoulombusBus

BINS = 20_000
LEAD_NS = 20_000_000
HEARTBEAT_NS = 50_000_000
WORD_OF_STATE = {0x21: 0x07, 0x23: 0x0F, 0x27: 0x0F, 0x08: 0x80}


class Loop:
    """A host on `canopen`, as one writes it."""

    def __init__(self, rig: Rig, bus: str, mode: str) -> None:
        self.rig, self.bus, self.priority = rig, bus, 0
        axis = rig.one_axis()
        self.network = canopen.Network(bus=CoulombusBus(parse_address(bus).name))
        nodes = {
            name: self.network.add_node(part.node_id, axis.description(name).path)
            for name, part in (("motor", axis.motor), ("brake", axis.brake))
        }
        maps: dict[tuple[str, str, int], Any] = {}
        for pdo in rig.pdos():
            layout = pdo.layout
            one = (nodes[pdo.node].rpdo if layout.direction == "rpdo" else nodes[pdo.node].tpdo)[layout.number]
            one.clear()
            for entry in layout.entries:
                one.add_variable(entry.index, entry.subindex)
            one.cob_id, one.enabled = layout.cob_id, True
            if layout.direction == "tpdo":
                one.subscribe()
            maps[pdo.node, layout.direction, layout.number] = one
        self.motor_tx, self.brake_tx = maps["motor", "tpdo", 1], maps["brake", "tpdo", 1]
        self.motor_rx, self.brake_rx = maps["motor", "rpdo", 1], maps["brake", "rpdo", 1]
        self.complete = threading.Event()
        self.arrived = self.counts = 0
        for bit, one in enumerate((self.motor_tx, self.brake_tx)):
            one.add_callback(self._listener(1 << bit))
        numbers, self.k = (
            axis.mode[mode],
            2 * 3.141592653589793 / (axis.motor.encoder_counts_rev * axis.mechanics.ratio),
        )
        self.motion = SimpleNamespace(x_rad=0.0, v_counts=0.0)
        self.law = SimpleNamespace(
            K_p=numbers.K_p_Nm_rad,
            F_s=numbers.F_s_Nm,
            F_d=numbers.F_d_Nm,
            velocity_band_counts=axis.law.velocity_band_counts,
            paper_entry=0,
            brake_spring=0,
        )
        self.state = SimpleNamespace(stuck=0, x_stuck=0.0, psi_Nm=0.0, brake_Nm=0.0)

    def _listener(self, bit: int) -> Any:
        def arrived(_: Any) -> None:
            self.arrived |= bit
            if self.arrived == 3:
                self.complete.set()

        return arrived

    def _promote(self, *_: Any) -> None:
        """Give the Notifier's thread, in which this runs, the loop's priority."""
        if self.priority:
            set_fifo(self.priority)
            self.priority = 0

    def cycle(self, beat: bool) -> bool:
        """SYNC, wait for the TPDOs, law, RPDOs; return whether all TPDOs came in their window."""
        self.arrived = 0
        self.complete.clear()
        self.network.sync.transmit()
        if beat:
            self.network.send_message(CobId.HEARTBEAT + self.rig.host.node_id, b"\x05")
        complete = self.complete.wait(self.rig.bus.tpdo_window_s)
        statusword = self.motor_tx[0].raw
        counts = self.motor_tx[1].raw
        self.motion.x_rad, self.motion.v_counts = counts * self.k, float(counts - self.counts)
        self.counts = counts
        self.state.psi_Nm = karnopp(self.motion, self.law, self.state)
        self.motor_rx[0].raw = WORD_OF_STATE.get(statusword & 0x6F, 0x06)
        self.motor_rx[1].raw = 0
        self.brake_rx[0].raw = round(min(max(self.state.brake_Nm, 0.0), 4.5) * 1000)
        self.motor_rx.transmit()
        self.brake_rx.transmit()
        return complete

    def run(self, seconds: float, priority: int, cpu: int) -> dict[str, Any]:
        """Cycle for so long and return the figures."""
        period = round(self.rig.bus.period_s * 1e9)
        wakeup, latency = [0] * BINS, [0] * BINS
        cycles = missed = lates = incomplete = heartbeat = 0
        self.priority = priority
        self.network.subscribe(CobId.TPDO1 + self.rig.one_axis().motor.node_id, self._promote)
        ask_for_real_time(priority, cpu)
        t = (time.monotonic_ns() + LEAD_NS) // period * period
        end = t + round(seconds * 1e9)
        used = time.process_time_ns()
        while t < end:
            left = t - time.monotonic_ns()
            if left > 0:
                time.sleep(left * 1e-9)
            wake = time.monotonic_ns()
            wakeup[min(max(wake - t, 0) // 1000, BINS - 1)] += 1
            late = (wake - t) // period
            was_late = late > 0
            if late > 0:
                t += late * period
                missed += late
            beat = t >= heartbeat
            if beat:
                heartbeat = t + HEARTBEAT_NS
            incomplete += not self.cycle(beat)
            done = time.monotonic_ns()
            latency[min((done - wake) // 1000, BINS - 1)] += 1
            t += period
            late = (done - t + period - 1) // period
            if late > 0:
                t += late * period
                missed += late
                was_late = True
            lates += was_late
            cycles += 1
        used = time.process_time_ns() - used
        for one in (self.motor_rx, self.brake_rx):  # no torque, no brake
            for variable in one:
                variable.raw = 0
            one.transmit()
        self.network.sync.transmit()
        return {
            "cycles": cycles,
            "missed": missed,
            "late": lates,
            "cpu_us": used / 1e3 / cycles,
            "incomplete": incomplete,
            "wakeup": [(i, n) for i, n in enumerate(wakeup) if n],
            "latency": [(i, n) for i, n in enumerate(latency) if n],
        }


def main(settings: dict[str, Any]) -> None:
    die_with_parent(settings["parent"])
    rig = load_rig(settings["rig"], settings["overrides"])
    control = RealControlPlane(rig, parse_address(settings["bus"]))
    control.check_alone(time.monotonic())
    bring_up_patiently(rig, control)
    loop = Loop(rig, settings["bus"], "hybrid")
    loop.network.connect()
    if settings["loaded"]:
        start_load()
    print(json.dumps(loop.run(settings["seconds"], settings["priority"], settings["cpu"])), flush=True)
    control.send(0x000, b"\x80\0")
    os._exit(0)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
