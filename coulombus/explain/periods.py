"""Timing of frames: SYNC, PDOs after SYNC, PDOs by their own period, excess frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from coulombus.eds.cia301 import CobId
from coulombus.explain.bus import EMCY, NMT, SDO_TX, Bus
from coulombus.explain.frames import SYNC, Block, Frames, Integers
from coulombus.recording.maps.seen_maps import Map

__all__ = ["Timing"]

MS = 1_000_000
LEARN = 20
"""Intervals of which a period is learned; of a PDO after SYNC, and of SYNC, so many suffice:"""
ENOUGH = 8
ACTIVE = 3
"""Successive SYNC intervals with a PDO after which its absence is noted."""
BABBLE_NS, BABBLE = 300_000, 200
"""Interval and number of successive frames of an identifier that are babble."""
SILENT = 10
"""SYNC periods without any frame that make a silent bus; at least 20 ms."""
MORE = 6
"""SYNC intervals per block with two frames of a PDO that show a second sender."""
PDO_KEYS = range(CobId.TPDO1, CobId.SDO_TX)


@dataclass
class _Pdo:
    """A PDO: its node by the present map, and its state between blocks."""

    key: int  # its identifier: the name may change
    node: int | None = None
    name: str = ""
    sends: bool = False  # the node sends it: a TPDO
    streak: int = 0  # successive SYNC intervals with a frame
    regular: bool = False
    missing_ns: int = -1  # time since which it is missing
    missing: int = 0
    held: tuple[int, int] | None = None  # time and row of a stop that an NMT command may still explain
    last_ns: int = -1
    last_word: int = 0
    last_row: int = -1
    latency_ns: float = -1.0
    period_ns: int = 0
    gaps: list[int] = field(default_factory=list)
    doubled: int = 0  # recent intervals with two different frames
    doubled_at: tuple[int, int] = (-1, -1)  # time and row of the first of them


class Timing:
    """Monitors periods; PDOs are counted per SYNC interval."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self.period_ns = 0
        self._sync = np.zeros(0, np.int64)  # the last SYNC of the previous block
        self._gaps: list[int] = []
        self._pdos: dict[int, _Pdo] = {}
        self._doubled_sync = False  # in this block: later intervals say nothing about PDOs
        self._doubled_ns = -1  # time of its beginning, if in this block
        self._last_ns = self._end_ns = -1
        self._quiet: list[tuple[int, int, int]] = []  # silences not yet ended by SYNC: begin, end, row
        self._rapid: dict[int, tuple[int, int, int]] = {}  # frames in rapid succession, begin, first row
        self._last_of: dict[int, int] = {}
        self.jitter_ns = 0.0
        self.sync_row = -1
        self.host_ns = -1

    def take(self, block: Block) -> None:
        """Process a block."""
        if len(block.t_ns) == 0:
            return
        self._end_ns = int(block.t_ns[-1])
        self._settle(self._end_ns)
        sync = block.groups.get(SYNC)
        edges = np.zeros(0, np.int64)
        if sync is not None:
            self._learn(sync)
        silences = self._silences(block)
        if sync is not None:
            self._sync_gaps(sync, silences)
            self._sync = sync.t_ns[-1:]
            edges = (
                sync.t_ns
                if block.last or self._doubled_sync
                else np.concatenate((sync.t_ns, self._sync + self.period_ns))
            )
            self.sync_row = int(sync.rows[-1])
        if self._doubled_sync:
            edges = edges[edges < self._doubled_ns]
        for key, group in block.groups.items():
            self._babble(key, group)
            known = self.bus.maps.get(key)
            if known is None and key not in PDO_KEYS:
                continue
            pdo = self._pdos.setdefault(key, _Pdo(key))
            self._identify(key, pdo, known)
            self._repeated(key, group, pdo)
            if len(edges) > 1 and self.period_ns:
                self._in_intervals(group, pdo, known, edges)
        if len(edges) > 1 and self.period_ns:
            for key, pdo in self._pdos.items():
                if key not in block.groups and pdo.regular:
                    empty = Frames(*(np.zeros(0, np.int64) for _ in range(4)))
                    known = self.bus.maps.get(key)
                    self._identify(key, pdo, known)
                    self._in_intervals(empty, pdo, known, edges)
        for key, group in block.groups.items():
            if key in self._pdos:
                pdo, known = self._pdos[key], self.bus.maps.get(key)
                self._identify(key, pdo, known)
                self._own_period(key, group, pdo, known)
                pdo.last_ns, pdo.last_word = int(group.t_ns[-1]), int(group.word[-1])
                pdo.last_row = int(group.rows[-1])
        self._last_ns = int(block.t_ns[-1])

    def look(self, t_ns: int) -> None:
        """Note overdue events at a time."""
        self._settle(t_ns)
        if self.period_ns and len(self._sync) and not self.clues.stands("sync_lost", None):
            last = int(self._sync[-1])
            overdue_ns = self.bus.order_due_ns(last, max(SILENT * self.period_ns, 20 * MS))
            if t_ns > overdue_ns and not self._stopped(last):
                self.clues.begin(
                    "sync_lost", None, last, "SYNC stops without an NMT order to the nodes", row=self.sync_row
                )
        for key, pdo in self._pdos.items():
            if pdo.regular or not pdo.period_ns or pdo.last_ns < 0:
                continue
            if t_ns > self.bus.order_due_ns(pdo.last_ns, 5 * pdo.period_ns):
                self._identify(key, pdo, self.bus.maps.get(key))
                self._gap(key, pdo, pdo.last_ns, None)

    # SYNC

    def _learn(self, sync: Frames) -> None:
        if self.period_ns:
            return
        self._gaps += np.diff(sync.t_ns[: LEARN + 1]).tolist()
        if len(self._gaps) >= ENOUGH:
            self.period_ns = int(np.median(self._gaps))

    def _sync_gaps(self, sync: Frames, silences: list[tuple[int, int]]) -> None:
        stamps = np.concatenate((self._sync, sync.t_ns))
        if not self.period_ns or len(stamps) < 2:
            return
        gaps = np.diff(stamps)
        near = gaps[(gaps > 0.5 * self.period_ns) & (gaps < 1.5 * self.period_ns)]
        if len(near):
            self.jitter_ns = max(self.jitter_ns, float(np.abs(near - self.period_ns).max()))
        if self.clues.stands("sync_lost", None):
            self.clues.end("sync_lost", None, int(sync.t_ns[0]), "SYNC comes again")
        first = len(stamps) - len(sync)
        for i in np.flatnonzero(gaps > 1.5 * self.period_ns).tolist():
            begin, end = int(stamps[i]), int(stamps[i + 1])
            row = int(sync.rows[i + 1 - first])
            if self._stopped(begin) or any(a < end and b > begin for a, b in silences):
                continue
            if self.bus.ordered(0, begin, end) is not None:
                continue
            count = round((end - begin) / self.period_ns) - 1
            text = f"no SYNC for {(end - begin) / MS:.2f} ms; its period is {self.period_ns / MS:g} ms"
            if end - begin > max(SILENT * self.period_ns, 20 * MS):
                self.clues.begin("sync_lost", None, begin, text, row=row)
                self.clues.end("sync_lost", None, end, "SYNC comes again")
            else:
                self.clues.note("sync_gap", None, begin, text, row=row, count=max(count, 1))
        close = np.flatnonzero(gaps < 0.5 * self.period_ns)
        stands = self.clues.stands("two_sync", None)
        if stands and not len(close) and len(gaps) > ENOUGH:
            self.clues.end("two_sync", None, int(stamps[0]), "SYNC comes once in its period again")
        self._doubled_sync = len(close) > 0 and (stands or (len(close) >= 5 and len(close) > 0.1 * len(gaps)))
        if self._doubled_sync:
            row, at = int(sync.rows[close[0] + 1 - first]), int(stamps[close[0] + 1])
            text = f"SYNC comes more than once within its period of {self.period_ns / MS:g} ms: two nodes produce it"
            self._doubled_ns = -1 if stands else at
            self.clues.begin("two_sync", None, at, text, row=row)
        elif len(close):
            row, at = int(sync.rows[close[0] + 1 - first]), int(stamps[close[0] + 1])
            self.clues.note("repeated", None, at, "a SYNC came twice", row=row, count=len(close), subject="sync")

    def _stopped(self, begin: int) -> bool:
        """Return whether NMT commands explain that cyclic frames stop after `begin`."""
        soon = self.bus.order_due_ns(begin, max(5 * self.period_ns, 20 * MS))
        nodes = [node.number for node in self.bus.nodes.values() if node.number != self.bus.host]
        running = [number for number in nodes if not self.bus.left_on_order(number, soon)]
        started = any(order.command == 1 for order in self.bus.orders)
        at_work = [number for number in running if started or self.bus.nodes[number].state == 5]
        return bool(nodes) and not at_work

    def _silences(self, block: Block) -> list[tuple[int, int]]:
        """Note silences in which SYNC and heartbeats were due, ended by SYNC; return their times."""
        if not self.period_ns:
            return []
        sync = block.groups.get(SYNC)
        stamps = block.t_ns if self._last_ns < 0 else np.concatenate(([self._last_ns], block.t_ns))
        gaps = np.diff(stamps)
        beats = [node.period_ns for node in self.bus.nodes.values() if node.period_ns and node.number != self.bus.host]
        limit = max(SILENT * self.period_ns, 20 * MS, round(1.5 * min(beats, default=0)))
        for i in np.flatnonzero(gaps > limit).tolist():
            begin, end = int(stamps[i]), int(stamps[i + 1])
            last = int(self._sync[-1]) if len(self._sync) else -1
            if sync is not None and int(sync.t_ns[0]) <= begin:
                last = int(sync.t_ns[sync.t_ns.searchsorted(begin, "right") - 1])
            if last >= 0 and begin - last <= 2 * self.period_ns and not self._stopped(begin):
                self._quiet.append((begin, end, block.first_row + max(i - (self._last_ns >= 0), 0)))
        if sync is None:
            return []
        silences = []
        for begin, end, row in self._quiet:
            place = int(sync.t_ns.searchsorted(end))
            if place < len(sync) and int(sync.t_ns[place]) - end <= max(3 * (end - begin), 200 * MS):
                text = f"no frame of any node for {(end - begin) / MS:.1f} ms"
                self.clues.begin("bus_silent", None, begin, text, row=row)
                self.clues.end("bus_silent", None, end, "frames come again")
                silences.append((begin, end))
        self._quiet = [quiet for quiet in self._quiet if int(sync.t_ns[-1]) < quiet[1]]
        return silences

    # PDOs

    def _identify(self, key: int, pdo: _Pdo, known: Map | None) -> None:
        """Set node, name and direction by the present map, else by the identifier."""
        if known is not None:
            pdo.node, pdo.name, pdo.sends = known.node, known.name, known.direction == "tpdo"
        else:
            pdo.node, pdo.name, pdo.sends = key & 0x7F or None, f"PDO {key:03X}h", bool(key & 0x080)

    def _in_intervals(self, group: Frames, pdo: _Pdo, known: Map | None, sync: Integers) -> None:
        """Count a PDO's frames in each SYNC interval that is complete."""
        if known is not None and known.synchronous is False:
            return
        place = np.searchsorted(sync, group.t_ns, "right") - 1
        intervals = len(sync) - 1
        complete = (place >= 0) & (place < intervals)
        counts = np.bincount(place[complete], minlength=intervals)
        if pdo.regular and counts.min(initial=1) == 1 == counts.max(initial=1):
            pdo.streak += intervals
            pdo.doubled = 0
            if pdo.missing_ns >= 0:
                self._again(pdo, int(sync[0]))
        else:
            self._walk(counts, sync, pdo, group)
        self._latency(group, pdo, sync, place, counts)

    def _walk(self, counts: Integers, sync: Integers, pdo: _Pdo, group: Frames) -> None:
        """Process runs of intervals with and without the PDO."""
        for empty, start, end in _runs(counts):
            if not empty:
                if pdo.missing_ns >= 0:
                    self._again(pdo, int(sync[start]))
                if not pdo.regular:
                    first = counts[start : min(end, start + ENOUGH)]
                    pdo.regular = len(first) + pdo.streak >= ACTIVE and bool((first == 1).mean() > 0.9)
                pdo.streak += end - start
                continue
            late = end - start == 1 and end < len(counts) and counts[end] > 1
            excused = self._excused(pdo.node, int(sync[start]))
            if pdo.regular and excused:
                pdo.regular = False  # a missing PDO stays noted until it is restarted and received
            elif pdo.regular and not late and pdo.missing_ns < 0:
                self._missing(pdo, int(sync[start]), end - start, group)
            elif pdo.missing_ns >= 0:
                pdo.missing += end - start
            pdo.streak = 0
        if pdo.regular:
            self._doubled(counts, sync, pdo, group)

    def _excused(self, node: int | None, begin: int) -> bool:
        """Return whether an NMT command explains that a PDO stops at this time."""
        due_ns = self.bus.order_due_ns(begin, max(3 * self.period_ns, 20 * MS))
        return node is None or self.bus.left_on_order(node, due_ns)

    def _missing(self, pdo: _Pdo, begin: int, number: int, group: Frames) -> None:
        pdo.missing_ns, pdo.missing = begin, number
        place = int(group.t_ns.searchsorted(begin))
        row = int(group.rows[place - 1]) if place else pdo.last_row
        pdo.held = begin, row
        self._settle(self._end_ns, pdo)

    def _settle(self, t_ns: int, *pdos: _Pdo) -> None:
        """Note the stops of `pdos`, or of all, that no NMT command explained in time."""
        for pdo in pdos or self._pdos.values():
            if pdo.held is None:
                continue
            begin, row = pdo.held
            if self._excused(pdo.node, begin):
                pdo.held, pdo.regular, pdo.missing_ns = None, False, -1
            elif t_ns > self.bus.order_due_ns(begin, 0):
                pdo.held = None
                self._begin_missing(pdo, begin, row)

    def _begin_missing(self, pdo: _Pdo, begin: int, row: int) -> None:
        kind = "tpdo_missing" if pdo.sends else "rpdo_missing"
        text = f"no {pdo.name} after SYNC" if pdo.sends else f"no {pdo.name}: set-points do not come"
        self.clues.begin(kind, pdo.node, begin, text, row=row, subject=pdo.key)

    def _again(self, pdo: _Pdo, t_ns: int) -> None:
        if pdo.held is not None:
            begin, row = pdo.held
            pdo.held = None
            self._begin_missing(pdo, begin, row)
        kind = "tpdo_missing" if pdo.sends else "rpdo_missing"
        text = f"{pdo.name} comes again, {max(pdo.missing, 1)} were missing"
        self.clues.end(kind, pdo.node, t_ns, text, subject=pdo.key)
        pdo.missing_ns, pdo.missing = -1, 0

    def _doubled(self, counts: Integers, sync: Integers, pdo: _Pdo, group: Frames) -> None:
        """Note intervals with several frames of a PDO with different contents."""
        differing = 0
        if any(count >= BABBLE for count, _, _ in self._rapid.values()):
            return  # on a flooded bus frames of two cycles fall into one interval
        for i in np.flatnonzero(counts > 1)[:200].tolist():
            start, end = group.t_ns.searchsorted((sync[i], sync[i + 1]))
            around = counts[max(i - 2, 0) : i + 3]
            long = sync[i + 1] - sync[i] > 1.3 * self.period_ns  # SYNC itself was late
            if len(set(group.word[start:end].tolist())) > 1 and around.all() and not long:
                differing += 1
                if not pdo.doubled and differing == 1:
                    pdo.doubled_at = int(group.t_ns[end - 1]), int(group.rows[end - 1])
        if differing <= 2 * int((counts == 0).sum()):
            differing = 0  # they are late frames
        pdo.doubled = pdo.doubled + differing if differing else max(pdo.doubled - len(counts), 0)
        if pdo.doubled >= MORE and differing:
            kind = "duplicate_node" if pdo.sends else "second_master"
            what = "two devices have its node id" if pdo.sends else "two masters command it"
            text = f"{pdo.name} comes twice within a SYNC period, with contents that differ: {what}"
            at, row = pdo.doubled_at
            self.clues.begin(kind, pdo.node, at, text, row=row, subject=pdo.key)

    def _latency(self, group: Frames, pdo: _Pdo, sync: Integers, place: Integers, counts: Integers) -> None:
        """Note PDOs that come much later after SYNC than usual."""
        complete = (place >= 0) & (place < len(counts))
        if not pdo.regular or not complete.any():
            return
        latency = (group.t_ns[complete] - sync[place[complete]]).astype(float)
        usual = pdo.latency_ns
        if usual < 0:
            if len(latency) < LEARN:
                return
            usual = pdo.latency_ns = float(np.median(latency[:LEARN]))
        late = np.flatnonzero((latency > usual + 0.3 * self.period_ns) & (counts[place[complete]] == 1))
        early = np.flatnonzero((latency < usual - 0.3 * self.period_ns) & (counts[place[complete]] == 1))
        worst = late if len(late) >= len(early) else early
        if len(worst) >= 5:
            i = int(np.flatnonzero(complete)[worst[0]])
            how = "late" if worst is late else "after the next SYNC"
            text = (
                f"{pdo.name} comes {how}: {latency[worst].mean() / MS:.2f} ms after SYNC, usually {usual / MS:.2f} ms"
            )
            kind = "tpdo_late" if pdo.sends else "rpdo_late"
            clue = self.clues.note(
                kind, pdo.node, int(group.t_ns[i]), text, row=int(group.rows[i]), subject=pdo.key, count=len(worst)
            )
            clue.last_ns = clue.end_ns = int(group.t_ns[np.flatnonzero(complete)[worst[-1]]])

    def _own_period(self, key: int, group: Frames, pdo: _Pdo, known: Map | None) -> None:
        """Learn the period of a PDO that does not follow SYNC, and note its gaps."""
        if pdo.regular or (known is not None and known.synchronous):
            return
        stamps = group.t_ns if pdo.last_ns < 0 else np.concatenate(([pdo.last_ns], group.t_ns))
        gaps = np.diff(stamps)
        if not pdo.period_ns:
            pdo.gaps += gaps[: 3 * LEARN].tolist()
            if len(pdo.gaps) >= 2 * LEARN:
                median = float(np.median(pdo.gaps))
                steady = np.percentile(pdo.gaps, 95) < 1.5 * median and min(pdo.gaps) > 0.5 * median
                pdo.period_ns = int(median) if steady else 0
                pdo.gaps = [] if steady else pdo.gaps[-LEARN:]
            return
        for i in np.flatnonzero(gaps > 5 * pdo.period_ns).tolist():
            self._gap(key, pdo, int(stamps[i]), int(stamps[i + 1]))
        if self.clues.stands("pdo_stopped", pdo.node, key):
            self.clues.end("pdo_stopped", pdo.node, int(group.t_ns[0]), "it comes again", subject=key)

    def _gap(self, key: int, pdo: _Pdo, begin: int, end: int | None) -> None:
        node = pdo.node
        if node is None or self._excused(node, begin) or self.clues.stands("pdo_stopped", node, key):
            return
        text = f"{pdo.name} stops, it came every {pdo.period_ns / MS:.3g} ms"
        self.clues.begin("pdo_stopped", node, begin, text, row=pdo.last_row, subject=key)
        if end is not None:
            self.clues.end("pdo_stopped", node, end, "it comes again", subject=key)

    # frames in excess

    def _babble(self, key: int, group: Frames) -> None:
        if key > 0x7FF or SDO_TX <= key < 0x680 or len(group) < 2:
            self._rapid.pop(key, None)
            return
        gaps = np.diff(group.t_ns)
        rapid = gaps < BABBLE_NS
        number = int(rapid.sum())
        if number < 0.7 * len(rapid):
            self._rapid.pop(key, None)
            return
        first = int(np.flatnonzero(rapid)[0])
        before, since_ns, row = self._rapid.get(key, (0, int(group.t_ns[first]), int(group.rows[first])))
        self._rapid[key] = before + number, since_ns, row
        if before + number >= BABBLE:
            node = self.bus.sender(key) if key not in (NMT, EMCY) else None
            usual_ns = float(np.median(gaps[rapid]))
            often = f"{1e9 / usual_ns:.0f} times a second" if usual_ns > 0 else "several times with one stamp"
            text = f"identifier {key:03X}h comes {often}"
            clue = self.clues.note("babble", node, since_ns, text, row=row, subject=key)
            clue.count = before + number
            clue.last_ns = clue.end_ns = int(group.t_ns[np.flatnonzero(rapid)[-1] + 1])

    def _repeated(self, key: int, group: Frames, pdo: _Pdo) -> None:
        """Note immediately duplicated frames, which CAN may deliver."""
        if len(group) < 2 or self._rapid.get(key):
            return
        gap = np.diff(group.t_ns)
        limit = 0.25 * self.period_ns if self.period_ns else 200_000
        same = (gap < limit) & (np.diff(group.word) == 0) & (np.diff(group.length) == 0)
        if not same.any():
            return
        first = int(np.flatnonzero(same)[0]) + 1
        text = f"{pdo.name} came twice, the second one {gap[first - 1] / 1000:.0f} us behind the first"
        self.clues.note(
            "repeated",
            pdo.node,
            int(group.t_ns[first]),
            text,
            row=int(group.rows[first]),
            subject=key,
            count=int(same.sum()),
        )


def _runs(counts: Integers) -> Iterator[tuple[bool, int, int]]:
    """Yield (without frames, first interval, end interval) of each run."""
    empty = counts == 0
    bounds = np.r_[0, np.flatnonzero(np.diff(empty.astype(np.int8))) + 1, len(counts)]
    for start, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        if end > start:
            yield bool(empty[start]), start, end
