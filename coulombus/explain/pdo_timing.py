"""Timing of PDOs: after SYNC, by their own period, or by their timers; frames in excess."""

from __future__ import annotations

import numpy as np

from coulombus.eds.cia301 import NmtState
from coulombus.explain.bus import EMCY, NMT, PDOS, SDO_TX, Bus
from coulombus.explain.frames import SYNC, Block, Frames, Integers
from coulombus.explain.sync_intervals import ENDING_NS, EQUAL, MS, NONE, STEADY, Flags, SeenPdo, SyncIntervals
from coulombus.recording.maps.seen_maps import Map
from coulombus.wire.clock import NEVER_NS

__all__ = ["PdoTimers", "PdoTiming"]

SHORT = 0.5
"""Interval, in periods, between two SYNCs in which a PDO need not come."""
TIMED = 15
"""Intervals of which the own period of a PDO is learned."""
STOPPED = 5
"""Own periods, or event timer periods, after which a PDO has stopped and is not late."""
LATE, SOON = 1.5, 0.75
"""Factors of the event timer and of the inhibit time, with a margin for waiting for the bus."""
RESTS = 3
"""Stops after which a PDO whose contents were never repeated is event-driven: what it tells of moves and rests."""
EVEN_NS = 10_000_000_000
"""Time of even intervals after which a PDO is cyclic whose contents were never repeated: what moves is sent so, too."""
ALWAYS_NS = 1_000_000_000
"""The same of a PDO that came at even intervals since its node is at work; time until its first frame."""
BABBLE_NS, BABBLE = 450_000, 200
"""Interval, and number among successive frames of an identifier, that are babble."""
TWICE_NS, UNKNOWN_NS = MS, 200_000
"""Maximum interval of a frame that came twice; the same while the period of SYNC is unknown."""
AFTER_NS = 1_000_000_000
"""Time after a flood within which delayed frames come."""
EMPTY = Frames(NONE, NONE, NONE, NONE)


class PdoTiming:
    """Monitors the periods of PDOs, and identifiers that come too often."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._pdos: dict[int, SeenPdo] = {}
        self._sync_ns = -1  # the last SYNC
        self._raw_ns = -NEVER_NS  # the same, if it followed too soon, too
        self._since_ns = bus.sync_since_ns  # with which its period was learned
        self._intervals = SyncIntervals(bus)

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        if len(block.t_ns) == 0:
            return
        if self.bus.sync_since_ns != self._since_ns:  # another period, or none
            self._since_ns, self._sync_ns = self.bus.sync_since_ns, -1
            for pdo in self._pdos.values():
                pdo.open, pdo.streak, pdo.empty = 0, 0, None
        sync = block.groups.get(SYNC)
        edges = NONE if sync is None else self._edges(sync.t_ns)
        if self._sync_ns >= 0:
            edges = np.concatenate(([self._sync_ns], edges))
        edges = edges[edges >= self.bus.sync_since_ns]
        for begin, end in self.bus.two_sync:  # its intervals say nothing about PDOs
            edges = edges[(edges <= begin) | (edges >= end)]
        for key in block.groups:
            if self._is_watched(key):
                self._pdos.setdefault(key, SeenPdo(key))
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
        self.note_overdue(int(block.t_ns[-1]))

    def _edges(self, sync_ns: Integers) -> Integers:
        """Return the SYNCs but those that follow too soon: no PDO need come between them."""
        gaps = np.diff(sync_ns, prepend=self._raw_ns)
        self._raw_ns = int(sync_ns[-1])
        edges: Integers = sync_ns[gaps >= SHORT * self.bus.sync_period_ns]
        return edges

    def note_overdue(self, t_ns: int) -> None:
        """Note stops that are overdue at a time [ns]."""
        for pdo in self._pdos.values():
            if pdo.held is not None:
                self._intervals.settle(pdo, t_ns)
            if pdo.period_ns and not pdo.excused:
                self._stopped(pdo, pdo.last_ns, pdo.last_row, t_ns)

    def _is_watched(self, key: int) -> bool:
        return key in self.bus.maps or (key <= 0x7FF and not SDO_TX <= key < 0x680 and key != SYNC)

    def _identify(self, pdo: SeenPdo, pdo_map: Map | None) -> None:
        """Set node, name and type by the present map, else by the identifier."""
        if pdo_map is not None:
            pdo.node, pdo.name, pdo.sends = pdo_map.node, pdo_map.name, pdo_map.direction == "tpdo"
            pdo.synchronous, pdo.event_ns = pdo_map.each_sync, pdo_map.event_ns
        else:
            pdo.node, pdo.name, pdo.sends = pdo.key & 0x7F or None, f"PDO {pdo.key:03X}h", bool(pdo.key & 0x080)

    def _group(self, pdo: SeenPdo, group: Frames, edges: Integers) -> None:
        """Process the frames of an identifier; `edges`: SYNC, from the last one before this block."""
        before = pdo.last_ns >= 0
        stamps = np.concatenate(([pdo.last_ns], group.t_ns)) if before else group.t_ns
        words = np.concatenate(([pdo.last_word], group.word)) if before else group.word
        lengths = np.concatenate(([pdo.last_length], group.length)) if before else group.length
        gaps = np.diff(stamps)
        equal = (np.diff(words) == 0) & (np.diff(lengths) == 0)
        rows = group.rows[len(group) - len(gaps) :]
        is_pdo = pdo.key in PDOS or pdo.key in self.bus.maps
        if is_pdo and not pdo.babbles:
            self._repeated(pdo, stamps, rows, gaps, equal)
        if is_pdo and pdo.synchronous is not False and len(edges) and self.bus.sync_period_ns:
            self._intervals.add_pdo(pdo, group, stamps, edges, equal)
        if len(group):
            if is_pdo:
                self._own_period(pdo, group, stamps, gaps, equal)
            pdo.last_ns, pdo.last_row = int(group.t_ns[-1]), int(group.rows[-1])
            pdo.last_word, pdo.last_length = int(group.word[-1]), int(group.length[-1])
            pdo.equal += int(equal.sum())

    # by its own period

    def _own_period(self, pdo: SeenPdo, group: Frames, stamps: Integers, gaps: Integers, equal: Flags) -> None:
        """Learn the period of a PDO that does not follow SYNC, and note its stops."""
        if pdo.synchronous and pdo.stopped:
            self._comes(pdo, int(group.t_ns[0]))
        before_following = stamps[1:] < pdo.followed_ns
        if not (pdo.synchronous or pdo.moves) and before_following.any():
            number = int(before_following.sum())
            self._own_gaps(pdo, group, stamps[: number + 1], gaps[:number], equal[:number])
        if pdo.synchronous or not before_following.all():
            pdo.period_ns = 0

    def _own_gaps(self, pdo: SeenPdo, group: Frames, stamps: Integers, gaps: Integers, equal: Flags) -> None:
        skipped = 0 if pdo.period_ns else self._learn(pdo, gaps, equal)
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

    def _learn(self, pdo: SeenPdo, gaps: Integers, equal: Flags) -> int:
        """Learn a period from the first intervals that are even; return how many of these it took."""
        before = len(pdo.gaps)
        whole = np.concatenate((pdo.gaps, gaps)).astype(np.int64)
        number = len(whole) // TIMED
        some = np.sort(whole[: number * TIMED].reshape(number, TIMED), axis=1)
        low, median, high = some[:, 0], some[:, TIMED // 2], some[:, -1]
        repeated = np.concatenate(([0], np.cumsum(equal)))[TIMED * (np.arange(number) + 1) - before] + pdo.equal
        narrow = high - low < 2 * STEADY * median
        so_far = np.cumsum(some.sum(axis=1))
        broken = np.maximum.accumulate(np.where(narrow, -pdo.even_ns, so_far)) if number else so_far
        lasts = so_far - broken
        whole_time = so_far + pdo.watched_ns  # since its first frame
        always = (lasts == whole_time) & (lasts >= ALWAYS_NS) & self._began_at_once(pdo)
        timed = (narrow & ((lasts >= EVEN_NS) | always)) | (repeated >= EQUAL)
        timed |= pdo.event_ns > 0
        shown = np.flatnonzero((high < 1.5 * median) & (low > 0.5 * median) & timed)
        if number:
            pdo.even_ns, pdo.watched_ns = int(lasts[-1]), int(whole_time[-1])
        pdo.gaps = [] if len(shown) else whole[number * TIMED :].tolist()
        pdo.period_ns = int(median[shown[0]]) if len(shown) else 0
        return TIMED * (int(shown[0]) + 1) - before if len(shown) else len(gaps)

    def _began_at_once(self, pdo: SeenPdo) -> bool:
        """Return whether a PDO came since the log's begin, or since its node was started: a timer sends it."""
        first = self.bus.first_of.get(pdo.key, self.bus.first_ns)
        started = pdo.node is not None and self.bus.ordered(pdo.node, first - ALWAYS_NS, first, NmtState.OPERATIONAL)
        return first - self.bus.first_ns < ALWAYS_NS or bool(started)

    def _stopped(self, pdo: SeenPdo, begin: int, row: int, t_ns: int) -> None:
        """Note a stop that is overdue at a time [ns]."""
        due_ns = self.bus.order_due_ns(begin, max(STOPPED * pdo.period_ns, 0 if pdo.sends else ENDING_NS))
        if t_ns <= due_ns:
            return
        pdo.excused = True
        if pdo.node is None or self.bus.left_on_order(pdo.node, due_ns):
            return
        text = f"{pdo.name} stops, it came every {pdo.period_ns / MS:.3g} ms"
        due = begin + pdo.period_ns
        pdo.stopped = "pdo_stopped" if pdo.sends else "rpdo_missing"
        text, who = self.bus.pdo_end(pdo.key, begin, t_ns, text)
        clue = self.clues.begin(pdo.stopped, pdo.node, begin, text, row=row, subject=pdo.key, due_ns=due)
        clue.who = who
        pdo.stops.append(clue)

    def _comes(self, pdo: SeenPdo, t_ns: int) -> None:
        if not pdo.stopped:
            return
        self.clues.end(pdo.stopped, pdo.node, t_ns, "it comes again", subject=pdo.key)
        pdo.stopped = ""
        if len(pdo.stops) >= RESTS and not pdo.event_ns and pdo.equal < EQUAL:
            self.clues.retract(pdo.stops)
            pdo.moves, pdo.period_ns = True, 0

    # in excess

    def _babble(self, pdo: SeenPdo, group: Frames) -> None:
        """Note an identifier that floods the bus."""
        stamps = group.t_ns if pdo.last_ns < 0 else np.concatenate(([pdo.last_ns], group.t_ns))
        gaps = np.diff(stamps)
        rows = group.rows[len(group) - len(gaps) :]
        if not len(gaps) or self.bus.last_ns == self.bus.first_ns:  # a log without times
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
            clue.show(rows[flood[1:]])
            self._intervals.floods = [*self._intervals.floods[-8:], [int(stamps[flood[0] + 1]), clue.end_ns + AFTER_NS]]
        pdo.recent = recent[-BABBLE:]

    def _repeated(self, pdo: SeenPdo, stamps: Integers, rows: Integers, gaps: Integers, equal: Flags) -> None:
        """Note immediately duplicated frames, which CAN may deliver."""
        period = self.bus.sync_period_ns
        limit = np.where(stamps[1:] > self.bus.sync_since_ns, min(0.25 * period, TWICE_NS), UNKNOWN_NS)
        twice = np.flatnonzero(equal & (gaps > 0) & (gaps < limit))  # of frames with one stamp the times are not known

        def text(i: int) -> str:
            return f"{pdo.name} came twice, the second one {gaps[twice[i]] / 1000:.0f} us behind the first"

        self.clues.series("repeated", pdo.node, stamps[twice + 1], rows[twice], text, subject=pdo.key)


class PdoTimers:
    """Compares the intervals of event-driven TPDOs with their timers (CiA 301, 7.5.2.37: 1800h:03 and :05)."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._last_ns: dict[int, int] = {}

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for key, group in block.groups.items():
            pdo_map = self.bus.maps.get(key)
            if pdo_map is None or pdo_map.synchronous or not (pdo_map.event_ns or pdo_map.inhibit_ns):
                continue
            self._hold(key, group, pdo_map)
            self._last_ns[key] = int(group.t_ns[-1])

    def _hold(self, key: int, group: Frames, pdo_map: Map) -> None:
        before = self._last_ns.get(key)
        stamps = group.t_ns if before is None else np.concatenate(([before], group.t_ns))
        gaps, first = np.diff(stamps), len(stamps) - len(group)
        soon = gaps < SOON * pdo_map.inhibit_ns
        late = (gaps > LATE * pdo_map.event_ns) & (gaps < STOPPED * pdo_map.event_ns) & (pdo_map.event_ns > 0)
        for kind, which, limit in (("inhibit_time", soon, pdo_map.inhibit_ns), ("event_timer", late, pdo_map.event_ns)):
            places = np.flatnonzero(which)
            setting = "inhibit time"
            if kind == "event_timer":
                setting = "event timer"
                ordered = [self.bus.ordered(pdo_map.node, *stamps[i : i + 2].tolist()) is not None for i in places]
                places = places[~np.array(ordered, bool)]

            def text(i: int, at: Integers = places, limit_ms: float = limit / MS, setting: str = setting) -> str:
                return f"{pdo_map.name} comes after {gaps[at[i]] / MS:.1f} ms; its {setting} is {limit_ms:g} ms"

            rows = group.rows[np.maximum(places + 1 - first, 0)]
            self.clues.series(kind, pdo_map.node, stamps[places + 1], rows, text, subject=key)
