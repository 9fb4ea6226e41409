"""Several devices on one link in virtual time: our nodes' cores, and what a test puts beside them.

Deadlines and frames in their order, no bit timing; each frame takes `DELAY_NS`.
"""

from __future__ import annotations

import heapq
from itertools import count

from coulombus.eds.cia301 import CobId
from coulombus.eds.own_devices import identity_from_1018h
from coulombus.eds.reader import parse_eds
from coulombus.node.device import Device
from coulombus.node.kinds import of_identity
from coulombus.node.record import new_nodes
from coulombus.wire.bus_link import RTR, BusFrame
from coulombus.wire.frame import data_bytes, data_word, new_queue
from eds_edit import edit
from node_bench import on_frame, on_time
from places import EDS

DELAY_NS = 100_000
UNCONFIGURED = 255


def eds(name="motor", **identity):
    """Return one of our EDS files with another `vendor`, `product`, `revision`, `serial`."""
    text = (EDS / f"{name}.eds").read_text(encoding="utf-8")
    for sub, part in enumerate(("vendor", "product", "revision", "serial"), 1):
        if part in identity:
            text = edit(text, f"1018sub{sub}", DefaultValue=f"0x{identity[part]:08X}")
    return parse_eds(text.encode(), f"{name}.eds")


class DevicesLink:
    """A link with devices at its far end.

    Attributes
    ----------
    others : functions of a frame to the devices, which return frames (can_id, data) in answer
    tamper : of a frame of a device: what comes of it on the bus
    sent : frames that the link's user sent
    doubled : numbers of the frames, counted from 0 both ways, that are delivered twice
    again_ns : how long behind the first the second of a device's comes, before its next frame
    count : frames so far
    """

    def __init__(self):
        self.t, self.devices, self.others, self.sent = 0, [], [], []
        self.out, self._rows, self._waiting, self._number = new_queue(), [], [], count()
        self.tamper = lambda frame: [frame]
        self.doubled, self.again_ns, self.count = frozenset(), 0, 0
        self._from_ns = {}  # the earliest time of the next frame of an identifier

    def add(self, description, node_id, kind=None):
        profile = of_identity(identity_from_1018h(description)) if kind is None else kind
        row = new_nodes(1)
        device = Device(description, node_id, profile, row[0])
        self._rows.append(row)
        self.devices.append(device)
        device.power_on(self.t, self.out)
        self._collect()
        return device

    def put(self, can_id, data, after_ns=DELAY_NS):
        """Let a frame of some other station come."""
        frame = BusFrame(self.t + after_ns, can_id, bytes(data), len(data))
        heapq.heappush(self._waiting, (frame.t_ns, next(self._number), frame))

    def now_ns(self):
        return self.t

    def send(self, can_id, data=b"", length=None):
        self._until(self.t + DELAY_NS)
        self.sent.append((can_id, bytes(data)))
        for _ in range(self._times()):
            self._deliver(can_id, bytes(data), length)

    def _times(self):
        self.count += 1
        return 2 if self.count - 1 in self.doubled else 1

    def _deliver(self, can_id, data, length):
        for row, device in zip(self._rows, self.devices, strict=True):
            arguments = (self.t, can_id, len(data) if length is None else length, data_word(data), self.out)
            if on_frame(row, 0, *arguments):
                device.service(*arguments)
        self._collect()
        for other in self.others:
            for answer in other(can_id, data):
                self.put(*answer)

    def receive(self, until_ns):
        while not self._waiting or self._waiting[0][0] > min(until_ns, self._next_ns()):
            if self._next_ns() > until_ns:
                self.t = max(self.t, until_ns)
                return None
            self._until(self._next_ns())
        frame = heapq.heappop(self._waiting)[2]
        self.t = max(self.t, frame.t_ns)
        return frame

    def _next_ns(self):
        return min((max(int(row[0].next_ns), self.t) for row in self._rows), default=1 << 62)

    def _until(self, t_ns):
        while self._next_ns() <= t_ns:
            self.t = max(self.t, self._next_ns())
            for row in self._rows:
                if int(row[0].next_ns) <= self.t:
                    on_time(row, 0, self.t, self.out)
            self._collect()
        self.t = max(self.t, t_ns)

    def _collect(self):
        for k in range(int(self.out["count"])):
            row = self.out.frames[k]
            can_id, length = int(row["can_id"]), int(row["length"])
            data = b"" if can_id & RTR else data_bytes(int(row["word"]), length)
            for frame in self.tamper(BusFrame(max(int(row["t_ns"]), self.t) + DELAY_NS, can_id, data, length)):
                times = self._times()
                for again in range(times):
                    t_ns = max(frame.t_ns + again * self.again_ns, self._from_ns.get(frame.can_id, 0))
                    one = BusFrame(t_ns, frame.can_id, frame.data, frame.length)
                    self._from_ns[frame.can_id] = t_ns
                    heapq.heappush(self._waiting, (t_ns, next(self._number), one))
        self.out["count"] = 0


class Server:
    """An SDO server in a test's own words: `answer` returns the responses to a request."""

    def __init__(self, link, node_id, answer):
        self.node_id, self.answer, self.requests = node_id, answer, []
        link.others.append(self._hear)

    def _hear(self, can_id, data):
        if can_id != CobId.SDO_RX + self.node_id:
            return []
        self.requests.append(data)
        return [
            (CobId.SDO_TX + self.node_id, *one) if isinstance(one, tuple) else (CobId.SDO_TX + self.node_id, one)
            for one in self.answer(data)
        ]
