"""The course of a run: arming, display, safe end, and what came of it.

It is the same in virtual time and against the wall clock. `lab.simulate` and `host.run.real_run`
say what time is and how it passes; what is done in it, and in which order, stands here. The
recording's markers are made here, too: for each axis ``phase KIND`` ... ``phase end``, and at last
``safe`` or ``trip WHY``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
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

__all__ = ["SAFE_TIMEOUT_NS", "Course", "Figures"]

FOREVER_NS = 1 << 62

SAFE_TIMEOUT_NS = 10_000_000_000
"""How long the safe state is waited for, beside the brake's ramp."""


class Figures(NamedTuple):
    """What a recording tells of a run."""

    each: Sequence[Measures]
    """The display's figures of each axis."""
    sha256: str | None
    """Of the recording; None where there is none."""


class Course(ABC):
    """The course of one run.

    All times are nanoseconds of the run's own clock, which `now_ns` reads.

    Attributes
    ----------
    k : the host's controllers
    path, recorder : of the recording; None where nothing is recorded
    failure : why the recording could not be written, None while it could
    losses : what bring-up left out, and what the host loses by that
    """

    def __init__(self, k: Controllers, path: Path | None, progress: Callable[[float], None] | None) -> None:
        self.k, self.path, self.progress = k, path, progress
        self.recorder: Recorder | None = None
        self.failure: str | None = None
        self.losses: tuple[str, ...] = ()
        self.marks = PhaseMarks(k.rig)
        self._end_marked = False

    # what time is, and what the run is on

    @property
    @abstractmethod
    def now_ns(self) -> int:
        """The present time."""

    @property
    def starts_ns(self) -> tuple[int | None, ...]:
        """When each axis' drive entered Operation Enabled, which begins its schedule; None while it
        has not.
        """
        enabled_ns = (int(controller.host["enabled_ns"][0]) for controller in self.k)
        return tuple(None if start < 0 else start for start in enabled_ns)

    @property
    def safe_ns(self) -> int | None:
        """When the first axis entered its safe state; None while none has."""
        return self.k.safe_ns

    @abstractmethod
    def look(self, until_ns: int, done: Callable[[], bool]) -> bool:
        """Let a little time pass, at most to `until_ns` or until `done`, and look after the run
        once; return False when it is to end.
        """

    @abstractmethod
    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Ask the host for the safe state: the normal end, or for the reason `trip`."""

    # the course

    @property
    def enabled_ns(self) -> int | None:
        """When the last axis' drive entered Operation Enabled; None while one has not."""
        starts = self.starts_ns
        return None if None in starts else max(start for start in starts if start is not None)

    def display(self, seconds: float | None) -> None:
        """Wait until all axes are armed, and display for `seconds` from then on; None: until
        something ends it.
        """
        arming_ends = self.now_ns + round(2e9 * self.k.arming_s)
        while self.enabled_ns is None and self.now_ns < arming_ends and self.look(arming_ends, self._one_more):
            pass
        enabled = self.enabled_ns
        if enabled is not None:
            display_ends = FOREVER_NS if seconds is None else enabled + round(seconds * 1e9)
            while self.now_ns < display_ends and self.look(display_ends, lambda: self.k.ending):
                pass
        for marker in self.marks.end(self._shown_ns()):
            self.mark(*marker)

    def make_safe(self) -> None:
        """Ask for the safe state, and wait until the brakes are ramped off and the drives
        disabled.
        """
        self.stop()
        ends = self.now_ns + SAFE_TIMEOUT_NS + round(1e9 * self.k.ending_s)
        while not self.k.done and self.now_ns < ends:
            self.look(ends, lambda: self.k.done or (self.k.safe and not self._end_marked))
        self.mark_end()

    def _one_more(self) -> bool:
        """Tell whether a drive has been enabled whose schedule has not begun, or the arming has
        ended.
        """
        return self.marks.begun < len(self.k.each) - self.starts_ns.count(None) or self.k.ending

    # markers and recording

    def mark(self, t_ns: int, text: str) -> None:
        """Mark the recording at `t_ns`."""
        if self.recorder is not None:
            self.recorder.mark(t_ns, text)

    def mark_course(self, before_ns: int) -> None:
        """Mark the phases that began before `before_ns`, each axis' from its own start, and the
        safe state.

        To be called before the frames of that time are recorded.
        """
        for axis, start_ns in enumerate(self.starts_ns):
            if start_ns is not None:
                self.marks.begin(axis, start_ns)
        for marker in self.marks.due(min(before_ns, self._shown_ns() + 1)):
            self.mark(*marker)
        if self.safe_ns is not None:
            self.mark_end()

    def mark_end(self) -> None:
        """Mark when the safe state began - now, where it is not known - and why; once."""
        if self._end_marked:
            return
        self._end_marked = True
        trip, safe_ns = self.k.trip, self.safe_ns
        self.mark(self.now_ns if safe_ns is None else safe_ns, f"trip {trip}" if trip else "safe")

    def _shown_ns(self) -> int:
        """Return until when there is, or was, something to display: until now, or until the safe
        state began.
        """
        now_ns, safe_ns = self.now_ns, self.safe_ns
        return now_ns if safe_ns is None else min(now_ns, safe_ns)

    def record(self, write: Callable[[Recorder], None]) -> None:
        """Write to the recording.

        Where that fails, the rig is made safe, and nothing more is written.
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
        """Why the run ended in its safe state, in words; None when it was not for a trip."""
        return self.k.trip if self.failure is None else f"RECORDING: {self.failure}"

    def figures(self) -> Figures:
        """Return the display's figures, computed from the recording alone."""
        none = [Measures() for _ in self.k]
        if self.path is None or (self.path.exists() and not self.path.is_file()):  # a device, such as /dev/null
            return Figures(none, None)
        sha256 = file_sha256(self.path)
        if self.failure is not None or self.enabled_ns is None:
            return Figures(none, sha256)
        return Figures([measure(axis) for axis in blocks(self.path).axes], sha256)

    def result_of(self, figures: Figures, **own: Any) -> RunResult:
        """Return what the run came to; `own` are the fields of `RunResult` that virtual time and a
        rig do not have alike.
        """
        return RunResult.of(
            self.k,
            figures.each,
            record=self.path,
            recording_sha256=figures.sha256,
            trip=self.trip,
            losses=self.losses,
            **own,
        )
