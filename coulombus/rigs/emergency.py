"""COB-ID of a node's EMCYs: 1014h of its EDS file (CiA 301, section 7.5.2.17)."""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, restricted
from coulombus.eds.pdo import COB_ID_INVALID
from coulombus.eds.reader import Description
from coulombus.rigs.pdo_records import writable

__all__ = ["emcy_default", "emcy_identifier", "is_mute"]

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
