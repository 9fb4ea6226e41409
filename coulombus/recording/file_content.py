"""What a recording's file holds: frames, comments, attachments, and what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coulombus.wire.frame import FRAME, Records

__all__ = ["Capture", "joined"]


def joined(path: str | Path, parts: Sequence[Capture]) -> Capture:
    """Return the content of a file from that of its stretches."""
    first = np.cumsum([0, *(len(part.frames) for part in parts)]).tolist()
    attachments: dict[str, bytes] = {}
    for part in parts:
        attachments |= part.attachments
    return replace(
        parts[-1],
        path=str(path),
        torn=sum(part.torn for part in parts),
        frames=np.concatenate([part.frames for part in parts]),
        comments=[(row + at, text) for row, part in zip(first, parts, strict=False) for at, text in part.comments],
        attachments=attachments,
        skipped=sum(part.skipped for part in parts),
        warnings=tuple(text for part in parts for text in part.warnings),
        inside=np.concatenate([part.inside for part in parts]),
    )


@dataclass(frozen=True)
class Capture:
    """Content of a file or of a stretch of it.

    `frames` are records of `FRAME`: `t_ns` since 1970 (or since the run's start, in virtual time),
    `source` the number of the interface, in the file's order. `comments` are (row of `frames`,
    text).
    """

    path: str
    frames: Records
    comments: list[tuple[int, str]]
    attachments: dict[str, bytes]
    comment: str = ""
    application: str = ""
    hardware: str = ""
    operating_system: str = ""
    torn: int = 0
    """Bytes of an incomplete last block, which are omitted; 0: the file ends with a complete block."""
    skipped: int = 0
    """Packets other than classical CAN frames (other link types, CAN FD, truncated)."""
    warnings: tuple[str, ...] = ()
    """Damaged blocks, packets and attachments, which are omitted."""
    inside: Records = field(default_factory=lambda: np.zeros(0, FRAME))
    """Frames that were on no bus: the host's telemetry (`recording.host_telemetry`)."""
    buses: tuple[str, ...] = ("",)
    """Name of the bus of each `source`, as in the file; "" for an interface without a bus."""
    channels: tuple[str, ...] | None = None
    """The rig's bus of each `source` (`recording.bus_match`); None: the rig's only bus."""

    def part(self, rows: npt.NDArray[np.bool_], inside: npt.NDArray[np.bool_]) -> Capture:
        """Return the content with some of the frames, and of those of the host's telemetry; comments of others are left out."""
        places = np.cumsum(rows) - 1
        comments = [(int(places[row]), text) for row, text in self.comments if rows[row]]
        return replace(self, frames=self.frames[rows], comments=comments, inside=self.inside[inside])

    def frames_on(self, channel: str) -> npt.NDArray[np.bool_]:
        """Return whether each frame was on a bus of the rig."""
        if self.channels is None:
            return np.ones(len(self.frames), bool)
        numbers = [number for number, name in enumerate(self.channels) if name == channel]
        return np.isin(self.frames["source"], numbers)
