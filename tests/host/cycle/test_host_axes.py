"""The cycle of two axes on one bus, step by step: whose frame it is, who waits, and that all stop
together.
"""

from __future__ import annotations

import pytest

from coulombus.host.cycle.axes import (
    WINDOW_OPEN,
    WINDOW_OVER,
    ask_to_stop,
    begin,
    finish,
    next_ns,
    on_frame,
    on_time,
    phases,
    ramps_a_brake,
    safe_setpoints,
)
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.wire.frame import new_queue
from host_bench import MS, rig_of
from plain_records import records_for_kernels


def finish_complete(axes, law_function, t_ns, *out):
    return finish(axes, law_function, t_ns, WINDOW_OPEN, *out)


def finish_waiting(axes, law_function, t_ns, *out):
    return finish(axes, law_function, t_ns, WINDOW_OVER, *out)


class Axes:
    """The two axes' records, a queue, and the calls with all their arguments."""

    def __init__(self):
        self.k = Controllers(rig_of("two_axes"), "hybrid")
        self.out = new_queue()
        self.k.start(0)
        self.host = self.k.host

    def call(self, function, t_ns):
        k = self.k
        self.out["count"] = 0
        return function(k.axes, k.law_function, t_ns, self.out)

    @property
    def sent(self):
        return [int(can_id) for can_id in self.out.frames["can_id"][: self.out["count"]]]


@pytest.mark.parametrize(("times", "first"), [((5, 9), 5), ((9, 5), 5), ((7, 7), 7)])
def test_the_earliest_axis_says_when_to_call(times, first):
    axes = Axes()
    axes.host["next_ns"] = times
    assert next_ns(axes.k.axes) == first


def test_the_phases_of_all_axes_are_one_number():
    axes = Axes()
    axes.host["phase"] = Phase.RUN, Phase.SAFE
    assert phases(records_for_kernels(axes.k.axes)) == Phase.RUN | Phase.SAFE << 4
    axes.host["phase"] = Phase.DISABLE, Phase.RUN
    assert phases(records_for_kernels(axes.k.axes)) == Phase.DISABLE | Phase.RUN << 4


def test_a_frame_goes_to_its_axis_and_an_extended_one_to_the_first():
    axes = Axes()
    k = axes.k
    k.owner[0x7FF] = 1
    for can_id in (0x7FF, 0x800, 0x8000_0183):
        on_frame(k.axes, k.owner, 5, can_id, 2, 0)
    assert axes.host["stray_frames"].tolist() == [2, 1]
    assert on_frame(k.axes, k.owner, 5, 0x183, 8, 0) == 0
    assert axes.host["arrived"].tolist() == [0, 1]
    assert on_frame(k.axes, k.owner, 5, 0x585, 8, 0) == 2


def test_a_cycle_begins_for_all_axes_with_one_sync():
    axes = Axes()
    k = axes.k
    begin(k.axes, 4 * MS, axes.out)
    assert axes.sent.count(0x80) == 1
    assert axes.host["cycle"].tolist() == [1, 1]
    assert axes.host["sync_ns"].tolist() == [4 * MS, 4 * MS]


def setpoints(axes, k):
    return [int(pdo["cob_id"]) for pdo in axes.k.rpdos[k][: int(axes.k.control[k]["rpdos"])]]


@pytest.mark.parametrize("arrived", [(3, 1), (1, 3), (3, 3), (0, 2)])
def test_axes_whose_tpdos_have_come_finish_and_the_others_wait_for_the_window(arrived):
    axes = Axes()
    axes.host["waiting"], axes.host["arrived"] = 1, arrived
    complete = [k for k in (0, 1) if arrived[k] == 3]
    assert axes.call(finish_complete, 10) == 2 - len(complete)
    assert axes.sent == [cob_id for k in complete for cob_id in setpoints(axes, k)]
    assert axes.host["waiting"].tolist() == [int(n != 3) for n in arrived]
    assert axes.call(finish_complete, 11) == 2 - len(complete)
    assert axes.sent == []  # none finishes twice
    axes.call(finish_waiting, 12)
    assert axes.sent == [cob_id for k in (0, 1) if k not in complete for cob_id in setpoints(axes, k)]
    assert axes.host["missed_in_a_row"].tolist() == [int(n != 3) for n in arrived]


@pytest.mark.parametrize("arrived", [(3, 1), (1, 3), (3, 3), (0, 2)])
def test_joints_of_one_arm_finish_together(arrived):
    k, out = Controllers(rig_of("plane"), "hybrid"), new_queue()
    k.start(0)
    assert k.arm is not None
    k.host["waiting"], k.host["arrived"] = 1, arrived
    missing = sum(n != 3 for n in arrived)
    assert finish(k.axes, k.law_function, 10, WINDOW_OPEN, out, k.arm) == missing
    assert k.host["waiting"].tolist() == [int(missing > 0)] * 2
    assert (out["count"] > 0) == (missing == 0)
    assert finish(k.axes, k.law_function, 12, WINDOW_OVER, out, k.arm) == 0
    assert k.host["waiting"].tolist() == [0, 0]


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("stop", [0, 1, 2, int(Trip.RECORDING)])
def test_where_one_axis_has_tripped_the_others_stop(first, phase, stop):
    axes = Axes()
    other = 1 - first
    axes.host["trip"][first], axes.host["phase"][first] = int(Trip.SPEED), Phase.SAFE
    axes.host["phase"][other], axes.host["stop"][other] = phase, stop
    axes.call(finish_waiting, 10)
    stopped = Trip.OTHER_AXIS if phase < Phase.SAFE and stop <= 1 else stop
    assert axes.host["stop"][other] == stopped
    assert axes.host["stop"][first] == 0


@pytest.mark.parametrize("trip", [0, 1, 2, int(Trip.HOST)])
def test_a_wish_to_stop_is_for_all_axes_and_the_first_reason_counts(trip):
    for stops, taken in (((0, 1), (trip, max(trip, 1))), ((2, 0), (2, trip)), ((1, 30), (max(trip, 1), 30))):
        axes = Axes()
        axes.host["stop"] = stops
        ask_to_stop(axes.k.axes, trip)
        assert tuple(axes.host["stop"].tolist()) == taken


def test_without_a_trip_no_axis_stops_another():
    axes = Axes()
    axes.host["phase"], axes.host["stop"] = (Phase.SAFE, Phase.RUN), (1, 0)
    axes.call(finish_waiting, 10)
    assert axes.host["stop"].tolist() == [1, 0]


def test_an_axis_alone_is_not_stopped_by_itself():
    axes = Axes()
    k = axes.k
    k.axes = k.axes[:1]
    k.host["trip"], k.host["phase"] = Trip.SPEED, Phase.STILL
    axes.call(finish_waiting, 10)
    assert k.host["stop"].tolist() == [0]


@pytest.mark.parametrize(
    ("late_ns", "cycle", "begins"), [(-9, 0, True), (-1, 3, False), (-1, 1, False), (0, 3, True), (5 * MS, 1, True)]
)
def test_the_first_axis_says_when_the_next_cycle_begins(late_ns, cycle, begins):
    axes = Axes()
    axes.host["sync_ns"], axes.host["cycle"], axes.host["waiting"] = (100, 7 * MS), (cycle, 3), (0, 1)
    axes.call(on_time, 100 + int(axes.k.control["period_ns"][0]) + late_ns)
    assert (0x80 in axes.sent) == begins
    assert set(setpoints(axes, 1)) <= set(axes.sent)  # the window of the second is over
    assert axes.host["waiting"].tolist() == [int(begins)] * 2


def test_the_last_setpoints_disable_the_drives_and_leave_the_brakes_to_their_drivers():
    axes = Axes()
    k = axes.k
    k.host["torque_Nm"], k.host["brake_Nm"] = (0.5, -0.5), (3.0, 0.2506)
    k.host["image"][:, [Image.CONTROLWORD, Image.BRAKE_CONTROLWORD, Image.TARGET_TORQUE]] = 15
    safe_setpoints(k.axes, 77, axes.out)
    assert k.host["image"][:, Image.BRAKE_CONTROLWORD].tolist() == [0, 0]
    assert axes.sent == [*setpoints(axes, 0), *setpoints(axes, 1), 0x80]
    rows = axes.out.frames[: axes.out["count"]]
    assert set(rows["t_ns"].tolist()) == {77}
    assert set(rows["source"].tolist()) == {-1}
    assert rows["length"][-1] == 0
    words = {int(row["can_id"]): int(row["word"]) for row in rows}
    assert words[0x201] == words[0x203] == 0
    assert [words[0x202], words[0x204]] == [3000, 251]
    assert words[0x80] == 0
    assert k.host["torque_Nm"].tolist() == [0.0, 0.0]
    assert k.host["brake_Nm"].tolist() == [3.0, 0.2506]


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize(
    ("own", "brake_Nm", "held"),
    [((1, 1), (2.0, 1.0), False), ((1, 0), (0.0, 1e-6), True), ((0, 1), (0.0, 1.0), False), ((0, 1), (0.5, 0), True)],
)
def test_the_end_waits_for_a_brake_that_only_the_host_ramps_off(phase, own, brake_Nm, held):
    k = Axes().k
    k.control["brake_ramps"], k.host["brake_Nm"], k.host["phase"] = own, brake_Nm, phase
    assert ramps_a_brake(k.axes) is (held and Phase.OFF < phase < Phase.DISABLE)


@pytest.mark.parametrize(
    ("brake", "most", "raw"), [(-0.5, 4500, 0), (0.0, 4500, 0), (0.25, 4500, 250), (0.25, 200, 200)]
)
def test_the_last_set_point_is_never_negative_nor_above_its_objects_limit(brake, most, raw):
    axes = Axes()
    k = axes.k
    k.host["brake_Nm"], k.control["brake_limit_raw"] = brake, most
    safe_setpoints(k.axes, 77, axes.out)
    assert k.host["image"][:, Image.BRAKE_SETPOINT].tolist() == [raw, raw]
