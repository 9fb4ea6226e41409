"""A world in real time as one process, for clients of a virtual bus, on a SocketCAN interface, or
on another process' virtual bus.

`BusServer` owns the sockets and answers what the compiled loop (`sim_bus.server.realtime_loop.serve`) needs
Python for.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.kernels.decorator import Entry
from coulombus.sim_bus.can_bus.cable_cut import wire_of
from coulombus.sim_bus.can_bus.fault_confinement import state_of
from coulombus.sim_bus.can_bus.stations import attach, detach
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.clients import BATCH, MESSAGE_FRAMES, SLOTS, STATION, Clients, Need, SlotState
from coulombus.sim_bus.server.precompile import warm_up
from coulombus.sim_bus.server.python_worker import Worker, drain_jobs
from coulombus.sim_bus.server.realtime_loop import Serve, serve
from coulombus.sim_bus.server.records import SLOT, PaceRecord, SlotRecord
from coulombus.system.file_lock import lock_file
from coulombus.system.realtime import RealTime, ask_for_real_time, bus_cpu
from coulombus.wire.address import BusAddress, BusUnavailable, socket_path
from coulombus.wire.frame import new_records
from coulombus.wire.handshake import MAX_FILTERS, SEND_BUFFER, Answer, BusStatus, Flags, Hello, greet
from coulombus.wire.recvmsg import Mailbox, ask_for_stamps, set_up
from coulombus.wire.socketcan import can_socket, is_virtual

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["BusServer", "SimResult"]

FOREVER_NS = 1 << 62
LOSERS_TOLD = 20
RECORD_FRAMES = 256
MUTE_S = 2.0
"""How long a client may take to greet where others wait for its place."""
SO_SNDBUFFORCE, SO_PEERCRED = 32, 17
SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK = 101, 2, 0x1FFFFFFF


@dataclass
class SimResult:
    """What a server came to."""

    bus: str
    seconds: float = 0.0
    frames: int = 0
    """Frames that the bus carried."""
    clients: int = 0
    """Clients that greeted."""
    lost: int = 0
    """Frames that clients did not get because they did not read, all clients together."""
    losers: list[dict[str, int]] = field(default_factory=list)
    malformed: int = 0
    unserved: int = 0
    """Requests (SDO, LSS, resets) that were lost because the nodes had too many to serve."""
    stalls: int = 0
    stalled_s: float = 0.0
    latest_delivery_s: float = 0.0
    wakeups: int = 0
    cpu_s: float = 0.0
    socketcan: dict[str, int] | None = None
    faults: list[dict[str, Any]] | None = None
    """What each fault of a fault file came to."""
    controllers: dict[str, dict[str, Any]] | None = None
    """State and error counters of the nodes' CAN controllers at the end, where there was a fault
    file.
    """
    gone: str | None = None
    """Why the bus ended before its time, or None."""

    @property
    def exit_status(self) -> int:
        """Exit status of the command: 4 when the bus ended before its time."""
        return 4 if self.gone else 0


class BusServer:
    """A bus in real time with the devices of `world` on it.

    Where another process serves the bus, or the kernel (SocketCAN), this one is a station of it,
    and frames take their time there.

    Parameters
    ----------
    make_world : gives a world of a bit rate; one is for a trial, in which all that it needs is
        compiled, and thrown away
    bit_rate : of the virtual bus; 0: frames take no time
    join : take part in the virtual bus of another process, if there is one
    beside : the bus goes on while Python serves the nodes (`sim_bus.server.python_worker`)

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        (exit status 4) a live process serves this bus already (without `join`), or the SocketCAN
        interface is not there
    """

    def __init__(
        self,
        make_world: Callable[[int, bool], VirtualNetwork],
        address: BusAddress,
        bit_rate: int,
        *,
        join: bool = False,
        beside: bool = False,
    ) -> None:
        self.address = address
        self.real_time = RealTime()
        self.result = SimResult(str(address))
        self.joined = False
        """Whether another process serves the bus."""
        raw = None
        if address.is_interface:  # first what can be refused at once: compiling takes half a minute the first time
            raw = can_socket(address.name)
        elif not join:
            _refuse_live(socket_path(address.name), address)
        self.bit_rate = bit_rate if raw is None else 0
        self._on_virtual = raw is not None and is_virtual(address.name)
        self.world = make_world(self.bit_rate, False)
        rows = SLOTS + 1  # the last is for a client that has to be told that there is no room
        self._pace, self._slots = new_records(PaceRecord), new_records(SlotRecord, rows)
        self._slots["fd"] = -1
        self._words = np.zeros((rows, 2 * MESSAGE_FRAMES), np.int64)
        self._boxes = new_records(Mailbox, rows)
        for i in range(rows):
            set_up(self._boxes[i : i + 1], self._words[i])
        self._filters = np.zeros((rows, MAX_FILTERS, 2), np.int64)
        self._batches = np.zeros((rows, 2 * BATCH), np.int64)
        self._pollfds = np.zeros(rows + 2, np.int64)
        self._sockets: dict[int, socket.socket] = {}
        self._pids: dict[int, int] = {}
        self._since: dict[int, float] = {}
        arrays = self._slots, self._boxes, self._words, self._filters, self._batches, self._pollfds
        self._clients = Clients(*arrays)
        self._run, self._drain_jobs = Entry(serve), Entry(drain_jobs)
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._worker = Worker(self.world, self._wake, self.stop, on=beside)
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)  # for who comes when there is no other left
        self._listener: socket.socket | None = None
        self._path: Path | None = None
        self._inode = 0
        self._pace["wake"], self._pace["listener"], self._pace["end_ns"] = self._wake, -1, FOREVER_NS
        self._load()
        warm_up(make_world(self.bit_rate, True))
        try:
            if raw is not None:
                self._open_interface(raw)
            elif not (join and self._join(address)):
                self._listen(address)
        except BaseException:
            self.close()
            raise

    # life

    def _load(self) -> None:
        """Compile the loop, or load it out of the cache, by a call that stops at once."""
        self._pace["stop"], self._pace["start_ns"] = 1, time.monotonic_ns() + FOREVER_NS // 2
        self._serve()
        self._pace["stop"] = self._pace["wakeups"] = 0

    def _serve(self) -> int:
        worker, (_, host, _, course) = self._worker, self.world.arguments
        why = int(self._run(self._pace, self._clients, worker.shared, worker.loop, host, course))
        self._drain_jobs(worker.shared, worker.loop, course, self._pace[0])
        return why

    @property
    def wakeups(self) -> int:
        """How often the loop has woken: a bus that stands still has as many as before."""
        return int(self._pace["wakeups"][0])

    def now_ns(self) -> int:
        """Return the present in the world's time: how late what now happens there is."""
        return time.monotonic_ns() - int(self._pace["start_ns"][0])

    def stop(self) -> None:
        """End `run` soon; may be called from another thread or a signal handler."""
        self._pace["stop"] = 1
        os.eventfd_write(self._wake, 1)

    def run(
        self,
        seconds: float | None = None,
        *,
        priority: int | None = None,
        cpu: int | None = None,
        ready: Callable[[], None] | None = None,
    ) -> SimResult:
        """Serve for `seconds` (None: until `stop`) and return what came of it.

        `priority` of SCHED_FIFO and `cpu` are asked for on behalf of the calling thread;
        `real_time` tells what was granted. With a priority on a virtual interface of Linux the
        thread keeps to one CPU (`bus_cpu`). `ready` is called just before the nodes are switched on;
        clients may connect from the constructor's end on.
        """
        world, pace = self.world, self._pace
        if cpu is None and priority is not None and self._on_virtual:
            cpu = bus_cpu()
        self._worker.start()  # not with the rights of the bus
        self.real_time = ask_for_real_time(priority, cpu)
        self._plan()
        if ready is not None:
            ready()
        begin, cpu_begin = time.monotonic_ns(), time.thread_time_ns()
        pace["start_ns"], pace["planned_ns"] = begin, 0
        self._began(begin)
        if seconds is not None:
            pace["end_ns"] = round(seconds * 1e9)
        world.power_on()
        self._worker.to_loop()
        while (why := self._serve()) not in (Serve.STOP, Serve.TIME, Need.GONE):
            if self._worker.failure is not None:
                break
            if why == Serve.ACCEPT:
                self._accept()
            elif why == Need.MESSAGE:
                self._greeted(int(pace["slot"][0]))
            elif why == Need.CLOSED:
                self._part(int(pace["slot"][0]))
                if self.joined:
                    self.result.gone = f"bus {self.address} is gone: its process ended"
                    break
            elif why == Serve.RECORD:
                with self._worker.whole():
                    self._record()
            elif why == Serve.FAILED:
                self.result.gone = (
                    f"bus {self.address}: waiting for its clients failed: {os.strerror(int(pace['error'][0]))}"
                )
                break
            else:
                with self._worker.whole():
                    world.answer(why)
        with self._worker.whole():
            self._record()
        if self._worker.failure is not None:
            raise self._worker.failure
        if why == Need.GONE and not self.joined:
            number = int(pace["error"][0])
            lost = number not in (0, errno.ENODEV, errno.ENXIO)
            why_gone = f"cannot be read: {os.strerror(number)}" if lost else "does not exist any more"
            self.result.gone = f"the interface {self.address.name} {why_gone}"
        self.result.cpu_s = (time.thread_time_ns() - cpu_begin) * 1e-9
        self.result.seconds = (time.monotonic_ns() - begin) * 1e-9
        return self._finish()

    def _began(self, begin_ns: int) -> None:
        """Called once, when the world's time begins: CLOCK_MONOTONIC at 0."""

    def _finish(self) -> SimResult:
        result, pace, bus = self.result, self._pace[0], self.world.bus
        for slot in list(self._sockets):
            if self._slots[slot]["state"] == SlotState.SOCKETCAN:
                names = ("sent", "delivered", "lost", "overflow", "no_buffer", "net_down", "error_frames")
                result.socketcan = {name: int(self._slots[slot][name]) for name in names}
            self._part(slot)
        result.frames = int(bus["frames"].sum())
        result.unserved = int(self._worker.shared.state["dropped"])
        result.stalls, result.stalled_s = int(pace["stalls"]), int(pace["stalled_ns"]) * 1e-9
        result.latest_delivery_s, result.wakeups = int(pace["latest_ns"]) * 1e-9, int(pace["wakeups"])
        return result

    def close(self) -> None:
        """Close the sockets and remove the socket's file, all of them, whatever becomes of one."""
        with ExitStack() as left:
            self._worker.close()
            if self._wake >= 0:
                for descriptor in (self._wake, self._spare):
                    left.callback(os.close, descriptor)
                self._wake = -1
            if self._path is not None:
                left.callback(self._unlink, self._path)
                self._path = None
            if self._listener is not None:
                left.callback(self._listener.close)
                self._listener = None
            for slot in self._sockets:
                left.callback(self._part, slot)

    def _unlink(self, path: Path) -> None:
        with _locked(path.parent), suppress(FileNotFoundError):
            if path.stat().st_ino == self._inode:
                path.unlink()

    def keep_frames(self) -> None:
        """Give the world's `on_frames` every frame that the bus carries, some hundred or those of
        0.1 s at a time; to be called before `run`.
        """
        self._pace["keep"] = RECORD_FRAMES

    def _record(self) -> None:
        if self._pace["keep"][0]:
            self.world.flush()
            self._pace["handed_out"] = 0

    def _plan(self) -> None:
        """Prepare what happens in the world, just before it begins."""

    # the virtual bus

    def _join(self, address: BusAddress) -> bool:
        """Take part in the bus of another process; return whether there is one."""
        path = socket_path(address.name)
        with _locked(path.parent):
            if not path.exists():
                return False
            try:
                _refuse_live(path, address)
            except BusUnavailable:
                self.joined = True
        if self.joined:
            connection = greet(address, Hello())
            self.bit_rate = connection.answer.bitrate_bit_s
            self.world.bus["bit_rate"] = 0  # frames take their time there
            connection.socket.setblocking(False)
            self._admit(0, connection.socket, SlotState.JOINED)
        return self.joined

    def _listen(self, address: BusAddress) -> None:
        path = socket_path(address.name)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            with _locked(path.parent):
                if _refuse_live(path, address):
                    path.unlink()
                listener.bind(str(path))
                listener.listen(16)
            self._inode = path.stat().st_ino
        except BaseException:
            listener.close()
            raise
        self._listener, self._path = listener, path
        self._pace["listener"] = listener.fileno()

    def _accept(self) -> None:
        assert self._listener is not None
        place = self._place()
        if place is None:  # not even room to say so: let it wait
            self._pace["listener"] = -1
            return
        try:
            client, _ = self._listener.accept()
        except (BlockingIOError, ConnectionAbortedError):  # it has gone already
            return
        except OSError as error:
            if error.errno not in (errno.EMFILE, errno.ENFILE):
                raise BusUnavailable(
                    f"bus {self.address}: no further client can be accepted: {error.strerror}"
                ) from None
            self._turn_away()
            return
        try:
            client.setblocking(False)
            try:
                client.setsockopt(socket.SOL_SOCKET, SO_SNDBUFFORCE, SEND_BUFFER)
            except PermissionError:
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            ask_for_stamps(client)
            self._admit(place, client, SlotState.GREETING)
        except BaseException as error:
            with ExitStack() as left:
                left.callback(client.close)
                if self._sockets.get(place) is client:
                    self._part(place)
            if not isinstance(error, OSError):  # one socket that cannot be set up costs nobody else the bus
                raise

    def _turn_away(self) -> None:
        """Without a descriptor left: let one in on the spare one, and out again.

        Who is left to wait would wake the loop for ever.
        """
        assert self._listener is not None
        os.close(self._spare)
        try:
            client, _ = self._listener.accept()
            with client, suppress(OSError):
                client.send(Answer(BusStatus.FULL).pack())
        except BlockingIOError:
            pass
        except OSError as error:
            raise BusUnavailable(f"bus {self.address}: no further client can be accepted: {error.strerror}") from None
        finally:
            self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)

    def _place(self) -> int | None:
        """Return a free place.

        When there are none for clients, who has connected and says nothing is turned away.
        """
        free = np.flatnonzero(self._slots["state"] == SlotState.FREE)
        if len(free) and free[0] < SLOTS:
            return int(free[0])
        mute = [
            i for i in self._sockets if self._slots[i]["state"] == SlotState.GREETING
        ]  # in the order of their coming
        mute.sort(key=lambda i: i == SLOTS)  # the place at which one is only told that there is none comes last
        before = time.monotonic() - MUTE_S
        for i in [i for i in mute if self._since[i] < before] or ([] if len(free) else mute[:1]):
            self._part(i)
        free = np.flatnonzero(self._slots["state"] == SlotState.FREE)
        return int(free[0]) if len(free) else None

    def _admit(self, i: int, client: socket.socket, state: SlotState) -> None:
        self._sockets[i], self._since[i] = client, time.monotonic()
        self._slots[i : i + 1] = np.zeros(1, SLOT)
        self._slots[i]["fd"], self._slots[i]["state"] = client.fileno(), state
        self._boxes[i]["overflow"] = 0
        if state is SlotState.GREETING:
            credentials = client.getsockopt(socket.SOL_SOCKET, SO_PEERCRED, struct.calcsize("3i"))
            self._pids[i] = struct.unpack("3i", credentials)[0]

    def _greeted(self, i: int) -> None:
        """Answer a greeting, the first or a later one.

        Who does not greet at first is turned away.
        """
        slot = self._slots[i]
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
            bus = wire_of(self.world.bus, STATION + i)
            bus.stations[STATION + i].listen_only = int(Flags.LISTEN_ONLY in hello.flags)
            attach(bus, STATION + i)
            self.result.clients += int(first)
        controller = wire_of(self.world.bus, STATION + i).stations[STATION + i]
        answer = Answer(status, self.bit_rate, STATION + i, int(slot["lost"]), state_of(controller))
        with suppress(OSError):  # it does not read, or has gone: the loop will find out
            self._sockets[i].send(answer.pack())
        if not isinstance(hello, Hello) or status is not BusStatus.OK:
            if first:
                self._part(i)
            else:
                slot["malformed"] += 1

    def _part(self, i: int) -> None:
        """Forget the client in slot `i`."""
        slot, result = self._slots[i], self.result
        self._sockets.pop(i).close()
        pid = self._pids.pop(i, 0)
        lost = int(slot["lost"])
        result.malformed += int(slot["malformed"])
        if slot["state"] == SlotState.OPEN:
            result.lost += lost
            if lost and len(result.losers) < LOSERS_TOLD:
                result.losers.append({"pid": pid, "lost": lost, "delivered": int(slot["delivered"])})
        detach(wire_of(self.world.bus, STATION + i), STATION + i)
        slot["state"], slot["fd"] = SlotState.FREE, -1
        if self._listener is not None:
            self._pace["listener"] = self._listener.fileno()

    # SocketCAN

    def _open_interface(self, raw: socket.socket) -> None:
        raw.setblocking(False)
        raw.setsockopt(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK)
        ask_for_stamps(raw)
        self._admit(0, raw, SlotState.SOCKETCAN)


@contextmanager
def _locked(directory: Path) -> Iterator[None]:
    """Hold the lock on the sockets' directory, so that two servers that start at a time do not both
    take a dead one's place.
    """
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        lock_file(fd, wait=True)
        yield
    finally:
        os.close(fd)


def _refuse_live(path: Path, address: BusAddress) -> bool:
    """Refuse a socket's file whose process lives.

    Return whether there is the file of a dead one.
    """
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)) as probe:
        try:
            probe.connect(str(path))
        except FileNotFoundError:
            return False
        except ConnectionRefusedError:
            return True
        except BlockingIOError:  # its queue is full: it lives
            pass
    raise BusUnavailable(
        f"bus {address} is served already by another process ({path}); stop that one, or choose another name with --bus"
    )
