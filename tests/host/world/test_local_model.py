import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.host.cycle.records import SLOTS, Slot
from coulombus.host.world.local_model import ACTIVE, HYBRID, PASSIVE
from coulombus.host.world.model_check import RANGES, why_not
from coulombus.host.world.model_parts import LinearField, Model, Spring, TorqueProfile, Wall
from coulombus.host.world.records import OFFERS, PARAMETERS
from model_cycle import cycle_of

BOTH = pytest.mark.parametrize("sign", [1, -1])


def test_the_records_have_a_place_for_each_parameter_of_a_law():
    assert (PARAMETERS, Slot.USER) == (SLOTS, 4)


@BOTH
def test_a_wall_resists_within_and_is_nothing_outside(sign):
    c = cycle_of(ACTIVE)
    c.render(Model(wall=Wall(0.5 * sign, 4.0, 0.5, side="above" if sign > 0 else "below")))
    assert c.at(0.25 * sign, 2.0 * sign) == (0.0, 0.0)
    assert c.at(0.75 * sign, 2.0 * sign) == (2.0 * sign, 0.0)  # 4 * 0.25 + 0.5 * 2
    assert c.at(0.75 * sign, -1.0 * sign) == (0.5 * sign, 0.0)


@BOTH
def test_a_wall_never_pulls_however_fast_the_hand_leaves(sign):
    c = cycle_of(ACTIVE)
    c.render(Model(wall=Wall(0.5 * sign, 4.0, 0.5, side="above" if sign > 0 else "below")))
    assert c.at(0.75 * sign, -8.0 * sign) == (0.0, 0.0)


@BOTH
def test_a_spring_pulls_to_its_point_with_at_most_its_torque(sign):
    c = cycle_of(ACTIVE)
    c.render(Model(spring=Spring(0.5, 4.0, 0.25, most_Nm=1.5)))
    assert c.at(0.5 + 0.25 * sign)[0] == 1.0 * sign
    assert c.at(0.5 + 0.25 * sign, 2.0 * sign)[0] == 1.5 * sign
    assert c.at(0.5 + 4.0 * sign)[0] == 1.5 * sign


@BOTH
def test_a_field_is_the_torque_on_the_handle(sign):
    c = cycle_of(ACTIVE)
    c.render(Model(field=LinearField(Nm=1.0 * sign, Nm_rad=-2.0, Nms_rad=-0.5)))
    assert c.at(0.0)[0] == -1.0 * sign
    assert c.at(0.5)[0] == -1.0 * sign + 1.0
    assert c.at(0.0, 2.0)[0] == -1.0 * sign + 1.0
    c.render(Model(field=LinearField(Nms_rad=0.5)))  # drives
    assert c.at(0.0, 2.0)[0] == -1.0


@BOTH
def test_in_hybrid_springs_push_by_the_motor_and_damping_is_the_brakes(sign):
    c = cycle_of(HYBRID)
    c.render(Model(spring=Spring(0.0, 4.0, 0.5)))
    assert c.at(0.5 * sign, 1.0 * sign) == (2.0 * sign, 0.5)
    assert c.at(0.5 * sign, -1.0 * sign) == (2.0 * sign, 0.5)  # the brake resists both ways
    assert c.at(0.5 * sign) == (2.0 * sign, 0.0)


@BOTH
def test_in_hybrid_the_brake_shows_what_the_motor_cannot_while_it_resists(sign):
    c = cycle_of(HYBRID, motor_Nm=0.5)
    c.render(Model(wall=Wall(0.0, 4.0, side="above" if sign > 0 else "below")))
    assert c.at(0.5 * sign, 1.0 * sign) == (0.5 * sign, 1.5)
    assert c.w.clipped == 0  # shown whole
    assert c.at(0.5 * sign, -1.0 * sign) == (0.5 * sign, 0.0)  # it does not hold the hand in the wall
    assert c.w.clipped == 1
    assert c.at(0.5 * sign, 0.0, 2.0 * sign) == (0.5 * sign, 1.5)  # the hand pushes into the wall
    assert c.at(0.5 * sign, 0.0, -2.0 * sign) == (0.5 * sign, 0.0)
    assert c.at(0.5 * sign, 0.0, 0.0) == (0.5 * sign, 0.0)  # no transducer


@BOTH
def test_in_passive_only_what_resists_is_shown(sign):
    c = cycle_of(PASSIVE)
    c.render(Model(wall=Wall(0.0, 4.0, 0.5, side="above" if sign > 0 else "below")))
    assert c.at(0.5 * sign, 1.0 * sign) == (0.0, 2.5)
    assert c.at(0.5 * sign, -1.0 * sign) == (0.0, 0.0)
    assert c.at(0.5 * sign, 0.0, 1.0 * sign) == (0.0, 2.0)


@BOTH
def test_the_motors_limit_leaves_room_for_the_compensation(sign):
    c = cycle_of(ACTIVE, motor_Nm=1.5, compensation_Nm=0.5)
    c.render(Model(spring=Spring(0.0, 4.0)))
    assert c.at(2.0 * sign) == (1.0 * sign, 0.0)
    assert (c.w.clipped, c.w.world_Nm) == (1, 1.0 * sign)


@BOTH
def test_law_and_model_together_stay_within_the_limits(sign):
    c = cycle_of(ACTIVE, motor_Nm=1.5, law_Nm=1.0 * sign)
    c.render(Model(spring=Spring(0.0, 4.0)))
    assert c.at(2.0 * sign)[0] == 1.5 * sign
    assert c.w.world_Nm == 0.5 * sign
    c = cycle_of(PASSIVE, brake_Nm=4.0, law_brake_Nm=3.0)
    c.render(Model(wall=Wall(0.0, 4.0)))
    assert c.at(2.0, 1.0) == (0.0, 4.0)
    assert (c.w.clipped, c.w.world_brake_Nm) == (1, 1.0)


def test_the_motors_torque_changes_by_at_most_its_rate():
    c = cycle_of(ACTIVE, rate_Nm=0.5)
    c.render(Model(spring=Spring(0.0, 4.0)))
    assert [c.at(0.5)[0] for _ in range(5)] == [0.5, 1.0, 1.5, 2.0, 2.0]
    assert c.w.clipped == 3


def test_the_brake_rises_at_once_and_falls_by_its_rate():
    c = cycle_of(PASSIVE, fall_Nm=0.5)
    c.render(Model(wall=Wall(0.0, 4.0)))
    assert c.at(0.5, 1.0) == (0.0, 2.0)
    assert [c.at(-1.0)[1] for _ in range(5)] == [1.5, 1.0, 0.5, 0.0, 0.0]


@pytest.mark.parametrize(("rest", "fading"), [(1.0, [0.25, 0.5, 0.75, 1.0, 1.0]), (0.0, [0.0] * 5)])
def test_a_model_fades_after_its_life_to_the_law_or_to_nothing(rest, fading):
    c = cycle_of(ACTIVE, rest=rest, law_Nm=8.0, motor_Nm=50.0)
    assert c.at(0.0)[0] == 8.0 * rest
    c.render(Model(spring=Spring(-1.0, 4.0), law=0.0, life_s=0.003))
    assert [c.at(0.0)[0] for _ in range(3)] == [4.0, 4.0, 4.0]
    assert [c.at(0.0)[0] for _ in range(5)] == [
        4.0 * share + 8.0 * law for share, law in zip([0.75, 0.5, 0.25, 0.0, 0.0], fading, strict=True)
    ]
    assert (c.w.fades, c.w.share) == (1, 0.0)


def test_a_model_that_is_renewed_does_not_fade():
    c = cycle_of(ACTIVE)
    for _ in range(20):
        c.render(Model(spring=Spring(-1.0, 4.0), life_s=0.002))
        assert c.at(0.0)[0] == 4.0
    assert c.w.fades == 0


def test_without_a_model_the_laws_output_passes_unchanged():
    c = cycle_of(ACTIVE, law_Nm=0.1 + 0.2, law_brake_Nm=0.7, motor_Nm=0.1, rate_Nm=1e-9)
    assert c.at(0.3, 1.0) == (0.1 + 0.2, 0.7)
    assert (c.w.clipped, c.w.world_Nm, c.w.world_brake_Nm) == (0, 0.0, 0.0)


def test_a_profile_is_played_once_for_its_number_and_ends():
    c = cycle_of(ACTIVE)
    click = Model(profile=TorqueProfile((1.0, -2.0), sample_s=0.002))
    c.render(click, profile=1)
    assert [c.at(0.0)[0] for _ in range(3)] == [-1.0, -1.0, 2.0]
    c.render(click, profile=1)  # renewed, not played again
    assert [c.at(0.0)[0] for _ in range(3)] == [2.0, 0.0, 0.0]
    c.render(click, profile=2)
    assert [c.at(0.0)[0] for _ in range(3)] == [-1.0, -1.0, 2.0]


def test_a_model_sets_parameters_of_the_law_until_it_has_faded():
    c = cycle_of(ACTIVE)
    c.render(Model(parameters={"F_s_Nm": 1.0}, life_s=0.001))
    c.at(0.0)
    assert (c.w.law.F_s, c.w.law.F_d, c.law.F_s) == (1.0, 2.0, 3.0)
    shown = []
    for _ in range(5):
        c.at(0.0)
        shown.append(float(c.w.law.F_s))
    assert shown == [1.5, 2.0, 2.5, 3.0, 3.0]


@BOTH
def test_a_change_of_the_stick_stiffness_keeps_the_force_of_a_stuck_handle(sign):
    c = cycle_of(ACTIVE)
    c.state.stuck, c.state.x_stuck = 1, 0.5
    c.render(Model(parameters={"K_p_Nm_rad": 400.0}, life_s=0.001))
    x = 0.5 + 0.01 * sign
    for _ in range(7):
        c.at(x)
        assert c.w.law.K_p * (x - c.state.x_stuck) == pytest.approx(1.0 * sign)
    assert (c.w.law.K_p, c.law.K_p) == (100.0, 100.0)


def test_more_models_than_rows_are_taken_in_turn():
    c = cycle_of(ACTIVE)
    for k in range(1, 3 * OFFERS):
        c.render(Model(spring=Spring(0.0, float(k % 5))))
        assert c.at(1.0)[0] == k % 5
        assert c.w.taken == k


numbers = {name: st.floats(low, high) for name, (low, high) in RANGES.items()}


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    mode=st.sampled_from([PASSIVE, HYBRID, ACTIVE]),
    values=st.fixed_dictionaries(numbers),
    parts=st.integers(0, 15),
    side=st.sampled_from([1, -1]),
    samples=st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 4),
    path=st.lists(st.tuples(st.floats(-100, 100), st.floats(-50, 50), st.floats(-20, 20)), min_size=1, max_size=12),
)
def test_no_plausible_model_exceeds_a_limit_or_a_rate(mode, values, parts, side, samples, path):
    c = cycle_of(mode, motor_Nm=1.5, brake_Nm=4.0, rate_Nm=0.75, fall_Nm=0.5, compensation_Nm=0.25)
    record = Model(life_s=0.005).record({})
    for name, value in values.items():
        record[name] = value
    record["parts"], record["wall_side"], record["profile"] = parts, side, 1
    record["samples"], record["sample_ns"] = 4, 1_500_000
    record["sample"][:4] = samples
    assert why_not(record, 1, 10**9) is None
    c.place(record)
    torque_Nm = brake_Nm = 0.0
    for place in path:
        before = torque_Nm, brake_Nm
        torque_Nm, brake_Nm = c.at(*place)
        assert math.isfinite(torque_Nm)
        assert abs(torque_Nm) <= 1.25
        assert abs(torque_Nm - before[0]) <= 0.75
        assert 0.0 <= brake_Nm <= 4.0
        assert before[1] - brake_Nm <= 0.5 + 1e-12


@BOTH
def test_what_a_limited_wall_returns_is_decided_by_the_place_alone(sign):
    c = cycle_of(ACTIVE, motor_Nm=1.5, compensation_Nm=0.25)
    c.render(Model(wall=Wall(0.0, 2.0, 0.1, side="above" if sign > 0 else "below"), life_s=1.0))
    returned = []
    for speed in (2.0, 0.0, -2.0):
        c.at(0.5 * sign, speed * sign)
        returned.append(c.w.elastic_Nm)
    assert returned == [sign * 1.0] * 3
    for speed in (2.0, 0.0, -2.0):
        c.at(0.75 * sign, speed * sign)
        assert c.w.elastic_Nm == sign * 1.25  # the motor has no more
    c = cycle_of(PASSIVE)
    c.render(Model(wall=Wall(0.0, 2.0, 0.1, side="above" if sign > 0 else "below"), life_s=1.0))
    c.at(0.5 * sign, 1.0 * sign)
    assert c.w.elastic_Nm == 0.0
