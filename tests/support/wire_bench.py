"""A bus with stations and nothing else, driven event by event: for tests of the wire."""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.sim_bus.can_bus.arbiter import end_frame, new_bus, receives, start_frame, start_ns
from coulombus.sim_bus.can_bus.error_path import attempt
from coulombus.sim_bus.can_bus.faults import plan_alarm
from coulombus.sim_bus.can_bus.frame_result import end_attempt
from coulombus.sim_bus.can_bus.records import ALL, Delivered, Stage
from coulombus.sim_bus.can_bus.stations import attach, refresh
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import CAN_ERR_FLAG, data_bytes, data_word, frames, new_queue, push

US = 1_000


@dataclass
class Row:
    t_ns: int
    can_id: int
    data: bytes
    source: int
    receivers: tuple[int, ...] = ()


class WireBench:
    """`stations` by number on a wire of 1 Mbit/s; `run` returns what the log holds."""

    def __init__(self, stations=(0, 1, 2), bitrate=1_000_000):
        self.array = new_bus(bitrate)
        self.bus = self.array[0]
        self.out = new_queue()
        self.stations = tuple(stations)
        self.log = frames(1)
        self.now = 0
        for station in stations:
            attach(self.bus, station)

    def __getitem__(self, station):
        return self.bus.stations[station & 0xFF]

    def errors(self, station):
        """(TEC, REC) of a station."""
        return int(self[station].tec), int(self[station].rec)

    def set(self, station, **values):
        for name, value in values.items():
            setattr(self[station], name, value)
        refresh(self.bus)

    def send(self, source, can_id, data=b"", t_ns=0):
        push(self.out, source, t_ns, can_id, len(data), data_word(data))

    def fault(self, kind, **values):
        row = self.bus.faults[self.bus.fault_count]
        row.kind, row.until_ns, row.match_source, row.station, row.nth = int(kind), NEVER_NS, ALL, ALL, 1
        row.every, row.most = 0, 0
        for name, value in values.items():
            setattr(row, name, value)
        row.next_ns = row.from_ns
        self.bus.fault_count += 1
        plan_alarm(self.bus, 0)
        refresh(self.bus)

    def run(self, until_ns=NEVER_NS - 1, rows=1000):
        """Let the wire work until `until_ns`, or until nobody wants it, or for so many rows of the
        log.
        """
        out = []
        bus = self.bus
        while len(out) < rows:
            if bus.stage != Stage.FREE:
                t = int(bus.end_ns)
                if t > until_ns:
                    break
                self.now = t
                for row in self._ended():
                    out.append(Row(int(row.t_ns), int(row.can_id), data_bytes(row.word, row.length), int(row.source)))
                if bus.delivered != Delivered.NOBODY:
                    out[-1].receivers = tuple(s for s in self.stations if receives(bus, s))
            else:
                t = max(int(start_ns(bus, self.out)), self.now)
                if t > until_ns:
                    break
                self.now = t
                if not start_frame(bus, self.out, t):
                    attempt(bus, self.out, t)
        return out

    def _ended(self):
        """End what is on the wire; return the rows of the log."""
        if self.bus.stage != Stage.FRAME:
            return self.bus.report[: end_attempt(self.bus, self.out)]
        end_frame(self.bus, self.log, 0)
        return self.log


def carried(rows):
    """The frames among the rows of a log."""
    return [row for row in rows if not row.can_id & CAN_ERR_FLAG]


def told(rows):
    """The error frames among the rows of a log."""
    return [row for row in rows if row.can_id & CAN_ERR_FLAG]


def bits(t_ns, bitrate=1_000_000):
    """Nanoseconds as bit times."""
    return t_ns * bitrate / 1e9


__all__ = ["US", "Row", "WireBench", "bits", "carried", "told"]
