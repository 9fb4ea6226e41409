r"""Torques that change with the angle, from slides: cogging, uneven friction, and the motor's ripple.

While the handle slides, motor and hand balance the device's friction and the motor's cogging:

.. math::

    \tau_m (1 + R \sin(\mu x + \psi)) + f = J\,\dot v + (c + b\,|v| + U \sin(\nu x + \chi))\,\mathrm{sgn}(v)
    + f_0 + A\,\sin(\kappa x + \varphi)

with :math:`\kappa = k i`, i motor revolutions per handle revolution and an integer k of periods per
motor revolution, as is :math:`\mu`; :math:`\nu` is near an integer of periods per handle revolution. The
sense of motion and the motor's torque distinguish the three. For each k all coefficients are fitted
together. Sine and cosine pass the same filter as the torques
(`recording.friction.equations.Equations.smooth`), so averaging over a period in a fast slide does not
reduce the amplitude. The k with the smallest residual is taken, and reported only if significant
(`STANDS_OUT` standard deviations). :math:`\kappa` is then refined by itself, because the ratio i is only
known to its interval. :math:`\nu` is refined by half a period, because a sweep over a part of a
revolution sees a part of whatever shape the friction has.

Cogging and ripple accelerate the handle, and uneven friction is mistaken for torque of the motor or of
the hand. So a fit without these columns is biased: `AngleWave.columns` goes into each fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from coulombus.recording.friction.equations import Equations, equations
from coulombus.recording.friction.regression import Column, Estimate
from coulombus.recording.friction.sliding import Floats, Slide, Sliding

__all__ = ["ALL_KINDS", "AngleWave", "Kind", "find_waves", "wave_columns"]

Kind: TypeAlias = Literal["cogging", "uneven", "ripple"]
ALL_KINDS: tuple[Kind, ...] = ("uneven", "cogging", "ripple")

WINDOW_S = 0.021
"""A shorter window than friction's: it averages over less of a period."""
MOST_PERIODS = 120
MOST_UNEVEN_PERIODS = 12
"""In a revolution of the handle: more of them average out over a stroke."""
LEAST_ROWS = 60
MOST_ROWS = 20_000
"""Maximum number of equations for the search: the first ones of a longer recording."""
STANDS_OUT = 6.0
"""Least amplitude in standard deviations: one of 120 candidates exceeds 4 by chance.

Of a wave that is seen in a part of its period, sine and cosine are hardly told apart: so its whole part of the
residual's sum of squares is compared.
"""
SHARED = 4
"""Neighbouring equations share samples: this many count as one."""
RATIO_SHARE = 0.004
"""Relative uncertainty of the ratio."""


@dataclass(frozen=True)
class AngleWave:
    """A torque wave over the angle.

    Attributes
    ----------
    kind : cogging; uneven: friction, whose sign is that of the motion; ripple: a share of the motor's torque
    periods : in one revolution of the motor, or of the handle if it is uneven friction
    wave_rad : phase of the sine per rad of the handle
    """

    kind: Kind
    periods: int
    wave_rad: float

    @property
    def names(self) -> tuple[str, str]:
        """Names of its two columns."""
        return f"{self.kind} sine", f"{self.kind} cosine"

    def columns(self, rows: Equations, slides: tuple[Slide, ...]) -> dict[str, Column]:
        """Return its sine and cosine as regression columns for the `rows` of `slides`.

        Those of friction have the mean 0, so that the Coulomb friction is the mean over the angles of the slides.
        """
        used = [slide for slide in slides if len(slide.t_s) >= len(rows.weight)]
        factors = [slide.motor_Nm if self.kind == "ripple" else np.ones(len(slide.t_s)) for slide in used]
        smooth = [
            rows.smooth([f * wave(self.wave_rad * slide.x_rad) for f, slide in zip(factors, used, strict=True)])
            for wave in (np.sin, np.cos)
        ]
        if self.kind == "uneven":
            smooth = [np.sign(rows.v) * (values - np.mean(values)) for values in smooth]
        return {name: (values, 0.0) for name, values in zip(self.names, smooth, strict=True)}

    def stands_out(self, coefficients: Mapping[str, Estimate]) -> bool:
        """Return whether its coefficients are significant in a fit with cluster intervals."""
        sine, cosine = (coefficients[name] for name in self.names)
        return math.hypot(sine.value, cosine.value) > STANDS_OUT / 1.96 * max(sine.reach, cosine.reach)

    def wave(self, sine: float, cosine: float) -> Callable[[Floats], Floats]:
        """Return the torque [Nm] as a function of the handle's angle [rad], by its coefficients."""
        return lambda x_rad: sine * np.sin(self.wave_rad * x_rad) + cosine * np.cos(self.wave_rad * x_rad)


def find_waves(slides: Sliding, ratio: float, kinds: Sequence[Kind], gain: float | None = 1.0) -> tuple[AngleWave, ...]:
    """Return the significant waves of the slides, one after another; none if one direction is missing.

    Parameters
    ----------
    ratio : motor revolutions per handle revolution
    kinds : to look for, in this order; each is fitted with those before it
    gain : of the motor's torque; None: also fitted (the hand must resist the motor)
    """
    rows = equations(slides.slides, slides.period_s, slides.count_rad, WINDOW_S)
    waves: tuple[AngleWave, ...] = ()
    if len(rows.v) < LEAST_ROWS or rows.v.min() >= 0 or rows.v.max() <= 0:
        return waves
    for kind in kinds:
        if kind == "uneven":
            candidates, reach = [AngleWave(kind, k, k) for k in range(1, MOST_UNEVEN_PERIODS + 1)], 0.5
        else:
            candidates, reach = [AngleWave(kind, k, k * ratio) for k in range(1, MOST_PERIODS + 1)], 0.0
        wave = _strongest(rows, slides.slides, gain, candidates, waves, reach)
        waves += () if wave is None else (wave,)
    return waves


def wave_columns(waves: Sequence[AngleWave], rows: Equations, slides: tuple[Slide, ...]) -> dict[str, Column]:
    """Return the columns of all waves."""
    return {name: column for wave in waves for name, column in wave.columns(rows, slides).items()}


def _strongest(
    rows: Equations,
    slides: tuple[Slide, ...],
    gain: float | None,
    candidates: Sequence[AngleWave],
    others: Sequence[AngleWave],
    reach: float,
) -> AngleWave | None:
    """Return the wave that leaves the least residual, if it is significant.

    `reach`: by how much the phase per rad may differ from the candidate's, besides `RATIO_SHARE` of it.
    """
    here = slice(0, MOST_ROWS)
    torque = (rows.hand_Nm if gain is None else rows.hand_Nm + gain * rows.motor_Nm)[here]
    common = [np.sign(rows.v), rows.v, rows.a, np.ones(len(rows.v))]
    if gain is None:
        common.append(rows.motor_Nm)
    common += [column for column, _ in wave_columns(others, rows, slides).values()]
    base, _ = np.linalg.qr(np.stack(common, 1)[here])
    left = torque - base @ (base.T @ torque)

    def columns(wave: AngleWave) -> Any:
        matrix = np.stack([column[here] for column, _ in wave.columns(rows, slides).values()], 1)
        return matrix - base @ (base.T @ matrix)

    def remaining(wave: AngleWave) -> float:
        matrix = columns(wave)
        solution, *_ = np.linalg.lstsq(matrix, left, rcond=None)
        return float(np.sum((left - matrix @ solution) ** 2))

    best = min(candidates, key=remaining)
    from scipy.optimize import minimize_scalar  # slow to load: imported only for a fit

    middle, half = best.wave_rad, reach + RATIO_SHARE * best.wave_rad
    refined = minimize_scalar(
        lambda wave_rad: remaining(replace(best, wave_rad=wave_rad)),
        bounds=(middle - half, middle + half),
        method="bounded",
        options={"xatol": 1e-5 * middle},
    )
    best = replace(best, wave_rad=float(refined.x))
    least = remaining(best)
    variance = SHARED * least / max(len(left) - SHARED * (base.shape[1] + 2), 1)
    return best if float(left @ left) - least >= STANDS_OUT**2 * variance else None
