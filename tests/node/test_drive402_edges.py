"""The drive's power states and set-points, function by function: every state, every option code,
both senses.
"""

from __future__ import annotations

import math

import pytest

from coulombus.eds.cia402 import COMMAND_OF_CONTROLWORD, NEXT_STATE, STATUSWORD
from coulombus.node import emcy, motion402, servo402, slots, slots402, states402
from coulombus.node.drive402 import DRIVE402, _apply
from coulombus.node.kinds import number
from coulombus.node.record import new_nodes
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import new_queue

KIND_DRIVE = number(DRIVE402)
SLOTS = vars(slots) | vars(slots402)

T = 5_000_000_000
NR, SOD, RTSO, SO, OE, QSA, FRA, FAULT = range(8)
STATES = range(8)
DRIVEN = (OE, QSA, FRA)
SLOW, QUICK = 1, 2
RAMPS = {1: SLOW, 2: QUICK, 5: SLOW, 6: QUICK}
OPTIONS = [-1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
BOTH = pytest.mark.parametrize("sign", [1, -1])


def drive(state=OE, torque=300, **values):
    """A drive in CST at `torque`, whose slow-down ramp takes its time."""
    nodes = new_nodes(1)
    n = nodes[0]
    n.kind, n.nmt, n.powered, n.power_state, n.mode, n.node_id, n.emcy_id = KIND_DRIVE, 5, 1, state, 10, 1, 0x81
    n.modes = 0x30C
    n.next_ns, n.demand_ns, n.setpoint_armed, n.setpoint_ns = T + 10**9, T, 1, T
    n.torque_demand_pm = n.out_torque_pm = float(torque)
    v = n.values
    v[slots402.MODE], v[slots402.TARGET_TORQUE], v[slots402.TORQUE_SLOPE], v[slots402.SLOW_DOWN_MS] = (
        10,
        torque,
        1000,
        1000,
    )
    v[slots402.MAX_TORQUE], v[slots402.POSITIVE_LIMIT], v[slots402.NEGATIVE_LIMIT], v[slots402.MAX_CURRENT] = (
        1000,
        900,
        800,
        2000,
    )
    v[slots402.LOWEST_POSITION], v[slots402.HIGHEST_POSITION] = -(2**31), 2**31 - 1
    v[slots402.MAX_MOTOR_SPEED] = slots402.NO_SPEED_LIMIT
    for name, value in values.items():
        v[SLOTS[name]] = value
    return n


def is_at_once(n, state):
    """Whether the drive is in `state` without torque."""
    return (n.power_state, n.slowing, n.out_torque_pm, n.torque_demand_pm, n.values[slots402.TORQUE_DEMAND]) == (
        state, 0, 0.0, 0.0, 0,
    )  # fmt: skip


def is_ramping(n, state, following):
    return (n.power_state, n.slowing, n.slowing_to, n.slowing_ns, n.out_torque_pm) == (state, SLOW, following, T, 300.0)


def is_as_before(n, state):
    return (n.power_state, n.slowing, n.out_torque_pm) == (state, 0, 300.0)


def test_a_drive_begins_switched_on_disabled_without_anything_of_before():
    n = drive(QSA)
    n.controlword, n.setpoint_stale, n.limited, n.mode, n.slowing = 15, 1, 1, 10, 1
    states402.start(n, T + 5)
    assert is_at_once(n, SOD)
    assert (n.controlword, n.setpoint_armed, n.setpoint_stale, n.demand_ns, n.limited) == (0, 0, 0, T + 5, 0)
    assert (n.mode, n.values[slots402.MODE_DISPLAY]) == (10, 10)
    n.values[slots402.MODE], n.values[slots402.MODE_DISPLAY] = 0, 7
    states402.start(n, T)
    assert (n.mode, n.values[slots402.MODE_DISPLAY]) == (0, 0)


# faults and lost connections


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("at_once", [False, True])
def test_a_fault_is_torque_0_at_once_or_the_ramp_of_605Eh(state, at_once):
    for option in OPTIONS:
        n = drive(state, FAULT_OPTION=option)
        states402.fault(n, T, at_once)
        assert n.setpoint_stale == 1
        ramp = RAMPS.get(option, 0)
        if at_once or ramp == 0 or state not in DRIVEN:
            assert is_at_once(n, FAULT)
        elif state == FRA:
            assert is_as_before(n, FRA)
        elif ramp == QUICK:  # in a torque mode it is at once
            assert is_at_once(n, FAULT)
        else:
            assert is_ramping(n, FRA, FAULT)


@pytest.mark.parametrize("state", STATES)
def test_the_supply_is_needed_from_switched_on_to_the_fault_reaction(state):
    assert states402.needs_supply(drive(state)) == (state in (SO, OE, QSA, FRA))


def stopped(n, option):
    """Whether the drive made the quick stop of 605Ah."""
    following = QSA if option >= 5 else SOD
    if RAMPS.get(option, 0) == SLOW:
        return is_ramping(n, QSA, following)
    return is_at_once(n, following)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("forced", [0, 1])
@pytest.mark.parametrize("option", [-1, 0, 1, 2, 3, 4])
def test_a_lost_connection_does_what_6007h_says_unless_it_is_forced(state, forced, option):
    for stop in OPTIONS if option == 3 else (0,):
        lose_connection(state, forced, option, stop)


def lose_connection(state, forced, option, stop):
    n = drive(state, ABORT_OPTION=option, QUICK_STOP_OPTION=stop)
    told = states402.connection_lost(n, T, forced)
    assert n.setpoint_armed == 0
    assert n.setpoint_stale == (forced or option != 0)
    assert told == (state in (OE, QSA) and not forced and option == 1)
    if state not in DRIVEN:
        assert is_as_before(n, state)
    elif forced:
        assert is_at_once(n, SOD)
    elif option in (0, 1) or state == FRA:
        assert is_as_before(n, state)
    elif option == 3:
        assert stopped(n, stop) if state == OE else is_as_before(n, state)
    else:
        assert is_at_once(n, SOD)


# controlwords


def commanded(n, word):
    out = new_queue()
    n.values[slots402.CONTROLWORD] = word
    states402.new_controlword(n, T, out)
    return [int(row["word"]) & 0xFFFF for row in out.frames[: int(out["count"])]]


@pytest.mark.parametrize(
    ("before", "word"), [(0, 0x80), (0x7F, 0x80), (0x80, 0x80), (0, 0x00), (0, 0x7F), (0, 0x100), (0x100, 0xFF)]
)
@pytest.mark.parametrize("causes", [0, 1 << emcy.RPDO_SHORT, 1 << emcy.SUPPLY, 1 << emcy.HEARTBEAT])
@pytest.mark.parametrize("latched", [0, 1 << emcy.RPDO_SHORT, 1 << emcy.SUPPLY | 1 << emcy.RPDO_SHORT])
def test_a_fault_is_reset_by_a_rising_bit_7_when_its_cause_is_gone(before, word, causes, latched):
    n = drive(FAULT, 0)
    n.controlword, n.causes, n.latched = before, causes, latched
    told = commanded(n, word)
    rising = word & 0x80 and not before & 0x80
    fault_causes = (1 << emcy.SUPPLY, 1 << emcy.HEARTBEAT)
    reset = rising and causes not in fault_causes
    assert n.power_state == (SOD if reset else FAULT)
    assert n.controlword == word
    assert told == ([0x0000] if reset and latched & 1 << emcy.SUPPLY else [])
    if told:
        assert n.latched == 1 << emcy.RPDO_SHORT


@pytest.mark.parametrize("state", [s for s in STATES if s not in (OE, QSA, FAULT)])
@pytest.mark.parametrize("supply", [0, 1])
def test_a_controlword_is_one_row_of_the_table_and_nothing_is_switched_on_without_supply(state, supply):
    for word in range(16):
        n = drive(state, 0)
        n.in_supply_ok = supply
        n.integral_pm, n.in_velocity_counts_s, n.demand_ns = 5.0, 77.0, T - 9
        commanded(n, word)
        following = NEXT_STATE[state, COMMAND_OF_CONTROLWORD[word]]
        barred = supply == 0 and (following == OE or (following == SO and state < SO))
        assert n.power_state == (state if barred else following)
        entered = not barred and following == OE != state
        assert (n.speed_demand, n.integral_pm, n.demand_ns) == ((77.0, 0.0, T) if entered else (0.0, 5.0, T - 9))


@pytest.mark.parametrize("supply", [0, 1])
@pytest.mark.parametrize("word", [0x0F, 0x07, 0x06, 0x00, 0x02])
def test_a_quick_stop_is_left_to_disabled_and_to_enabled_only_when_the_drive_stays(word, supply):
    following = NEXT_STATE[QSA, COMMAND_OF_CONTROLWORD[word]]
    for option in OPTIONS:
        n = drive(QSA, QUICK_STOP_OPTION=option)
        n.in_supply_ok = supply
        commanded(n, word)
        if following == QSA or (following == OE and (option < 5 or supply == 0)):
            assert is_as_before(n, QSA)
        else:
            assert is_at_once(n, following)


@pytest.mark.parametrize("stop", OPTIONS)
def test_a_quick_stop_is_the_one_of_605Ah(stop):
    n = drive(OE, QUICK_STOP_OPTION=stop)
    commanded(n, 0x02)
    assert stopped(n, stop)


@pytest.mark.parametrize("disable", [0, 1, 2])
@pytest.mark.parametrize("shutdown", [0, 1, 2])
@pytest.mark.parametrize(("word", "following"), [(0x07, SO), (0x06, RTSO), (0x00, SOD)])
@pytest.mark.parametrize("supply", [0, 1])
def test_operation_is_left_at_once_or_by_the_ramp_of_605Ch_and_605Bh(disable, shutdown, word, following, supply):
    n = drive(OE, DISABLE_OPTION=disable, SHUTDOWN_OPTION=shutdown)
    n.in_supply_ok = supply
    commanded(n, word)
    option = {SO: disable, RTSO: shutdown, SOD: 0}[following]
    if option == 1 and supply:
        assert is_ramping(n, OE, following)
    else:
        assert is_at_once(n, following)


@pytest.mark.parametrize(("to", "begins"), [(SO, False), (OE, True)])
def test_a_drive_on_its_way_out_goes_further_and_one_that_changes_its_mode_begins(to, begins):
    n = drive(OE, DISABLE_OPTION=1, SHUTDOWN_OPTION=1)
    n.slowing, n.slowing_to, n.slowing_ns = SLOW, to, T - 50
    commanded(n, 0x06)
    assert (n.slowing, n.slowing_to, n.slowing_ns) == (SLOW, RTSO, T if begins else T - 50)


@pytest.mark.parametrize("state", [OE, FRA])
@pytest.mark.parametrize("to", [SO, OE, FAULT])
@pytest.mark.parametrize("word", [0x0F, 0x1F, 0x10F])
def test_a_drive_that_is_enabled_again_leaves_its_ramp(state, to, word):
    n = drive(state)
    n.slowing, n.slowing_to = SLOW, to
    commanded(n, word)
    assert n.power_state == state
    assert n.slowing == (0 if state == OE and to != OE else SLOW)
    n = drive(OE)
    commanded(n, 0x0F)
    assert is_as_before(n, OE)


# set-points


@pytest.mark.parametrize(("mode", "is_speed"), [(3, True), (4, False), (9, True), (10, False), (0, False)])
@pytest.mark.parametrize("speed", [False, True])
def test_a_setpoint_counts_in_the_modes_that_it_is_for(mode, is_speed, speed):
    n = drive()
    n.mode, n.setpoint_stale, n.setpoint_armed, n.setpoint_ns = mode, 1, 0, 3
    states402.new_setpoint(n, T + 9, slots402.ACTS_SPEED if speed else slots402.ACTS_TORQUE)
    taken = speed == is_speed
    assert (n.setpoint_stale, n.setpoint_armed, n.setpoint_ns) == ((0, 1, T + 9) if taken else (1, 0, 3))


@pytest.mark.parametrize(("armed", "next_ns", "after"), [(0, T + 99, T + 10), (0, T + 3, T + 3), (1, T + 99, T + 99)])
def test_the_first_setpoint_asks_for_the_watch_of_its_age(armed, next_ns, after):
    n = drive()
    n.setpoint_armed, n.next_ns = armed, next_ns
    states402.new_setpoint(n, T + 9, slots402.ACTS_TORQUE)
    assert n.next_ns == after


@pytest.mark.parametrize(("ramping", "before", "after"), [(0, T, T + 9), (0, T + 20, T + 20), (1, T, T)])
def test_a_slope_begins_when_its_setpoint_comes(ramping, before, after):
    n = drive()
    n.ramping, n.demand_ns = ramping, before
    states402.new_setpoint(n, T + 9, slots402.ACTS_TORQUE)
    assert n.demand_ns == after


@pytest.mark.parametrize(("target", "clipped"), [(900, 0), (901, 1), (-800, 0), (-801, 1), (0, 0)])
def test_a_setpoint_beyond_the_limits_is_counted(target, clipped):
    n = drive(OE, target)
    n.clipped_setpoints = 4
    states402.new_setpoint(n, T, slots402.ACTS_TORQUE)
    assert n.clipped_setpoints == 4 + clipped
    n.mode = 9
    states402.new_setpoint(n, T, slots402.ACTS_SPEED)
    assert n.clipped_setpoints == 4 + clipped
    n.mode = n.vendor_mode = -3  # 6071h is no set-point of it
    states402.new_setpoint(n, T, slots402.ACTS_TORQUE)
    assert n.clipped_setpoints == 4 + clipped


# torque in CST


def torque(n, t_ns=T):
    states402.actuate(n, t_ns)
    return float(n.out_torque_pm)


@pytest.mark.parametrize(
    ("target", "offset", "out", "limited"),
    [(250, 50, 300, 0), (250, -50, 200, 0), (900, 0, 900, 0), (900, 1, 900, 1), (-800, 0, -800, 0), (-801, 0, -800, 1)],
)
def test_the_torque_is_the_target_and_the_offset_within_the_limits(target, offset, out, limited):
    n = drive(OE, target, TORQUE_OFFSET=offset)
    n.limited, n.ramping = 1 - limited, 1
    assert torque(n, T + 7) == out
    assert (n.torque_demand_pm, n.values[slots402.TORQUE_DEMAND], n.limited, n.ramping) == (out, out, limited, 0)
    assert n.demand_ns == T + 7


@BOTH
@pytest.mark.parametrize("state", STATES)
def test_there_is_torque_in_operation_enabled_only(sign, state):
    assert torque(drive(state, sign * 300)) == (sign * 300 if state == OE else 0)


@BOTH
@pytest.mark.parametrize(("name", "value"), [("in_supply_ok", 0), ("setpoint_stale", 1), ("controlword", 0x10F)])
def test_there_is_no_torque_without_supply_with_an_old_setpoint_nor_halted(sign, name, value):
    n = drive(OE, sign * 300)
    assert torque(n) == sign * 300
    setattr(n, name, value)
    assert torque(n) == 0
    assert n.values[slots402.TORQUE_DEMAND] == 0


@BOTH
@pytest.mark.parametrize("age_us", [1, 3000])
def test_a_setpoint_is_old_at_its_age(sign, age_us):
    n = drive(OE, sign * 300, SETPOINT_AGE_US=age_us)
    assert torque(n, T + age_us * 1000 - 1) == sign * 300
    assert states402.next_deadline(n, NEVER_NS) == T + age_us * 1000
    assert states402.next_deadline(n, T + 5) == T + 5
    assert torque(n, T + age_us * 1000) == 0
    assert n.setpoint_stale == 1
    assert states402.next_deadline(n, NEVER_NS) == NEVER_NS


@pytest.mark.parametrize(("armed", "age_us"), [(0, 3000), (1, 0)])
def test_an_age_that_is_not_watched_changes_nothing(armed, age_us):
    n = drive(OE, 300, SETPOINT_AGE_US=age_us)
    n.setpoint_armed = armed
    assert torque(n, T + 10**12) == 300
    assert states402.next_deadline(n, NEVER_NS) == NEVER_NS


def test_other_modes_and_ramps_take_the_time_since_they_were_looked_at():
    n = drive(OE, 300)
    n.mode = n.values[slots402.MODE] = 4
    n.torque_demand_pm = 0.0
    assert torque(n, T + 10**6) == pytest.approx(1.0)
    assert n.demand_ns == T + 10**6
    n = drive(OE, 300)
    n.slowing, n.slowing_to, n.slowing_ns = SLOW, SO, T
    assert torque(n, T + 10**6) == pytest.approx(299.0)
    assert states402.next_deadline(n, NEVER_NS) == motion402.next_deadline(n, NEVER_NS) < NEVER_NS


def test_a_new_mode_is_entered_by_a_ramp_to_torque_0():
    n = drive(OE, 300)
    n.values[slots402.MODE] = 4
    torque(n)
    assert (n.mode, n.slowing, n.slowing_to) == (10, 3, OE)


# what it tells


@pytest.mark.parametrize(
    ("counts", "position"),
    [(5, 5), (-5, -5), (2**31 - 1, 2**31 - 1), (2**31, -(2**31)), (-(2**31) - 1, 2**31 - 1), (2**32 + 7, 7)],
)
@pytest.mark.parametrize("supply", [0, 1])
def test_position_and_supply_as_they_are_told(counts, position, supply):
    n = drive()
    n.in_position_counts, n.in_supply_ok, n.supply_mV = counts, supply, 48_000
    states402.sample(n)
    assert n.values[slots402.POSITION] == position
    assert n.values[slots402.DC_LINK_MV] == 48_000 * supply


@pytest.mark.parametrize(
    ("value", "speed", "torque"),
    [
        (12.5, 13, 13), (12.25, 12, 12), (-12.5, -12, -12), (-12.75, -13, -13), (40000.0, 40000, 32767),
        (-40000.0, -40000, -32768), (32767.0, 32767, 32767), (-32768.0, -32768, -32768),
        (2.0**31 - 1, 2**31 - 1, 32767), (2.0**31, 2**31 - 1, 32767), (-(2.0**31), -(2**31), -32768), (2.0e9, 2 * 10**9, 32767),
        (-(2.0**31) - 1, -(2**31), -32768), (-2.0e9, -2 * 10**9, -32768), (math.nan, -(2**31), -32768), (math.inf, 2**31 - 1, 32767),
    ],
)  # fmt: skip
def test_speed_and_torque_are_rounded_and_saturate(value, speed, torque):
    n = drive()
    n.in_velocity_counts_s = n.in_torque_pm = value
    states402.sample(n)
    assert n.values[slots402.VELOCITY] == speed
    assert n.values[slots402.TORQUE_ACTUAL] == n.values[slots402.CURRENT_ACTUAL] == torque


VOLTAGE, WARNING, REMOTE, REACHED, LIMITED, FOLLOWS = 0x10, 0x80, 0x200, 0x400, 0x800, 0x1000


def statusword(n):
    states402.sample(n)
    return int(n.values[slots402.STATUSWORD])


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("slowing", [0, 1])
def test_the_statusword_by_state(state, slowing):
    n = drive(state)
    n.slowing = slowing
    bits = {OE: FOLLOWS * (not slowing), QSA: REACHED * (not slowing)}.get(state, 0)
    assert statusword(n) == STATUSWORD[state] | VOLTAGE | REMOTE | bits


@pytest.mark.parametrize(
    ("state", "bits"),
    [
        ({"in_supply_ok": 0}, REMOTE | FOLLOWS),
        ({"latched": 1 << emcy.RPDO_SHORT}, VOLTAGE | WARNING | REMOTE | FOLLOWS),
        ({"latched": 1 << emcy.SUPPLY}, VOLTAGE | REMOTE | FOLLOWS),
        ({"nmt": 4}, VOLTAGE | FOLLOWS),
        ({"nmt": 127}, VOLTAGE | REMOTE | FOLLOWS),
        ({"limited": 1}, VOLTAGE | REMOTE | LIMITED | FOLLOWS),
        ({"setpoint_stale": 1}, VOLTAGE | REMOTE),
        ({"controlword": 0x10F}, VOLTAGE | REMOTE),
        ({"mode": 9}, VOLTAGE | REMOTE | 0x1000),  # bit 12 of CSV
        ({"mode": 4, "torque_demand_pm": 300.0}, VOLTAGE | REMOTE | REACHED),
        ({"mode": 4, "setpoint_stale": 1}, VOLTAGE | REMOTE),
    ],
)
def test_the_statuswords_single_bits(state, bits):
    n = drive(OE)
    for name, value in state.items():
        setattr(n, name, value)
    assert statusword(n) == STATUSWORD[OE] | bits


# position modes

PROFILE, HOMING, INTERPOLATED, CSP, CSV, CST = 1, 6, 7, 8, 9, 10
FOLLOWING_LOST, BLOCKED, OTHER = (
    1 << (cause - emcy.FIRST_DEVICE_CAUSE) for cause in (emcy.FOLLOWING, emcy.BLOCKED, emcy.ENCODER)
)


def servo(mode, **values):
    """A servo drive at 70 counts that is enabled in `mode`, holds them, and has got set-points."""
    n = drive(OE, 0, **values)
    n.servo, n.modes, n.mode, n.values[slots402.MODE], n.controlword = servo402.servo_address(), 0x3ED, mode, mode, 15
    n.in_position_counts = n.position_demand = n.target_counts = 70
    n.position_kp, n.speed_kp, n.period_ns, n.cyclic_ns = 10.0, 0.25, 4_000_000, T
    v = n.values
    v[slots402.FOLLOWING_WINDOW] = v[slots402.POSITION_WINDOW] = slots402.NO_WINDOW
    v[slots402.MAX_VELOCITY] = v[slots402.PROFILE_VELOCITY] = 10**6
    v[slots402.ACCELERATION] = v[slots402.DECELERATION] = 10**6
    return n


def test_a_drive_begins_without_a_home_position_and_probes():
    n = servo(HOMING, PROBE_STATUS=3)
    n.homing, n.zero_counts, n.probe_function = motion402.HOMED, 30, 17
    states402.start(n, T)
    assert (n.homing, n.zero_counts, n.probe_function, n.values[slots402.PROBE_STATUS]) == (0, 0, 0, 0)


@pytest.mark.parametrize("before", [0, FOLLOWING_LOST, BLOCKED, FOLLOWING_LOST | BLOCKED])
@pytest.mark.parametrize(
    ("lost", "stalled_s", "causes"),
    [
        (0, 0.0, 0),
        (1, 0.0, FOLLOWING_LOST),
        (0, 0.5, BLOCKED),
        (0, 0.499, 0),
        (1, 9.0, FOLLOWING_LOST | BLOCKED),
    ],
)
def test_a_lost_and_a_blocked_position_are_detected_and_released(before, lost, stalled_s, causes):
    n = servo(CSP)
    n.detected, n.following_lost, n.stalled_s = before | OTHER, lost, stalled_s
    states402.detect(n, T)
    assert n.detected == causes | OTHER


@pytest.mark.parametrize(
    ("detected", "lost", "stalled_s", "soon"),
    [
        (0, 0, 0.0, False),
        (FOLLOWING_LOST, 1, 0.0, False),
        (FOLLOWING_LOST, 0, 0.0, True),
        (BLOCKED, 0, 0.5, False),
        (BLOCKED, 0, 0.0, True),
        (0, 1, 0.5, False),
        (OTHER, 0, 0.0, False),
        (FOLLOWING_LOST | BLOCKED, 0, 0.5, True),
        (FOLLOWING_LOST | BLOCKED, 1, 1.0, False),
    ],
)
def test_a_cause_that_is_gone_is_released_at_once(detected, lost, stalled_s, soon):
    n = servo(CSP)
    n.detected, n.following_lost, n.stalled_s, n.demand_ns = detected, lost, stalled_s, T
    assert states402.next_deadline(n, T + 9) == (T if soon else T + 9)
    assert states402.next_deadline(n, T - 9) == T - 9


@pytest.mark.parametrize(("before", "is_new"), [(0x0F, True), (0x1F, False)])
def test_a_position_is_taken_by_the_rising_edge_of_bit_4(before, is_new):
    n, out = servo(PROFILE, TARGET_POSITION=500), new_queue()
    n.controlword, n.values[slots402.CONTROLWORD] = before, 0x1F
    states402.new_controlword(n, T, out)
    assert (n.acknowledged, n.target_counts) == ((1, 500.0) if is_new else (0, 70.0))


@pytest.mark.parametrize("mode", [PROFILE, HOMING, INTERPOLATED, CSP, CSV, CST])
@pytest.mark.parametrize("acts", [slots402.ACTS_TORQUE, slots402.ACTS_SPEED, slots402.ACTS_POSITION])
def test_a_cyclic_position_is_the_set_point_of_its_modes_alone(mode, acts):
    n = servo(mode, TARGET_POSITION=500, INTERPOLATED_POSITION=500)
    n.setpoint_armed, n.setpoint_stale, n.controlword = 0, 1, 0x1F
    states402.new_setpoint(n, T + 9, acts)
    cyclic = {INTERPOLATED: slots402.ACTS_POSITION, CSP: slots402.ACTS_POSITION}
    is_setpoint = {CSV: slots402.ACTS_SPEED, CST: slots402.ACTS_TORQUE, **cyclic}.get(mode) == acts
    assert (n.setpoint_armed, n.setpoint_stale) == ((1, 0) if is_setpoint else (0, 1))
    is_position = is_setpoint and mode in cyclic
    assert (n.target_counts, n.cyclic_ns) == ((500.0, T + 9) if is_position else (70.0, T))


@pytest.mark.parametrize(("mode", "follows"), [(CSP, True), (CST, False)])
def test_a_servo_drive_follows_its_position_in_a_position_mode_only(mode, follows):
    n = servo(mode, TARGET_TORQUE=300)
    n.position_demand = n.target_counts = n.profile_from = n.profile_to = 90.0
    out = torque(n, T + 1_000_000)
    assert out == (pytest.approx(0.25 * 10.0 * 20) if follows else 300)


@pytest.mark.parametrize(("guarded", "sync_armed", "watched"), [(1, 0, 1), (1, 1, 0), (0, 0, 0), (0, 1, 0)])
def test_a_limit_of_position_or_speed_is_watched_where_no_sync_does(guarded, sync_armed, watched):
    n = drive(OE, 300)
    n.values[slots402.HIGHEST_POSITION] -= guarded
    n.sync_armed = sync_armed
    torque(n)
    assert n.ramping == watched


@pytest.mark.parametrize("counts", [70, 2**31 + 70, -(2**31) - 1])
def test_the_internal_position_wraps_and_the_users_is_from_home(counts):
    n = servo(CSP)
    n.in_position_counts, n.zero_counts = counts, 30
    states402.sample(n)
    wrapped = (counts + 2**31) % 2**32 - 2**31
    assert n.values[slots402.INTERNAL_POSITION] == wrapped
    assert n.values[slots402.POSITION] == (counts - 30 + 2**31) % 2**32 - 2**31
    n.servo = 0
    states402.sample(n)
    assert n.values[slots402.POSITION] == n.values[slots402.POSITION_DEMAND] == wrapped


@pytest.mark.parametrize(
    ("mode", "state", "lost", "bits"),
    [
        (CSP, OE, 0, FOLLOWS),
        (CSP, OE, 1, FOLLOWS | 0x2000),
        (CSP, SO, 1, 0),
        (CSP, QSA, 1, REACHED),
        (CST, OE, 1, FOLLOWS),
        (CSV, OE, 1, FOLLOWS),
    ],
)
def test_a_position_modes_bits_are_of_the_enabled_drive(mode, state, lost, bits):
    n = servo(mode, TARGET_VELOCITY=500)
    n.power_state, n.following_lost = state, lost
    assert statusword(n) == STATUSWORD[state] | VOLTAGE | REMOTE | bits
    n.servo = 0
    if mode == CSP and state == OE:  # no part says it
        assert statusword(n) == STATUSWORD[state] | VOLTAGE | REMOTE


@pytest.mark.parametrize("carries", range(32))
@pytest.mark.parametrize("has_servo", [True, False])
def test_an_rpdo_acts_by_what_it_carries(carries, has_servo):
    n, out = servo(CSP, TARGET_POSITION=500, PROBE_FUNCTION=0x11, CONTROLWORD=0x07), new_queue()
    n.setpoint_armed = n.probe_function = 0
    if not has_servo:
        n.servo, n.mode = 0, CST
    _apply(n, T + 9, T + 3, carries, out)
    by = slots402.ACTS_POSITION if has_servo else slots402.ACTS_TORQUE
    assert (n.setpoint_armed, n.setpoint_ns) == ((1, T + 3) if carries & by else (0, T))
    assert n.target_counts == (500.0 if has_servo and carries & slots402.ACTS_POSITION else 70.0)
    assert n.probe_function == (0x11 if has_servo and carries & slots402.ACTS_PROBE else 0)
    assert n.power_state == (SO if carries & slots402.ACTS_CONTROLWORD else OE)
