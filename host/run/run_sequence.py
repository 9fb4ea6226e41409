"""Sequence of a run: set up, arm, display, make safe, end.

Virtual time and real time share this sequence, `Course.run`. They differ in the abstract members of `Course`, which
`lab.virtual_course` and `host.run.realtime_sequence` define. The sequence also sets the recording's markers:
``run MODE``, for each axis ``phase KIND`` ... ``phase end``, and at the end ``safe`` or ``trip WHY``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Trip
from coulombus.host.run.result import RunResult, file_sha256
from coulombus.host.run.schedule import PhaseMarks
from coulombus.recording.measures import Measures, measure
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.reading import blocks
from coulombus.recording.recorder import Recorder
from coulombus.wire.clock import NEVER_NS

__all__ = ["SAFE_TIMEOUT_NS", "Course", "Figures"]

SAFE_TIMEOUT_NS = 10_000_000_000
"""Longest wait for the end of the safe state, in addition to the brake's ramp."""


class Figures(NamedTuple):
    """Figures of a run, computed from its recording."""

    each: Sequence[Measures]
    """The display's figures of each axis."""
    sha256: str | None
    """SHA-256 of the recording; None without a recording."""


class Course(ABC):
    """The sequence of one run.

    All times are nanoseconds of the run's own clock, which `now_ns` reads.

    Attributes
    ----------
    controllers : the host's controllers
    path, recorder : path and recorder of the recording; None without a recording
    failure : reason why the recording could not be written, or None
    losses : settings that bring-up left out, each with the protection that the host loses
    """

    def __init__(self, controllers: Controllers, path: Path | None, progress: Callable[[float], None] | None) -> None:
        self.controllers, self.path, self.progress = controllers, path, progress
        self.recorder: Recorder | None = None
        self.failure: str | None = None
        self.losses: tuple[str, ...] = ()
        self.marks = PhaseMarks(controllers.rig)
        self._end_marked = self._trip_marked = False

    def run(self, seconds: float | None) -> RunResult:
        """Set up, arm, display for `seconds` (None: until the run is ended), make safe, end; return the result."""
        try:
            self.losses = self.set_up()
            with self.armed():
                self.display(seconds)
        finally:
            self.end()
        return self.result()

    # the differences of virtual time and real time

    @property
    @abstractmethod
    def now_ns(self) -> int:
        """The present time."""

    @abstractmethod
    def set_up(self) -> tuple[str, ...]:
        """Bring the nodes up, set the marker ``run MODE``; return the losses."""

    @abstractmethod
    def armed(self) -> AbstractContextManager[None]:
        """Return a context that begins the cycle, and at its end makes the rig safe."""

    @abstractmethod
    def advance(self, until_ns: int, done: Callable[[], bool]) -> bool:
        """Advance the run by one supervision step, at most to `until_ns` or until `done`.

        Return False if the run must end.
        """

    @abstractmethod
    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Request the safe state from the host: the normal end, or with the reason `trip`."""

    @abstractmethod
    def end(self) -> None:
        """Leave the nodes, close the recording."""

    @abstractmethod
    def result(self) -> RunResult:
        """Return the result of the run."""

    # display and safe state

    @property
    def starts_ns(self) -> tuple[int | None, ...]:
        """Time at which each axis' drive entered Operation Enabled, which begins its schedule; None before."""
        enabled_ns = (int(controller.host["enabled_ns"][0]) for controller in self.controllers)
        return tuple(None if start < 0 else start for start in enabled_ns)

    @property
    def safe_ns(self) -> int | None:
        """Time at which the first axis entered its safe state; None before."""
        return self.controllers.safe_ns

    @property
    def enabled_ns(self) -> int | None:
        """Time at which the last axis' drive entered Operation Enabled; None before."""
        starts = self.starts_ns
        return None if None in starts else max(start for start in starts if start is not None)

    def display(self, seconds: float | None) -> None:
        """Wait until all axes are armed, then display for `seconds`; None: until the run is ended."""
        arming_ends = self.now_ns + round(2e9 * self.controllers.arming_s)
        while self.enabled_ns is None and self.now_ns < arming_ends and self.advance(arming_ends, self._one_more):
            pass
        enabled = self.enabled_ns
        if enabled is not None:
            display_ends = NEVER_NS if seconds is None else enabled + round(seconds * 1e9)
            while self.now_ns < display_ends and self.advance(display_ends, lambda: self.controllers.ending):
                pass
        self._mark_display_end()

    def make_safe(self) -> None:
        """Request the safe state, and wait until the brakes are ramped off and the drives disabled."""
        self.stop()
        ends = self.now_ns + SAFE_TIMEOUT_NS + round(1e9 * self.controllers.ending_s)
        while not self.controllers.done and self.now_ns < ends:
            self.advance(ends, lambda: self.controllers.done or (self.controllers.safe and not self._end_marked))
        self.mark_end()

    def _one_more(self) -> bool:
        """Return whether a drive is enabled whose schedule has not begun, or an axis is in its safe state."""
        return self.marks.begun < len(self.controllers.each) - self.starts_ns.count(None) or self.controllers.ending

    # markers and recording

    def mark(self, t_ns: int, text: str) -> None:
        """Set a marker in the recording at `t_ns`."""
        if self.recorder is not None:
            self.recorder.mark(t_ns, text)

    def mark_course(self, before_ns: int) -> None:
        """Set the markers of the safe state, and of the schedules' phases that began before `before_ns`.

        Call it before the frames of that time are recorded.
        """
        for axis, start_ns in enumerate(self.starts_ns):
            if start_ns is not None:
                self.marks.begin(axis, start_ns)
        for marker in self.marks.due(min(before_ns, self._shown_ns() + 1)):
            self.mark(*marker)
        if self.safe_ns is not None:
            if self.controllers.trip is not None:  # the trip's marker is the last one
                self._mark_display_end()
            self.mark_end()

    def _mark_display_end(self) -> None:
        for marker in self.marks.end(self._shown_ns()):
            self.mark(*marker)

    def mark_end(self) -> None:
        """Set the marker of the safe state with its reason, once; at the present time if its start is unknown."""
        if self._end_marked:
            return
        self._end_marked = True
        trip, safe_ns = self.controllers.trip, self.safe_ns
        self._trip_marked = trip is not None
        self.mark(self.now_ns if safe_ns is None else safe_ns, f"trip {trip}" if trip else "safe")

    def mark_trip(self) -> None:
        """Set the marker of a trip that `mark_end` did not know. Call it before the recording is closed."""
        trip = self.trip
        if trip is not None and not self._trip_marked:
            self._trip_marked = True
            self.mark(self.now_ns, f"trip {trip}")

    def _shown_ns(self) -> int:
        """Return the end of the display so far: the present time, or the start of the safe state."""
        now_ns, safe_ns = self.now_ns, self.safe_ns
        return now_ns if safe_ns is None else min(now_ns, safe_ns)

    def record(self, write: Callable[[Recorder], None]) -> None:
        """Write to the recording.

        After an error the rig is made safe, and nothing more is written.
        """
        if self.recorder is None or self.failure is not None:
            return
        try:
            write(self.recorder)
        except RecordingError as error:
            self.failure = str(error)
            self.stop(Trip.RECORDING)

    # the result

    @property
    def trip(self) -> str | None:
        """Text of the trip, or None."""
        return self.controllers.trip if self.failure is None else f"RECORDING: {self.failure}"

    def figures(self) -> Figures:
        """Return the display's figures, computed from the recording alone."""
        none = [Measures() for _ in self.controllers]
        if self.path is None or (self.path.exists() and not self.path.is_file()):  # a device, such as /dev/null
            return Figures(none, None)
        try:
            sha256 = file_sha256(self.path)
        except OSError:
            if self.failure is None:
                raise
            return Figures(none, None)
        if self.failure is not None or self.enabled_ns is None:
            return Figures(none, sha256)
        return Figures([measure(axis) for axis in blocks(self.path).axes], sha256)

    def result_of(self, figures: Figures, **fields: Any) -> RunResult:
        """Return the result of the run; `fields`: those that differ between virtual time and a rig."""
        return RunResult.from_controllers(
            self.controllers,
            figures.each,
            record=self.path,
            recording_sha256=figures.sha256,
            trip=self.trip,
            losses=self.losses,
            **fields,
        )
