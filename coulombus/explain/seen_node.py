"""State of a node from the frames of a log."""

from __future__ import annotations

import bisect
from array import array
from dataclasses import dataclass, field

import numpy as np

from coulombus.explain.frames import Integers
from coulombus.recording.maps.seen_maps import MappedNode

__all__ = ["SeenNode", "Spread"]


class Spread:
    """Minimum, median and maximum of values; beyond `MOST` of them, the median is of each second, fourth ... one."""

    MOST = 8192

    def __init__(self) -> None:
        self.count, self._step, self._values = 0, 1, array("q")
        self._least, self._most, self.total = 0, 0, 0

    def add(self, value: int) -> None:
        """Add a value."""
        self._least = min(self._least, value) if self.count else value
        self._most = max(self._most, value) if self.count else value
        if self.count % self._step == 0:
            self._values.append(value)
            if len(self._values) > self.MOST:
                self._values, self._step = self._values[::2], 2 * self._step
        self.count += 1
        self.total += value

    @property
    def figures(self) -> tuple[int, float, int] | None:
        """Minimum, median, maximum; None without a value."""
        return (
            (self._least, float(np.median(np.frombuffer(self._values, np.int64))), self._most) if self.count else None
        )


@dataclass
class SeenNode(MappedNode):
    """State of a node from its frames; stamps are ns, -1 if none."""

    first_ns: int
    last_ns: int
    state: int = -1  # of the last heartbeat; -1: unknown
    was_operational: bool = False
    always_operational: bool = True  # every heartbeat says so
    heartbeat_ns: int = -1  # the last one; -1: none since it booted
    heartbeat_row: int = -1
    reset_ns: int = -1  # the first reset command without a boot-up since
    reset_alone: bool = False  # it went to this node only
    program_ns: int = -1  # the last command to its program (1F51h)
    program_starts: bool = False  # that command starts it, and no boot-up came since
    life_ns: int = -1  # the last EMCY about a heartbeat or guarding that it misses
    period_ns: int = 0  # of heartbeats; 0: unknown
    last_gap_ns: int = 0
    gaps: list[int] = field(default_factory=list)
    learned_ns: int = -1  # time at which the period was learned
    states: list[tuple[int, int]] = field(default_factory=list)
    """NMT state, from each time [ns] of a change."""
    flips: list[int] = field(default_factory=list)
    """Times [ns] of the last successive heartbeats that each changed its state."""
    boots: int = 0
    emergencies: int = 0
    transfers: int = 0
    intervals: Spread = field(default_factory=Spread)
    """Intervals of its heartbeats [ns]."""
    sdo_response: Spread = field(default_factory=Spread)
    """Times [ns] from an SDO request to its response."""
    booted_ns: int = -1

    @property
    def produces_sync(self) -> bool:
        """Whether 1005h (COB-ID SYNC), as it was written or read last, has bit 30."""
        return bool(self.objects.get((0x1005, 0), 0) >> 30 & 1)

    @property
    def since_ns(self) -> int:
        """Time [ns] since which it is there: its boot-up, else its first frame."""
        return max(self.first_ns, self.booted_ns)

    def state_at(self, t_ns: int) -> int:
        """Return the NMT state at a time [ns], -1 if unknown."""
        place = bisect.bisect_right(self.states, t_ns, key=lambda change: change[0])
        return self.states[place - 1][1] if place else -1

    def was(self, state: int, t_ns: int) -> bool:
        """Return whether it was in a state before a time [ns]."""
        return 0 <= self.since(state) <= t_ns

    def states_at(self, t_ns: Integers) -> Integers:
        """Return the NMT state at each of these times [ns], -1 if unknown."""
        times = np.array([since for since, _ in self.states], np.int64)
        states = np.array([-1, *(state for _, state in self.states)], np.int64)
        return states[times.searchsorted(t_ns, "right")]

    def since(self, state: int) -> int:
        """Return the first time [ns] of a state, -1 if none."""
        return next((t_ns for t_ns, entered in self.states if entered == state), -1)

    def change_beat(self, t_ns: int, period_ns: int) -> None:
        """Wait for heartbeats of another period from a time [ns] on; 0: for none."""
        if self.heartbeat_ns < 0:
            self.heartbeat_row = -1  # none came yet
        self.heartbeat_ns = max(self.heartbeat_ns, t_ns) if period_ns else -1
        self.period_ns, self.learned_ns = period_ns, t_ns
        self.gaps.clear()

    def enter(self, t_ns: int, state: int) -> None:
        """Note the NMT state at a time [ns]."""
        if state != self.state:
            self.states.append((t_ns, state))
        self.state = state
