"""python-can interface of a virtual bus: ``can.Bus(interface="coulombus", channel="bench")``.

Every python-can program can attach: can_viewer, can_logger, can_player, cantools monitor,
canopen. python-can finds the interface by the entry point ``can.interface``.
"""

from __future__ import annotations

import logging
import os
import select
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import can
from can.bus import BusState
from can.typechecking import AutoDetectedConfig, CanFilters

from coulombus.wire import error_frames
from coulombus.wire.address import AddressError, BusAddress, BusUnavailable, live_bus_names, parse_address
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG
from coulombus.wire.client import BusDown, BusFull, Client, Echo, Received, pack_frame
from coulombus.wire.controller_state import BUS_OFF
from coulombus.wire.handshake import MAX_FILTERS, Flags, Hello
from coulombus.wire.python_can_messages import can_id_of, data_of, is_classical, message_of

__all__ = ["CoulombusBus"]

_log = logging.getLogger(__name__)


class CoulombusBus(can.BusABC):
    """A python-can bus on a virtual bus of this project, which ``coulombus emulate`` provides.

    Parameters
    ----------
    channel
        The bus's name: ``bench`` or ``coulombus:bench``.
    can_filters
        As in python-can; the bus itself applies them.
    receive_own_messages
        Also deliver the frames sent here, after they have been on the wire.
    listen_only
        Send nothing; ``state = BusState.PASSIVE`` has the same effect.
    ignore_rx_error_frames
        Receive no error frames.
    bitrate
        Compared with the bus's own bit rate only.
    timeout
        Seconds to wait for the bus to answer.

    Raises
    ------
    can.CanInitializationError
        No such bus; the text says how to start it.
    """

    def __init__(
        self,
        channel: Any = None,
        can_filters: CanFilters | None = None,
        receive_own_messages: bool = False,
        listen_only: bool = False,
        ignore_rx_error_frames: bool = False,
        bitrate: int | None = None,
        fd: bool = False,
        timeout: float = 2.0,
        **kwargs: Any,
    ) -> None:
        if fd:
            raise can.CanInitializationError("the virtual bus carries classical CAN frames only: leave fd out")
        address = _address(channel)
        flags = Flags(0)
        for is_set, flag in (
            (receive_own_messages, Flags.OWN),
            (listen_only, Flags.LISTEN_ONLY),
            (not ignore_rx_error_frames, Flags.ERRORS),
        ):
            if is_set:
                flags |= flag
        try:
            self._client = Client(address, Hello(flags, _packed(can_filters)), timeout)
        except BusUnavailable as error:
            raise can.CanInitializationError(str(error), error.errno) from None
        except AddressError as error:
            raise can.CanInitializationError(str(error)) from None
        self.channel = address.name
        self.channel_info = str(address)
        self._gone = False
        self._waiting: deque[Received] = deque()
        # select() must report the descriptor readable while frames of a message wait here. So it is an epoll
        # descriptor: of the socket, and of an eventfd that is set as long as `_waiting` is not empty.
        self._more = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._readable = select.epoll()
        self._readable.register(self._client.fileno(), select.EPOLLIN)
        self._readable.register(self._more, select.EPOLLIN)
        bus_bitrate = self._client.bitrate_bit_s
        if bitrate and bus_bitrate and int(bitrate) != bus_bitrate:
            _log.warning("%s runs at %d bit/s, not at the %s asked for", address, bus_bitrate, bitrate)
        super().__init__(channel=address.name, can_filters=can_filters)

    @property
    def bitrate_bit_s(self) -> int:
        """Bit rate of the bus; 0 if it has none."""
        return self._client.bitrate_bit_s

    @property
    def lost(self) -> int:
        """Number of frames that this client lost by not reading, as of the bus's last answer."""
        return self._client.lost

    def fileno(self) -> int:
        """Return a descriptor for select() and asyncio: readable as long as `recv` has a frame."""
        return -1 if self._readable.closed else self._readable.fileno()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._waiting:
            self._fetch(timeout)
        if not self._waiting:
            return None, False
        received = self._waiting.popleft()
        stamp, can_id, length, data = received
        if not self._waiting and self._marked:
            self._marked = False
            os.eventfd_read(self._more)
        error = bool(can_id & CAN_ERR_FLAG)
        if error and data[5] == self._client.station & 0xFF:
            self._off = bool(can_id & error_frames.BUS_OFF) or (self._off and not can_id & error_frames.RESTARTED)
        is_rx = not isinstance(received, Echo)
        message = message_of(stamp / 1e9, can_id, length, data, channel=self.channel, is_rx=is_rx)
        # frames that pass the old filters still come until the bus has applied new filters
        return message, error or (self._filtered and not self._client.unanswered)

    _marked = False
    _off = False
    _filtered = True

    def _fetch(self, timeout: float | None) -> None:
        self._refuse_when_shut()
        if self._gone:
            raise can.CanOperationError(f"bus {self._client.address} is gone")
        if not self._receive() and (timeout is None or timeout > 0) and self._readable.poll(timeout, 1):
            self._receive()

    def _receive(self) -> bool:
        """Receive one message; return whether it held frames."""
        try:
            frames = self._client.receive()
        except BusUnavailable as error:
            self._gone = not isinstance(error, BusDown)
            raise can.CanOperationError(str(error), error.errno) from None
        except (OSError, ValueError) as error:  # another thread has closed the socket
            self._gone = True
            raise can.CanOperationError(f"bus {self._client.address}: {error}") from None
        self._waiting.extend(frames)
        if len(self._waiting) > 1 and not self._marked:
            self._marked = True
            os.eventfd_write(self._more, 1)
        return bool(frames)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; wait up to `timeout` seconds (None: 0, as in socketcan) for the bus to accept it.

        Raises
        ------
        can.CanOperationError
            The bus does not accept the frame or is gone, or this client is listen-only.
        """
        self._refuse_when_shut()
        if not is_classical(msg):
            raise can.CanOperationError("the virtual bus carries classical CAN frames only: at most 8 data bytes")
        if self._client.hello.flags & Flags.LISTEN_ONLY:
            raise can.CanOperationError(f"bus {self._client.address} was opened to listen only: nothing is sent")
        if msg.is_error_frame:
            raise can.CanOperationError("an error frame is the bus's own message and cannot be sent")
        bits = 29 if msg.is_extended_id else 11
        if not 0 <= msg.arbitration_id < 1 << bits:
            hint = "" if msg.is_extended_id else "; set is_extended_id for one of 29 bits"
            raise can.CanOperationError(f"identifier {msg.arbitration_id:#x} has more than {bits} bits{hint}")
        frame = pack_frame(can_id_of(msg), data_of(msg), msg.dlc)
        deadline = time.monotonic() + (timeout or 0.0)
        while True:
            try:
                return self._client.send(frame)
            except BusFull as error:
                if time.monotonic() >= deadline:
                    raise can.CanOperationError(str(error), error.errno) from None
                time.sleep(1e-3)
            except OSError as error:
                raise can.CanOperationError(str(error), error.errno) from None

    def send_periodic(self, *arguments: Any, **options: Any) -> can.broadcastmanager.CyclicSendTaskABC:
        """Send frames periodically from a thread, as in python-can."""
        self._refuse_when_shut()
        return super().send_periodic(*arguments, **options)

    def _refuse_when_shut(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError(f"bus {self._client.address} was shut down here; open it again with can.Bus")

    def _apply_filters(self, filters: CanFilters | None) -> None:
        packed = _packed(filters)
        self._filtered = not filters or bool(packed)
        if packed != self._client.hello.filters:
            self._ask(Hello(self._client.hello.flags, packed))

    def _ask(self, hello: Hello) -> None:
        self._refuse_when_shut()
        try:
            self._client.ask(hello)
        except OSError as error:
            raise can.CanOperationError(str(error), error.errno) from None

    def details(self, timeout: float = 1.0) -> str:
        """Request the state and counters of this client's controller; return the text that
        ``ip -details -statistics link show`` prints.

        Raises
        ------
        can.CanOperationError
            The bus does not answer within `timeout` seconds, or does not report a controller.
        """
        self._ask(self._client.hello)
        deadline = time.monotonic() + timeout
        while self._client.unanswered and time.monotonic() < deadline:
            if self._client.wait(0.01):
                self._receive()
        if self._client.unanswered or self._client.controller is None:
            raise can.CanOperationError(f"bus {self._client.address} does not report its controllers")
        self._off = self._client.controller.state == BUS_OFF
        return str(self._client.controller)

    @property
    def state(self) -> BusState:
        """PASSIVE: listen-only; ERROR: the bus is gone, or this controller was last reported in bus-off;
        else ACTIVE.
        """
        if self._gone or self._off:
            return BusState.ERROR
        return BusState.PASSIVE if self._client.hello.flags & Flags.LISTEN_ONLY else BusState.ACTIVE

    @state.setter
    def state(self, new_state: BusState) -> None:
        hello = self._client.hello
        if new_state is BusState.ERROR:
            raise ValueError("a bus cannot be put into the state ERROR; expected ACTIVE or PASSIVE (listen only)")
        quiet = Flags.LISTEN_ONLY if new_state is BusState.PASSIVE else Flags(0)
        self._ask(Hello(hello.flags & ~Flags.LISTEN_ONLY | quiet, hello.filters))

    def flush_tx_buffer(self) -> None:
        """Do nothing: sent frames already belong to the bus."""

    def shutdown(self) -> None:
        """Stop the periodic tasks and leave the bus; may be called again."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._readable.close()
        self._client.close()
        if self._more >= 0:
            os.close(self._more)
            self._more = -1

    @staticmethod
    def _detect_available_configs() -> Sequence[AutoDetectedConfig]:
        return [AutoDetectedConfig(interface="coulombus", channel=name) for name in live_bus_names()]


def _address(channel: Any) -> BusAddress:
    text = "" if channel is None else str(channel)
    try:
        address = parse_address(text if ":" in text else f"coulombus:{text}")
    except AddressError as error:
        running = ", ".join(live_bus_names()) or "none; start one with `coulombus emulate`"
        raise can.CanInitializationError(f"{error} (virtual buses here: {running})") from None
    if address.kind != "coulombus":
        raise can.CanInitializationError(
            f"{address}: use python-can's own interface for it: -i socketcan -c {address.name}"
        )
    return address


def _packed(filters: CanFilters | None) -> tuple[tuple[int, int], ...]:
    """Return python-can's filters as (identifier, mask) of SocketCAN; empty if there are more than a bus
    accepts.
    """
    pairs = []
    for filter_ in filters or ():
        can_id, mask = filter_["can_id"], filter_["can_mask"]
        if "extended" in filter_:
            mask |= CAN_EFF_FLAG
            can_id |= CAN_EFF_FLAG if filter_["extended"] else 0
        pairs.append((can_id & 0xFFFFFFFF, mask & 0xFFFFFFFF))
    return tuple(pairs) if len(pairs) <= MAX_FILTERS else ()
