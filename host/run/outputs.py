"""Output files of a run, and whether they may overwrite existing files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from coulombus.host.run.markers import BitMark
from coulombus.recording.segments import Rotation

__all__ = ["Outputs"]


@dataclass(frozen=True)
class Outputs:
    """Output files of a run; None: not written."""

    record: Path | None = None
    """The recording: a file, or with `rotation` a folder of segments."""
    rotation: Rotation | None = None
    """Rule for the end of a segment (`recording.segments`)."""
    meta: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """The user's notes on the recording, which are attached to it."""
    mark_on: tuple[BitMark, ...] = ()
    """Bits of signals that set a marker when they become 1."""
    histogram: Path | None = None
    """Figure of the wake-up and the SYNC-to-RPDO times."""
    status: Path | None = None
    """Path of the status socket (`host.run.status_socket`)."""
    force: bool = False
    """Overwrite existing files at `record` and `histogram`."""
