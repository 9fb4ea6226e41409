"""The host's parent while the rig is armed: whatever call fails, once, the rig is made safe, the
recording is readable, nothing is left behind.

The data plane is played in virtual time, on the real shared memory; door, recording and course are
the real ones.
"""

from __future__ import annotations

import os
import socket
import sys
from contextlib import suppress
from types import SimpleNamespace

import pytest

from coulombus.host.cycle.records import Phase, Trip
from coulombus.host.errors import HostError
from coulombus.host.realtime.data_plane import DataPlane
from coulombus.host.realtime.shared_memory import TRACE_ROWS, PlaneCommand, PlaneStatus, SharedPlane
from coulombus.host.run import realtime_sequence
from coulombus.host.run.control_socket import HostSocket, StopRequest, control_path
from coulombus.host.run.real_run import real_run
from coulombus.host.run.run import Outputs, Run
from coulombus.kernels.records import new_records
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.reading import read
from coulombus.recording.trace import TraceRow
from coulombus.rigs.rig import load_rig
from coulombus.system import stop_signals
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.frame import frames
from fault_shim import Shim

pytestmark = pytest.mark.usefixtures("private_sockets")

MS = 1_000_000
BUS = parse_address("coulombus:x")
TORQUE_NM = 0.5
CALLS = 3
"""Of each place, with --every-fault: it is called some thousand times, always in one of a few
states.
"""


class Clock:
    """Time that passes only while someone sleeps."""

    def __init__(self):
        self.ns, self.plane = 10**12, None

    def monotonic_ns(self):
        return self.ns

    def monotonic(self):
        return self.ns * 1e-9

    def sleep(self, seconds):
        shim = sys.getprofile()
        sys.setprofile(None)  # nothing here is the parent's: a shim that looks at each call takes half of a run
        for _ in range(round(seconds * 1e3)):
            self.ns += MS
            if self.plane is not None:
                self.plane.live(self.ns)
        sys.setprofile(shim)


class Process:
    """The data plane's, as far as `DataPlane` looks at it."""

    def __init__(self):
        self.status = None
        self.stdout = SimpleNamespace(closed=False, close=lambda: setattr(self.stdout, "closed", True))

    def poll(self):
        return self.status

    def kill(self):
        self.status = -9

    def wait(self):
        return self.status


class PlayedPlane(DataPlane):
    """Cycles each ms: enabled 20 ms after the start, then torque.

    Safe at the next ms after it was asked to, done 30 ms later.
    """

    def __init__(self, controllers, address, *, priority=None, cpu=None):
        self.shared = SharedPlane.create(len(controllers.each))
        controllers.adopt(self.shared.axes)
        self._controllers, self._clients, self._addresses = (
            controllers,
            [SimpleNamespace(close=lambda: None)],
            (address,),
        )
        self._batch, self._rows, self.real_time = frames(1 << 10), new_records(TraceRow, TRACE_ROWS), []
        self._process, self.armed, self.unsafe_end = Process(), False, False
        self.clock.plane = self

    def wait_ready(self, timeout_s=0.0):
        pass

    def live(self, t_ns):
        p, h = self.shared.plane[0], self._controllers.host
        if self._process.status is not None:
            return
        if p.command != PlaneCommand.CYCLE:
            self.unsafe_end |= bool(h["torque_Nm"].any())
            p.status = PlaneStatus.ENDED if p.command == PlaneCommand.QUIT else PlaneStatus.LISTENING
            h["torque_Nm"] = 0.0
            self._process.status = 0 if p.command == PlaneCommand.QUIT else None
            return
        p.status = PlaneStatus.CYCLING
        if h["phase"][0] == Phase.OFF:
            h["phase"] = Phase.STILL
        p.cycles += 1
        if p.cycles % 10 == 0:
            self._log(p, t_ns)
        if h["phase"][0] == Phase.STILL and t_ns > p.start_ns + 20 * MS:
            h["enabled_ns"], h["phase"], h["torque_Nm"], self.armed = t_ns, Phase.RUN, TORQUE_NM, True
        asked = p.stop or (Trip.HOST if 0 < p.parent_ns < t_ns else 0)
        if asked and h["phase"][0] < Phase.SAFE:
            h["trip"], h["trip_ns"] = asked if asked > 1 else 0, t_ns
            h["phase"], h["torque_Nm"] = Phase.SAFE, 0.0
        if h["phase"][0] == Phase.SAFE and t_ns >= h["trip_ns"][0] + 30 * MS:
            h["phase"] = Phase.DONE

    def _log(self, p, t_ns):
        row = self.shared.ring[p.log_head & (len(self.shared.ring) - 1)]
        row.t_ns, row.can_id, row.length = t_ns, 0x080, 0
        p.log_head += 1


def descriptors():
    """How many are open, but for those of the shared memory, which lasts as long as its arrays."""
    places = []
    for fd in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            places.append(os.readlink(f"/proc/self/fd/{fd}"))
    return sum("memfd:" not in place for place in places)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Return a function that does one run, with the n-th call failing while the rig is armed, and
    returns what came of it.
    """
    rig = load_rig("bench", ("host.deadman=none",))

    class Control:
        def __init__(self, rig, address):
            self.wait_ns = lambda ns: clock[0].sleep(ns * 1e-9)

        def send(self, can_id, data):
            pass

        def check_alone(self, until_s):
            pass

        def close(self):
            pass

    clock = [Clock()]
    monkeypatch.setattr(realtime_sequence, "DataPlane", PlayedPlane)
    monkeypatch.setattr(realtime_sequence, "RealControlPlane", Control)
    monkeypatch.setattr(realtime_sequence, "bring_up", lambda k, control: ())
    monkeypatch.setattr(realtime_sequence, "release", lambda k, control: None)

    def run(fail_at=0, before=lambda: None, arming=True):
        clock[0] = Clock()
        monkeypatch.setattr(PlayedPlane, "clock", clock[0], raising=False)
        monkeypatch.setattr(realtime_sequence, "time", clock[0])
        monkeypatch.setattr("coulombus.host.realtime.data_plane.time", clock[0])
        shim, planes = Shim(fail_at), []

        def begin():
            planes.append(clock[0].plane)
            before()
            shim.__enter__()

        class Signals(stop_signals.Signals):
            def defer(self):  # from here on the rig is being armed
                super().defer()
                if arming:
                    begin()
                elif shim.failed is None:
                    shim.__exit__()

        record = tmp_path / "r.pcapng"
        record.unlink(missing_ok=True)
        control_path(BUS).unlink(missing_ok=True)
        before_run = descriptors()
        result, refusal = None, None
        try:
            if not arming:
                begin()
            run = Run(rig, "passive", 0.03, outputs=Outputs(record=record))
            result = real_run(run, bus=BUS, signals=Signals())
        except (HostError, BusUnavailable, RecordingError) as error:
            refusal = error
        finally:
            shim.__exit__()
        left = descriptors() - before_run
        if arming and not planes:
            raise refusal
        plane = planes[0] if arming else clock[0].plane
        return SimpleNamespace(result=result, refusal=refusal, shim=shim, plane=plane, record=record, left=left)

    return run


def judge(found):
    """Return what is wrong with the end of a run in which a call failed."""
    h, plane, result = found.plane._controllers.host, found.plane, found.result
    wrong = []
    if found.refusal is not None:
        return [f"refused while it was armed: {found.refusal!r}"]
    if h["phase"][0] != Phase.DONE or h["torque_Nm"].any() or plane.unsafe_end:
        wrong.append(f"not safe: {Phase(int(h['phase'][0])).name}")
    if plane._process.status is None:
        wrong.append("the data plane's process is left")
    if control_path(BUS).exists() or found.left > 0:
        wrong.append(f"left behind: {found.left} descriptors, the socket {control_path(BUS).exists()}")
    if result.exit_status == 0 and result.trip is None:
        pass  # who was absorbed: a marker, an asker
    elif result.exit_status != 7 or not result.trip.startswith(("HOST", "RECORDING")):
        wrong.append(f"status {result.exit_status}, trip {result.trip}")
    try:
        read(found.record)
    except Exception as error:
        wrong.append(f"the recording cannot be read: {error}")
    return wrong


def test_without_a_fault_the_run_ends_well(bench):
    found = bench()
    assert (found.result.exit_status, found.result.trip) == (0, None)
    assert found.plane.armed
    assert judge(found) == []
    assert len(found.shim.sites) > 100


def test_many_silent_askers_take_no_descriptor_from_a_run(bench):
    """253 of them ended it with status 2, and no trip."""
    silent = []

    def crowd():
        for _ in range(8):  # as many as wait at the door at a time
            silent.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
            silent[-1].connect(str(control_path(BUS)))

    found = bench(before=crowd)
    assert (found.result.exit_status, found.result.trip) == (0, None)
    for asker in silent:
        asker.close()


def test_an_error_of_the_parent_is_a_trip_with_its_name(bench, monkeypatch):
    def broken(self):
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(HostSocket, "stop_wanted", broken)
    found = bench()
    assert found.result.exit_status == 7
    assert found.result.trip.startswith("HOST: OSError: [Errno 24] Too many open files")
    assert found.plane.shared.plane["stop"][0] == Trip.HOST
    assert judge(found) == []


def test_a_trip_after_the_safe_end_is_the_last_marker(bench, monkeypatch):
    def broken(control):
        raise RuntimeError("no more")

    monkeypatch.setattr(realtime_sequence, "shut_down", broken)
    found = bench()
    assert found.result.trip.startswith("HOST: RuntimeError: no more (realtime_sequence.py:")
    markers = [text for _, text in read(found.record).markers]
    assert markers[-2:] == ["safe", f"trip {found.result.trip}"]


def test_a_data_plane_that_dies_is_the_last_marker_at_its_time(bench, monkeypatch):
    live = PlayedPlane.live

    def die(self, t_ns):
        live(self, t_ns)
        if self.armed:
            self._process.status = -9

    monkeypatch.setattr(PlayedPlane, "live", die)
    monkeypatch.setattr(PlayedPlane, "fate", "was ended by signal 9: Killed")
    found = bench()
    assert found.result.trip.startswith("DATA_PLANE")
    recording = read(found.record)
    at_s, text = recording.markers[-1]
    assert text.startswith("trip DATA_PLANE")
    assert at_s == found.result.trip_ns / 1e9 > recording.ends_s[1]


def test_a_recording_that_is_removed_is_a_trip_while_it_runs(bench, tmp_path):
    """It was a FileNotFoundError of the library at the end."""
    found = bench(before=lambda: (tmp_path / "r.pcapng").unlink())
    assert found.result.exit_status == 7
    assert found.result.trip.startswith(f"RECORDING: {tmp_path / 'r.pcapng'}")
    assert "the file or its folder was removed" in found.result.trip
    assert found.plane.shared.plane["stop"][0] == Trip.RECORDING
    assert found.plane._controllers.host["phase"][0] == Phase.DONE


def test_a_stop_by_command_is_no_fault(bench):
    requests = []
    found = bench(before=lambda: requests.append(StopRequest(BUS)))
    assert (found.result.exit_status, found.result.stopped_by) == (0, "coulombus stop")
    assert requests[0].result()["exit_status"] == 0


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_whatever_call_of_the_parent_fails_the_rig_is_made_safe(bench, pytestconfig):
    """Each place in the code that calls into C, at its first call.

    With --every-fault at its first calls and its last one.

    What a call that failed half-way through opening leaves is closed with its last reference:
    ResourceWarning tells of that.
    """
    bench()  # loads what is compiled
    reference = bench().shim
    wrong = {}
    for number in reference.numbers(CALLS if pytestconfig.getoption("--every-fault") else 1):
        try:
            found = bench(number)
        except Exception as error:
            wrong[number] = repr(error)
            continue
        if faults := judge(found):
            wrong[found.shim.failed or number] = faults
    assert wrong == {}


def judge_refusal(found):
    """Return what is wrong with the end of a run in which a call failed before anything was
    armed.
    """
    wrong, plane = [], found.plane
    if found.refusal is None:  # who was absorbed
        return [] if found.result.exit_status == 0 else judge(found)
    if found.refusal.exit_status not in (2, 4, 7) or "\n" in str(found.refusal):
        wrong.append(f"no documented end: {found.refusal!r}")
    if plane is not None and (plane.armed or plane.unsafe_end or plane._process.status is None):
        wrong.append("the data plane was armed, or is left")
    if control_path(BUS).exists() or found.left > 0:
        wrong.append(f"left behind: {found.left} descriptors, the socket {control_path(BUS).exists()}")
    if found.record.exists():
        try:
            read(found.record)
        except Exception as error:
            wrong.append(f"the recording cannot be read: {error}")
    return wrong


def test_an_error_before_arming_is_a_refusal_with_its_place(bench, monkeypatch):
    def broken(k, control):
        raise OSError(24, "Too many open files")

    done = []
    monkeypatch.setattr(realtime_sequence, "bring_up", broken)
    monkeypatch.setattr(realtime_sequence, "shut_down", done.append)
    found = bench(arming=False)
    assert found.refusal.exit_status == 7
    assert str(found.refusal).startswith(
        "arming refused: OSError: [Errno 24] Too many open files (realtime_sequence.py:"
    )
    assert len(done) == 1  # the nodes were sent to PRE-OPERATIONAL
    assert judge_refusal(found) == []


@pytest.mark.parametrize("status", [PlaneStatus.LOST, PlaneStatus.ENDED])
def test_a_data_plane_that_has_ended_before_arming_is_no_run_that_went_well(bench, monkeypatch, status):
    """It was exit status 0 after 0 cycles."""

    def lose(k, control):
        plane = PlayedPlane.clock.plane
        plane.shared.plane["status"], plane.shared.plane["error"] = status, 5
        plane._process.status = 0
        return ()

    monkeypatch.setattr(realtime_sequence, "bring_up", lose)
    found = bench(arming=False)
    assert found.refusal.exit_status == 4
    assert "lost before anything was armed: Input/output error" in str(found.refusal)
    assert judge_refusal(found) == []


def test_a_bus_that_is_lost_before_the_first_cycle_is_a_trip(bench, monkeypatch):
    start = DataPlane.start_cycle

    def lose(self, at_ns):
        start(self, at_ns)
        self.shared.plane["status"], self.shared.plane["error"] = PlaneStatus.LOST, 5
        self._process.status = 0

    monkeypatch.setattr(PlayedPlane, "start_cycle", lose)
    monkeypatch.setattr(PlayedPlane, "live", lambda self, t_ns: None)
    found = bench()
    assert found.result.exit_status == 7
    assert found.result.trip.startswith("BUS_LOST")


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_whatever_call_before_arming_fails_nothing_is_armed(bench, pytestconfig):
    if not pytestconfig.getoption("--every-fault"):
        pytest.skip("with --every-fault only: some hundred runs")
    bench(arming=False)
    reference = bench(arming=False).shim
    assert len(reference.sites) > 50
    wrong = {}
    for number in reference.numbers(CALLS):
        try:
            found = bench(number, arming=False)
        except Exception as error:
            wrong[number] = repr(error)
            continue
        if faults := judge_refusal(found):
            wrong[found.shim.failed or number] = faults
    assert list(wrong.items()) == []
