"""What each kind of device does when the communication side calls it: nothing, torque 0, or the
brake's ramp.
"""

from __future__ import annotations

import math

import pytest

from coulombus.node import emcy, reactions, slots, slots402, slots404
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC, PROFILES, number
from coulombus.node.profile import BY_COMMAND, BY_ITSELF, BY_RESET
from coulombus.node.record import new_nodes
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import new_queue

KIND_BRAKE = number(BRAKE404)
KIND_DRIVE = number(DRIVE402)
KIND_GENERIC = number(GENERIC)

T = 5_000_000_000
MS = 1_000_000
SOD, SO, OE, FAULT = 1, 3, 4, 7
KINDS = pytest.mark.parametrize("kind", [KIND_GENERIC, KIND_DRIVE, KIND_BRAKE])
CONTROLWORD, SETPOINT, SPEED = 1, 2, 4
ALL_CAUSES = range(len(emcy.CAUSES))


class Node:
    """An OPERATIONAL device: a drive at 300 per mille, or a brake at 2 Nm; row 0."""

    def __init__(self, kind, state=OE):
        self.nodes = new_nodes(1)
        self.out = new_queue()
        n = self.n = self.nodes[0]
        n.kind, n.nmt, n.powered, n.node_id, n.emcy_id, n.next_ns = kind, 5, 1, 9, 0x89, T + 10**9
        n.setpoint_armed, n.setpoint_ns, n.demand_ns = 1, T, T
        n.held = PROFILES[kind].held
        v = n.values
        if kind == KIND_DRIVE:
            n.power_state, n.mode, n.torque_demand_pm, n.out_torque_pm = state, 10, 300.0, 300.0
            n.in_velocity_counts_s = 77.0
            v[slots402.LOWEST_POSITION], v[slots402.HIGHEST_POSITION] = -(2**31), 2**31 - 1
            v[slots402.MAX_MOTOR_SPEED] = slots402.NO_SPEED_LIMIT
            v[slots402.MODE], v[slots402.TARGET_TORQUE], v[slots402.TORQUE_SLOPE], v[slots402.SLOW_DOWN_MS] = (
                10,
                300,
                1000,
                1000,
            )
            v[slots402.MAX_TORQUE] = v[slots402.POSITIVE_LIMIT] = v[slots402.NEGATIVE_LIMIT] = v[
                slots402.MAX_CURRENT
            ] = 1000
        if kind == KIND_BRAKE:
            n.ao_gain_Nm, n.ao_full_Nm, n.setpoint_high, n.out_brake_Nm, n.open_since_ns = 2.0**-9, 8.0, 4000, 2.0, -1
            n.limit_Nm = n.short_A = n.least_A = n.warm_degC = n.hot_degC = math.inf
            n.ai_gain[:], n.ai_low[:], n.ai_high[:], n.in_handle_Nm = 1.0, -1e9, 1e9, 55.0
            v[slots404.SETPOINT], v[slots404.FAULT_MODE], v[slots.RAMP_US] = 1024, 1, 4000

    def codes(self):
        count = int(self.out["count"])
        self.out["count"] = 0
        words = [int(row["word"]) for row in self.out.frames[:count]]
        assert {word >> 24 for word in words} <= {0}  # none of these has an information
        return [word & 0xFFFF for word in words]

    def call(self, function, *arguments):
        return function(self.n, T, *arguments, self.out)

    @property
    def safe(self):
        """Whether the output was made safe: a drive without torque, a brake on its way."""
        n = self.n
        return n.out_torque_pm == 0.0 if n.kind == KIND_DRIVE else n.ramping != 0


@KINDS
def test_each_kind_samples_what_it_measures(kind):
    node = Node(kind)
    n = node.n
    n.in_velocity_counts_s, n.in_handle_Nm, n.in_coil_A, n.ai_gain[:], n.ai_low[:], n.ai_high[:] = (
        77.0,
        55.0,
        9.0,
        1.0,
        -1e9,
        1e9,
    )
    before = n.values.copy()
    reactions.sample(n)
    changed = {slot for slot in range(len(before)) if n.values[slot] != before[slot]}
    expected = {
        KIND_GENERIC: set(),
        KIND_DRIVE: {slots402.VELOCITY, slots402.STATUSWORD},
        KIND_BRAKE: {slots404.INPUT, slots404.INPUT + 1},
    }
    assert changed == expected[kind]


@KINDS
def test_each_kind_computes_its_own_output(kind):
    node = Node(kind)
    n = node.n
    n.out_torque_pm = n.out_brake_Nm = -1.0
    reactions.actuate(n, T)
    assert (n.out_torque_pm, n.out_brake_Nm) == (
        300.0 if kind == KIND_DRIVE else -1.0,
        2.0 if kind == KIND_BRAKE else -1.0,
    )
    assert n.next_ns == T + 10**9


@pytest.mark.parametrize("demag_A", [0.0, 0.25])
def test_a_brake_with_a_pulse_demagnetises(demag_A):
    node = Node(KIND_BRAKE)
    node.n.demag_A, node.n.demag_delay_ns = demag_A, 50
    reactions.actuate(node.n, T)
    assert (node.n.pulse_due, node.n.pulse_ns) == ((1, T + 50) if demag_A else (0, 0))


@pytest.mark.parametrize("ramping", [0, 1, 2])
@pytest.mark.parametrize("next_ns", [T + 5, T + 10**9])
def test_a_ramp_is_computed_each_millisecond(ramping, next_ns):
    node = Node(KIND_BRAKE)
    n = node.n
    n.ramping, n.ramp_start_ns, n.ramp_from_Nm, n.next_ns = ramping, T, 2.0, next_ns
    reactions.actuate(n, T)
    assert n.next_ns == (min(next_ns, T + MS) if ramping == 1 else next_ns)
    deadline = reactions.next_deadline(n, T, next_ns)
    assert deadline == (min(next_ns, T + MS) if ramping == 1 else next_ns)


@pytest.mark.parametrize(("ramping", "computed"), [(0, True), (1, False), (2, True)])
def test_a_reading_computes_the_output_but_for_a_ramp_which_has_a_cycle_of_its_own(ramping, computed):
    n = Node(KIND_DRIVE).n
    n.out_torque_pm, n.in_velocity_counts_s, n.ramping = -1.0, 77.0, ramping
    reactions.measure(n, T)
    assert n.out_torque_pm == (300.0 if computed else -1.0)
    assert n.values[slots402.VELOCITY] == 77


@KINDS
def test_each_kind_tells_its_own_deadline(kind):
    node = Node(kind)
    node.n.values[slots.SETPOINT_AGE_US] = 7
    assert reactions.next_deadline(node.n, T, NEVER_NS) == (NEVER_NS if kind == KIND_GENERIC else T + 7000)


@KINDS
@pytest.mark.parametrize("carries", range(8))
@pytest.mark.parametrize("mode", [9, 10])
def test_what_was_received_acts_by_kind_and_by_what_it_carries(kind, carries, mode):
    node = Node(kind, SO)
    n = node.n
    n.setpoint_ns, n.mode = 3, mode
    if kind == KIND_DRIVE:
        n.values[slots402.CONTROLWORD] = 0x0F
    node.call(reactions.apply, T + 9, carries, *())
    taken = {
        KIND_DRIVE: bool(carries & (SETPOINT if mode == 10 else SPEED)),
        KIND_BRAKE: bool(carries & SETPOINT),
        KIND_GENERIC: False,
    }[kind]
    assert n.setpoint_ns == (T + 9 if taken else 3)
    assert n.power_state == (0 if kind != KIND_DRIVE else OE if carries & CONTROLWORD else SO)
    assert n.controlword == (0x0F if kind == KIND_DRIVE and carries & CONTROLWORD else 0)


@KINDS
@pytest.mark.parametrize("why", [BY_COMMAND, BY_RESET, BY_ITSELF])
@pytest.mark.parametrize("abort", [0, 1, 2])
@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("age_us", [0, 9000])
def test_leaving_operational_makes_the_output_safe(kind, why, abort, mode, age_us):
    node = Node(kind)
    n = node.n
    v = n.values
    v[slots.SETPOINT_AGE_US] = age_us
    if kind == KIND_DRIVE:
        v[slots402.ABORT_OPTION] = abort
    if kind == KIND_BRAKE:
        v[slots404.FAULT_MODE] = mode
    node.call(reactions.connection_lost, why)
    told = node.codes()
    if kind == KIND_DRIVE:
        faulty = bool(abort == 1 and why != BY_RESET)
        assert told == [0x8100] * faulty
        assert n.power_state == (FAULT if faulty else OE if abort == 0 and why != BY_RESET else SOD)
        assert n.causes == 0  # an event, not a condition
        assert (n.latched != 0) == faulty
    elif kind == KIND_BRAKE:
        held = why == BY_ITSELF and age_us > 0
        assert node.safe == (not held and (mode == 1 or why == BY_RESET))
        assert told == []
    else:
        assert told == []
    if kind == KIND_GENERIC:
        assert (n.setpoint_armed, n.ramping) == (1, 0)


def test_another_cause_outlives_the_fault_of_an_aborted_connection():
    node = Node(KIND_DRIVE)
    node.n.values[slots402.ABORT_OPTION] = 1
    node.n.causes = 1 << emcy.RPDO_SHORT | 1 << emcy.ERROR_PASSIVE
    node.call(reactions.connection_lost, BY_COMMAND)
    assert node.n.causes == 1 << emcy.RPDO_SHORT | 1 << emcy.ERROR_PASSIVE


@KINDS
@pytest.mark.parametrize("cause", ALL_CAUSES)
@pytest.mark.parametrize("fault_option", [0, 1])
def test_an_alarm_is_told_and_reacted_to_by_kind(kind, cause, fault_option):
    node = Node(kind)
    n = node.n
    if kind == KIND_DRIVE:
        n.values[slots402.FAULT_OPTION] = fault_option
    node.call(reactions.alarm, cause, 0)
    assert node.codes() == [emcy.CAUSES[cause].code]
    assert n.causes == 1 << cause
    device = emcy.FIRST_DEVICE_CAUSE <= cause < emcy.DEVICE_CAUSES_END
    if kind == KIND_DRIVE:
        at_once = cause == emcy.SUPPLY or (
            device and cause not in (emcy.OVER_TEMPERATURE, emcy.FOLLOWING, emcy.BLOCKED)
        )
        faulty = emcy.CAUSES[cause].fault
        ramps = faulty and fault_option == 1 and not at_once
        assert n.power_state == (6 if ramps else FAULT if faulty else OE)
    elif kind == KIND_BRAKE:
        assert n.ramping == (2 if cause == emcy.COIL_SHORT else 1 if device else 0)
        assert n.out_brake_Nm == (0.0 if cause == emcy.COIL_SHORT else 2.0)
    if kind != KIND_BRAKE:
        assert n.setpoint_armed == 1
        assert n.ramping == (1 if n.power_state == 6 else 0)


def test_a_fault_of_the_brake_itself_ramps_whatever_the_fault_mode_says():
    node = Node(KIND_BRAKE)
    node.n.values[slots404.FAULT_MODE] = 0
    node.call(reactions.alarm, emcy.COIL_OPEN, 0)
    assert node.n.ramping == 1


@KINDS
@pytest.mark.parametrize("state", [SOD, SO, OE, FAULT])
@pytest.mark.parametrize("supply", [0, 1])
@pytest.mark.parametrize("before", [0, 1 << emcy.SUPPLY])
def test_a_lost_supply_is_a_fault_of_a_drive_that_is_switched_on_and_goes_with_it(kind, state, supply, before):
    node = Node(kind, state)
    n = node.n
    n.in_supply_ok, n.causes, n.latched = supply, before, before
    node.call(reactions.inputs)
    lost = kind == KIND_DRIVE and supply == 0
    present = 1 << emcy.SUPPLY if (lost and state in (SO, OE)) or (lost and before) else 0
    assert n.causes == present
    told = node.codes()
    if lost:
        assert told == ([0x3220] if state in (SO, OE) and not before else [])
        if state in (SO, OE):
            assert n.power_state == FAULT
    else:
        assert told == ([0x0000] if before and kind != KIND_DRIVE else [])


@KINDS
@pytest.mark.parametrize("bit", range(9))
@pytest.mark.parametrize("source", ["in_faults", "detected"])
def test_each_fault_of_the_device_comes_once_and_goes(kind, bit, source):
    node = Node(kind)
    n = node.n
    cause = emcy.FIRST_DEVICE_CAUSE + bit
    n.open_since_ns = -1
    setattr(n, source, 1 << bit)
    if kind == KIND_BRAKE and source == "detected":
        n.cooled_degC = -math.inf
    for told in ([emcy.CAUSES[cause].code], []):
        n.following_lost = int(cause == emcy.FOLLOWING and source == "detected")
        n.stalled_s = float(cause == emcy.BLOCKED and source == "detected")
        node.call(reactions.inputs)
        assert node.codes() == told
        assert n.causes == 1 << cause
    setattr(n, source, 0)
    n.detected = n.following_lost = n.stalled_s = 0
    node.call(reactions.inputs)
    assert n.causes == 0
    held = kind == KIND_DRIVE and emcy.CAUSES[cause].fault  # until its reset
    assert node.codes() == ([] if held else [0x0000])


def test_one_fault_may_come_while_another_goes():
    node = Node(KIND_BRAKE)
    n = node.n
    n.in_faults = 0b0001
    node.call(reactions.inputs)
    n.in_faults = 0b0110
    node.call(reactions.inputs)
    assert n.causes == 0b0110 << emcy.FIRST_DEVICE_CAUSE
    assert node.codes() == [0x2310, 0x0000, 0x4210, 0x7305]


def test_a_fault_that_comes_or_goes_beside_another_leaves_that_alone():
    node = Node(KIND_BRAKE)
    n = node.n
    n.in_faults = 0b0010
    node.call(reactions.inputs)
    assert node.codes() == [0x4210]
    n.in_faults = 0b0011
    node.call(reactions.inputs)
    assert node.codes() == [0x2310]
    assert n.causes == 0b0011 << emcy.FIRST_DEVICE_CAUSE
    n.setpoint_armed = 1  # a set-point came meanwhile
    n.in_faults = 0b0010
    node.call(reactions.inputs)
    assert node.codes() == [0x0000]
    assert n.setpoint_armed == 1
    assert n.causes == 0b0010 << emcy.FIRST_DEVICE_CAUSE


@pytest.mark.parametrize("causes", [1 << emcy.RPDO_DEADLINE, 1 << emcy.BUS_OFF, 1 << emcy.LIFE_GUARDING])
def test_losses_of_communication_are_no_matter_of_the_inputs(causes):
    node = Node(KIND_BRAKE)
    node.n.causes = node.n.latched = causes
    node.call(reactions.inputs)
    assert node.n.causes == causes
    assert node.codes() == []


@KINDS
def test_only_a_brake_watches_its_coil(kind):
    node = Node(kind)
    node.n.short_A, node.n.in_coil_A, node.n.hot_degC, node.n.warm_degC, node.n.open_since_ns = 1.0, 5.0, 1e9, 1e9, -1
    node.call(reactions.inputs)
    assert node.codes() == ([0x2320] if kind == KIND_BRAKE else [])


def test_the_names_of_the_bits_and_of_the_reasons():
    assert (slots402.ACTS_CONTROLWORD, slots402.ACTS_TORQUE, slots402.ACTS_SPEED) == (1, 2, 4)
    assert slots404.ACTS_SETPOINT == slots402.ACTS_TORQUE
    assert (BY_COMMAND, BY_RESET, BY_ITSELF) == (0, 1, 2)
    assert reactions.RAMP_STEP_NS == MS
