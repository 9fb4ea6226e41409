"""A model that feeds the handle's swings gets softer, and no other does."""

import math

import numpy as np
import pytest

from coulombus.host.world import softening
from coulombus.host.world.model_parts import LinearField, Model, Spring, TorqueProfile, Wall
from coulombus.host.world.model_set_up import set_up_model
from coulombus.host.world.records import LocalModelRecord
from coulombus.host.world.softening import come_back, feeds_a_swing, keep_stiffness, soften
from coulombus.kernels.records import dtype_of, new_records
from coulombus.rigs.rig import load_rig
from model_cycle import cycle_of
from plain_records import record_for_kernels

PERIOD_NS = 1_000_000
FIRST_SWINGS = 20
"""Cycles in which a swing has no whole one before it."""


def record():
    w = record_for_kernels(new_records(LocalModelRecord)[0])
    w.period_ns, w.swing_band_rad, w.drive_step, w.acts_at_once = PERIOD_NS, 0.001, 1.0, 1
    return w


def swing(w, periods, frequency_Hz=50.0, size_rad=0.01, decay=1.0, gain_Nm=0.0, law_Nm=0.0, driven=0.0):
    """Swing the handle; the model's torque along its velocity is `gain_Nm`, a share of it `driven`; that of the law
    `law_Nm`. Return the numbers of the cycles in which a fed swing ends.
    """
    fed = []
    for k in range(round(periods * 1000 / frequency_Hz)):
        t = k / 1000
        phase = 2 * math.pi * frequency_Hz * t
        if feeds_a_swing(w, size_rad * decay ** (frequency_Hz * t) * math.sin(phase)):
            fed.append(k)
        # what acts until the next position: with the sign of psi, a torque against the motion is positive
        ahead = math.cos(2 * math.pi * frequency_Hz * (t + 0.0005))
        w.world_Nm = -gain_Nm * ahead
        w.driven_Nm, w.pushed_Nm = driven * w.world_Nm, w.world_Nm - law_Nm * ahead
    return [k for k in fed if k >= FIRST_SWINGS]


def test_a_model_that_gives_energy_feeds_each_swing():
    fed = swing(record(), 6, gain_Nm=1.0)
    assert len(fed) == 10
    assert set(np.diff(fed)) == {10}  # a half period of 50 Hz


@pytest.mark.parametrize(
    "what",
    [
        {"gain_Nm": 1.0, "frequency_Hz": 6.0},  # a hand does that
        {"gain_Nm": 1.0, "size_rad": 0.0004},  # the encoder's counts
        {"gain_Nm": 1.0, "decay": 0.6},  # it dies by itself: 0.77 of the swing before
        {"gain_Nm": 1.0, "law_Nm": 1.1},  # the law feeds it
    ],
)
def test_no_other_swing_is_fed(what):
    assert swing(record(), 8, **what) == []


@pytest.mark.parametrize("what", [{"decay": 0.7}, {"frequency_Hz": 7.0}, {"size_rad": 0.0006}, {"law_Nm": 0.9}])
def test_a_swing_just_within_the_bounds_is_fed(what):
    assert swing(record(), 8, **({"gain_Nm": 1.0} | what))


def test_the_other_sense_changes_nothing():
    mirrored = record()
    mirrored.falls = 1
    assert swing(mirrored, 6, size_rad=-0.01, gain_Nm=-1.0) == swing(record(), 6, gain_Nm=1.0)


def test_a_torque_acts_with_the_next_sync_and_behind_the_drives_lag():
    w = record()
    w.acts_at_once, w.drive_step = 0, 0.5
    w.world_Nm = w.pushed_Nm = -2.0
    given = []
    for k in range(5):
        feeds_a_swing(w, 0.01 * k)
        given.append(round(float(w.given_J[0]), 12))
        w.world_Nm = w.pushed_Nm = 0.0
    assert given == [0.0, 0.0, 0.01, 0.015, 0.0175]


def test_each_fed_swing_takes_a_fifth_and_more_where_the_motor_is_at_its_limit():
    w = record()
    soften(w)
    soften(w)
    assert w.softened == pytest.approx(1.0 - 0.8 * 0.8)
    w.demand_before = 10.0
    soften(w)
    assert w.softened == pytest.approx(1.0 - 0.8 * 0.8 * 0.08)
    for _ in range(100):
        soften(w)
    assert w.softened == softening.MOST


def test_the_most_that_was_asked_is_that_of_the_swing_before():
    w = record()
    swing(w, 2)
    w.demand = 7.0
    swing(w, 0.51)
    assert (w.demand_before, w.demand) == (7.0, 0.0)


def test_the_stiffness_comes_back_off_the_model_and_at_rest_alone():
    w = record()
    w.softened = 0.5
    w.swing_ns = softening.CHATTER_NS
    come_back(w, True)
    assert w.softened == 0.5
    w.swing_ns -= 1
    come_back(w, False)
    assert w.softened == 0.5
    w.swing_ns += 1
    for _ in range(1001):
        come_back(w, False)
    assert 1.0 - w.softened == pytest.approx(0.5 * math.exp(1.001 / softening.RECOVERY_S), rel=1e-3)
    for _ in range(1000):
        come_back(w, False)
    assert w.softened == 0.0


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Model(wall=Wall(0.0, 100.0)), Model(wall=Wall(0.1, 400.0))),
        (Model(spring=Spring(0.0, 100.0)), Model(wall=Wall(0.1, 300.0), spring=Spring(0.0, 100.0))),
        (Model(field=LinearField(0.0, -100.0)), Model(spring=Spring(0.0, 400.0))),
    ],
)
def test_a_stiffer_model_is_softened_down_to_what_was_displayed(first, second):
    c = cycle_of(2)
    c.render(first)
    c.at(0.0)
    c.w.softened = 0.5
    c.render(second)
    c.at(0.0)
    assert c.w.softened == pytest.approx(1.0 - 50.0 / 400.0)
    c.render(Model(wall=Wall(0.0, 20.0)))
    c.at(1.0)
    assert c.w.softened == 0.0


@pytest.mark.parametrize(
    ("parts", "stiffness"), [(1, 0.25 + 0.5), (2, 2.0 + 4.0), (4, 8.0 + 1 + 2 + 3 + 4), (3, 6.75), (0, 0.0)]
)
def test_the_stiffness_of_a_model_is_the_sum_of_the_parts_that_it_has(parts, stiffness):
    w = record()
    m = w.offered[0]
    m.parts, m.wall_K_Nm_rad, m.plane_wall_K_N_m, m.spring_K_Nm_rad, m.plane_spring_K_N_m = parts, 0.25, 0.5, 2.0, 4.0
    m.field_Nm_rad = -8.0
    for k, value in enumerate((1.0, -2.0, 3.0, -4.0)):
        m.plane_field_N_m[k] = value
    w.softened, w.stiffness = 0.5, 0.5
    keep_stiffness(w)
    assert w.stiffness == stiffness
    assert w.softened == (1.0 - 0.25 / stiffness if stiffness else 0.0)


def test_a_model_that_is_not_softened_may_get_stiffer():
    w = record()
    w.offered[0].parts, w.offered[0].wall_K_Nm_rad, w.stiffness = 1, 8.0, 4.0
    keep_stiffness(w)
    assert w.softened == 0.0


@pytest.mark.parametrize(("before", "now", "softened"), [(0.0, 4.0, 0.0), (4.0, 4e9, softening.MOST), (4.0, 1.0, 0.0)])
def test_what_was_displayed_bounds_what_is_softened(before, now, softened):
    w = record()
    w.offered[0].parts, w.offered[0].wall_K_Nm_rad = 1, now
    w.softened, w.stiffness = 0.5, before
    keep_stiffness(w)
    assert w.softened == softened


def test_what_drives_is_no_stiffness():
    c = cycle_of(2, motor_Nm=0.75)
    c.render(
        Model(wall=Wall(0.0, 4.0), field=LinearField(-0.25, 0.0, 0.125), profile=TorqueProfile((0.125,) * 64, 1.0))
    )
    for v_rad_s, driven_Nm in ((0.0, 0.125), (1.0, 0.0), (8.0, -0.75), (-8.0, 0.75)):
        c.at(0.0, v_rad_s)
        assert c.w.driven_Nm == driven_Nm
    c.render(Model(field=LinearField(-0.25, -1.0)))
    c.at(0.0)
    assert c.w.driven_Nm == 0.0
    wall = Model(wall=Wall(0.0, 4.0)).record({}, profile=0)
    wall["field_Nm"] = 0.5  # of a part that the model does not have
    c.place(wall)
    c.at(0.0)
    assert c.w.driven_Nm == 0.0
    passive = cycle_of(0)
    passive.render(Model(field=LinearField(-0.25)))
    passive.at(0.0)
    assert passive.w.driven_Nm == 0.0


def test_a_stream_of_torques_that_shakes_the_handle_softens_nothing():
    assert swing(record(), 10, gain_Nm=1.0, driven=0.8) == []


def turning(size_rad=4.0, swing_rad=4.0, model_J=(1.0, 0.0), law_J=(0.0, 0.0), ns=40_000_000, back_rad=0.5):
    """Return a record, and whether the swing that turns in its next cycle is fed. `model_J` and `law_J` are the
    energies of this swing and the one before.
    """
    w = record()
    w.turned_rad, w.extreme_rad, w.swing_x_rad, w.swing_rad = -size_rad, 0.0, -back_rad, swing_rad
    w.swing_ns, w.swing_band_rad = ns - PERIOD_NS, 0.25
    for k, (now, before) in enumerate((model_J, law_J)):
        w.given_J[k], w.given_before_J[k] = now, before
    return w, feeds_a_swing(w, -back_rad)


@pytest.mark.parametrize(
    ("what", "fed"),
    [
        ({}, True),
        ({"model_J": (0.0, 1.0)}, True),
        ({"model_J": (-1.0, 1.0)}, False),
        ({"model_J": (1.0, 1.0), "law_J": (1.0, 0.5)}, True),
        ({"model_J": (1.0, 1.0), "law_J": (1.0, 1.0)}, False),
        ({"model_J": (1.0, 1.0), "law_J": (0.5, 2.0)}, False),
        ({"model_J": (1.0, 1.0), "law_J": (3.0, -0.5)}, False),
        ({"model_J": (-0.25, -0.25), "law_J": (-1.0, -1.0)}, False),
        ({"size_rad": 4.0, "swing_rad": 5.0}, False),
        ({"size_rad": 4.5, "swing_rad": 5.0}, True),
        ({"swing_rad": 0.0}, False),
        ({"ns": 79_999_999}, True),
        ({"ns": 80_000_000}, False),
        ({"back_rad": 0.25}, False),
    ],
)
def test_which_swing_is_fed(what, fed):
    assert turning(**what)[1] == fed


@pytest.mark.parametrize(
    ("swings", "ns", "law_J", "fed"),
    [
        (7, 49_999_999, (0.0, 0.0), True),
        (6, 49_999_999, (0.0, 0.0), False),
        (7, 50_000_000, (0.0, 0.0), False),
        (7, 40_000_000, (0.5, -0.5), True),
        (7, 40_000_000, (0.5, -0.25), False),
        (9, 40_000_000, (-0.5, -0.5), True),
    ],
)
def test_what_swings_long_and_too_fast_for_a_hand_is_fed_whatever_the_account_says(swings, ns, law_J, fed):
    w = record()
    w.turned_rad, w.swing_x_rad, w.swing_rad, w.swings = -4.0, -0.5, 4.0, swings
    w.swing_ns, w.swing_band_rad = ns - PERIOD_NS, 0.25
    w.given_J[0], w.given_J[1], w.given_before_J[1] = -1.0, *law_J
    assert feeds_a_swing(w, -0.5) == fed
    assert w.swings == (swings + 1 if ns < 50_000_000 else 0)


def test_a_swing_that_dies_ends_the_row():
    w, _ = turning(size_rad=1.0, swing_rad=4.0)
    assert w.swings == 0


def test_a_turn_begins_the_next_swing():
    w, _ = turning(model_J=(1.0, 7.0), law_J=(2.0, 8.0))
    assert (w.turned_rad, w.extreme_rad, w.falls, w.swing_rad, w.swing_ns) == (0.0, -0.5, 1, 4.0, 0)
    assert (list(w.given_before_J), list(w.given_J)) == ([1.0, 2.0], [0.0, 0.0])
    slow, _ = turning(ns=90_000_000)
    assert slow.swing_rad == 0.0


def test_a_handle_that_goes_on_does_not_turn():
    w = record()
    for k in range(10):
        assert not feeds_a_swing(w, 0.01 * k)
    assert (w.falls, w.turned_rad, w.extreme_rad, w.swing_ns) == (0, 0.0, 0.09, 10 * PERIOD_NS)


@pytest.mark.parametrize(("rig", "ahead_s"), [("bench", 3.5e-3), ("paper", 3.5e-3), ("plane", 6e-3)])
def test_how_far_ahead_a_model_acts(rig, ahead_s):
    axis = load_rig(rig, ('world.rest = "law"',)).axes[0]
    w = np.zeros(1, dtype_of(LocalModelRecord))[0]
    names = "motor_limit_raw", "motor_Nm_raw", "motor_rate_Nm", "brake_limit_Nm", "brake_fall_Nm"
    set_up_model(w, axis, "active", dict.fromkeys(names, 1.0) | {"period_ns": PERIOD_NS, "rad_count": -2.0})
    assert w["ahead_s"] == pytest.approx(ahead_s)
    assert w["drive_step"] == pytest.approx(1.0 - math.exp(-axis.bus.period_s / 1e-3))
    assert (w["swing_band_rad"], w["acts_at_once"]) == (6.0, 0)


def test_what_is_softened_is_wall_spring_and_stiff_field_with_their_damping():
    def at(model, x_rad, v_rad_s=0.0, softened=0.75):
        c = cycle_of(2, motor_Nm=100.0)
        c.render(model)
        c.w.softened = softened
        c.w.stiffness = 4.0
        return c.at(x_rad, v_rad_s)[0]

    for model in (
        Model(wall=Wall(0.0, 4.0, 0.5)),
        Model(spring=Spring(0.0, 4.0, 0.5)),
        Model(field=LinearField(0, -4.0, -0.5)),
    ):
        assert at(model, 1.0, 2.0) == pytest.approx(0.25 * at(model, 1.0, 2.0, softened=0.0)) != 0.0


def test_a_model_acts_where_the_handle_will_be():
    c = cycle_of(2, motor_Nm=100.0)
    c.w.ahead_s = 0.25
    c.render(Model(wall=Wall(1.0, 4.0, 0.5)))
    assert c.at(0.75, 2.0)[0] == pytest.approx(4.0 * 0.25 + 0.5 * 2.0)  # not yet in the wall
    assert c.at(1.25, -2.0)[0] == 0.0  # out of it when the torque acts
    assert c.w.elastic_Nm == pytest.approx(4.0 * 0.25)  # the account has the place where it is


def test_a_constant_field_is_no_stiffness():
    c = cycle_of(2)
    c.w.softened = 0.5
    c.w.stiffness = 1.0
    c.render(Model(field=LinearField(1.0)))
    c.w.wanted, c.w.taken = c.number, c.number  # in use already
    c.w.share, c.w.left_ns = 1.0, 10 * PERIOD_NS
    assert c.at(0.0)[0] == -1.0
    c.render(Model(field=LinearField(1.0, 1.0)))
    c.at(0.0)
    c.w.softened = 0.5
    assert c.at(0.0)[0] == -0.5


def test_what_the_parts_ask_of_the_motor_is_kept_until_the_handle_turns():
    c = cycle_of(2, motor_Nm=0.5)
    c.compensation_Nm = 0.25
    c.w.swing_band_rad = 10.0
    c.render(Model(spring=Spring(0.0, 4.0)))
    for x_rad, demand in ((-0.5, 8.0), (0.25, 8.0), (0.75, 12.0), (0.0, 12.0)):
        c.at(x_rad)
        assert c.w.demand == pytest.approx(demand)
    none = cycle_of(2, motor_Nm=0.25)
    none.compensation_Nm = 0.25
    none.render(Model(spring=Spring(0.0, 4.0)))
    none.at(1.0)
    assert none.w.demand == 0.0


def test_a_cycle_softens_what_is_fed_and_recovers_off_the_model():
    c = cycle_of(2, motor_Nm=100.0)
    c.w.swing_band_rad = 0.25
    c.render(Model(wall=Wall(0.0, 1.0)))
    c.at(0.0)
    c.w.turned_rad, c.w.extreme_rad, c.w.swing_rad, c.w.swing_ns, c.w.given_J[0] = -4.0, 1.0, 4.0, 0, 1.0
    c.at(0.5)
    assert c.w.softened == pytest.approx(0.2)
    c.w.swing_ns = 90_000_000
    c.at(0.5)
    assert c.w.softened == pytest.approx(0.2)  # at the wall
    c.at(1.0)
    assert c.w.softened == pytest.approx(0.2)
    c.at(0.9)
    c.w.swing_ns, c.w.swing_band_rad = 90_000_000, 10.0
    c.at(-0.1)
    assert c.w.softened == pytest.approx(1.0 - 0.8 * 1.0005)
