"""The dead man's switch: what the rig file asks for, and the key that is held in the terminal.

A held key reaches a program as repeats, which begin some tenths of a second after the first stroke.
So one stroke counts for nothing; two within `RELEASE_S` count as held, until none has come for
`RELEASE_S`.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any

from coulombus.host.errors import SafetyTrip
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


class HeldKey:
    """Watches the space bar of the terminal in a thread.

    Calls ``hold(until_ns)`` (CLOCK_MONOTONIC) with every repeat.

    Raises
    ------
    SafetyTrip
        the standard input is no terminal
    """

    def __init__(self, hold: Callable[[int], None]) -> None:
        if not sys.stdin.isatty():
            raise SafetyTrip('host.deadman = "key" needs a terminal: the standard input is none')
        self._fd = sys.stdin.fileno()
        self._hold = hold
        self._held_until = 0
        self._end, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._watch, name="dead man's key", daemon=True)
        self._mode: list[Any] = []

    def __enter__(self) -> HeldKey:
        self._mode = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._wake)
        self._thread.join()
        os.close(self._end)
        with suppress(termios.error):
            termios.tcsetattr(self._fd, termios.TCSAFLUSH, self._mode)  # the repeats that wait are not for the shell

    @property
    def held(self) -> bool:
        """Whether the key counts as held now."""
        return time.monotonic_ns() < self._held_until

    def _watch(self) -> None:
        release_ns, last = round(RELEASE_S * 1e9), 0
        while True:
            ready, _, _ = select.select([self._fd, self._end], [], [])
            if self._end in ready:
                return
            try:
                strokes = os.read(self._fd, 64)
            except OSError:
                strokes = b""
            if not strokes:  # the terminal is gone: nobody holds anything
                return
            if KEY not in strokes:
                continue
            now = time.monotonic_ns()
            if now - last < release_ns:
                self._held_until = now + release_ns
                self._hold(self._held_until)
            last = now
