"""The compiled step's limits, trips and safe state: whatever the devices or the law do, the hand is
safe.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.laws.laws import compile_law
from coulombus.rigs.rig import load_rig
from host_bench import VELOCITY, HostBench, armed


def speed(bench):
    bench.counts += 16 / 0.08 + 5
    bench.cycle()


def jump(bench):
    bench.counts += 501
    bench.cycle()


def net_work(bench):
    bench.c.motor_mismatch_Nm = 9.0
    for _ in range(200):
        bench.counts += 50  # 4 rad/s ...
        bench.torque_pm = 300  # ... with 0.5 Nm: 2 W
        bench.handle_Nm = 0.0
        bench.cycle()


def pushing(bench):
    bench.torque_pm = -300  # 0.5 Nm, and the handle is held
    bench.cycles(120)


def mismatch(bench):
    bench.handle_Nm = 7.0
    bench.cycles(250)


def coil(bench):
    bench.coil_A = 1.5
    bench.cycles(5000, lambda: bench.phase >= Phase.SAFE)


def supply(bench):
    bench.supply = False
    bench.cycles(3)


def silent(bench):
    bench.silent = {"brake"}
    bench.cycles(3)


def left(bench):
    bench.state = int(PowerState.SWITCHED_ON)
    bench.cycle()


def emcy_motor(bench):
    bench.frame(0x081, 8, 0x10_7305)
    bench.cycle()


def emcy_brake(bench):
    bench.frame(0x082, 8, 0x10_4210)
    bench.cycle()


def heartbeat(bench):
    bench.heartbeats = False
    bench.cycles(400, lambda: bench.phase >= Phase.SAFE)


def stopped(bench):
    bench.frame(0x701, 1, 4)
    bench.cycle()


TRIPS = {
    Trip.SPEED: speed, Trip.ENCODER_JUMP: jump, Trip.NET_WORK: net_work, Trip.HANDLE_TORQUE: mismatch, Trip.COIL_I2T: coil,
    Trip.VOLTAGE: supply, Trip.TPDO_LOST: silent, Trip.DRIVE_STATE: left, Trip.EMCY_MOTOR: emcy_motor, Trip.EMCY_BRAKE: emcy_brake,
    Trip.HEARTBEAT_MOTOR: heartbeat, Trip.NMT_STATE: stopped, Trip.MOTOR_TORQUE: pushing,
}  # fmt: skip


@pytest.mark.parametrize("trip", TRIPS, ids=lambda trip: trip.name)
def test_each_doubt_trips_with_its_reason_and_zero_torque(trip):
    bench = armed("active") if trip is Trip.NET_WORK else armed("hybrid")
    TRIPS[trip](bench)
    assert bench.k.trip is not None
    assert bench.k.trip.startswith(trip.name)
    assert bench.phase >= Phase.SAFE
    assert bench.motor_pm == 0


def test_travel_trips_when_it_is_limited():
    bench = armed("hybrid", "limits.travel_rad=0.5")
    for _ in range(200):
        bench.counts += 40
        bench.handle_Nm = 3.0
        bench.cycle()
    assert bench.k.trip.startswith("TRAVEL")


def test_only_the_first_reason_is_told():
    bench = armed()
    jump(bench)
    supply(bench)
    assert bench.k.trip.startswith("ENCODER_JUMP")


def test_safe_state_in_its_order():
    """Torque 0 and the drive disabled at once; the brake from what is felt, at its rate, with all its
    pauses.
    """
    bench = armed("hybrid")
    assert bench.brake_Nm == pytest.approx(3.5)
    bench.frame(0x081, 8, 0x7305)
    shown, enabled = [], []
    for n in range(2100):
        bench.counts += 7 if n < 700 else 0  # the handle keeps moving, for a while
        bench.handle_Nm = 2.0
        bench.cycle()
        shown.append(bench.brake_Nm)
        enabled.append(bench.state == PowerState.OPERATION_ENABLED)
        assert bench.motor_pm == 0
    shown = np.array(shown)
    falls = -np.diff(shown)
    assert np.all(falls >= 0)
    assert np.all(falls <= 4.5 / 1800 + 0.0011)  # a count of 7300h is 1 mNm
    assert np.all(shown[:400] == shown[0])  # fast: it waits, until it must not any more
    assert shown[0] == pytest.approx(3.5, abs=0.01)
    assert np.all(shown[1902:] == 0.0)
    assert shown[1800] > 0.0
    assert enabled.index(False) <= 2
    assert bench.phase is Phase.DONE


def test_a_handle_without_a_load_is_let_go_soon():
    bench = armed("hybrid")
    bench.k.stop()
    bench.cycles(4)
    assert bench.brake_Nm < 3.4
    bench.cycles(100)
    assert bench.brake_Nm == 0.0
    assert bench.k.trip is None


def test_nothing_re_arms_by_itself():
    bench = armed("active")
    jump(bench)
    bench.cycles(3000)
    assert bench.phase is Phase.DONE
    assert bench.controlword == 0
    assert bench.motor_pm == 0


def test_a_stale_position_stops_the_motor_before_the_trip():
    bench = armed("active")
    for _ in range(20):
        bench.counts += 20
        bench.cycle()
    assert bench.motor_pm != 0
    bench.silent = {"motor"}
    bench.cycles(2)
    assert bench.motor_pm == 0
    assert bench.phase is Phase.RUN
    bench.cycle()
    assert bench.k.trip == "TPDO_LOST: no complete set of TPDOs for 3 cycles (limits.missed_tpdo_cycles)"


def mad(motion, law, state):
    state.brake_Nm = law.user[1]
    return law.user[0]


@pytest.mark.parametrize("psi", [math.nan, math.inf, -math.inf, 1e9, -1e9, 0.0])
@pytest.mark.parametrize("brake", [math.nan, math.inf, -math.inf, -2.0, 1e9])
@pytest.mark.parametrize("mode", ["active", "hybrid"])
def test_a_mad_law_cannot_get_past_the_limits(mode, psi, brake):
    bench = armed(mode)
    bench.k.law_function = mad_law()
    bench.k.law[0].user[:2] = psi, brake
    for _ in range(3):
        bench.counts += 10
        bench.handle_Nm = 3.0 if mode == "hybrid" else 0.1
        bench.cycle()
        assert abs(bench.motor_pm) <= bench.c.motor_limit_raw
        assert 0.0 <= bench.brake_Nm <= bench.c.brake_limit_Nm
        if mode == "hybrid":
            assert abs(bench.motor_pm * bench.c.motor_Nm_raw) <= 0.97 * 0.14 + bench.c.motor_Nm_raw / 2
    if not (math.isfinite(psi) and math.isfinite(brake)):
        assert bench.k.trip.startswith("LAW")
    elif mode == "hybrid" and brake < 0:
        bench.cycles(8)
        assert bench.brake_Nm == 0.0  # at the rate at which a law lets the brake go
        assert bench.h.negative_setpoints > 0


@cache
def mad_law():
    return compile_law(mad)


def test_the_brake_never_becomes_motor_torque():
    """In hybrid mode the motor's command is the compensation at most, whatever the law says."""
    bench = armed("hybrid")
    for n in range(2000):
        bench.counts += 40 * math.sin(n / 50)
        bench.handle_Nm = 3.0 * math.copysign(1, math.sin(n / 50))
        bench.cycle()
        if bench.phase is not Phase.RUN:
            break
        assert abs(bench.motor_pm * bench.c.motor_Nm_raw) <= 0.97 * 0.14 + bench.c.motor_Nm_raw / 2


def test_compensation_is_zero_when_stuck():
    bench = armed("hybrid")
    for step_counts in (0, 1, 2, -2, 2, -1):
        bench.counts += step_counts
        bench.cycle()
        assert bench.motor_pm == 0
    bench.counts += 3
    bench.handle_Nm = 3.0
    bench.cycle()
    assert bench.motor_pm == round(0.97 * 0.14 / bench.c.motor_Nm_raw)


def test_near_the_speed_limit_the_motor_may_only_brake():
    bench = armed("active", "limits.net_work_J=100.0", "limits.handle_mismatch_Nm=100.0")
    bench.k.law_function = mad_law()
    counts = 0
    for _ in range(40):
        counts = min(counts + 5, 165)  # 13.2 rad/s of 15
        bench.counts += counts
        bench.k.law[0].user[0] = -0.5  # a law that would drive on
        bench.cycle()
    assert bench.motor_pm == 0
    bench.k.law[0].user[0] = 0.5
    bench.counts += counts
    bench.cycle()
    assert bench.motor_pm < 0
    assert bench.k.trip is None


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(-(2**31), 2**31 - 1), min_size=5, max_size=60),
    st.lists(st.integers(-32768, 32767), min_size=5, max_size=60),
)
def test_any_wire_input_keeps_the_outputs_within_limits(positions, torques):
    bench = armed("active")
    for position, torque in zip(positions, torques, strict=False):
        bench.counts = position
        bench.handle_Nm = torque * 1e-3
        bench.torque_pm = torque
        bench.cycle()
        assert abs(bench.motor_pm) <= bench.c.motor_limit_raw
        assert 0 <= bench.h.image[Image.BRAKE_SETPOINT] <= round(bench.c.brake_limit_Nm / bench.c.brake_Nm_raw)


def test_positions_wrap_at_32_bits():
    bench = armed("hybrid")
    start = bench.h.counts
    bench.h.raw_position = 2**31 - 3
    bench.counts = -(2**31) + 4
    bench.handle_Nm = 3.0
    bench.cycle()
    assert bench.k.trip is None
    assert bench.h.counts - start == 7


@pytest.mark.parametrize(("can_id", "length"), [(0x181, 7), (0x181, 0), (0x281, 8), (0x182, 5)])
def test_a_pdo_of_the_wrong_length_is_dropped_and_counted(can_id, length):
    bench = armed("hybrid", *VELOCITY)
    image = bench.h.image.copy()
    bench.frame(can_id, length, -1)
    assert bench.h.malformed_pdos == 1
    assert np.array_equal(image, bench.h.image)


@given(st.integers(0x300, 0xFFFFFFFF), st.integers(0, 8), st.integers(-(2**63), 2**63 - 1))
def test_unknown_identifiers_do_nothing(can_id, length, word):
    bench = UNKNOWN
    image, phase = bench.h.image.copy(), bench.phase
    bench.frame(can_id, length, word) if can_id & 0x7FF not in (0x701, 0x702) else None
    assert np.array_equal(image, bench.h.image)
    assert bench.phase is phase
    assert bench.h.emcy == 0


UNKNOWN = HostBench()


# the hand-over from motor to brake


def leaning(*overrides, mode="active"):
    """A handle at rest whose motor displays 1 Nm: 150 counts of a spring."""
    bench = armed(mode, *overrides)
    bench.k.law_function = spring_law()
    bench.counts, bench.handle_Nm = 150.0, 1.0
    bench.cycles(60)
    assert displayed(bench) == pytest.approx(1.0, abs=0.01)
    return bench


def spring(motion, law, state):
    return 1.0


@cache
def spring_law():
    return compile_law(spring)


def displayed(bench):
    return abs(bench.motor_pm * bench.c.motor_Nm_raw)


def test_at_an_orderly_end_the_brake_is_up_before_the_motor_lets_go():
    bench = leaning()
    bench.k.stop()
    motor, brake = [], []
    while bench.phase is Phase.RUN:
        bench.cycle()
        motor.append(displayed(bench))
        brake.append(float(bench.h.brake_lagged_Nm))
    up = next(k for k, torque in enumerate(brake) if torque >= 0.95)
    assert min(motor[: up + 1]) == pytest.approx(1.0, abs=0.01)
    assert all(b <= a + 1e-9 for a, b in itertools.pairwise(motor[up:]))
    assert motor[-2] < 0.05
    assert min(brake[up:]) >= 0.95
    assert bench.k.trip is None
    bench.cycles(3000)
    assert (bench.phase, bench.brake_Nm) == (Phase.DONE, 0.0)


def test_the_display_counts_no_cycle_of_the_hand_over():
    bench = leaning()
    cycles = int(bench.h.display_cycles)
    bench.k.stop()
    bench.cycles(20)
    assert (bench.phase, bench.h.display_cycles) == (Phase.RUN, cycles)


@pytest.mark.parametrize("doubt", [jump, supply, lambda bench: bench.frame(0x081, 8, 0x7305)])
def test_a_trip_within_the_hand_over_cuts_the_motor_at_once(doubt):
    bench = leaning()
    bench.k.stop()
    bench.cycles(5)
    assert bench.phase is Phase.RUN
    doubt(bench)
    bench.cycles(2)
    assert bench.phase is Phase.SAFE
    assert bench.motor_pm == 0
    assert bench.h.level_Nm == pytest.approx(1.0, abs=0.02)


def test_a_brake_that_is_weaker_than_the_motor_lets_it_fade_slowly():
    bench = leaning("limits.brake_torque_Nm=0.6", "limits.still_handle_torque_Nm=2.0")
    bench.k.stop()
    steps = [displayed(bench)]
    while bench.phase is Phase.RUN:
        bench.cycle()
        steps.append(displayed(bench))
    assert len(steps) > 1800
    assert displayed(bench) == 0.0
    assert steps[len(steps) // 2] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("node", ["motor", "brake"])
def test_lost_tpdos_let_the_brake_take_over_what_was_displayed_before(node):
    bench = leaning()
    bench.silent = {node}
    bench.cycles(3)
    assert bench.phase is Phase.SAFE
    assert bench.brake_Nm >= 1.0
    assert bench.h.level_Nm == pytest.approx(1.0, abs=0.02)


def test_a_limit_cycle_hands_over_its_largest_torque():
    bench = leaning()
    bench.k.law_function = flipping_law()
    for _ in range(9):
        bench.cycle()
    bench.counts = 1e7
    bench.cycle()
    assert bench.phase is Phase.SAFE
    assert bench.h.level_Nm == pytest.approx(1.0, abs=0.1)


def flipping(motion, law, state):
    state.user[0] += 1.0
    return (1.0 if state.user[0] % 4.0 < 2.0 else -1.0) if state.user[0] % 2.0 < 1.0 else 0.0


@cache
def flipping_law():
    return compile_law(flipping)


def test_in_hybrid_a_wall_hands_over_and_friction_ends_at_once():
    wall = armed("hybrid", "law.function=wall")
    assert wall.c.hands_over
    friction = armed("hybrid")
    friction.k.stop()
    friction.cycle()
    assert friction.phase is Phase.SAFE
    wall.k.stop()
    wall.cycle()
    assert wall.phase is Phase.RUN


def test_a_drive_that_a_stranger_commands_leaves_operational_in_the_same_cycle():
    bench = armed("active")
    bench.frame(0x201, 4, 0x000F | 500 << 16)
    bench.cycle()
    assert bench.k.trip.startswith("SECOND_HOST")
    order = [(can_id, length, word) for _, can_id, length, word in bench.frames() if can_id == 0]
    assert order == [(0, 2, 0x80 | 1 << 8)]
    bench.cycle()
    assert not [frame for frame in bench.frames() if frame[1] == 0]


def test_a_drive_that_does_not_end_its_torque_so_keeps_its_disable_command():
    bench = armed("active")
    bench.c.ends_by_nmt = 0
    bench.frame(0x201, 4, 0x000F | 500 << 16)
    bench.cycle()
    assert bench.k.trip.startswith("SECOND_HOST")
    assert not [frame for frame in bench.frames() if frame[1] == 0]
    assert bench.controlword == 0


def test_a_strangers_command_beside_another_trip_takes_the_drive_too():
    bench = armed("active")
    bench.frame(0x201, 4, 0x000F | 500 << 16)
    bench.frame(0x082, 8, 0x8140)
    bench.cycle()
    assert bench.k.trip.startswith("EMCY_BRAKE")
    assert [can_id for _, can_id, _, _ in bench.frames()].count(0) == 1


@pytest.mark.parametrize("trip", [True, False])
def test_a_stranger_that_commands_the_drive_in_the_safe_state_loses_it_once(trip):
    bench = armed("active")
    if trip:
        bench.frame(0x082, 8, 0x8140)
    else:
        bench.k.stop()
    while bench.phase is not Phase.SAFE:
        bench.cycle()
    assert not [frame for frame in bench.frames() if frame[1] == 0]
    for nmt in (1, 0):
        bench.frame(0x201, 4, 0x000F | 500 << 16)
        bench.cycle()
        assert [can_id for _, can_id, _, _ in bench.frames()].count(0) == nmt
    assert bench.h.trip == (Trip.EMCY_BRAKE if trip else Trip.NONE)


def test_a_stranger_that_commands_the_drive_after_the_end_has_it():
    bench = armed("active")
    bench.k.stop()
    while bench.phase is not Phase.DONE:
        bench.cycle()
    bench.frame(0x201, 4, 0x000F | 500 << 16)
    bench.cycle()
    assert not [frame for frame in bench.frames() if frame[1] == 0]


def test_all_axes_hand_over_for_as_long_as_the_slowest():
    slow = "axis.right.brake.fluid_lag_s=0.2", "axis.left.limits.brake_torque_Nm=0.5"
    controls = [c.control[0] for c in Controllers(load_rig("two_axes", overrides=slow), "active").each]
    assert {int(c.rise_cycles) for c in controls} == {round(3 * 0.2 / 0.002)}
    assert {int(c.fade_cycles) for c in controls} == {round(1.8 / 0.002)}
