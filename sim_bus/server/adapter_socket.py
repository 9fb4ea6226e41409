"""An adapter of python-can as the socket that the compiled loop reads: a thread copies frames both ways."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable
from functools import partial

from coulombus.wire.adapter import AdapterClient
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.client import CAN_FRAME, BusFull
from coulombus.wire.handshake import Hello
from coulombus.wire.recvmsg import ask_for_stamps

__all__ = ["AdapterSocket"]

LOOK_S = 0.1
RETRY_S = 1e-3


class AdapterSocket:
    """The socket `socket` of a bus behind an adapter; its other end closes when the adapter is gone.

    Attributes
    ----------
    gone : why the adapter is gone; "" while it is there

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no such adapter.
    """

    def __init__(self, address: BusAddress) -> None:
        self._client = AdapterClient(address, Hello())
        self.bitrate_bit_s = self._client.bitrate_bit_s
        self.gone = ""
        self.socket, self._far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ask_for_stamps(self.socket)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._copy, name="adapter's frames", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send what was written, and leave the adapter; may be called again."""
        self._stopped.set()
        self._thread.join()
        self.socket.close()
        self._far.close()
        self._client.close()

    def _copy(self) -> None:
        far, near = self._far.fileno(), self._client.fileno()
        try:
            while True:
                stopped = self._stopped.is_set()
                readable = select.select((far, near), (), (), 0 if stopped else LOOK_S)[0]
                if near in readable:
                    self._deliver()
                if far in readable:
                    if not (message := self._far.recv(1 << 16)):
                        return
                    self._try(partial(self._client.send, message))
                elif stopped:
                    return
        except BusUnavailable as error:
            self.gone = str(error)
            self._far.shutdown(socket.SHUT_RDWR)

    def _deliver(self) -> None:
        for _, can_id, length, data in self._client.receive():
            frame = CAN_FRAME.pack(can_id, length, data)
            self._try(partial(self._far.send, frame, socket.MSG_DONTWAIT))

    def _try(self, send: Callable[[], object]) -> None:
        """Send a frame; wait while there is no room, at most until the end."""
        while True:
            try:
                send()
                return
            except (BusFull, BlockingIOError):
                if self._stopped.wait(RETRY_S):
                    return
