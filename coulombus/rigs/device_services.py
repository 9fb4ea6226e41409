"""EMCY and error control of a device, from its EDS file.

The COB-ID of its EMCYs is 1014h (CiA 301, section 7.5.2.17). The host guards nodes that cannot consume its heartbeat, or
produce none (section 7.2.8.3.2.1).
"""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, restricted
from coulombus.eds.pdo import COB_ID_INVALID
from coulombus.eds.reader import Description
from coulombus.rigs.pdo_records import writable

__all__ = ["beats", "emcy_default", "emcy_identifier", "is_guarded", "is_mute", "life_of"]


_EXTENDED = 1 << 29


def emcy_default(description: Description, node_id: int) -> int | None:
    """Return the default of 1014h, or None."""
    default = description.default(0x1014, 0, node_id) if description.has(0x1014, 0) else None
    return default if isinstance(default, int) else None


def emcy_identifier(description: Description, node_id: int) -> int:
    """Return the identifier under which the node is to send its EMCYs.

    It is the file's if valid, of 11 bits and not used by another service; else that of the pre-defined connection set,
    which bring-up writes.
    """
    usual, default = CobId.EMCY + node_id, emcy_default(description, node_id)
    if default is None or default & (COB_ID_INVALID | _EXTENDED) or default == CobId.SYNC:
        return usual
    described = default & 0x7FF
    return described if described == usual or (described and not restricted(described)) else usual


def is_mute(description: Description, node_id: int) -> bool:
    """Return whether the node cannot send EMCYs: 1014h is absent, or disabled and read-only."""
    if not description.has(0x1014, 0):
        return True
    default = emcy_default(description, node_id)
    off = default is not None and (default & COB_ID_INVALID or not default & 0x7FF)
    return bool(off) and not writable(description.variable(0x1014, 0))


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
