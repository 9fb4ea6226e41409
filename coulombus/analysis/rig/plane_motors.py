"""Motors alone on an arm in the plane: the limit cycle of Coulomb friction at rest, predicted and exact."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from coulombus.analysis.rig.plane_display import rig_mechanism
from coulombus.analysis.theory.plane_orbit import (
    PredictedOrbit,
    SettledOrbit,
    TipLoop,
    predicted_orbit,
    settled_orbit,
)
from coulombus.host.laws.plane.plane_laws import load_plane_law
from coulombus.host.plane.plane_host import PlaneModel, new_plane_host
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.rig.arm_plant import new_plane_plant

__all__ = ["MotorsAlone", "motors_alone"]


@dataclass(frozen=True)
class MotorsAlone:
    """The limit cycle of motors alone in a pose.

    Attributes
    ----------
    q_rad : the pose
    friction_N : level of the friction
    masses_kg : of arm and hand at the tip, along its principal directions, ascending
    direction_rad : of the smaller mass
    predicted : by the describing function, of the free tip
    settled : of the exact sampled loop, with the hand's damping and stiffness
    """

    q_rad: tuple[float, float]
    friction_N: float
    masses_kg: tuple[float, float]
    direction_rad: float
    predicted: PredictedOrbit
    settled: SettledOrbit

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)

    def lines(self) -> list[str]:
        """Return it as text."""
        q1, q2 = (math.degrees(angle) for angle in self.q_rad)
        rows = (("describing function", self.predicted), ("exact loop", self.settled))
        return [
            f"motors alone at {q1:.4g}, {q2:.4g} deg, {self.friction_N:g} N of Coulomb friction, without the joints' own: "
            f"{self.masses_kg[0]:.3g} and {self.masses_kg[1]:.3g} kg at the tip",
            *(
                f"  {name:19s} {orbit.frequency_Hz:5.1f} Hz, {1e3 * orbit.velocity_m_s[0]:.1f} by "
                f"{1e3 * orbit.velocity_m_s[1]:.1f} mm/s"
                for name, orbit in rows
            ),
        ]


def motors_alone(rig: Rig, q_rad: tuple[float, float], friction_N: float = 3.0) -> MotorsAlone:
    """Return the limit cycle of motors alone that display Coulomb friction at rest in a pose.

    The joints' own friction is left out; so are the limits of the motors.

    Raises
    ------
    coulombus.rigs.errors.RigError
        the rig is not an arm of two links with [plane], has no mode active, or the pose is singular
    """
    if "active" not in rig.modes:
        raise RigError([f"{rig.path}: the rig {rig.name} has no mode 'active'; expected motors alone"])
    plant = new_plane_plant(rig)[0]
    kinematics, mechanism = rig_mechanism(rig)
    jacobian = mechanism.pose(*q_rad)["jacobian"].copy()
    if np.linalg.cond(jacobian) > 1e6:
        degrees = ", ".join(f"{math.degrees(angle):g}" for angle in q_rad)
        raise RigError([f"--pose {degrees}: the pose is singular: the tip has no mass along one direction"])
    elbow = kinematics.signs[1] * q_rad[1] + kinematics.offsets_rad[1]
    a1, a2, a3, k = (float(plant[name]) for name in ("a1", "a2", "a3", "k"))
    mixed = a2 + k * math.cos(elbow)
    inertia = np.array([[a1 + 2 * k * math.cos(elbow), mixed], [mixed, a3]]) * np.outer(
        kinematics.signs, kinematics.signs
    )
    inverse = np.linalg.inv(jacobian)
    masses, directions = np.linalg.eigh(inverse.T @ inertia @ inverse)
    model = PlaneModel(load_plane_law("plane_coulomb", [f"F_d_N={friction_N!r}"]), mechanism)
    h = new_plane_host(rig, "active", model)[0]
    turn, period_s = int(h["turn_cycles"]), rig.bus.period_s
    lags = [axis.simulation.plant.motor_lag_s for axis in rig.axes]
    loop = TipLoop(
        period_s,
        friction_N,
        int(h["window_cycles"]),
        max(turn, 1),
        float(h["control"]["lead_s"]) / (turn * period_s) if turn > 0 else 0.0,
        sum(lags) / len(lags),
    )
    pair = (float(masses[0]), float(masses[1]))
    hand = [tuple((directions**2 * np.asarray(plant[name])[:, None]).sum(axis=0)) for name in ("damping", "stiffness")]
    return MotorsAlone(
        q_rad,
        friction_N,
        pair,
        math.atan2(directions[1, 0], directions[0, 0]) % math.pi,
        predicted_orbit(loop, pair),
        settled_orbit(loop, pair, hand[0], hand[1]),
    )
