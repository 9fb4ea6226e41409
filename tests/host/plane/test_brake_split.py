"""A wanted force shared out over brakes and motors: whole, bounded, and never active."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.host.plane.brake_split import expect_brakes, hold, observe, slip
from coulombus.host.plane.plane_host_record import SplitControlRecord, SplitStateRecord
from coulombus.kernels.records import new_records
from coulombus.rigs.kinematics.mechanisms import PoseRecord

NOTHING = np.zeros(2)
number = st.floats(-5, 5, allow_subnormal=False)
level = st.floats(0, 4, allow_subnormal=False)


def control(brake=9.0, motor=9.0, compensation=1.0, **others):
    c = new_records(SplitControlRecord)[0]
    c["brake_limit_Nm"], c["motor_limit_Nm"] = brake, motor
    c["coil_step"] = c["fluid_step"] = 1.0
    c["period_s"], c["passivity_J"] = 1e-3, 1e9
    for name, value in others.items():
        c[name] = value
    c["compensation_Nm"] = compensation * c["friction_Nm"]
    return c


def posed(jacobian):
    pose = new_records(PoseRecord)[0]
    pose["jacobian"] = jacobian
    return pose


def arm(l1, l2, q1, q2):
    elbow, tip = l1 * np.exp(1j * q1), l1 * np.exp(1j * q1) + l2 * np.exp(1j * (q1 + q2))
    columns = [1j * tip, 1j * (tip - elbow)]
    return np.array([[column.real for column in columns], [column.imag for column in columns]])


def split(c, jacobian, psi, v, push=NOTHING, rate=NOTHING, expected=None, hand=NOTHING):
    s = new_records(SplitStateRecord)[0]
    if expected is not None:
        s["expected_Nm"] = s["coil_Nm"] = s["sent_Nm"] = expected
    slip(
        c,
        s,
        posed(jacobian),
        np.asarray(psi, float),
        np.asarray(push, float),
        np.asarray(v, float),
        np.asarray(rate, float),
        np.asarray(hand, float),
    )
    return s


def shown(c, s, v):
    """The torques of motors, modelled brakes and friction on the joints."""
    return s["motor_Nm"] - np.sign(v) * (s["ahead_Nm"] + c["friction_Nm"])


@pytest.mark.parametrize("seed", range(10))
def test_brakes_that_are_there_at_once_leave_the_motors_what_would_push(seed):
    random = np.random.default_rng(seed)
    jacobian = arm(*random.uniform(0.1, 0.4, 2), random.uniform(-3, 3), random.uniform(0.4, 2.7))
    heading = random.uniform(0, 2 * math.pi)
    tip = np.array([math.cos(heading), math.sin(heading)])
    v, psi = np.linalg.solve(jacobian, tip), 3.0 * tip
    wanted = -jacobian.T @ psi
    s = split(control(), jacobian, psi, v)
    brakes = np.maximum(0.0, -wanted * np.sign(v))
    assert s["brake_Nm"] == pytest.approx(brakes)
    s = split(control(), jacobian, psi, v, expected=brakes)
    assert s["motor_Nm"] == pytest.approx(wanted + np.sign(v) * brakes, abs=1e-12)
    assert sum(np.maximum(s["motor_Nm"] * v, 0)) == pytest.approx(sum(np.maximum(wanted * v, 0)), abs=1e-12)
    assert np.count_nonzero(np.abs(s["motor_Nm"]) > 1e-9) <= 1


def test_the_motors_give_what_lagging_brakes_do_not():
    jacobian, tip = arm(0.2, 0.2, 0.0, 1.6), np.array([0.6, 0.8])
    v, psi = np.linalg.solve(jacobian, tip), 3.0 * tip
    for expected in ([0.0, 0.0], [0.3, 0.1], [1.2, 0.9]):
        c = control(friction_Nm=[0.1, 0.2])
        s = split(c, jacobian, psi, v, expected=np.array(expected))
        assert shown(c, s, v) == pytest.approx(-jacobian.T @ psi)


def test_a_joints_own_friction_is_a_part_of_what_its_brake_bears():
    jacobian, tip = arm(0.2, 0.2, 0.0, 1.6), np.array([0.0, 1.0])
    v, psi = np.linalg.solve(jacobian, tip), 5.0 * tip
    without, own = split(control(), jacobian, psi, v), split(control(friction_Nm=[0.2, 0.2]), jacobian, psi, v)
    assert without["brake_Nm"].max() > 0.5
    assert own["brake_Nm"] == pytest.approx(np.maximum(without["brake_Nm"] - 0.2, 0.0))


@settings(max_examples=60, derandomize=True, deadline=None)
@given(
    st.tuples(number, number, number, number),
    st.tuples(number, number),
    st.floats(0, 10),
    st.tuples(level, level),
    st.tuples(level, level),
    st.tuples(level, level),
    st.tuples(number, number),
)
def test_whatever_is_wanted_no_limit_is_passed_and_the_whole_takes_power(
    entries, v, size, brake, motor, expected, rate
):
    jacobian, v = np.array(entries).reshape(2, 2), np.array(v)
    tip = jacobian @ v
    if not np.hypot(*tip) > 1e-6:
        return
    c = control(brake, motor, friction_Nm=[0.1, 0.05], reversal_s=0.06, lead_s=0.004)
    c["coil_step"], c["fluid_step"] = 0.3, 0.1
    s = split(c, jacobian, size * tip / np.hypot(*tip), v, rate=rate, expected=np.array(expected))
    assert (np.abs(s["motor_Nm"]) <= np.array(motor) + 1e-12).all()
    assert (s["brake_Nm"] >= 0).all()
    assert (s["brake_Nm"] <= np.array(brake) + 1e-12).all()
    assert float(shown(c, s, v) @ v) <= 1e-9


def pushed(jacobian):
    """The joints' speeds of the motion in which a motor must push most, and which joint it is on."""
    headings = np.linspace(0, 2 * math.pi, 721)
    tips = np.stack((np.cos(headings), np.sin(headings)))
    speeds = np.linalg.solve(jacobian, tips)
    power = -(jacobian.T @ tips) * speeds
    joint, k = np.unravel_index(power.argmax(), power.shape)
    assert power[joint, k] > 0.05
    return speeds[:, k], int(joint)


def test_a_limit_that_would_make_the_whole_active_shortens_what_pushes():
    jacobian = arm(0.2, 0.2, 0.0, 1.0)
    v, joint = pushed(jacobian)
    limit = np.full(2, 9.0)
    limit[1 - joint] = 0.02  # of what takes power there is almost nothing
    c = control(brake=limit, motor=limit)
    s = split(c, jacobian, 5.0 * (jacobian @ v), v)
    assert s["withheld"] == 1
    assert s["motor_Nm"][joint] * v[joint] > 0
    assert float(shown(c, s, v) @ v) == pytest.approx(0.0, abs=1e-12)


def test_a_spring_pushes_back_with_the_motors_alone():
    jacobian, v = arm(0.2, 0.3, 0.3, 1.2), np.array([0.1, -0.2])
    push = np.array([2.0, -1.0])
    s = split(control(), jacobian, push, v, push=push)
    assert s["motor_Nm"] == pytest.approx(-jacobian.T @ push)
    assert s["brake_Nm"] == pytest.approx(0.0, abs=1e-12)


def test_a_brake_lets_go_before_its_joint_turns_round():
    jacobian, v = arm(0.2, 0.2, 0.0, 1.6), np.array([0.3, 0.3])
    tip = jacobian @ v
    psi = 3.0 * tip / np.hypot(*tip)
    c = control(reversal_s=0.06)
    full = split(c, jacobian, psi, v)["brake_Nm"]
    assert full.min() > 0
    for rate, share in (((-2.5, 0.0), 1.0), ((-10.0, 0.0), 0.5), ((10.0, 0.0), 1.0)):
        s = split(c, jacobian, psi, v, rate=rate)
        assert s["brake_Nm"] == pytest.approx(full * [share, 1.0])


def test_motors_that_have_given_too_much_push_no_more():
    jacobian, c = arm(0.2, 0.2, 0.0, 1.0), control(passivity_J=0.01)
    v, _ = pushed(jacobian)
    psi, pushes = 3.0 * (jacobian @ v), []
    for given_J in (0.0, 0.005, 0.02):
        s = new_records(SplitStateRecord)[0]
        s["motor_J"] = given_J, 0.0
        slip(c, s, posed(jacobian), psi, NOTHING, v, NOTHING, NOTHING)
        pushes.append(np.maximum(s["motor_Nm"] * v, 0.0).sum())
    assert pushes[0] == pytest.approx(pushes[1])
    assert pushes[0] > 0.1
    assert pushes[2] == 0.0


@pytest.mark.parametrize(("beside_Nm", "part"), [(-0.2, -1.0), (-0.01, -0.8), (0.005, 0.4), (0.2, 1.0)])
def test_friction_of_a_joint_at_rest_is_compensated_towards_its_load(beside_Nm, part):
    c = control(friction_Nm=0.1, compensation=0.9)
    s = split(c, np.eye(2), [0.0, 1.0], [0.3, 0.0], hand=[0.0, 1.0 + beside_Nm])
    assert s["motor_Nm"][1] == pytest.approx(-1.0 + 0.09 * part)
    still = split(c, np.eye(2), [0.0, 1.0], [0.0, 0.0], hand=[0.0, 1.0 + beside_Nm])
    assert still["motor_Nm"][1] == -1.0  # an offset of the transducer moves no arm at rest


def test_the_energies_are_those_of_what_acts():
    c, s = control(friction_Nm=[0.1, 0.0]), new_records(SplitStateRecord)[0]
    v = np.array([2.0, -1.0])
    s["motor_Nm"], s["brake_Nm"] = (0.5, 0.4), (0.3, 0.2)
    expect_brakes(c, s)
    observe(c, s, v)
    assert s["motor_J"] == pytest.approx([1e-3, -0.4e-3])
    assert s["taken_J"] == pytest.approx(0.1 * 2e-3 - 0.6e-3)
    expect_brakes(c, s)  # now the set-points act
    observe(c, s, v)
    assert s["taken_J"] == pytest.approx(2 * (0.1 * 2e-3 - 0.6e-3) + 0.3 * 2e-3 + 0.2e-3)


def test_the_motors_give_what_the_lagging_brake_lacks_when_they_act():
    c = control(coil_step=1 - math.exp(-1e-3 / 3e-3), fluid_step=1 - math.exp(-1e-3 / 12e-3))
    s, pose = new_records(SplitStateRecord)[0], posed(np.eye(2))
    seen, ahead = [], []
    for _ in range(60):
        expect_brakes(c, s)
        slip(c, s, pose, np.array([1.0, 0.0]), NOTHING, np.array([0.5, 0.0]), NOTHING, NOTHING)
        seen.append(float(s["expected_Nm"][0]))
        ahead.append(float(s["ahead_Nm"][0]))
        assert s["motor_Nm"][0] == pytest.approx(ahead[-1] - 1.0)
    assert s["brake_Nm"][0] == 1.0
    t = (np.arange(60) - 1) * 1e-3  # it is sent in the first cycle, and acts from the second on
    exact = 1 - (12 * np.exp(-t / 12e-3) - 3 * np.exp(-t / 3e-3)) / 9
    assert seen[1:] == pytest.approx(exact[1:], abs=0.01)
    assert ahead[:-2] == pytest.approx(seen[2:])  # the end of the cycle in which the commands act


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("share", [0.0, 0.4, 0.9, 1.0])
def test_at_rest_the_box_of_the_brakes_holds_the_disc(seed, share):
    random = np.random.default_rng(seed)
    jacobian, F_s = arm(*random.uniform(0.1, 0.4, 2), random.uniform(-3, 3), random.uniform(0.4, 2.7)), 3.0
    heading = random.uniform(0, 2 * math.pi)
    hand = share * F_s * np.array([math.cos(heading), math.sin(heading)])
    s = new_records(SplitStateRecord)[0]
    s["expected_Nm"] = s["coil_Nm"] = 0.0
    hold(control(brake=99.0), s, posed(jacobian), F_s, jacobian.T @ hand)
    # every other force of the disc that the hand may come to is held as well, and no motor has a part
    assert (s["motor_Nm"] == 0.0).all()
    for turn in np.linspace(0, 2 * math.pi, 73):
        for part in (0.3, 1.0):
            step = part * (1 - share) * F_s * np.array([math.cos(turn), math.sin(turn)])
            assert (np.abs(jacobian.T @ (hand + step)) <= s["brake_Nm"] + 1e-9).all()


def test_at_the_edge_both_joints_let_go_together():
    jacobian = arm(0.2, 0.3, 0.4, 1.3)
    hand = 3.0 * np.array([math.cos(1.9), math.sin(1.9)])
    for scale, share in ((1.0, 1.0), (1.2, 1 / 1.2)):
        s = new_records(SplitStateRecord)[0]
        c = control(brake=99.0, friction_Nm=[0.05, 0.05])
        hold(c, s, posed(jacobian), 3.0, scale * jacobian.T @ hand)
        assert s["brake_Nm"] + 0.05 == pytest.approx(share * np.abs(scale * jacobian.T @ hand))


def test_a_brake_is_led_to_its_level_at_rest():
    c, s = control(coil_step=0.3, fluid_step=0.08, brake=4.0), new_records(SplitStateRecord)[0]
    s["expected_Nm"], s["coil_Nm"] = 0.5, 0.5
    jacobian = arm(0.2, 0.3, 0.4, 1.3)
    hold(c, s, posed(jacobian), 0.0, np.zeros(2))
    assert (s["brake_Nm"] == 0.0).all()  # it cannot be led below 0
    hold(c, s, posed(jacobian), 3.0, np.zeros(2))
    level = 3.0 * np.hypot(*jacobian)
    assert s["brake_Nm"] == pytest.approx(np.minimum(0.5 + 2 * (3 * (level - 0.5)), 4.0))
