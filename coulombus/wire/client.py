"""A client of a bus of either kind: a non-blocking socket on which
messages of 16-byte ``struct can_frame`` come and go.

No numba and no python-can in here: a script or a viewer starts at once.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
from collections.abc import Sequence
from typing import TypeAlias

from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.ancillary import SO_RXQ_OVFL, SO_TIMESTAMPNS
from coulombus.wire.controller_state import ControllerState
from coulombus.wire.handshake import Answer, BusStatus, Flags, Hello, greet, is_greeting

__all__ = ["CAN_FRAME", "BusDown", "BusFull", "BusGone", "Client", "Echo", "Received", "pack_frame"]

CAN_FRAME = struct.Struct("=IB3x8s")
"""Identifier with EFF, RTR and ERR flags; length; data."""

Received: TypeAlias = tuple[int, int, int, bytes]
"""Stamp [ns since 1970], identifier with flags, length, eight data bytes."""


class Echo(tuple[int, int, int, bytes]):
    """A `Received` that this client has sent itself, back from the wire
    (`wire.handshake.Flags.OWN`).
    """

    __slots__ = ()


MESSAGE_BYTES = 1 << 16
CAN_LENGTH = 8
ECHO_BYTE = 5
"""The first padding byte of struct can_frame, which a virtual bus
sets in a client's own frames, as Linux sets MSG_CONFIRM.
"""
MSG_CONFIRM = 0x800
CAN_RAW_ERR_FILTER = 2
_TIMESPEC = struct.Struct("=qq") if struct.calcsize("@l") == 8 else struct.Struct("=ll")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(4)
_FILTER = struct.Struct("=II")
_ALL_ERRORS = 0x1FFFFFFF


class BusGone(BusUnavailable):
    """The bus went away: its process ended, or the interface was removed."""


class BusDown(BusUnavailable):
    """The interface is down; reading may go on when it is up again."""


class BusFull(OSError):
    """The send queue is full: nobody reads, or more is sent than the bus carries."""

    def __init__(self, address: BusAddress) -> None:
        super().__init__(errno.ENOBUFS, f"bus {address}: the send queue is full: more is sent than the bus carries")


def pack_frame(can_id: int, data: bytes = b"", length: int | None = None) -> bytes:
    """Return the 16 bytes of a frame; `length` only for a remote
    frame, which asks for so many bytes and carries none.
    """
    return CAN_FRAME.pack(can_id, len(data) if length is None else length, data)


class Client:
    """Frames from and to a bus; nothing here blocks but the constructor, `timeout` seconds at most.

    Attributes
    ----------
    bitrate_bit_s, station
        What a virtual bus told; 0 on SocketCAN, whose bit rate is the interface's own affair.
    lost
        Frames that found no place in this client's receive queue. A
        virtual bus tells it with each answer (`ask`).
    malformed
        Messages and frames that were dropped because they are none.
    controller
        This client's CAN controller, as of the bus's last answer; None where the bus does not tell.

    Raises
    ------
    BusUnavailable
        No such bus; BusGone, BusDown later on.
    """

    def __init__(self, address: BusAddress, hello: Hello | None = None, timeout: float = 2.0) -> None:
        self.address = address
        self.hello = hello or Hello()
        self.bitrate_bit_s = self.station = self.lost = self.malformed = 0
        self.unanswered = 0
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
        """Return the socket's descriptor, which is readable when `receive` has something."""
        return self.socket.fileno()

    def close(self) -> None:
        """Leave the bus; may be called again."""
        self.socket.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self, timeout: float | None) -> bool:
        """Wait until something can be received, `timeout` seconds at most (None: for ever)."""
        poll = select.poll()
        poll.register(self.socket, select.POLLIN)
        return bool(poll.poll(None if timeout is None else max(0.0, timeout * 1e3)))

    def receive(self) -> list[Received]:
        """Return the frames of the next message; none when there is
        no message, or when it was the bus's answer.
        """
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
            own = self._own(message, flags)
            frames = [Echo(frame) if echo else frame for frame, echo in zip(frames, own, strict=True)]
        if any(frame[2] > CAN_LENGTH for frame in frames):
            good = [frame for frame in frames if frame[2] <= CAN_LENGTH]
            self.malformed += len(frames) - len(good)
            return good
        return frames

    def send(self, message: bytes) -> None:
        """Send one message of frames (`pack_frame`); on SocketCAN of one frame.

        Raises
        ------
        BusFull
            Nothing was sent; try again later.
        BusUnavailable
            It is gone or down.
        """
        try:
            self.socket.send(message)
        except (BlockingIOError, InterruptedError):
            raise BusFull(self.address) from None
        except OSError as error:
            if error.errno == errno.ENOBUFS:
                raise BusFull(self.address) from None
            raise self.failure(error) from None

    def ask(self, hello: Hello | None = None) -> None:
        """Change flags and filters, or (without `hello`) only ask how many frames were lost.

        A virtual bus answers among the frames, and `receive` takes
        the answer; `unanswered` counts those under way.
        """
        if hello is not None:
            self.hello = hello
        if self.address.kind == "socketcan":
            self._configure_socketcan()
            return
        self.send(self.hello.pack())
        self.unanswered += 1

    def _own(self, message: memoryview, flags: int) -> Sequence[int]:
        """Tell of each frame of a message whether this client has sent it."""
        if self.address.kind == "socketcan":
            return (flags & MSG_CONFIRM,)
        return message[ECHO_BYTE :: CAN_FRAME.size]

    def take_other(self, message: bytes) -> None:
        """Take a message that is none of frames: the bus' answer, or rubbish, which is counted."""
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
        """Return what the end of the connection means."""
        return BusGone(errno.ECONNRESET, f"bus {self.address} is gone: its process ended")

    def failure(self, error: OSError) -> OSError:
        """Return what a failed system call means."""
        if error.errno == errno.ENETDOWN:
            name = self.address.name
            return BusDown(errno.ENETDOWN, f"bus {self.address}: the interface is down: sudo ip link set {name} up")
        if error.errno in (errno.ENODEV, errno.ENXIO):
            return BusGone(error.errno, f"bus {self.address} is gone: the interface was removed")
        if error.errno in (errno.ECONNRESET, errno.EPIPE, errno.ENOTCONN, errno.ECONNREFUSED):
            return self.gone()
        return error


def _open_socketcan(name: str) -> socket.socket:
    made = None
    try:
        made = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        made.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        made.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        made.bind((name,))
    except OSError as error:
        if made is not None:
            made.close()
        remedies = {
            errno.ENODEV: f"there is no such interface; for a virtual one: sudo ip link add {name} type vcan && "
            f"sudo ip link set {name} up",
            errno.EAFNOSUPPORT: "this kernel has no SocketCAN: sudo modprobe can_raw",
            errno.EPROTONOSUPPORT: "this kernel has no raw CAN sockets: sudo modprobe can_raw",
            errno.ENETDOWN: f"the interface is down: sudo ip link set {name} up",
        }
        text = remedies.get(error.errno or 0, error.strerror or str(error))
        raise BusUnavailable(error.errno, f"bus socketcan:{name} cannot be opened: {text}") from None
    return made
