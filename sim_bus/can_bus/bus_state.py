"""States of the bus, and the lengths in bit times that all modules of the bus use.

::

    FREE ---> FRAME ------------------------------> FREE     a frame: only its length matters
    FREE ---> WATCHED ----------------------------> FREE     an undisturbed frame; its end applies rules g and h
    FREE ---> TELLING ----------------------------> FREE     nobody sends; the recovery of a controller is reported
    FREE ---> PLAYED ---> TOLD ---> PLAYED ... OVER ---> FREE   bit-level simulation

`BusRecord.stage` is written at each start (`arbiter.start_frame`, `error_path.attempt`), by
`bit_level.run_bits`, and at each end (`BusRecord.end_ns`) by `arbiter.end_frame` or
`frame_result.end_attempt`.
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["INTER_FRAME_BITS", "NS", "RUN_BITS", "SUSPEND_BITS", "Delivered", "ErrorKind", "Stage"]

INTER_FRAME_BITS = 3
"""Length of the intermission."""
SUSPEND_BITS = 8
"""Additional waiting time of an error-passive sender."""
RUN_BITS = 11
"""Recessive bits at the end of a frame or of an error frame, with the inter-frame space.

Bus-off ends after 128 such runs.
"""
NS = 1_000_000_000


class Stage(IntEnum):
    """State of the bus up to `end_ns`."""

    FREE = 0
    FRAME = 1
    WATCHED = 2
    TELLING = 3
    PLAYED = 4  # bits are simulated up to `end_ns`, where their events are reported
    TOLD = 5  # events are reported, the next bits are due
    OVER = 6  # as PLAYED; after the last bit a station may start to send


class Delivered(IntEnum):
    """Receivers of the frame that has just ended."""

    NOBODY = 0  # not a frame
    OTHERS = 1  # all except its sender
    HEARERS = 2  # stations whose controller has `hears`


class ErrorKind(IntEnum):
    """The five errors of the standard (10.11)."""

    BIT = 0
    STUFF = 1
    CRC = 2
    FORM = 3
    ACK = 4
