"""``coulombus sim``: bus, nodes and rig as one process in real time, for clients of a virtual bus or on a SocketCAN interface.

`SimServer` owns the sockets and answers what the compiled loop (`lab.paced.serve`) needs Python for.
"""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eds.cia301 import NmtCommand
from eds.rig import Rig
from lab.clients import BATCH, MESSAGE_FRAMES, SLOT, SLOTS, STATION, Need, State
from lab.kernel import BRAKE, MOTOR, Exit
from lab.paced import PACE, Serve, serve
from lab.world import VirtualRig
from wire.address import BusAddress, BusUnavailable, socket_path
from wire.frame import new_records
from wire.hello import MAX_FILTERS, SEND_BUFFER, Answer, Hello, Status
from wire.mailbox import MAILBOX, ask_for_stamps, set_up
from wire.realtime import RealTime, ask_for_real_time
from wire.socketcan import can_socket

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lab.sim_script import Entry

__all__ = ["PacedRig", "SimResult", "SimServer"]

FOREVER_NS = 1 << 62
LOSERS_TOLD = 20
SO_SNDBUFFORCE, SO_PEERCRED = 32, 17
SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK = 101, 2, 0x1FFFFFFF


class PacedRig(VirtualRig):
    """The rig of a process in which no host runs; `arguments` are those of the kernels."""

    def __init__(self, rig: Rig, mode: str, seed: int, bit_rate: int) -> None:
        super().__init__(rig, mode, seed=seed)
        self.bus["bit_rate"] = bit_rate
        self._world["host_elsewhere"] = 1
        self._waiting: list[Entry] = []

    @property
    def arguments(self) -> tuple[Any, ...]:
        """The arrays, in the order of `lab.kernel.run`'s arguments."""
        return self._arguments

    def plan(self, script: Sequence[Entry]) -> None:
        """Take the entries of a script: those that wait for Operation Enabled until then."""
        self._waiting = [entry for entry in script if entry.after == "enabled"]
        for entry in script:
            if entry.after == "start":
                self.at(entry.t_ns, self._actor(entry))

    def _actor(self, entry: Entry) -> Callable[[VirtualRig], None]:
        return lambda _: entry.act(self)

    def power_on(self, node: int | None = None) -> None:
        """Switch both nodes on, or the node `MOTOR` or `BRAKE`; one that is on stays so."""
        for device in (self.motor, self.brake) if node is None else ((self.motor, self.brake)[node],):
            if not device.record["powered"]:
                device.power_on(self.t_ns, self._queue, self._header)

    def nmt_command(self, node: int, command: int) -> None:
        """Let the node `MOTOR` or `BRAKE` act as on an NMT command to it."""
        (self.motor, self.brake)[node].nmt_command(self.t_ns, command, self._queue, self._header)

    def answer(self, why: int) -> None:
        """Do what the kernel needs Python for, at the world's present time."""
        if why == Serve.RESTED:
            self._world["operator_start_ns"] = -1
            self._new_force_block()
        else:
            self._answer(Exit(why))
        if why == Exit.ENABLED:
            for entry in self._waiting:
                self.at(self.t_ns + entry.t_ns, self._actor(entry))
            self._waiting = []
        self._actuate()


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
    stalls: int = 0
    stalled_s: float = 0.0
    latest_delivery_s: float = 0.0
    wakeups: int = 0
    cpu_s: float = 0.0
    socketcan: dict[str, int] | None = None
    gone: str | None = None
    """Why the bus ended before its time, or None."""

    @property
    def exit_status(self) -> int:
        """Exit status of the command: 4 when the bus ended before its time."""
        return 4 if self.gone else 0


class SimServer:
    """A bus with the nodes and the rig of `rig` on it, in real time.

    Parameters
    ----------
    mode : whose F_s sets the size of the operator's pushes
    script : what happens to the nodes, and when
    unpaced : frames take no time

    Raises
    ------
    wire.address.BusUnavailable
        (exit status 4) a live process serves this bus already, or the SocketCAN interface is not there
    """

    def __init__(
        self,
        rig: Rig,
        address: BusAddress,
        *,
        mode: str = "hybrid",
        seed: int = 0,
        script: Sequence[Entry] = (),
        unpaced: bool = False,
    ) -> None:
        self.address = address
        self.real_time = RealTime()
        self.result = SimResult(str(address))
        on_can = address.kind == "socketcan"
        raw = None
        if on_can:  # first what can be refused at once: compiling takes half a minute the first time
            raw = can_socket(address.name)
        else:
            _refuse_live(socket_path(address.name), address)
        self.bit_rate = 0 if unpaced or on_can else rig.bus.bitrate_bit_s
        self.world = PacedRig(rig, mode, seed, self.bit_rate)
        self._script = tuple(script)
        rows = SLOTS + 1  # the last is for a client that has to be told that there is no room
        self._pace, self._slots = new_records(PACE), new_records(SLOT, rows)
        self._slots["fd"] = -1
        self._words = np.zeros((rows, 2 * MESSAGE_FRAMES), np.int64)
        self._boxes = new_records(MAILBOX, rows)
        for i in range(rows):
            set_up(self._boxes[i : i + 1], self._words[i])
        self._filters = np.zeros((rows, MAX_FILTERS, 2), np.int64)
        self._batches = np.zeros((rows, 2 * BATCH), np.int64)
        self._pollfds = np.zeros(rows + 2, np.int64)
        self._sockets: dict[int, socket.socket] = {}
        self._pids: dict[int, int] = {}
        self._arguments = (self._pace, self._slots, self._boxes, self._words, self._filters, self._batches)
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._listener: socket.socket | None = None
        self._path: Path | None = None
        self._inode = 0
        self._pace["wake"], self._pace["listener"], self._pace["end_ns"] = self._wake, -1, FOREVER_NS
        self._load()
        try:
            if raw is not None:
                self._open_interface(raw)
            else:
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
        _warm_up(PacedRig(self.world.rig, self.world.mode, 0, self.bit_rate))

    def _serve(self) -> int:
        return serve(*self._arguments, self._pollfds, *self.world.arguments)

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

        `priority` of SCHED_FIFO and `cpu` are asked for on behalf of the calling thread; `real_time` tells what was granted. `ready` is
        called just before the nodes are switched on; clients may connect from the constructor's end on.
        """
        world, pace = self.world, self._pace
        self.real_time = ask_for_real_time(priority, cpu)
        world.plan(self._script)
        if ready is not None:
            ready()
        begin, cpu_begin = time.monotonic_ns(), time.thread_time_ns()
        pace["start_ns"], pace["planned_ns"] = begin, 0
        if seconds is not None:
            pace["end_ns"] = round(seconds * 1e9)
        world.power_on()
        while (why := self._serve()) not in (Serve.STOP, Serve.TIME, Need.GONE):
            if why == Serve.ACCEPT:
                self._accept()
            elif why == Need.MESSAGE:
                self._greeted(int(pace["slot"][0]))
            elif why == Need.CLOSED:
                self._part(int(pace["slot"][0]))
            else:
                world.answer(why)
        if why == Need.GONE:
            self.result.gone = f"the interface {self.address.name} does not exist any more"
        self.result.cpu_s = (time.thread_time_ns() - cpu_begin) * 1e-9
        self.result.seconds = (time.monotonic_ns() - begin) * 1e-9
        return self._finish()

    def _finish(self) -> SimResult:
        result, pace, bus = self.result, self._pace[0], self.world.bus[0]
        for slot in list(self._sockets):
            if self._slots[slot]["state"] == State.SOCKETCAN:
                names = ("sent", "delivered", "lost", "overflow", "no_buffer", "net_down", "error_frames")
                result.socketcan = {name: int(self._slots[slot][name]) for name in names}
            self._part(slot)
        result.frames = int(bus["frames"])
        result.stalls, result.stalled_s = int(pace["stalls"]), int(pace["stalled_ns"]) * 1e-9
        result.latest_delivery_s, result.wakeups = int(pace["latest_ns"]) * 1e-9, int(pace["wakeups"])
        return result

    def close(self) -> None:
        """Close the sockets and remove the socket's file."""
        for slot in list(self._sockets):
            self._part(slot)
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        if self._path is not None:
            with _locked(self._path.parent):
                try:
                    if self._path.stat().st_ino == self._inode:
                        self._path.unlink()
                except FileNotFoundError:
                    pass
            self._path = None
        if self._wake >= 0:
            os.close(self._wake)
            self._wake = -1

    # the virtual bus

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
        free = np.flatnonzero(self._slots["state"] == State.FREE)
        if len(free) == 0:  # not even room to say so: let it wait
            self._pace["listener"] = -1
            return
        try:
            client, _ = self._listener.accept()
        except OSError:  # it has gone already, or there are no descriptors left
            return
        client.setblocking(False)
        try:
            client.setsockopt(socket.SOL_SOCKET, SO_SNDBUFFORCE, SEND_BUFFER)
        except PermissionError:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        ask_for_stamps(client)
        self._admit(int(free[0]), client, State.GREETING)

    def _admit(self, i: int, client: socket.socket, state: State) -> None:
        self._slots[i : i + 1] = np.zeros(1, SLOT)
        self._slots[i]["fd"], self._slots[i]["state"] = client.fileno(), state
        self._boxes[i]["overflow"] = 0
        self._sockets[i] = client
        if state is State.GREETING:
            credentials = client.getsockopt(socket.SOL_SOCKET, SO_PEERCRED, struct.calcsize("3i"))
            self._pids[i] = struct.unpack("3i", credentials)[0]

    def _greeted(self, i: int) -> None:
        """Answer a greeting, the first or a later one; who does not greet at first is turned away."""
        slot = self._slots[i]
        message = self._words[i].tobytes()[: int(self._pace["message_bytes"][0])]
        hello = Hello.unpack(message)
        status = hello if isinstance(hello, Status) else Status.OK
        first = slot["state"] == State.GREETING
        if status is Status.OK and i == SLOTS:
            status = Status.FULL
        answer = Answer(status, self.bit_rate, STATION + i, int(slot["lost"]))
        with suppress(OSError):  # it does not read, or has gone: the loop will find out
            self._sockets[i].send(answer.pack())
        if isinstance(hello, Hello) and status is Status.OK:
            slot["flags"], slot["filters"] = int(hello.flags), len(hello.filters)
            self._filters[i, : len(hello.filters)] = np.array(hello.filters, np.int64).reshape(-1, 2)
            slot["state"] = State.OPEN
            self.result.clients += int(first)
        elif first:
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
        if slot["state"] == State.OPEN:
            result.lost += lost
            if lost and len(result.losers) < LOSERS_TOLD:
                result.losers.append({"pid": pid, "lost": lost, "delivered": int(slot["delivered"])})
        slot["state"], slot["fd"] = State.FREE, -1
        if self._listener is not None:
            self._pace["listener"] = self._listener.fileno()

    # SocketCAN

    def _open_interface(self, raw: socket.socket) -> None:
        raw.setblocking(False)
        raw.setsockopt(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK)
        ask_for_stamps(raw)
        self._admit(0, raw, State.SOCKETCAN)


def _warm_up(world: PacedRig) -> None:
    """Let a world that nobody looks at do what the real one will: what is compiled, or loaded, at its first call takes a second."""
    world.power_on()
    for device in (world.motor, world.brake):
        rx = 0x600 + device.node_id
        for word in (0x0000_0000_0010_1740, 0x0000_0064_0010_172B):  # upload, download of 1017h
            device.service(0, rx, 8, word, world._queue, world._header)
    for row in (MOTOR, BRAKE):
        for command in (NmtCommand.START, NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            world.nmt_command(row, command)
        world.power_off(row)


@contextmanager
def _locked(directory: Path) -> Iterator[None]:
    """Hold the lock on the sockets' directory, so that two servers that start at a time do not both take a dead one's place."""
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX)
        yield
    finally:
        os.close(fd)


def _refuse_live(path: Path, address: BusAddress) -> bool:
    """Refuse a socket's file whose process lives; return whether there is the file of a dead one."""
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
