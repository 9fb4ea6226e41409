r"""The plants of two axes as the joints of one arm in the plane (`sim_bus.rig.plane_plant`).

Motor, coil, fluid, own friction, encoder and transducer of a joint are those of its axis' plant
(`sim_bus.rig.plant`); links and hand couple them. A joint's angle counts from the start, in its own sense:

.. math:: \\alpha_i = o_i + s_i (q_{0,i} + x_i), \\qquad \\tau_{\\alpha,i} = s_i \\tau_i

The hand's force on the tip is its muscles', linear between the knots, and that of its stiffness and
damping at the tip.

    plants : the `PlantRecord` of both axes        s : the `PlanePlantRecord` of the first
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Floats, RecordArray, new_records
from coulombus.rigs.errors import RigError
from coulombus.rigs.kinematics.kinematics_rules import SIMULATED
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.rig.plane_hand import drawn_hand
from coulombus.sim_bus.rig.plane_plant import kinetic_J, step_plane, tip_force
from coulombus.sim_bus.rig.plant import (
    TRUTH_COLUMNS,
    coil_target,
    drive_train,
    heat_coil,
    keep_truth,
    motor_target,
    settled,
)
from coulombus.sim_bus.rig.records import PlanePlantRecord, PlantRecord

__all__ = ["PLANE_COLUMNS", "advance_joints", "new_plane_plant"]

PLANE_COLUMNS = ("tip_x_m", "tip_y_m", "tip_vx_m_s", "tip_vy_m_s", "shown_x_N", "shown_y_N", "hand_x_N", "hand_y_N")
"""Further columns of the true course of a joint: the tip, the force that motors, brakes and friction show to the
hand, and the hand's force. The kinetic energy of arm and hand together is in the first joint's course.
"""
PLAIN, KINETIC = len(TRUTH_COLUMNS), TRUTH_COLUMNS.index("kinetic_energy_J")


@kernel
def _keep(plants: RecordArray[PlantRecord], truth: Floats, row: int) -> None:
    """Write a row of both joints' true courses."""
    s = plants[0].plane
    tip_force(s)
    for i in range(2):
        out = truth[i, row]
        keep_truth(plants[i], out)
        out[KINETIC] = kinetic_J(s, s.v[0], s.v[1], math.cos(s.angle[1])) if i == 0 else 0.0
        for k in range(2):
            out[PLAIN + k], out[PLAIN + 2 + k] = s.tip_m[k], s.tip_m_s[k]
            out[PLAIN + 4 + k], out[PLAIN + 6 + k] = s.shown_N[k], s.hand_N[k]


@kernel
def _write_joints(plants: RecordArray[PlantRecord]) -> None:
    """Give the arm's state at a step's end to the joints' plants."""
    s = plants[0].plane
    for i in range(2):
        p, sign = plants[i], s.sign[i]
        p.x = sign * (s.angle[i] - s.offset_rad[i]) - s.start_rad[i]
        p.v = sign * s.v[i]
        p.f_operator, p.f_motor = sign * s.transduced_Nm[i], sign * s.motor[i]
        p.f_brake, p.f_friction = sign * s.brake_Nm[i], sign * s.friction_Nm[i]
        p.w_operator, p.w_motor = s.work_hand[i], s.work_motor[i]
        p.w_brake, p.w_friction, p.w_viscous = s.work_brake[i], s.work_friction[i], s.work_viscous[i]
        if p.transducer_decay > 0.0:
            p.transduced = p.f_operator + (p.transduced - p.f_operator) * p.transducer_decay
        p.t_ns += p.step_ns


@kernel
def advance_joints(
    plants: RecordArray[PlantRecord], f_h: Floats, per_knot: int, first: int, steps: int, truth: Floats, row: int
) -> None:
    """Advance both joints, like `sim_bus.rig.plant.advance` one plant.

    Parameters
    ----------
    f_h : shape (2, knots), the muscles' force on the tip along x and y [N]
    truth : shape (2, rows, columns): both joints' courses
    """
    s = plants[0].plane
    for i in range(2):
        s.motor_want[i], s.brake_want[i] = motor_target(plants[i]), coil_target(plants[i])
        s.coil_square[i] = 0.0
    knot = first // per_knot
    within = first - knot * per_knot
    for k in range(steps):
        if within == per_knot:
            within = 0
            knot += 1
        for i in range(2):
            p = plants[i]
            remembers = p.remanence > 0.0 or s.brake_want[i] < 0.0 or p.coil < 0.0
            torque, capacity = drive_train(p, s.motor_want[i], s.brake_want[i], remembers)
            s.coil_square[i] += p.coil * p.coil
            s.motor[i] = s.sign[i] * torque
            s.inherent[i] = p.inherent
            s.level[i] = capacity + p.inherent
            s.push_N[i] = f_h[i, knot] + (f_h[i, knot + 1] - f_h[i, knot]) / per_knot * (within + 0.5)
        step_plane(s)
        _write_joints(plants)
        within += 1
        if row >= 0:
            _keep(plants, truth, row + k)
    for i in range(2):
        p = plants[i]
        p.motor, p.coil, p.fluid = settled(p.motor), settled(p.coil), settled(p.fluid)
        if p.K_A2 > 0.0 and steps > 0:
            heat_coil(p, steps * p.h, s.coil_square[i] / steps)


def new_plane_plant(rig: Rig, seed: int = 0) -> RecordArray[PlanePlantRecord]:
    """Return links and hand of a rig at rest at its start, as an array of one record; `seed` draws the hand.

    Raises
    ------
    RigError
        the rig has no [plane], no [plant], a detailed plant, or another mechanism than two links in series
    """
    truth = None if rig.in_plane is None else rig.in_plane.plane
    if rig.in_plane is None or truth is None or rig.in_plane.kinematics.kind.strip() != SIMULATED:
        raise RigError(
            [
                f'{rig.path}: the rig {rig.name} has no [plane] with kinematics.kind = "{SIMULATED}": '
                "two links in series are the only mechanism that is simulated"
            ]
        )
    kinematics = rig.in_plane.true_kinematics
    joints = [axis.simulation.plant for axis in rig.axes]
    for axis, joint in zip(rig.axes, joints, strict=True):
        if joint.in_detail:
            raise axis.mistake("plant", "no [plant.X]: a joint of [plane] is one rigid body")
        if joint.step_s != joints[0].step_s:
            raise axis.mistake("plant.step_s", f"the other joint's, {joints[0].step_s:g}: they are one arm")
    hand = drawn_hand(truth, seed)
    record = new_records(PlanePlantRecord)
    s = record[0]
    (m1, m2), (c1, c2), (i1, i2) = truth.link_mass_kg, truth.link_centre_m, truth.link_inertia_kg_m2
    l1, l2 = kinematics.l1_m or 0.0, kinematics.l2_m or 0.0
    s["on"], s["h"], s["l1"], s["l2"] = 1, joints[0].step_s, l1, l2
    s["a2"] = i2 + m2 * c2**2 + hand.hand_mass_kg * l2**2
    s["a3"] = s["a2"] + joints[1].inertia_kg_m2
    s["a1"] = s["a2"] + i1 + m1 * c1**2 + (m2 + hand.hand_mass_kg) * l1**2 + joints[0].inertia_kg_m2
    s["k"] = l1 * (m2 * c2 + hand.hand_mass_kg * l2)
    s["viscous"] = [joint.viscous_Nms_rad for joint in joints]
    s["stiffness"], s["damping"] = hand.hand_stiffness_N_m, hand.hand_damping_Ns_m
    s["hand_kg"] = hand.hand_mass_kg
    s["offset_rad"], s["sign"], s["start_rad"] = kinematics.offsets_rad, kinematics.signs, kinematics.start_rad
    s["angle"] = s["offset_rad"] + s["sign"] * s["start_rad"]
    tip_force(s)
    s["goal_m"] = s["tip_m"]
    return record
