"""Recording of a live run: its start by the wall clock, and the data plane's log in the order of the stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.host.laws.law_source import law_attachments
from coulombus.host.run.markers import BitMarks
from coulombus.host.run.run import Run
from coulombus.kernels.records import Records
from coulombus.recording.host_telemetry import SOURCE_INSIDE
from coulombus.recording.recorder import About, Recorder
from coulombus.recording.segments import SegmentedRecorder
from coulombus.recording.wall_clock import meta_attachment, wall_clock
from coulombus.wire.frame import stations_of

__all__ = ["Batch", "StampOrder", "begin_recording"]

HOLD_BACK_NS = 50_000_000  # frames enter the log slightly out of order; younger ones wait for the next batch


def begin_recording(run: Run, k: Controllers, zero_ns: int | None = None) -> Recorder | None:
    """Begin the recording of a run, or of its part on the bus of the controllers `k`; None if none is wanted.

    `zero_ns`, of CLOCK_MONOTONIC, is time 0 of the recording, and the recording contains the wall clock's
    time at this instant; None: virtual time.

    Raises
    ------
    coulombus.recording.pcapng_blocks.RecordingError
        the file exists, or cannot be created
    """
    outputs, rig = run.outputs, k.rig
    path = outputs.record
    if path is None:
        return None
    started_ns, more, comment = 0, run.attachments(rig), ""
    if zero_ns is not None:
        started_ns, clock, comment = wall_clock(zero_ns)
        more |= clock | meta_attachment(outputs.meta)
    about = About(
        law=law_attachments(rig),
        law_state=k.each[0].law_state,
        more=more,
        comment=comment,
        started_ns=started_ns,
    )
    if outputs.rotation is None:
        return Recorder(path, rig, run.mode, run.seed if run.virtual else None, about=about, force=outputs.force)
    return SegmentedRecorder(path, rig, run.mode, outputs.rotation, about)


@dataclass(frozen=True)
class Batch:
    """Frames in the order of their stamps, and the host's trace of its cycles."""

    frames: Records
    rows: Records
    last: bool
    """Whether this is the last batch, after which the recording is closed."""

    def write(self, recorder: Recorder, bits: BitMarks) -> None:
        """Write the batch, with the markers that `bits` finds in it.

        Raises
        ------
        coulombus.recording.pcapng_blocks.RecordingError
            the recording cannot be written
        """
        of_bus = self.frames["source"] != SOURCE_INSIDE
        if len(self.frames):
            for t_ns, marker in bits.edges(self.frames[of_bus]):
                recorder.mark(t_ns, marker)
            recorder.write(self.frames)
        if len(self.frames) or len(self.rows):
            recorder.trace(stations_of(self.frames[of_bus]) == SOURCE_HOST, self.rows)
        if self.last:
            recorder.close()


class StampOrder:
    """Sorts the data plane's log by the stamps.

    Parameters
    ----------
    zero_ns : time 0 of the recording, of CLOCK_MONOTONIC
    """

    def __init__(self, zero_ns: int) -> None:
        self._zero_ns = zero_ns
        self._waiting: Records | None = None

    def batch(self, frames: Records, rows: Records, seen_ns: int | None) -> Batch:
        """Return the frames that are older than every frame still to come.

        Frames of the last `HOLD_BACK_NS` before `seen_ns` wait for the next batch; with None, no frame
        waits. The times of `frames` and `rows` are converted to the recording's time, in place.
        """
        frames["t_ns"] -= self._zero_ns
        rows["t_ns"] -= self._zero_ns
        if self._waiting is not None:
            frames = np.concatenate((self._waiting, frames)).view(np.recarray)
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        ready = len(frames)
        if seen_ns is not None:
            ready = int(np.searchsorted(frames["t_ns"], seen_ns - self._zero_ns - HOLD_BACK_NS))
        self._waiting = frames[ready:]
        return Batch(frames[:ready], rows, seen_ns is None)
