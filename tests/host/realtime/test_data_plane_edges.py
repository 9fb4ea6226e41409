"""The parent's handle of the data plane, without a process: what it commands, how long it waits, and
what it tells of a process that has ended.
"""

from __future__ import annotations

import errno
import json
import os
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Trip
from coulombus.host.realtime import data_plane
from coulombus.host.realtime.data_plane import (
    CAN_SFF_EXACT,
    PARENT_NS,
    START_TIMEOUT_S,
    DataPlane,
    PlaneError,
    Spread,
    rig_filters,
)
from coulombus.host.realtime.process import mark_trip
from coulombus.host.realtime.shared_memory import BINS, PlaneCommand, PlaneRecord, PlaneStatus, SharedPlane
from coulombus.kernels.records import new_records
from coulombus.recording.reading import read
from coulombus.recording.recorder import Recorder
from coulombus.recording.trace import TraceRow
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import BusAddress
from coulombus.wire.frame import frames

ENDING_S, STEP_S = 0.25, 2.0**-9
PID = 4321


class Out:
    """The pipe of a process: what it says, and whether it is closed."""

    def __init__(self, line=""):
        self.line, self.closed = line, False

    def readline(self):
        return self.line

    def close(self):
        self.closed = True


class Process:
    """A process that ends with `status` at a time of the clock, or when it is killed."""

    pid = PID

    def __init__(self, clock):
        self.clock, self.ends_s, self.status = clock, None, 0
        self.stdout, self.log = Out(), []

    def poll(self):
        ended = self.ends_s is not None and self.clock.s >= self.ends_s
        return self.status if ended else None

    def kill(self):
        self.log.append("kill")
        self.status, self.ends_s = -9, self.clock.s

    def wait(self):
        assert self.poll() is not None
        self.log.append("wait")


class Clock:
    """Time that passes only while someone sleeps, 1/512 s each time; `each` is called behind it."""

    def __init__(self):
        self.s, self.sleeps, self.each = 100.0, [], lambda: None

    def monotonic(self):
        return self.s

    def monotonic_ns(self):
        return round(self.s * 1e9)

    def sleep(self, seconds):
        self.s += STEP_S
        self.sleeps.append(seconds)
        self.each()


@pytest.fixture
def handle(monkeypatch):
    """Return the handle of a process that is not there."""
    found = object.__new__(DataPlane)
    found.clock = Clock()
    monkeypatch.setattr(data_plane, "time", found.clock)
    found._process = Process(found.clock)
    found.closed = []
    found._clients, found._addresses = [SimpleNamespace(close=lambda: found.closed.append("client"))], ()
    found.started = []
    found._controllers = SimpleNamespace(ending_s=ENDING_S, start=found.started.append)
    found.shared = SimpleNamespace(
        plane=new_records(PlaneRecord, 1),
        wakeup_bins=np.zeros(BINS, np.int64),
        latency_bins=np.zeros(BINS, np.int64),
        skew_bins=np.zeros(BINS, np.int64),
        ring=frames(8),
        trace=new_records(TraceRow, 8),
        recording=np.zeros(16, np.uint8),
        zero_ns=np.zeros(1, np.int64),
        close=lambda: found.closed.append("shared"),
    )
    found._batch, found._rows, found.real_time = frames(4), new_records(TraceRow, 4), []
    return found


def told(handle, name):
    return int(handle.shared.plane[name][0])


# commands


def test_the_cycle_begins_when_the_controllers_do(handle):
    handle.start_cycle(12345)
    assert handle.started == [12345]
    assert (told(handle, "start_ns"), told(handle, "command")) == (12345, PlaneCommand.CYCLE)
    handle.end_cycle()
    assert told(handle, "command") == PlaneCommand.LISTEN


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        ([Trip.NONE], 1),
        ([Trip.SPEED], Trip.SPEED),
        ([Trip.NONE, Trip.NONE], 1),
        ([Trip.NONE, Trip.HOST], Trip.HOST),
        ([Trip.HOST, Trip.NONE], Trip.HOST),
        ([Trip.HOST, Trip.RECORDING], Trip.HOST),
        ([Trip.RECORDING, Trip.HOST], Trip.RECORDING),
        ([Trip(2), Trip.HOST], Trip(2)),
    ],
)
def test_the_first_reason_to_stop_counts(handle, asked, reason):
    for trip in asked:
        handle.stop(trip)
    assert told(handle, "stop") == reason


def test_a_stop_without_a_reason_is_the_normal_end(handle):
    handle.stop()
    assert told(handle, "stop") == 1


def test_the_parent_counts_as_running_for_two_seconds_more(handle):
    handle.attend()
    assert told(handle, "parent_ns") == 102_000_000_000
    assert PARENT_NS == 2_000_000_000


def test_the_dead_man_s_key_and_an_order_go_to_the_data_plane(handle):
    handle.hold_deadman(77)
    handle.publish_order(1, 5)
    assert [told(handle, name) for name in ("deadman_ns", "order_axis", "order")] == [77, 1, 5]


# waiting


@pytest.mark.parametrize("status", [PlaneStatus.LISTENING, PlaneStatus.LOST, PlaneStatus.ENDED])
def test_an_end_is_awaited_until_the_cycle_has_ended(handle, status):
    handle.shared.plane["status"] = PlaneStatus.CYCLING

    def each():
        assert told(handle, "parent_ns") == round((handle.clock.s - STEP_S) * 1e9) + PARENT_NS
        if len(handle.clock.sleeps) == 3:
            handle.shared.plane["status"] = status

    handle.clock.each = each
    handle.await_end()
    assert handle.clock.sleeps == [2e-3] * 3


def test_an_end_is_not_awaited_of_a_process_that_has_ended(handle):
    handle.shared.plane["status"] = PlaneStatus.CYCLING
    handle._process.ends_s = 100.005
    handle.await_end()
    assert handle.clock.sleeps == [2e-3] * 3
    handle.await_end()
    assert len(handle.clock.sleeps) == 3


def test_an_end_is_awaited_for_a_second_more_than_the_brakes_need(handle):
    handle.shared.plane["status"] = PlaneStatus.CYCLING
    handle.await_end()
    assert handle.clock.s == 101.0 + ENDING_S


@pytest.mark.parametrize(("ends_s", "log"), [(100.0, ["wait"]), (100.5, ["wait"]), (None, ["kill", "wait"])])
def test_a_process_is_told_to_end_and_ended_where_it_does_not(handle, ends_s, log):
    handle._process.ends_s = ends_s
    handle.close()
    assert told(handle, "command") == PlaneCommand.QUIT
    assert handle._process.log == log
    assert handle._process.stdout.closed
    assert handle.closed == ["client", "shared"]
    assert handle.clock.s == (102.0 + ENDING_S if ends_s is None else ends_s)
    assert set(handle.clock.sleeps) <= {2e-3}
    handle.shared.plane["command"] = PlaneCommand.LISTEN
    handle.close()
    assert (handle._process.log, handle.closed) == (log, ["client", "shared"])
    assert told(handle, "command") == PlaneCommand.LISTEN


def test_the_states_of_a_world_are_closed_with_it(handle):
    handle.states, handle._process.ends_s = SimpleNamespace(close=lambda: handle.closed.append("states")), 100.0
    handle.close()
    assert handle.closed == ["client", "states", "shared"]


def test_the_recording_is_told_until_the_parent_has_closed_it(handle):
    handle.tell_recording(Path("/r.pcapng"), 77)
    assert (bytes(handle.shared.recording), told_zero(handle)) == (b"/r.pcapng".ljust(16, b"\0"), 77)
    handle._process.ends_s = 100.0
    handle.close()
    assert not handle.shared.recording.any()


@pytest.mark.parametrize(("name", "is_told"), [("/sixteen.letters", True), ("/seventeen.letter", False)])
def test_a_path_that_does_not_fit_is_not_told(handle, name, is_told):
    handle.tell_recording(Path(name), 77)
    assert (bytes(handle.shared.recording) == name.encode(), told_zero(handle) == 77) == (is_told, is_told)


def told_zero(handle):
    return int(handle.shared.zero_ns[0])


def orphan(path):
    """Return the shared memory of two axes whose parent has ended, with a recording at `path`."""
    shared = SharedPlane.create(2)
    shared.zero_ns[0] = 1_000
    if path is not None:
        shared.recording[: len(str(path))] = np.frombuffer(str(path).encode(), np.uint8)
    return shared


def trips_of(shared, *trips):
    for axis, (t_ns, trip) in zip(shared.axes, trips, strict=False):
        axis.host.trip_ns, axis.host.trip = t_ns, trip


@pytest.mark.parametrize(
    ("trips", "marker"),
    [
        ([(5_000, Trip.HOST), (4_000, Trip.NONE)], (4e-6, "trip HOST: the host's process failed, ended or hung")),
        ([(5_000, Trip.HOST), (4_000, Trip.TPDO_LOST)], (3e-6, "trip TPDO_LOST: no complete set of TPDOs for")),
        ([], None),
    ],
)
def test_the_trip_of_an_ended_parent_is_appended_to_its_recording(tmp_path, trips, marker):
    path = tmp_path / "r.pcapng"
    with Recorder(path, load_rig("bench"), "hybrid") as recorder:
        recorder.write(frames(1))
    shared = orphan(path)
    trips_of(shared, *trips)
    mark_trip(shared)
    assert read(path).markers == ([] if marker is None else [marker])
    shared.close()


@pytest.mark.parametrize("is_named", [True, False])
def test_without_a_recording_the_trip_of_an_ended_parent_is_no_error(tmp_path, is_named):
    shared = orphan(tmp_path / "none.pcapng" if is_named else None)
    trips_of(shared, (5_000, Trip.HOST))
    mark_trip(shared)
    assert list(tmp_path.iterdir()) == []
    shared.close()


def test_a_process_whose_pipe_is_not_there_is_left_alone(handle):
    handle._process.stdout = None
    handle.close()
    assert (handle._process.log, handle.closed, handle.clock.sleeps) == ([], [], [])


def test_it_is_closed_within_the_time_that_is_given(handle):
    handle.close(0.5)
    assert handle.clock.s == 100.5 + ENDING_S
    assert handle._process.log == ["kill", "wait"]


def wait(handle, monkeypatch, line, ready=True, *timeout):
    asked = []

    def select(*what):
        asked.append(what)
        return (what[0] if ready else []), [], []

    monkeypatch.setattr(data_plane, "select", SimpleNamespace(select=select))
    handle._process.stdout = Out(line)
    try:
        handle.wait_ready(*timeout)
    finally:
        assert asked == [([handle._process.stdout], [], [], *(timeout or (START_TIMEOUT_S,)))]


def test_a_process_that_is_ready_tells_its_rights(handle, monkeypatch):
    rights = [{"name": "SCHED_FIFO", "granted": False}]
    wait(handle, monkeypatch, json.dumps({"real_time": rights}) + "\n")
    assert handle.real_time == rights
    assert START_TIMEOUT_S == 180.0


@pytest.mark.parametrize(
    ("line", "ready", "status", "reason"),
    [
        ("", True, None, "did not start in time"),
        ("{}\n", False, None, "did not start in time"),
        ("", True, 3, "ended at its start with status 3"),
        ("", False, 0, "ended at its start with status 0"),
    ],
)
def test_a_process_that_does_not_come_to_that_is_an_error(handle, monkeypatch, line, ready, status, reason):
    if status is not None:
        handle._process.status, handle._process.ends_s = status, 0.0
    with pytest.raises(PlaneError) as error:
        wait(handle, monkeypatch, line, ready, 7.0)
    assert str(error.value) == f"the data plane's process {reason}; its messages are above"
    assert error.value.exit_status == 4


# what has become of it


@pytest.mark.parametrize("status", PlaneStatus)
def test_the_status_is_what_the_process_says(handle, status):
    handle.shared.plane["status"] = status
    assert handle.status is status


@pytest.mark.parametrize(
    ("status", "stopped", "fate"),
    [
        (None, None, "stands still"),
        (None, "a result", "is stopped, as by SIGSTOP"),
        (0, None, "ended with 0"),
        (5, None, "ended with 5"),
        (-1, None, f"was ended by signal 1: {signal.strsignal(1)}"),
        (-9, None, f"was ended by signal 9: {signal.strsignal(9)}"),
    ],
)
def test_what_became_of_a_process_is_told(handle, monkeypatch, status, stopped, fate):
    asked = []

    def waitid(*what):
        asked.append(what)
        return stopped

    monkeypatch.setattr(data_plane.os, "waitid", waitid)
    if status is not None:
        handle._process.status, handle._process.ends_s = status, 0.0
    assert handle.alive is (status is None)
    assert handle.pid == PID
    assert handle.fate == fate
    assert asked == [(os.P_PID, PID, os.WSTOPPED | os.WNOHANG | os.WNOWAIT)] * (status is None)


@pytest.mark.parametrize(
    ("error", "text"), [(0, "its process ended"), (1, os.strerror(1)), (errno.ENODEV, os.strerror(errno.ENODEV))]
)
def test_why_a_bus_is_lost_is_told(handle, error, text):
    handle.shared.plane["error"] = error
    assert handle.lost_text == text


@pytest.mark.parametrize(
    ("buses", "lost", "text"), [("ab", 1, "coulombus:a: "), ("ab", 2, "coulombus:b: "), ("ab", 0, ""), ("a", 1, "")]
)
def test_which_of_several_buses_is_lost_is_told(handle, buses, lost, text):
    handle._addresses = tuple(BusAddress("coulombus", name) for name in buses)
    handle.shared.plane["lost_bus"] = lost
    assert handle.lost_text == f"{text}its process ended"


def test_the_skew_of_sync_is_that_of_several_buses(handle):
    assert handle.skew() is None
    handle.shared.skew_bins[2], handle.shared.plane["skew_max_ns"] = 3, 2_400
    assert handle.skew().as_dict() == {"p50": 2.4, "p99": 2.4, "max": 2.4}


def test_what_is_logged_is_taken_once_and_as_a_copy(handle):
    ring, trace, plane = handle.shared.ring, handle.shared.trace, handle.shared.plane
    ring["can_id"][:3], trace["t_ns"][:3] = [0x181, 0x182, 0x701], [5, 6, 7]
    plane["log_head"], plane["trace_head"] = 2, 1
    found, rows = handle.take_frames(), handle.take_trace()
    plane["log_head"], plane["trace_head"] = 3, 3
    assert handle.take_frames()["can_id"].tolist() == [0x701]
    assert handle.take_trace()["t_ns"].tolist() == [6, 7]
    assert found["can_id"].tolist() == [0x181, 0x182]
    assert rows["t_ns"].tolist() == [5]
    assert len(handle.take_frames()) == len(handle.take_trace()) == 0


# figures


def spread(max_ns, **counts):
    bins = np.zeros(BINS, np.int64)
    for row, n in counts.items():
        bins[int(row[1:])] = n
    return Spread.from_bins(bins, max_ns)


@pytest.mark.parametrize(
    ("counts", "max_ns", "expected"),
    [
        ({"_3": 50, "_9": 49, "_20": 1}, 20_500, (4.0, 10.0, 20.5)),
        ({"_3": 49, "_9": 49, "_20": 2}, 20_500, (10.0, 20.5, 20.5)),
        ({"_0": 1}, 250, (0.25, 0.25, 0.25)),
        ({"_0": 1}, 2_000, (1.0, 1.0, 2.0)),
        ({f"_{BINS - 2}": 1}, 70_000_000, (BINS - 1.0, BINS - 1.0, 70_000.0)),
        ({f"_{BINS - 1}": 1}, 70_000_000, (70_000.0, 70_000.0, 70_000.0)),
    ],
)
def test_the_spread_of_a_histogram_ends_at_its_largest_time(counts, max_ns, expected):
    found = spread(max_ns, **counts)
    assert (found.p50, found.p99, found.max) == expected
    assert found.as_dict() == dict(zip(("p50", "p99", "max"), expected, strict=True))


def test_an_empty_histogram_has_no_spread():
    assert spread(7) is None


def test_the_figures_are_those_of_their_histograms(handle):
    plane = handle.shared.plane
    assert handle.wakeup() is handle.latency() is handle.cpu_us_per_cycle() is None
    handle.shared.wakeup_bins[4], plane["wakeup_max_ns"] = 1, 4_500
    handle.shared.latency_bins[7], plane["latency_max_ns"] = 1, 9_000
    assert handle.wakeup() == Spread(4.5, 4.5, 4.5)
    assert handle.latency() == Spread(8.0, 8.0, 9.0)
    plane["cpu_ns"], plane["cycles"] = 6_000, 1
    assert handle.cpu_us_per_cycle() == 6.0
    plane["cycles"] = 4
    assert (handle.cpu_us_per_cycle(), handle.cycles) == (1.5, 4)


def test_what_the_data_plane_counted_is_told_by_its_names(handle):
    names = ["missed_deadlines", "tx_full", "rx_frames", "rx_malformed", "rx_overflow"]
    names += ["error_frames", "foreign_sync", "log_dropped"]
    for k, name in enumerate(names, 3):
        handle.shared.plane[name] = k
    assert handle.counters() == {name: k for k, name in enumerate(names, 3)}


def test_the_filters_are_the_rig_s_identifiers_in_their_order_each_whole():
    found = rig_filters(Controllers(load_rig("bench"), "hybrid"))
    nodes = {base + node for base in (0x080, 0x180, 0x200, 0x580, 0x600, 0x700) for node in (1, 2)}
    assert [can_id for can_id, _ in found] == sorted({0x000, 0x080, 0x77F} | nodes)
    assert {mask for _, mask in found} == {CAN_SFF_EXACT} == {0xC00007FF}


def test_a_rig_of_several_axes_hears_one_sync():
    filters = rig_filters(Controllers(load_rig("two_axes"), "hybrid"))
    nodes = {base + node for base in (0x080, 0x180, 0x200, 0x580, 0x600, 0x700) for node in (1, 2, 3, 4)}
    assert {can_id for can_id, _ in filters} == {0x000, 0x080, 0x77F} | nodes
