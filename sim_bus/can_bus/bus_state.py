"""What the wire is in the midst of, and the lengths in bit times that all modules of the bus count
with.

::

    FREE ---> FRAME ------------------------------> FREE     a frame: its length is all there is to know of it
    FREE ---> WATCHED ----------------------------> FREE     a frame that passes; at its end the counters' rules g and h apply
    FREE ---> TELLING ----------------------------> FREE     nobody sends; a controller has recovered, which is told
    FREE ---> PLAYED ---> TOLD ---> PLAYED ... OVER ---> FREE   slow motion

`BusRecord.stage` is written by who begins something (`arbiter.start_frame`, `error_path.attempt`),
by `bit_level.run_bits`, and at each end (`BusRecord.end_ns`) by `arbiter.end_frame` or
`frame_result.end_attempt`.
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["INTER_FRAME_BITS", "NS", "RUN_BITS", "SUSPEND_BITS", "Delivered", "ErrorKind", "Stage"]

INTER_FRAME_BITS = 3
"""The intermission."""
SUSPEND_BITS = 8
"""So much longer an error-passive sender waits."""
RUN_BITS = 11
"""Recessive: the end of a frame or of an error frame, with the inter-frame space.

Bus-off ends after 128 such runs.
"""
NS = 1_000_000_000


class Stage(IntEnum):
    """What the wire is in the midst of up to `end_ns`."""

    FREE = 0
    FRAME = 1
    WATCHED = 2
    TELLING = 3
    PLAYED = 4  # bits were played up to `end_ns`, where what came of them is told
    TOLD = 5  # that has been told, and the next bits are to be played
    OVER = 6  # as PLAYED; behind the last bit somebody may begin to send


class Delivered(IntEnum):
    """Who has what has just ended."""

    NOBODY = 0  # it is no frame
    OTHERS = 1  # all but its sender
    HEARERS = 2  # those whose controller has `hears`


class ErrorKind(IntEnum):
    """The five errors of the standard (10.11)."""

    BIT = 0
    STUFF = 1
    CRC = 2
    FORM = 3
    ACK = 4
