"""What a recording's file holds: frames, comments, attachments, and remarks on what was left out."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records
from coulombus.recording.folders import segments_of
from coulombus.recording.pcapng_blocks import attachment_block
from coulombus.wire.frame import FRAME

__all__ = ["HOST", "LATE", "UNSURE", "Capture", "append_late", "joined", "pack_late", "remarks_on", "unpack_late"]

HOST = "host."
"""Prefix of attachments that only the host's replay reads: many, and not text."""
LATE = "markers"
"""Attachment with the markers after which no frame follows."""
UNSURE = "unsure "
"""Prefix of the names of positions that may have wrapped unseen in a gap."""


def pack_late(markers: Sequence[tuple[int, str]]) -> bytes:
    """Return the content of the attachment `LATE`: a JSON list of [stamp in ns, text]."""
    return json.dumps(markers).encode()


def append_late(path: Path, markers: Sequence[tuple[int, str]]) -> None:
    """Append the attachment `LATE` to a recording whose writer has ended.

    Parameters
    ----------
    path : the recording, or a run's folder: then its newest segment

    Raises
    ------
    OSError
        the recording is not there, or cannot be written
    """
    paths = segments_of(path) if path.is_dir() else [path]
    fd = os.open(paths[-1] if paths else path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        os.write(fd, attachment_block(LATE, pack_late(markers)))
    finally:
        os.close(fd)


def unpack_late(content: bytes) -> list[tuple[int, str]]:
    """Return the markers of an attachment `LATE`.

    Raises
    ------
    ValueError
        the content has another form
    """
    try:
        markers = [(t_ns, text) for t_ns, text in json.loads(content)]
    except (TypeError, RecursionError) as error:
        raise ValueError(str(error)) from None
    if not all(type(t_ns) is int and abs(t_ns) < 1 << 63 and isinstance(text, str) for t_ns, text in markers):
        raise ValueError("a marker is not a stamp of 64 bits and a text")
    return markers


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
        late=tuple(marker for part in parts for marker in part.late),
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
    late: tuple[tuple[int, str], ...] = ()
    """Markers after which no frame follows: stamp like the frames', and text."""
    origin_ns: int | None = None
    """Time 0 of the file, which all its buses share; None: that of these frames."""

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


def remarks_on(path: str, warnings: Iterable[str], left_out: Counter[str]) -> tuple[str, ...]:
    """Return the remarks: the file's warnings, and omitted data."""
    texts = {
        "torn": "the last block is unfinished: {} bytes were left out",
        "skipped": "{} packets are no classical CAN frames and were left out",
    }

    def text(name: str) -> str:
        if name.startswith(UNSURE):
            return (
                f"{name.removeprefix(UNSURE)} has {{}} gaps that are longer than its counter can be followed "
                "(limits.encoder_jump_counts); after them it may be wrong by whole wraps"
            )
        return texts.get(name, f"{{}} frames of {name} have a wrong length")

    return (*warnings, *(f"{path}: {text(name).format(n)}" for name, n in left_out.items() if n))
