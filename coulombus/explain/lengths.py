"""PDOs whose length does not match their map (CiA 301, 7.2.2.5)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import Block

__all__ = ["Lengths"]


class Lengths:
    """Compares the length of every PDO with its map, and with its earlier length."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._last: dict[int, int] = {}
        self._fits: dict[int, bool] = {}

    def take(self, block: Block) -> None:
        """Process a block."""
        for key, group in block.groups.items():
            known = self.bus.maps.get(key)
            if known is None or known.source == "assumed":
                continue
            expected = known.length or self._last.get(key, int(group.length[0]))
            self._last[key] = expected
            fits = group.length >= expected if known.direction == "rpdo" else group.length == expected
            changes = np.flatnonzero(np.diff(fits, prepend=self._fits.get(key, True)))
            self._fits[key] = bool(fits[-1])
            for i, behind in pairwise([*changes.tolist(), len(group)]):
                t_ns, row = int(group.t_ns[i]), int(group.rows[i])
                if fits[i]:
                    self.clues.end("pdo_length", known.node, t_ns, "the length fits again", subject=key)
                    continue
                text = f"{known.name} ({key:03X}h) has {group.length[i]} bytes, its map ({known.source}) {expected}"
                clue = self.clues.begin("pdo_length", known.node, t_ns, text, row=row, subject=key)
                clue.count += behind - i - 1
            if not fits[0] and (not len(changes) or changes[0] > 0):
                self.clues.more("pdo_length", known.node, int(changes[0]) if len(changes) else len(group), subject=key)
