"""What all compiled parts of a node share: the room in its record, and two times."""

from __future__ import annotations

from coulombus.wire.clock import NEVER_NS

__all__ = [
    "BLOCK_SEGMENTS",
    "EMCY_WAITING",
    "FAR_FUTURE_NS",
    "INPUTS",
    "MAX_CONSUMERS",
    "MAX_HISTORY",
    "MAX_PDOS",
    "MAX_SDO_SERVERS",
    "OUTBOX",
    "OUTPUTS",
    "PORTS",
    "SDO_TIMEOUT_NS",
    "SLOTS",
    "SPARE_SLOTS",
]

SLOTS = 1024
PORTS, INPUTS, OUTPUTS = 8, 16, 8  # at most: digital ports of each direction, analogue inputs and outputs
SPARE_SLOTS = 256  # for objects that a PDO maps later, however many the EDS describes
MAX_PDOS = 128  # of each direction: those of two axes of a drive
MAX_CONSUMERS = 127  # entries of 1016h that are watched
MAX_SDO_SERVERS = 128  # 1200h to 127Fh
BLOCK_SEGMENTS = 127  # most segments of a block of an SDO block transfer
OUTBOX = 1024  # segments of block uploads that wait to be sent
MAX_HISTORY = 8  # entries of 1003h
EMCY_WAITING = 8  # EMCY messages that wait for the end of the inhibit time
FAR_FUTURE_NS = NEVER_NS
SDO_TIMEOUT_NS = 1_000_000_000
"""An SDO transfer that stands still for so long is aborted (0504 0000h)."""
