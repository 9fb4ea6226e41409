"""Whom a disturbance or a scripted fault hits: a station by its number, or more than one
(compiled).
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined

__all__ = ["ALL", "CLIENTS", "CLIENT_ROWS", "NOBODY", "is_meant"]

ALL = -1000
"""As a station: all of them; as that of a disturbance, the wire."""
CLIENTS = -1001
"""As a station: each client of a bus in real time."""
NOBODY = -2000
CLIENT_ROWS = slice(128, 192)
_CLIENTS_FROM, _CLIENTS_TO = CLIENT_ROWS.start, CLIENT_ROWS.stop


@inlined
def is_meant(station: int, row: int) -> bool:
    """Tell whether a row of the stations is `station`, or one of those that it stands for."""
    if station == ALL:
        return True
    if station == CLIENTS:
        return _CLIENTS_FROM <= row < _CLIENTS_TO
    return station != NOBODY and station & 0xFF == row
