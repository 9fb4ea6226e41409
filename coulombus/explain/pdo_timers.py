"""Violated event timers and inhibit times (CiA 301, 7.5.2.37: 1800h:03 and :05)."""

from __future__ import annotations

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import Block, Frames, Integers
from coulombus.recording.maps.seen_maps import Map

__all__ = ["PdoTimers"]

MS = 1_000_000
LATE, SOON = 1.5, 0.75
"""Factors of the event timer and of the inhibit time, with a margin for waiting for the bus."""
STOPPED = 5
"""Event timer periods without the PDO after which it has stopped and is not late."""


class PdoTimers:
    """Compares the intervals of event-driven TPDOs with their event timer and inhibit time."""

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
