"""One device in virtual time as the conformance run's link.

Deadlines and frames in their order, no bit timing.
"""

from __future__ import annotations

from collections import deque
from functools import lru_cache

from coulombus.conformance.catalogue import catalogue
from coulombus.conformance.runner import Report, check_before, run, select
from coulombus.conformance.tester.unit import Timing, Unit
from coulombus.eds.reader import Description, read_eds
from coulombus.node.brake404 import BRAKE404
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.profile import Profile
from coulombus.node.record import new_nodes
from coulombus.wire.bus_link import RTR, BusFrame
from coulombus.wire.frame import data_bytes, data_word, new_queue
from node_bench import on_frame, on_time
from places import EDS

KIND_OF = {"motor": DRIVE402, "mr_brake": BRAKE404}
DELAY_NS = 100_000


@lru_cache
def description(name: str) -> Description:
    return read_eds(EDS / f"{name}.eds")


class VirtualLink:
    """A device that is alone with the tester; each frame takes `DELAY_NS`.

    `tamper` may change what the device sends.
    """

    def __init__(self, eds: Description, node_id: int, kind: Profile, device_type=Device) -> None:
        self.nodes = new_nodes(1)
        self.out = new_queue()
        self.device = device_type(eds, node_id, kind, self.nodes[0])
        self.t = 0
        self.sent: deque[BusFrame] = deque()
        self.prepare()
        self.device.power_on(0, self.out)
        self._collect()

    def prepare(self) -> None:
        """For a device that has a supply."""

    def now_ns(self) -> int:
        return self.t

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        self.until(self.t + DELAY_NS)
        self.deliver(can_id, data, len(data) if length is None else length)

    def deliver(self, can_id: int, data: bytes, length: int) -> None:
        arguments = (self.t, can_id, length, data_word(data), self.out)
        if on_frame(self.nodes, 0, *arguments):
            self.device.service(*arguments)
        self._collect()

    def until(self, t_ns: int) -> None:
        while int(self.nodes[0].next_ns) <= t_ns:
            self.t = max(self.t, int(self.nodes[0].next_ns))
            on_time(self.nodes, 0, self.t, self.out)
            self._collect()
        self.t = max(self.t, t_ns)

    def receive(self, until_ns: int) -> BusFrame | None:
        while not self.sent:
            if self.t >= until_ns:
                return None
            following = min(until_ns, max(self.t + 1, int(self.nodes[0].next_ns)))
            self.until(following)
        frame = self.sent.popleft()
        self.t = max(self.t, min(frame.t_ns, until_ns))
        return frame

    def _collect(self) -> None:
        for k in range(int(self.out["count"])):
            row = self.out.frames[k]
            can_id, length = int(row["can_id"]), int(row["length"])
            data = b"" if can_id & RTR else data_bytes(int(row["word"]), length)
            for frame in self.tamper(BusFrame(int(row["t_ns"]), can_id, data, length)):
                self.sent.append(frame)
        self.out["count"] = 0

    def tamper(self, frame: BusFrame) -> list[BusFrame]:
        return [frame]


def supplied(link: VirtualLink) -> VirtualLink:
    return link


def new_unit(name: str, link_type=VirtualLink, device_type=Device, *, node_id: int = 1) -> Unit:
    eds = description(name)
    link = link_type(eds, node_id, KIND_OF[name], device_type)
    return Unit(link, eds, node_id, Timing())


def run_cases(unit: Unit, *numbers: str) -> Report:
    check_before(unit)
    return run(unit, select(numbers))


__all__ = ["VirtualLink", "catalogue", "description", "new_unit", "run_cases"]
