"""Clues: observations with kind, node, begin and end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from coulombus.explain.frames import Integers

__all__ = ["Clue", "Clues"]

MERGED_NS = 1_000_000_000
"""Notes of one kind, node and subject within this time of each other form one clue."""
MOST = 40
"""Maximum clues of one kind and node, and of one identifier; the last of them counts later ones."""
SHOWN = 6
"""Maximum frames that show a clue."""
BY_IDENTIFIER = frozenset(
    {
        *("tpdo_missing", "rpdo_missing", "pdo_stopped", "tpdo_late", "rpdo_late", "pdo_length", "service_length"),
        *("repeated", "babble", "starved", "event_timer", "inhibit_time"),
    }
)


@dataclass
class Clue:
    """An observation that is abnormal for a healthy bus.

    `end_ns` is None while it persists; `rows` has the numbers of a few frames that show it.
    """

    kind: str
    node: int | None
    begin_ns: int
    text: str
    end_ns: int | None = None
    due_ns: int = -1
    """Time from which a listener may know it: for an absence, the time at which the first missing frame was due."""
    last_ns: int = 0
    count: int = 1
    axis: int = 0
    end_text: str = ""
    who: str = ""
    """Culprit, if it is another than that of its kind."""
    check: str = ""
    """First check, if it is more specific than that of its kind."""
    rows: list[int] = field(default_factory=list)

    def show(self, rows: Sequence[int] | Integers) -> None:
        """Add the numbers of frames that show it."""
        self.rows.extend(int(row) for row in rows[: SHOWN - len(self.rows)])


class Clues:
    """The clues so far; at most one clue is open per kind, node and subject."""

    def __init__(self) -> None:
        self.all: list[Clue] = []
        self._last: dict[tuple[str, int | None, object], Clue] = {}
        self._open: Counter[int | None] = Counter()  # open clues of each node
        self._number: dict[tuple[str, int | None, object], int] = {}

    def begin(
        self,
        kind: str,
        node: int | None,
        t_ns: int,
        text: str,
        *,
        row: int = -1,
        subject: object = None,
        due_ns: int = -1,
    ) -> Clue:
        """Open a clue, or count it if it is already open.

        An absence, which has the time `due_ns`, is not merged with an earlier one.
        """
        key = (kind, node, subject)
        clue = self._last.get(key)
        apart_ns = MERGED_NS if due_ns < 0 else -1
        if clue is None or (clue.end_ns is not None and t_ns - clue.last_ns > apart_ns and self._room(key)):
            due_ns = t_ns if due_ns < 0 else due_ns
            clue = Clue(kind, node, t_ns, text, due_ns=due_ns, last_ns=t_ns, rows=[row] if row >= 0 else [])
            self.all.append(clue)
            self._last[key] = clue
            self._open[node] += 1
            return clue
        clue.count += 1
        self._open[node] += clue.end_ns is not None
        clue.end_ns, clue.last_ns = None, max(clue.last_ns, t_ns)
        if row >= 0:
            clue.show([row])
        return clue

    def note(
        self,
        kind: str,
        node: int | None,
        t_ns: int,
        text: str,
        *,
        row: int = -1,
        subject: object = None,
        count: int = 1,
    ) -> Clue:
        """Note a momentary clue."""
        clue = self.begin(kind, node, t_ns, text, row=row, subject=subject)
        clue.count += count - 1
        self._open[node] -= clue.end_ns is None
        clue.end_ns = clue.last_ns
        return clue

    def series(
        self,
        kind: str,
        node: int | None,
        t_ns: Integers,
        rows: Integers,
        text: Callable[[int], str],
        *,
        subject: object = None,
    ) -> Clue | None:
        """Note observations at several times, in their order; `text`: of one of them by its place; return the last clue."""
        clue = None
        if not len(t_ns):
            return clue
        starts = [0, *(np.flatnonzero(np.diff(t_ns) > MERGED_NS) + 1).tolist(), len(t_ns)]
        for start, end in pairwise(starts):
            first = int(t_ns[start])
            clue = self.note(kind, node, first, text(start), row=int(rows[start]), subject=subject, count=end - start)
            clue.last_ns = clue.end_ns = int(t_ns[end - 1])
            clue.show(rows[start + 1 : end])
        return clue

    def end(self, kind: str, node: int | None, t_ns: int, text: str = "", *, subject: object = None) -> bool:
        """Close a clue; return whether it was open."""
        clue = self._last.get((kind, node, subject))
        if clue is None or clue.end_ns is not None:
            return False
        self._open[node] -= 1
        clue.end_ns, clue.end_text = max(t_ns, clue.begin_ns), text
        clue.last_ns = max(clue.last_ns, t_ns)
        return True

    def more(self, kind: str, node: int | None, count: int, *, subject: object = None) -> None:
        """Count more of an open clue."""
        self._last[kind, node, subject].count += count

    def end_all(self, kind: str, node: int | None, t_ns: int, text: str = "") -> None:
        """Close all clues of this kind and node, for any subject."""
        for which, whose, subject in list(self._last):
            if (which, whose) == (kind, node):
                self.end(kind, node, t_ns, text, subject=subject)

    def any_open(self, node: int | None) -> bool:
        """Return whether any clue of a node is open."""
        return self._open[node] > 0

    def stands(self, kind: str, node: int | None, subject: object = None) -> bool:
        """Return whether such a clue is open."""
        clue = self._last.get((kind, node, subject))
        return clue is not None and clue.end_ns is None

    def retract(self, clues: list[Clue]) -> None:
        """Remove clues whose ground turned out to be wrong."""
        gone = {id(clue) for clue in clues}
        for clue in clues:
            self._open[clue.node] -= clue.end_ns is None
        self.all = [clue for clue in self.all if id(clue) not in gone]
        self._last = {key: clue for key, clue in self._last.items() if id(clue) not in gone}

    def _room(self, key: tuple[str, int | None, object]) -> bool:
        if key[0] not in BY_IDENTIFIER:
            key = key[0], key[1], None
        number = self._number[key] = self._number.get(key, 0) + 1
        return number < MOST
