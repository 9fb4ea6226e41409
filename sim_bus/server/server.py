"""A world in real time as one process.

It serves clients of a virtual bus, or joins a SocketCAN interface, an adapter of python-can or another
process's virtual bus.

`BusServer` handles the exits of the compiled loop (`sim_bus.server.realtime_loop.serve`).
`sim_bus.server.admission.Admission` handles the clients' sockets.
"""

from __future__ import annotations

import errno
import os
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

from coulombus.kernels.decorator import Entry
from coulombus.kernels.records import new_records
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.adapter_socket import AdapterSocket
from coulombus.sim_bus.server.admission import Admission
from coulombus.sim_bus.server.clients import Need, SlotState
from coulombus.sim_bus.server.precompile import warm_up
from coulombus.sim_bus.server.python_worker import Worker, drain_jobs
from coulombus.sim_bus.server.realtime_loop import Serve, serve
from coulombus.sim_bus.server.records import PaceRecord
from coulombus.sim_bus.server.sim_result import SimResult
from coulombus.sim_bus.server.socket_file import locked, refuse_live, unlink_own
from coulombus.system.realtime import RealTime, ask_for_real_time, bus_cpu
from coulombus.wire.address import BusAddress, BusUnavailable, socket_path
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.handshake import Hello, greet
from coulombus.wire.recvmsg import ask_for_stamps
from coulombus.wire.socketcan import can_socket, is_virtual

__all__ = ["BusServer"]

RECORD_FRAMES = 256
SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK = 101, 2, 0x1FFFFFFF

_T = TypeVar("_T")


class BusServer:
    """A bus, or several, in real time with the devices of `world` on it.

    If another process or the kernel (SocketCAN) serves the bus, this process is a station of it,
    and frames take their time there.

    Parameters
    ----------
    address : of the bus, or of each of the world's buses: all virtual, or all interfaces
    make_world : returns a world for a bit rate; a trial world, which compiles all kernels, is
        discarded
    bit_rate : of the virtual bus; 0: frames take no time
    join : join the virtual bus of another process, if it exists, or an adapter
    beside : the bus continues while Python serves the nodes (`sim_bus.server.python_worker`)

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        (exit status 4) a live process serves this bus already (without `join`), or the SocketCAN
        interface does not exist
    """

    def __init__(
        self,
        make_world: Callable[[int, bool], VirtualNetwork],
        address: BusAddress | Sequence[BusAddress],
        bit_rate: int,
        *,
        join: bool = False,
        beside: bool = False,
    ) -> None:
        self.addresses = (address,) if isinstance(address, BusAddress) else tuple(address)
        self.address = self.addresses[0]
        self.name = ", ".join(map(str, self.addresses))
        self.real_time = RealTime()
        self.result = SimResult(self.name)
        self.joined = False
        """Whether another process serves the bus."""
        # first the immediate refusals: the first compilation takes half a minute
        raws = [can_socket(address.name) for address in self.addresses if address.is_interface]
        self._adapter = AdapterSocket(self.address) if self.address.is_adapter else None
        for address in self.addresses if not raws and not join else ():
            refuse_live(socket_path(address.name), address)
        self.bit_rate = 0 if raws else bit_rate
        self._on_virtual = bool(raws) and all(is_virtual(address.name) for address in self.addresses)
        self.world = make_world(self.bit_rate, False)
        self._pace = new_records(PaceRecord)
        self._admission = Admission(self.name, self.bit_rate, self.world, self._pace, self.result)
        self._run, self._drain_jobs = Entry(serve), Entry(drain_jobs)
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._worker = Worker(self.world, self._wake, self.stop, on=beside)
        self._inodes: dict[Path, int] = {}
        self._calls: deque[tuple[Future[object], Callable[[], object]]] = deque()
        self._ended = False
        self._pace["wake"], self._pace["listener"], self._pace["end_ns"] = self._wake, -1, NEVER_NS
        self._load()
        self.world.load_detail()
        warm_up(make_world(self.bit_rate, True))
        try:
            for bus, raw in enumerate(raws):
                self._open_interface(bus, raw)
            if not raws and not (join and self._join(self.addresses[0])):
                self._admission.listen(*map(self._listener, self.addresses))
        except BaseException:
            self.close()
            raise

    # life cycle

    def _load(self) -> None:
        """Compile the loop, or load it from the cache, by a call that stops at once."""
        self._pace["stop"], self._pace["start_ns"] = 1, time.monotonic_ns() + NEVER_NS // 2
        self._serve()
        self._pace["stop"] = self._pace["wakeups"] = 0

    def _serve(self) -> int:
        worker, (world, host, _, course, _) = self._worker, self.world.arguments
        loop = worker.loop if worker.shared.state["on"] else world
        why = int(self._run(self._pace, self._admission.clients, worker.shared, loop, host, course))
        self._drain_jobs(worker.shared, loop, course, self._pace[0])
        return why

    @property
    def wakeups(self) -> int:
        """Number of the loop's wake-ups: it does not change while the bus is stalled."""
        return int(self._pace["wakeups"][0])

    def now_ns(self) -> int:
        """Return the present in the world's time."""
        return time.monotonic_ns() - int(self._pace["start_ns"][0])

    def stop(self) -> None:
        """End `run` soon; may be called from another thread or a signal handler."""
        self._ended = True
        self._interrupt()

    def call(self, action: Callable[[], _T]) -> Future[_T]:
        """Perform `action` on the world between two events, in the thread of `run`; may be called from another
        thread.

        The frames before it have been passed to `on_frames`. The future is cancelled if `run` ends first.
        """
        future: Future[_T] = Future()
        self._calls.append((future, action))  # type: ignore[arg-type]  # a future of any result
        self._interrupt()
        return future

    def mark(self, t_ns: int, text: str) -> None:
        """Mark the recording, if there is one, at the world's time `t_ns`."""

    def _interrupt(self) -> None:
        """Let the loop return to Python."""
        self._pace["stop"] = 1
        os.eventfd_write(self._wake, 1)

    def _perform_calls(self) -> None:
        """Perform the actions of other threads; an exception belongs to the caller."""
        self._pace["stop"] = int(self._ended)  # first, so that a call that comes meanwhile sets it again
        with self._worker.whole():
            self._record()
            while self._calls:
                future, action = self._calls.popleft()
                try:
                    future.set_result(action())
                except Exception as error:
                    future.set_exception(error)

    def run(
        self,
        seconds: float | None = None,
        *,
        priority: int | None = None,
        cpu: int | None = None,
        ready: Callable[[], None] | None = None,
    ) -> SimResult:
        """Serve for `seconds` (None: until `stop`) and return the result.

        `priority` of SCHED_FIFO and `cpu` are requested for the calling thread; `real_time` tells
        what was granted. With a priority on a virtual interface of Linux the thread stays on one
        CPU (`bus_cpu`). `ready` is called just before the nodes are switched on; clients may
        connect from the constructor's end on.
        """
        world, pace = self.world, self._pace
        if cpu is None and priority is not None and self._on_virtual:
            cpu = bus_cpu()
        self._worker.start()  # without the real-time rights of the bus
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
        while (why := self._serve()) not in (Serve.TIME, Need.GONE):
            if self._worker.failure is not None or (why == Serve.STOP and self._ended):
                break
            if why == Serve.STOP:
                self._perform_calls()
            elif why == Serve.ACCEPT:
                self._admission.accept()
            elif why == Need.MESSAGE:
                self._admission.greeted(int(pace["slot"][0]))
            elif why == Need.CLOSED:
                self._admission.part(int(pace["slot"][0]))
                if self.joined:
                    ended = f"bus {self.name} is gone: its process ended"
                    self.result.gone = ended if self._adapter is None else self._adapter.gone
                    break
            elif why == Serve.RECORD:
                with self._worker.whole():
                    self._record()
            elif why == Serve.FAILED:
                self.result.gone = (
                    f"bus {self.name}: waiting for its clients failed: {os.strerror(int(pace['error'][0]))}"
                )
                break
            else:
                with self._worker.whole():
                    world.answer(why)
        with self._worker.whole():
            self._record()
        while self._calls:
            self._calls.popleft()[0].cancel()
        if self._worker.failure is not None:
            raise self._worker.failure
        if why == Need.GONE and not self.joined:
            number = int(pace["error"][0])
            lost = number not in (0, errno.ENODEV, errno.ENXIO)
            why_gone = f"cannot be read: {os.strerror(number)}" if lost else "does not exist any more"
            interface = self.addresses[int(pace["slot"][0])]
            self.result.gone = f"the interface {interface.name} {why_gone}"
        self.result.cpu_s = (time.thread_time_ns() - cpu_begin) * 1e-9
        self.result.seconds = (time.monotonic_ns() - begin) * 1e-9
        return self._finish()

    def _began(self, begin_ns: int) -> None:
        """Hook, called once when the world's time begins, at CLOCK_MONOTONIC `begin_ns`."""

    def _finish(self) -> SimResult:
        result, pace, bus = self.result, self._pace[0], self.world.bus
        for slot in list(self._admission.sockets):
            if self._admission.slots[slot]["state"] == SlotState.SOCKETCAN:
                names = ("sent", "delivered", "lost", "overflow", "no_buffer", "net_down", "error_frames")
                counts = {name: int(self._admission.slots[slot][name]) for name in names}
                result.socketcan = {name: counts[name] + (result.socketcan or {}).get(name, 0) for name in names}
            self._admission.part(slot)
        result.frames = int(bus["frames"].sum())
        result.unserved = int(self._worker.shared.state["dropped"])
        result.stalls, result.stalled_s = int(pace["stalls"]), int(pace["stalled_ns"]) * 1e-9
        result.latest_delivery_s, result.wakeups = int(pace["latest_ns"]) * 1e-9, int(pace["wakeups"])
        return result

    def close(self) -> None:
        """Close all sockets and remove the socket's file, also after an error."""
        with ExitStack() as left:
            self._worker.close()
            if self._wake >= 0:
                left.callback(os.close, self._wake)
                self._wake = -1
            for path, inode in self._inodes.items():
                left.callback(unlink_own, path, inode)
            self._inodes = {}
            left.callback(self._admission.close)
            if self._adapter is not None:
                left.callback(self._adapter.close)

    def keep_frames(self) -> None:
        """Pass every frame on the bus to the world's `on_frames`, in batches of some hundred frames or 0.1 s; to be
        called before `run`.
        """
        self._pace["keep"] = RECORD_FRAMES

    def _record(self) -> None:
        if self._pace["keep"][0]:
            self.world.flush()
            self._pace["handed_out"] = 0

    def _plan(self) -> None:
        """Schedule the actions in the world, just before it begins."""

    # the virtual bus

    def _join(self, address: BusAddress) -> bool:
        """Join the bus of another process, or an adapter; return whether there is one."""
        if self._adapter is not None:
            self.joined = True
            self._admit_joined(self._adapter.socket.dup(), self._adapter.bitrate_bit_s)
            return True
        path = socket_path(address.name)
        with locked(path.parent):
            if not path.exists():
                return False
            try:
                refuse_live(path, address)
            except BusUnavailable:
                self.joined = True
        if self.joined:
            connection = greet(address, Hello())
            self._admit_joined(connection.socket, connection.answer.bitrate_bit_s)
        return self.joined

    def _admit_joined(self, joined: socket.socket, bit_rate: int) -> None:
        self.bit_rate = bit_rate
        self.world.bus["bit_rate"] = 0  # frames take their time there
        joined.setblocking(False)
        self._admission.admit(0, joined, SlotState.JOINED)

    def _listener(self, address: BusAddress) -> socket.socket:
        path = socket_path(address.name)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            with locked(path.parent):
                if refuse_live(path, address):
                    path.unlink()
                listener.bind(str(path))
                listener.listen(16)
            self._inodes[path] = path.stat().st_ino
        except BaseException:
            listener.close()
            raise
        return listener

    # SocketCAN

    def _open_interface(self, bus: int, raw: socket.socket) -> None:
        raw.setblocking(False)
        raw.setsockopt(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK)
        ask_for_stamps(raw)
        self._admission.admit(bus, raw, SlotState.SOCKETCAN, bus)
