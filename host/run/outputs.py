"""What a run leaves behind: where, and whether it may replace what stands there."""

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
    """What a run writes; None: it does not."""

    record: Path | None = None
    """The recording: a file, or with `rotation` a folder of segments."""
    rotation: Rotation | None = None
    """When a segment ends (`recording.segments`)."""
    meta: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """What a person says of the recording; it is attached."""
    mark_on: tuple[BitMark, ...] = ()
    """Bits of signals that set a marker when they become 1."""
    histogram: Path | None = None
    """A picture of the wake-up and the SYNC-to-RPDO times."""
    status: Path | None = None
    """A socket is made there that tells the run's state (`host.run.status_socket`)."""
    force: bool = False
    """Replace `record` and `histogram` where they exist."""
