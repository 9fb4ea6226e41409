"""A bus behind an adapter of python-can, ``can:slcan:/dev/ttyACM0``, and `open_bus` for every kind of bus.

A thread reads the adapter, whose own buffer may be small, into a bounded queue. Filters, own frames
and error frames have the meaning that they have on the other buses. python-can is imported when an
adapter is opened, and this module needs nothing of Linux.
"""

from __future__ import annotations

import difflib
import errno
import select
import socket
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.can_flags import CAN_ERR_FLAG
from coulombus.wire.client import CAN_FRAME, CAN_LENGTH, BusFull, BusGone, Client, Echo, OpenBus, Received
from coulombus.wire.error_frames import BUS_ERROR, CONTROLLER, RX_OVERFLOW
from coulombus.wire.handshake import Flags, Hello

if TYPE_CHECKING:
    import can

__all__ = ["ROOM", "AdapterClient", "open_bus"]

ROOM = 1 << 16
"""Frames that wait for the reader; those without room are lost, and counted."""
READ_S = 0.05
"""Longest wait for a frame: after it `close` is noticed."""
IDLE_S = 1e-3
"""Pause without a frame, for drivers that do not wait: python-can's socketcand, after its server's end."""
CLOSE_S = 2.0
"""Longest wait for a driver that is asked for a frame when the bus is closed."""
SKEW_NS, STALE_NS = 1_000_000_000, 60_000_000_000
"""A clock that is ahead of this PC's by more, or behind it, is not this PC's."""
LINUX_ERRORS = ("coulombus", "gs_usb", "socketcan", "socketcand")
"""Interfaces whose error frames have Linux's classes; another driver's identifier has a meaning of its own."""
PACKAGES = {"slcan": "serial", "robotell": "serial", "udp_multicast": "multicast", "gs_usb": "gs-usb"}
"""python-can's extra with the package that an interface needs, where it has another name."""
INVERTED = CAN_ERR_FLAG
"""Flag of a filter's identifier: the filter passes what does not match."""


def open_bus(address: BusAddress, hello: Hello | None = None, timeout: float = 2.0) -> OpenBus:
    """Open a bus of any kind.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no such bus, or no such adapter; the text says what to do.
    """
    return AdapterClient(address, hello) if address.is_adapter else Client(address, hello, timeout)


class AdapterClient(OpenBus):
    """A bus behind an adapter of python-can.

    Each frame has python-can's stamp. An adapter whose clock has a zero of its own is set to this PC's
    clock at its first frame; without any stamp a frame has the time of its reception.
    """

    def __init__(self, address: BusAddress, hello: Hello | None = None) -> None:
        super().__init__(address, hello)
        self._bus = _opened(address, own=bool(self.hello.flags & Flags.OWN))
        self.bitrate_bit_s = _bitrate(address, self._bus)
        self._linux_errors = address.name.partition(":")[0] in LINUX_ERRORS
        self._clock = AdapterClock()
        self._frames: deque[Received] = deque()
        self._dropped = 0
        self._failure: BusGone | None = None
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._readable, self._filled = socket.socketpair()  # readable while there is a frame, or the bus is gone
        self._thread = threading.Thread(target=self._read, name=f"adapter {address.name}", daemon=True)
        self._thread.start()

    @property
    def stamps(self) -> str:
        """Meaning of the stamps of the frames so far."""
        return self._clock.meaning

    def fileno(self) -> int:
        """Return the descriptor that is readable when `receive` has a frame."""
        return self._readable.fileno()

    def close(self) -> None:
        """Leave the bus; may be called again."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        self._thread.join(CLOSE_S)
        try:
            self._bus.shutdown()
        except Exception:  # of a driver whose adapter was unplugged
            if self._failure is None:
                raise
        finally:
            self._readable.close()
            self._filled.close()

    def wait(self, timeout: float | None) -> bool:
        """Wait at most `timeout` seconds (None: for ever) until a frame can be received."""
        return bool(select.select([self._readable], [], [], None if timeout is None else max(0.0, timeout))[0])

    def receive(self) -> list[Received]:
        """Return the frames that have come."""
        with self._lock:
            frames = list(self._frames)
            self._frames.clear()
            if frames and self._failure is None:
                self._readable.recv(1)
            self.lost = self._dropped + int(getattr(self._bus, "lost", 0))
        if not frames and self._failure is not None:
            raise self._failure
        return frames

    def send(self, message: bytes, stamp_ns: int = 0) -> None:
        """Send one frame; every failure but the adapter's end counts as a full queue."""
        import can

        from coulombus.wire.python_can_messages import message_of

        for can_id, length, data in CAN_FRAME.iter_unpack(message):
            try:
                self._bus.send(message_of(0.0, can_id, length, data, channel=self.address.name, is_rx=False), 0.0)
            except (can.CanError, OSError) as error:
                if self._failure is not None:
                    raise self._failure from error
                raise BusFull(self.address) from error

    def ask(self, hello: Hello | None = None) -> None:
        """Change the filters, or the error frames; `receive` itself brings `lost` up to date."""
        self.hello = hello or self.hello

    def _read(self) -> None:
        try:
            while not self._stopped.is_set():
                message = self._bus.recv(READ_S)
                if message is None:
                    self._stopped.wait(IDLE_S)
                    continue
                frame = self._frame(message)
                if frame is not None and passes(frame[1], self.hello):
                    self._put(frame)
        except Exception as error:  # a driver raises errors of its own
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            with self._lock:
                self._failure = BusGone(errno.ENODEV, f"bus {self.address} is gone: {reason}")
                if not self._frames:
                    self._filled.send(b"x")  # remains readable

    def _put(self, frame: Received) -> None:
        with self._lock:
            if len(self._frames) >= ROOM:
                self._dropped += 1
                return
            if not self._frames:
                self._filled.send(b"x")
            self._frames.append(frame)

    def _frame(self, message: can.Message) -> Received | None:
        """Return a message as a frame; None if it is none, or an own frame that is not to be heard."""
        from coulombus.wire.python_can_messages import can_id_of, data_of, is_classical

        stamp_ns = self._clock.ns(message.timestamp, time.time_ns())
        if not is_classical(message):
            self.malformed += 1
            return None
        data = data_of(message).ljust(CAN_LENGTH, b"\0")
        if message.is_error_frame:
            if not self._linux_errors:
                return stamp_ns, CAN_ERR_FLAG | BUS_ERROR, CAN_LENGTH, bytes(CAN_LENGTH)
            classes = message.arbitration_id & 0x1FFFFFFF
            if classes & CONTROLLER and data[1] & RX_OVERFLOW:
                self._dropped += 1  # at least one
            return stamp_ns, CAN_ERR_FLAG | classes, message.dlc, data
        frame = stamp_ns, can_id_of(message), message.dlc, data
        if message.is_rx:
            return frame
        return Echo(frame) if self.hello.flags & Flags.OWN else None


class AdapterClock:
    """Times of an adapter's stamps [ns since 1970].

    Attributes
    ----------
    meaning : of the stamps so far, for people
    """

    def __init__(self) -> None:
        self.meaning = "by python-can, from the adapter's clock, or this PC's where the adapter has none"
        self._offset_ns = 0
        self._latest_ns = SKEW_NS
        """Largest plausible delay: a first frame has just come, a later one may have waited."""

    def ns(self, stamp_s: float, now_ns: int) -> int:
        """Return the time of a stamp [s], read at `now_ns`; an adapter without a clock gives 0."""
        if not stamp_s:
            self.meaning = "this PC's clock at reception: the adapter gives none"
            return now_ns
        t_ns = round(stamp_s * 1e9) + self._offset_ns
        if not -SKEW_NS <= now_ns - t_ns <= self._latest_ns:
            self.meaning = "the adapter's clock, set to this PC's at its first frame"
            self._offset_ns += now_ns - t_ns
            t_ns = now_ns
        self._latest_ns = STALE_NS
        return t_ns


def passes(can_id: int, hello: Hello) -> bool:
    """Tell whether a client gets a frame, by SocketCAN's rules (`wire.handshake.Hello`)."""
    if can_id & CAN_ERR_FLAG:
        return bool(hello.flags & Flags.ERRORS)
    return not hello.filters or any(
        (can_id & mask == identifier & mask & ~INVERTED) != bool(identifier & INVERTED)
        for identifier, mask in hello.filters
    )


def _opened(address: BusAddress, *, own: bool) -> can.BusABC:
    """Return python-can's bus; its configuration files fill what the address does not say."""
    import can
    from can.util import cast_from_string

    interface, _, channel = address.name.partition(":")
    unavailable = f"bus {address} cannot be opened: "
    if interface not in can.VALID_INTERFACES:
        near = difflib.get_close_matches(interface, sorted(can.VALID_INTERFACES), 1, 0.6)
        meant = f"did you mean can:{near[0]}{address.name[len(interface) :]}? " if near else ""
        raise BusUnavailable(
            f"{unavailable}python-can has no interface {interface!r}; {meant}It has "
            f"{', '.join(sorted(can.VALID_INTERFACES))}"
        )
    options: dict[str, Any] = {key: cast_from_string(value) for key, value in address.options}
    options |= {"receive_own_messages": True} if own else {}
    try:
        return can.Bus(interface=interface, channel=channel or None, **options)
    except (can.CanInterfaceNotImplementedError, ImportError) as error:
        package = f"pip install 'python-can[{PACKAGES.get(interface, interface)}]'"
        reason = f"{_sentence(error)}; install what python-can's interface {interface} needs: {package}, or its driver"
    except TypeError as error:
        reason = f"{_sentence(error)}; give the channel, can:{interface}:CHANNEL, or the option: --bus-option KEY=VALUE"
    except (AttributeError, NameError, OSError) as error:
        reason = f"{_sentence(error)}; is the adapter there, and may you open it? Its driver may be missing, too"
    except Exception as error:  # a driver raises errors of its own
        hint = "; is the channel right, is the adapter there and free, and its driver installed?"
        reason = _sentence(error) + ("" if interface == "coulombus" else hint)
    raise BusUnavailable(unavailable + reason)


def _sentence(error: Exception) -> str:
    """Return an error's text in one line, without a full stop."""
    return " ".join(str(error).split()).rstrip(".;") or type(error).__name__


def _bitrate(address: BusAddress, bus: can.BusABC) -> int:
    """Return the bit rate that the bus reports, or that it was opened with; 0: unknown."""
    reported = getattr(bus, "bitrate_bit_s", 0) or dict(address.options).get("bitrate", 0)
    return int(reported) if str(reported).isdecimal() else 0
