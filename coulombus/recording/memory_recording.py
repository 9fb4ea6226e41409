"""In-memory recording: only what the figures need.

Only stamps and data words of the PDOs with figures (`recording.measures.MEASURED`) are kept: 48
bytes per cycle of an axis. The figures equal those of a file, except for rounding of sums over
other blocks (`recording.measures`).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records, new_records
from coulombus.recording.block import Block, markers_of
from coulombus.recording.file_content import Capture
from coulombus.recording.measures import MEASURED
from coulombus.recording.pdo_columns import Series, signals_of
from coulombus.recording.recorder import Markers
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.wire.frame import Frame

__all__ = ["MeasuredFrames"]

NAME = "a run in memory"
Integers: TypeAlias = npt.NDArray[np.int64]


class MeasuredFrames:
    """Collects the frames and markers of a run of `rig`, like a `Recorder`."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._came: dict[int, tuple[RigPdo, list[Integers], list[Integers]]] = {
            pdo.layout.cob_id: (pdo, [], [])
            for pdo in rig.pdos()
            if any(signal.key in MEASURED for signal in pdo.signals)
        }
        """By identifier: the PDO, and the stamps and data words of its frames per batch."""
        self._waiting = Markers()
        self._markers: list[tuple[float, str]] = []

    def mark(self, t_ns: int, text: str) -> None:
        """Attach the comment `text` to the first frame at or after `t_ns`."""
        self._waiting.add(t_ns, text)

    def write(self, frames: Records) -> None:
        """Append a batch of frames with rising stamps."""
        frames = frames.view(np.ndarray)  # a recarray looks each field up in Python
        t_ns, can_id = frames["t_ns"], np.ascontiguousarray(frames["can_id"])
        for row, text in self._waiting.on(t_ns).items():
            self._markers += [(float(t_ns[row] / 1e9), line) for line in text.splitlines()]
        for cob_id, (pdo, stamps, words) in self._came.items():
            rows = np.flatnonzero(can_id == cob_id)
            rows = rows[frames["length"][rows] == pdo.layout.length]
            stamps.append(t_ns[rows])
            words.append(frames["word"][rows])

    def recordings(self) -> tuple[Block, ...]:
        """Return each axis' view (`Recording.axes`): the measured signals and the markers, without frames."""
        names = self._rig.axis_names
        rigs = [self._rig.alone(name) for name in names] or [self._rig]
        return tuple(self._seen(name, rig) for name, rig in zip(names or ("",), rigs, strict=True))

    def _seen(self, axis: str, rig: Rig) -> Block:
        signals = {}
        for pdo in rig.pdos():
            if pdo.layout.cob_id in self._came:
                _, *parts = self._came[pdo.layout.cob_id]
                t_ns, words = (np.concatenate([np.zeros(0, np.int64), *arrays]) for arrays in parts)
                t_s = t_ns / 1e9
                for signal, values in signals_of(pdo, words, t_ns, rig, {}, MEASURED)[0]:
                    signals[signal.name] = Series(t_s, values, signal.unit)
        return Block(
            path=NAME,
            known_rig=rig,
            capture=Capture(NAME, new_records(Frame, 0), comments=[], attachments={}),
            epoch_ns=0,
            tables=(),
            signals=signals,
            markers=markers_of(axis, self._rig, self._markers) if axis else self._markers,
            malformed={},
            before={},
        )
