r"""Cogging of the motor from slides: torque that depends on the angle but not on the direction.

While the handle slides, motor and hand balance the device's friction and the motor's cogging:

.. math:: \tau_m + f = J\,\dot v + (c + b\,|v|)\,\mathrm{sgn}(v) + f_0 + A\,\sin(\kappa x + \varphi)

with :math:`\kappa = k i`, i motor revolutions per handle revolution and an integer k of periods per
motor revolution. For each k all coefficients are fitted together. Sine and cosine pass the same
filter as the torques (`recording.friction.sliding.Equations.smooth`), so averaging over a period in
a fast slide does not reduce the amplitude. The k with the smallest residual is taken, and reported
only if significant (`STANDS_OUT` standard deviations). :math:`\kappa` is then refined by itself,
because the ratio i is only known to its interval.

Cogging accelerates the handle, so a fit of friction or inertia without these two columns is biased:
`Cogging.columns` goes into each fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coulombus.recording.friction.equations import Equations, equations
from coulombus.recording.friction.regression import Column, Estimate
from coulombus.recording.friction.sliding import Floats, Slide, Sliding

__all__ = ["Cogging", "find_cogging"]

WINDOW_S = 0.021
"""A shorter window than friction's: it averages over less of a period."""
MOST_PERIODS = 120
LEAST_ROWS = 60
MOST_ROWS = 20_000
"""Maximum number of equations for the search: the first ones of a longer recording."""
STANDS_OUT = 6.0
"""Least amplitude in standard deviations: one of 120 candidates exceeds 4 by chance."""
SHARED = 4
"""Neighbouring equations share samples: this many count as one."""
RATIO_SHARE = 0.004
"""Relative uncertainty of the ratio."""


@dataclass(frozen=True)
class Cogging:
    """The torque wave over the angle.

    Attributes
    ----------
    periods : in one revolution of the motor
    wave_rad : phase of the sine per rad of the handle
    """

    periods: int
    wave_rad: float

    def columns(self, rows: Equations, slides: tuple[Slide, ...]) -> dict[str, Column]:
        """Return its sine and cosine as regression columns for the `rows` of `slides`."""
        used = [slide for slide in slides if len(slide.t_s) >= len(rows.weight)]
        return {
            name: (rows.smooth([function(self.wave_rad * slide.x_rad) for slide in used]), 0.0)
            for name, function in (("cogging sine", np.sin), ("cogging cosine", np.cos))
        }

    def stands_out(self, coefficients: Mapping[str, Estimate]) -> bool:
        """Return whether its coefficients are significant in a fit with cluster intervals."""
        sine, cosine = coefficients["cogging sine"], coefficients["cogging cosine"]
        return math.hypot(sine.value, cosine.value) > STANDS_OUT / 1.96 * max(sine.reach, cosine.reach)

    def wave(self, sine: float, cosine: float) -> Callable[[Floats], Floats]:
        """Return the cogging [Nm] as a function of the handle's angle [rad], by its coefficients."""
        return lambda x_rad: sine * np.sin(self.wave_rad * x_rad) + cosine * np.cos(self.wave_rad * x_rad)


def find_cogging(slides: Sliding, ratio: float, gain: float | None = 1.0) -> Cogging | None:
    """Return the cogging of the slides; None if none is significant or one direction is missing.

    Parameters
    ----------
    ratio : motor revolutions per handle revolution
    gain : of the motor's torque; None: also fitted (the hand must resist the motor)
    """
    rows = equations(slides.slides, slides.period_s, slides.count_rad, WINDOW_S)
    if len(rows.v) < LEAST_ROWS or rows.v.min() >= 0 or rows.v.max() <= 0:
        return None
    here = slice(0, MOST_ROWS)
    torque = (rows.hand_Nm if gain is None else rows.hand_Nm + gain * rows.motor_Nm)[here]
    common = [np.sign(rows.v), rows.v, rows.a, np.ones(len(rows.v))]
    if gain is None:
        common.append(rows.motor_Nm)
    base, _ = np.linalg.qr(np.stack(common, 1)[here])
    left = torque - base @ (base.T @ torque)

    def waves(wave_rad: float) -> Any:
        columns = Cogging(0, wave_rad).columns(rows, slides.slides)
        matrix = np.stack([column[here] for column, _ in columns.values()], 1)
        return matrix - base @ (base.T @ matrix)

    def remaining(wave_rad: float) -> float:
        matrix = waves(wave_rad)
        solution, *_ = np.linalg.lstsq(matrix, left, rcond=None)
        return float(np.sum((left - matrix @ solution) ** 2))

    periods = min(range(1, MOST_PERIODS + 1), key=lambda k: remaining(k * ratio))
    from scipy.optimize import minimize_scalar  # slow to load: imported only for a fit

    middle = periods * ratio
    bounds = ((1 - RATIO_SHARE) * middle, (1 + RATIO_SHARE) * middle)
    wave_rad = float(minimize_scalar(remaining, bounds=bounds, method="bounded", options={"xatol": 1e-5 * middle}).x)
    matrix = waves(wave_rad)
    solution, *_ = np.linalg.lstsq(matrix, left, rcond=None)
    variance = SHARED * remaining(wave_rad) / max(len(left) - SHARED * (base.shape[1] + 2), 1)
    error = np.sqrt(variance * np.linalg.pinv(matrix.T @ matrix).diagonal())
    if math.hypot(*solution) < STANDS_OUT * float(error.max()):
        return None
    return Cogging(periods, wave_rad)
