"""The parent's handle of the data plane: start its process, command it, read its log and figures."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Trip
from coulombus.host.errors import HostError
from coulombus.host.realtime.log_rings import take_log, take_trace
from coulombus.host.realtime.shared_memory import BINS, TRACE_ROWS, PlaneCommand, PlaneStatus, SharedPlane
from coulombus.kernels.records import Records, new_records
from coulombus.recording.trace import TraceRow
from coulombus.wire.address import BusAddress
from coulombus.wire.client import Client
from coulombus.wire.frame import frames
from coulombus.wire.handshake import Flags, Hello

__all__ = ["DataPlane", "PlaneError", "Spread", "rig_filters"]

START_TIMEOUT_S = 180.0  # the very first start compiles the loop
BATCH_FRAMES = 1 << 14
STATES_BYTES = 1 << 18
"""Size of the queue of states: some hundreds; the kernel may allow less."""
CAN_SFF_EXACT = 0x7FF | 0xC0000000  # the whole identifier, no extended and no remote frames
PRIORITY = 80
PARENT_NS = 2_000_000_000
"""Longest time for which the parent may hang while the rig is armed: it could neither stop nor record the
run.
"""


class PlaneError(HostError):
    """The data plane's process did not start."""

    exit_status = 4


@dataclass(frozen=True)
class Spread:
    """Median, 99th percentile and maximum of a time [us]."""

    p50: float
    p99: float
    max: float

    @classmethod
    def from_bins(cls, bins: np.ndarray[Any, np.dtype[np.int64]], max_ns: int) -> Spread | None:
        """Return the spread of a histogram with bins of 1 us; None if it is empty."""
        total = int(bins.sum())
        if total == 0:
            return None
        cumulated = np.cumsum(bins)
        top = max_ns / 1000

        def at(share: float) -> float:
            row = int(np.searchsorted(cumulated, share * total))
            return min(row + 1.0, top) if row < BINS - 1 else top

        return cls(at(0.5), at(0.99), top)

    def as_dict(self) -> dict[str, float]:
        """Return plain values for JSON."""
        return {"p50": self.p50, "p99": self.p99, "max": self.max}


def rig_filters(controllers: Controllers, bus: int = 0) -> tuple[tuple[int, int], ...]:
    """Return the receive filters of the data plane on one of its buses: the CANopen objects of the host, and of the
    motors and brakes there, and no other identifier.

    So the bus (or Linux's CAN core) drops foreign frames, and a flood of them costs the cycle nothing.
    """
    c = controllers.control[0]
    identifiers = {int(CobId.NMT), int(c["sync_cob_id"]), CobId.HEARTBEAT + int(c["host_id"])}
    for controller in controllers:
        identifiers |= {can_id for can_id in controller.can_ids() if controllers.bus_of[can_id] == bus}
    return tuple((can_id, CAN_SFF_EXACT) for can_id in sorted(identifiers))


class DataPlane:
    """The process that runs the cycle of `controllers` on the buses at `addresses`.

    The controllers work on the shared records from then on.

    Parameters
    ----------
    addresses : one for each bus, in the order of `rigs.rig.Rig.channels`
    priority : SCHED_FIFO priority; None requests no real-time right
    cpu : CPU to which the process is pinned; None leaves it free
    line : socket of a simulated bus, used instead of a bus at an address; closed with the data plane

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        the bus does not exist
    """

    states: socket.socket | None = None
    """Socket with a `host.world.records.StateRecord` of each axis after each cycle, for a rig with [world]."""
    MODULE = "coulombus.host.realtime.process"
    """Module that the process runs."""

    def __init__(
        self,
        controllers: Controllers,
        *addresses: BusAddress,
        priority: int | None = PRIORITY,
        cpu: int | None = None,
        line: socket.socket | None = None,
    ) -> None:
        self._clients: list[Client | socket.socket] = [] if line is None else [line]
        self._addresses = addresses
        try:
            for k, address in enumerate(addresses if line is None else ()):
                self._clients.append(Client(address, Hello(Flags.ERRORS, rig_filters(controllers, k))))
        except BaseException:
            self._close_clients()
            raise
        self.shared = SharedPlane.create(len(controllers.each))
        controllers.adopt(self.shared.axes)
        self.shared.owner[:] = controllers.owner
        self.shared.bus_of[:] = controllers.bus_of
        self.shared.plane["packed"] = sum(address.packs_frames << k for k, address in enumerate(addresses))
        self._controllers = controllers
        self._batch = frames(BATCH_FRAMES)
        self._rows = new_records(TraceRow, TRACE_ROWS)
        self.real_time: list[dict[str, Any]] = []
        self._process = self._start(priority, cpu)

    def _start(self, priority: int | None, cpu: int | None) -> subprocess.Popen[str]:
        rig = self._controllers.rig
        sender: socket.socket | None = None
        if any(axis.world is not None for axis in rig.axes):
            self.states, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, STATES_BYTES)
        bus_fds = [client.fileno() for client in self._clients]
        fds = [*bus_fds, self.shared.fd, *([] if sender is None else [sender.fileno()])]
        settings = {
            "parent": os.getpid(),
            "bus_fds": bus_fds,
            "memory_fd": self.shared.fd,
            "axes": self.shared.axis_count,
            "world_fd": -1 if sender is None else sender.fileno(),
            "law": rig.law_function,
            "law_directory": str(rig.law_directory.absolute()),
            "kinematics": None if rig.kinematics is None else rig.kinematics.model_dump(),
            "priority": priority,
            "cpu": cpu,
        }
        root = str(Path(__file__).parents[__name__.count(".")])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", self.MODULE, json.dumps(settings)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=fds,
            start_new_session=True,  # Ctrl-C of the terminal goes to the parent only
            env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        if sender is not None:
            sender.close()
        return process

    @property
    def pid(self) -> int:
        """Process id of the data plane."""
        return self._process.pid

    def wait_ready(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait until the data plane has loaded everything and listens; PlaneError if it does not."""
        out = self._process.stdout
        assert out is not None
        ready, _, _ = select.select([out], [], [], timeout_s)
        line = out.readline() if ready else ""
        if not line:
            status = self._process.poll()
            reason = "did not start in time" if status is None else f"ended at its start with status {status}"
            raise PlaneError(f"the data plane's process {reason}; its messages are above")
        self.real_time = json.loads(line)["real_time"]

    def tell_recording(self, path: Path | None, zero_ns: int) -> None:
        """Tell the process the recording, or the folder of its segments, and its time 0 of CLOCK_MONOTONIC; None: there is none.

        After the end of the parent it appends the marker of the trip to it.
        """
        name = b"" if path is None else os.fsencode(path.absolute())
        if len(name) <= len(self.shared.recording):
            self.shared.zero_ns[0] = zero_ns
            self.shared.recording[: len(name)] = np.frombuffer(name, np.uint8)

    # state

    @property
    def status(self) -> PlaneStatus:
        """State of the data plane."""
        return PlaneStatus(int(self.shared.plane["status"][0]))

    @property
    def cycles(self) -> int:
        """Number of cycles so far."""
        return int(self.shared.plane["cycles"][0])

    @property
    def alive(self) -> bool:
        """Whether the process exists."""
        return self._process.poll() is None

    @property
    def fate(self) -> str:
        """Text of the state of a process that no longer cycles."""
        status = self._process.poll()
        if status is None:
            stopped = os.waitid(os.P_PID, self.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT)
            return "stands still" if stopped is None else "is stopped, as by SIGSTOP"
        return f"was ended by signal {-status}: {signal.strsignal(-status)}" if status < 0 else f"ended with {status}"

    @property
    def lost_text(self) -> str:
        """Text of the reason why the bus is lost."""
        number, bus = int(self.shared.plane["error"][0]), int(self.shared.plane["lost_bus"][0]) - 1
        text = "its process ended" if number == 0 else os.strerror(number)
        return f"{self._addresses[bus]}: {text}" if len(self._addresses) > 1 and bus >= 0 else text

    # commands

    def start_cycle(self, at_ns: int) -> None:
        """Begin the cycle at CLOCK_MONOTONIC = `at_ns`."""
        self._controllers.start(at_ns)
        self.shared.plane["start_ns"] = at_ns
        self.shared.plane["command"] = PlaneCommand.CYCLE

    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Request the safe state: the normal end, or with the reason `trip`.

        The first reason counts.
        """
        plane = self.shared.plane
        plane["stop"] = max(1, int(trip)) if plane["stop"][0] <= 1 else plane["stop"]

    def attend(self) -> None:
        """Report that the parent runs: without a report for `PARENT_NS`, the data plane enters the safe state."""
        self.shared.plane["parent_ns"] = time.monotonic_ns() + PARENT_NS

    def hold_deadman(self, until_ns: int) -> None:
        """Count the dead man's switch as held until CLOCK_MONOTONIC = `until_ns`."""
        self.shared.plane["deadman_ns"] = until_ns

    def publish_order(self, axis: int, number: int) -> None:
        """Publish order `number` in the axis' buffer, which the step takes in the next cycle."""
        plane = self.shared.plane
        plane["order_axis"] = axis
        plane["order"] = number

    def end_cycle(self) -> None:
        """End the cycle, with set-points of zero torque last, and continue to listen."""
        self.shared.plane["command"] = PlaneCommand.LISTEN

    def await_end(self) -> None:
        """Wait until the ended cycle has ramped the brakes off."""
        deadline = time.monotonic() + 1.0 + self._controllers.ending_s
        while self.alive and self.status is PlaneStatus.CYCLING and time.monotonic() < deadline:
            self.attend()
            time.sleep(2e-3)

    def take_frames(self) -> Records:
        """Return copies of the frames logged since the last call, with stamps of CLOCK_MONOTONIC."""
        count = take_log(self.shared.plane, self.shared.ring, self._batch)
        return self._batch[:count].copy()

    def take_trace(self) -> Records:
        """Return copies of the trace's rows (`recording.trace`) since the last call, with stamps of
        CLOCK_MONOTONIC.
        """
        count = take_trace(self.shared.plane, self.shared.trace, self._rows)
        return self._rows[:count].copy()

    def close(self, timeout_s: float = 2.0) -> None:
        """End the process by command, or kill it after the longest safe state plus `timeout_s`.

        May be called again.
        """
        if self._process.stdout is None or self._process.stdout.closed:
            return
        self.shared.recording[:] = 0  # the parent has closed it
        self.shared.plane["command"] = PlaneCommand.QUIT
        deadline = time.monotonic() + timeout_s + self._controllers.ending_s
        while self.alive and time.monotonic() < deadline:
            time.sleep(2e-3)
        if self.alive:
            self._process.kill()
        self._process.wait()
        self._process.stdout.close()
        self._close_clients()
        if self.states is not None:
            self.states.close()
        self.shared.close()

    def _close_clients(self) -> None:
        for client in self._clients:
            client.close()

    # figures

    def wakeup(self) -> Spread | None:
        """Wake-up delay of the cycle."""
        return Spread.from_bins(self.shared.wakeup_bins, int(self.shared.plane["wakeup_max_ns"][0]))

    def latency(self) -> Spread | None:
        """Time from SYNC sent to the last RPDO sent."""
        return Spread.from_bins(self.shared.latency_bins, int(self.shared.plane["latency_max_ns"][0]))

    def skew(self) -> Spread | None:
        """Time from the first bus' SYNC to the last bus' SYNC of a cycle, as sent; None on one bus."""
        return Spread.from_bins(self.shared.skew_bins, int(self.shared.plane["skew_max_ns"][0]))

    def cpu_us_per_cycle(self) -> float | None:
        """CPU time of the loop for one cycle."""
        return float(self.shared.plane["cpu_ns"][0]) / 1000 / self.cycles if self.cycles else None

    def counters(self) -> dict[str, int]:
        """Return the counters of the data plane."""
        names = (
            *("missed_deadlines", "tx_full", "rx_frames", "rx_malformed", "rx_overflow", "error_frames"),
            *("foreign_sync", "log_dropped"),
        )
        return {name: int(self.shared.plane[name][0]) for name in names}
