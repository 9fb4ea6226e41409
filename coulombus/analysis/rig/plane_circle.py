"""A circle with Coulomb friction in the plane, without a bus: display errors of hybrid, passive and active."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.plane.plane_laws import load_plane_law
from coulombus.host.plane.plane_host import PLANE_MODES
from coulombus.lab.plane_loop import PlaneRun, circle, simulate_plane
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.rig.arm_plant import new_plane_plant

__all__ = ["CircleStudy", "circle_goals", "circle_study"]

RADIUS_m = 0.05
BAND_m_s = 0.008
"""Speed below which the law treats the tip as stuck."""
LAPS, PERIOD_s = 2.5, 1e-3


@dataclass(frozen=True)
class CircleStudy:
    """Displayed friction on a circle about the rig's start.

    Attributes
    ----------
    frequency_Hz, friction_N : of the circle, and desired
    errors : by mode, from `PlaneCourse.display_errors`, and the motors' net work [J]
    """

    frequency_Hz: float
    friction_N: float
    errors: dict[str, dict[str, float]]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"frequency_Hz": self.frequency_Hz, "friction_N": self.friction_N, "modes": self.errors}

    def lines(self) -> list[str]:
        """Return it as text."""
        text = [
            f"circle of {100 * RADIUS_m:g} cm about the start, {self.frequency_Hz:g} Hz, {self.friction_N:g} N wanted "
            "(no bus); median and 95th percentile:"
        ]
        for mode, row in self.errors.items():
            text.append(
                f"  {mode:8s} {row['median_deg']:5.1f} deg ({row['p95_deg']:.1f}), {row['median_N']:.2f} N "
                f"({row['p95_N']:.2f}), net work of the motors {row['motor_work_J']:.3f} J"
            )
        return text


def circle_goals(centre_m: npt.NDArray[np.float64], frequency_Hz: float) -> npt.NDArray[np.float64]:
    """Return the hand's goals: a second from the centre to the circle's rightmost point, then its laps [m]."""
    share = np.linspace(0.0, 1.0, round(1.0 / PERIOD_s) + 1)[:-1, None]
    way = centre_m + np.hstack((RADIUS_m * share**2 * (3 - 2 * share), 0.0 * share))
    laps = circle((float(centre_m[0]), float(centre_m[1])), RADIUS_m, frequency_Hz, LAPS / frequency_Hz, PERIOD_s)
    return np.vstack((way, laps))


def circle_study(rig: Rig, frequency_Hz: float, friction_N: float = 3.0) -> CircleStudy:
    """Simulate the circle in each mode of the rig, with static friction 10 % above dynamic friction.

    The errors count after half a lap, while the tip is faster than 0.05 m/s.

    Raises
    ------
    coulombus.rigs.errors.RigError
        the rig is not an arm of two links with [plane]
    """
    centre = new_plane_plant(rig)[0]["tip_m"].copy()
    goals = circle_goals(centre, frequency_Hz)
    law = load_plane_law(
        "plane_karnopp", [f"F_d_N={friction_N!r}", f"F_s_N={1.1 * friction_N!r}", f"band_m_s={BAND_m_s}"]
    )
    errors = {}
    for mode in (name for name in reversed(PLANE_MODES) if name in rig.modes):
        course = simulate_plane(rig, goals, PlaneRun(mode, law, PERIOD_s))
        errors[mode] = course.display_errors(from_s=1.0 + 0.5 / frequency_Hz)
        errors[mode]["motor_work_J"] = float(course.plant[0]["work_motor"].sum())
    return CircleStudy(frequency_Hz, friction_N, errors)
