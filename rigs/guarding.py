"""Which nodes the host guards: those that cannot watch its heartbeat, or have none of their own
(CiA 301, section 7.2.8.3.2.1).
"""

from __future__ import annotations

from coulombus.eds.reader import Description

__all__ = ["beats", "is_guarded"]


def is_guarded(description: Description) -> bool:
    """Tell whether a node is guarded by remote frames: it lacks a heartbeat or its consumer, and
    has guard time and life time factor.
    """
    by_heartbeat = description.has(0x1016, 1) and description.has(0x1017, 0)
    return not by_heartbeat and description.has(0x100C, 0) and description.has(0x100D, 0)


def beats(description: Description) -> bool:
    """Tell whether the host hears from a node at all: by its heartbeat, or as it is guarded."""
    return description.has(0x1017, 0) or is_guarded(description)
