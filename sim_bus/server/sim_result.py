"""Result of a virtual bus server."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

__all__ = ["SimResult"]


@dataclass
class SimResult:
    """Result of a server."""

    bus: str
    seconds: float = 0.0
    frames: int = 0
    """Number of frames on the bus."""
    clients: int = 0
    """Number of clients that greeted."""
    lost: int = 0
    """Frames that clients missed because they did not read, all clients together."""
    losers: list[dict[str, int]] = field(default_factory=list)
    malformed: int = 0
    unserved: int = 0
    """Requests (SDO, LSS, resets) lost because the nodes had too many to serve."""
    stalls: int = 0
    stalled_s: float = 0.0
    latest_delivery_s: float = 0.0
    wakeups: int = 0
    cpu_s: float = 0.0
    socketcan: dict[str, int] | None = None
    faults: list[dict[str, Any]] | None = None
    """Result of each fault of a fault file."""
    controllers: dict[str, dict[str, Any]] | None = None
    """State and error counters of the nodes' CAN controllers at the end, if there was a fault file."""
    gone: str | None = None
    """Why the bus ended early, or None."""

    @property
    def exit_status(self) -> int:
        """Exit status of the command: 4 if the bus ended early."""
        return 4 if self.gone else 0
