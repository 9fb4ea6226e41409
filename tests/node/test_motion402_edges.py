"""The drive's torque, function by function: limits, ramps, slopes and the velocity loop, in both
senses.
"""

from __future__ import annotations

import math

import pytest

from coulombus.node import homing402, motion402, slots, slots402
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import number
from coulombus.node.record import new_nodes
from coulombus.wire.clock import NEVER_NS

KIND_DRIVE = number(DRIVE402)
SLOTS = vars(slots) | vars(slots402)

T = 5_000_000_000
MS = 1_000_000
OE, QSA, FAULT = 4, 5, 7
POSITION, VELOCITY, TORQUE, HOMING, INTERPOLATED, CSP, CSV, CST = 1, 3, 4, 6, 7, 8, 9, 10
POSITIONS = POSITION, HOMING, INTERPOLATED, CSP
SLOW, QUICK, TO_ZERO = 1, 2, 3
BOTH = pytest.mark.parametrize("sign", [1, -1])
LOWEST, HIGHEST = -(2**31), 2**31 - 1


def drive(mode=TORQUE, torque=0.0, speed=0.0, **values):
    """An enabled drive whose limits are 800 upwards and 700 downwards; Kp is 1/4, Ki 64 per mille
    per (count/s).
    """
    nodes = new_nodes(1)
    n = nodes[0]
    n.kind, n.nmt, n.powered, n.power_state, n.mode, n.controlword = KIND_DRIVE, 5, 1, OE, mode, 15
    n.modes, n.demand_ns, n.torque_demand_pm, n.out_torque_pm = 0x30C, T, torque, torque
    n.in_velocity_counts_s = n.speed_demand = speed
    n.speed_kp, n.speed_ki, n.index_counts = 0.25, 64.0, 30.0  # 6080h of 2 is 1 count/s
    v = n.values
    v[slots402.MODE] = v[slots402.MODE_DISPLAY] = mode
    v[slots402.MAX_TORQUE], v[slots402.POSITIVE_LIMIT], v[slots402.NEGATIVE_LIMIT], v[slots402.MAX_CURRENT] = (
        1000,
        800,
        700,
        900,
    )
    v[slots402.LOWEST_POSITION], v[slots402.HIGHEST_POSITION] = LOWEST, HIGHEST
    v[slots402.MAX_MOTOR_SPEED] = 2_000_000
    v[slots402.TORQUE_SLOPE], v[slots402.SLOW_DOWN_MS], v[slots402.MAX_VELOCITY] = 1000, 1000, 10**6
    v[slots402.ACCELERATION], v[slots402.DECELERATION], v[slots402.QUICK_STOP_DECELERATION] = 1000, 2000, 4000
    for name, value in values.items():
        v[SLOTS[name]] = value
    return n


def moved(n, elapsed_ns):
    """Let the mode's function compute; return the torque."""
    motion402.other_mode(n, T + elapsed_ns, elapsed_ns)
    return float(n.out_torque_pm)


# a mode of the maker's own


@pytest.mark.parametrize(
    ("target", "torque", "limited"),
    [(1600, 800, 0), (1602, 800, 1), (-1400, -700, 0), (-1402, -700, 1), (-5000, -700, 1), (7, 3.5, 0), (0, 0, 0)],
)
def test_the_makers_set_point_acts_at_once_within_the_limits(target, torque, limited):
    n = drive(-3, 250.0, VENDOR_TARGET=target)
    n.vendor_mode, n.vendor_slot, n.vendor_pm = -3, slots402.VENDOR_TARGET, 0.5
    assert moved(n, 1) == torque
    assert (n.torque_demand_pm, n.limited) == (torque, limited)
    n.controlword = 0x10F  # halt
    assert moved(n, 1) == 0
    assert n.limited == 0


# limits


@pytest.mark.parametrize(
    ("values", "high", "low"),
    [
        ({}, 800, -700),
        ({"MAX_TORQUE": 100}, 100, -100),
        ({"MAX_CURRENT": 100}, 100, -100),
        ({"POSITIVE_LIMIT": 950, "NEGATIVE_LIMIT": 950}, 900, -900),
        ({"POSITIVE_LIMIT": 0}, 0, -700),
        ({"NEGATIVE_LIMIT": 0}, 800, 0),
        ({"MAX_TORQUE": -500}, 0, 0),  # of a signed object: no torque, and none that is forced
        ({"MAX_CURRENT": -1}, 0, 0),
        ({"POSITIVE_LIMIT": -200}, 0, -700),
        ({"NEGATIVE_LIMIT": -200}, 800, -200),
        ({"MAX_TORQUE": 1}, 1, -1),
    ],
)
def test_the_limits_are_the_least_of_three(values, high, low):
    n = drive(**values)
    assert (motion402.high_limit(n), motion402.low_limit(n)) == (high, low)


@pytest.mark.parametrize(
    ("position", "speed", "up", "down"),
    [
        (0, 0.0, True, True),
        (99, 0.0, True, True),
        (100, 0.0, False, True),
        (101, 0.0, False, True),
        (-99, 0.0, True, True),
        (-100, 0.0, True, False),
        (-101, 0.0, True, False),
        (2**32 + 100, 0.0, False, True),
        (2**32 - 100, 0.0, True, False),
        (2**31, 0.0, True, False),
        (0, 499.5, True, True),
        (0, 500.0, False, True),
        (0, -499.5, True, True),
        (0, -500.0, True, False),
        (100, -500.0, False, False),
        (-100, 500.0, False, False),
    ],
)
def test_beyond_a_position_or_a_speed_nothing_pushes_further(position, speed, up, down):
    n = drive(LOWEST_POSITION=-100, HIGHEST_POSITION=100, MAX_MOTOR_SPEED=1000)
    n.in_position_counts, n.in_velocity_counts_s = position, speed
    assert motion402.high_limit(n) == (800 if up else 0)
    assert motion402.low_limit(n) == (-700 if down else 0)


@pytest.mark.parametrize(
    ("rpm", "speed"), [(0, 0.0), (1, 0.5), (3, 1.5), (2**32 - 2, 2147483647.0), (2**32 - 1, math.inf)]
)
def test_6080h_is_in_rpm_of_the_motor(rpm, speed):
    assert motion402.largest_speed(drive(MAX_MOTOR_SPEED=rpm)) == speed


@pytest.mark.parametrize(
    ("values", "guarded"),
    [
        ({}, False),
        ({"LOWEST_POSITION": LOWEST + 1}, True),
        ({"HIGHEST_POSITION": HIGHEST - 1}, True),
        ({"MAX_MOTOR_SPEED": 2**32 - 2}, True),
    ],
)
def test_607Dh_and_6080h_guard_a_drive_unless_they_limit_nothing(values, guarded):
    assert motion402.has_limits(drive(**{"MAX_MOTOR_SPEED": 2**32 - 1, **values})) == guarded


@pytest.mark.parametrize("position", [LOWEST, HIGHEST])
def test_the_ends_of_the_counter_are_no_limits(position):
    n = drive()
    n.in_position_counts = position
    assert (motion402.high_limit(n), motion402.low_limit(n)) == (800, -700)


# beginnings and ends


def test_a_stop_leaves_nothing():
    n = drive(torque=5.0, TORQUE_DEMAND=5, VELOCITY_DEMAND=5)
    n.slowing, n.ramping, n.integral_pm = SLOW, 1, 5.0
    motion402.stop(n)
    assert (n.slowing, n.ramping, n.integral_pm, n.torque_demand_pm, n.out_torque_pm) == (0, 0, 0.0, 0.0, 0.0)
    assert (n.values[slots402.TORQUE_DEMAND], n.values[slots402.VELOCITY_DEMAND]) == (0, 0)


def test_operation_begins_from_the_speed_that_is():
    n = drive(speed=77.0)
    n.speed_demand, n.slowing, n.integral_pm = 5.0, SLOW, 5.0
    motion402.enter(n, T + 3)
    assert (n.speed_demand, n.slowing, n.integral_pm) == (77.0, 0, 0.0)
    assert (n.demand_ns, n.off_target_ns, n.moving_ns) == (T + 3, T + 3, T + 3)


@pytest.mark.parametrize(
    ("mode", "taken"),
    [
        (3, 3),
        (4, 4),
        (9, 9),
        (10, 10),
        (0, 0),
        (1, 0),
        (5, 0),
        (-1, 0),
        (11, 0),
        (68, 0),
        (-60, 0),
        (-128, 0),
        (127, 0),
    ],
)
@pytest.mark.parametrize("state", [3, OE])
def test_a_mode_is_taken_at_torque_0_and_one_that_is_not_there_is_none(mode, taken, state):
    n = drive(4, speed=77.0, MODE=mode)
    n.power_state, n.speed_demand, n.integral_pm = state, 5.0, 5.0
    motion402.change_mode(n, T)
    assert (n.mode, n.values[slots402.MODE_DISPLAY]) == (taken, taken)
    changed = taken != 4
    assert n.integral_pm == (0.0 if changed else 5.0)
    waits = changed and state == OE
    assert (n.setpoint_stale, n.speed_demand) == ((1, 77.0) if waits else (0, 5.0))


@BOTH
@pytest.mark.parametrize(
    ("state", "mode", "torque", "slowing", "begins"),
    [
        (OE, 4, 100.0, 0, True),
        (3, 4, 100.0, 0, False),
        (OE, 0, 100.0, 0, False),
        (OE, 4, 0.0, 0, False),
        (OE, 4, 100.0, SLOW, None),
        (OE, 4, 0.5, 0, True),
    ],
)
def test_a_mode_changes_behind_a_ramp_where_there_is_torque(sign, state, mode, torque, slowing, begins):
    n = drive(mode, sign * torque, MODE=10)
    n.power_state, n.slowing, n.slowing_to, n.slowing_ns = state, slowing, 3, T - 5
    motion402.change_mode(n, T)
    if begins is None:
        assert (n.mode, n.slowing, n.slowing_to, n.slowing_ns) == (mode, SLOW, 3, T - 5)
    elif begins:
        assert (n.mode, n.slowing, n.slowing_to, n.slowing_ns, n.torque_demand_pm) == (
            mode,
            TO_ZERO,
            OE,
            T,
            sign * torque,
        )
    else:
        assert (n.mode, n.slowing, n.torque_demand_pm) == (10, 0, 0.0)


# ramps


def slowed(n, ramp, *elapsed_ms, state=FAULT):
    """The torque right after the begin and then after each time."""
    motion402.begin(n, T, ramp, state)
    shown = [float(n.out_torque_pm)]
    before = 0
    for ms in elapsed_ms:
        if n.slowing:
            motion402.other_mode(n, T + round(ms * MS), round((ms - before) * MS))
        before = ms
        shown.append(float(n.out_torque_pm))
    return shown


@BOTH
@pytest.mark.parametrize(
    ("mode", "ramp"), [(TORQUE, SLOW), (CST, SLOW), (TORQUE, TO_ZERO), (VELOCITY, TO_ZERO), (CSV, TO_ZERO)]
)
def test_torque_goes_to_0_by_its_slope_and_the_state_follows(sign, mode, ramp):
    n = drive(mode, sign * 64.0)
    n.demand_ns = T - 9
    assert slowed(n, ramp, 16, 63) == pytest.approx([sign * 64.0, sign * 48.0, sign * 1.0])
    assert (n.power_state, n.slowing, n.slowing_to, n.slowing_ns, n.ramping) == (OE, ramp, FAULT, T, 1)
    assert n.demand_ns == T
    assert n.values[slots402.TORQUE_DEMAND] == sign * 1
    assert moved(n, 64 * MS) == 0.0
    assert (n.power_state, n.slowing, n.torque_demand_pm, n.ramping) == (FAULT, 0, 0.0, 0)


@BOTH
@pytest.mark.parametrize("mode", [TORQUE, CST])
def test_a_quick_stop_of_a_torque_mode_is_at_once(sign, mode):
    n = drive(mode, sign * 64.0)
    assert slowed(n, QUICK) == [0.0]
    assert (n.power_state, n.slowing) == (FAULT, 0)


@BOTH
@pytest.mark.parametrize(("ramp", "rate"), [(SLOW, 2000), (QUICK, 4000)])
@pytest.mark.parametrize("mode", [VELOCITY, CSV])
def test_a_speed_is_slowed_down_by_its_deceleration(sign, ramp, rate, mode):
    n = drive(mode, sign * 8.0, sign * 512.0)
    n.integral_pm, n.speed_ki = sign * 8.0, 0.0
    motion402.begin(n, T, ramp, QSA)
    assert n.speed_demand == sign * 512.0
    motion402.other_mode(n, T + 100 * MS, 100 * MS)
    assert n.speed_demand == pytest.approx(sign * (512.0 - rate / 10))
    assert n.out_torque_pm == pytest.approx(sign * (8.0 - 0.25 * rate / 10))
    assert (n.power_state, n.slowing) == (OE, ramp)
    motion402.other_mode(n, T + 200 * MS, 100 * MS)
    assert (n.power_state == QSA) == (rate == 4000)
    if rate == 4000:
        assert (n.slowing, n.out_torque_pm) == (0, 0.0)


@BOTH
@pytest.mark.parametrize(("elapsed_ms", "over"), [(19, False), (19.99999, False), (20, True), (21, True)])
def test_no_ramp_lasts_longer_than_2006h(sign, elapsed_ms, over):
    for mode in (TORQUE, VELOCITY):
        n = drive(mode, sign * 600.0, sign * 9e4, SLOW_DOWN_MS=20, TORQUE_SLOPE=1, DECELERATION=1)
        n.speed_demand = sign * 9e4
        slowed(n, SLOW, elapsed_ms)
        assert (n.power_state, n.slowing) == ((FAULT, 0) if over else (OE, SLOW))


@BOTH
@pytest.mark.parametrize("mode", [TORQUE, VELOCITY])
def test_no_ramp_outlives_the_supply(sign, mode):
    n = drive(mode, sign * 600.0, sign * 900.0)
    slowed(n, SLOW, 1)
    assert n.slowing == SLOW
    n.in_supply_ok = 0
    assert moved(n, 2 * MS) == 0.0
    assert n.power_state == FAULT


@BOTH
def test_the_end_of_a_ramp_of_speed_asks_for_no_torque(sign):
    n = drive(VELOCITY, 0.0, sign * 9000.0)
    n.speed_demand = sign * 10.0
    slowed(n, SLOW, 16)
    assert (n.power_state, n.out_torque_pm, n.limited) == (
        FAULT,
        0.0,
        1,
    )  # 1: from the begin, when it was still asked for
    n.power_state, n.slowing, n.slowing_to, n.speed_demand, n.limited = OE, SLOW, FAULT, sign * 10.0, 0
    moved(n, 16 * MS)
    assert (n.power_state, n.limited) == (FAULT, 0)


def test_a_ramp_is_within_the_limits_that_are():
    for torque, shown in ((900.0, 800.0), (-900.0, -700.0)):
        assert slowed(drive(TORQUE, torque), SLOW) == [shown]


def test_behind_a_ramp_a_waiting_mode_is_taken():
    n = drive(TORQUE, 64.0, MODE=CST)
    slowed(n, TO_ZERO, 16, state=OE)
    assert n.mode == TORQUE
    moved(n, 100 * MS)
    assert (n.mode, n.power_state, n.setpoint_stale) == (CST, OE, 1)


@BOTH
@pytest.mark.parametrize("mode", [TORQUE, VELOCITY])
def test_a_rate_of_a_signed_object_never_leads_away_from_the_target(sign, mode):
    negative = {"TORQUE_SLOPE": -1000, "ACCELERATION": -1000, "DECELERATION": -1000}
    n = drive(mode, sign * 64.0, sign * 64.0, TARGET_TORQUE=sign * 300, TARGET_VELOCITY=sign * 300, **negative)
    moved(n, 16 * MS)
    assert (n.torque_demand_pm if mode == TORQUE else n.speed_demand) == sign * 64.0
    n.controlword |= 0x100
    moved(n, 16 * MS)
    assert (n.torque_demand_pm if mode == TORQUE else n.speed_demand) == sign * 64.0


# profile torque


@BOTH
@pytest.mark.parametrize(
    ("target", "present", "elapsed_ms", "demand", "ramping", "limited"),
    [
        (300, 0.0, 16, 16.0, 1, 0),
        (300, 292.0, 16, 300.0, 0, 0),
        (300, 300.0, 16, 300.0, 0, 0),
        (-300, 100.0, 16, 84.0, 1, 0),
        (100, 300.0, 16, 284.0, 1, 0),
        (700, 690.0, 16, 700.0, 0, 0),
    ],
)
def test_profile_torque_goes_to_its_target_by_its_slope(sign, target, present, elapsed_ms, demand, ramping, limited):
    n = drive(TORQUE, sign * present, TARGET_TORQUE=sign * target)
    n.limited = 1
    assert moved(n, elapsed_ms * MS) == pytest.approx(sign * demand)
    assert (n.ramping, n.limited) == (ramping, limited)
    assert n.values[slots402.TORQUE_DEMAND] == sign * demand


@pytest.mark.parametrize(
    ("target", "present", "demand", "limited", "ramping"),
    [(800, 795.0, 800, 0, 0), (801, 795.0, 800, 1, 0), (5000, 795.0, 800, 1, 0), (-700, -695.0, -700, 0, 0),
     (-701, -695.0, -700, 1, 0), (-5000, -695.0, -700, 1, 0), (0, 950.0, 800, 0, 1), (0, -950.0, -700, 0, 1)],
)  # fmt: skip
def test_profile_torque_ends_at_the_limits_at_once(target, present, demand, limited, ramping):
    n = drive(TORQUE, present, TARGET_TORQUE=target)
    assert moved(n, 16 * MS) == demand
    assert (n.limited, n.ramping) == (limited, ramping)


@BOTH
@pytest.mark.parametrize(("option", "demand"), [(1, 84.0), (2, 0.0), (0, 84.0), (3, 84.0)])
def test_halt_is_torque_0_by_the_slope_or_at_once(sign, option, demand):
    n = drive(TORQUE, sign * 100.0, TARGET_TORQUE=sign * 300, HALT_OPTION=option)
    n.controlword = 0x10F
    assert moved(n, 16 * MS) == pytest.approx(sign * demand)
    assert n.ramping == (demand != 0)


@BOTH
@pytest.mark.parametrize("mode", [TORQUE, VELOCITY, CSV])
@pytest.mark.parametrize(
    ("name", "value"), [("power_state", 3), ("in_supply_ok", 0), ("setpoint_stale", 1), ("mode", 0)]
)
def test_no_mode_gives_torque_when_it_may_not(sign, mode, name, value):
    n = drive(mode, sign * 100.0, sign * 64.0, TARGET_TORQUE=sign * 300, TARGET_VELOCITY=sign * 9000)
    n.limited, n.speed_demand = 1, 5.0
    setattr(n, name, value)
    assert moved(n, MS) == 0.0
    assert (n.torque_demand_pm, n.speed_demand, n.limited) == (0.0, sign * 64.0, 0)


# speeds


@BOTH
@pytest.mark.parametrize(
    ("target", "present", "halted", "option", "demand"),
    [
        (500, 0.0, 0, 0, 16.0),
        (500, 100.0, 0, 0, 116.0),
        (500, 500.0, 0, 0, 500.0),
        (500, 490.0, 0, 0, 500.0),
        (100, 500.0, 0, 0, 468.0),
        (0, 500.0, 0, 0, 468.0),
        (-500, 500.0, 0, 0, 468.0),
        (-500, 16.0, 0, 0, 0.0),
        (-500, 0.0, 0, 0, -16.0),
        (500, 500.0, 1, 1, 468.0),
        (500, 500.0, 1, 2, 436.0),
        (500, 500.0, 1, 0, 468.0),
        (500, 500.0, 0, 2, 500.0),
        (100, 500.0, 0, 2, 468.0),
        (500, 16.0, 1, 1, 0.0),
        (-500, 400.0, 0, 0, 368.0),
    ],
)
def test_profile_velocity_accelerates_and_decelerates(sign, target, present, halted, option, demand):
    n = drive(VELOCITY, 0.0, sign * present, TARGET_VELOCITY=sign * target, HALT_OPTION=option)
    n.controlword |= 0x100 * halted
    moved(n, 16 * MS)
    assert n.speed_demand == pytest.approx(sign * demand)
    assert n.values[slots402.VELOCITY_DEMAND] == sign * demand
    assert n.ramping == 1


@BOTH
@pytest.mark.parametrize(("target", "elapsed_ns", "demand"), [(2, MS, 1.25), (-2, MS // 10, 0.05), (-2, MS, 0.0)])
def test_a_slow_speed_is_accelerated_decelerated_and_turned_at_0(sign, target, elapsed_ns, demand):
    n = drive(VELOCITY, 0.0, sign * 0.25, TARGET_VELOCITY=sign * target)
    moved(n, elapsed_ns)
    assert n.speed_demand == pytest.approx(sign * demand)


@BOTH
@pytest.mark.parametrize(("halted", "demand"), [(0, 530.0), (1, 0.0)])
def test_csv_follows_its_target_and_offset_at_once(sign, halted, demand):
    n = drive(CSV, 0.0, sign * 500.0, TARGET_VELOCITY=sign * 500, VELOCITY_OFFSET=sign * 30)
    n.controlword |= 0x100 * halted
    moved(n, 16 * MS)
    assert n.speed_demand == sign * demand
    n = drive(VELOCITY, 0.0, sign * 500.0, TARGET_VELOCITY=sign * 500, VELOCITY_OFFSET=sign * 30)
    moved(n, 16 * MS)
    assert n.speed_demand == sign * 500.0  # the offset is CSV's


@BOTH
@pytest.mark.parametrize(
    ("fastest", "rpm", "target", "demand", "limited"),
    [
        (-9, 2**32 - 1, 401, 0.0, 1),
        (400, -1, 401, 0.0, 1),
        (400, 2**32 - 1, 400, 400.0, 0),
        (400, 2**32 - 1, 401, 400.0, 1),
        (900, 600, 401, 300.0, 1),
        (900, 1600, 401, 401.0, 0),
    ],
)
def test_a_speed_is_within_607Fh_and_6080h(sign, fastest, rpm, target, demand, limited):
    n = drive(CSV, 0.0, 0.0, TARGET_VELOCITY=sign * target, MAX_VELOCITY=fastest, MAX_MOTOR_SPEED=rpm)
    n.speed_kp, n.limited = 0.0, 1
    n.speed_ki = 0.0
    moved(n, MS)
    assert (n.speed_demand, n.limited) == (sign * demand, limited)


@pytest.mark.parametrize(
    ("position", "speed", "target", "allowed"),
    [
        (100, 0.0, 50, False), (100, 0.0, -50, True), (-100, 0.0, -50, False), (-100, 0.0, 50, True), (0, 0.0, 50, True),
        (0, 0.0, -50, True), (100, -500.0, 50, False), (100, -500.0, -50, False), (100, 0.0, 0, True), (-100, 500.0, -1, False),
        (100, 0.0, 1, False), (100, -500.0, 0, True),
    ],
)  # fmt: skip
def test_a_speed_leads_no_further_beyond_607Dh(position, speed, target, allowed):
    n = drive(CSV, 0.0, speed, TARGET_VELOCITY=target, LOWEST_POSITION=-100, HIGHEST_POSITION=100, MAX_MOTOR_SPEED=1000)
    n.in_position_counts = position
    n.speed_kp = n.speed_ki = 0.0
    moved(n, MS)
    assert n.speed_demand == (target if allowed else 0.0)
    assert n.limited == (not allowed)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("side", [1, -1])
def test_a_very_slow_speed_leads_back_only(sign, side):
    n = drive(CSV, 0.0, 0.0, TARGET_VELOCITY=sign * 5, LOWEST_POSITION=-100, HIGHEST_POSITION=100, MAX_MOTOR_SPEED=1)
    n.in_position_counts, n.speed_kp, n.speed_ki = side * 100, 0.0, 0.0
    moved(n, MS)
    assert n.speed_demand == (0.0 if sign == side else sign * 0.5)


@BOTH
def test_the_velocity_loop_is_proportional_and_integral(sign):
    n = drive(CSV, 0.0, sign * 100.0, TARGET_VELOCITY=sign * 164)
    n.integral_pm = sign * 10.0
    assert moved(n, MS) == pytest.approx(sign * (16.0 + 10.0 + 64 * 64 * 1e-3))
    assert n.integral_pm == pytest.approx(sign * (10.0 + 64 * 64 * 1e-3))
    n = drive(CSV, 0.0, sign * 100.0, TARGET_VELOCITY=sign * 164)
    moved(n, 50 * MS)  # nobody called for longer: 10 ms count
    assert n.integral_pm == pytest.approx(sign * 64 * 64 * 1e-2)


@pytest.mark.parametrize(
    ("target", "before", "out", "integral", "limited"),
    [
        (1000, 790.0, 800.0, 790.0, 1),  # pushes further: the integral stands still
        (-1000, -690.0, -700.0, -690.0, 1),
        (-40, 900.0, 800.0, 800.0, 0),  # comes back
        (40, -900.0, -700.0, -700.0, 0),
        (40, 900.0, 800.0, 800.0, 1),
        (-40, -900.0, -700.0, -700.0, 1),
    ],
)
def test_the_integral_does_not_wind_up(target, before, out, integral, limited):
    n = drive(CSV, 0.0, 0.0, TARGET_VELOCITY=target)
    n.integral_pm = before
    assert moved(n, MS) == out
    assert n.integral_pm == integral
    assert n.limited == limited


@pytest.mark.parametrize(("integral", "most"), [(900.0, 800.0), (-900.0, -700.0)])
@pytest.mark.parametrize(("speed", "pushes"), [(50.0, 0), (49.5, 1), (50.5, -1)])
def test_the_torque_is_limited_where_an_error_however_small_pushes_further(integral, most, speed, pushes):
    n = drive(CSV, 0.0, speed, TARGET_VELOCITY=50)
    n.integral_pm = integral
    assert moved(n, MS) == most
    assert (n.integral_pm, n.limited) == (most, int(pushes * integral > 0))


@pytest.mark.parametrize(("target", "integral", "limit"), [(40, 790.0, 800.0), (-40, -690.0, -700.0)])
def test_a_torque_at_its_limit_is_not_beyond_it(target, integral, limit):
    n = drive(CSV, 0.0, 0.0, TARGET_VELOCITY=target)
    n.integral_pm, n.speed_ki = integral, 0.0
    assert moved(n, MS) == limit
    assert (n.integral_pm, n.limited) == (integral, 0)


@pytest.mark.parametrize("speed", [math.nan, math.inf, -math.inf])
def test_a_speed_that_is_no_number_is_torque_0(speed):
    n = drive(CSV, 300.0, speed, TARGET_VELOCITY=50, MAX_MOTOR_SPEED=2**32 - 1)
    n.integral_pm = 300.0
    assert moved(n, MS) == 0.0
    assert (n.integral_pm, n.speed_demand) == (0.0, 0.0)


# what it tells

REACHED, BIT12, SLIPPAGE = 0x400, 0x1000, 0x2000


@BOTH
@pytest.mark.parametrize(
    ("demand", "controlword", "slowing", "bits"),
    [(300.0, 15, 0, REACHED), (299.5, 15, 0, 0), (300.0, 15, SLOW, 0), (300.0, 0x10F, 0, 0), (0.0, 0x10F, 0, REACHED)],
)
def test_profile_torque_tells_that_its_target_is_reached(sign, demand, controlword, slowing, bits):
    n = drive(TORQUE, sign * demand, TARGET_TORQUE=sign * 300)
    n.controlword, n.slowing = controlword, slowing
    assert motion402.target_bits(n) == bits


@pytest.mark.parametrize(("mode", "controlword", "slowing", "bits"), [
    (CSV, 15, 0, BIT12), (CSV, 0x10F, 0, 0), (CSV, 15, SLOW, 0), (CST, 15, 0, 0), (0, 15, 0, 0)])  # fmt: skip
def test_csv_tells_that_it_follows_and_other_modes_nothing(mode, controlword, slowing, bits):
    n = drive(mode, TARGET_VELOCITY=0)
    n.controlword, n.slowing = controlword, slowing
    assert motion402.target_bits(n) == bits


def test_torque_of_the_makers_own_in_cia_s_mode_4_tells_nothing_of_a_target():
    n = drive(TORQUE, 300.0, TARGET_TORQUE=300)
    n.vendor_mode = TORQUE
    assert motion402.target_bits(n) == 0


def told(speed, target=0, elapsed_ms=0, controlword=15, demand=None, sign=1):
    n = drive(VELOCITY, 0.0, sign * speed, TARGET_VELOCITY=sign * target, VELOCITY_WINDOW=10, VELOCITY_WINDOW_MS=20)
    v = n.values
    v[slots402.VELOCITY_THRESHOLD], v[slots402.VELOCITY_THRESHOLD_MS], v[slots402.MAX_SLIPPAGE] = 5, 30, 40
    n.controlword, n.off_target_ns, n.moving_ns = controlword, T - round(elapsed_ms * MS), T - round(elapsed_ms * MS)
    n.speed_demand = sign * (speed if demand is None else demand)
    return n, motion402.target_bits(n)


@BOTH
@pytest.mark.parametrize(
    ("speed", "target", "elapsed_ms", "reached"),
    [
        (90.0, 100, 20, True),
        (110.0, 100, 20, True),
        (90.0, 100, 19.99999, False),
        (89.5, 100, 99, False),
        (110.5, 100, 99, False),
    ],
)
def test_a_speed_is_reached_when_it_was_in_its_window_for_its_time(sign, speed, target, elapsed_ms, reached):
    n, bits = told(speed, target, elapsed_ms, sign=sign)
    assert bits & REACHED == REACHED * reached
    assert n.off_target_ns == (T if abs(speed - target) > 10 else T - round(elapsed_ms * MS))


@BOTH
@pytest.mark.parametrize(
    ("speed", "elapsed_ms", "still"), [(5.0, 30, True), (0.0, 30, True), (5.0, 29.99999, False), (5.5, 99, False)]
)
def test_a_speed_is_0_when_it_was_below_its_threshold_for_its_time(sign, speed, elapsed_ms, still):
    n, bits = told(speed, 100, elapsed_ms, sign=sign)
    assert bits & BIT12 == BIT12 * still
    assert n.moving_ns == (T if speed > 5 else T - round(elapsed_ms * MS))


@BOTH
@pytest.mark.parametrize(("demand", "slips"), [(140.0, False), (140.5, True), (60.0, False), (59.5, True)])
def test_a_speed_that_is_off_its_demand_slips(sign, demand, slips):
    bits = told(100.0, 100, demand=demand, sign=sign)[1]
    assert bits & SLIPPAGE == SLIPPAGE * slips


def test_several_bits_are_told_together_and_halt_aims_at_speed_0():
    assert told(0.0, 0, 99)[1] == REACHED | BIT12
    assert told(0.0, 100, 99, 0x10F)[1] == REACHED | BIT12
    assert told(0.0, 0, 99, demand=50.0)[1] == REACHED | BIT12 | SLIPPAGE
    assert told(100.0, 100, 99, 0x10F)[1] == 0
    for sign in (1, -1):
        assert told(10.0, 100, 99, 0x10F, sign=sign)[1] == REACHED
        assert told(10.5, 100, 99, 0x10F, sign=sign)[1] == 0


@BOTH
@pytest.mark.parametrize(
    ("mode", "slowing", "left", "rate", "after_ms"),
    [
        (TORQUE, SLOW, 64.0, 1000, 64),
        (CST, QUICK, 64.0, 1000, 64),
        (VELOCITY, TO_ZERO, 64.0, 1000, 64),
        (VELOCITY, SLOW, 64.0, 2000, 32),
        (CSV, QUICK, 64.0, 4000, 16),
    ],
)
def test_a_ramp_wants_to_be_called_at_its_end(sign, mode, slowing, left, rate, after_ms):
    n = drive(mode, sign * left, sign * left)
    if mode in (VELOCITY, CSV) and slowing != TO_ZERO:
        n.torque_demand_pm = 9999.0
    else:
        n.speed_demand = 9999.0
    n.slowing, n.slowing_ns, n.demand_ns = slowing, T - 500 * MS, T
    assert motion402.next_deadline(n, NEVER_NS) == T + after_ms * MS + 1
    assert motion402.next_deadline(n, T + 5) == T + 5
    n.slowing_ns = T - 990 * MS  # 2006h ends it sooner
    assert motion402.next_deadline(n, NEVER_NS) == T + min(after_ms * MS + 1, 10 * MS)


@pytest.mark.parametrize(("slope", "after_ms"), [(0, 500), (1, 500)])
def test_a_slope_without_an_end_ends_with_2006h(slope, after_ms):
    n = drive(TORQUE, 900.0, TORQUE_SLOPE=slope)
    n.slowing, n.slowing_ns = SLOW, T - 500 * MS
    assert motion402.next_deadline(n, NEVER_NS) == T + after_ms * MS


def test_a_slope_of_one_per_mille_a_second_has_an_end():
    n = drive(TORQUE, 8.0, TORQUE_SLOPE=1, SLOW_DOWN_MS=10**6)
    n.slowing, n.slowing_ns = SLOW, T
    assert motion402.next_deadline(n, NEVER_NS) == T + 8000 * MS + 1
    n.torque_demand_pm = 800.0
    assert motion402.next_deadline(n, NEVER_NS) == T + 100_000 * MS + 1  # looked at again


# position modes


@pytest.mark.parametrize("mode", range(-3, 12))
def test_a_mode_holds_a_position_or_does_not_and_none_of_the_makers_own_does(mode):
    n = drive(mode)
    assert motion402.is_position_mode(n) == (mode in POSITIONS)
    n.vendor_mode = mode
    assert not motion402.is_position_mode(n)


@pytest.mark.parametrize("mode", [1, 32])
def test_the_first_and_the_last_mode_of_6502h_are_taken(mode):
    n = drive(TORQUE, MODE=mode)
    n.modes = 1 << (mode - 1)
    motion402.change_mode(n, T)
    assert n.mode == mode


def test_a_velocity_is_in_the_units_of_60A9h():
    n = drive(CSV, 0.0, 98.0, TARGET_VELOCITY=60, MAX_VELOCITY=1000, MAX_MOTOR_SPEED=200)
    n.unit_counts_s, n.speed_ki = 2.0, 0.0
    assert motion402.velocity(n) == 49.0
    assert moved(n, MS) == pytest.approx(0.25 * (50.0 - 49.0))
    assert (n.speed_demand, n.limited) == (50.0, 1)  # 6080h is 100 counts/s


@pytest.mark.parametrize("zero_counts", [0, 30, -30, 2**31])
def test_a_position_is_counted_from_the_home_position(zero_counts):
    n = drive(LOWEST_POSITION=-100, HIGHEST_POSITION=100)
    n.zero_counts = zero_counts
    for position, up, down in ((99, 1, 1), (100, 0, 1), (-99, 1, 1), (-100, 1, 0)):
        n.in_position_counts = position + zero_counts
        assert (motion402.high_limit(n), motion402.low_limit(n)) == (800 * up, -700 * down)


@pytest.mark.parametrize("mode", POSITIONS)
def test_a_position_mode_keeps_its_demand_in_607Dh_and_its_torque_free(mode):
    n = drive(mode, LOWEST_POSITION=-100, HIGHEST_POSITION=100, MAX_MOTOR_SPEED=1000)
    for position in (-101, 101):
        n.in_position_counts = position
        assert (motion402.high_limit(n), motion402.low_limit(n)) == (800, -700)
    n.in_velocity_counts_s = 500.0
    assert (motion402.high_limit(n), motion402.low_limit(n)) == (0, -700)


def test_a_stop_leaves_nothing_of_a_position():
    n = drive(CSP)
    n.feed_forward_pm, n.following_lost, n.stalled_s = 5.0, 1, 0.3
    motion402.stop(n)
    assert (n.feed_forward_pm, n.following_lost, n.stalled_s) == (0.0, 0, 0.0)


HELD = ("target_limited", "acknowledged", "halted", "waiting", "following_lost")


def dirty(mode):
    """A drive that has another demand, and set-points of before."""
    n = drive(mode, 0.0, 8.0)
    n.in_position_counts, n.position_demand, n.target_counts, n.target_speed, n.profile_end_ns = 70, 5.0, 5.0, 5.0, 9
    n.cyclic_ns, n.following_ns, n.off_target_ns, n.setpoint_stale = 9, 9, 9, 0
    for name in HELD:
        setattr(n, name, 1)
    return n


def holds(n, t_ns):
    """Whether the drive demands the position that is, without set-points, since then."""
    assert (n.position_demand, n.target_counts, n.target_speed, n.profile_end_ns) == (70.0, 70.0, 0.0, t_ns)
    assert (n.cyclic_ns, n.following_ns, n.off_target_ns) == (-1, t_ns, t_ns)
    assert [getattr(n, name) for name in HELD] == [0] * len(HELD)
    return True


@pytest.mark.parametrize("mode", POSITIONS)
def test_operation_begins_at_the_position_that_is(mode):
    n = dirty(mode)
    motion402.enter(n, T + 3)
    assert holds(n, T + 3)


@pytest.mark.parametrize("mode", [VELOCITY, TORQUE, CSV, CST])
def test_operation_without_a_position_leaves_its_demand(mode):
    n = dirty(mode)
    motion402.enter(n, T + 3)
    assert (n.position_demand, n.target_speed, n.cyclic_ns, n.following_ns) == (5.0, 5.0, 9, 9)
    assert [getattr(n, name) for name in HELD] == [1] * len(HELD)


def test_only_a_homing_that_is_over_is_kept():
    unfinished = range(homing402._IDLE, homing402._APPROACH + 1), [homing402._FAILED]
    stages = {stage for part in unfinished for stage in part}
    assert motion402.HOMED not in stages
    for stage in (*stages, motion402.HOMED):
        n = dirty(HOMING)
        n.homing = stage
        motion402.enter(n, T)
        assert n.homing == (stage if stage == motion402.HOMED else homing402._IDLE)


@BOTH
@pytest.mark.parametrize(
    ("before", "after", "at_once"),
    [(CSP, POSITION, True), (POSITION, HOMING, True), (CSP, CST, False), (CST, CSP, False), (CSV, POSITION, False)],
)
def test_a_position_mode_follows_another_at_once(sign, before, after, at_once):
    n = dirty(before)
    n.modes, n.torque_demand_pm, n.values[slots402.MODE] = 0x3ED, sign * 100.0, after
    motion402.change_mode(n, T)
    assert (n.mode, n.slowing) == ((after, 0) if at_once else (before, TO_ZERO))
    if at_once:
        assert holds(n, T)
        assert (n.torque_demand_pm, n.setpoint_stale) == (0.0, 1)


@pytest.mark.parametrize("state", [3, OE])
def test_a_position_mode_holds_only_when_it_is_enabled(state):
    n = dirty(CST)
    n.modes, n.power_state, n.values[slots402.MODE] = 0x3ED, state, CSP
    motion402.change_mode(n, T)
    assert n.mode == CSP
    assert (n.position_demand == 70.0) == (state == OE)


@BOTH
@pytest.mark.parametrize(("ramp", "rate"), [(SLOW, 2000), (QUICK, 4000)])
@pytest.mark.parametrize("mode", POSITIONS)
def test_a_position_is_slowed_down_from_the_speed_that_is(sign, ramp, rate, mode):
    n = drive(mode, sign * 8.0, sign * 512.0)
    n.speed_demand, n.feed_forward_pm, n.speed_ki = 3.0, 99.0, 0.0
    motion402.begin(n, T, ramp, QSA)
    assert (n.speed_demand, n.feed_forward_pm, n.out_torque_pm) == (sign * 512.0, 0.0, 0.0)
    motion402.other_mode(n, T + 100 * MS, 100 * MS)
    assert n.speed_demand == pytest.approx(sign * (512.0 - rate / 10))
    assert (n.power_state, n.slowing) == (OE, ramp)


@pytest.mark.parametrize("mode", [VELOCITY, CSV])
def test_a_speed_is_slowed_down_from_its_demand(mode):
    n = drive(mode, 8.0, 512.0)
    n.speed_demand, n.integral_pm = 500.0, 8.0
    motion402.begin(n, T, SLOW, QSA)
    assert (n.speed_demand, n.integral_pm) == (500.0, 8.0)  # no time has passed yet


@BOTH
def test_csv_adds_the_torque_offset_and_profile_velocity_does_not(sign):
    for mode, offset in ((CSV, sign * 30), (VELOCITY, 0)):
        n = drive(mode, 0.0, sign * 100.0, TARGET_VELOCITY=sign * 100, TORQUE_OFFSET=sign * 30)
        n.feed_forward_pm = 99.0
        assert moved(n, MS) == offset
        assert n.feed_forward_pm == offset


@BOTH
@pytest.mark.parametrize(
    ("speed", "target", "limit", "stalls"),
    [
        (0.5, 4000, 800, True),
        (-0.5, 4000, 800, True),
        (1.0, 4000, 800, False),
        (-1.0, 4000, 800, False),
        (-5.0, 4000, 800, False),
        (0.5, 40, 800, False),  # the torque is not limited
        (0.5, 4000, 1, True),
        (0.5, 4000, 0, False),  # no torque
    ],
)
def test_a_motor_stands_still_against_the_largest_torque(sign, speed, target, limit, stalls):
    n = drive(CSV, 0.0, sign * speed, TARGET_VELOCITY=sign * target, MAX_TORQUE=limit)
    n.speed_ki, n.stalled_s = 0.0, 0.25
    moved(n, 4 * MS)
    assert n.stalled_s == (pytest.approx(0.254) if stalls else 0.0)
