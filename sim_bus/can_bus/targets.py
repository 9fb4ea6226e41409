"""Compiled targets of a disturbance or a scripted fault: a station by its number, or several stations."""

from __future__ import annotations

from coulombus.kernels.decorator import inlined

__all__ = ["ALL", "CLIENTS", "CLIENT_ROWS", "NOBODY", "is_meant"]

ALL = -1000
"""Station number for all stations; for a disturbance, the wire."""
CLIENTS = -1001
"""Station number for every client of a bus in real time."""
NOBODY = -2000
CLIENT_ROWS = slice(128, 192)
_CLIENTS_FROM, _CLIENTS_TO = CLIENT_ROWS.start, CLIENT_ROWS.stop


@inlined
def is_meant(station: int, row: int) -> bool:
    """Tell whether a row of the stations is `station`, or a member of that group."""
    if station == ALL:
        return True
    if station == CLIENTS:
        return _CLIENTS_FROM <= row < _CLIENTS_TO
    return station != NOBODY and station & 0xFF == row
