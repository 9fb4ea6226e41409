"""The brake's driver, function by function: set-point, hold, ramp, the coil's watch and the pulse,
each at its edge.
"""

from __future__ import annotations

import math

import pytest

from coulombus.node import brake404, coil404, emcy, slots, slots404
from coulombus.node.brake404 import BRAKE404
from coulombus.node.kinds import number
from coulombus.node.record import new_nodes
from coulombus.wire.clock import NEVER_NS

KIND_BRAKE = number(BRAKE404)

T = 5_000_000_000
HOLD_US, RAMP_US = 1000, 4000
HOLD, RAMP = HOLD_US * 1000, RAMP_US * 1000
DEVICE = 1 << emcy.OVER_CURRENT
ACTS, ON_THE_WAY, THERE = 0, 1, 2


def brake():
    """A brake that bears 2 Nm since T; 512 raw is 1 Nm, full scale 8 Nm, the fault value 0.5 Nm."""
    nodes = new_nodes(1)
    n = nodes[0]
    n.kind, n.nmt, n.powered, n.next_ns = KIND_BRAKE, 5, 1, T + 10**9
    n.ao_gain_Nm, n.ao_full_Nm, n.setpoint_high, n.ao_FV_Nm = 2.0**-9, 8.0, 4000, 100.0
    n.limit_Nm, n.setpoint_armed, n.setpoint_ns, n.out_brake_Nm = math.inf, 1, T, 2.0
    n.values[slots404.SETPOINT], n.values[slots404.FAULT_VALUE], n.values[slots404.FAULT_MODE] = 1024, 256, 1
    n.values[slots.SETPOINT_AGE_US], n.values[slots.RAMP_US] = HOLD_US, RAMP_US
    n.ai_gain[:], n.ai_low[:], n.ai_high[:], n.open_since_ns = 1.0, -1e9, 1e9, -1
    return n


def output(n, t_ns):
    brake404.actuate(n, t_ns)
    return float(n.out_brake_Nm)


def test_a_brake_begins_without_torque_and_without_a_setpoint():
    n = brake()
    n.ramp_from_Nm, n.ramp_to_Nm, n.ramping, n.detected, n.pulse_due, n.out_reverse_A = 1.0, 1.0, 1, 8, 1, 0.5
    n.open_since_ns = 7
    brake404.start(n, T + 5)
    assert (n.setpoint_armed, n.ramping, n.ramp_from_Nm, n.ramp_to_Nm, n.ramp_start_ns) == (0, THERE, 0.0, 0.0, T + 5)
    assert (n.out_brake_Nm, n.detected, n.open_since_ns, n.pulse_due, n.out_reverse_A) == (0.0, 0, -1, 0, 0.0)
    assert output(n, T + 10**9) == 0.0


@pytest.mark.parametrize(
    ("raw", "bias", "limit", "torque"),
    [
        (1024, 0.0, math.inf, 2.0),
        (0, 0.0, math.inf, 0.0),
        (-512, 0.25, math.inf, 0.25),  # a negative one is 0, and that is the bias
        (-512, -0.25, math.inf, 0.0),
        (512, -1.5, math.inf, 0.0),
        (512, 0.5, math.inf, 1.5),
        (4096, 0.0, math.inf, 8.0),
        (5000, 0.0, math.inf, 8.0),
        (1024, 0.0, 1.25, 1.25),
    ],
)
def test_the_setpoints_line_ends_at_0_at_full_scale_and_at_the_coils_limit(raw, bias, limit, torque):
    n = brake()
    n.values[slots404.SETPOINT], n.ao_bias_Nm, n.limit_Nm = raw, bias, limit
    assert output(n, T) == torque


@pytest.mark.parametrize(
    ("raw", "kept", "negative", "clipped"),
    [(0, 0, 0, 0), (1, 1, 0, 0), (-1, 0, 1, 0), (-4000, 0, 1, 0), (4000, 4000, 0, 0), (4001, 4000, 0, 1)],
)
@pytest.mark.parametrize("causes", [0, DEVICE, 1 << emcy.RPDO_DEADLINE])
def test_a_new_setpoint_is_clipped_counted_and_ends_the_ramp_unless_the_device_has_a_fault(
    raw, kept, negative, clipped, causes
):
    n = brake()
    n.values[slots404.SETPOINT], n.ramping, n.causes = raw, ON_THE_WAY, causes
    n.negative_setpoints = n.clipped_setpoints = 6
    brake404.new_setpoint(n, T + 9)
    assert n.values[slots404.SETPOINT] == kept
    assert (n.negative_setpoints, n.clipped_setpoints) == (6 + negative, 6 + clipped)
    assert (n.setpoint_ns, n.setpoint_armed, n.next_ns) == (T + 9, 1, T + 10**9)
    assert n.ramping == (ON_THE_WAY if causes == DEVICE else ACTS)


@pytest.mark.parametrize(("next_ns", "after"), [(T + 10**9, T + 10), (T + 3, T + 3)])
def test_the_first_setpoint_asks_for_the_watch_of_its_age(next_ns, after):
    n = brake()
    n.setpoint_armed, n.next_ns = 0, next_ns
    brake404.new_setpoint(n, T + 9)
    assert (n.setpoint_armed, n.next_ns) == (1, after)


COURSE = [(0, 2.0), (HOLD - 1, 2.0), (HOLD, 2.0), (HOLD + RAMP // 4, 1.625), (HOLD + RAMP // 2, 1.25)]


@pytest.mark.parametrize("called", [1, 5])
def test_a_setpoint_is_held_for_its_time_and_then_ramped_in_a_line(called):
    """Whether it is computed at each time or only at the last."""
    for last in (*COURSE, (HOLD + RAMP - 4, 0.5 + 1.5e-6), (HOLD + RAMP, 0.5), (HOLD + RAMP + 10**9, 0.5)):
        n = brake()
        for elapsed, _ in COURSE if called > 1 else []:
            if elapsed < last[0]:
                output(n, T + elapsed)
        assert output(n, T + last[0]) == pytest.approx(last[1], abs=1e-12)
        assert n.ramping == (ACTS if last[0] < HOLD else ON_THE_WAY if last[0] < HOLD + RAMP else THERE)
        if n.ramping:
            assert n.ramp_start_ns == T + HOLD


@pytest.mark.parametrize("name", ["not armed", "no age", "fault mode 0", "fault mode 2"])
def test_a_setpoint_whose_age_is_not_watched_stays(name):
    n = brake()
    if name == "not armed":
        n.setpoint_armed = 0
    elif name == "no age":
        n.values[slots.SETPOINT_AGE_US] = 0
    else:
        n.values[slots404.FAULT_MODE] = int(name[-1])
    assert output(n, T + 10**12) == 2.0
    assert n.ramping == ACTS
    assert brake404.next_deadline(n, T, NEVER_NS) == NEVER_NS


def test_an_age_of_a_microsecond_is_watched():
    n = brake()
    n.values[slots.SETPOINT_AGE_US] = 1
    assert brake404.next_deadline(n, T, NEVER_NS) == T + 1000
    output(n, T + 1000)
    assert n.ramping == ON_THE_WAY


@pytest.mark.parametrize(("fault_value", "causes", "end"), [(256, 0, 0.5), (256, DEVICE, 0.0), (2048, 0, 4.0)])
def test_the_ramp_leads_to_the_fault_value_and_for_a_device_fault_to_0(fault_value, causes, end):
    n = brake()
    n.values[slots404.FAULT_VALUE], n.causes = fault_value, causes
    output(n, T + HOLD)
    assert (n.ramp_from_Nm, n.ramp_to_Nm) == (2.0, end)
    assert output(n, T + HOLD + RAMP // 2) == (2.0 + end) / 2
    n.limit_Nm = 0.25
    assert output(n, T + HOLD + RAMP // 2) == min((2.0 + end) / 2, 0.25)
    assert output(n, T + HOLD + RAMP) == min(end, 0.25)


def test_before_its_begin_a_ramp_is_where_it_begins_and_without_a_time_at_its_end():
    n = brake()
    n.ramping, n.ramp_from_Nm, n.ramp_to_Nm, n.ramp_start_ns = ON_THE_WAY, 2.0, 0.5, T + 100
    assert output(n, T) == 2.0
    n.values[slots.RAMP_US] = 0
    assert output(n, T + 100) == 0.5
    assert n.ramping == THERE


def test_a_cut_is_0_at_once_and_stays():
    n = brake()
    n.ramp_to_Nm = 1.0
    brake404.cut(n)
    assert (n.ramping, n.out_brake_Nm) == (THERE, 0.0)
    assert output(n, T + 1) == 0.0


@pytest.mark.parametrize("forced", [0, 1])
@pytest.mark.parametrize("mode", [0, 1, 2])
@pytest.mark.parametrize("ramping", [ACTS, ON_THE_WAY, THERE])
@pytest.mark.parametrize("causes", [0, DEVICE])
@pytest.mark.parametrize("ramp_to", [0.0, 0.5])
def test_a_lost_connection_begins_the_ramp_from_the_present_output(forced, mode, ramping, causes, ramp_to):
    n = brake()
    n.values[slots404.FAULT_MODE], n.ramping, n.causes = mode, ramping, causes
    n.ramp_from_Nm, n.ramp_to_Nm, n.ramp_start_ns, n.out_brake_Nm = 4.0, ramp_to, T - RAMP // 2, 9.0
    present = {ACTS: 2.0, ON_THE_WAY: (4.0 + ramp_to) / 2, THERE: ramp_to}[ramping]
    brake404.connection_lost(n, T, forced)
    assert n.setpoint_armed == 0
    begins = (forced or mode == 1) and (ramping == ACTS or (causes and ramp_to > 0.0))
    assert (n.ramp_start_ns == T) == begins
    if begins:
        assert (n.ramping, n.ramp_from_Nm, n.ramp_to_Nm) == (ON_THE_WAY, present, 0.0 if causes else 0.5)
        assert n.out_brake_Nm == present
        assert output(n, T + RAMP // 2) == (present + n.ramp_to_Nm) / 2
    else:
        assert n.ramping == ramping


def test_a_lost_connection_without_a_ramp_time_acts_in_the_same_step():
    n = brake()
    n.values[slots.RAMP_US] = 0
    brake404.connection_lost(n, T, 0)
    assert (n.ramping, n.out_brake_Nm) == (THERE, 0.5)


@pytest.mark.parametrize(
    ("armed", "age_us", "begins"), [(1, HOLD_US, False), (0, HOLD_US, True), (1, 0, True), (1, 1, False)]
)
def test_where_the_age_is_watched_a_lost_host_changes_nothing_yet(armed, age_us, begins):
    n = brake()
    n.setpoint_armed, n.values[slots.SETPOINT_AGE_US] = armed, age_us
    brake404.host_lost(n, T)
    assert (n.ramping == ON_THE_WAY) == begins
    n = brake()
    n.setpoint_armed, n.values[slots404.FAULT_MODE] = 0, 0
    brake404.host_lost(n, T)
    assert n.ramping == ACTS  # it is not forced


@pytest.mark.parametrize(
    ("value", "raw", "status"),
    [
        (0.0, 0, 0), (2.5, 3, 0), (2.4375, 2, 0), (-2.5, -2, 0), (-2.5625, -3, 0), (32766.75, 32767, 0), (32767.25, 32767, 0),
        (32767.75, 32767, 0), (31000.25, 31000, 0), (-31000.25, -31000, 0),
        (-32767.75, -32768, 0), (-32768.75, -32768, 0), (40000.0, 32767, 0), (50000.0, 32767, 0),
        (50000.5, 32767, 2), (-50000.0, -32768, 0), (-50000.5, -32768, 4), (math.nan, -32768, 1), (math.inf, 32767, 2),
    ],
)  # fmt: skip
@pytest.mark.parametrize("k", range(3))
def test_an_input_is_scaled_rounded_saturated_and_judged(value, raw, status, k):
    n = brake()
    n.ai_gain[k], n.ai_bias[k], n.ai_low[k], n.ai_high[k] = 2.0, 8.0, -50000.0, 50000.0
    n.values[slots404.INPUT_STATUS + k] = 7
    given = [0.0, 0.0, 0.0]
    given[k] = (value - 8.0) / 2.0
    n.in_handle_Nm, n.in_coil_A, n.in_coil_degC = given
    n.out_brake_Nm = 1.006
    brake404.sample(n)
    assert [n.values[slots404.INPUT + j] for j in range(3)] == [raw if j == k else 0 for j in range(3)]
    assert [n.values[slots404.INPUT_STATUS + j] for j in range(3)] == [status if j == k else 0 for j in range(3)]
    assert n.values[slots404.OUTPUT_FV] == 101


@pytest.mark.parametrize(("low", "high", "value", "raw", "status"), [
    (math.inf, -math.inf, 5.0, 0, 1),
    (math.inf, -math.inf, 0.0, 0, 1),
    (-10.0, 0.0, 0.25, 0, 2),
    (0.0, 10.0, -0.25, 0, 4),
    (0.0, 10.0, -3.0, -3, 4),
    (10.0, 5.0, 5.0, 5, 4),  # the limits crossed: never valid
    (10.0, 5.0, 7.0, 7, 2),
])  # fmt: skip
def test_a_channel_that_is_off_shows_0_and_is_not_valid(low, high, value, raw, status):
    n = brake()
    n.ai_low[0], n.ai_high[0], n.in_handle_Nm = low, high, value
    brake404.sample(n)
    assert (n.values[slots404.INPUT], n.values[slots404.INPUT_STATUS]) == (raw, status)


@pytest.mark.parametrize("before", [T - 3, T + 10**12])
def test_the_brake_wants_to_be_called_at_the_end_of_hold_and_ramp(before):
    n = brake()
    assert brake404.next_deadline(n, T, before) == min(before, T + HOLD)
    n.ramping, n.ramp_start_ns = ON_THE_WAY, T + HOLD
    assert brake404.next_deadline(n, T, before) == min(before, T + HOLD + RAMP)
    n.ramping = THERE
    assert brake404.next_deadline(n, T, before) == before


# the coil

A_NM = 0.25
TEMPERATURE, OPEN, SHORT = (1 << cause - 8 for cause in (emcy.OVER_TEMPERATURE, emcy.COIL_OPEN, emcy.COIL_SHORT))


def coil(measured=0.5, degC=20.0):
    """A brake at 2 Nm, whose coil draws 0.5 A for that."""
    n = brake()
    n.coil_A_Nm, n.max_A, n.short_A, n.least_A, n.open_ns = A_NM, 2.0, 3.0, 0.125, 100
    n.warm_degC, n.hot_degC, n.cooled_degC, n.share_left = 80.0, 96.0, 88.0, 0.5
    n.in_coil_A, n.in_coil_degC, n.sync_armed = measured, degC, 1
    n.limit_Nm = 8.0
    return n


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("measured", "torque", "since"),
    [(0.125, 2.0, -1), (0.1171875, 2.0, T), (0.0, 0.5, -1), (0.0, 0.515625, T), (0.0, 0.0, -1)],
)
def test_a_coil_that_draws_less_than_a_quarter_is_suspected(sign, measured, torque, since):
    """Not below the least current."""
    n = coil(sign * measured)
    n.out_brake_Nm = torque
    coil404.detect(n, T)
    assert (n.open_since_ns, n.detected) == (since, 0)


def test_an_open_coil_is_found_after_its_time_and_not_before():
    n = coil(0.0)
    for elapsed, found in ((0, 0), (1, 0), (99, 0), (100, OPEN)):
        coil404.detect(n, T + elapsed)
        assert (n.detected, n.open_since_ns) == (found, T)
    n = coil(0.0)
    coil404.detect(n, T)
    n.in_coil_A = 0.5
    coil404.detect(n, T + 99)
    assert n.open_since_ns == -1
    n.in_coil_A = 0.0
    coil404.detect(n, T + 150)
    assert (n.detected, n.open_since_ns) == (0, T + 150)


def test_a_coil_that_is_suspected_since_time_0_is_found_too():
    n = coil(0.0)
    coil404.detect(n, 0)
    assert n.open_since_ns == 0
    coil404.detect(n, 50)
    assert n.open_since_ns == 0
    coil404.detect(n, 100)
    assert n.detected == OPEN


@pytest.mark.parametrize("sign", [1, -1])
def test_more_than_the_short_circuits_current_is_one(sign):
    n = coil(sign * 3.0)
    n.derated = 1  # so that it is looked into
    coil404.detect(n, T)
    assert n.detected == 0
    n.in_coil_A = sign * 3.0078125
    coil404.detect(n, T)
    assert n.detected == SHORT


@pytest.mark.parametrize("fault", [OPEN, SHORT, OPEN | SHORT])
@pytest.mark.parametrize("ramping", [ACTS, ON_THE_WAY, THERE])
@pytest.mark.parametrize("torque", [0.0, 0.5])
@pytest.mark.parametrize("raw", [0, 1, -1])
def test_a_coils_fault_stays_until_a_setpoint_of_0_at_output_0(fault, ramping, torque, raw):
    n = coil(0.0)
    n.detected, n.ramping, n.out_brake_Nm, n.values[slots404.SETPOINT] = fault | TEMPERATURE, ramping, torque, raw
    n.open_since_ns, n.in_coil_degC = T - 1000, 90.0
    coil404.detect(n, T)
    over = ramping != ACTS and torque == 0.0 and raw <= 0
    assert n.detected == (TEMPERATURE if over else fault | TEMPERATURE)
    assert n.open_since_ns == (-1 if over else T - 1000)


@pytest.mark.parametrize(
    ("degC", "before", "detected"),
    [
        (20.0, 0, 0), (96.0, 0, 0), (96.5, 0, TEMPERATURE), (96.0, TEMPERATURE, TEMPERATURE),
        (88.0, TEMPERATURE, TEMPERATURE), (87.5, TEMPERATURE, 0), (20.0, TEMPERATURE, 0),
    ],
)  # fmt: skip
def test_over_temperature_has_a_hysteresis(degC, before, detected):
    n = coil(0.5, degC)
    n.detected = before | 1
    coil404.detect(n, T)
    assert n.detected == detected | 1


@pytest.mark.parametrize(
    ("degC", "share", "derated"), [(20.0, 1.0, 0), (80.0, 1.0, 0), (84.0, 0.875, 1), (96.0, 0.5, 1), (200.0, 0.5, 1)]
)
def test_above_the_warning_temperature_the_limit_falls_in_a_line(degC, share, derated):
    n = coil(0.5, degC)
    n.derated = 1
    coil404.detect(n, T)
    assert (n.limit_Nm, n.derated) == (share * 2.0 / A_NM, derated)


@pytest.mark.parametrize(
    ("degC", "board_Nm", "limit_Nm"),
    [
        (20.0, 0.25, 0.25),
        (20.0, 64.0, 2.0 / 0.25),
        (96.0, 0.25, 0.25),
        (96.0, 64.0, 1.0 / 0.25),
        (20.0, 0.0, 2.0 / 0.25),
    ],
)
def test_the_hardware_s_own_limit_holds_beside_the_coil_s(degC, board_Nm, limit_Nm):
    n = coil(0.5, degC)
    n.derated, n.coil_A_Nm, n.board_Nm = 1, 0.25, board_Nm
    coil404.detect(n, T)
    assert n.limit_Nm == limit_Nm


def test_a_line_of_no_length_falls_at_once_and_an_unknown_coil_has_no_limit():
    n = coil(0.5, 96.0)
    n.warm_degC, n.hot_degC, n.derated = 95.9, 95.95, 1
    coil404.detect(n, T)
    assert n.limit_Nm == pytest.approx((1.0 - 0.5 * 0.5) * 2.0 / A_NM)
    n.coil_A_Nm = 0.0
    coil404.detect(n, T)
    assert n.limit_Nm == math.inf


@pytest.mark.parametrize("odd", ["missing", "short", "warm", "detected", "derated", "suspected"])
def test_a_coil_in_order_is_not_looked_into(odd):
    """The limit is computed when there is a reason to."""
    n = coil()
    n.limit_Nm = -1.0
    coil404.detect(n, T)
    n.in_coil_A, n.in_coil_degC = 3.0, 80.0  # at both limits
    coil404.detect(n, T)
    assert n.limit_Nm == -1.0
    if odd == "missing":
        n.in_coil_A = 0.0
    elif odd == "short":
        n.in_coil_A = -5.0
    elif odd == "warm":
        n.in_coil_degC = 80.5
    elif odd == "detected":
        n.detected = 1
    elif odd == "derated":
        n.derated = 1
    else:
        n.open_since_ns = 0
    coil404.detect(n, T)
    assert n.limit_Nm > 0.0


def pulsed(**state):
    n = coil()
    n.demag_A, n.demag_ns, n.demag_delay_ns = 0.25, 60, 100
    n.out_brake_Nm, n.pulse_due, n.pulse_ns, n.out_reverse_A = 0.0, 1, T, 0.125
    for name, value in state.items():
        setattr(n, name, value)
    return n


def test_while_there_is_torque_the_pulse_is_put_off():
    n = pulsed(out_brake_Nm=2.0**-20, pulse_due=0)
    coil404.demagnetise(n, T + 7)
    assert (n.out_reverse_A, n.pulse_due, n.pulse_ns, n.next_ns) == (0.0, 1, T + 107, T + 10**9)


@pytest.mark.parametrize(
    ("elapsed", "current", "due", "next_ns"),
    [
        (-100, 0.0, 1, T),
        (-1, 0.0, 1, T),
        (0, 0.25, 1, T + 60),
        (59, 0.25, 1, T + 60),
        (60, 0.0, 0, T + 10**9),
        (61, 0.0, 0, T + 10**9),
    ],
)
def test_the_pulse_begins_and_ends_at_its_times(elapsed, current, due, next_ns):
    n = pulsed()
    coil404.demagnetise(n, T + elapsed)
    assert (n.out_reverse_A, n.pulse_due, n.next_ns) == (current, due, next_ns)
    n = pulsed(next_ns=T - 500)
    coil404.demagnetise(n, T + elapsed)
    assert n.next_ns == T - 500


@pytest.mark.parametrize("state", [{"pulse_due": 0}, {"causes": DEVICE}])
def test_no_pulse_without_torque_before_nor_with_a_fault_of_the_device(state):
    n = pulsed(**state)
    coil404.demagnetise(n, T + 1)
    assert (n.out_reverse_A, n.next_ns) == (0.0, T + 10**9)
    assert coil404.next_deadline(n, T + 1, NEVER_NS) == NEVER_NS


def test_another_cause_does_not_bar_the_pulse():
    n = pulsed(causes=1 << emcy.RPDO_DEADLINE)
    coil404.demagnetise(n, T + 1)
    assert n.out_reverse_A == 0.25
    assert coil404.next_deadline(n, T + 1, NEVER_NS) == T + 60


@pytest.mark.parametrize("before", [T - 500, NEVER_NS])
@pytest.mark.parametrize(
    ("t_ns", "due"), [(T - 1, T), (T, T + 60), (T + 59, T + 60), (T + 60, T + 61), (T + 99, T + 100)]
)
def test_the_coil_wants_to_be_called_at_the_pulses_edges(before, t_ns, due):
    assert coil404.next_deadline(pulsed(), t_ns, before) == min(before, due)


@pytest.mark.parametrize("state", [{"demag_A": 0.0}, {"pulse_due": 0}, {"out_brake_Nm": 0.5}])
def test_without_a_pulse_the_coil_wants_nothing(state):
    assert coil404.next_deadline(pulsed(**state), T, NEVER_NS) == NEVER_NS


@pytest.mark.parametrize("before", [T - 500, NEVER_NS])
@pytest.mark.parametrize(
    ("since", "t_ns", "due"), [(T, T, T + 100), (T, T + 99, T + 100), (T, T + 100, T + 10_000_100), (0, 5, 100)]
)
def test_a_suspected_coil_is_looked_at_when_its_time_is_over(before, since, t_ns, due):
    n = coil()
    n.open_since_ns = since
    assert coil404.next_deadline(n, t_ns, before) == min(before, due)
    n.detected = OPEN
    assert coil404.next_deadline(n, t_ns, before) == before


@pytest.mark.parametrize(
    ("state", "looks"),
    [
        ({}, True), ({"out_brake_Nm": 0.125}, True), ({"sync_armed": 1}, False), ({"coil_A_Nm": 0.0}, False), ({"out_brake_Nm": 0.0}, False),
        ({"out_brake_Nm": 0.0, "detected": TEMPERATURE}, True),
    ],
)  # fmt: skip
@pytest.mark.parametrize("before", [T - 500, NEVER_NS])
def test_without_syncs_the_coil_is_looked_at_every_10_ms(state, looks, before):
    n = coil()
    n.sync_armed = 0
    for name, value in state.items():
        setattr(n, name, value)
    assert coil404.next_deadline(n, T, before) == (min(before, T + 10_000_000) if looks else before)
