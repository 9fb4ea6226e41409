"""The dead man's switch: the rig file's choice, and watchers for switches that are no object of a device.

A watcher is a thread of the data plane's parent. Each time it reads the switch as held, it counts it as
held for a short time ahead (``hold(until_ns)``). The compiled loop compares that time with its own clock
in each cycle. So if the watcher dies or stalls, or its device or client goes, the switch counts as
released.

The key: a terminal sends a held key as repeats, which begin tenths of a second after the first stroke. So
one stroke does not count. Two strokes within `RELEASE_S` count as held, until `RELEASE_S` passes without
a stroke.

``host.deadman = "gpio:gpiochip0:17"``: line 17 of ``/dev/gpiochip0``, by the Linux interface
(``GPIO_V2_GET_LINE_IOCTL``, ``linux/gpio.h``). The line has a pull-down, so a broken cable is a release.
With ``:low`` appended, the switch is held while the line is 0, and the line has a pull-up.

``host.deadman = "socket:/run/coulombus/deadman"``: a client connects to this UNIX socket and sends any
byte at least every 100 ms while the switch is held, preferably every 20 ms. Silence, the end of the
connection, or a second client is a release.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
import struct
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self, TypeAlias

from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.errors import SafetyTrip
from coulombus.rigs.rig import Rig
from coulombus.system.keyboard import Keys
from coulombus.system.watch_thread import Lookout
from coulombus.wire.address import BusAddress

__all__ = [
    "RELEASE_S",
    "SILENCE_S",
    "HeldKey",
    "HeldLine",
    "HeldSocket",
    "Switch",
    "Watcher",
    "deadman_of",
    "switch_of",
]

RELEASE_S = 0.3
KEY = b" "
SILENCE_S = 0.1
LOOK_S, LEVEL_S = 0.002, 0.03
"""Period in which a line is read, and time for which a held line counts as held."""

Ioctl: TypeAlias = Callable[[int, int, bytes], bytes]

LINE = struct.Struct("=256s32sQI20s240sII20si")  # struct gpio_v2_line_request with its configuration
VALUES = struct.Struct("=QQ")  # struct gpio_v2_line_values: bits, mask
GET_LINE, GET_VALUES = 0xC250B407, 0xC010B40E
ACTIVE_LOW, INPUT, PULL_UP, PULL_DOWN = 1 << 1, 1 << 2, 1 << 8, 1 << 9
REASONS = {
    errno.EBUSY: "another program has this line",
    errno.EINVAL: "it has no such line, or no pull resistor for it",
    errno.ENOENT: "there is no such device; `ls /dev/gpiochip*` shows those that are there",
    errno.EACCES: "no right to read it; a udev rule or the group `gpio` gives it",
    errno.ENOTTY: "it is not a GPIO device",
}


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


def switch_of(
    deadman: str, hold: Callable[[int], None], other: Callable[[bytes], None] = lambda strokes: None
) -> Switch | None:
    """Return the switch that `host.deadman` names.

    None: it is an object of a device, which the cycle reads itself, or "none". `other` gets the terminal's
    other keys.

    Raises
    ------
    coulombus.host.errors.SafetyTrip
        the switch is not available
    """
    kind, _, rest = deadman.partition(":")
    if kind == "key":
        return HeldKey(hold, other)
    if kind == "gpio":
        chip, number, *low = rest.split(":")
        return HeldLine(hold, Path("/dev") / chip, int(number), low=bool(low))
    if kind == "socket":
        return HeldSocket(hold, Path(rest))
    return None


class HeldLine(Watcher):
    """A GPIO line of this computer.

    Parameters
    ----------
    low : whether the switch is held while the line is 0
    ioctl : the kernel's ioctl, or a substitute

    Raises
    ------
    SafetyTrip
        the line is not available; the text gives the reason
    """

    name = "the switch at the GPIO line"
    invitation = "hold the switch at the GPIO line; releasing it stops the rig"

    def __init__(
        self, hold: Callable[[int], None], chip: Path, number: int, *, low: bool = False, ioctl: Ioctl = fcntl.ioctl
    ) -> None:
        self._ioctl = ioctl
        flags = INPUT | (ACTIVE_LOW | PULL_UP if low else PULL_DOWN)
        offsets = struct.pack("=I", number)
        request = LINE.pack(offsets, b"coulombus dead man", flags, 0, b"", b"", 1, 0, b"", -1)
        try:
            device = os.open(chip, os.O_RDONLY)
            try:
                self._line = LINE.unpack(ioctl(device, GET_LINE, request))[-1]
            finally:
                os.close(device)
        except OSError as error:
            why = REASONS.get(error.errno or 0, error.strerror)
            raise SafetyTrip(f"host.deadman: line {number} of {chip} cannot be had: {why}") from None
        super().__init__(hold)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, error, trace)
        os.close(self._line)

    def _watch(self) -> None:
        while self._lookout.ready([], LOOK_S) is not None:
            bits, _ = VALUES.unpack(self._ioctl(self._line, GET_VALUES, VALUES.pack(0, 1)))
            if bits & 1:
                self._hold_for(LEVEL_S)
            else:
                self._let_go()


class HeldSocket(Watcher):
    """A UNIX socket on which a client keeps sending; only this user may connect.

    Raises
    ------
    SafetyTrip
        the socket cannot be created, or another host has it
    """

    name = "the socket"
    invitation = "keep the socket of host.deadman alive; silence on it stops the rig"

    def __init__(self, hold: Callable[[int], None], path: Path) -> None:
        self.path = path
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            _remove_abandoned(path)
            self._listener.bind(str(path))
            path.chmod(0o600)
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            raise SafetyTrip(f"host.deadman: socket {path} cannot be made: {error.strerror or error}") from None
        super().__init__(hold)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, error, trace)
        with suppress(OSError):
            self.path.unlink()
        self._listener.close()

    def _watch(self) -> None:
        client: socket.socket | None = None
        try:
            while True:
                sources = [self._listener.fileno(), *([] if client is None else [client.fileno()])]
                ready = self._lookout.ready(sources, SILENCE_S)
                if ready is None:
                    return
                if self._listener.fileno() in ready:
                    other = _accepted(self._listener)
                    if client is None:
                        client = other
                    elif other is not None:  # with two clients neither hand counts
                        client.close()
                        other.close()
                        client = None
                        self._let_go()
                elif client is not None and ready:
                    if _spoke(client):
                        self._hold_for(SILENCE_S)
                    else:
                        client.close()
                        client = None
                        self._let_go()
        finally:
            if client is not None:
                client.close()


def _accepted(listener: socket.socket) -> socket.socket | None:
    """Return the connection of a new client; None if it has disconnected."""
    with suppress(BlockingIOError, ConnectionAbortedError):
        connection, _ = listener.accept()
        connection.setblocking(False)
        return connection
    return None


def _spoke(client: socket.socket) -> bool:
    """Read a client's bytes; return False if it has disconnected."""
    try:
        return bool(client.recv(4096))
    except OSError:
        return False


def _remove_abandoned(path: Path) -> None:
    """Remove a stale socket.

    OSError: another host listens on it, or the path is not a socket.
    """
    try:
        kind = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(kind):
        raise OSError(errno.EEXIST, "something else is there")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except BlockingIOError:
            pass
    raise OSError(errno.EADDRINUSE, "another host listens on it")
