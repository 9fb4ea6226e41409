"""The data plane's loop and its surroundings, without a simulated rig: allocation, the ring,
sockets that misbehave, the door, the switch.
"""

from __future__ import annotations

import errno
import os
import pty
import re
import resource
import signal
import socket
import struct
import subprocess
import threading
import time
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.errors import SafetyTrip
from coulombus.host.realtime.data_plane import DataPlane, Spread, rig_filters
from coulombus.host.realtime.log_rings import take_log
from coulombus.host.realtime.loop import run_plane
from coulombus.host.realtime.process import new_buffers
from coulombus.host.realtime.shared_memory import BINS, RING_FRAMES, PlaneCommand, PlaneStatus, SharedPlane
from coulombus.host.run.deadman import HeldKey, deadman_of
from coulombus.host.run.histogram import coarse
from coulombus.host.run.realtime_sequence import RealCourse
from coulombus.kernels.decorator import CACHE_DIR, JIT_DISABLED, kernel
from coulombus.lab.simulate import simulate
from coulombus.recording.trace import Moment
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from coulombus.wire.address import parse_address
from coulombus.wire.frame import frames
from coulombus.wire.handshake import Hello
from foreign_rigs import brake, drive, written
from host_bench import HostBench
from places import ROOT

pytestmark = [pytest.mark.real_time, pytest.mark.usefixtures("private_sockets")]

FRAME = struct.Struct("=IB3xq")


class Plane:
    """The loop in a thread, on one end of a socket pair; `other` is the bus."""

    def __init__(self, *overrides, rig="bench"):
        self.k = Controllers(load_rig(rig, overrides), "hybrid")
        self.shared = SharedPlane.create(len(self.k.each))
        self.k.adopt(self.shared.axes)
        self.shared.owner[:] = self.k.owner
        self.plane = self.shared.plane
        self.plane["packed"] = 1
        self.mine, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.other.setblocking(False)
        self.sent = []
        buffers = new_buffers([self.mine.fileno()], self.shared)
        self.status = None
        self.thread = threading.Thread(target=lambda: setattr(self, "status", run_plane(buffers, self.k.law_function)))

    def cycle(self):
        self.wait(lambda: self.plane["status"][0] == PlaneStatus.LISTENING, 120, read=False)  # the loop is loaded
        at = time.monotonic_ns() + 5_000_000
        self.k.start(at)
        self.plane["start_ns"] = at
        self.plane["command"] = PlaneCommand.CYCLE

    def read(self):
        """Take all messages that wait at the bus."""
        with suppress(BlockingIOError):
            while True:
                self.sent += list(FRAME.iter_unpack(self.other.recv(1 << 16)))

    def wait(self, condition, seconds=10, read=True):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(1e-3)
            if read:
                self.read()


@contextmanager
def running(*overrides, rig="bench"):
    plane = Plane(*overrides, rig=rig)
    plane.thread.start()
    try:
        yield plane
    finally:
        plane.plane["command"] = PlaneCommand.QUIT
        plane.thread.join()
        plane.mine.close()
        plane.other.close()
        plane.shared.close()


@pytest.mark.skipif(JIT_DISABLED, reason="the compiler is switched off")
def test_the_loop_allocates_nothing():
    def machine_code(function):
        """What the disk cache keeps of a kernel: its machine code with the callees', and the names
        that it calls.
        """
        module = function.py_func.__module__.rpartition(".")[2]
        files = list(CACHE_DIR.rglob(f"{module}.{function.py_func.__qualname__}-*.nbc"))
        assert files
        return b"".join(file.read_bytes() for file in files)

    def allocations(code):
        return set(re.findall(rb"NRT_Allocate\w*|NRT_MemInfo_(?:alloc|new)\w*", code))

    with running():
        pass
    code = machine_code(run_plane)
    for callee in (b"host5cycle4step6finish", b"host8realtime11bus_sockets8transmit", b"recvmsg", b"clock_nanosleep"):
        assert callee in code
    assert not allocations(code)
    allocates(3)
    assert allocations(machine_code(allocates))


@kernel
def allocates(n):
    return np.zeros(n).sum()


def test_it_listens_and_logs():
    with running() as plane:
        plane.other.send(FRAME.pack(0x701, 1, 5) + FRAME.pack(0x181, 8, -1))
        plane.other.send(b"no frame")
        plane.other.send(FRAME.pack(0x581, 9, 0))
        plane.other.send(FRAME.pack(0x702, 1, 0x1234567F))
        plane.wait(lambda: plane.plane["log_head"][0] == 3)
        out = frames(8)
        assert take_log(plane.plane, plane.shared.ring, out) == 3
        assert list(out["can_id"][:3]) == [0x701, 0x181, 0x702]
        assert list(out["word"][:3]) == [5, -1, 0x7F]  # nothing beyond the length
        assert plane.plane["rx_malformed"][0] == 2
        assert take_log(plane.plane, plane.shared.ring, out) == 0
    assert plane.status == PlaneStatus.ENDED


def test_a_ring_that_nobody_empties_keeps_the_oldest_frames():
    with running() as plane:
        plane.plane["log_tail"] = 10 * RING_FRAMES - 2  # it has been around
        plane.plane["log_head"] = 11 * RING_FRAMES - 3
        for can_id in (0x701, 0x702):
            plane.other.send(FRAME.pack(can_id, 1, 5))
        plane.wait(lambda: plane.plane["log_dropped"][0] == 1)
        assert plane.shared.ring[RING_FRAMES - 3]["can_id"] == 0x701


def test_without_nodes_it_trips_and_its_last_set_points_are_zero():
    with running() as plane:
        plane.cycle()
        plane.wait(lambda: plane.k.done)
        assert plane.k.trip.startswith("TPDO_LOST")
        plane.plane["command"] = PlaneCommand.LISTEN
        plane.wait(lambda: plane.plane["status"][0] == PlaneStatus.LISTENING)
        plane.read()
        sent = plane.sent
        assert sent[0][:2] == (0x080, 0)
        assert [can_id for can_id, _, _ in sent[-3:]] == [0x201, 0x202, 0x080]
        assert [word for _, _, word in sent[-3:]] == [0, 0, 0]
        assert plane.plane["cycles"][0] >= 3
        assert plane.shared.wakeup_bins.sum() >= plane.plane["cycles"][0]
        assert plane.plane["cpu_ns"][0] > 0


def test_the_time_from_sync_to_rpdo_is_not_counted_once_all_axes_are_done():
    """The nodes send no TPDO any more: the whole window, of 49 cycles, was the p99 of a short run."""
    with running() as plane:
        plane.cycle()
        plane.wait(lambda: plane.k.done)
        cycles = plane.plane["cycles"][0]
        plane.wait(lambda: plane.plane["cycles"][0] > cycles + 1)
        counted = plane.shared.latency_bins.sum()
        assert counted > 0
        plane.wait(lambda: plane.plane["cycles"][0] > cycles + 20)
        assert plane.shared.latency_bins.sum() == counted


@pytest.mark.parametrize(("kind", "ramped"), [("402", True), ("401", True), ("own", False)])
def test_a_brake_that_does_not_ramp_by_itself_is_ramped_off_before_the_loop_ends(tmp_path, kind, ramped):
    file, overrides = written(tmp_path, drive("own"), brake(kind))
    with running(*overrides, "limits.missed_tpdo_cycles=1000", "limits.safe_ramp_s=0.2", rig=str(file)) as plane:
        h = plane.shared.axes["host"]
        h["image"][:, [Image.STATUSWORD, Image.BRAKE_STATUSWORD]] = 0x27
        plane.cycle()
        plane.wait(lambda: plane.plane["cycles"][0] > 0)
        h["brake_Nm"], h["brake_lagged_Nm"], h["phase"] = 1.0, 1.0, Phase.RUN
        plane.plane["command"] = PlaneCommand.QUIT
        plane.wait(lambda: not plane.thread.is_alive())
        plane.read()
    rpdo = next(pdo for pdo in plane.k.rig.pdos() if pdo.name == "RPDO1" and pdo.node == "brake")
    at = next(k for k, one in enumerate(rpdo.signals) if one.name == "brake.setpoint_Nm")
    starts = rpdo.layout.starts[at]
    sent = [(word >> starts & 0xFFFF, word & 0xFFFF) for can_id, _, word in plane.sent if can_id == 0x202]
    raw = [setpoint for setpoint, _ in sent]
    first = next(k for k, setpoint in enumerate(raw) if setpoint)
    if not ramped:  # its own driver does, from the safe state's torque
        assert raw[-1] > 0
        return
    assert len(raw) - first >= 20
    released = raw[raw.index(max(raw)) :]  # behind what RUN sent: the brake takes over what the motor displayed
    assert released == sorted(released, reverse=True)
    assert raw[-1] == 0
    if kind == "402":  # enabled until it is off
        assert {word for setpoint, word in sent if setpoint} == {0x0F}
        assert sent[-1] == (0, 0)


def test_a_parent_that_stands_still_is_a_reason_for_the_safe_state():
    with running() as plane:
        plane.plane["parent_ns"] = 1  # long past
        plane.cycle()
        plane.wait(lambda: plane.k.done)
        assert plane.k.trip.startswith("HOST")
        assert plane.thread.is_alive()


def test_a_parent_that_has_ended_is_too_and_then_the_loop_ends_by_itself():
    with running("limits.missed_tpdo_cycles=1000") as plane:
        plane.plane["parent"] = os.getppid()  # for the first cycles nothing has happened
        plane.cycle()
        plane.wait(lambda: plane.plane["cycles"][0] > 0)
        assert plane.k.trip is None
        plane.plane["parent"] = -1
        plane.wait(lambda: not plane.thread.is_alive())
        assert plane.status == PlaneStatus.ENDED
        assert plane.k.trip.startswith("HOST")
        plane.read()
        assert [(can_id, word) for can_id, _, word in plane.sent[-3:]] == [(0x201, 0), (0x202, 0), (0x080, 0)]


def test_waiting_that_fails_is_a_lost_bus_and_no_reason_to_spin():
    """ppoll(2) refuses more entries than a process may have descriptors, at once and every time."""
    with running() as plane:
        plane.cycle()
        plane.wait(lambda: plane.plane["cycles"][0] > 0)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
        try:
            plane.thread.join(10)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert plane.status == PlaneStatus.LOST
        assert plane.plane["error"][0] == errno.EINVAL
        assert plane.k.done


def test_the_bus_goes_away():
    with running() as plane:
        plane.cycle()
        plane.wait(lambda: plane.plane["cycles"][0] > 0)
        plane.other.close()
        plane.thread.join(10)
        assert plane.status == PlaneStatus.LOST
        assert plane.k.trip.startswith(("BUS_LOST", "TPDO_LOST"))
        assert plane.k.done


def test_a_bus_that_does_not_read_blocks_nothing():
    with running("limits.missed_tpdo_cycles=1000") as plane:
        plane.shared.axes["control"]["missed_cycles"] = 20
        plane.mine.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        plane.cycle()
        plane.wait(lambda: plane.plane["tx_full"][0] > 20, read=False)
        plane.wait(lambda: plane.k.ending, read=False)
        plane.plane["command"] = PlaneCommand.LISTEN
        plane.wait(lambda: plane.plane["status"][0] == PlaneStatus.LISTENING, read=False)
    assert plane.k.trip.startswith(("TRANSMIT", "TPDO_LOST"))


def test_the_last_set_points_are_offered_until_the_bus_takes_them():
    with running("limits.missed_tpdo_cycles=1000") as plane:
        plane.mine.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        plane.cycle()
        plane.wait(lambda: plane.plane["tx_full"][0] > 0, read=False)
        plane.plane["command"] = PlaneCommand.LISTEN
        trace = plane.shared.trace
        plane.wait(lambda: (trace["kind"] == Moment.END).any(), read=False)  # now the safe ones find the queue full
        plane.wait(lambda: plane.plane["status"][0] == PlaneStatus.LISTENING)
        plane.read()
        log = frames(RING_FRAMES)
        log = log[: take_log(plane.plane, plane.shared.ring, log)]
        last = log[log["t_ns"] > trace["t_ns"][trace["kind"] == Moment.END][0]]
        assert list(last["can_id"]) == [0x201, 0x202, 0x080]
        assert [can_id for can_id, _, _ in plane.sent[-3:]] == [0x201, 0x202, 0x080]


@pytest.mark.parametrize("strict", [0, 1])
def test_frames_that_are_not_taken_trip_by_the_strictest_axis(strict):
    with running("limits.missed_tpdo_cycles=1000", rig="two_axes") as plane:
        plane.mine.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        plane.k.each[1 - strict].control["missed_cycles"] = 1_000_000
        plane.k.each[strict].control["missed_cycles"] = 20
        plane.k.host["missed_in_a_row"] = -1_000_000  # this is not about the TPDOs that do not come
        plane.cycle()
        plane.wait(lambda: plane.k.ending, read=False)
    assert plane.k.tripped.host["trip"][0] == Trip.TRANSMIT


def test_another_host_in_mid_run_is_noticed():
    with running("limits.missed_tpdo_cycles=1000") as plane:
        plane.cycle()
        plane.wait(lambda: plane.plane["cycles"][0] > 0)
        plane.other.send(FRAME.pack(0x080, 0, 0))
        plane.wait(lambda: plane.k.trip is not None)
        assert plane.k.trip.startswith("SECOND_HOST")


@pytest.mark.parametrize("trip", [Trip.NONE, Trip.RECORDING])
def test_the_parent_stops_it(trip):
    with running("limits.missed_tpdo_cycles=1000") as plane:
        plane.cycle()
        plane.wait(lambda: plane.plane["cycles"][0] > 0)
        plane.plane["stop"] = max(1, int(trip))
        plane.wait(lambda: plane.k.done)
        assert (plane.k.trip or "NONE").startswith(trip.name)


def test_the_filters_pass_the_rig_and_nothing_else():
    k = Controllers(load_rig("bench"), "hybrid")
    wanted = {can_id for can_id, _ in rig_filters(k)}
    assert {0x000, 0x080, 0x181, 0x182, 0x201, 0x202, 0x581, 0x602, 0x701, 0x702, 0x77F, 0x081} <= wanted
    for _, mask in rig_filters(k):
        assert mask & 0x7FF == 0x7FF
        assert mask & 0xC0000000 == 0xC0000000
    Hello(filters=rig_filters(k)).pack()


def test_no_bus_no_process():
    with pytest.raises(OSError, match="coulombus emulate") as caught:
        DataPlane(Controllers(load_rig("bench"), "hybrid"), parse_address("coulombus:nowhere"))
    assert caught.value.exit_status == 4


# Figures.


def test_a_data_plane_that_is_stopped_has_not_died():
    plane = DataPlane.__new__(DataPlane)
    with subprocess.Popen(["sleep", "600"]) as process:
        plane._process = process
        assert plane.fate == "stands still"
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
        assert plane.fate == "is stopped, as by SIGSTOP"
        process.kill()
        process.wait()
        assert plane.fate == "was ended by signal 9: Killed"


@pytest.mark.parametrize(
    ("trip", "error", "told"),
    [
        (Trip.HOST, None, "HOST: the host's process failed, ended or hung (it hung for 2 s)"),
        (Trip.HOST, "OSError: x (y.py:3)", "HOST: OSError: x (y.py:3)"),
        (Trip.NONE, "OSError: x (y.py:3)", "HOST: OSError: x (y.py:3)"),
        (Trip.DATA_PLANE, None, "DATA_PLANE: the data plane's process ended or hung (it is stopped)"),
        (Trip.BUS_LOST, None, "BUS_LOST: the bus is gone: its process ended, or its interface went down (Broken pipe)"),
        (Trip.NONE, None, None),
    ],
)
def test_a_trip_says_what_became_of_whom(trip, error, told):
    run = RealCourse.__new__(RealCourse)
    run.controllers, run.failure, run.error, run._fate = Controllers(load_rig("bench"), "hybrid"), None, error, ""
    run.plane = SimpleNamespace(fate="is stopped", lost_text="Broken pipe")
    if trip is Trip.DATA_PLANE:
        run._plane_gone()
        run.plane.fate = "was ended by signal 9: Killed"  # at the end, by this process
        run._plane_gone()
    elif trip is not Trip.NONE:
        run.controllers.host["trip"] = trip
    assert run.trip == told


def test_spread_of_a_histogram():
    bins = np.zeros(BINS, np.int64)
    assert Spread.from_bins(bins, 0) is None
    bins[9], bins[499], bins[BINS - 1] = 98, 1, 1
    assert Spread.from_bins(bins, 70_000_000).as_dict() == {"p50": 10.0, "p99": 500.0, "max": 70_000.0}
    bins[499] = 0
    bins[BINS - 1] = 2
    assert Spread.from_bins(bins, 70_000_000).p99 == 70_000.0


def test_the_picture_counts_every_cycle():
    bins = np.random.default_rng(1).integers(0, 5, BINS)
    edges, counts = coarse(bins)
    assert counts.sum() == bins.sum()
    assert len(edges) == len(counts) + 1
    assert np.all(np.diff(edges) > 0)


# The dead man's switch.


def test_where_a_switch_is_needed():
    bench = load_rig("bench")
    can, virtual = parse_address("socketcan:can0"), parse_address("coulombus:bench")
    assert deadman_of(bench, "active", virtual) == "none"
    assert deadman_of(bench, "passive", can) == "none"  # no motor torque
    for mode in ("active", "hybrid"):
        with pytest.raises(SafetyTrip, match=r"host\.deadman"):
            deadman_of(bench, mode, can)
        assert deadman_of(bench.variant("host.deadman=none"), mode, can) == "none"
    assert deadman_of(bench.variant("host.deadman=key"), "active", virtual) == "key"


def test_the_key_counts_while_it_repeats(monkeypatch):
    ours, theirs = pty.openpty()
    until = []
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        with HeldKey(until.append) as key:
            os.write(ours, b" ")
            time.sleep(0.02)
            assert not key.held  # one stroke is nothing
            while not key.held:
                os.write(ours, b" ")
                time.sleep(0.02)
            count = len(until)
            os.write(ours, b"x")
            assert 0 < until[-1] - time.monotonic_ns() <= 300_000_000
            deadline = time.monotonic() + 5
            while key.held:
                assert time.monotonic() < deadline
                time.sleep(0.02)
            assert len(until) == count
    os.close(ours)


def test_without_a_terminal_there_is_no_key(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        with pytest.raises(SafetyTrip, match="terminal"):
            HeldKey(print)


def test_the_step_stops_when_the_switch_is_let_go():
    bench = HostBench("hybrid")
    bench.arm()
    bench.cycles(50)
    assert bench.phase is Phase.RUN
    bench.h.deadman_ok = 0
    bench.cycle()
    assert bench.phase is Phase.SAFE
    assert bench.motor_pm == 0
    assert bench.k.trip.startswith("DEADMAN")


def test_nothing_is_armed_without_the_switch():
    bench = HostBench("hybrid", "limits.still_timeout_s=0.5")
    bench.h.deadman_ok = 0
    bench.cycles(2000, lambda: bench.phase is not Phase.STILL)
    assert bench.phase is Phase.SAFE
    assert bench.k.trip.startswith("DEADMAN")
    assert bench.h.enabled_ns == -1


def test_an_object_as_switch_must_be_one():
    for wrong in ("object:7130:1", "object:60FF:0", "object:123456:0", "yes", "object:1018:1"):
        with pytest.raises(RigError, match=r"host\.deadman"):
            load_rig("bench", [f"host.deadman={wrong}"])


def rig_with_input(deadman, data_type=0x0007):
    """Return the bench rig whose drive has an object 60FDh of this type, mapped beside the
    velocity.
    """
    folder = ROOT / "eds"
    motor = (folder / "motor.eds").read_text()
    count = int(re.search(r"\[OptionalObjects\]\nSupportedObjects=(\d+)", motor).group(1))
    motor = motor.replace(
        f"[OptionalObjects]\nSupportedObjects={count}\n",
        f"[OptionalObjects]\nSupportedObjects={count + 1}\n{count + 1}=0x60FD\n",
    )
    motor += f"\n[60FD]\nParameterName=Digital inputs\nObjectType=0x7\nDataType=0x{data_type:04X}\n"
    motor += "AccessType=ro\nDefaultValue=0\nPDOMapping=1\n"
    texts = {"motor.eds": motor, "mr_brake.eds": (folder / "mr_brake.eds").read_text()}
    bench = load_rig("bench")
    text = bench.text.replace("[host]\n", f'[host]\ndeadman = "{deadman}"\n')
    return load_rig_text(text, bench.path, texts)


@pytest.mark.parametrize(
    ("deadman", "data_type", "why"),
    [
        (
            "object:60FD:0",
            0x0007,
            r'any of them would hold the switch: name .* a mask, as in "object:60FD:0:0x00010000"',
        ),
        ("object:60FD:0", 0x0006, 'has 16 bits, .* "object:60FD:0:0x0100"'),
        ("object:60FD:0:0x0", 0x0007, "the mask is 0"),
        ("object:60FD:0:0x0", 0x0005, "the mask is 0"),
        ("object:60FD:0:0x100000000", 0x0007, "mask 0x100000000 is wider than 60FDh:0 of the motor, which has 32 bits"),
        ("object:60FD:0:0x100", 0x0005, "wider"),
        ("object:60FD:0:10000", 0x0007, "object:INDEX:SUB:MASK"),
        ("object:60FD:0:0xG", 0x0007, "object:INDEX:SUB:MASK"),
    ],
)
def test_a_switch_among_other_inputs_needs_its_mask(deadman, data_type, why):
    """One limit switch in 60FDh held a dead man's switch that was the whole object."""
    with pytest.raises(RigError, match=why) as refused:
        rig_with_input(deadman, data_type)
    line = load_rig("bench").text.splitlines().index("[host]") + 2
    assert f"bench.toml:{line}: host.deadman:" in str(refused.value)


@pytest.mark.parametrize(
    ("deadman", "data_type", "holds", "lets_go"),
    [
        ("object:60FD:0:0x00030000", 0x0007, 0x00030001, (0, 1, 0xFFFF, 0x00010000, 0x00020000, 0xFFFEFFFF)),
        ("object:60FD:0:0x80000000", 0x0004, -1, (0x7FFFFFFF, 0)),
        ("object:60FD:0:0x04", 0x0005, 0x0C, (0x08, 0xFB, 0)),
        ("object:60FD:0", 0x0005, 0x80, (0,)),
    ],
)
def test_only_all_bits_of_its_mask_hold_the_switch(deadman, data_type, holds, lets_go):
    for other in lets_go:
        bench = HostBench("hybrid", rig=rig_with_input(deadman, data_type).variant("limits.still_timeout_s=0.5"))
        bench.switch = other
        bench.cycles(600)
        assert bench.k.trip.startswith("DEADMAN")
        assert bench.h.enabled_ns == -1
        bench = HostBench("hybrid", rig=bench.rig)
        bench.switch = holds
        bench.arm()
        bench.cycles(20)
        assert bench.phase is Phase.RUN
        bench.switch = other
        bench.cycle()
        assert bench.phase is Phase.SAFE
        assert bench.motor_pm == 0
        assert bench.k.trip.startswith("DEADMAN")


def test_an_input_of_the_drive_as_switch():
    """60FD is mapped into a TPDO of its own.

    The bench arms while its bit 16 is 1, and stops in the cycle in which it is not.
    """
    rig = rig_with_input("object:60FD:0:0x00010000")
    assert [s.name for pdo in rig.pdos() if pdo.node == "motor" for s in pdo.signals][-1] == "motor.deadman"
    seen = {}

    def let_go(world):
        world.motor[0x60FD, 0] = 1  # a limit switch
        seen["t_ns"] = world.t_ns

    def press(world):
        seen["world"] = world
        world.motor[0x60FD, 0] = 0x10000
        world.at(world.t_ns + 2_500_000_000, let_go)

    result = simulate(rig, "hybrid", 5.0, script=lambda world: world.at(500_000_000, press))
    host = seen["world"].controller.host
    assert result.trip.startswith("DEADMAN")
    assert host["enabled_ns"][0] > 500_000_000  # not before it was pressed
    assert 0 < host["trip_ns"][0] - seen["t_ns"] <= 2_000_000
    assert simulate(rig, "hybrid", 1.0).trip.startswith("DEADMAN")  # never pressed
