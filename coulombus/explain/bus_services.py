"""TIME, LSS, and a bus on which nothing but SYNC comes (CiA 301, 7.2.6; CiA 305)."""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.cia305 import LSS_RESULTS, LssService, lss_result
from coulombus.explain.bus import PDOS, Bus
from coulombus.explain.frames import SYNC, Block
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.data_word import data_bytes

__all__ = ["Services"]

TIME, LSS_ANSWER = int(CobId.TIME), int(CobId.LSS_TX)
ENOUGH, STOPPED = 3, 2.5
"""Intervals of which the period of TIME is learned; periods without TIME after which it has stopped."""
EMPTY_NS = 2_000_000_000
"""Time with SYNC and an OPERATIONAL node after which a bus has no PDO."""


class Services:
    """Monitors services of the bus that have few frames."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._times: list[int] = []  # the last stamps of TIME
        self._row = -1
        self._period_ns = 0
        self._due_ns = NEVER_NS  # time at which a bus without PDO is one

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for row, t_ns, key, word, length in block.merged(TIME, LSS_ANSWER):
            if key == TIME:
                self.note_overdue(t_ns)
                self._time(row, t_ns)
            elif length == 8:
                self._lss(row, t_ns, data_bytes(word, 8))
        if len(block.t_ns):
            self.note_overdue(int(block.t_ns[-1]))

    def note_overdue(self, t_ns: int) -> None:
        """Note what is overdue at a time [ns]."""
        overdue = self._period_ns and t_ns > self._times[-1] + STOPPED * self._period_ns
        if overdue and not self.clues.stands("time_lost", None):
            text = f"TIME stops: it came every {self._period_ns / 1e9:g} s"
            due = self._times[-1] + self._period_ns
            self.clues.begin("time_lost", None, self._times[-1], text, row=self._row, due_ns=due)
        sync = self.bus.first_of.get(SYNC)
        if self._due_ns and (sync is not None or any(pdo_map.synchronous for pdo_map in self.bus.maps.values())):
            self._empty(sync, t_ns)

    def _time(self, row: int, t_ns: int) -> None:
        self.clues.end("time_lost", None, t_ns, "TIME comes again")
        self._times, self._row = [*self._times[-ENOUGH:], t_ns], row
        gaps = sorted(later - earlier for earlier, later in zip(self._times, self._times[1:], strict=False))
        if not self._period_ns and len(gaps) >= ENOUGH and gaps[-1] < 1.2 * gaps[0]:
            self._period_ns = gaps[len(gaps) // 2]

    def _lss(self, row: int, t_ns: int, data: bytes) -> None:
        if data[0] in list(LSS_RESULTS) and data[1]:
            service = LssService(data[0])
            what, why = service.name.lower().replace("_", " "), lss_result(service, data[1], data[2])
            self.clues.begin("lss_refused", None, t_ns, f"LSS {what} is refused: {why}", row=row, subject=data[0])

    def _is_started(self, number: int, t_ns: int) -> bool:
        """Return whether a node was commanded to start: one that only sends heartbeats may be the host."""
        started = self.bus.ordered(number, -1, t_ns, NmtState.OPERATIONAL) is not None
        return started and not self.bus.is_host(number, t_ns) and not self.bus.only_beats(number, t_ns)

    def _empty(self, sync_ns: int | None, t_ns: int) -> None:
        """Note a bus with OPERATIONAL nodes and SYNC, or with PDOs that follow SYNC, and without a PDO."""
        pdos = [first for key, first in self.bus.first_of.items() if key in PDOS]
        starts = [
            (since_ns, node)
            for node in self.bus.nodes.values()
            if (since_ns := node.since(NmtState.OPERATIONAL)) >= 0 and self._is_started(node.number, t_ns)
        ]
        due_ns = max(sync_ns or 0, min((since_ns for since_ns, _ in starts), default=t_ns)) + EMPTY_NS
        if pdos and min(pdos) <= due_ns:
            self._due_ns = 0  # there are PDOs
        elif t_ns > due_ns:
            self._due_ns = 0
            operational = [node.number for _, node in starts if node.state_at(due_ns) == NmtState.OPERATIONAL]
            number = operational[0] if len(operational) == 1 else None
            text = f"OPERATIONAL beside SYNC for {EMPTY_NS / 1e9:g} s, and not one PDO"
            if sync_ns is None:
                text = f"OPERATIONAL for {EMPTY_NS / 1e9:g} s: its PDOs follow SYNC, and no SYNC comes"
            if operational:
                self.clues.begin("no_pdo", number, due_ns - EMPTY_NS, text, due_ns=due_ns)
