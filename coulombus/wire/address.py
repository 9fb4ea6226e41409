"""Name of a bus: ``coulombus:bench`` is a virtual bus of this project, ``socketcan:can0`` a Linux interface,
``can:slcan:/dev/ttyACM0`` an adapter of python-can, and ``socketcand:127.0.0.1:29536`` a server for others.

A virtual bus is a socket in a private directory of the user: ``$XDG_RUNTIME_DIR/coulombus`` where
the system provides one, else ``coulombus-UID`` in the directory for temporary files. Whoever can
enter that directory can move the motor, so it has mode 0700, and is refused with any other mode or
owner (`coulombus.system.private_folder`).
"""

from __future__ import annotations

import os
import re
import socket
import tempfile
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from coulombus.system.errors import CoulombusError
from coulombus.system.private_folder import make_private, reason_against
from coulombus.system.quoting import INTERFACE

__all__ = [
    "FAULTS_SUFFIX",
    "HOST_SUFFIX",
    "LOOPBACK",
    "WITH_ADAPTERS",
    "WORLD_SUFFIX",
    "AddressError",
    "BusAddress",
    "BusUnavailable",
    "bus_names",
    "default_address",
    "live_bus_names",
    "option_of",
    "parse_address",
    "socket_names",
    "socket_path",
]

Kind: TypeAlias = Literal["coulombus", "socketcan", "can", "socketcand"]

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_ADAPTER = re.compile(r"([A-Za-z0-9_-]+)(?::([^?]*))?(?:\?(.*))?")  # INTERFACE[:CHANNEL][?K=V&K=V]
_SERVER = re.compile(r"(?:(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):)?([0-9]{1,5})")  # [HOST:]PORT
LOOPBACK = "127.0.0.1"
WITH_ADAPTERS: tuple[Kind, ...] = ("can",)
"""What a verb takes besides, for which no latency counts."""
_SUN_PATH = 107  # bytes of a socket's path, without the closing zero byte: unix(7)
HOST_SUFFIX = ".host"  # the control socket of the host on bus NAME is NAME.host
FAULTS_SUFFIX = ".faults"  # the sockets of the processes with nodes on bus NAME, for faults
WORLD_SUFFIX = ".world"  # the socket of the host on bus NAME for a world outside is NAME.world

_SUFFIXES = (HOST_SUFFIX, WORLD_SUFFIX, FAULTS_SUFFIX)


class AddressError(CoulombusError, ValueError):
    """A text that is no bus address; the message lists the valid forms."""

    exit_status = 2


class BusUnavailable(CoulombusError, OSError):
    """No bus answers at this address; the text says how to get one."""

    exit_status = 4

    def __str__(self) -> str:
        return str(self.args[-1]) if self.args else ""  # without OSError's "[Errno 104]": the text is for people


@dataclass(frozen=True)
class BusAddress:
    """Address of a bus: its kind and its name. ``str()`` is the form that `parse_address` reads.

    `start` is the command that serves the bus with the expected rig, if known, and `options` are those of
    an adapter, as python-can names them; neither is part of the bus's identity.
    """

    kind: Kind
    name: str
    start: str = field(default="", compare=False)
    options: tuple[tuple[str, str], ...] = field(default=(), compare=False)

    def __str__(self) -> str:
        return f"{self.kind}:{self.name}"

    @property
    def is_virtual(self) -> bool:
        """Whether the bus is virtual: a process of this machine serves it at a socket, with its own bit times,
        faults and recordings.
        """
        return self.kind == "coulombus"

    @property
    def is_interface(self) -> bool:
        """Whether `name` is a network interface of Linux: `ip` sets its bit rate, and it may have a CAN card
        behind it.
        """
        return self.kind == "socketcan"

    @property
    def is_adapter(self) -> bool:
        """Whether python-can reaches the bus; `name` is then its INTERFACE, or INTERFACE:CHANNEL."""
        return self.kind == "can"

    @property
    def is_server(self) -> bool:
        """Whether the bus is that of other programs, which connect to the port HOST:PORT, `name`."""
        return self.kind == "socketcand"

    @property
    def moves_hardware(self) -> bool:
        """Whether a frame may move a real motor: then a key, a dead man's switch and rehearsal marks are
        required.
        """
        return self.kind != "coulombus"

    @property
    def packs_frames(self) -> bool:
        """Whether one message carries many frames; otherwise each frame is a message."""
        return self.kind == "coulombus"

    @property
    def stamps(self) -> str:
        """Meaning of the time stamp of a frame received from a socket."""
        what = "the virtual bus sent the message" if self.is_virtual else "the kernel took the frame"
        return f"SO_TIMESTAMPNS: when {what}"


def default_address(rig_name: str) -> BusAddress:
    """Return the virtual bus of a rig: ``coulombus:RIG``, with ``-`` for each character that a name
    cannot have.
    """
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", rig_name).strip("-.")
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    name = name or "bus"
    return BusAddress("coulombus", name)


def parse_address(text: str, also: Collection[Kind] = ()) -> BusAddress:
    """Return the address that `text` names.

    Parameters
    ----------
    also : kinds that the caller can do with, besides the two that have a known latency: "can", an adapter
        of python-can, and "socketcand", a server at a port of this machine

    Raises
    ------
    AddressError
        (a ValueError) The text names no bus; the message lists the valid forms.
    """
    kind, colon, name = text.partition(":")
    if kind not in get_args(Kind) or not colon:
        bare = text if not colon and _NAME.fullmatch(text) else name or "bench"
        if colon and kind not in get_args(Kind):
            near = f"; another adapter is can:{text}" if "can" in also else ""
            raise AddressError(
                f"bus {text!r}: unknown kind of bus {kind!r}; expected coulombus:NAME for a virtual bus or "
                f"socketcan:IF for a CAN interface of Linux, as in socketcan:can0, which the card's driver makes{near}"
            )
        raise AddressError(
            f"bus {text!r}: expected KIND:NAME; write coulombus:{bare} for a virtual bus or socketcan:{bare} for a "
            "SocketCAN interface"
        )
    if kind == "can":
        return _adapter(text, name, allowed="can" in also)
    if kind == "socketcand":
        return _server(text, name, allowed="socketcand" in also)
    if kind == "socketcan":
        if not INTERFACE.fullmatch(name):
            raise AddressError(
                f"bus {text!r}: expected the name of a network interface, as in socketcan:can0: 1 to 15 letters (A-Z, "
                "a-z), digits, '_', '-' and '.', not starting with '-' or '.'; another name goes into files of a "
                "shell and of systemd: ip link set NAME name can0"
            )
        return BusAddress("socketcan", name)
    _check_name(name)
    for suffix in _SUFFIXES:
        if name.endswith(suffix):
            raise AddressError(f"bus {text!r}: names that end in {suffix} are kept for control sockets")
    return BusAddress("coulombus", name)


def _adapter(text: str, name: str, *, allowed: bool) -> BusAddress:
    """Return the address of an adapter: ``INTERFACE:CHANNEL``, perhaps with ``?KEY=VALUE&KEY=VALUE``."""
    if not allowed:
        raise AddressError(
            f"bus {text!r}: an adapter of python-can is for services and for listening; a control cycle of 1 ms needs "
            "a bus of known latency: coulombus:NAME, or socketcan:IF, which Linux's drivers make of most adapters"
        )
    match = _ADAPTER.fullmatch(name)
    if match is None:
        raise AddressError(
            f"bus {text!r}: expected can:INTERFACE:CHANNEL, as in can:slcan:/dev/ttyACM0 or can:pcan:PCAN_USBBUS1; "
            "INTERFACE is a name of python-can"
        )
    interface, channel, rest = match.groups()
    options = tuple(option_of(pair) for pair in (rest or "").split("&") if pair)
    return BusAddress("can", f"{interface}:{channel}" if channel else interface, options=options)


def option_of(pair: str) -> tuple[str, str]:
    """Return the option of an adapter that ``KEY=VALUE`` names; AddressError if it is none."""
    key, equals, value = pair.partition("=")
    if not equals or not key.isidentifier() or "&" in value:
        raise AddressError(f"adapter option {pair!r}: expected KEY=VALUE without '&', as in bitrate=500000")
    return key, value


def _server(text: str, name: str, *, allowed: bool) -> BusAddress:
    """Return the address of a server: ``HOST:PORT``, or ``PORT`` of the loopback."""
    if not allowed:
        raise AddressError(
            f"bus {text!r}: a server of this machine for others' programs is an end of a bridge: "
            f"coulombus bridge coulombus:bench {text}; a server elsewhere is reached by "
            f"can:socketcand:CHANNEL --bus-option host=HOST --bus-option port=PORT"
        )
    match = _SERVER.fullmatch(name)
    if match is None or int(match[2]) > 0xFFFF:
        raise AddressError(f"bus {text!r}: expected socketcand:HOST:PORT, as in socketcand:{LOOPBACK}:29536")
    return BusAddress("socketcand", f"{match[1] or LOOPBACK}:{match[2]}")


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise AddressError(
            f"bus name {name!r}: expected letters, digits, '_', '-' and '.', not starting with '-' or '.', "
            "as in coulombus:bench"
        )


def socket_path(name: str) -> Path:
    """Return the path of the socket `name`; its directory is created if missing, and private to this
    user.

    Raises
    ------
    AddressError
        The name has a forbidden character, or is too long for a socket's address.
    BusUnavailable
        The directory belongs to another user, or others may enter it.
    """
    _check_name(name)
    path = _directory() / name
    excess = len(os.fsencode(path)) - _SUN_PATH
    if excess > 0:
        raise AddressError(
            f"bus name {name!r}: {path} is {excess} bytes longer than the {_SUN_PATH} of a socket's path; "
            "use a shorter name, or set XDG_RUNTIME_DIR or TMPDIR to a shorter path"
        )
    _make_private(path.parent)
    return path


def socket_names() -> list[str]:
    """Return the names of all sockets in this user's directory, including stale sockets of killed processes."""
    try:
        return sorted(path.name for path in _directory().iterdir() if path.is_socket())
    except OSError:
        return []


def bus_names() -> list[str]:
    """Return the names of the virtual buses that have a socket, including stale sockets of killed processes."""
    return [name for name in socket_names() if _NAME.fullmatch(name) and not name.endswith(_SUFFIXES)]


def live_bus_names() -> list[str]:
    """Return the names of the virtual buses that a process serves."""
    return [name for name in bus_names() if _answers(_directory() / name)]


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK) as probe:
        try:
            probe.connect(str(path))
        except BlockingIOError:  # the queue of pending connections is full: the bus is alive
            return True
        except OSError:
            return False
    return True


def _directory() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if os.path.isabs(runtime):
        try:
            # after `su` the variable may still name the other user's directory
            if os.stat(runtime).st_uid == os.geteuid():
                return Path(runtime, "coulombus")
        except OSError:
            pass
    return Path(tempfile.gettempdir(), f"coulombus-{os.geteuid()}")


def _make_private(directory: Path) -> None:
    try:
        make_private(directory)
        why = reason_against(directory)
    except OSError as error:
        raise BusUnavailable(
            error.errno, f"cannot use {directory} for the sockets of virtual buses: {error.strerror}"
        ) from None
    if why:
        raise BusUnavailable(
            f"refused for the sockets of virtual buses: {why}; or set XDG_RUNTIME_DIR to a folder of yours"
        )
