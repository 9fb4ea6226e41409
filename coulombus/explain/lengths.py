"""PDOs whose length does not match their map (CiA 301, 7.2.2.5)."""

from __future__ import annotations

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import Block

__all__ = ["Lengths"]


class Lengths:
    """Compares the length of every PDO with its map, and with its earlier length."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._last: dict[int, int] = {}

    def take(self, block: Block) -> None:
        """Process a block."""
        for key, group in block.groups.items():
            known = self.bus.maps.get(key)
            if known is None or known.source == "assumed":
                continue
            expected = known.length or self._last.get(key, int(group.length[0]))
            self._last[key] = expected
            enough = group.length >= expected if known.direction == "rpdo" else group.length == expected
            if enough.all():
                self.clues.end("pdo_length", known.node, int(group.t_ns[0]), "the length fits again", subject=key)
                continue
            wrong = np.flatnonzero(~enough)
            i = int(wrong[0])
            text = f"{known.name} ({key:03X}h) has {group.length[i]} bytes, its map ({known.source}) {expected}"
            clue = self.clues.begin(
                "pdo_length", known.node, int(group.t_ns[i]), text, row=int(group.rows[i]), subject=key
            )
            clue.count += len(wrong) - 1
            if wrong[-1] < len(group) - 1:
                after = int(group.t_ns[wrong[-1] + 1])
                self.clues.end("pdo_length", known.node, after, "the length fits again", subject=key)
