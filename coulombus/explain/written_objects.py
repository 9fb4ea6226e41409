"""Objects that SDO transfers read and write, and what follows from their values."""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.eds.cia301 import NmtState, predefined
from coulombus.eds.pdo import COMMUNICATION_RANGES, MAPPING_RANGES
from coulombus.eds.sdo_frames import where
from coulombus.explain.bus import Bus
from coulombus.explain.device_errors import error_text
from coulombus.explain.seen_node import SeenNode

__all__ = ["WrittenObjects", "number_text"]

SETTINGS = (range(0x1005, 0x1008), range(0x1012, 0x1018), range(0x1400, 0x1C00))
MAPPING = (*SETTINGS, range(0x1000, 0x1001), range(0x1018, 0x1019))
"""Objects on which PDO maps, names and periods depend."""
PROGRAM, START = 0x1F51, 1
"""Program control (CiA 302-3), and its command to start."""
PRODUCES = 1 << 30
"""Bit of 1005h (COB-ID SYNC): the node produces SYNC."""
VALID = 1 << 31
"""Bit of a PDO's COB-ID that is 0 while it is switched on."""


@dataclass(frozen=True)
class _Value:
    """A value of an object, and the frame that shows it."""

    row: int
    t_ns: int
    node: SeenNode
    at: tuple[int, int]
    value: int
    writes: bool


class WrittenObjects:
    """Keeps the values of objects, and notes what contradicts them."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._written: dict[tuple[int, tuple[int, int]], int] = {}

    def add(self, row: int, t_ns: int, number: int, at: tuple[int, int], value: int, *, writes: bool) -> None:
        """Process a value that a confirmed transfer of an object had."""
        node = self.bus.node(number, t_ns)
        shown = _Value(row, t_ns, node, at, value, writes)
        index = at[0]
        if writes:
            self._written[number, at] = value
            self._set(shown)
        else:
            self._read(shown)
        if 0x6000 <= index < 0xA000 or index == 0x603F:
            self.bus.words.append((row, t_ns, number, index, value))
        if at == (0x1000, 0):
            node.device_type = value
        if any(index in some for some in MAPPING_RANGES):
            self.bus.configured.add(number)
        if node.objects.get(at) != value:
            node.objects[at] = value
            self.bus.stale |= any(index in some for some in MAPPING)

    def _read(self, shown: _Value) -> None:
        """Compare a value with the one that was written."""
        node, at, value = shown.node, shown.at, shown.value
        was = self._written.get((node.number, at))
        if was is not None and any(at[0] in some for some in SETTINGS) and node.booted_ns < shown.t_ns:
            if value & ~PRODUCES != was & ~PRODUCES and node.objects.get(at) == was:
                text = f"{where(*at)} was written with {number_text(was)} and confirmed; read back it is {number_text(value)}"
                self.clues.begin("not_applied", node.number, shown.t_ns, text, row=shown.row, subject=at)
            else:
                self.clues.end("not_applied", node.number, shown.t_ns, "it reads as written", subject=at)
        if at[0] == 0x1003 and at[1] and value:
            text = f"{where(*at)} (error history) has {error_text(value & 0xFFFF)}"
            self.clues.note("error_history", node.number, shown.t_ns, text, row=shown.row, subject=value)
        if 0x6000 <= at[0] < 0xA000 and (at[0] - 0x6000) % 0x800 == 0x61:
            self._mode(shown)

    def _mode(self, shown: _Value) -> None:
        """Compare a drive's displayed mode (6061h) with the written one (6060h)."""
        number, index = shown.node.number, shown.at[0]
        wish = self._written.get((number, (index - 1, 0)))
        if wish is None:
            return
        if wish == shown.value:
            self.clues.end("mode_refused", number, shown.t_ns, "it shows the mode", subject=index)
        else:
            text = f"mode of operation {wish} was written, {where(*shown.at)} shows {shown.value}"
            self.clues.begin("mode_refused", number, shown.t_ns, text, row=shown.row, subject=index)

    def _set(self, shown: _Value) -> None:
        """Process a written setting."""
        node, (index, subindex), value = shown.node, shown.at, shown.value
        if index == 0x1005 and not value & PRODUCES and node.objects.get(shown.at, PRODUCES) & PRODUCES:
            self.bus.sync_off_ns = shown.t_ns
        elif index == 0x1006 and value and value * 1000 != self.bus.sync_period_ns:
            self.bus.expect_sync(written=True)
        elif index == 0x1016 and subindex:
            self.bus.host = value >> 16 & 0x7F or self.bus.host
        elif index == 0x1017 and value != node.objects.get(shown.at):
            self._heartbeat(shown)
        elif index == PROGRAM:
            node.program_ns, node.program_starts = shown.t_ns, value == START
            self.bus.beats_changed = True
        elif any(index in some for some in COMMUNICATION_RANGES):
            self._pdo(shown)

    def _heartbeat(self, shown: _Value) -> None:
        """Process another period of a node's heartbeats."""
        node = shown.node
        is_ordered = self.bus.left_on_order(node.number, shown.t_ns)
        at_work = node.state_at(shown.t_ns) == NmtState.OPERATIONAL and not is_ordered
        if not shown.value and node.period_ns and at_work:
            text = "1017h was written with 0: its heartbeats end"
            self.clues.begin("heartbeat_lost", node.number, shown.t_ns, text, row=shown.row).who = "client"
        node.change_beat(shown.t_ns, shown.value * 1_000_000)
        self.bus.beats_changed = True

    def _pdo(self, shown: _Value) -> None:
        """Process a PDO's COB-ID or event timer: it may be switched off, or have the identifier of another one."""
        node, (index, subindex), value = shown.node, shown.at, shown.value
        usual = predefined(index, 1, node.number) or VALID
        cob_id = value if subindex == 1 else node.objects.get((index, 1), usual)
        if (subindex == 1 and value & VALID) or (subindex == 5 and not value):
            self.bus.pdo_ends[cob_id & 0x7FF] = shown.t_ns, f"{where(index, subindex)} was written with {value:X}h"
        elif subindex in (1, 5):
            self.bus.pdo_ends.pop(cob_id & 0x7FF, None)
        if subindex == 1 and index >= 0x1800:
            self._senders(shown)

    def _senders(self, shown: _Value) -> None:
        """Note two nodes that send PDOs with one identifier."""
        node, value = shown.node, shown.value
        self.clues.end("same_cob_id", node.number, shown.t_ns, "it got another one", subject=shown.at[0])
        for other in self.bus.nodes.values() if not value & VALID else ():
            for (index, subindex), cob_id in other.objects.items():
                is_tpdo = index in COMMUNICATION_RANGES[1] and subindex == 1 and not cob_id & VALID
                if is_tpdo and other is not node and cob_id & 0x7FF == value & 0x7FF and other.booted_ns < shown.t_ns:
                    text = f"{where(*shown.at)} was written with {value & 0x7FF:X}h, which {self.bus.name(other.number)} has"
                    self.clues.begin("same_cob_id", node.number, shown.t_ns, text, row=shown.row, subject=shown.at[0])


def number_text(value: int | None) -> str:
    """Return a number as a reader of data sheets has it; "?" if it is unknown."""
    return "?" if value is None else f"{value} ({value:X}h)" if value > 9 else str(value)
