"""Timing of PDOs: after SYNC, or by their own period; frames in excess."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import CobId
from coulombus.explain.bus import EMCY, NMT, SDO_TX, Bus
from coulombus.explain.frames import SYNC, Block, Frames, Integers, Rolling
from coulombus.recording.maps.seen_maps import Map

__all__ = ["PdoTiming"]

MS, NEVER = 1_000_000, 1 << 62
LEARN, TIMED = 20, 15
"""Frames of which the usual time after SYNC is learned; intervals of which the own period of a PDO is."""
ACTIVE, CHANCE, LONG = 3, 50, 200
"""Successive SYNC intervals with one frame that show a synchronous PDO: if its type says so, if its type is unknown and
its contents were repeated, and if only its time after SYNC is steady.
"""
EQUAL, STEADY = 5, 0.1
"""Repeated contents that an event-driven PDO would not send; maximum spread, in periods, of a steady time after SYNC."""
GAP = 1.5
"""Interval, in SYNC periods, between two frames of a PDO of which none is missing."""
STOPPED = 5
"""The same in its own periods, after which a PDO has stopped."""
MORE, WINDOW = 6, 50
"""SYNC intervals with two frames of a PDO that show a second sender, among the last so many."""
OFTEN = 5
"""Late frames among so many that are told."""
BABBLE_NS, BABBLE, BABBLE_WINDOW = 300_000, 200, 280
"""Interval, and number among so many successive frames of an identifier, that are babble."""
TWICE_NS, UNKNOWN_NS = MS, 200_000
"""Maximum interval of a frame that came twice; the same while the period of SYNC is unknown."""
AFTER_NS = 1_000_000_000
"""Time after a flood within which delayed frames come."""
PDO_KEYS = range(CobId.TPDO1, CobId.SDO_TX)
NONE = np.zeros(0, np.int64)
EMPTY = Frames(NONE, NONE, NONE, NONE)
Flags = npt.NDArray[np.bool_]


class _Empty(NamedTuple):
    """The first SYNC interval without a PDO: its times, and time and row of the frame before."""

    begin_ns: int
    until_ns: int
    last_ns: int
    row: int


@dataclass
class _Pdo:
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
    frames: int = 0
    # after SYNC
    open: int = 0  # frames in the SYNC interval that is not complete
    open_ns: int = -1  # the first of them
    open_differs: bool = False
    streak: int = 0  # successive intervals with one frame
    regular: bool = False
    spans: list[list[int]] = field(default_factory=list)  # times of this block within which it is regular
    followed_ns: int = NEVER  # since then it was regular at any time
    empty: _Empty | None = None
    missing_ns: int = -1  # time since which it is missing
    missing: int = 0
    held: tuple[int, int] | None = None  # time and row of a stop that an NMT command may still explain
    twice_ns: int = -1
    twice_row: int = -1
    latencies: Integers = field(default_factory=lambda: NONE)  # the last times after SYNC
    learned: list[float] = field(default_factory=list)
    usual_ns: float = -1.0  # usual time after SYNC
    empties: Rolling = field(default_factory=lambda: Rolling(WINDOW))
    differing: Rolling = field(default_factory=lambda: Rolling(WINDOW))
    late: Rolling = field(default_factory=lambda: Rolling(WINDOW))
    # by its own period
    gaps: list[int] = field(default_factory=list)
    period_ns: int = 0
    excused: bool = False  # the present stop is explained, or noted
    stopped: str = ""  # kind of the clue of a stop
    # in excess
    rapid: Rolling = field(default_factory=lambda: Rolling(BABBLE_WINDOW))
    babbles: bool = False
    recent: Integers = field(default_factory=lambda: NONE)  # the last stamps

    @property
    def kind(self) -> str:
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


class PdoTiming:
    """Monitors the periods of PDOs, and identifiers that come too often."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._pdos: dict[int, _Pdo] = {}
        self._sync_ns = -1  # the last SYNC
        self._floods: list[list[int]] = []
        """Times [ns] in which an identifier floods the bus, and those after it: frames of two cycles come in one."""

    def take(self, block: Block) -> None:
        """Process a block."""
        if len(block.t_ns) == 0:
            return
        sync = block.groups.get(SYNC)
        edges = NONE if sync is None else sync.t_ns
        if self._sync_ns >= 0:
            edges = np.concatenate(([self._sync_ns], edges))
        edges = edges[edges >= self.bus.sync_since_ns]
        for begin, end in self.bus.two_sync:  # its intervals say nothing about PDOs
            edges = edges[(edges <= begin) | (edges >= end)]
        for key in block.groups:
            if self._is_watched(key):
                self._pdos.setdefault(key, _Pdo(key))
        for key, pdo in self._pdos.items():
            if key in block.groups:
                self._babble(pdo, block.groups[key])
        for key, pdo in self._pdos.items():
            group = block.groups.get(key, EMPTY)
            if len(group) or len(edges) > 1:
                self._identify(pdo, self.bus.maps.get(key))
                self._group(pdo, group, edges)
        if len(edges):
            self._sync_ns = int(edges[-1])
        self.look(int(block.t_ns[-1]))

    def look(self, t_ns: int) -> None:
        """Note stops that are overdue at a time [ns]."""
        for pdo in self._pdos.values():
            if pdo.held is not None:
                self._settle(pdo, t_ns)
            if pdo.period_ns and not pdo.excused:
                self._stopped(pdo, pdo.last_ns, pdo.last_row, t_ns)

    def _is_watched(self, key: int) -> bool:
        return key in self.bus.maps or (key <= 0x7FF and not SDO_TX <= key < 0x680 and key != SYNC)

    def _identify(self, pdo: _Pdo, known: Map | None) -> None:
        """Set node, name and type by the present map, else by the identifier."""
        if known is not None:
            pdo.node, pdo.name, pdo.sends = known.node, known.name, known.direction == "tpdo"
            pdo.synchronous = known.synchronous
        else:
            pdo.node, pdo.name, pdo.sends = pdo.key & 0x7F or None, f"PDO {pdo.key:03X}h", bool(pdo.key & 0x080)

    def _group(self, pdo: _Pdo, group: Frames, edges: Integers) -> None:
        """Process the frames of an identifier; `edges`: SYNC, from the last one before this block."""
        before = pdo.last_ns >= 0
        stamps = np.concatenate(([pdo.last_ns], group.t_ns)) if before else group.t_ns
        words = np.concatenate(([pdo.last_word], group.word)) if before else group.word
        lengths = np.concatenate(([pdo.last_length], group.length)) if before else group.length
        gaps = np.diff(stamps)
        equal = (np.diff(words) == 0) & (np.diff(lengths) == 0)
        rows = group.rows[len(group) - len(gaps) :]
        is_pdo = pdo.key in PDO_KEYS or pdo.key in self.bus.maps
        if is_pdo and not pdo.babbles:
            self._repeated(pdo, stamps, rows, gaps, equal)
        if is_pdo and pdo.synchronous is not False and len(edges) and self.bus.sync_period_ns:
            self._in_intervals(pdo, group, stamps, edges, equal)
        pdo.equal += int(equal.sum())
        pdo.frames += len(group)
        if len(group):
            if is_pdo:
                self._own_period(pdo, group, stamps, gaps)
            pdo.last_ns, pdo.last_row = int(group.t_ns[-1]), int(group.rows[-1])
            pdo.last_word, pdo.last_length = int(group.word[-1]), int(group.length[-1])

    # after SYNC

    def _in_intervals(self, pdo: _Pdo, group: Frames, stamps: Integers, edges: Integers, equal: Flags) -> None:
        """Count a PDO's frames in each SYNC interval that is complete."""
        pdo.spans = [[-1, NEVER]] if pdo.regular else []
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
        self._latency(pdo, group, frames)
        pdo.latencies = np.concatenate((pdo.latencies, frames.latency))[-CHANCE:]

    def _walk(
        self,
        pdo: _Pdo,
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
                        pdo.spans.append([int(edges[shown + 1]), NEVER])
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

    def _decide(self, pdo: _Pdo, t_ns: int) -> None:
        """Note that a regular PDO is missing, as known at a time; it may only be in another interval than usual."""
        assert pdo.empty is not None
        empty = pdo.empty
        if t_ns - empty.last_ns <= GAP * max(self.bus.sync_period_ns, empty.until_ns - empty.begin_ns):
            return
        pdo.empty = None
        if self._excused(pdo.node, min(empty.begin_ns + self._at_once_ns, t_ns)):
            pdo.regular, pdo.missing = False, 0
            pdo.spans[-1][1] = empty.begin_ns
            return
        pdo.missing_ns = empty.begin_ns
        pdo.held = empty.begin_ns, empty.row

    def _regular_from(self, pdo: _Pdo, frames: _Placed, start: int, end: int) -> int:
        """Return the first interval until `end`, each with one frame from `start` on, that shows that a PDO follows SYNC;
        `end` if none does.
        """
        before = pdo.streak - (end - start)  # of the streak, before `start`
        if pdo.synchronous:
            return min(start + max(ACTIVE - 1 - before, 0), end)
        found = end
        if pdo.streak >= CHANCE:
            equal = np.flatnonzero(np.cumsum(frames.equal) + pdo.equal >= EQUAL)
            first = len(frames.place) - len(frames.equal)
            repeated = 0 if pdo.equal >= EQUAL else int(frames.place[first + equal[0]]) if len(equal) else end
            found = min(max(start + CHANCE - 1 - before, start, repeated), end)
        latencies = np.concatenate((pdo.latencies, frames.latency))
        behind = len(pdo.latencies) + int(frames.place.searchsorted(start)) - (frames.carried and start == 0)
        for streak in range(LONG, pdo.streak + 1, CHANCE):
            if before < streak <= before + found - start:
                until = behind + streak - before
                if float(np.std(latencies[max(until - CHANCE, 0) : until])) < STEADY * self.bus.sync_period_ns:
                    return start + streak - before - 1
        return found

    @property
    def _at_once_ns(self) -> int:
        """Time after its begin within which an NMT command explains that a PDO is missing, while SYNC goes on."""
        return max(3 * self.bus.sync_period_ns, 20 * MS)

    def _excused(self, node: int | None, until_ns: int) -> bool:
        """Return whether NMT commands until a time [ns] explain that a PDO stops."""
        return node is None or self.bus.left_on_order(node, until_ns)

    def _settle(self, pdo: _Pdo, t_ns: int) -> None:
        """Note a stop that no NMT command explained in time."""
        assert pdo.held is not None
        begin, row = pdo.held
        due_ns = begin + self._at_once_ns
        if self._excused(pdo.node, min(due_ns, t_ns)):
            pdo.held, pdo.regular, pdo.missing_ns = None, False, -1
            pdo.usual_ns, pdo.learned = -1.0, []
        elif t_ns > due_ns:
            self._begin_missing(pdo, begin, row)

    def _begin_missing(self, pdo: _Pdo, begin: int, row: int) -> None:
        pdo.held = None
        text = f"no {pdo.name} after SYNC" if pdo.sends else f"no {pdo.name}: set-points do not come"
        self.clues.begin(pdo.kind, pdo.node, begin, text, row=row, subject=pdo.key, due_ns=begin)

    def _again(self, pdo: _Pdo, t_ns: int) -> None:
        if pdo.held is not None:
            self._settle(pdo, t_ns)
        if pdo.held is not None:
            self._begin_missing(pdo, *pdo.held)
        text = f"{pdo.name} comes again, {max(pdo.missing, 1)} were missing"
        self.clues.end(pdo.kind, pdo.node, t_ns, text, subject=pdo.key)
        pdo.missing_ns, pdo.missing = -1, 0

    def _differing(self, pdo: _Pdo, place: Integers, equal: Flags, intervals: int) -> Flags:
        """Return the intervals, the open one too, in which a frame follows another one with different contents."""
        before = np.concatenate(([0 if pdo.open else -1], place))[:-1]
        first = len(place) - len(equal)  # 1 for the first frames of all
        differs = np.zeros(intervals + 1, bool)
        differs[0] = pdo.open_differs
        differs[place[first:][(before == place)[first:] & ~equal & (place[first:] >= 0)]] = True
        pdo.open_differs = bool(differs[-1])
        return differs

    def _doubled(
        self, pdo: _Pdo, group: Frames, place: Integers, counts: Integers, differs: Flags, edges: Integers
    ) -> None:
        """Note a second sender: frames with different contents within one SYNC interval."""
        twice = differs[: len(counts)] & (np.diff(edges) < 1.3 * self.bus.sync_period_ns)
        twice &= _within(edges[:-1], pdo.spans) & ~_within(edges[:-1], self._floods)
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

    def _latency(self, pdo: _Pdo, group: Frames, frames: _Placed) -> None:
        """Note PDOs that come much later after SYNC than usual."""
        known = (frames.place >= 0) & frames.first & (frames.latency < GAP * self.bus.sync_period_ns)
        for begin, end in pdo.spans:
            inside = np.flatnonzero(known & (group.t_ns >= begin) & (group.t_ns < end))
            self._late(pdo, group, inside, frames.latency[inside].astype(float))
            if end < NEVER:
                pdo.usual_ns, pdo.learned = -1.0, []

    def _late(self, pdo: _Pdo, group: Frames, places: Integers, latency: npt.NDArray[np.float64]) -> None:
        """Compare times after SYNC with the usual one, or with earlier ones if the PDO may have a clock of its own."""
        skipped, period = 0, self.bus.sync_period_ns
        if pdo.synchronous:
            if pdo.usual_ns < 0:
                skipped = min(len(latency), LEARN - len(pdo.learned))
                pdo.learned += latency[:skipped].tolist()
                if len(pdo.learned) < LEARN:
                    return
                pdo.usual_ns = float(np.median(pdo.learned))
            usual = np.full(len(latency) - skipped, pdo.usual_ns)
        else:
            whole = np.concatenate((pdo.learned, latency))
            pdo.learned = whole[-LEARN:].tolist()
            skipped = max(LEARN - (len(whole) - len(latency)), 0)
            usual = whole[: max(len(whole) - LEARN, 0)][-len(latency) :] if len(latency) else latency
        deviation = latency[skipped:] - usual
        if not pdo.synchronous:
            deviation = (deviation + period / 2) % period - period / 2
        strange = np.abs(deviation) > 0.3 * period
        often = np.flatnonzero((pdo.late.counts(strange) >= OFTEN) & strange)
        if len(often):
            which = places[skipped:][often]
            how = "late" if deviation[often[0]] > 0 else "after the next SYNC"
            worst = latency[skipped:][often[0]]
            text = f"{pdo.name} comes {how}: {worst / MS:.2f} ms after SYNC, usually {usual[often[0]] / MS:.2f} ms"
            kind, i = "tpdo_late" if pdo.sends else "rpdo_late", int(which[0])
            clue = self.clues.note(
                kind, pdo.node, int(group.t_ns[i]), text, row=int(group.rows[i]), subject=pdo.key, count=len(often)
            )
            clue.last_ns = clue.end_ns = int(group.t_ns[which[-1]])

    # by its own period

    def _own_period(self, pdo: _Pdo, group: Frames, stamps: Integers, gaps: Integers) -> None:
        """Learn the period of a PDO that does not follow SYNC, and note its stops."""
        if pdo.synchronous and pdo.stopped:
            self._comes(pdo, int(group.t_ns[0]))
        own = stamps[1:] < pdo.followed_ns
        if not pdo.synchronous and own.any():
            number = int(own.sum())
            self._own_gaps(pdo, group, stamps[: number + 1], gaps[:number])
        if pdo.synchronous or not own.all():
            pdo.period_ns = 0

    def _own_gaps(self, pdo: _Pdo, group: Frames, stamps: Integers, gaps: Integers) -> None:
        skipped = 0
        if not pdo.period_ns:
            skipped = min(len(gaps), TIMED - len(pdo.gaps))
            pdo.gaps += gaps[:skipped].tolist()
            if len(pdo.gaps) < TIMED:
                return
            low, median, high = (float(value) for value in np.percentile(pdo.gaps, (5, 50, 95)))
            even = high < 1.5 * median and min(pdo.gaps) > 0.5 * median
            timed = high - low < 2 * STEADY * median or pdo.equal >= EQUAL or pdo.synchronous is False
            pdo.period_ns = int(median) if even and timed else 0
            pdo.gaps = []
            if not pdo.period_ns:
                return
        rows = np.concatenate(([pdo.last_row], group.rows))[-len(stamps) :]
        for i in np.flatnonzero(gaps > STOPPED * pdo.period_ns).tolist():
            if i < skipped:
                continue
            begin, end = int(stamps[i]), int(stamps[i + 1])
            if not pdo.excused:
                self._stopped(pdo, begin, int(rows[i]), end)
            pdo.excused = False
            self._comes(pdo, end)

    def _stopped(self, pdo: _Pdo, begin: int, row: int, t_ns: int) -> None:
        """Note a stop that is overdue at a time [ns]."""
        due_ns = self.bus.order_due_ns(begin, STOPPED * pdo.period_ns)
        if t_ns <= due_ns:
            return
        pdo.excused = True
        if pdo.node is None or self._excused(pdo.node, due_ns):
            return
        text = f"{pdo.name} stops, it came every {pdo.period_ns / MS:.3g} ms"
        due = begin + pdo.period_ns
        pdo.stopped = "pdo_stopped" if pdo.sends else "rpdo_missing"
        self.clues.begin(pdo.stopped, pdo.node, begin, text, row=row, subject=pdo.key, due_ns=due)

    def _comes(self, pdo: _Pdo, t_ns: int) -> None:
        if pdo.stopped:
            self.clues.end(pdo.stopped, pdo.node, t_ns, "it comes again", subject=pdo.key)
            pdo.stopped = ""

    # in excess

    def _babble(self, pdo: _Pdo, group: Frames) -> None:
        """Note an identifier that floods the bus."""
        stamps = group.t_ns if pdo.last_ns < 0 else np.concatenate(([pdo.last_ns], group.t_ns))
        gaps, rows = np.diff(stamps), group.rows
        if not len(gaps):
            return
        flood = np.flatnonzero(pdo.rapid.counts(gaps < BABBLE_NS) >= BABBLE)
        pdo.babbles = bool(len(flood)) and int(flood[-1]) == len(gaps) - 1
        recent = np.concatenate((pdo.recent, stamps[1:]))
        if len(flood):
            i = len(pdo.recent) + int(flood[0])
            begin, end = int(recent[max(i - BABBLE, 0)]), int(recent[i])
            often = (
                f"{1e9 * BABBLE / (end - begin):.0f} times a second" if end > begin else "several times with one stamp"
            )
            node = self.bus.sender(pdo.key) if pdo.key not in (NMT, EMCY) else None
            text, row = f"identifier {pdo.key:03X}h comes {often}", int(rows[flood[0]])
            clue = self.clues.note("babble", node, begin, text, row=row, subject=pdo.key, count=len(flood))
            clue.last_ns = clue.end_ns = int(stamps[flood[-1] + 1])
            self._floods = [*self._floods[-8:], [int(stamps[flood[0] + 1]), clue.end_ns + AFTER_NS]]
        pdo.recent = recent[-BABBLE:]

    def _repeated(self, pdo: _Pdo, stamps: Integers, rows: Integers, gaps: Integers, equal: Flags) -> None:
        """Note immediately duplicated frames, which CAN may deliver."""
        period = self.bus.sync_period_ns
        limit = np.where(stamps[1:] > self.bus.sync_since_ns, min(0.25 * period, TWICE_NS), UNKNOWN_NS)
        twice = np.flatnonzero(equal & (gaps < limit))
        if len(twice):
            i = int(twice[0])
            text = f"{pdo.name} came twice, the second one {gaps[i] / 1000:.0f} us behind the first"
            clue = self.clues.note(
                "repeated", pdo.node, int(stamps[i + 1]), text, row=int(rows[i]), subject=pdo.key, count=len(twice)
            )
            clue.last_ns = clue.end_ns = int(stamps[twice[-1] + 1])


def _within(t_ns: Integers, spans: list[list[int]]) -> Flags:
    """Return whether each of these times is in one of the spans."""
    inside = np.zeros(len(t_ns), bool)
    for begin, end in spans:
        inside |= (t_ns >= begin) & (t_ns < end)
    return inside
