"""The dead man's switch: the rig file's choice, and watchers for switches that are no object of a device.

A watcher is a thread of the data plane's parent. Each time it reads the switch as held, it counts it as
held for a short time ahead (``hold(until_ns)``). The compiled loop compares that time with its own clock
in each cycle. So if the watcher dies or stalls, or its device or client goes, the switch counts as
released.

The key: a terminal sends a held key as repeats, which begin tenths of a second after the first stroke. So
one stroke does not count. Two strokes within `RELEASE_S` count as held, until `RELEASE_S` passes without
a stroke.
"""

from __future__ import annotations

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import ClassVar, Self

from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.errors import SafetyTrip
from coulombus.rigs.rig import Rig
from coulombus.system.keyboard import Keys
from coulombus.system.watch_thread import Lookout
from coulombus.wire.address import BusAddress

__all__ = ["RELEASE_S", "HeldKey", "Switch", "Watcher", "deadman_of"]

RELEASE_S = 0.3
KEY = b" "


def deadman_of(rig: Rig, mode: str, address: BusAddress) -> str:
    """Return the dead man's switch of a run: "none", "key", "object:INDEX:SUB",
    "object:INDEX:SUB:MASK", "gpio:gpiochipN:LINE", "gpio:gpiochipN:LINE:low" or "socket:/PATH".

    A virtual bus moves no hardware and needs no switch. On a Linux interface, a mode in which the motor
    of any axis has torque needs a switch, unless the rig file says "none" explicitly.

    Raises
    ------
    SafetyTrip
        the rig file names no switch, and the mode needs one
    """
    if rig.host.deadman:
        return rig.host.deadman
    pushing = [f"{axis.prefix}motor" for axis in rig.axes if motor_limit_Nm(axis, mode) > 0]
    if address.moves_hardware and pushing:
        which = "the motor" if pushing == ["motor"] else ", ".join(pushing)
        raise SafetyTrip(
            f"mode {mode} gives {which} torque on {address}, and {rig.path} names no dead man's switch: set host.deadman to "
            '"key", "object:INDEX:SUB:MASK", "gpio:gpiochipN:LINE" or "socket:/PATH", or to "none" if the rig needs none'
        )
    return "none"


class Switch(ABC):
    """A dead man's switch, which the context manager watches.

    Parameters
    ----------
    hold : called with the time [ns, CLOCK_MONOTONIC] until which the switch counts as held; with 0
        when it is released
    """

    invitation: ClassVar[str]
    """Instruction for the operator."""
    name: ClassVar[str]

    def __init__(self, hold: Callable[[int], None]) -> None:
        self._tell, self._held_until = hold, 0

    @abstractmethod
    def __enter__(self) -> Self:
        """Begin to watch."""

    @abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop watching."""

    @property
    def held(self) -> bool:
        """Whether the switch counts as held now."""
        return time.monotonic_ns() < self._held_until

    def _hold_for(self, seconds: float) -> None:
        self._held_until = time.monotonic_ns() + round(seconds * 1e9)
        self._tell(self._held_until)

    def _let_go(self) -> None:
        self._held_until = 0
        self._tell(0)


class Watcher(Switch):
    """A switch with a watcher thread of its own."""

    def __init__(self, hold: Callable[[int], None]) -> None:
        super().__init__(hold)
        self._lookout = Lookout("dead man's switch", self._watch, self._let_go)

    def __enter__(self) -> Self:
        self._lookout.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lookout.end()

    @abstractmethod
    def _watch(self) -> None:
        """Watch until `_lookout.ready` returns None; then, and after an error, the switch is released.

        OSError: the switch is gone.
        """


class HeldKey(Switch):
    """The space bar of the terminal; `other` is called with all other keys.

    Raises
    ------
    SafetyTrip
        the standard input is not a terminal
    """

    name = "the space bar"
    invitation = "hold the space bar; releasing it stops the rig"

    def __init__(self, hold: Callable[[int], None], other: Callable[[bytes], None] = lambda strokes: None) -> None:
        if not sys.stdin.isatty():
            raise SafetyTrip('host.deadman = "key" needs a terminal: standard input is not one')
        super().__init__(hold)
        self._keys, self._other, self._last = Keys(self._struck, self._let_go), other, 0

    def __enter__(self) -> Self:
        self._keys.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._keys.__exit__(kind, error, trace)

    def _struck(self, strokes: bytes) -> None:
        others = strokes.replace(KEY, b"")
        if others:
            self._other(others)
        if KEY not in strokes:
            return
        now = time.monotonic_ns()
        if now - self._last < round(RELEASE_S * 1e9):
            self._hold_for(RELEASE_S)
        self._last = now
