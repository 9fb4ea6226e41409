"""PDOs after SYNC: missing, late, and from two senders."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.explain.bus import Bus
from coulombus.explain.clues import Clue
from coulombus.explain.frames import Frames, Integers, Rolling
from coulombus.wire.clock import NEVER_NS

__all__ = ["EQUAL", "MS", "NONE", "STEADY", "Flags", "SeenPdo", "SyncIntervals"]

MS = 1_000_000
LEARN = 20
"""Frames of which the usual time after SYNC is learned."""
ACTIVE, CHANCE, LONG = 3, 50, 100
"""Successive SYNC intervals with one frame that show a synchronous PDO: if its type says so, if its type is unknown and
its contents were repeated, and if only its time after SYNC is steady.
"""
EQUAL, STEADY = 5, 0.1
"""Repeated contents that an event-driven PDO would not send; maximum spread, in periods, of a steady time after SYNC."""
ENDING_NS = 500_000_000
"""Time within which a command explains that set-points stop, or a PDO of a disarmed drive, while SYNC goes on."""
GAP = 1.5
"""Interval, in SYNC periods, between two frames of a PDO of which none is missing."""
MORE, WINDOW = 6, 50
"""SYNC intervals with two frames of a PDO that show a second sender, among the last so many."""
CROSSED = 0.8
"""Change of the time after SYNC, in periods, of a frame that came before SYNC and comes after it now."""
OFTEN = 5
"""Late frames among so many that are told."""
BABBLE_WINDOW = 280
"""Successive frames of an identifier in which babble is looked for."""
NONE = np.zeros(0, np.int64)
Flags = npt.NDArray[np.bool_]


class _Empty(NamedTuple):
    """The first SYNC interval without a PDO: its times, and time and row of the frame before."""

    begin_ns: int
    until_ns: int
    last_ns: int
    row: int


@dataclass
class SeenPdo:
    """State of a PDO; -1: none."""

    key: int
    node: int | None = None
    name: str = ""
    sends: bool = False  # the node sends it: a TPDO
    synchronous: bool | None = None
    last_ns: int = -1
    last_row: int = -1
    last_word: int = 0
    last_length: int = -1
    equal: int = 0  # frames with the contents of the one before
    # after SYNC
    open: int = 0  # frames in the SYNC interval that is not complete
    open_ns: int = -1  # the first of them
    open_differs: bool = False
    streak: int = 0  # successive intervals with one frame
    regular: bool = False
    spans: list[list[int]] = field(default_factory=list)  # times of this block within which it is regular
    followed_ns: int = NEVER_NS  # since then it was regular at any time
    empty: _Empty | None = None
    missing_ns: int = -1  # time since which it is missing
    missing: int = 0
    held: tuple[int, int] | None = None  # time and row of a stop that an NMT command may still explain
    twice_ns: int = -1
    twice_row: int = -1
    latencies: Integers = field(default_factory=lambda: NONE)  # the last times after SYNC
    learned: list[float] = field(default_factory=list)
    usual_ns: float = -1.0  # usual time after SYNC
    crossed_ns: int = NEVER_NS  # its time after SYNC went through a whole period then: a timer sends it
    empties: Rolling = field(default_factory=lambda: Rolling(WINDOW))
    differing: Rolling = field(default_factory=lambda: Rolling(WINDOW))
    late: Rolling = field(default_factory=lambda: Rolling(WINDOW))
    # by its own period
    gaps: list[int] = field(default_factory=list)
    period_ns: int = 0
    even_ns: int = 0  # time of even intervals, up to the last one
    watched_ns: int = 0  # time since its first frame, up to the same one
    event_ns: int = 0  # its event timer
    excused: bool = False  # the present stop is explained, or noted
    stopped: str = ""  # kind of the clue of a stop
    stops: list[Clue] = field(default_factory=list)
    moves: bool = False  # it is event-driven: it comes while something moves
    # in excess
    rapid: Rolling = field(default_factory=lambda: Rolling(BABBLE_WINDOW))
    babbles: bool = False
    recent: Integers = field(default_factory=lambda: NONE)  # the last stamps

    @property
    def kind(self) -> str:
        """Kind of its absence."""
        return "tpdo_missing" if self.sends else "rpdo_missing"


@dataclass(frozen=True)
class _Placed:
    """Frames of a PDO: their SYNC intervals, whether they are the first there, times after SYNC, whether their contents
    are as before.
    """

    carried: bool  # the first interval has an earlier frame
    place: Integers
    first: Flags
    latency: Integers
    equal: Flags


class SyncIntervals:
    """Counts the frames of each PDO in the intervals between SYNCs."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self.floods: list[list[int]] = []
        """Times [ns] in which an identifier floods the bus, and those after it: frames of two cycles come in one."""

    def add_pdo(self, pdo: SeenPdo, group: Frames, stamps: Integers, edges: Integers, equal: Flags) -> None:
        """Count a PDO's frames in each SYNC interval that is complete; `stamps` begins with its frame before this block."""
        pdo.spans = [[-1, NEVER_NS]] if pdo.regular else []
        place = np.searchsorted(edges, group.t_ns, "right") - 1
        intervals = len(edges) - 1
        counts = np.bincount(place[place >= 0], minlength=intervals + 1)
        counts[0] += pdo.open
        carried = pdo.open_ns if pdo.open else 0
        differs = self._differing(pdo, place, equal, intervals)
        first = np.diff(place, prepend=0 if pdo.open else -1) > 0  # of its interval
        pdo.open = int(counts[-1])
        if pdo.open and (intervals or not carried):
            pdo.open_ns = int(group.t_ns[place.searchsorted(intervals)])
        counts = counts[:-1]
        frames = _Placed(bool(carried), place, first, np.where(place >= 0, group.t_ns - edges[place], 0), equal)
        if intervals and pdo.regular and pdo.empty is None and counts.min() == 1 == counts.max():
            pdo.streak += intervals
            if pdo.missing_ns >= 0:
                self._again(pdo, int(edges[0]))
        elif intervals:
            self._walk(pdo, group, frames, stamps, counts, edges, carried)
        if intervals:
            self._doubled(pdo, group, place, counts, differs, edges)
        self._cross(pdo, group, frames)
        self._latency(pdo, group, frames)
        pdo.latencies = np.concatenate((pdo.latencies, frames.latency))[-CHANCE:]

    def _walk(
        self,
        pdo: SeenPdo,
        group: Frames,
        frames: _Placed,
        stamps: Integers,
        counts: Integers,
        edges: Integers,
        carried: int,
    ) -> None:
        """Process runs of intervals with no frame, one frame, and more."""
        starts = np.flatnonzero(np.diff(np.minimum(counts, 2), prepend=-1))
        ends = np.append(starts[1:], len(counts))
        if not pdo.regular and pdo.missing_ns < 0:
            single = np.flatnonzero(counts[starts] == 1)
            streaks = ends[single] - starts[single] + np.where(starts[single] == 0, pdo.streak, 0)
            long = single[streaks >= (ACTIVE if pdo.synchronous else CHANCE)]
            if not len(long):
                pdo.streak = int(streaks[-1]) if len(streaks) and ends[single[-1]] == len(counts) else 0
                return
            pdo.streak = pdo.streak if starts[long[0]] == 0 else 0
            starts, ends = starts[long[0] :], ends[long[0] :]
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            if counts[start]:
                if pdo.empty is not None:
                    came = int(stamps[stamps.searchsorted(edges[start])]) if start or not carried else carried
                    self._decide(pdo, came)
                pdo.empty = None
                if pdo.missing_ns >= 0:
                    self._again(pdo, int(edges[start]))
                pdo.streak = pdo.streak + end - start if counts[start] == 1 else 0
                if counts[start] == 1 and not pdo.regular:
                    shown = self._regular_from(pdo, frames, start, end)
                    pdo.regular = shown < end
                    if pdo.regular:
                        pdo.spans.append([int(edges[shown + 1]), NEVER_NS])
                        pdo.followed_ns = min(pdo.followed_ns, int(edges[shown + 1]))
                continue
            pdo.streak = 0
            for i in range(start, end):
                if pdo.missing_ns >= 0 or not pdo.regular:
                    pdo.missing += end - i
                    break
                begin, until = int(edges[i]), int(edges[i + 1])
                if pdo.empty is None:
                    place = int(group.t_ns.searchsorted(begin))
                    last = (
                        (int(group.t_ns[place - 1]), int(group.rows[place - 1]))
                        if place
                        else (pdo.last_ns, pdo.last_row)
                    )
                    pdo.empty = _Empty(begin, until, *last)
                pdo.missing += 1
                self._decide(pdo, until)

    def _decide(self, pdo: SeenPdo, t_ns: int) -> None:
        """Note that a regular PDO is missing, as known at a time; it may only be in another interval than usual."""
        assert pdo.empty is not None
        empty = pdo.empty
        if t_ns - empty.last_ns <= GAP * max(self.bus.sync_period_ns, empty.until_ns - empty.begin_ns):
            return
        pdo.empty = None
        if self._excused(pdo.node, min(empty.begin_ns + self._hold_ns(pdo, empty.begin_ns), t_ns)):
            pdo.regular, pdo.missing = False, 0
            pdo.spans[-1][1] = empty.begin_ns
            return
        pdo.missing_ns = empty.begin_ns
        pdo.held = empty.begin_ns, empty.row

    def _regular_from(self, pdo: SeenPdo, frames: _Placed, start: int, end: int) -> int:
        """Return the first interval until `end`, each with one frame from `start` on, that shows that a PDO follows SYNC;
        `end` if none does.
        """
        before = pdo.streak - (end - start)  # of the streak, before `start`
        if pdo.synchronous:
            return min(start + max(ACTIVE - 1 - before, 0), end)
        first_regular = end
        if pdo.streak >= CHANCE:
            equal = np.flatnonzero(np.cumsum(frames.equal) + pdo.equal >= EQUAL)
            first = len(frames.place) - len(frames.equal)
            repeated = 0 if pdo.equal >= EQUAL else int(frames.place[first + equal[0]]) if len(equal) else end
            first_regular = min(max(start + CHANCE - 1 - before, start, repeated), end)
        latencies = np.concatenate((pdo.latencies, frames.latency))
        behind = len(pdo.latencies) + int(frames.place.searchsorted(start)) - (frames.carried and start == 0)
        for streak in range(LONG, pdo.streak + 1, CHANCE):
            if before < streak <= before + first_regular - start:
                until = behind + streak - before
                if float(np.std(latencies[max(until - CHANCE, 0) : until])) < STEADY * self.bus.sync_period_ns:
                    return start + streak - before - 1
        return first_regular

    @property
    def _at_once_ns(self) -> int:
        """Time after its begin within which an NMT command explains that a PDO is missing, while SYNC goes on."""
        return max(3 * self.bus.sync_period_ns, 20 * MS)

    def _hold_ns(self, pdo: SeenPdo, begin: int) -> int:
        """Return the time within which a command explains that a PDO is missing: longer while its drive is disarmed."""
        disarmed = pdo.node is not None and self.bus.is_disarmed(pdo.node, begin)
        return max(self._at_once_ns, ENDING_NS if disarmed or not pdo.sends else 0)

    def _excused(self, node: int | None, until_ns: int) -> bool:
        """Return whether NMT commands until a time [ns] explain that a PDO stops."""
        return node is None or self.bus.left_on_order(node, until_ns)

    def settle(self, pdo: SeenPdo, t_ns: int) -> None:
        """Note a stop that no NMT command explained in time."""
        assert pdo.held is not None
        begin, row = pdo.held
        due_ns = begin + self._hold_ns(pdo, begin)
        if self._excused(pdo.node, min(due_ns, t_ns)):
            pdo.held, pdo.regular, pdo.missing_ns = None, False, -1
            pdo.usual_ns, pdo.learned = -1.0, []
        elif t_ns > due_ns:
            self._begin_missing(pdo, begin, row)

    def _begin_missing(self, pdo: SeenPdo, begin: int, row: int) -> None:
        pdo.held = None
        text = f"no {pdo.name} after SYNC" if pdo.sends else f"no {pdo.name}: set-points do not come"
        text, who = self.bus.pdo_end(pdo.key, begin, begin + self._hold_ns(pdo, begin), text)
        self.clues.begin(pdo.kind, pdo.node, begin, text, row=row, subject=pdo.key, due_ns=begin).who = who

    def _again(self, pdo: SeenPdo, t_ns: int) -> None:
        if pdo.held is not None:
            self.settle(pdo, t_ns)
        if pdo.held is not None:
            self._begin_missing(pdo, *pdo.held)
        text = f"{pdo.name} comes again, {max(pdo.missing, 1)} were missing"
        self.clues.end(pdo.kind, pdo.node, t_ns, text, subject=pdo.key)
        pdo.missing_ns, pdo.missing = -1, 0

    def _differing(self, pdo: SeenPdo, place: Integers, equal: Flags, intervals: int) -> Flags:
        """Return the intervals, the open one too, in which a frame follows another one with different contents."""
        before = np.concatenate(([0 if pdo.open else -1], place))[:-1]
        first = len(place) - len(equal)  # 1 for the first frames of all
        differs = np.zeros(intervals + 1, bool)
        differs[0] = pdo.open_differs
        differs[place[first:][(before == place)[first:] & ~equal & (place[first:] >= 0)]] = True
        pdo.open_differs = bool(differs[-1])
        return differs

    def _doubled(
        self, pdo: SeenPdo, group: Frames, place: Integers, counts: Integers, differs: Flags, edges: Integers
    ) -> None:
        """Note a second sender: frames with different contents within one SYNC interval."""
        twice = differs[: len(counts)] & (np.diff(edges) < 1.3 * self.bus.sync_period_ns)
        twice &= _within(edges[:-1], pdo.spans) & ~_within(edges[:-1], self.floods)
        empties = pdo.empties.counts(counts == 0)
        often = pdo.differing.counts(twice)
        if twice.any() and pdo.twice_ns < 0:
            frames = np.flatnonzero(place == int(np.flatnonzero(twice)[0]))
            i = int(frames[-1]) if len(frames) else -1
            pdo.twice_ns = int(group.t_ns[i]) if i >= 0 else pdo.last_ns
            pdo.twice_row = int(group.rows[i]) if i >= 0 else pdo.last_row
        shown = (often >= MORE) & (often > 2 * empties)
        if shown.any() and pdo.twice_ns >= 0:
            kind = "duplicate_node" if pdo.sends else "second_master"
            what = "two devices have its node id" if pdo.sends else "two masters command it"
            text = f"{pdo.name} comes twice within a SYNC period, with contents that differ: {what}"
            if not self.clues.stands(kind, pdo.node, pdo.key):
                self.clues.begin(kind, pdo.node, pdo.twice_ns, text, row=pdo.twice_row, subject=pdo.key)
        if len(often) and not often[-1]:
            pdo.twice_ns = -1

    def _cross(self, pdo: SeenPdo, group: Frames, frames: _Placed) -> None:
        """Note that a PDO comes before SYNC and then after it, or the other way round."""
        change = np.abs(np.diff(frames.latency, prepend=pdo.latencies[-1] if len(pdo.latencies) else NEVER_NS))
        crossed = group.t_ns[(change > CROSSED * self.bus.sync_period_ns) & (change < self.bus.sync_period_ns)]
        pdo.crossed_ns = min([pdo.crossed_ns, *crossed[:1].tolist()])

    def _latency(self, pdo: SeenPdo, group: Frames, frames: _Placed) -> None:
        """Note PDOs that come much later after SYNC than usual."""
        usable = (frames.place >= 0) & frames.first & (frames.latency < GAP * self.bus.sync_period_ns)
        for begin, end in pdo.spans:
            inside = np.flatnonzero(usable & (group.t_ns >= begin) & (group.t_ns < end))
            self._late(pdo, group, inside, frames.latency[inside].astype(float))
            if end < NEVER_NS:
                pdo.usual_ns, pdo.learned = -1.0, []

    def _late(self, pdo: SeenPdo, group: Frames, places: Integers, latency: npt.NDArray[np.float64]) -> None:
        """Compare times after SYNC with the usual one, or with the one before if the PDO may have a clock of its own."""
        skipped, period = 0, self.bus.sync_period_ns
        if not len(latency):
            return
        if pdo.synchronous:
            if pdo.usual_ns < 0:
                skipped = min(len(latency), LEARN - len(pdo.learned))
                pdo.learned += latency[:skipped].tolist()
                if len(pdo.learned) < LEARN:
                    return
                pdo.usual_ns = float(np.median(pdo.learned))
            usual = np.full(len(latency) - skipped, pdo.usual_ns)
        else:
            usual = np.concatenate((pdo.learned, latency))[:-1]
            skipped = len(latency) - len(usual)
            pdo.learned = latency[-1:].tolist()
        deviation = latency[skipped:] - usual
        if not pdo.synchronous:
            deviation = (deviation + period / 2) % period - period / 2
            deviation[group.t_ns[places[skipped:]] >= pdo.crossed_ns] = 0
        strange = np.abs(deviation) > 0.3 * period
        often = np.flatnonzero((pdo.late.counts(strange) >= OFTEN) & strange)
        which = places[skipped:][often]

        def text(i: int) -> str:
            how = "late" if deviation[often[i]] > 0 else "after the next SYNC"
            after, before = latency[skipped:][often[i]] / MS, usual[often[i]] / MS
            return f"{pdo.name} comes {how}: {after:.2f} ms after SYNC, usually {before:.2f} ms"

        kind = "tpdo_late" if pdo.sends else "rpdo_late"
        self.clues.series(kind, pdo.node, group.t_ns[which], group.rows[which], text, subject=pdo.key)


def _within(t_ns: Integers, spans: list[list[int]]) -> Flags:
    """Return whether each of these times is in one of the spans."""
    inside = np.zeros(len(t_ns), bool)
    for begin, end in spans:
        inside |= (t_ns >= begin) & (t_ns < end)
    return inside
