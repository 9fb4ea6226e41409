"""Identifiers in the user's notation: ``181``, ``180-1FF``, ``00000123x``.

Numbers are hexadecimal; 8 digits (or x) mean extended.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from coulombus.system.errors import CoulombusError
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_RTR_FLAG

__all__ = ["IdentifierError", "Ranges", "among", "parse_identifiers"]

Ranges = tuple[tuple[int, int], ...]
"""Inclusive ranges of identifiers with CAN_EFF_FLAG."""

_PART = re.compile(r"(0x)?([0-9A-F]+)(X?)", re.I)


class IdentifierError(CoulombusError, ValueError):
    """A text that names no identifiers; the message shows the valid form."""

    exit_status = 2


def parse_identifiers(text: str) -> Ranges:
    """Return the ranges that `text` names, separated by commas.

    Raises
    ------
    IdentifierError
        A part is no identifier, too large, or a range that ends before it begins.
    """
    return tuple(_range(part.strip()) for part in text.split(","))


def _range(part: str) -> tuple[int, int]:
    low, dash, high = part.partition("-")
    first = _number(low, part)
    last = _number(high, part) if dash else first
    if last < first or (first ^ last) & CAN_EFF_FLAG:
        raise IdentifierError(f"identifiers {part!r}: a range goes from a lower to a higher identifier of one length")
    return first, last


def _number(text: str, part: str) -> int:
    match = _PART.fullmatch(text.strip())
    if match is None:
        raise IdentifierError(f"identifiers {part!r}: expected hexadecimal numbers, as in 181,200-27F,00000123x")
    value, extended = int(match[2], 16), bool(match[3]) or len(match[2]) > 3
    if value > (0x1FFFFFFF if extended else 0x7FF):
        raise IdentifierError(
            f"identifiers {part!r}: the highest one is 7FF, extended (more than 3 digits, or x) 1FFFFFFF"
        )
    return value | (CAN_EFF_FLAG if extended else 0)


def among(can_ids: npt.NDArray[np.int64] | Iterable[int], ranges: Ranges) -> npt.NDArray[np.bool_]:
    """Return for each identifier (with flags) whether one of the ranges contains it; the flag of a remote
    frame is ignored.
    """
    bare = np.asarray(can_ids, np.int64) & ~CAN_RTR_FLAG
    inside = np.zeros(bare.shape, bool)
    for low, high in ranges:
        inside |= (bare >= low) & (bare <= high)
    return inside
