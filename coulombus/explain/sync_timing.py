"""Timing of SYNC: its period, late and lost SYNCs, a second producer, and silences of the whole bus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.explain.bus import Bus
from coulombus.explain.clues import Clue
from coulombus.explain.frames import SYNC, Block, Integers, Rolling
from coulombus.wire.clock import NEVER_NS

__all__ = ["SyncTiming"]

MS = 1_000_000
ENOUGH = 8
"""Intervals of which the period is learned."""
SILENT = 10
"""Periods without SYNC after which it has stopped; at least 20 ms."""
LATE, CLOSE = 1.5, 0.5
"""Interval, in periods, of a late SYNC; the same of a SYNC that follows too soon."""
UNEVEN, SHARE, WINDOW = 0.2, 0.3, 50
"""Deviation, in periods, and least share of such intervals in a window of so many, of a SYNC that jitters."""
AHEAD, BEHIND, NEAR = 5, 100, 9
"""SYNCs by which a second producer leads the period, within so many intervals; of these, so many are too short."""
STOPS = "SYNC stops without an NMT order to the nodes"
TWICE_NS = MS
"""Maximum interval of a SYNC that came twice."""


@dataclass
class _SyncStop:
    """A stop of SYNC: its last stamp and row; `kind` of its clue, "" while none is due."""

    t_ns: int
    row: int
    kind: str = ""
    clue: Clue | None = None
    silence_ns: int = 0  # begin of the silence of all; -1: other frames come; 0: not yet known
    back_ns: int = -1  # the first frame after it


class SyncTiming:
    """Monitors SYNC."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._doubled: list[int] = []  # begins [ns] of the times with two producers
        self._heard_ns = -1  # the last frame of any node but the host
        self._forget()

    def _forget(self) -> None:
        """Begin to learn the period."""
        self.bus.sync_period_ns, self.bus.sync_since_ns, self.bus.relearn_sync = 0, NEVER_NS, False
        self._learned: list[int] = []
        self._stop: _SyncStop | None = None  # since the last SYNC
        self._uneven = Rolling(WINDOW)
        self._worst_ns = 0  # largest deviation from the period so far
        self._lead_ns = 0  # time by which the SYNCs so far lead their period
        self._leads = np.zeros(0, np.int64)  # this lead at the last intervals
        self._most_ns = 0  # its maximum before them
        self._near = Rolling(BEHIND)
        self._number = 0  # intervals so far
        self._close: tuple[int, int] | None = None  # time and row of the first SYNC of a series that follow too soon
        self._close_ns = self._close_number = -1  # time and interval of the last one

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        if len(block.t_ns):
            self._process(block)
        if self.bus.relearn_sync:  # by the last frame of this block
            if self.clues.end("two_sync", None, int(block.t_ns[-1]), "SYNC gets another period"):
                self.bus.two_sync[-1] = self.bus.two_sync[-1][0], int(block.t_ns[-1])
            self._forget()

    def _process(self, block: Block) -> None:
        sync = block.groups.get(SYNC)
        if sync is None:
            self.note_overdue(int(block.t_ns[-1]), block)
            self._heard_ns = int(block.t_ns[-1])
            return
        stop = self._stop
        stamps = sync.t_ns if stop is None else np.concatenate(([stop.t_ns], sync.t_ns))
        rows = sync.rows if stop is None else np.concatenate(([stop.row], sync.rows))
        gaps = np.diff(stamps)
        skipped = 0
        if not self.bus.sync_period_ns:
            skipped = min(len(gaps), ENOUGH - len(self._learned))
            self._learned += gaps[:skipped].tolist()
            if len(self._learned) == ENOUGH:
                self.bus.sync_period_ns = int(np.median(self._learned))
                self.bus.sync_since_ns = int(stamps[skipped])
        if self.bus.sync_period_ns and len(gaps) > skipped:
            self._intervals(
                block, stamps[skipped:], rows[skipped:], gaps[skipped:], self._stop if skipped == 0 else None
            )
        self._stop = _SyncStop(int(sync.t_ns[-1]), int(sync.rows[-1]))
        self.bus.sync_ns = self._stop.t_ns
        self.note_overdue(int(block.t_ns[-1]), block)
        self._heard_ns = int(block.t_ns[-1])

    def note_overdue(self, t_ns: int, block: Block | None = None) -> None:
        """Note a stop of SYNC that is overdue at a time [ns]; `block`: the frames until then, if they are new."""
        if self._stop is not None and self.bus.sync_period_ns:
            self._follow(block, self._stop, t_ns)

    def _follow(self, block: Block | None, stop: _SyncStop, t_ns: int) -> None:
        """Note what is known of a stop of SYNC at a time [ns]: the order, the stop, the silence of all, its end."""
        due_ns = self._due_ns(stop.t_ns)
        if not stop.kind and t_ns > due_ns:
            stop.kind = "in order" if self._ordered(stop.t_ns, due_ns) else "sync_lost"
            if stop.kind == "sync_lost":
                self._begin(stop, stop.t_ns, STOPS)
        beats = self.bus.heartbeat_periods(stop.t_ns)
        silent_ns = max(due_ns, stop.t_ns + round(1.5 * min(beats, default=0)))
        if stop.kind == "sync_lost" and not stop.silence_ns and beats and t_ns > silent_ns:
            last = self._last_frame(block, silent_ns)
            stop.silence_ns = last if last <= stop.t_ns + 2 * self.bus.sync_period_ns else -1
            if stop.silence_ns > 0 and stop.clue is not None:
                self.clues.retract([stop.clue])
                stop.kind = "bus_silent"
                self._begin(stop, stop.silence_ns, "no frame of any node comes")
        if stop.kind == "bus_silent" and block is not None:
            place = int(block.t_ns.searchsorted(silent_ns, "right"))
            if stop.back_ns < 0 and place < len(block.t_ns):
                stop.back_ns = int(block.t_ns[place])
            if 0 <= stop.back_ns < t_ns - max(3 * (stop.back_ns - stop.t_ns), 200 * MS):
                self.clues.end("bus_silent", None, stop.back_ns, "frames come again")
                stop.kind = "sync_lost"
                self._begin(stop, stop.t_ns, "SYNC does not come again")

    def _begin(self, stop: _SyncStop, t_ns: int, text: str) -> None:
        period = self.bus.sync_period_ns
        text += f": it came every {period / MS:g} ms" if stop.kind == "sync_lost" else ""
        producer = next((n for n, node in self.bus.nodes.items() if node.produces_sync), None)
        text += f"; {self.bus.name(producer)} produces it (1005h)" if producer is not None else ""
        stop.clue = self.clues.begin(stop.kind, None, t_ns, text, row=stop.row, due_ns=stop.t_ns + period)
        if producer is not None and stop.kind == "sync_lost" and not self.bus.is_host(producer, stop.t_ns):
            stop.clue.who = "node"

    @property
    def _limit_ns(self) -> int:
        return max(SILENT * self.bus.sync_period_ns, 20 * MS)

    def _due_ns(self, last_ns: int) -> int:
        """Return the time until which an NMT command may explain that SYNC stops."""
        return self.bus.order_due_ns(last_ns, self._limit_ns)

    def _last_frame(self, block: Block | None, until_ns: int) -> int:
        """Return the time of the last frame of any node before a time."""
        place = int(block.t_ns.searchsorted(until_ns)) if block is not None else 0
        return int(block.t_ns[place - 1]) if block is not None and place else self._heard_ns

    def _ordered(self, begin: int, until_ns: int) -> bool:
        """Return whether NMT commands explain that cyclic frames stop after `begin`, as known at a time."""
        if begin - self.bus.sync_period_ns <= self.bus.sync_off_ns <= until_ns:
            return True
        soon = min(self.bus.order_due_ns(begin, max(5 * self.bus.sync_period_ns, 20 * MS)), until_ns)
        nodes = [n for n in self.bus.nodes if self.bus.present(n, begin) and not self.bus.is_host(n, soon)]
        running = [number for number in nodes if not self.bus.left_on_order(number, soon)]
        started = any(order.command == NmtCommand.START and order.t_ns <= begin for order in self.bus.orders)
        at_work = [n for n in running if started or self.bus.nodes[n].state_at(begin) == NmtState.OPERATIONAL]
        return bool(nodes) and not at_work

    def _intervals(
        self, block: Block, stamps: Integers, rows: Integers, gaps: Integers, open_stop: _SyncStop | None
    ) -> None:
        period = self.bus.sync_period_ns
        for i in np.flatnonzero(gaps > LATE * period).tolist():
            stop = open_stop if i == 0 and open_stop is not None else _SyncStop(int(stamps[i]), int(rows[i]))
            self._gap(block, stop, int(stamps[i + 1]))
        self._second_producer(stamps[1:], rows[1:], gaps)
        deviates = np.abs(gaps - period) > UNEVEN * period
        uneven = self._uneven.counts(deviates & (gaps < 3 * period)) >= SHARE * WINDOW
        for (_, end), begin in zip(self.bus.two_sync, self._doubled, strict=True):
            uneven &= (stamps[1:] < begin) | (stamps[1:] > end)
        often = np.flatnonzero(uneven)
        strange = np.where(gaps < 3 * period, np.abs(gaps - period), 0)
        worst = np.maximum.accumulate(np.concatenate(([self._worst_ns], strange)))[1:]
        self._worst_ns = int(worst[-1])

        def text(i: int) -> str:
            return f"its intervals differ by up to {worst[often[i]] / MS:.1f} ms from its period of {period / MS:g} ms"

        self.clues.series("sync_jitter", None, stamps[1:][often], rows[1:][often], text)

    def _gap(self, block: Block, stop: _SyncStop, end: int) -> None:
        """Process an interval that is too long."""
        begin, row = stop.t_ns, stop.row
        self._follow(block, stop, end)
        if not stop.kind and end - begin > self._limit_ns and not self._ordered(begin, end):
            stop.kind = "sync_lost"
            self._begin(stop, begin, STOPS)
        if stop.kind == "in order":
            return
        if stop.kind:
            ends = stop.back_ns if stop.kind == "bus_silent" and stop.back_ns >= 0 else end
            self.clues.end(stop.kind, None, ends, f"SYNC comes again, after {(end - begin) / MS:.0f} ms")
            return
        if self._ordered(begin, end) or self.bus.ordered(0, begin, end) is not None:
            return
        period = self.bus.sync_period_ns
        text = f"no SYNC for {(end - begin) / MS:.2f} ms; its period is {period / MS:g} ms"
        count = max(round((end - begin) / period) - 1, 1)
        self.clues.note("sync_gap", None, begin, text, row=row, count=count)

    def _second_producer(self, stamps: Integers, rows: Integers, gaps: Integers) -> None:
        """Note SYNCs that lead their period more and more; a SYNC that was late and is caught up does not."""
        period = self.bus.sync_period_ns
        lead = self._lead_ns + np.cumsum(period - np.minimum(gaps, self._limit_ns))
        leads = np.concatenate((self._leads, lead))
        peak_leads = np.maximum.accumulate(np.concatenate(([self._most_ns], leads)))
        earlier = peak_leads[np.maximum(np.arange(len(peak_leads) - len(lead), len(peak_leads)) - BEHIND, 0)]
        often = self._near.counts(gaps < CLOSE * period) >= NEAR
        ahead = np.flatnonzero((lead - earlier > AHEAD * period) & often)
        self._lead_ns, self._leads = int(lead[-1]), leads[-BEHIND:]
        self._most_ns = int(peak_leads[max(len(peak_leads) - 1 - BEHIND, 0)])
        for i in np.flatnonzero(gaps < CLOSE * period).tolist():
            self._even(self._number + i, int(stamps[i]))
            if self._close is None:
                self._close = int(stamps[i]), int(rows[i])
            if len(ahead) and i >= ahead[0]:
                text = f"SYNC comes more than once within its period of {period / MS:g} ms: two nodes produce it"
                if not self.clues.stands("two_sync", None):
                    self.bus.two_sync.append((int(stamps[ahead[0]]), NEVER_NS))
                    self._doubled.append(self._close[0])
                    early = [c for c in self.clues.all if c.kind == "sync_jitter" and c.begin_ns >= self._close[0]]
                    self.clues.retract(early)
                    self.clues.begin("two_sync", None, self._close[0], text, row=self._close[1])
            self._close_ns, self._close_number = int(stamps[i]), self._number + i
        self._number += len(gaps)
        self._even(self._number, int(stamps[-1]))
        twice = np.flatnonzero(gaps < min(0.25 * period, TWICE_NS))
        if self.clues.stands("two_sync", None):
            twice = twice[stamps[twice] < self._doubled[-1]]

        def words(i: int) -> str:
            return f"a SYNC came twice, the second one {gaps[twice[i]] / 1000:.0f} us behind the first"

        self.clues.series("repeated", None, stamps[twice], rows[twice], words, subject="sync")

    def _even(self, number: int, t_ns: int) -> None:
        """End a series of SYNCs that follow too soon, if none came in the intervals until this one."""
        if self._close is not None and number - self._close_number > BEHIND:
            if self.clues.stands("two_sync", None):
                self.bus.two_sync[-1] = self.bus.two_sync[-1][0], t_ns
            self.clues.end("two_sync", None, self._close_ns, "SYNC comes once in its period again")
            self._close = None
