"""Constants of all compiled parts of a node: capacities of its record, and two times."""

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
PORTS, INPUTS, OUTPUTS = 8, 16, 8  # largest number of digital ports per direction, analogue inputs, outputs
SPARE_SLOTS = 256  # for objects that a PDO maps later, in addition to the EDS's
MAX_PDOS = 128  # per direction: those of two axes of a drive
MAX_CONSUMERS = 127  # checked entries of 1016h
MAX_SDO_SERVERS = 128  # 1200h to 127Fh
BLOCK_SEGMENTS = 127  # segments in a block of an SDO block transfer
OUTBOX = 1024  # pending segments of block uploads
MAX_HISTORY = 8  # entries of 1003h
EMCY_WAITING = 8  # EMCY messages pending until the end of the inhibit time
FAR_FUTURE_NS = NEVER_NS
SDO_TIMEOUT_NS = 1_000_000_000
"""An SDO transfer without progress for this time is aborted (0504 0000h)."""
