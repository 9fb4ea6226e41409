"""Dead man's switches without a terminal: a GPIO line of this computer, and a UNIX socket with a client.

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
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

from coulombus.host.errors import SafetyTrip
from coulombus.host.run.deadman import HeldKey, Switch, Watcher

__all__ = ["SILENCE_S", "HeldLine", "HeldSocket", "switch_of"]

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
            self._listener.listen(1)
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
