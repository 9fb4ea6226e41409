r"""A law's curve over the velocity: its torque at a steady speed, with the present parameters.

At each speed :math:`v` the law is evaluated with the cycle's period from its relaxed state, over
`FAR_RAD`, for at least `LEAST_S` and at most `MOST_S`. The curve is the mean of the last tenth. A law has
no curve if its torque varies in that tenth, or differs far away: then it depends on the position, and not
on the speed alone.

A law in the plane has a ring: its force at a steady speed, over the directions of motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.parameter_changes import parameters_of
from coulombus.host.cycle.records import Slot
from coulombus.host.laws.along import drive
from coulombus.host.laws.plane.plane_laws import PlaneLaw
from coulombus.host.plane.plane_host import load_plane
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["DIRECTIONS", "SPEEDS", "Line", "law_curve", "law_ring"]

SPEEDS = tuple(float(speed) for speed in np.geomspace(5e-4, 1.0, 18))
"""The speeds of the curve, as shares of `limits.speed_rad_s`."""
FAR_RAD, AWAY_RAD = 0.3, 1000.0
LEAST_S, MOST_S = 1.0, 15.0
SAME = 0.02
"""Largest variation of a law with a curve or a ring, as a share of its largest torque or force."""
FIELDS = {Slot.K_P: "K_p", Slot.F_S: "F_s", Slot.F_D: "F_d"}
DIRECTIONS = 72
SPEED_M_S, FASTER_M_S = 0.05, 0.2
SECONDS, STEP_S = 0.4, 2e-3
AWAY_M = (0.37, -0.23)
"""Another place of the plane: a law that differs there depends on the position."""

Line: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]]
"""Ascending velocities [rad/s], and the friction at each [Nm]."""


def law_curve(axis: Axis, mode: str, live: Mapping[str, float]) -> Line | None:
    """Return the torque of an axis' law in a mode at steady speeds of both signs; None for a law without
    a curve, and for a joint, whose share depends on the other.

    Parameters
    ----------
    live : values of live parameters by name; others have the rig file's values

    Raises
    ------
    coulombus.rigs.rig.RigError
        the law cannot be loaded
    coulombus.host.laws.laws.LawError
        the law returned a number that is not finite
    """
    if axis.joint:
        return None
    controller = Controller(axis, mode)
    law, law_name = controller.law.copy(), axis.law.function
    for parameter in parameters_of(controller):
        value = live.get(parameter.name, parameter.value) * parameter.scale
        if parameter.slot in FIELDS:
            law[FIELDS[Slot(parameter.slot)]] = value
        elif parameter.slot >= Slot.USER:
            law["user"][0, parameter.slot - Slot.USER] = value
    count_rad, period_s = float(controller.control["rad_count"][0]), axis.bus.period_s

    def last(v: float, from_rad: float = 0.0) -> npt.NDArray[np.float64]:
        seconds = min(max(LEAST_S, FAR_RAD / abs(v)), MOST_S)
        t_s = np.arange(round(seconds / period_s) + 1) * period_s
        samples = drive(law_name, controller.law_function, law, t_s, from_rad + v * t_s, abs(count_rad)).samples
        end: npt.NDArray[np.float64] = samples["torque_Nm"][-(len(t_s) // 10) :]
        return end

    far = axis.limits.speed_rad_s
    speeds = [*(-far * share for share in SPEEDS[::-1]), *(far * share for share in SPEEDS)]
    ends = [last(v) for v in speeds]
    means = [float(torques.mean()) for torques in ends]
    negligible_Nm = SAME * max(map(abs, means))
    middle = len(SPEEDS) // 2
    elsewhere = (last(speeds[middle], away) for away in (AWAY_RAD, -AWAY_RAD))
    if any(np.ptp(torques) > negligible_Nm for torques in ends) or any(
        abs(torques.mean() - means[middle]) > negligible_Nm for torques in elsewhere
    ):
        return None
    return tuple(speeds), tuple(means)


def law_ring(rig: Rig, mode: str, live: Mapping[str, float]) -> Line | None:
    """Return the force on the hand at steady motion in `DIRECTIONS` directions, x and y [N].

    None for a law whose force depends on the speed or the position, and for a rig of independent axes.

    Parameters
    ----------
    live : values of live parameters by name; others have the rig file's values

    Raises
    ------
    coulombus.rigs.rig.RigError, coulombus.host.laws.laws.LawError
        the law cannot be loaded, or returned a number that is not finite
    """
    model = load_plane(rig, mode)
    if model is None:
        return None
    law = _changed(model.law, live)
    angles = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    slow = np.array([_steady(law, angle, SPEED_M_S) for angle in angles])
    negligible_N = SAME * float(np.abs(slow).max())
    for k in range(0, DIRECTIONS, DIRECTIONS // 8):
        faster = _steady(law, angles[k], FASTER_M_S)
        away = _steady(law, angles[k], SPEED_M_S, AWAY_M)
        if max(np.abs(faster - slow[k]).max(), np.abs(away - slow[k]).max()) > negligible_N:
            return None
    x, y = (-slow).T.tolist()
    return tuple(x), tuple(y)


def _changed(law: PlaneLaw, live: Mapping[str, float]) -> PlaneLaw:
    """Return the law with the present values of its live parameters."""
    if law.parameters is None:
        return law
    update = {name: value for name, value in live.items() if name in type(law.parameters).model_fields}
    return replace(law, parameters=law.parameters.model_copy(update=update))


def _steady(
    law: PlaneLaw, angle: float, speed_m_s: float, from_m: tuple[float, float] = (0.0, 0.0)
) -> npt.NDArray[np.float64]:
    """Return the friction at the end of a steady motion [N], positive against it."""
    t_s = np.arange(round(SECONDS / STEP_S) + 1) * STEP_S
    way = np.outer(speed_m_s * t_s, (math.cos(angle), math.sin(angle)))
    force: npt.NDArray[np.float64] = law.along(t_s, np.array(from_m) + way)[-1]
    return force
