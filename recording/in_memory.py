"""A run's frames in memory, for its figures alone: of a run that nobody wants to keep.

Only the frames of the PDOs that figures are computed from are kept (`recording.measures.MEASURED`):
120 bytes for each cycle of an axis. The figures are those of the recording, but for the rounding of
sums over other blocks (`recording.measures`).
"""

from __future__ import annotations

import numpy as np

from coulombus.compiled.records import joined
from coulombus.recording.measures import MEASURED
from coulombus.recording.pcapng_reader import Capture
from coulombus.recording.recorder import Markers
from coulombus.recording.signals import Recording, decode
from coulombus.rigs.rig import Rig
from coulombus.wire.frame import FRAME, Records

__all__ = ["MeasuredFrames"]

NAME = "a run in memory"


class MeasuredFrames:
    """Takes the frames and markers of a run of `rig`, as a `Recorder` does."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._wanted = sorted(
            {pdo.layout.cob_id for pdo in rig.pdos() if any(signal.key in MEASURED for signal in pdo.signals)}
        )
        self._markers = Markers()
        self._parts: list[Records] = []
        self._comments: list[tuple[int, str]] = []
        self._count = 0

    def mark(self, t_ns: int, text: str) -> None:
        """Let the first frame at or after `t_ns` carry the comment `text`."""
        self._markers.add(t_ns, text)

    def write(self, frames: Records) -> None:
        """Append a batch of frames with rising stamps."""
        frames = frames.view(np.ndarray)  # a plain array answers faster than a recarray
        comments = self._markers.on(frames["t_ns"])
        can_id = np.ascontiguousarray(frames["can_id"])
        kept = np.zeros(len(frames), np.bool_)
        for wanted in self._wanted:  # a few: faster than np.isin
            kept |= can_id == wanted
        kept[list(comments)] = True
        self._comments += [(self._count + int(np.count_nonzero(kept[:row])), text) for row, text in comments.items()]
        self._parts.append(frames.take(np.flatnonzero(kept)))  # frames[kept] copies field by field: ten times as long
        self._count += len(self._parts[-1])

    def recording(self) -> Recording:
        """Return what was taken, decoded."""
        frames = joined(FRAME, self._parts)
        return decode(Capture(NAME, frames, comments=self._comments, attachments={}), self._rig)
