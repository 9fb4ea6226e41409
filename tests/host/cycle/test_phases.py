"""Arming, the law's split and the safe state, function by function: in both senses, in every
polarity, away from 0.
"""

from __future__ import annotations

import math
from functools import cache

import pytest

from coulombus.eds.cia402 import INTERNAL_LIMIT, PowerState
from coulombus.host.cycle.phases import (
    advance,
    count_still,
    disable,
    enable,
    enter,
    safe,
    sign_check,
    split_law,
    still,
    trip_to_safe,
)
from coulombus.host.cycle.records import Image, Phase, SignResult, Trip
from coulombus.host.laws.laws import compile_law
from host_bench import MS, HostBench

BOTH = pytest.mark.parametrize("sign", [1, -1])
POLARITIES = pytest.mark.parametrize(("motor", "encoder"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
SWITCHED_ON = int(PowerState.SWITCHED_ON)
T = 123 * MS


@cache
def no_number_law():
    return compile_law(lambda motion, law, state: math.nan)


def standing(phase, counts=-640, mode="hybrid", **control):
    bench = HostBench(mode).enter(phase, counts)
    bench.h.fresh = 1
    for name, value in control.items():
        setattr(bench.c, name, value)
    return bench


def releasing(brake_Nm):
    bench = standing(Phase.SAFE)
    bench.h.brake_Nm = bench.h.level_Nm = brake_Nm
    return bench


def followed(bench, torque_Nm, following):
    """Go on to the phase that a phase's function names, as the step does; return the torque."""
    if following == Phase.SAFE and bench.h.phase < Phase.SAFE:
        trip_to_safe(bench.c, bench.h, bench.h.trip, T)
    elif following != bench.h.phase:
        enter(bench.axis, following, T)
    return torque_Nm


def test_a_phase_begins_where_the_handle_stands():
    bench = standing(Phase.STILL, 77)
    h = bench.h
    h.phase_cycle, h.still, h.reference_counts = 9, 9, 9
    enter(bench.axis, int(Phase.SIGN), T)
    assert (h.phase, h.phase_cycle, h.still, h.reference_counts) == (Phase.SIGN, 0, 0, 77)


# a brake with power states of its own


ENABLED, OFF = int(PowerState.OPERATION_ENABLED), int(PowerState.SWITCH_ON_DISABLED)
READY, FAULT = int(PowerState.READY_TO_SWITCH_ON), int(PowerState.FAULT)


@pytest.mark.parametrize("motor", [SWITCHED_ON, READY])
@pytest.mark.parametrize("brake", [SWITCHED_ON, READY])
def test_arming_waits_until_motor_and_brake_are_switched_on(motor, brake):
    bench = standing(Phase.STILL, still_cycles=0)
    h = bench.h
    h.drive, h.brake_drive, h.reference_counts, h.deadman_ok, h.handle_Nm = motor, brake, h.counts, 1, 0.0
    both = motor == brake == SWITCHED_ON
    assert still(bench.c, h)[1] == (Phase.ENABLE if both else Phase.STILL)


@pytest.mark.parametrize("motor", [SWITCHED_ON, ENABLED])
@pytest.mark.parametrize("brake", [SWITCHED_ON, ENABLED])
def test_the_sign_check_waits_until_motor_and_brake_are_enabled(motor, brake):
    bench = standing(Phase.ENABLE)
    bench.h.drive, bench.h.brake_drive = motor, brake
    both = motor == brake == ENABLED
    assert enable(bench.c, bench.h, T)[1] == (Phase.SIGN if both else Phase.ENABLE)


@pytest.mark.parametrize("motor", [OFF, FAULT, ENABLED])
@pytest.mark.parametrize("brake", [OFF, FAULT, ENABLED])
def test_the_end_waits_until_motor_and_brake_are_disabled(motor, brake):
    bench = standing(Phase.DISABLE)
    bench.h.drive, bench.h.brake_drive = motor, brake
    assert disable(bench.h)[1] == (Phase.DISABLE if ENABLED in (motor, brake) else Phase.DONE)


def test_the_brake_has_the_controlword_of_its_own_state():
    bench = standing(Phase.STILL)
    h = bench.h
    h.drive, h.brake_drive = OFF, READY
    advance(bench.axis, bench.k.law_function, Trip.NONE, T)
    assert (h.image[Image.CONTROLWORD], h.image[Image.BRAKE_CONTROLWORD]) == (6, 7)


# the safe state


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize(
    ("brake", "felt", "begins"), [(0.25, 0.5, 0.5), (3.5, 3.0, 3.0), (0.0, 9.0, 4.5), (1.0, 0.0, 0.0)]
)
def test_the_safe_state_begins_once_with_its_reason_and_the_torque_that_is_felt(phase, brake, felt, begins):
    bench = standing(phase, counts=55, brake_limit_Nm=4.5)
    h = bench.h
    h.brake_Nm, h.brake_lagged_Nm, h.sign_result = brake, felt, int(SignResult.NOT_RUN)
    h.trip, h.trip_ns, h.phase_cycle, h.torque_Nm = int(Trip.NONE), 5, 40, 0.125
    trip_to_safe(bench.c, h, int(Trip.SPEED), T)
    if phase >= Phase.SAFE:
        assert (h.phase, h.trip, h.trip_ns, h.phase_cycle, h.brake_Nm) == (phase, Trip.NONE, 5, 40, brake)
        return
    assert (h.phase, h.trip, h.trip_ns, h.phase_cycle, h.brake_Nm) == (Phase.SAFE, Trip.SPEED, T, 0, begins)
    assert h.sign_result == (SignResult.REFUSED if phase is Phase.SIGN else SignResult.NOT_RUN)


@pytest.mark.parametrize(("displayed", "level"), [(0.0, 0.25), (1.0, 1.25), (9.0, 4.5)])
def test_the_brake_takes_over_what_the_motor_displayed(displayed, level):
    bench = standing(Phase.RUN, counts=55, brake_limit_Nm=4.5, coil_step=0.0, fluid_step=0.0)
    bench.h.brake_lagged_Nm, bench.h.displayed_Nm = 0.25, displayed
    trip_to_safe(bench.c, bench.h, int(Trip.NONE), T)
    assert bench.h.level_Nm == level
    assert bench.h.brake_Nm == (min(0.25 + 6.0 * (level - 0.25), 4.5) if displayed else 0.25)


def test_a_trip_within_the_hand_over_keeps_the_torque_that_the_brake_rises_to():
    bench = standing(Phase.RUN, counts=55, brake_limit_Nm=4.5)
    bench.h.brake_lagged_Nm, bench.h.displayed_Nm, bench.h.level_Nm, bench.h.end_cycles = 0.25, 0.5, 1.5, 3
    trip_to_safe(bench.c, bench.h, int(Trip.SPEED), T)
    assert bench.h.level_Nm == 1.5


LONGEST, RELEASE, UNLOADED = 12, 0.125, 0.5
LOAD = 1.0
"""On the handle, above `still_handle_Nm`."""


def safe_course(bench, counts=0, load=LOAD, longest=LONGEST):
    """The brake's torque in each cycle of SAFE, while the encoder counts `counts` a cycle."""
    c, h = bench.c, bench.h
    c.safe_longest_cycles, c.release_Nm, c.unloaded_Nm, c.release_counts = longest, RELEASE, UNLOADED, 4.0
    c.still_handle_Nm = min(c.still_handle_Nm, 0.25) if c.still_handle_Nm < math.inf else math.inf
    shown = []
    while h.phase == Phase.SAFE and len(shown) < 40:
        h.phase_cycle += 1
        h.v_counts, h.handle_Nm = counts, load
        assert followed(bench, *safe(c, h)) == 0.0  # of the motor
        shown.append(h.brake_Nm)
    return shown


def line(first, longest=LONGEST):
    """The latest release: a line that falls at the same rate to 0 in the last cycle."""
    return [min(first, RELEASE * (longest - k)) for k in range(1, longest + 1)]


@BOTH
@pytest.mark.parametrize("counts", [0, 4.0, -4.0, 100])
def test_near_the_load_the_brake_falls_in_all_of_the_time_that_is_left(sign, counts):
    bench = releasing(1.25)
    shown = safe_course(bench, counts, sign * LOAD, 25)
    assert shown == pytest.approx([1.25 - 0.05 * k for k in range(1, 26)], abs=1e-12)
    assert bench.phase is Phase.DISABLE
    assert bench.h.phase_cycle == 0


def test_far_above_the_load_the_brake_falls_at_its_rate():
    assert safe_course(releasing(2.0), 0, LOAD, 30)[:6] == [1.875, 1.75, 1.625, 1.5, 1.375, 1.25]


def test_near_the_load_it_falls_no_faster_than_its_rate():
    assert safe_course(releasing(1.0), 0, LOAD, 4) == [0.375, 0.25, 0.125, 0.0]


@pytest.mark.parametrize("counts", [4.01, -4.01, 100])
def test_the_release_pauses_while_the_handle_is_fast_but_not_for_ever(counts):
    bench = releasing(1.0)
    bench.h.missed_in_a_row = 1
    assert safe_course(bench, counts) == line(1.0)


def test_the_release_goes_on_at_the_speed_itself():
    bench = releasing(0.5)
    bench.h.missed_in_a_row = 1
    assert safe_course(bench, 4.0) == [0.375, 0.25, 0.125, 0.0]


def test_a_handle_whose_position_is_not_known_is_not_held_as_a_fast_one():
    bench = releasing(0.5)
    bench.h.fresh, bench.h.missed_in_a_row = 0, 1
    assert safe_course(bench, 100) == [0.375, 0.25, 0.125, 0.0]


@BOTH
def test_a_handle_without_a_load_is_let_go_soon(sign):
    assert safe_course(releasing(1.75), 100, sign * 0.25, 30) == [1.25, 0.75, 0.25, 0.0]
    assert safe_course(releasing(1.0), 0, sign * 0.26, 30)[:2] == [0.875, 0.75]


@pytest.mark.parametrize("doubt", ["none there", "stale", "doubted"])
@pytest.mark.parametrize("load", [0.0, 0.5])
def test_a_transducer_that_cannot_be_believed_decides_nothing(doubt, load):
    bench = releasing(0.5)
    if doubt == "none there":
        bench.c.still_handle_Nm = math.inf
    bench.h.missed_in_a_row = int(doubt == "stale")
    bench.h.trip = int(Trip.HANDLE_TORQUE if doubt == "doubted" else Trip.NONE)
    assert safe_course(bench, 0, load) == [0.375, 0.25, 0.125, 0.0]


def test_a_brake_without_torque_is_not_held_and_safe_lasts_a_cycle():
    assert safe_course(releasing(0.0), 50) == [0.0, 0.0]


# still


@BOTH
@pytest.mark.parametrize("most", [1, 6])
def test_still_is_some_counts_about_where_it_stood_in_either_sense(sign, most):
    bench = standing(Phase.STILL, counts=500)
    c, h = bench.c, bench.h
    c.still_counts = most
    near, off = most * sign, (most + 1) * sign
    for counts, count, reference in (
        (500, 1, 500),
        (500 + near, 2, 500),
        (500 - near, 3, 500),
        (500 + off, 0, 500 + off),
        (500 + off, 1, 500 + off),
        (500, 0, 500),
    ):
        h.counts = counts
        count_still(c, h)
        assert (h.still, h.reference_counts) == (count, reference)
    h.still, h.fresh = 5, 0
    h.counts = 501
    count_still(c, h)
    assert (h.still, h.reference_counts) == (0, 501)


@pytest.mark.parametrize(
    ("still_rad", "still_counts", "sign_counts"), [(0.0, 1, 20), (1e-5, 1, 20), (0.0004, 4, 20), (0.001, 12, 49)]
)
def test_still_is_an_angle_of_a_count_or_more_and_the_sign_check_looks_for_more(still_rad, still_counts, sign_counts):
    """A count is 80 urad: a hand that drifts is not taken for the motor."""
    c = HostBench("hybrid", f"limits.still_rad={still_rad}").c
    assert (c.still_counts, c.sign_counts) == (still_counts, sign_counts)


@BOTH
def test_the_handle_is_enabled_after_its_time_with_the_mean_torque_before(sign):
    bench = standing(Phase.STILL, still_cycles=4, still_handle_Nm=0.25)
    c, h = bench.c, bench.h
    h.handle_before_Nm, h.handle_samples, h.still = 7.0, 5, 0
    h.counts += c.still_counts + 1  # not still: what was summed is forgotten
    for handle in (0.0625, 0.125, 0.25, 0.125, 0.0):
        assert h.phase == Phase.STILL
        h.handle_Nm = sign * handle
        h.drive = h.brake_drive = SWITCHED_ON
        followed(bench, *still(c, h))
    assert h.phase == Phase.ENABLE
    assert h.handle_before_Nm == sign * 0.5625 / 5


@BOTH
def test_a_load_begins_the_waiting_anew(sign):
    bench = standing(Phase.STILL, still_cycles=4, still_handle_Nm=0.25)
    c, h = bench.c, bench.h
    for handle in (0.0, 0.0, 0.2578125, 0.125, 0.125, 0.125):
        h.handle_Nm = sign * handle
        h.drive = h.brake_drive = SWITCHED_ON
        followed(bench, *still(c, h))
    assert (h.phase, h.still) == (Phase.STILL, 3)
    assert h.handle_before_Nm == sign * (0.2578125 + 3 * 0.125)
    assert h.handle_samples == 4


@pytest.mark.parametrize("state", PowerState)
@pytest.mark.parametrize("deadman", [0, 1])
def test_nothing_is_enabled_without_the_switch_and_a_switched_on_drive(state, deadman):
    bench = standing(Phase.STILL, still_cycles=4)
    bench.h.still, bench.h.deadman_ok = 3, deadman
    bench.h.drive = bench.h.brake_drive = int(state)
    followed(bench, *still(bench.c, bench.h))
    assert (bench.h.phase == Phase.ENABLE) == (state == PowerState.SWITCHED_ON and deadman == 1)


@BOTH
@pytest.mark.parametrize(
    ("state", "still_for", "deadman", "handle", "trip"),
    [
        (2, 50, 1, 0.0, Trip.ENABLE_TIMEOUT),
        (4, 0, 1, 0.5, Trip.ENABLE_TIMEOUT),
        (3, 4, 0, 0.0, Trip.DEADMAN),
        (3, 3, 0, 0.0, Trip.DEADMAN),
        (3, 2, 0, 0.0, Trip.NOT_STILL),
        (3, 0, 1, 0.25, Trip.NOT_STILL),
        (3, 9, 1, 0.2578125, Trip.HANDLE_LOADED),
    ],
)
def test_a_handle_that_is_not_armed_in_time_is_refused_with_the_reason(sign, state, still_for, deadman, handle, trip):
    for waited in (99, 100, 101):
        bench = standing(Phase.STILL, still_cycles=4, still_timeout_cycles=100, still_handle_Nm=0.25)
        h = bench.h
        h.still, h.deadman_ok, h.handle_Nm, h.phase_cycle = still_for, deadman, sign * handle, waited
        h.drive = h.brake_drive = state
        followed(bench, *still(bench.c, h))
        assert h.trip == (trip if waited > 100 else Trip.NONE)
        assert h.trip_ns == (T if waited > 100 else 0)


# the sign check

STEP, LIMIT, COUNTS, TRAVEL, HAND = 2.0**-4, 0.5, 10, 60, 2.0**-5
HAND_CYCLES = 4


def checking(direction=1, motor=1, encoder=1, start=-640):
    """A sign check at torque 0; its numbers are powers of two."""
    bench = standing(Phase.SIGN, start, sign_step_Nm=STEP, sign_torque_Nm=LIMIT, sign_counts=COUNTS)
    c, h = bench.c, bench.h
    c.motor_Nm_raw, c.rad_count, c.motor_limit_raw = motor * 2.0**-8, encoder * 2.0**-6, 1000
    c.sign_travel_counts, c.sign_hand_Nm, c.sign_hand_cycles = TRAVEL, HAND, HAND_CYCLES
    h.sign_direction, h.torque_Nm, h.handle_before_Nm = direction, 0.0, -0.125
    h.sign_result = int(SignResult.NOT_RUN)
    return bench


def asked(bench, moved, torque=None, handle=0.0):
    """One cycle with the handle `moved` counts in the sense that is tried.

    Return the torque in that sense.
    """
    c, h = bench.c, bench.h
    sense = h.sign_direction
    h.counts = h.reference_counts + moved * sense * (1 if c.rad_count > 0 else -1)
    if torque is not None:
        h.torque_Nm = torque * sense
    h.handle_Nm = handle
    h.torque_Nm = followed(bench, *sign_check(c, h))
    return h.torque_Nm * sense


@BOTH
@POLARITIES
def test_the_torque_is_ramped_to_its_limit_in_the_sense_that_is_tried(sign, motor, encoder):
    bench = checking(sign, motor, encoder)
    assert [asked(bench, 0) for _ in range(9)] == [STEP * k for k in (1, 2, 3, 4, 5, 6, 7, 8, 8)]
    assert bench.phase is Phase.SIGN


@BOTH
@POLARITIES
def test_the_torque_never_exceeds_the_modes_limit(sign, motor, encoder):
    bench = checking(sign, motor, encoder)
    bench.c.motor_limit_raw = 80  # 0.3125 Nm
    assert [asked(bench, 0) for _ in range(6)] == [STEP * k for k in (1, 2, 3, 4, 5, 5)]
    bench.c.motor_limit_raw = 72  # 0.28125 Nm: no whole number of steps
    assert asked(bench, 0, STEP * 4) == 0.28125


@BOTH
@pytest.mark.parametrize(("moved", "torque"), [(9, 0.3125), (10, 0.3125), (39, 0.3125), (40, 0.25), (41, 0.25)])
def test_the_ramp_goes_on_to_four_times_the_counts_of_the_verdict(sign, moved, torque):
    assert asked(checking(sign), moved, 0.25) == torque


@BOTH
@pytest.mark.parametrize(("moved", "counts", "torque"), [(40, 4.01, 0.0), (40, 4.0, 0.25), (39, 9.0, 0.3125)])
def test_a_fast_handle_has_the_torque_taken_back_behind_the_ramp(sign, moved, counts, torque):
    bench = checking(sign)
    bench.c.release_counts, bench.h.v_counts = 4.0, sign * counts
    assert asked(bench, moved, 0.25) == torque


@BOTH
def test_the_torque_is_taken_back_five_times_as_fast_as_it_came(sign):
    bench = checking(sign)
    bench.c.release_counts, bench.h.v_counts, bench.c.sign_step_Nm = 4.0, sign * 9.0, 2.0**-6
    assert asked(bench, 40, 0.25) == 0.25 - 5 * 2.0**-6


@BOTH
@POLARITIES
@pytest.mark.parametrize(("moved", "trip"), [(-9, 0), (-10, Trip.SIGN_ENCODER), (-11, Trip.SIGN_ENCODER)])
def test_an_encoder_that_counts_the_other_way_is_refused(sign, motor, encoder, moved, trip):
    bench = checking(sign, motor, encoder)
    torque = asked(bench, moved, 0.25)
    assert bench.h.trip == trip
    assert torque == (0.0 if trip else 0.3125)
    assert bench.h.sign_result == (SignResult.REFUSED if trip else SignResult.NOT_RUN)
    assert bench.h.trip_ns == (T if trip else 0)


@BOTH
@POLARITIES
@pytest.mark.parametrize("way", [1, -1])
def test_a_handle_that_moves_too_far_is_refused(sign, motor, encoder, way):
    bench = checking(sign, motor, encoder)
    bench.c.sign_counts = 1000  # no verdict yet
    asked(bench, way * TRAVEL, 0.25)
    assert bench.h.trip == Trip.NONE
    assert asked(bench, way * (TRAVEL + 1), 0.25) == 0.0
    assert bench.h.trip == Trip.SIGN_TRAVEL
    assert bench.h.trip_ns == T


@BOTH
def test_what_moves_before_the_torque_has_turned_is_no_evidence(sign):
    bench = checking(sign)
    h = bench.h
    before = h.reference_counts
    assert asked(bench, -30, -0.25) == -0.1875
    assert h.reference_counts == before - 30 * sign
    assert bench.h.trip == Trip.NONE
    before = h.reference_counts
    assert asked(bench, -3, 0.0) == STEP  # from torque 0 on it is
    assert h.reference_counts == before


def test_a_handle_that_does_not_move_is_tried_the_other_way_and_refused():
    """Full torque, and then as long as the hand is looked at, in either sense.

    The second sense begins at the torque of the first.
    """
    bench = checking(1)
    h = bench.h
    for _ in range(8):
        asked(bench, 3)
    assert h.torque_Nm == LIMIT
    assert h.still == 1  # the cycle that reached it counts
    for _ in range(HAND_CYCLES - 1):
        asked(bench, 3)
    assert (h.still, h.sign_direction) == (HAND_CYCLES, 1)
    h.sign_moved = 1
    h.handle_samples, h.handle_during_Nm = 3, 3.0
    assert asked(bench, 3) == LIMIT
    assert (h.still, h.sign_direction) == (0, -1)
    assert (h.handle_samples, h.handle_during_Nm) == (0, 0.0)
    shown = [-asked(bench, 0) for _ in range(16)]
    assert shown == [LIMIT - STEP * k for k in range(1, 17)]
    for _ in range(HAND_CYCLES - 1):
        assert asked(bench, 3) == LIMIT
    assert bench.phase is Phase.SIGN
    assert asked(bench, 3) == 0.0
    assert h.trip == Trip.SIGN_NO_MOTION
    assert (h.sign_result, h.trip_ns) == (SignResult.REFUSED, T)
    assert h.sign_moved == 3
    assert f"moved the handle by 3 of the {COUNTS} counts" in bench.k.trip


@pytest.mark.parametrize(("first", "second", "most"), [(3, 1, 3), (1, 3, 3), (-2, -1, 0)])
def test_the_farther_of_both_senses_is_told(first, second, most):
    bench = checking(1)
    for moved in (first, second):
        for _ in range(HAND_CYCLES + 1):
            asked(bench, moved, LIMIT)
    assert bench.h.trip == Trip.SIGN_NO_MOTION
    assert bench.h.sign_moved == most


def test_a_sign_check_knows_nothing_of_the_one_before():
    bench = standing(Phase.ENABLE)
    bench.h.sign_moved, bench.h.sign_direction = 3, -1
    enter(bench.axis, int(Phase.SIGN), T)
    assert (bench.h.sign_moved, bench.h.sign_direction) == (0, 1)


@BOTH
@POLARITIES
@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ((0.0, 0.0, 0.0, 0.0), SignResult.NO_HAND),
        ((-HAND, -HAND, -HAND, -HAND), SignResult.NO_HAND),
        ((HAND, HAND, HAND, HAND), SignResult.NO_HAND),
        ((-HAND, -HAND, -HAND, -HAND * 1.25), SignResult.AGREED),
        ((-4.0, 3.0, -4.0, 4.0), SignResult.AGREED),
        ((HAND, HAND, HAND, HAND * 1.25), SignResult.REFUSED),
        ((4.0, -3.0, 4.0, -4.0), SignResult.REFUSED),
    ],
)
def test_the_hands_mean_torque_tells_the_transducers_sign(sign, motor, encoder, changes, result):
    bench = checking(sign, motor, encoder)
    h = bench.h
    asked(bench, COUNTS - 1, 0.25, handle=9.0)  # before the encoder's verdict: not summed
    for change in changes[:-1]:
        assert asked(bench, COUNTS, 0.25, handle=-0.125 + sign * change) == 0.3125
        assert bench.phase is Phase.SIGN
    torque = asked(bench, COUNTS + 30, 0.25, handle=-0.125 + sign * changes[-1])
    assert h.sign_result == result
    if result is SignResult.REFUSED:
        assert h.trip == Trip.SIGN_TRANSDUCER
        assert (torque, h.trip_ns) == (0.0, T)
    else:
        assert bench.phase is Phase.SETTLE
        assert torque == 0.25


# the law


@BOTH
def test_the_law_begins_stuck_where_the_handle_is_with_gain_0(sign):
    bench = standing(Phase.SETTLE, counts=sign * 700)
    c, h, law = bench.c, bench.h, bench.k.state[0]
    law.stuck, law.x_stuck, law.psi_Nm, law.brake_Nm, h.gain, h.armed_ns = 0, 9.0, 1.0, 1.0, 1.0, -1
    enter(bench.axis, int(Phase.RUN), T)
    assert (law.stuck, law.x_stuck, law.psi_Nm, law.brake_Nm) == (1, sign * 700 * c.rad_count, 0.0, 0.0)
    assert (h.gain, h.armed_ns, h.phase) == (0.0, T, Phase.RUN)


def split(mode, counts, encoder=1, psi=0.5, brake=0.75, gain=1.0):
    bench = standing(Phase.RUN, mode=mode)
    c, h, law = bench.c, bench.h, bench.k.state[0]
    c.rad_count, c.slide_band_counts, c.compensation_Nm = encoder * 2.0**-6, 2.0, 0.125
    c.gain_step, c.brake_limit_Nm, h.gain, law.brake_Nm = 0.25, 1.0, gain, brake
    law.psi_Nm = psi
    h.slide_counts, h.brake_Nm, h.negative_setpoints = counts, 0.0625, 3
    return bench, split_law(bench.axis)


@pytest.mark.parametrize("encoder", [1, -1])
@pytest.mark.parametrize(
    ("counts", "compensation"), [(0, 0), (2, 0), (-2, 0), (2.25, 0.125), (-2.25, -0.125), (50, 0.125), (-50, -0.125)]
)
@pytest.mark.parametrize("psi", [0.5, -0.5])
def test_the_motor_shows_the_law_and_compensates_in_slip_only(encoder, counts, compensation, psi):
    assert split("active", encoder * counts, encoder, psi)[1] == compensation - psi
    assert split("hybrid", encoder * counts, encoder, psi)[1] == compensation
    assert split("passive", encoder * counts, encoder, psi)[1] == compensation


@pytest.mark.parametrize(("mode", "shown"), [("active", -0.5), ("hybrid", -0.25), ("passive", 0.0)])
@pytest.mark.parametrize("gain", [0.25, 1.0])
def test_the_motor_has_in_hybrid_what_the_law_has_for_it(mode, shown, gain):
    bench, _ = split(mode, 0, psi=0.5)
    bench.c.gain_step, bench.h.gain, bench.axis.state.motor_Nm = 0.0, gain, 0.25
    assert split_law(bench.axis) == gain * shown
    assert bench.h.pushed_Nm == -gain * shown


def test_the_brake_bears_the_law_unless_the_motor_shows_it():
    for mode, shown in (("active", 0.0625), ("hybrid", 0.75), ("passive", 0.75)):
        assert split(mode, 0)[0].h.brake_Nm == shown


@pytest.mark.parametrize(
    ("setpoint", "shown", "negative"),
    [(0.0, 0.0, 0), (-0.5, 0.0, 1), (math.nan, 0.0, 1), (-math.inf, 0.0, 1), (1.0, 1.0, 0), (1.25, 1.0, 0)],
)
def test_the_brakes_set_point_is_never_negative_nor_above_its_limit(setpoint, shown, negative):
    h = split("hybrid", 0, brake=setpoint)[0].h
    assert (h.brake_Nm, h.negative_setpoints) == (shown, 3 + negative)


@pytest.mark.parametrize(
    ("setpoint", "clipped"),
    [(0.5, 0), (1.0, 0), (1.0625, 0), (1.125, 0), (1.1875, 1), (2.0, 1), (math.inf, 1)],
)
def test_a_set_point_that_the_limit_cuts_off_by_more_than_a_count_is_counted(setpoint, clipped):
    bench = standing(Phase.RUN)
    c, h, law = bench.c, bench.h, bench.k.state[0]
    c.gain_step, c.brake_limit_Nm, c.brake_Nm_raw, c.brake_active = 1.0, 1.0, 0.125, 1
    h.gain, h.clipped_setpoints, law.brake_Nm = 1.0, 7, setpoint
    split_law(bench.axis)
    assert (h.brake_Nm, h.clipped_setpoints) == (min(setpoint, 1.0), 7 + clipped)


@BOTH
def test_all_that_is_shown_grows_with_the_gain(sign):
    for before, gain in ((0.0, 0.25), (0.25, 0.5), (0.875, 1.0), (1.0, 1.0)):
        bench, torque = split("active", sign * 50, psi=sign * 0.5, gain=before)
        assert bench.h.gain == gain
        assert torque == sign * (0.125 - 0.5) * gain
        assert split("hybrid", 0, gain=before)[0].h.brake_Nm == gain * 0.75


# what is counted while the law is shown


def test_a_limit_of_the_drives_own_is_counted_while_the_law_is_shown():
    bench = HostBench("hybrid")
    bench.status_bits = INTERNAL_LIMIT
    bench.arm()
    assert bench.h.limited_by_drive == 0
    bench.cycles(5)
    assert bench.h.limited_by_drive == 5
    bench.status_bits = 0
    bench.cycles(5)
    assert bench.h.limited_by_drive == 5


def test_the_gain_is_known_to_be_1_when_it_is():
    bench = HostBench("hybrid", "law.gain_ramp_s=0.05")
    bench.arm()
    bench.cycles(49)
    assert bench.h.full_gain_ns == -1
    bench.cycles(2)
    assert bench.h.gain == 1.0
    at = bench.h.full_gain_ns
    assert at - bench.h.armed_ns == pytest.approx(50e6, abs=1.1e6)
    bench.cycles(5)
    assert bench.h.full_gain_ns == at
    bench.h.full_gain_ns = 0
    bench.cycle()
    assert bench.h.full_gain_ns == 0


# a whole cycle


@pytest.mark.parametrize("phase", [Phase.ENABLE, Phase.SIGN, Phase.SETTLE, Phase.DISABLE, Phase.DONE])
def test_the_law_begins_with_run_only(phase):
    bench = standing(Phase.STILL)
    bench.h.gain, bench.h.armed_ns, bench.axis.state.brake_Nm = 0.5, 7, 1.25
    enter(bench.axis, int(phase), T)
    assert (bench.h.gain, bench.h.armed_ns, bench.axis.state.brake_Nm) == (0.5, 7, 1.25)


def test_a_law_that_is_no_number_makes_brake_and_controlword_safe_in_the_same_cycle():
    bench = HostBench("hybrid").enter(Phase.RUN, counts=40)
    bench.c.brake_lag_decay, bench.c.release_Nm, bench.c.unloaded_Nm, bench.h.brake_Nm = 0.0, 0.25, 0.25, 3.0
    bench.k.law_function = no_number_law()
    bench.cycle()
    assert (bench.phase, bench.h.trip) == (Phase.SAFE, Trip.LAW)
    assert bench.h.brake_Nm == 2.75
    assert bench.brake_Nm == pytest.approx(2.75)
    assert bench.controlword == 0


def test_the_safe_states_ramp_goes_on_by_one_step_a_cycle():
    bench = HostBench("hybrid").enter(Phase.SAFE, counts=40)
    bench.h.level_Nm, bench.h.stop, bench.c.release_Nm, bench.c.unloaded_Nm = 1.0, 1, 0.125, 0.125
    for steps in range(1, 6):
        bench.cycle()
        assert (bench.phase, bench.h.brake_Nm) == (Phase.SAFE, 1.0 - 0.125 * steps)


@pytest.mark.parametrize("phase", [Phase.STILL, Phase.RUN])
def test_a_wall_of_before_pushes_nothing_when_the_law_begins_anew(phase):
    bench = standing(phase)
    bench.axis.state.motor_Nm, bench.h.pushed_Nm = 0.75, 0.5
    enter(bench.axis, int(Phase.RUN), T)
    assert (bench.axis.state.motor_Nm, bench.h.pushed_Nm) == (0.0, 0.0)


def observed(share, counts, *, felt=0, setpoint=0.5):
    """Split the law while the observer allows `share` of the compensation."""
    bench = standing(Phase.RUN)
    c, h, law = bench.c, bench.h, bench.k.state[0]
    c.rad_count, c.slide_band_counts, c.compensation_Nm, c.friction_Nm = 2.0**-6, 2.0, 0.125, 0.1875
    c.gain_step, c.brake_limit_Nm, c.viscous, c.level_is_felt = 1.0, 4.0, 0.0, felt
    h.gain, h.share, h.slide_counts, h.withheld_compensation, law.brake_Nm = 1.0, share, counts, 5, setpoint
    return bench.h, split_law(bench.axis)


@BOTH
@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_brake_bears_what_the_observer_withholds_of_the_compensation(share, sign):
    h, torque = observed(share, sign * 3)
    assert torque == sign * share * 0.125
    assert h.brake_Nm == 0.5 + (1 - share) * 0.125
    assert h.withheld_compensation == 5 + (share < 1)


@pytest.mark.parametrize("felt", [0, 1])
def test_a_handle_that_is_stuck_has_nothing_compensated_and_nothing_withheld(felt):
    h, torque = observed(0.25, 2, felt=felt)
    assert torque == 0.0
    assert h.brake_Nm == 0.5 - felt * 0.1875
    assert h.withheld_compensation == 5


@BOTH
def test_a_felt_level_leaves_out_what_friction_bears_already(sign):
    h, _ = observed(0.5, sign * 3, felt=1)
    assert h.brake_Nm == 0.5 - 0.1875 + 0.0625 + 0.0625
