"""Node guarding by the host (CiA 301, section 7.2.8.3.2.1).

It guards nodes that cannot consume its heartbeat, or produce none.
"""

from __future__ import annotations

from coulombus.eds.reader import Description

__all__ = ["beats", "is_guarded", "life_of"]


def is_guarded(description: Description) -> bool:
    """Return whether a node is guarded: it has no heartbeat or no consumer, but guard time and life time factor."""
    by_heartbeat = description.has(0x1016, 1) and description.has(0x1017, 0)
    return not by_heartbeat and description.has(0x100C, 0) and description.has(0x100D, 0)


def beats(description: Description) -> bool:
    """Return whether the host can monitor a node: by heartbeat or guarding."""
    return description.has(0x1017, 0) or is_guarded(description)


def life_of(guard_s: float, timeout_s: float) -> tuple[int, int]:
    """Return guard time (100Ch) [ms] and life time factor (100Dh): the least life time not below `timeout_s`. Both
    times are whole milliseconds.
    """
    guard_ms, timeout_ms = round(guard_s * 1000), round(timeout_s * 1000)
    return guard_ms, -(-timeout_ms // guard_ms)
