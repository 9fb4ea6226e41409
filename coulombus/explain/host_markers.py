"""The host's reports in a coulombus recording: its markers, and its telemetry of each cycle."""

from __future__ import annotations

from collections import Counter

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import Block
from coulombus.kernels.records import Records
from coulombus.recording.host_telemetry import FIRST, PER_AXIS, PHASE_RUN, Limit
from coulombus.wire.frame import FRAME

__all__ = ["HostMarkers"]

RUN, TRIP, SAFE, PHASE = "run ", "trip ", "safe", "phase "
BEFORE_NS, KEPT_NS = 1_000_000_000, 5_000_000_000
"""Time before a trip within which the host's telemetry may explain it; length of the kept telemetry."""
WORDS = {
    Limit.TORQUE_CLIPPED: "torque clipped",
    Limit.TORQUE_SLOWED: "torque held back by rate or speed limit",
    Limit.BY_DRIVE: "the drive told of a limit",
    Limit.SETPOINT_CLIPPED: "brake set-point clipped",
    Limit.SETPOINT_NEGATIVE: "brake set-point negative",
    Limit.COMPENSATION_WITHHELD: "compensation withheld",
    Limit.TPDO_MISSED: "TPDO missed",
    Limit.DEADMAN_OPEN: "dead-man open",
}
"""Active limits of a cycle, as texts."""


class HostMarkers:
    """Reads trips and ordered ends from the comments; markers of injected faults are ignored.

    `take_inside` gets the host's telemetry (`recording.host_telemetry`) before the frames of the same time.
    """

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._inside: Records = np.zeros(0, FRAME)

    def take_inside(self, inside: Records) -> None:
        """Keep the host's latest telemetry: phase, trip and limits of each axis."""
        heads = inside[(inside["can_id"] - FIRST) % PER_AXIS == 0]
        if len(heads):
            recent = np.concatenate((self._inside, heads))
            self._inside = recent[recent["t_ns"] > recent["t_ns"][-1] - KEPT_NS]

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for row, text in block.comments:
            at = min(row, len(block.t_ns) - 1)
            t_ns = int(block.t_ns[at]) if at >= 0 else self.bus.last_ns
            for line in text.splitlines():
                self.mark(t_ns, line, block.first_row + max(at, 0))

    def mark(self, t_ns: int, line: str, row: int) -> None:
        """Process a marker; `row` is the frame that shows it."""
        plain = line.partition(".")[2] if "." in line.split(" ")[0] else line
        self.bus.host_runs |= line.startswith(RUN)
        if line.startswith(TRIP) or line == SAFE:
            self.bus.host_runs = False
        if line.startswith(TRIP):
            self.bus.tripped = True
            self._trip(t_ns, line.removeprefix(TRIP), row)
        elif line == SAFE:
            self.bus.safe_ns = t_ns
        elif plain.startswith(PHASE) and plain != "phase end":
            self.clues.end("host_trip", None, t_ns, "it displays again")

    def _trip(self, t_ns: int, text: str, row: int) -> None:
        inside = self._inside
        near = inside[(inside["t_ns"] >= t_ns - BEFORE_NS) & (inside["t_ns"] <= t_ns + BEFORE_NS)]
        word = np.ascontiguousarray(near["word"]).astype(np.int64)
        tripped = np.flatnonzero(word >> 8 & 0xFF)
        if len(tripped):  # the marker comes at the end of the cycle: the axis' telemetry has the first trip
            first = int(tripped[0])
            axis = (int(near["can_id"][first]) - FIRST) // PER_AXIS + 1
            earlier = word[:first][near["can_id"][:first] == near["can_id"][first]]
            phase = int(earlier[-1] & 0xFF) if len(earlier) else -1
            text += f"; first doubt of axis {axis}" + (" while it displayed" if phase == PHASE_RUN else "")
            counts = Counter({limit: int((earlier >> 16 & limit != 0).sum()) for limit in WORDS})
            acted = [f"{WORDS[limit]} in {count}" for limit, count in counts.most_common(3) if count]
            if acted:
                text += f"; in the {len(earlier)} cycles before: {', '.join(acted)}"
        self.clues.begin("host_trip", None, t_ns, text, row=row)
