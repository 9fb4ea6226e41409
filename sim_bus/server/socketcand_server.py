"""The server's end of a bridge: other programs join the bus by TCP, with the protocol of socketcand.

python-can's interface `socketcand`, SavvyCAN, Kayak and others speak it. This is the subset that they
use of a bus in raw mode; elements have spaces between their words, and need none between each other::

    server -> client  < hi >   < ok >   < echo >   < error TEXT >
                      < frame 123 SECONDS.MICROSECONDS 1122 >   < rtr 123 SECONDS.MICROSECONDS 8 >
    client -> server  < open NAME >   < rawmode >   < echo >
                      < send 123 2 11 22 >   < sendrtr 123 8 >

An identifier of eight digits is extended. Any NAME is this one bus. There is no password: a program
that reaches the port can send to the bus.

A client hears the other clients, too, with the time at which the server has read the frame. Nobody
waits for a client that does not read: beyond `BACKLOG_BYTES` it is dropped. A client that sends more
than the bus carries waits by TCP's own means (`hold`).
"""

from __future__ import annotations

import ipaddress
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_RTR_FLAG
from coulombus.wire.client import CAN_FRAME, CAN_LENGTH, OpenBus, Received

__all__ = ["BACKLOG_BYTES", "MOST_CLIENTS", "SocketcandServer"]

MOST_CLIENTS = 16
READ_BYTES = 1024
"""Of a client at a time: half a bridge's queue has room for all clients' frames."""
ELEMENT_BYTES = 256
"""Longest element; python-can's longest has 45 bytes."""
BACKLOG_BYTES = 1 << 20
"""Bytes that wait for a client: some 25,000 frames."""
SETTLE_S = 0.05
"""Frames begin so long after the answer to rawmode, which python-can expects alone in a packet."""


@dataclass
class _Remote:
    """A connected client."""

    socket: socket.socket
    name: str
    raw: bool = False
    coming: bytes = b""
    going: bytearray = field(default_factory=bytearray)
    frames_from_s: float = 0.0


class SocketcandServer(OpenBus):
    """A bus of the programs at a TCP port; `malformed` counts elements that are none.

    Parameters
    ----------
    address : ``socketcand:HOST:PORT``; port 0 is a free one, which `address` has afterwards
    say : called with each line for people: a client that came, went or was dropped

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        The port is taken, or HOST is no address of this machine.
    """

    def __init__(self, address: BusAddress, say: Callable[[str], None] = lambda text: None) -> None:
        host, _, port = address.name.rpartition(":")
        try:
            family, _, _, _, place = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
            self._listener = socket.create_server(place[:2], family=family, backlog=MOST_CLIENTS)
        except OSError as error:
            text = f"bus {address} cannot be served: {error.strerror or error}; choose another port, or an address here"
            raise BusUnavailable(error.errno, text) from None
        super().__init__(BusAddress("socketcand", f"{host}:{self._listener.getsockname()[1]}"))
        self._say = say
        self._remotes: dict[int, _Remote] = {}
        self._held = False
        self._listener.setblocking(False)
        self._ready = select.epoll()
        self._ready.register(self._listener, select.EPOLLIN)
        if not ipaddress.ip_address(place[0]).is_loopback:
            say(f"warning: {self.address} has no password: a program that reaches this port can send to the bus")

    def fileno(self) -> int:
        """Return the descriptor that is readable when a client wants something."""
        return self._ready.fileno()

    def close(self) -> None:
        """Send what can be sent, and close all connections."""
        for remote in list(self._remotes.values()):
            with suppress(OSError):
                remote.socket.send(remote.going)
            remote.socket.close()
        self._remotes.clear()
        self._listener.close()
        self._ready.close()

    def wait(self, timeout: float | None) -> bool:
        """Wait at most `timeout` seconds (None: for ever) until a client wants something."""
        return bool(select.select([self._ready], [], [], timeout)[0])

    def receive(self) -> list[Received]:
        """Return the frames that clients have sent, each of which the other clients get, too."""
        frames: list[Received] = []
        for fd, events in self._ready.poll(0):
            if fd == self._listener.fileno():
                self._accept()
                continue
            remote = self._remotes.get(fd)
            if remote is None:  # dropped while another client was served
                continue
            if events & (select.EPOLLIN | select.EPOLLHUP | select.EPOLLERR):
                frames += self._read(remote)
            if events & select.EPOLLOUT and fd in self._remotes:
                self._flush(remote)
        return frames

    def send(self, message: bytes, stamp_ns: int = 0) -> None:
        """Give a frame of the bus to each client, with its stamp [ns since 1970]; never blocks."""
        for frame in CAN_FRAME.iter_unpack(message):
            self._give(element(stamp_ns or time.time_ns(), *frame))

    def ask(self, hello: object = None) -> None:
        """Send what waited for a client to settle; there are no flags and filters."""
        for remote in list(self._remotes.values()):
            self._flush(remote)

    def hold(self, held: bool) -> None:
        """Read no client while held."""
        if held != self._held:
            self._held = held
            for remote in self._remotes.values():
                self._watch(remote)

    def _accept(self) -> None:
        with suppress(OSError):  # it has gone already, or no descriptor is left
            connection, place = self._listener.accept()
            name = f"{place[0]}:{place[1]}"
            if len(self._remotes) >= MOST_CLIENTS:
                connection.close()
                self._say(f"{name} was refused: {MOST_CLIENTS} clients are connected")
                return
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            remote = self._remotes[connection.fileno()] = _Remote(connection, name)
            self._ready.register(connection, 0)
            self._say(f"{name} has joined")
            self._answer(remote, b"< hi >")

    def _read(self, remote: _Remote) -> list[Received]:
        """Return the frames that a client has sent; drop it if it has gone."""
        try:
            content = remote.socket.recv(READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return []
        except OSError:
            content = b""
        if not content:
            self._drop(remote, "has left")
            return []
        frames = []
        *elements, remote.coming = (remote.coming + content).split(b">")
        if len(remote.coming) > ELEMENT_BYTES:
            remote.coming = b""
            self.malformed += 1
        for text in elements:
            frame = self._obey(remote, text)
            if frame is not None:
                frames.append(frame)
                self._give(element(*frame), beside=remote)
        return frames

    def _obey(self, remote: _Remote, text: bytes) -> Received | None:
        """Process an element, without its last character; return the frame that it sends."""
        before, _, inside = text.rpartition(b"<")
        words = inside.split()
        if before.strip() or not words or len(inside) > ELEMENT_BYTES:
            self.malformed += 1
        elif words[0] in (b"open", b"rawmode"):
            if words[0] == b"rawmode":
                remote.raw, remote.frames_from_s = True, time.monotonic() + SETTLE_S
            self._answer(remote, b"< ok >")
        elif words == [b"echo"]:
            self._answer(remote, b"< echo >")
        elif words[0] in (b"send", b"sendrtr"):
            frame = sent_frame(words)
            if frame is not None:
                return (time.time_ns(), *frame)
            self.malformed += 1
        else:
            self.malformed += 1
            self._answer(remote, b"< error unknown command >")
        return None

    def _give(self, text: bytes, beside: _Remote | None = None) -> None:
        """Send an element to all clients in raw mode, except `beside`."""
        for remote in list(self._remotes.values()):
            if remote.raw and remote is not beside:
                remote.going += text
                self._flush(remote)

    def _answer(self, remote: _Remote, text: bytes) -> None:
        """Send an answer; what else goes to a client that settles comes after it."""
        remote.going += text
        self._flush(remote, settled=True)

    def _flush(self, remote: _Remote, *, settled: bool = False) -> None:
        if remote.going and (settled or time.monotonic() >= remote.frames_from_s):
            try:
                del remote.going[: remote.socket.send(remote.going)]
            except (BlockingIOError, InterruptedError):
                pass
            except OSError:
                self._drop(remote, "has left")
                return
        if len(remote.going) > BACKLOG_BYTES:
            self._drop(remote, f"was dropped: it does not read, and {BACKLOG_BYTES >> 20} MB wait for it")
            return
        self._watch(remote)

    def _watch(self, remote: _Remote) -> None:
        """Wait for what a client may want: to send, unless held, and to read, if something waits for it."""
        waiting = remote.going and time.monotonic() >= remote.frames_from_s
        self._ready.modify(remote.socket, (0 if self._held else select.EPOLLIN) | (select.EPOLLOUT if waiting else 0))

    def _drop(self, remote: _Remote, why: str) -> None:
        if self._remotes.pop(remote.socket.fileno(), None) is not None:
            self._ready.unregister(remote.socket)
            remote.socket.close()
            self._say(f"{remote.name} {why}")


def element(stamp_ns: int, can_id: int, length: int, data: bytes) -> bytes:
    """Return a frame as a client reads it; an empty frame keeps the space before its data."""
    number = f"{can_id & 0x1FFFFFFF:08X}" if can_id & CAN_EFF_FLAG else f"{can_id & 0x7FF:03X}"
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    head = f"{number} {seconds}.{rest_ns // 1000:06d}"
    if can_id & CAN_RTR_FLAG:
        return f"< rtr {head} {length} >".encode()
    return f"< frame {head} {data[:length].hex().upper()} >".encode()


def sent_frame(words: list[bytes]) -> tuple[int, int, bytes] | None:
    """Return the frame of ``send ID LENGTH DATA...`` or ``sendrtr ID LENGTH``; None if it is none."""
    try:
        number, length, *data = words[1:]
        can_id, size = int(number, 16), int(length)
        content = bytes(int(byte, 16) for byte in data)
    except ValueError:
        return None
    remote, extended = words[0] == b"sendrtr", len(number) == 8
    if not 0 <= size <= CAN_LENGTH or len(content) != (0 if remote else size):
        return None
    if not 0 <= can_id <= (0x1FFFFFFF if extended else 0x7FF):
        return None
    flags = (CAN_EFF_FLAG if extended else 0) | (CAN_RTR_FLAG if remote else 0)
    return can_id | flags, size, content.ljust(CAN_LENGTH, b"\0")
