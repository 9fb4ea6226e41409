"""The host's own words: the markers of a recording of this project."""

from __future__ import annotations

from coulombus.explain.bus import Bus
from coulombus.explain.frames import Block

__all__ = ["HostMarkers"]

TRIP, SAFE, PHASE = "trip ", "safe", "phase "


class HostMarkers:
    """Reads trips and ordered ends from the comments; what was injected there is not read."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues

    def take(self, block: Block) -> None:
        """Go through a block."""
        for row, text in block.comments:
            at = min(row, len(block.t_ns) - 1)
            t_ns = int(block.t_ns[at]) if at >= 0 else self.bus.last_ns
            for line in text.splitlines():
                plain = line.partition(".")[2] if "." in line.split(" ")[0] else line
                if line.startswith(TRIP):
                    self.bus.tripped = True
                    self.clues.begin("host_trip", None, t_ns, line.removeprefix(TRIP), row=block.first_row + max(at, 0))
                elif line == SAFE:
                    self.bus.safe_ns = t_ns
                elif plain.startswith(PHASE) and plain != "phase end":
                    self.clues.end("host_trip", None, t_ns, "it displays again")
