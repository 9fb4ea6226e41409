r"""A law's curve over the velocity: its torque at a steady speed, with the present parameters.

At each speed :math:`v` the law is evaluated with the cycle's period from its relaxed state, over
`FAR_RAD`, for at least `LEAST_S` and at most `MOST_S`. The curve is the mean of the last tenth. A law has
no curve if its torque varies in that tenth, or differs far away: then it depends on the position, and not
on the speed alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.parameter_changes import parameters_of
from coulombus.host.cycle.records import Slot
from coulombus.host.laws.along import drive
from coulombus.rigs.axis import Axis

__all__ = ["SPEEDS", "Line", "law_curve"]

SPEEDS = tuple(float(speed) for speed in np.geomspace(5e-4, 1.0, 18))
"""The speeds of the curve, as shares of `limits.speed_rad_s`."""
FAR_RAD, AWAY_RAD = 0.3, 1000.0
LEAST_S, MOST_S = 1.0, 15.0
SAME = 0.02
"""Largest variation of a law with a curve at a steady speed, as a share of its largest torque."""
FIELDS = {Slot.K_P: "K_p", Slot.F_S: "F_s", Slot.F_D: "F_d"}

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
