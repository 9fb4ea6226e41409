"""A run's recording: frames as they come, the rig and EDS files attached, markers as comments of the frames that follow them."""

from __future__ import annotations

import heapq
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType

import numpy as np

from eds.rig import Rig
from wire.frame import Records
from wire.pcapng import PcapngWriter

__all__ = ["Recorder", "project_version"]


def project_version() -> str:
    """Return the version of this project."""
    try:
        return version("coulombus")
    except PackageNotFoundError:
        return "0+unknown"


class Recorder:
    """Writes frames to a pcapng file; a marker is the comment of the first frame at or after its time.

    Raises
    ------
    wire.pcapng.RecordingError
        the file cannot be written (from the constructor, `write` and `close`); what was written before stays readable
    """

    def __init__(self, path: Path, rig: Rig, mode: str, seed: int | None = None) -> None:
        attachments = {
            "rig.toml": rig.effective().encode(),
            "mode": mode.encode(),
            "version": project_version().encode(),
        }
        if seed is not None:
            attachments["seed"] = str(seed).encode()
        attachments |= {name: text.encode() for name, text in rig.eds_texts.items()}
        self._writer = PcapngWriter(path, attachments=attachments)
        self._markers: list[tuple[int, int, str]] = []
        self._marked = 0

    def mark(self, t_ns: int, text: str) -> None:
        """Let the first frame at or after `t_ns` carry the comment `text`."""
        heapq.heappush(self._markers, (t_ns, self._marked, text))
        self._marked += 1

    def write(self, frames: Records) -> None:
        """Append a batch of frames with rising stamps."""
        comments: dict[int, str] = {}
        while self._markers and self._markers[0][0] <= frames["t_ns"][-1]:
            t_ns, _, text = heapq.heappop(self._markers)
            row = int(np.searchsorted(frames["t_ns"], t_ns))
            comments[row] = f"{comments[row]}\n{text}" if row in comments else text
        self._writer.write(frames, comments)

    def close(self) -> None:
        """Write what is left and close the file."""
        self._writer.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
