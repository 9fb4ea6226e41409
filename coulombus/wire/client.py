"""Client of a bus, and its kind with a socket: non-blocking, for messages of 16-byte ``struct can_frame``.

Imports neither numba nor python-can: a script or a viewer starts at once.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
from collections.abc import Sequence
from typing import Self, TypeAlias

from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.ancillary import SO_RXQ_OVFL, SO_TIMESTAMPNS
from coulombus.wire.controller_state import ControllerState
from coulombus.wire.handshake import Answer, BusStatus, Flags, Hello, greet, is_greeting

__all__ = ["CAN_FRAME", "BusDown", "BusFull", "BusGone", "Client", "Echo", "OpenBus", "Received", "pack_frame"]

CAN_FRAME = struct.Struct("=IB3x8s")
"""Identifier with EFF, RTR and ERR flags; length; data."""

Received: TypeAlias = tuple[int, int, int, bytes]
"""Stamp [ns since 1970], identifier with flags, length, eight data bytes."""


class Echo(tuple[int, int, int, bytes]):
    """A `Received` that this client sent itself, back from the wire (`wire.handshake.Flags.OWN`)."""

    __slots__ = ()


MESSAGE_BYTES = 1 << 16
CAN_LENGTH = 8
ECHO_BYTE = 5
"""First padding byte of struct can_frame; a virtual bus sets it in a client's own frames, as Linux
sets MSG_CONFIRM.
"""
MSG_CONFIRM = 0x800
CAN_RAW_ERR_FILTER = 2
_TIMESPEC = struct.Struct("=qq") if struct.calcsize("@l") == 8 else struct.Struct("=ll")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(4)
_FILTER = struct.Struct("=II")
_ALL_ERRORS = 0x1FFFFFFF


class BusGone(BusUnavailable):
    """The bus is gone: its process ended, or the interface was removed."""


class BusDown(BusUnavailable):
    """The interface is down; reading may continue when it is up again."""


class BusFull(OSError):
    """The send queue is full: nobody reads, or the client sends faster than the bus transmits."""

    def __init__(self, address: BusAddress) -> None:
        super().__init__(errno.ENOBUFS, f"bus {address}: the send queue is full: more is sent than the bus carries")


def pack_frame(can_id: int, data: bytes = b"", length: int | None = None) -> bytes:
    """Return the 16 bytes of a frame; `length` is for a remote frame only, which requests `length` bytes
    and carries none.
    """
    return CAN_FRAME.pack(can_id, len(data) if length is None else length, data)


class OpenBus:
    """Frames from and to a bus, by whatever it is reached: what every reader and every service takes.

    Attributes
    ----------
    bitrate_bit_s
        As the bus reports it, or as an adapter was opened; 0: unknown.
    lost
        Number of frames that found no room in a receive queue on the way to this client.
    malformed
        Number of malformed messages and frames, which were dropped.
    unanswered
        Number of answers that the bus owes (`ask`).
    """

    def __init__(self, address: BusAddress, hello: Hello | None = None) -> None:
        self.address = address
        self.hello = hello or Hello()
        self.bitrate_bit_s = self.lost = self.malformed = self.unanswered = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def stamps(self) -> str:
        """Meaning of the time stamp of a received frame."""
        return self.address.stamps

    def fileno(self) -> int:
        """Return the descriptor that is readable when `receive` has a message."""
        raise NotImplementedError

    def close(self) -> None:
        """Leave the bus; may be called again."""
        raise NotImplementedError

    def wait(self, timeout: float | None) -> bool:
        """Wait at most `timeout` seconds (None: for ever) until a message can be received."""
        raise NotImplementedError

    def receive(self) -> list[Received]:
        """Return the frames of the next message; empty if there is no message, or if it was the bus's answer."""
        raise NotImplementedError

    def send(self, message: bytes, stamp_ns: int = 0) -> None:
        """Send one message of frames (`pack_frame`): of one frame, unless ``address.packs_frames``.

        `stamp_ns` is when another bus carried the frame [ns since 1970]; only a server passes it on.

        Raises
        ------
        BusFull
            Nothing was sent; try again later.
        BusUnavailable
            The bus is gone or down.
        """
        raise NotImplementedError

    def ask(self, hello: Hello | None = None) -> None:
        """Change flags and filters, or (without `hello`) only request the number of lost frames."""
        raise NotImplementedError

    def hold(self, held: bool) -> None:
        """Let senders wait while held, where they can: a bus cannot, a server's clients can."""


class Client(OpenBus):
    """A virtual bus or a SocketCAN interface, by its socket; only the constructor blocks, at most
    `timeout` seconds.

    Attributes
    ----------
    bitrate_bit_s, station
        As reported by a virtual bus; 0 on SocketCAN, where the interface sets the bit rate.
    controller
        This client's CAN controller, as of the bus's last answer; None if the bus does not report it.

    Raises
    ------
    BusUnavailable
        No such bus; later BusGone or BusDown.
    """

    def __init__(self, address: BusAddress, hello: Hello | None = None, timeout: float = 2.0) -> None:
        super().__init__(address, hello)
        self.station = 0
        self.controller: ControllerState | None = None
        self._buffer = bytearray(MESSAGE_BYTES)
        if address.kind == "coulombus":
            connection = greet(address, self.hello, timeout)
            self.socket = connection.socket
            self._take_answer(connection.answer)
        else:
            self.socket = _open_socketcan(address.name)
            self._configure_socketcan()
        self.socket.setblocking(False)

    def fileno(self) -> int:
        """Return the socket's descriptor, which is readable when `receive` has a message."""
        return self.socket.fileno()

    def close(self) -> None:
        """Leave the bus; may be called again."""
        self.socket.close()

    def wait(self, timeout: float | None) -> bool:
        """Wait at most `timeout` seconds (None: for ever) until a message can be received."""
        poll = select.poll()
        poll.register(self.socket, select.POLLIN)
        return bool(poll.poll(None if timeout is None else max(0.0, timeout * 1e3)))

    def receive(self) -> list[Received]:
        """Return the frames of the next message; empty if there is no message, or if it was the bus's answer."""
        try:
            size, ancillary, flags, _ = self.socket.recvmsg_into([self._buffer], _ANCILLARY)
        except (BlockingIOError, InterruptedError):
            return []
        except OSError as error:
            raise self.failure(error) from None
        if size == 0:
            raise self.gone()
        stamp = 0
        for level, kind, content in ancillary:
            if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(content) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(content)
                stamp = seconds * 1_000_000_000 + nanoseconds
            elif level == socket.SOL_SOCKET and kind == SO_RXQ_OVFL:
                self.lost = int.from_bytes(content, "little")
        message = memoryview(self._buffer)[:size]
        if size % CAN_FRAME.size or flags & socket.MSG_TRUNC:
            self.take_other(bytes(message))
            return []
        frames = [(stamp, can_id, length, data) for can_id, length, data in CAN_FRAME.iter_unpack(message)]
        if self.hello.flags & Flags.OWN:
            echoes = self._echoes(message, flags)
            frames = [Echo(frame) if echo else frame for frame, echo in zip(frames, echoes, strict=True)]
        if any(frame[2] > CAN_LENGTH for frame in frames):
            good = [frame for frame in frames if frame[2] <= CAN_LENGTH]
            self.malformed += len(frames) - len(good)
            return good
        return frames

    def send(self, message: bytes, stamp_ns: int = 0) -> None:
        """Send a message at once, or raise."""
        try:
            self.socket.send(message)
        except (BlockingIOError, InterruptedError):
            raise BusFull(self.address) from None
        except OSError as error:
            if error.errno == errno.ENOBUFS:
                raise BusFull(self.address) from None
            raise self.failure(error) from None

    def ask(self, hello: Hello | None = None) -> None:
        """Change flags and filters, or (without `hello`) only request the number of lost frames.

        A virtual bus answers among the frames, and `receive` takes the answer; `unanswered` counts the
        answers that are due.
        """
        if hello is not None:
            self.hello = hello
        if self.address.kind == "socketcan":
            self._configure_socketcan()
            return
        self.send(self.hello.pack())
        self.unanswered += 1

    def _echoes(self, message: memoryview, flags: int) -> Sequence[int]:
        """Return for each frame of a message whether this client sent it."""
        if self.address.kind == "socketcan":
            return (flags & MSG_CONFIRM,)
        return message[ECHO_BYTE :: CAN_FRAME.size]

    def take_other(self, message: bytes) -> None:
        """Process a message that holds no frames: the bus's answer, or a malformed message, which is counted."""
        answer = Answer.unpack(message) if self.address.kind == "coulombus" and is_greeting(message) else None
        if answer is None:
            self.malformed += 1
            return
        self.unanswered = max(0, self.unanswered - 1)
        if answer.status == BusStatus.OK:
            self._take_answer(answer)

    def _take_answer(self, answer: Answer) -> None:
        self.bitrate_bit_s, self.station, self.lost = answer.bitrate_bit_s, answer.station, answer.lost
        self.controller = answer.controller

    def _configure_socketcan(self) -> None:
        filters: Sequence[tuple[int, int]] = self.hello.filters or ((0, 0),)
        flags = self.hello.flags
        option = self.socket.setsockopt
        option(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"".join(_FILTER.pack(*pair) for pair in filters))
        option(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, _ALL_ERRORS if flags & Flags.ERRORS else 0)
        option(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, int(bool(flags & Flags.OWN)))

    def gone(self) -> BusGone:
        """Return the error that the end of the connection means."""
        return BusGone(errno.ECONNRESET, f"bus {self.address} is gone: its process ended")

    def failure(self, error: OSError) -> OSError:
        """Return the error that a failed system call means."""
        if error.errno == errno.ENETDOWN:
            name = self.address.name
            return BusDown(errno.ENETDOWN, f"bus {self.address}: the interface is down: sudo ip link set {name} up")
        if error.errno in (errno.ENODEV, errno.ENXIO):
            return BusGone(error.errno, f"bus {self.address} is gone: the interface was removed")
        if error.errno in (errno.ECONNRESET, errno.EPIPE, errno.ENOTCONN, errno.ECONNREFUSED):
            return self.gone()
        return error


def _open_socketcan(name: str) -> socket.socket:
    sock = None
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        sock.bind((name,))
    except OSError as error:
        if sock is not None:
            sock.close()
        remedies = {
            errno.ENODEV: f"there is no such interface; for a virtual one: sudo ip link add {name} type vcan && "
            f"sudo ip link set {name} up",
            errno.EAFNOSUPPORT: "this kernel has no SocketCAN: sudo modprobe can_raw",
            errno.EPROTONOSUPPORT: "this kernel has no raw CAN sockets: sudo modprobe can_raw",
            errno.ENETDOWN: f"the interface is down: sudo ip link set {name} up",
        }
        text = remedies.get(error.errno or 0, error.strerror or str(error))
        raise BusUnavailable(error.errno, f"bus socketcan:{name} cannot be opened: {text}") from None
    return sock
