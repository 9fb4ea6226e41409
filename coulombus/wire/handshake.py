"""Handshake of a client with a virtual bus, and how a client connects.

The socket is AF_UNIX, SOCK_SEQPACKET: it keeps messages whole and reports when the other side has
closed. All words of the greeting are little endian::

    client -> bus   u32 magic  u16 version  u16 flags  u16 n  n x (u32 id, u32 mask)  padding     Hello
    bus -> client   u32 magic  u16 version  u16 status  u32 bit rate  u32 station  u64 lost       Answer
                    and perhaps the state of the client's controller, as wire.controller_state.ControllerState packs it
    then, both ways, messages of one or more 16-byte ``struct can_frame`` in native byte order

A greeting is padded so that its length is 8 modulo 16; a message of frames is a multiple of 16. So
greetings and frames can be distinguished at any time, and a client may greet again to change its
flags and filters, or to request its number of lost frames.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from pathlib import Path

from coulombus.system.full_queue import connect_by
from coulombus.wire.address import BusAddress, BusUnavailable, socket_path
from coulombus.wire.ancillary import SO_TIMESTAMPNS
from coulombus.wire.controller_state import ControllerState

__all__ = [
    "MAGIC",
    "MAX_FILTERS",
    "VERSION",
    "Answer",
    "BusStatus",
    "BusUnavailable",
    "Connection",
    "Flags",
    "Hello",
    "connect",
    "connect_path",
    "greet",
    "is_greeting",
]

MAGIC = 0x53424C43  # "CLBS"
VERSION = 1
MAX_FILTERS = 512  # like CAN_RAW_FILTER_MAX
SEND_BUFFER = 4 << 20  # bytes requested; the kernel gives at most net.core.wmem_max

_HELLO = struct.Struct("<IHHH")
_FILTER = struct.Struct("<II")
_ANSWER = struct.Struct("<IHHIIQ")


class Flags(IntFlag):
    """Options of a client, in addition to the frames of others."""

    OWN = 1  # its own frames too, after they were on the wire
    LISTEN_ONLY = 2  # frames that it sends are dropped
    ERRORS = 4  # error frames (CAN_ERR_FLAG), regardless of the filters


_NO_FLAGS = Flags(0)


class BusStatus(IntEnum):
    """Status of a bus's answer."""

    OK = 0
    WRONG_VERSION = 1
    BAD_HELLO = 2
    FULL = 3


_REFUSAL = {
    BusStatus.WRONG_VERSION: f"it speaks another version than {VERSION} of the protocol; update both to one coulombus",
    BusStatus.BAD_HELLO: "it does not understand the greeting; update both to one coulombus",
    BusStatus.FULL: "all its places for clients are taken; end another client first",
}


def is_greeting(message: bytes) -> bool:
    """Distinguish a greeting from frames, by its length alone."""
    return len(message) % 16 == 8


def _padded(message: bytes) -> bytes:
    return message.ljust(len(message) + (8 - len(message)) % 16, b"\0")


@dataclass(frozen=True)
class Hello:
    """First message of a client. A filter passes frames with ``id & mask == filter id & mask``; no filter
    passes all.

    The identifiers and masks have the meaning of SocketCAN's ``struct can_filter``: bit 31 for
    extended frames, bit 30 for remote frames, and bit 29 of the identifier inverts the filter.
    """

    flags: Flags = _NO_FLAGS
    filters: tuple[tuple[int, int], ...] = ()

    def pack(self) -> bytes:
        """Return the greeting's bytes. ValueError for more than `MAX_FILTERS` filters."""
        if len(self.filters) > MAX_FILTERS:
            raise ValueError(f"{len(self.filters)} filters: a bus takes at most {MAX_FILTERS} of a client")
        head = _HELLO.pack(MAGIC, VERSION, self.flags, len(self.filters))
        return _padded(head + b"".join(_FILTER.pack(*pair) for pair in self.filters))

    @classmethod
    def unpack(cls, message: bytes) -> Hello | BusStatus:
        """Return the greeting in `message`, or the status with which the bus refuses it.

        Never raises.
        """
        if len(message) < _HELLO.size:
            return BusStatus.BAD_HELLO
        magic, version, flags, count = _HELLO.unpack_from(message)
        if magic != MAGIC:
            return BusStatus.BAD_HELLO
        if version != VERSION:
            return BusStatus.WRONG_VERSION
        size = _HELLO.size + count * _FILTER.size
        if count > MAX_FILTERS or len(message) != size + (8 - size) % 16:
            return BusStatus.BAD_HELLO
        supported = flags & (Flags.OWN | Flags.LISTEN_ONLY | Flags.ERRORS)
        return cls(Flags(supported), tuple(_FILTER.iter_unpack(message[_HELLO.size : size])))


@dataclass(frozen=True)
class Answer:
    """Answer of a bus: whether it accepts the client, its bit rate (0: unknown), and the client's station
    number.

    `lost` counts the frames that found no room in the client's receive queue since it connected,
    because it does not read. `controller` is its CAN controller.
    """

    status: BusStatus
    bitrate_bit_s: int = 0
    station: int = 0
    lost: int = 0
    controller: ControllerState | None = None

    def pack(self) -> bytes:
        """Return the answer's bytes."""
        head = _ANSWER.pack(MAGIC, VERSION, self.status, self.bitrate_bit_s, self.station, self.lost)
        return head if self.controller is None else head + self.controller.pack()

    @classmethod
    def unpack(cls, message: bytes) -> Answer | None:
        """Return the answer in `message`, None if it is no answer; never raises."""
        if len(message) < _ANSWER.size or not is_greeting(message):
            return None
        magic, _, status, bitrate, station, lost = _ANSWER.unpack_from(message)
        if magic != MAGIC or status not in BusStatus.__members__.values():
            return None
        return cls(BusStatus(status), bitrate, station, lost, ControllerState.unpack(message[_ANSWER.size :]))


@dataclass(frozen=True)
class Connection:
    """A socket after the handshake (blocking, no timeout), and the bus's answer."""

    socket: socket.socket
    answer: Answer


def connect(
    address: BusAddress,
    flags: Flags | int = 0,
    filters: Sequence[tuple[int, int]] = (),
    timeout: float = 2.0,
) -> socket.socket:
    """Return a blocking socket on the virtual bus at `address`, after the handshake; `timeout` in seconds
    covers everything.

    Raises
    ------
    BusUnavailable
        No bus is there, or it refuses; the text says what to do.
    """
    return greet(address, Hello(Flags(flags), tuple(filters)), timeout).socket


def greet(address: BusAddress, hello: Hello, timeout: float = 2.0) -> Connection:
    """Connect like `connect`; return the bus's answer, too."""
    if address.kind != "coulombus":
        raise ValueError(f"{address}: only coulombus: buses are greeted; a SocketCAN interface is opened by its name")
    path = socket_path(address.name)
    try:
        return connect_path(path, hello, timeout)
    except (FileNotFoundError, ConnectionRefusedError):
        text = f"no bus {address}: start one in another terminal with `{address.start or f'coulombus emulate --bus {address}'}`"
    except BusUnavailable as error:
        text = f"bus {address} refuses: {error}"
    except TimeoutError:
        text = f"bus {address} does not answer within {timeout:g} s: is its process stopped? (socket {path})"
    except OSError as error:
        text = f"bus {address} cannot be reached at {path}: {error.strerror or error}"
    raise BusUnavailable(text) from None


def connect_path(path: Path, hello: Hello, timeout: float) -> Connection:
    """Connect to the socket at `path` and greet; errors are the system's own, a refusal is a
    BusUnavailable.
    """
    deadline = time.monotonic() + timeout
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        client.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)  # before connect(): no message without a stamp
        connect_by(client, path, deadline)
        with suppress(BrokenPipeError):  # a full bus says so and closes at once
            client.send(hello.pack())
        answer = None
        while answer is None:  # ignore other messages before the answer
            client.settimeout(max(1e-3, deadline - time.monotonic()))
            message = client.recv(1 << 16)
            if not message:
                raise ConnectionResetError(errno.ECONNRESET, "it closed the connection")
            answer = Answer.unpack(message)
        if answer.status != BusStatus.OK:
            raise BusUnavailable(_REFUSAL[answer.status])
        client.settimeout(None)
    except BaseException:
        client.close()
        raise
    return Connection(client, answer)
