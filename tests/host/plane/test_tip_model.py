"""The local model of an arm's tip: its force by the motors' and the brakes' part, its bounds, and its energy."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.host.laws.law import LawRecord
from coulombus.host.plane.plane_host_record import PlaneHostRecord
from coulombus.host.plane.plane_step import share_out
from coulombus.host.plane.tip_model import add_tip_model, end_tip_model, follow_tip_model, resist_at_rest, unpaid
from coulombus.host.world.local_model import ACTIVE, HYBRID, PASSIVE
from coulombus.host.world.model_check import PLANE_RANGES, why_not
from coulombus.host.world.model_parts import (
    Model,
    PlaneField,
    PlaneProfile,
    PlaneSpring,
    PlaneWall,
    Spring,
    Wall,
    model_of,
)
from coulombus.host.world.records import LocalModelRecord
from coulombus.kernels.records import new_records
from coulombus.rigs.arguments import WrongCall
from model_cycle import offer
from plain_records import record_for_kernels

MS = 1_000_000
SQUARE = np.array([[-0.2, 0.0], [0.2, 0.2]])
"""Jacobian of two links of 0.2 m: the first along x, the second along y."""
WALL = PlaneWall((0.1, 0.0), (-2.0, 0.0), K_N_m=400.0, B_Ns_m=10.0)


@dataclass
class Cycle:
    """The local model of an arm in a cycle, with a law of constant force."""

    w: Any
    plane: Any
    law: Any
    number: int = 0

    def render(self, model, profile=1):
        """Let the next cycle take a model."""
        self.place(model.record({"B_Ns_m": 4}, profile=profile))

    def place(self, record):
        """Let the next cycle take a record."""
        self.number += 1
        offer(self.w, record, self.number)

    def at(self, x_m, v_m_s=(0.0, 0.0), *, hand_Nm=(0.0, 0.0), psi_N=(0.0, 0.0), push_N=(0.0, 0.0), hold_N=0.0):
        """Run a cycle at a place of the tip; return psi and push [N]."""
        plane = self.plane
        plane.motion.x_m[:], plane.motion.v_m_s[:] = x_m, v_m_s
        plane.v_rad_s[:] = np.linalg.solve(SQUARE, v_m_s)
        plane.hand_Nm[:], plane.psi_N[:], plane.push_N[:], plane.hold_N = hand_Nm, psi_N, push_N, hold_N
        for k in range(len(self.law.user)):
            plane.law.user[k] = self.law.user[k]
        self.unpaid_J = unpaid(self.w, plane)
        follow_tip_model(self.w, plane, self.law)
        add_tip_model(self.w, plane)
        share_out(plane)
        resist_at_rest(self.w, plane)
        return plane.psi_N.tolist(), plane.push_N.tolist()

    @property
    def commands(self):
        """Torques of the motors and levels of the brakes [Nm]."""
        return self.plane.split.motor_Nm.tolist(), self.plane.split.brake_Nm.tolist()


def cycle_of(mode, *, motor_Nm=10.0, brake_Nm=20.0):
    w, law = (record_for_kernels(new_records(kind)[0]) for kind in (LocalModelRecord, LawRecord))
    plane = new_records(PlaneHostRecord)[0]
    w.on, w.mode, w.rest, w.law_share, w.period_ns, w.ramp_step = 1, mode, 1.0, 1.0, MS, 0.25
    plane.gain, plane.mode = 1.0, {ACTIVE: 0, PASSIVE: 1, HYBRID: 2}[mode]
    plane.pose.jacobian[:] = SQUARE
    c = plane.control
    c.brake_limit_Nm[:] = 0.0 if mode == ACTIVE else brake_Nm
    c.motor_limit_Nm[:] = 0.0 if mode == PASSIVE else motor_Nm
    c.coil_step[:] = c.fluid_step[:] = 1.0
    c.period_s, c.passivity_J = 1e-3, 1e9
    return Cycle(w, plane, law)


def test_a_wall_pushes_along_its_normal_and_damps_the_way_in_alone():
    c = cycle_of(HYBRID)
    c.render(Model(wall=WALL))
    for x in (0.09, 0.1):  # on its face the hand is not in it yet
        assert c.at((x, 0.3), (0.5, 0.5)) == ([0.0, 0.0], [0.0, 0.0])
    psi, push = c.at((0.11, 0.3), (0.2, 0.7))
    assert psi == pytest.approx([6.0, 0.0])  # 400 * 0.01 + 10 * 0.2: the hand feels it against x
    assert push == pytest.approx([4.0, 0.0])
    assert c.at((0.11, 0.3), (-9.0, 0.0))[0] == [0.0, 0.0]  # however fast the hand leaves, the wall never pulls


def test_a_spring_pulls_to_its_point_with_its_most_and_a_profile_along_its_direction():
    c = cycle_of(ACTIVE)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0, 0.0, most_N=5.0)))
    assert c.at((0.03, 0.04))[1] == pytest.approx([3.0, 4.0])
    assert c.at((0.3, 0.4))[1] == pytest.approx([3.0, 4.0])
    assert c.at((0.0, 0.0))[1] == [0.0, 0.0]
    c.render(Model(profile=PlaneProfile((2.0, -1.0), (0.0, 3.0), sample_s=0.002)))
    assert [c.at((0.0, 0.0))[1][1] for _ in range(5)] == [-2.0, -2.0, 1.0, 1.0, 0.0]


def test_a_spring_damps_along_the_motion_with_its_most():
    c = cycle_of(HYBRID)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 0.0, B_Ns_m=10.0, most_N=4.0)))
    assert c.at((0.1, 0.1), (0.06, -0.08)) == (pytest.approx([0.6, -0.8]), [0.0, 0.0])
    assert c.at((0.1, 0.1), (0.6, -0.8))[0] == pytest.approx([2.4, -3.2])


def test_a_slanted_wall_damps_within_its_face_alone():
    c = cycle_of(HYBRID)
    c.render(Model(wall=PlaneWall((0.1, 0.3), (-0.6, 0.8), K_N_m=400.0, B_Ns_m=10.0)))
    assert c.at((0.1, 0.31), (0.6, -0.8))[0] == [0.0, 0.0]
    psi, push = c.at((0.1, 0.2), (0.6, -0.8))  # 0.08 m deep, straight in with 1 m/s
    assert push == pytest.approx([0.6 * 32.0, -0.8 * 32.0])
    assert psi == pytest.approx([0.6 * 42.0, -0.8 * 42.0])


def test_a_profile_acts_along_its_direction():
    c = cycle_of(ACTIVE)
    c.render(Model(profile=PlaneProfile((5.0,), (0.6, -0.8))))
    assert c.at((0.0, 0.0))[1] == pytest.approx([-3.0, 4.0])


def test_a_field_damps_by_the_brakes_and_drives_by_the_motors():
    c = cycle_of(HYBRID)
    c.render(Model(field=PlaneField(N=(1.0, 0.0), N_m=((0.0, 2.0), (-2.0, 0.0)), Ns_m=((-3.0, 0.0), (0.0, -3.0)))))
    psi, push = c.at((0.0, 0.5), (0.0, 0.2))
    assert push == pytest.approx([-2.0, 0.0])
    assert psi == pytest.approx([-2.0, 0.6])
    c.render(Model(field=PlaneField(Ns_m=((0.0, -4.0), (4.0, 0.0)))))  # across the motion: no work, and no brake
    psi, push = c.at((0.0, 0.0), (0.5, 0.0))
    assert psi == push == pytest.approx([0.0, -2.0])


def test_each_number_of_a_field_has_its_place():
    c = cycle_of(HYBRID)
    c.render(Model(field=PlaneField((1.0, 2.0), ((3.0, 5.0), (7.0, 11.0)), ((-13.0, 17.0), (19.0, -23.0)))))
    x, v = (0.2, 0.3), (0.5, 0.4)
    still = [1.0 + 0.6 + 1.5, 2.0 + 1.4 + 3.3]
    fx, fy = -13.0 * 0.5 + 17.0 * 0.4, 19.0 * 0.5 - 23.0 * 0.4
    psi, push = c.at(x, v)
    assert psi == pytest.approx([-still[0] - fx, -still[1] - fy])
    assert push == psi  # along the motion it drives
    psi, push = c.at(x, (-0.5, 0.5))
    fx, fy = 13.0 * 0.5 + 17.0 * 0.5, -19.0 * 0.5 - 23.0 * 0.5
    along = (fx * -0.5 + fy * 0.5) / 0.5
    assert along < 0.0
    assert psi == pytest.approx([-still[0] - fx, -still[1] - fy])
    assert push == pytest.approx([psi[0] + along * -0.5, psi[1] + along * 0.5])


@pytest.mark.parametrize(
    ("law", "place", "kept"),
    [
        ((0.0, 0.0), (0.1, 0.0), 0.5),  # 2 Nm on the first joint alone
        ((0.0, 0.0), (-0.1, 0.0), 0.5),
        ((0.0, 0.0), (0.0, 0.1), 0.5),  # and on both
        ((0.0, 0.0), (0.04, -0.1), 1.0 / 2.8),  # 2.8 Nm on the first, 2 Nm on the second
        ((3.0, 0.0), (0.1, 0.0), 0.2),  # the law's 0.6 Nm leave 0.4 Nm
        ((-3.0, 0.0), (0.1, 0.0), 0.2),
        ((0.0, -2.0), (0.0, 0.1), 0.3),
        ((1.0, 3.0), (0.0, 0.1), 0.2),  # 0.4 Nm on the first, 0.6 Nm on the second
        ((0.0, 9.0), (0.0, 0.1), 0.0),  # it leaves nothing
        ((0.0, 9.0), (0.0, 0.0), 1.0),  # and nothing is asked for
        ((0.0, 0.0), (0.0, 0.05), 1.0),  # as much as there is
        ((0.0, 0.0), (0.0, 0.04), 1.0),
    ],
)
@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_the_motors_have_one_share_of_the_models_push_beside_the_laws(law, place, kept, gain):
    c = cycle_of(HYBRID, motor_Nm=gain)
    c.plane.gain = gain
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0)))
    psi, push = c.at(place, psi_N=[gain * n for n in law], push_N=[gain * n for n in law])
    spring_N = [gain * 100.0 * n for n in place]
    assert push == pytest.approx([gain * law_N + kept * n for law_N, n in zip(law, spring_N, strict=True)])
    assert psi == pytest.approx([gain * law_N + n for law_N, n in zip(law, spring_N, strict=True)])
    assert list(c.w.push_N) == pytest.approx([kept * n for n in spring_N])
    assert c.w.clipped == (kept < 1.0)


def test_a_display_without_motors_clips_nothing_and_a_driving_field_counts_as_push():
    c = cycle_of(PASSIVE)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 1e4), law=0.5))
    assert c.at((0.1, 0.1), psi_N=(2.0, 0.0), push_N=(2.0, 4.0))[1] == [1.0, 2.0]
    assert c.w.clipped == 0
    c = cycle_of(HYBRID, motor_Nm=1.0)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0), profile=PlaneProfile((10.0,), (1.0, -1.0))))
    drive = 10.0 / math.sqrt(2.0)
    psi, push = c.at((0.1, 0.05))
    assert psi == pytest.approx([10.0 - drive, 5.0 + drive])
    torques = SQUARE.T @ psi
    assert push == pytest.approx([n / np.abs(torques).max() for n in psi])


@pytest.mark.parametrize("hold_N", [0.5, 2.0])
def test_a_held_joint_that_still_turns_gets_the_rest_of_the_model_too(hold_N):
    c = cycle_of(HYBRID, motor_Nm=0.5)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0)))
    place = (0.02, 0.06)
    c.at(place, (0.001, 0.002), hold_N=hold_N)
    bare = np.array(c.commands[1])
    into = 0.001 * SQUARE.T @ place
    c.at(place, (0.001, 0.002), hold_N=hold_N, hand_Nm=into)
    psi, push = (SQUARE.T @ [getattr(c.w, name)[k] for k in range(2)] for name in ("psi_N", "push_N"))
    assert c.commands[0] == pytest.approx((-push).tolist())
    assert c.commands[1] == pytest.approx((bare + np.abs(psi - push)).tolist(), abs=1e-3)
    c.at(place, (0.001, 0.002), hold_N=hold_N, hand_Nm=-into)
    assert c.commands[1] == pytest.approx(bare.tolist(), abs=1e-3)


def test_a_moving_joint_has_the_splits_level_and_one_at_rest_resists_the_hand():
    c = cycle_of(PASSIVE)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0)))
    c.at((0.02, 0.06), (0.0, 0.2), hand_Nm=(1.0, 1.0))  # the second joint turns, away from the point
    torques = SQUARE.T @ (2.0, 6.0)
    assert c.commands[1] == pytest.approx([torques[0], torques[1]])
    c.at((0.02, 0.06), (0.0, 0.2), hand_Nm=(-1.0, -1.0))
    assert c.commands[1] == pytest.approx([0.0, torques[1]])
    c.at((0.02, 0.06), (0.0, 0.0), hand_Nm=(0.0, 1e-9))
    assert c.commands[1] == pytest.approx([0.0, torques[1]])


def test_the_laws_force_and_hold_have_their_share_and_its_parameters_are_the_models():
    c = cycle_of(HYBRID)
    c.law.user[0] = 1.0
    c.render(Model(law=0.25, parameters={"B_Ns_m": 3.0}, life_s=0.002))
    assert c.at((0.0, 0.0), psi_N=(4.0, 8.0), hold_N=2.0)[0] == [1.0, 2.0]
    assert (c.plane.hold_N, c.plane.law.user[0]) == (0.5, 3.0)
    for _ in range(2):
        c.at((0.0, 0.0))
    assert c.plane.law.user[0] == 2.5  # it fades
    for _ in range(5):
        c.at((0.0, 0.0), psi_N=(4.0, 8.0))
    assert (c.w.share, c.plane.psi_N.tolist(), c.plane.law.user[0]) == (0.0, [4.0, 8.0], 1.0)


def test_a_force_that_is_too_large_for_a_motor_keeps_its_direction():
    c = cycle_of(HYBRID, motor_Nm=0.5)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0)))
    psi, push = c.at((0.06, 0.08))
    assert psi == pytest.approx([6.0, 8.0])
    assert push == pytest.approx([0.6 * math.hypot(*push), 0.8 * math.hypot(*push)])
    assert np.abs(SQUARE.T @ push).max() == pytest.approx(0.5)
    assert c.w.clipped == 1


def test_at_rest_brakes_resist_where_the_hand_pushes_and_hold_as_much_more():
    c = cycle_of(PASSIVE)
    c.render(Model(wall=PlaneWall((0.0, 0.1), (0.0, -1.0), K_N_m=1000.0)))
    into = SQUARE.T @ (0.0, 5.0)
    c.at((0.0, 0.105), hand_Nm=into)
    assert c.commands == ([0.0, 0.0], pytest.approx([1.0, 1.0]))  # 5 N at 0.2 m
    c.at((0.0, 0.105), hand_Nm=-into)
    assert c.commands[1] == [0.0, 0.0]  # the wall never pulls
    c.at((0.0, 0.105), hand_Nm=0.2 * into, hold_N=2.0)
    held = c.commands[1]
    c.at((0.0, 0.0), hand_Nm=0.2 * into, hold_N=2.0)
    assert held == pytest.approx((np.array(c.commands[1]) + 1.0).tolist())


def test_motors_push_while_the_brakes_hold():
    c = cycle_of(HYBRID)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0)))
    c.at((0.02, 0.0), hold_N=3.0)
    assert c.commands[0] == pytest.approx((-SQUARE.T @ (2.0, 0.0)).tolist())
    assert min(c.commands[1]) > 0.0


def test_a_part_that_the_model_does_not_name_does_nothing():
    c = cycle_of(ACTIVE)
    c.law.user[0] = 1.0
    everything = Model(
        wall=PlaneWall((0.0, 0.0), (-1.0, 0.0), 100.0, 10.0),
        spring=PlaneSpring((0.5, 0.5), 100.0, 10.0),
        field=PlaneField((1.0, 1.0), ((1.0, 2.0), (3.0, 4.0)), ((1.0, 2.0), (3.0, 4.0))),
        profile=PlaneProfile((1.0,), (1.0, 0.0)),
        parameters={"B_Ns_m": 3.0},
    ).record({"B_Ns_m": 4})
    everything["parts"] = 32
    c.place(everything)
    assert c.at((0.1, 0.2), (0.3, 0.4)) == ([0.0, 0.0], [0.0, 0.0])
    assert (c.w.most_J, c.plane.law.user[0]) == (0.0, 1.0)


def test_what_the_parts_can_return_is_their_force_over_the_way_to_their_rest():
    c = cycle_of(ACTIVE)
    c.render(Model(wall=PlaneWall((0.1, 0.3), (-0.6, 0.8), K_N_m=400.0)))
    c.at((0.1, 0.2))  # 0.08 m deep
    assert c.w.most_J == pytest.approx(400.0 * 0.08**2)
    c.render(Model(spring=PlaneSpring((0.1, 0.2), 100.0, most_N=2.0)))
    c.at((0.13, 0.24))
    assert c.w.most_J == pytest.approx(2.0 * 0.05)
    c.at((0.1, 0.2))
    field = Model(field=PlaneField((1.0, 2.0), ((3.0, 4.0), (5.0, 6.0))))
    c.render(field)
    c.at((0.2, 0.1))
    assert c.w.most_J == 0.0  # it begins here
    c.render(field)
    c.at((0.5, 0.5))
    force = math.hypot(1.0 + 1.5 + 2.0, 2.0 + 2.5 + 3.0)
    assert c.w.most_J == pytest.approx(force * 0.5)
    c.render(Model(wall=WALL))
    c.render(field)  # another begin
    c.at((0.5, 0.5))
    c.render(Model())
    c.at((0.5, 0.5))
    c.render(field)
    c.at((0.4, 0.5))
    assert c.w.most_J == 0.0


def test_what_is_given_beyond_what_was_stored_is_unpaid():
    c = cycle_of(ACTIVE)
    c.render(Model(spring=PlaneSpring((0.0, 0.0), 100.0), life_s=1.0))
    c.at((0.03, 0.04))
    assert (c.unpaid_J, c.w.stored_J) == (0.0, 0.0)
    c.at((0.06, 0.08))  # 5 N over 0.05 m
    assert (c.unpaid_J, c.w.stored_J) == (0.0, pytest.approx(0.25))
    c.at((0.06, 0.06))  # 8 N over 0.02 m back
    assert (c.unpaid_J, c.w.stored_J) == (0.0, pytest.approx(0.09))
    c.at((0.03, 0.06))  # 6 N over 0.03 m back
    assert (c.unpaid_J, c.w.stored_J) == (pytest.approx(0.09), 0.0)
    c.render(Model(spring=PlaneSpring((0.03, 0.06), 1.0), life_s=1.0))
    c.at((0.06, 0.06))  # 3 N over 0.03 m; the new spring returns less
    assert c.w.stored_J == pytest.approx(0.09)
    c.at((0.06, 0.06))
    assert c.w.stored_J == pytest.approx(0.03 * 0.03)


def test_motors_alone_damp_too_and_at_the_end_nothing_is_left():
    c = cycle_of(ACTIVE)
    c.render(Model(wall=WALL))
    psi, push = c.at((0.11, 0.0), (0.1, 0.1))
    assert c.commands[0] == pytest.approx((-SQUARE.T @ psi).tolist())
    assert psi != push
    c.w.elastic_N[1] = c.w.push_N[1] = c.w.psi_N[1] = 1.0
    end_tip_model(c.w)
    assert [*c.w.psi_N, *c.w.push_N, *c.w.elastic_N] == [0.0] * 6


def energy_of(c, places):
    return sum(c.at(place) and c.unpaid_J for place in places)


CIRCLE = [(0.05 * math.cos(a), 0.05 * math.sin(a)) for a in np.linspace(0.0, 2.0 * math.pi, 800)]


def test_a_still_spring_gives_back_what_it_took_and_a_field_with_curl_gives_more():
    c = cycle_of(ACTIVE)
    c.render(Model(spring=PlaneSpring((0.05, 0.0), 100.0), life_s=10.0))
    assert energy_of(c, CIRCLE) < 0.01
    c = cycle_of(ACTIVE)
    curl = PlaneField(N_m=((0.0, -100.0), (100.0, 0.0)))  # along the circle: 5 N at 0.05 m
    c.render(Model(field=curl, life_s=10.0))
    assert energy_of(c, CIRCLE) == pytest.approx(2 * math.pi * 0.05 * 5.0, rel=0.02)


def test_a_spring_that_a_program_moves_gives_what_the_hand_has_not_put_in():
    c = cycle_of(ACTIVE)
    given_J = 0.0
    for k in range(100):  # ahead of the tip by 1 cm: 2 N over 10 cm
        c.render(Model(spring=PlaneSpring((0.001 * k + 0.01, 0.0), 200.0)))
        c.at((0.001 * k, 0.0))
        given_J += c.unpaid_J
    assert given_J == pytest.approx(0.2, rel=0.1)


def rotated(vector, angle_rad):
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return (c * vector[0] - s * vector[1], s * vector[0] + c * vector[1])


vectors = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


@settings(derandomize=True, max_examples=60, deadline=None)
@given(angle=st.floats(-3, 3), x=vectors, v=vectors, normal=st.floats(-3, 3), K=st.floats(0, 500), B=st.floats(0, 50))
def test_wall_and_spring_turn_with_the_plane(angle, x, v, normal, K, B):
    def psi(turn):
        c = cycle_of(ACTIVE, motor_Nm=1e9)
        wall = PlaneWall(rotated((0.1, 0.2), turn), rotated((math.cos(normal), math.sin(normal)), turn), K, B)
        c.render(Model(wall=wall, spring=PlaneSpring(rotated((-0.3, 0.1), turn), K, B, most_N=20.0)))
        return c.at(rotated(x, turn), rotated(v, turn))[0]

    assert psi(angle) == pytest.approx(rotated(psi(0.0), angle), abs=1e-6)


numbers = {name: st.lists(st.floats(low, high), min_size=4, max_size=4) for name, (low, high) in PLANE_RANGES.items()}


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    mode=st.sampled_from([PASSIVE, HYBRID, ACTIVE]),
    values=st.fixed_dictionaries(numbers),
    parts=st.integers(0, 15),
    samples=st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 4),
    path=st.lists(st.tuples(vectors, vectors, vectors, st.sampled_from([0.0, 3.0])), min_size=1, max_size=8),
)
def test_no_plausible_model_exceeds_a_limit(mode, values, parts, samples, path):
    c = cycle_of(mode, motor_Nm=1.5, brake_Nm=4.0)
    record = Model(life_s=0.005, field=PlaneField()).record({})
    for name, four in values.items():
        record[name] = four[0] if np.ndim(record[name]) == 0 else four[: len(record[name])]
    record["plane_wall_normal"], record["profile_direction"] = (0.6, -0.8), (0.0, 1.0)
    record["parts"] = parts | 32
    record["samples"], record["sample_ns"], record["profile"] = 4, 1_500_000, 1
    record["sample"][:4] = samples
    assert why_not(record, 2, 10**9, arm=True) is None
    c.place(record)
    for x, v, hand, hold_N in path:
        c.at(x, v, hand_Nm=hand, hold_N=hold_N)
        motor, brake = c.commands
        assert np.isfinite(motor).all()
        assert np.abs(motor).max() <= (0.0 if mode == PASSIVE else 1.5 + 1e-12)
        assert min(brake) >= 0.0
        assert max(brake) <= (0.0 if mode == ACTIVE else 4.0)


@pytest.mark.parametrize("name", PLANE_RANGES)
def test_a_number_that_is_none_or_out_of_its_range_is_refused_by_its_name(name):
    low, high = PLANE_RANGES[name]
    for value in (math.nan, math.inf, math.nextafter(high, math.inf), math.nextafter(low, -math.inf)):
        record = Model(wall=WALL, profile=PlaneProfile((1.0,), (1.0, 0.0))).record({})
        record[name] = value
        assert why_not(record, 2, 10**9, arm=True).startswith(f"{name} is ")


def test_a_model_of_another_kind_of_rig_is_refused_with_the_kind():
    of_plane, of_axis = Model(wall=WALL).record({}), Model(wall=Wall(0.0, 1.0)).record({})
    assert why_not(of_plane, 2, 10**9) == "the rig is of single axes: expected parts of one axis"
    assert why_not(of_axis, 2, 10**9, arm=True) == "the rig is an arm in the plane: expected parts in the plane"
    of_plane["axis"] = 1
    assert why_not(of_plane, 2, 10**9, arm=True) == "axis is 1: expected from 0 to 0"
    of_plane["axis"], of_plane["plane_wall_normal"] = 0, (0.5, 0.0)
    assert why_not(of_plane, 2, 10**9, arm=True) == "plane_wall_normal is [0.5, 0.0]: expected a vector of length 1"
    assert why_not(Model(parameters={"B_Ns_m": 1.0}).record({"B_Ns_m": 4}), 2, 10**9, arm=True) is None


@pytest.mark.parametrize(
    "call",
    [
        lambda: PlaneWall((0.0, 0.0), (0.0, 0.0), 1.0),
        lambda: PlaneWall((0.0,), (1.0, 0.0), 1.0),
        lambda: PlaneWall((0.0, math.nan), (1.0, 0.0), 1.0),
        lambda: PlaneWall((0.0, 0.0), "up", 1.0),
        lambda: PlaneWall((0.0, 0.0), (1.0, 0.0), -1.0),
        lambda: PlaneSpring(0.0, 1.0),
        lambda: PlaneSpring((0.0, 0.0), 1.0, most_N=math.inf),
        lambda: PlaneField(N_m=(1.0, 0.0)),
        lambda: PlaneProfile((), (1.0, 0.0)),
        lambda: PlaneProfile((1.0,), (1.0, 0.0), sample_s=2.0),
        lambda: Model(wall=WALL, spring=Spring(0.0, 1.0)),
        lambda: model_of((WALL, WALL)),
    ],
)
def test_a_wrong_part_is_refused_where_it_is_made(call):
    with pytest.raises(WrongCall):
        call()


STIFF = [
    Model(law=0.0, wall=WALL),
    Model(law=0.0, spring=PlaneSpring((0.0, 0.1), 400.0, 10.0)),
    Model(law=0.0, field=PlaneField((1.0, 2.0), ((-30.0, 4.0), (4.0, -20.0)), ((-3.0, 0.0), (0.0, -3.0)))),
]


def softened_at(model, x_m, v_m_s, softened):
    c = cycle_of(ACTIVE, motor_Nm=1e4)
    c.render(model)
    c.at((0.0, 0.0))
    c.w.softened = softened
    return np.array(c.at(x_m, v_m_s)[0])


@pytest.mark.parametrize("model", STIFF)
def test_a_softened_model_has_less_stiffness_and_damping(model):
    whole = softened_at(model, (0.15, 0.05), (0.2, -0.1), 0.0)
    assert np.abs(whole).max() > 1.0
    assert softened_at(model, (0.15, 0.05), (0.2, -0.1), 0.75) == pytest.approx(0.25 * whole)


def test_a_constant_force_is_no_stiffness():
    constant = Model(law=0.0, field=PlaneField((1.0, 2.0)))
    assert softened_at(constant, (0.0, 0.0), (0.0, 0.0), 0.5).tolist() == [-1.0, -2.0]
    ones = Model(law=0.0, field=PlaneField((1.0, 2.0), ((1.0, 0.0), (0.0, 0.0))))
    assert softened_at(ones, (0.0, 0.0), (0.0, 0.0), 0.5).tolist() == [-0.5, -1.0]


def test_a_model_acts_where_the_tip_will_be():
    for axis in range(2):
        c = cycle_of(ACTIVE, motor_Nm=1e4)
        c.w.ahead_s = 0.5
        c.render(Model(law=0.0, spring=PlaneSpring((0.0, 0.0), 100.0)))
        v_m_s = [0.0, 0.0]
        v_m_s[axis] = 0.2
        assert c.at((0.01, 0.02), v_m_s)[0] == pytest.approx([1.0 + 10.0 * (axis == 0), 2.0 + 10.0 * (axis == 1)])
        assert list(c.w.elastic_N) == pytest.approx([1.0, 2.0])  # the account has the place where it is


def test_what_the_model_asks_of_the_motors_is_kept_until_a_joint_turns():
    c = cycle_of(ACTIVE, motor_Nm=1.0)
    c.render(Model(law=0.0, spring=PlaneSpring((0.0, 0.0), 100.0)))
    for x, demand in ((0.01, 1.0), (0.2, 4.0), (0.1, 4.0), (0.25, 5.0)):
        c.at((0.0, x))
        assert c.w.demand == pytest.approx(demand)
    none = cycle_of(PASSIVE)
    none.render(Model(law=0.0, spring=PlaneSpring((0.0, 0.0), 100.0)))
    none.at((0.0, 0.1))
    assert none.w.demand == 0.0


@pytest.mark.parametrize(
    ("x_m", "comes"),
    [((0.0, 0.0), True), ((0.1, 0.0), False), ((0.0, 0.1), False), ((0.01, 0.0), False), ((0.0, 0.01), False)],
)
def test_the_stiffness_comes_back_where_the_model_exerts_nothing(x_m, comes):
    c = cycle_of(ACTIVE)
    c.render(Model(law=0.0, spring=PlaneSpring((0.0, 0.0), 100.0)))
    c.at(x_m)
    c.w.softened, c.w.swing_ns = 0.5, 90_000_000
    c.at(x_m)
    assert (c.w.softened < 0.5) == comes


def test_what_drives_the_tip_is_no_stiffness():
    c = cycle_of(ACTIVE, motor_Nm=1.0)
    drive = PlaneField((2.0, 1.0), Ns_m=((1.0, 0.0), (0.0, 1.0)))
    c.render(Model(law=0.0, spring=PlaneSpring((0.0, 0.0), 100.0), field=drive))
    c.at((0.0, 0.0), (0.5, 0.0))
    assert list(c.w.driven_N) == pytest.approx([-2.5, -1.0])
    c.at((0.2, 0.0), (0.5, 0.0))
    kept = c.w.push_N[0] / (20.0 - 2.5)
    assert kept < 0.9
    assert list(c.w.driven_N) == pytest.approx([-2.5 * kept, -1.0 * kept])
    c.render(Model(law=0.0, field=PlaneField((2.0, 1.0), ((-1.0, 0.0), (0.0, 0.0)))))
    c.at((0.0, 0.0))
    assert list(c.w.driven_N) == [0.0, 0.0]
    spring = Model(law=0.0, spring=PlaneSpring((0.0, 0.0), 100.0)).record({})
    spring["plane_field_N"] = 3.0, 4.0  # of a part that the model does not have
    c.place(spring)
    c.at((0.0, 0.0))
    assert list(c.w.driven_N) == [0.0, 0.0]
