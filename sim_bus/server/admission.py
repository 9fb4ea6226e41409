"""Admission of clients to a virtual bus: slots, handshake, and clean-up when a client leaves."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from contextlib import ExitStack, suppress

import numpy as np

from coulombus.kernels.records import RecordArray, new_records
from coulombus.sim_bus.can_bus.cable_cut import SEVERAL, wire_of
from coulombus.sim_bus.can_bus.fault_confinement import state_of
from coulombus.sim_bus.can_bus.stations import attach, detach
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.clients import BATCH, MESSAGE_FRAMES, SLOTS, STATION, Clients, SlotState
from coulombus.sim_bus.server.records import SLOT, PaceRecord, SlotRecord
from coulombus.sim_bus.server.sim_result import SimResult
from coulombus.sim_bus.server.socket_file import peer
from coulombus.wire.address import BusUnavailable
from coulombus.wire.handshake import MAX_FILTERS, SEND_BUFFER, Answer, BusStatus, Flags, Hello
from coulombus.wire.recvmsg import Mailbox, ask_for_stamps, set_up

__all__ = ["Admission"]

LOSERS_TOLD = 20
MUTE_S = 2.0
"""Longest time for a client's greeting if others wait for its slot."""
SO_SNDBUFFORCE = 32


class Admission:
    """Slots of a server's clients, and their sockets.

    Parameters
    ----------
    name : of the bus or the buses, for messages
    bit_rate : of the bus; the answer to a greeting contains it
    world : network in which the clients are stations
    pace : the loop's record; its `listener` is -1 while no client can be accepted
    result : counts of the clients
    """

    def __init__(
        self,
        name: str,
        bit_rate: int,
        world: VirtualNetwork,
        pace: RecordArray[PaceRecord],
        result: SimResult,
    ) -> None:
        self._name, self._bit_rate, self._world, self._pace, self._result = name, bit_rate, world, pace, result
        self.listeners: tuple[socket.socket, ...] = ()
        self._door: socket.socket | select.epoll | None = None  # readable if a client waits at a listener
        rows = SLOTS + 1  # the last row serves a client that gets the answer "bus full"
        self.slots = new_records(SlotRecord, rows)
        self.slots["fd"] = -1
        self._words = np.zeros((rows, 2 * MESSAGE_FRAMES), np.int64)
        self._boxes = new_records(Mailbox, rows)
        for i in range(rows):
            set_up(self._boxes[i : i + 1], self._words[i])
        self._filters = np.zeros((rows, MAX_FILTERS, 2), np.int64)
        batches = np.zeros((rows, 2 * BATCH), np.int64)
        pollfds = np.zeros(rows + 2, np.int64)
        self.clients = Clients(self.slots, self._boxes, self._words, self._filters, batches, pollfds)
        """The same slots for the compiled loop."""
        self.sockets: dict[int, socket.socket] = {}
        self._pids: dict[int, int] = {}
        self._since: dict[int, float] = {}
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)  # for a client when no other descriptor is left

    def listen(self, *listeners: socket.socket) -> None:
        """Accept clients from a listener for each bus; they are closed together with the slots."""
        self.listeners = listeners
        self._door = listeners[0]
        if len(listeners) > 1:
            self._door = select.epoll()
            for listener in listeners:
                self._door.register(listener, select.EPOLLIN)
        self._pace["listener"] = self._door.fileno()

    def accept(self) -> None:
        """Assign a slot to the client that waits at a listener."""
        if not isinstance(self._door, select.epoll):
            self._accept(0)
            return
        ready = {fd for fd, _ in self._door.poll(0)}
        for bus, listener in enumerate(self.listeners):
            if listener.fileno() in ready:
                self._accept(bus)

    def _accept(self, bus: int) -> None:
        listener = self.listeners[bus]
        place = self._place()
        if place is None:  # no slot even for a refusal: let it wait
            self._pace["listener"] = -1
            return
        try:
            client, _ = listener.accept()
        except (BlockingIOError, ConnectionAbortedError):  # the client has gone already
            return
        except OSError as error:
            if error.errno not in (errno.EMFILE, errno.ENFILE):
                raise BusUnavailable(f"bus {self._name}: no further client can be accepted: {error.strerror}") from None
            self._turn_away(listener)
            return
        try:
            client.setblocking(False)
            try:
                client.setsockopt(socket.SOL_SOCKET, SO_SNDBUFFORCE, SEND_BUFFER)
            except PermissionError:
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            ask_for_stamps(client)
            self.admit(place, client, SlotState.GREETING, bus)
        except BaseException as error:
            with ExitStack() as left:
                left.callback(client.close)
                if self.sockets.get(place) is client:
                    self.part(place)
            if not isinstance(error, OSError):  # a socket that cannot be set up affects no other client
                raise

    def _turn_away(self, listener: socket.socket) -> None:
        """Out of descriptors: accept with the spare one and close.

        A pending client would wake poll() for ever.
        """
        os.close(self._spare)
        try:
            client, _ = listener.accept()
            with client, suppress(OSError):
                client.send(Answer(BusStatus.FULL).pack())
        except BlockingIOError:
            pass
        except OSError as error:
            raise BusUnavailable(f"bus {self._name}: no further client can be accepted: {error.strerror}") from None
        finally:
            self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)

    def _place(self) -> int | None:
        """Return a free slot.

        If clients have none left, a client that connected without greeting is turned away.
        """
        free = np.flatnonzero(self.slots["state"] == SlotState.FREE)
        if len(free) and free[0] < SLOTS:
            return int(free[0])
        mute = [i for i in self.sockets if self.slots[i]["state"] == SlotState.GREETING]  # in order of arrival
        mute.sort(key=lambda i: i == SLOTS)  # the slot for refusals comes last
        before = time.monotonic() - MUTE_S
        for i in [i for i in mute if self._since[i] < before] or ([] if len(free) else mute[:1]):
            self.part(i)
        free = np.flatnonzero(self.slots["state"] == SlotState.FREE)
        return int(free[0]) if len(free) else None

    def admit(self, i: int, client: socket.socket, state: SlotState, bus: int = 0) -> None:
        """Assign the slot `i` to a client of a bus, with all counters at 0."""
        if self._world.bus[0].cut == SEVERAL:
            self._world.place(STATION + i, bus)
        self.sockets[i], self._since[i] = client, time.monotonic()
        self.slots[i : i + 1] = np.zeros(1, SLOT)
        self.slots[i]["fd"], self.slots[i]["state"] = client.fileno(), state
        self._boxes[i]["overflow"] = 0
        if state is SlotState.GREETING:
            self._pids[i] = peer(client).pid

    def greeted(self, i: int) -> None:
        """Answer a greeting, the first or a later one.

        A client without a first greeting is turned away.
        """
        slot = self.slots[i]
        message = self._words[i].tobytes()[: int(self._pace["message_bytes"][0])]
        hello = Hello.unpack(message)
        status = hello if isinstance(hello, BusStatus) else BusStatus.OK
        first = slot["state"] == SlotState.GREETING
        if status is BusStatus.OK and i == SLOTS:
            status = BusStatus.FULL
        if isinstance(hello, Hello) and status is BusStatus.OK:
            slot["greeted"], slot["filters"] = int(hello.flags), len(hello.filters)
            self._filters[i, : len(hello.filters)] = np.array(hello.filters, np.int64).reshape(-1, 2)
            slot["state"] = SlotState.OPEN
            bus = wire_of(self._world.bus, STATION + i)
            bus.stations[STATION + i].listen_only = int(Flags.LISTEN_ONLY in hello.flags)
            attach(bus, STATION + i)
            self._result.clients += int(first)
        controller = wire_of(self._world.bus, STATION + i).stations[STATION + i]
        answer = Answer(status, self._bit_rate, STATION + i, int(slot["lost"]), state_of(controller))
        with suppress(OSError):  # it does not read, or has gone: the loop will detect it
            self.sockets[i].send(answer.pack())
        if not isinstance(hello, Hello) or status is not BusStatus.OK:
            if first:
                self.part(i)
            else:
                slot["malformed"] += 1

    def part(self, i: int) -> None:
        """Remove the client in slot `i`."""
        slot, result = self.slots[i], self._result
        self.sockets.pop(i).close()
        pid = self._pids.pop(i, 0)
        lost = int(slot["lost"])
        result.malformed += int(slot["malformed"])
        if slot["state"] == SlotState.OPEN:
            result.lost += lost
            if lost and len(result.losers) < LOSERS_TOLD:
                result.losers.append({"pid": pid, "lost": lost, "delivered": int(slot["delivered"])})
        detach(wire_of(self._world.bus, STATION + i), STATION + i)
        slot["state"], slot["fd"] = SlotState.FREE, -1
        if self._door is not None:
            self._pace["listener"] = self._door.fileno()

    def close(self) -> None:
        """Close all clients' sockets and the listeners, also after an error."""
        with ExitStack() as left:
            if self._spare >= 0:
                left.callback(os.close, self._spare)
                self._spare = -1
            for door in {*self.listeners, *((self._door,) if self._door is not None else ())}:
                left.callback(door.close)
            self._door = None
            for slot in self.sockets:
                left.callback(self.part, slot)
