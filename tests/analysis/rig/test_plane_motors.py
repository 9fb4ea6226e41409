"""The limit cycle of motors alone in the plane: prediction and exact loop against the rig through its PDOs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.analysis.rig.plane_motors import motors_alone
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import RigError, load_rig

NO_FRICTION = (
    *("plant.coulomb_Nm=0", "plant.brake_off_state_Nm=0", "mechanics.friction_Nm=0"),
    *("plant.viscous_Nms_rad=0", "mechanics.viscous_Nms_rad=0"),
)
REST = 'phase=[{kind="rest", duration_s=0.6}, {kind="tip_hold", duration_s=3.4, push_F_s=0.0, frequency_Hz=1.0, taps_s=[0.3], tap_N=2.0}]'


def through_pdos(rig, direction_rad):
    """Return frequency and velocities along the principal directions of the simulated arm's last 1.5 s."""
    worlds = []
    simulate(rig, "active", 4.0, script=worlds.append, measured=True)
    course = worlds[0].tip_course()
    v = np.stack([course["tip_vx_m_s"], course["tip_vy_m_s"]], axis=1)
    t_s = course["t_s"] - worlds[0].enabled_ns * 1e-9
    v = v[(t_s > 2.4) & (t_s < 3.9)]
    v = v - v.mean(axis=0)
    spectrum = (np.abs(np.fft.rfft(v * np.hanning(len(v))[:, None], n=1 << 15, axis=0)) ** 2).sum(axis=1)
    frequency = float(np.argmax(spectrum)) / ((1 << 15) * float(np.diff(t_s[:2])[0]))
    unit = np.array(
        [[math.cos(direction_rad), -math.sin(direction_rad)], [math.sin(direction_rad), math.cos(direction_rad)]]
    )
    return frequency, np.sqrt(2 * ((v @ unit) ** 2).mean(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("elbow_deg", "hand_kg", "hand", "tolerances"),
    [
        (110, 0.3, (), (0.15, 0.06)),
        (130, 1.5, (), (0.10, 0.08)),
        (90, 0.6, ("plane.hand_damping_Ns_m=[4, 4]", "plane.hand_stiffness_N_m=[100, 100]"), (0.08, 0.06)),
    ],
)
def test_the_prediction_is_what_the_rig_does(elbow_deg, hand_kg, hand, tolerances):
    q = (-math.radians(elbow_deg) / 2, math.radians(elbow_deg))
    rig = load_rig("plane", (f"kinematics.start_rad=[{q[0]}, {q[1]}]", f"plane.hand_mass_kg={hand_kg}", *NO_FRICTION,
                             "law.function=plane_coulomb", "law.plane_coulomb.F_d_N=3.0", REST, *hand))  # fmt: skip
    found = motors_alone(rig, q)
    frequency, velocity = through_pdos(rig, found.direction_rad)
    for orbit, tolerance in zip((found.predicted, found.settled), tolerances, strict=True):
        assert frequency == pytest.approx(orbit.frequency_Hz, rel=tolerance)
        assert np.hypot(*velocity) == pytest.approx(math.hypot(*orbit.velocity_m_s), rel=2 * tolerance)
    assert velocity[0] > 1.5 * velocity[1]  # the lighter direction moves more


def test_a_rig_that_has_no_motors_alone_is_refused():
    with pytest.raises(RigError, match="singular"):
        motors_alone(load_rig("plane"), (0.3, 0.0))
    with pytest.raises(RigError, match="serial_2r"):
        motors_alone(load_rig("bench"), (0.0, 1.0))


def test_the_masses_are_those_of_the_kinetic_energy():
    rig = load_rig("plane", ("plane.link_mass_kg=[1e-6, 1e-6]", "plane.link_inertia_kg_m2=[1e-9, 1e-9]",
                             "plant.inertia_kg_m2=1e-9", "plane.hand_mass_kg=0.8"))  # fmt: skip
    assert motors_alone(rig, (0.2, 1.7)).masses_kg == pytest.approx((0.8, 0.8), rel=1e-3)
