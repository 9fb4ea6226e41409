"""Each number of the local model: what a change of one would do to the torques, to the account of energy, or to the fade."""

import pytest

from coulombus.host.world.local_model import ACTIVE, HYBRID, PASSIVE
from coulombus.host.world.model_parts import LinearField, Model, Spring, TorqueProfile, Wall
from model_cycle import MS, cycle_of

EVERYTHING = Model(
    wall=Wall(-1.0, 4.0, 0.5),
    spring=Spring(0.5, 4.0, 0.5),
    field=LinearField(1.0, 2.0, -0.5),
    profile=TorqueProfile((1.0, 2.0), sample_s=1.0),
)


def record_of(model=EVERYTHING, **values):
    record = model.record({}, profile=1)
    for name, value in values.items():
        record[name] = value
    return record


def test_the_modes_are_numbered_as_the_protocol_says():
    assert (PASSIVE, HYBRID, ACTIVE) == (0, 1, 2)


@pytest.mark.parametrize("drives", [False, True])
def test_a_part_that_the_model_does_not_name_does_nothing(drives):
    c = cycle_of(ACTIVE)
    c.place(record_of(parts=0, field_Nms_rad=0.5 if drives else -0.5, parameters=7))
    assert c.at(0.0, 1.0) == (0.0, 0.0)
    assert (c.w.most_J, c.w.elastic_Nm, c.w.profile) == (0.0, 0.0, 0)
    assert (c.w.law.K_p, c.w.law.F_s, c.w.law.F_d) == (100.0, 3.0, 2.0)


def test_a_profile_is_played_once_by_its_number_and_ends_with_its_last_sample():
    c = cycle_of(ACTIVE)
    c.place(record_of(parts=8, samples=1, sample_ns=MS))
    assert c.at(0.0)[0] == -1.0
    assert c.at(0.0)[0] == 0.0  # the second sample of the record is not part of the profile
    c.place(record_of(parts=0, profile=7))  # a number alone plays nothing, and does not count as played
    c.at(0.0)
    assert c.w.profile == 1
    c.place(record_of(parts=8, samples=1, sample_ns=MS))
    assert c.at(0.0)[0] == 0.0
    c.place(record_of(parts=8, profile=2, samples=1, sample_ns=1))
    assert c.at(0.0)[0] == -1.0
    c.place(record_of(parts=8, profile=3, samples=1, sample_ns=0))
    assert c.at(0.0)[0] == 0.0


def test_a_time_to_live_ends_within_the_cycle_that_it_ends_in():
    c = cycle_of(ACTIVE)
    c.w.ramp_step = 0.3
    c.place(record_of(life_ns=MS + 1))
    shares = []
    for _ in range(8):
        c.at(0.0)
        shares.append((c.w.left_ns, round(c.w.share, 9)))
    assert shares[:5] == [(MS + 1, 1.0), (1, 1.0), (1 - MS, 0.7), (1 - MS, 0.4), (1 - MS, 0.1)]
    assert shares[5:] == [(1 - MS, 0.0)] * 3
    assert c.w.fades == 1
    c.place(record_of(life_ns=2 * MS))
    for _ in range(5):
        c.at(0.0)
    assert c.w.left_ns == 0


def test_a_field_begins_where_it_comes_in_and_goes_on_with_the_next_model():
    c = cycle_of(ACTIVE)
    field, bare = Model(field=LinearField(1.0), life_s=0.001), Model(life_s=0.001)
    for x_rad, model, begin in [
        (0.25, field, 0.25),
        (0.5, field, 0.25),
        (0.75, bare, 0.25),
        (1.0, field, 1.0),
        (1.25, field, 1.0),
    ]:
        c.render(model)
        c.at(x_rad)
        assert c.w.field_from_rad == begin
    for _ in range(2):
        c.at(1.5)
    assert 0.0 < c.w.share < 1.0
    c.render(field)
    c.at(1.75)
    assert c.w.field_from_rad == 1.0  # it had not faded to the end
    for _ in range(6):
        c.at(2.0)
    assert c.w.share == 0.0
    c.render(field)
    c.at(2.25)
    assert c.w.field_from_rad == 2.25


def test_each_parameter_has_its_slot_and_those_that_the_model_leaves_out_are_the_laws():
    c = cycle_of(ACTIVE)
    c.law.paper_entry, c.law.brake_spring, c.law.velocity_band_counts = 1, 1, 5.0
    for k in range(16):
        c.law.user[k] = 100.0 + k
    every = [200.0 + slot for slot in range(20)]
    c.place(record_of(parts=16, parameters=(1 << 20) - 1, parameter=every))
    c.at(0.0)
    law = c.w.law
    assert (law.K_p, law.F_s, law.F_d, [*law.user]) == (200.0, 201.0, 202.0, every[4:])
    assert (law.paper_entry, law.brake_spring, law.velocity_band_counts) == (1, 1, 5.0)
    c.place(record_of(parts=16, parameters=1 << 2 | 1 << 5, parameter=every))
    c.at(0.0)
    assert (law.K_p, law.F_s, law.F_d) == (100.0, 3.0, 202.0)
    assert [*law.user] == [100.0, 205.0, *(100.0 + k for k in range(2, 16))]


@pytest.mark.parametrize(("K_p", "ratio"), [(100.0, 0.5), (0.5, 100.0), (0.0, 1.0)])
@pytest.mark.parametrize("stuck", [0, 1])
def test_a_change_of_stiffness_keeps_the_force_of_a_stuck_handle(K_p, ratio, stuck):
    c = cycle_of(ACTIVE)
    c.law.K_p, c.state.stuck, c.state.x_stuck = K_p, stuck, 1e-20
    c.render(Model(parameters={"K_p_Nm_rad": 50.0}))
    c.at(0.1)
    assert c.w.K_p_ratio == ratio
    shifted = 0.1 - (0.1 - 1e-20) / ratio if stuck and ratio != 1.0 else 1e-20
    assert c.state.x_stuck == shifted
    c.at(0.1)
    assert c.state.x_stuck == shifted


@pytest.mark.parametrize(
    ("model", "x_rad", "most_J"),
    [
        (Model(), 1.0, 0.0),
        (Model(wall=Wall(0.5, 4.0)), 0.75, 4.0 * 0.25 * 0.25),
        (Model(wall=Wall(0.5, 4.0)), 2.5, 1.5 * 2.0),
        (Model(wall=Wall(-0.5, 4.0, side="below")), -0.75, 4.0 * 0.25 * 0.25),
        (Model(spring=Spring(0.5, 4.0)), 0.75, 4.0 * 0.25 * 0.25),
        (Model(spring=Spring(0.5, 4.0)), 0.25, 4.0 * 0.25 * 0.25),
        (Model(spring=Spring(0.5, 4.0)), -1.5, 1.5 * 2.0),
        (Model(field=LinearField(1.0, 0.5)), 0.5, 1.25 * 0.25),
        (Model(field=LinearField(-1.0, -0.5)), 0.0, 1.0 * 0.25),
        (Model(field=LinearField(1.0, 5.0)), 1.25, 1.5 * 1.0),
    ],
)
def test_what_a_part_can_return_at_most(model, x_rad, most_J):
    c = cycle_of(ACTIVE, motor_Nm=1.5)
    c.render(model)
    c.at(0.25)
    c.at(x_rad)
    assert c.w.most_J == pytest.approx(most_J)
    c.w.left_ns = 0
    c.at(x_rad)
    assert c.w.most_J == pytest.approx(0.75 * most_J)


def test_a_wall_does_not_damp_at_its_face():
    c = cycle_of(ACTIVE)
    c.render(Model(wall=Wall(0.5, 4.0, 1.0)))
    assert c.at(0.5, 2.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("v_counts", "handle_Nm", "resists"),
    [
        (2.0, -1.0, False),  # within the band the hand decides
        (2.0, 1.0, True),
        (2.5, -1.0, True),
        (-2.5, 1.0, False),
        (0.0, 0.5, True),
        (0.0, -0.5, False),
        (0.0, 0.0, False),
    ],
)
def test_the_motion_decides_what_resists_and_at_rest_the_hand(v_counts, handle_Nm, resists):
    c = cycle_of(PASSIVE)
    c.render(Model(wall=Wall(0.0, 4.0)))
    assert c.at(0.5, 0.01 * v_counts, handle_Nm) == (0.0, 2.0 if resists else 0.0)


@pytest.mark.parametrize("v_counts", [0.8, -0.8])
def test_a_narrow_band_has_two_senses(v_counts):
    c = cycle_of(PASSIVE)
    c.law.velocity_band_counts = 0.5
    c.render(Model(wall=Wall(0.0, 4.0)))
    assert c.at(0.5, 0.01 * v_counts)[1] == (2.0 if v_counts > 0.0 else 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_laws_own_push_is_not_limited_here_and_without_room_the_model_has_none(sign):
    c = cycle_of(ACTIVE, motor_Nm=1.0, law_Nm=sign * 3.0)
    c.render(Model())
    assert c.at(0.0)[0] == sign * 3.0
    c = cycle_of(ACTIVE, motor_Nm=1.0, compensation_Nm=5.0)
    c.render(Model(spring=Spring(-sign, 4.0)))
    assert c.at(0.0)[0] == 0.0
    c.law_Nm = sign * 0.5
    assert c.at(0.0)[0] == sign * 0.5
    c.render(Model(spring=Spring(sign * 0.075, 4.0)))  # it takes away from the law's push
    assert c.at(0.0)[0] == pytest.approx(sign * 0.2)


def test_the_laws_own_level_is_not_limited_here_and_falls_at_the_models_rate_from_the_limit():
    c = cycle_of(HYBRID, brake_Nm=20.0, fall_Nm=1.0, law_brake_Nm=30.0)
    c.render(Model())
    assert c.at(0.0)[1] == 30.0
    c.law_brake_Nm = 0.0
    assert [c.at(0.0)[1] for _ in range(3)] == [20.0, 19.0, 18.0]
    assert c.w.clipped == 3


def test_without_a_model_the_law_has_its_own_rates():
    c = cycle_of(HYBRID, rate_Nm=0.5, fall_Nm=0.5, law_Nm=4.0, law_brake_Nm=4.0)
    assert c.at(0.0) == (4.0, 4.0)
    c.law_Nm, c.law_brake_Nm = -4.0, 0.0
    assert c.at(0.0) == (-4.0, 0.0)
    assert (c.w.clipped, c.w.apart) == (0, 0)


def test_rounding_is_no_clipping():
    c = cycle_of(ACTIVE, motor_Nm=0.0)
    c.render(Model(field=LinearField(-1e-9)))
    c.at(0.0)
    assert c.w.clipped == 0
    c = cycle_of(HYBRID, motor_Nm=0.0, brake_Nm=0.0)
    c.render(Model(field=LinearField(-1e-9)))
    c.at(0.0, 1.0)
    assert c.w.clipped == 0
    c.render(Model(field=LinearField(-3e-9)))
    c.at(0.0, 1.0)
    assert c.w.clipped == 1


def test_the_models_rates_hold_until_nothing_of_it_is_left():
    c = cycle_of(ACTIVE, rate_Nm=0.5)
    c.w.ramp_step = 1.0
    c.render(Model(life_s=0.001))
    c.at(0.0)
    assert c.w.apart == 1  # a model that exerts nothing yet
    c.render(Model(field=LinearField(-2.0), life_s=0.004))
    assert [c.at(0.0)[0] for _ in range(5)] == [0.5, 1.0, 1.5, 2.0, 1.5]
    assert (c.w.share, c.w.apart) == (0.0, 1)
    assert [(c.at(0.0)[0], c.w.apart) for _ in range(4)] == [(1.0, 1), (0.5, 1), (0.0, 0), (0.0, 0)]
    c = cycle_of(PASSIVE, fall_Nm=0.5)
    c.w.ramp_step = 1.0
    c.render(Model(wall=Wall(0.0, 1.0), life_s=0.001))
    assert [c.at(1.0, 1.0)[1] for _ in range(2)] == [1.0, 0.5]
    assert (c.w.share, c.w.apart) == (0.0, 1)
    c.at(1.0, 1.0)
    assert c.w.apart == 0
