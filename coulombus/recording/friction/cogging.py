r"""Cogging of the motor from slides: the torque that depends on the angle and not on the direction.

While the handle slides, motor and hand bear the device's friction and the motor's cogging:

.. math:: \tau_m + f = J\,\dot v + (c + b\,|v|)\,\mathrm{sgn}(v) + f_0 + A\,\sin(k i x + \varphi)

with :math:`i` motor revolutions for one of the handle and :math:`k` periods in one revolution of the
motor, a whole number. For each :math:`k` all coefficients are fitted together, sine and cosine
behind the same filter as the torques (`recording.friction.sliding.Equations.smooth`), so a fast
slide that averages over a period does not make the amplitude smaller. The :math:`k` that leaves
least is taken, and told only where it stands out (`STANDS_OUT` standard deviations). So friction,
which changes its sign with the direction, has no part in it, and it has none in friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from coulombus.recording.friction.friction_fit import Estimate
from coulombus.recording.friction.sliding import Floats, Sliding, equations

__all__ = ["Cogging", "find_cogging"]

WINDOW_S = 0.021
"""A shorter window than friction's: it averages over less of a period."""
MOST_PERIODS = 60
LEAST_ROWS = 60
STANDS_OUT = 6.0
"""Standard deviations that the amplitude is above 0: one of 60 candidates is above 4 by chance."""
SHARED = 4
"""Neighbouring equations share samples: so many count as one."""


@dataclass(frozen=True)
class Cogging:
    """What depends on the angle alone.

    Attributes
    ----------
    amplitude_Nm : at the handle
    reach_Nm : half of its 95 % interval
    periods : in one revolution of the motor
    coulomb_Nm, viscous_Nms_rad : friction, fitted together with it: without it a slide that is no
        whole number of periods long leaves a part of the cogging in them
    x_rad, torque_Nm : the samples, friction and inertia taken off
    phase_rad : of the sine at angle 0
    """

    amplitude_Nm: float
    reach_Nm: float
    periods: int
    phase_rad: float
    coulomb_Nm: Estimate
    viscous_Nms_rad: Estimate
    x_rad: Floats
    torque_Nm: Floats

    def wave(self, ratio: float) -> Callable[[Floats], Floats]:
        """Return the cogging [Nm] as a function of the handle's angle [rad]."""
        return lambda x_rad: self.amplitude_Nm * np.sin(self.periods * ratio * x_rad + self.phase_rad)


def find_cogging(slides: Sliding, ratio: float) -> Cogging | None:
    """Return the cogging that the slides show; None where none stands out, or one direction lacks.

    `ratio`: motor revolutions for one of the handle.
    """
    rows = equations(slides.slides, slides.period_s, slides.count_rad, WINDOW_S)
    if len(rows.v) < LEAST_ROWS or rows.v.min() >= 0 or rows.v.max() <= 0:
        return None
    used = [slide for slide in slides.slides if len(slide.t_s) >= len(rows.weight)]
    torque = rows.hand_Nm + rows.motor_Nm
    common = [np.sign(rows.v), rows.v, rows.a, np.ones(len(rows.v))]
    best: tuple[float, int, Any, Any] | None = None
    for periods in range(1, MOST_PERIODS + 1):
        turned = [periods * ratio * slide.x_rad for slide in used]
        waves = [rows.smooth([function(angle) for angle in turned]) for function in (np.sin, np.cos)]
        matrix = np.stack([*waves, *common], 1)
        solution, *_ = np.linalg.lstsq(matrix, torque, rcond=None)
        left = float(np.sum((torque - matrix @ solution) ** 2))
        if best is None or left < best[0]:
            best = left, periods, solution, matrix
    assert best is not None
    left, periods, solution, matrix = best
    variance = SHARED * left / max(len(torque) - SHARED * matrix.shape[1], 1)
    reach = 1.96 * np.sqrt(variance * np.linalg.pinv(matrix.T @ matrix).diagonal())
    amplitude = math.hypot(solution[0], solution[1])
    if amplitude < STANDS_OUT / 1.96 * reach[:2].max():
        return None
    return Cogging(
        amplitude_Nm=amplitude,
        reach_Nm=float(reach[:2].max()),
        periods=periods,
        phase_rad=math.atan2(solution[1], solution[0]),
        coulomb_Nm=_estimate(solution[2], reach[2]),
        viscous_Nms_rad=_estimate(solution[3], reach[3]),
        x_rad=rows.smooth([slide.x_rad for slide in used]) / float(rows.weight.sum()),
        torque_Nm=torque - matrix[:, 2:] @ solution[2:],
    )


def _estimate(value: float, reach: float) -> Estimate:
    return Estimate(float(value), float(value - reach), float(value + reach))
