"""The dead man's switch: what the rig file asks for, and the key that is held in the terminal.

A held key reaches a program as repeats, which begin some tenths of a second after the first stroke.
So one stroke counts for nothing; two within `RELEASE_S` count as held, until none has come for
`RELEASE_S`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from coulombus.host.errors import SafetyTrip
from coulombus.host.run.keys import Keys
from coulombus.rigs.rig import Rig
from coulombus.wire.address import BusAddress

__all__ = ["RELEASE_S", "HeldKey", "deadman_of"]

RELEASE_S = 0.3
KEY = b" "


def deadman_of(rig: Rig, mode: str, address: BusAddress) -> str:
    """Return the dead man's switch of a run: "none", "key", "object:INDEX:SUB" or
    "object:INDEX:SUB:MASK".

    A virtual bus moves nobody, and needs none. On an interface of Linux a mode in which the motor
    of any axis has torque needs one, or the rig file says in so many words that there is none.

    Raises
    ------
    SafetyTrip
        the rig file says nothing
    """
    if rig.host.deadman:
        return rig.host.deadman
    pushing = [f"{axis.prefix}motor" for axis in rig.axes if axis.motor_limit_Nm(mode) > 0]
    if address.kind == "socketcan" and pushing:
        which = "the motor" if pushing == ["motor"] else ", ".join(pushing)
        raise SafetyTrip(
            f"mode {mode} gives {which} torque on {address}, and {rig.path} names no dead man's switch: set host.deadman to "
            '"key", "object:INDEX:SUB" or "object:INDEX:SUB:MASK", or to "none" if the rig needs none'
        )
    return "none"


class HeldKey(Keys):
    """Watches the space bar of the terminal.

    Calls ``hold(until_ns)`` (CLOCK_MONOTONIC) with every repeat, and `other` with all other
    strokes.

    Raises
    ------
    SafetyTrip
        the standard input is no terminal
    """

    def __init__(self, hold: Callable[[int], None], other: Callable[[bytes], None] = lambda strokes: None) -> None:
        if not sys.stdin.isatty():
            raise SafetyTrip('host.deadman = "key" needs a terminal: the standard input is none')
        super().__init__(self._struck)
        self._hold, self._other = hold, other
        self._held_until, self._last = 0, 0

    @property
    def held(self) -> bool:
        """Whether the key counts as held now."""
        return time.monotonic_ns() < self._held_until

    def _struck(self, strokes: bytes) -> None:
        others = strokes.replace(KEY, b"")
        if others:
            self._other(others)
        if KEY not in strokes:
            return
        now, release_ns = time.monotonic_ns(), round(RELEASE_S * 1e9)
        if now - self._last < release_ns:
            self._held_until = now + release_ns
            self._hold(self._held_until)
        self._last = now
