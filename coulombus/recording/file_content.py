"""What a recording's file holds: frames, comments, attachments, and what was left out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from coulombus.wire.frame import FRAME, Records

__all__ = ["Capture"]


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

    def frames_on(self, channel: str) -> npt.NDArray[np.bool_]:
        """Return whether each frame was on a bus of the rig."""
        if self.channels is None:
            return np.ones(len(self.frames), bool)
        numbers = [number for number, name in enumerate(self.channels) if name == channel]
        return np.isin(self.frames["source"], numbers)
