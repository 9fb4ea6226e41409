"""recvmsg ancillary data: SO_TIMESTAMPNS and SO_RXQ_OVFL.

Python has no names for these. A control message is a length, a level and a type, and its data; read
as 64-bit words, the second word is level and type (``STAMP``, ``OVERFLOW``).
"""

from __future__ import annotations

import socket

__all__ = ["CONTROL_WORDS", "OVERFLOW", "SECOND_NS", "SO_RXQ_OVFL", "SO_TIMESTAMPNS", "STAMP", "STAMP_NEW"]

SO_TIMESTAMPNS = 35
"""Socket option and control message: struct timespec of CLOCK_REALTIME."""
SO_RXQ_OVFL = 40
"""Socket option and control message: number of frames that this socket's queue has dropped so far."""

CONTROL_WORDS = 16
"""Size of the buffer for one message's control messages, in 64-bit words."""
STAMP = socket.SOL_SOCKET | SO_TIMESTAMPNS << 32
STAMP_NEW = socket.SOL_SOCKET | 64 << 32  # SO_TIMESTAMPNS_NEW, with the same contents on a 64-bit system
OVERFLOW = socket.SOL_SOCKET | SO_RXQ_OVFL << 32
SECOND_NS = 1_000_000_000
