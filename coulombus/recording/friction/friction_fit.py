r"""The regression of `recording.friction.identify`: coefficients, intervals, and the test of Stribeck's term.

The encoder's quantisation gives v and a errors of known variance; `recording.friction.regression`
corrects for them, and has intervals for correlated residuals. Cogging adds a sine and a cosine of
the motor's angle to the columns (`recording.friction.angle_waves`).

Stribeck's term is the best fit over a grid of speeds v_S. The best of many is never exactly 0 by
chance, so it stays only if it clearly lowers Schwarz's criterion *and* its interval at
`STRIBECK_LEVEL` excludes 0 *and* friction falls with speed (F_s > c).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from coulombus.recording.friction.equations import Equations
from coulombus.recording.friction.regression import (
    CONFIDENCE,
    LEAST_CLUSTERS,
    Column,
    Estimate,
    SpeedLevels,
    clusters_of,
    correction_reach,
    solve,
    standard_errors,
)
from coulombus.recording.friction.sliding import IdentifyError, Slide

__all__ = ["MOTOR", "Fit", "fit_friction", "load_column"]

Floats: TypeAlias = npt.NDArray[np.float64]

LOAD, MOTOR = "load", "motor"
"""Names of the columns of the load's friction, and of the motor's torque."""
LOAD_LEVEL = 3.0
"""Least share of the load, in reaches of its interval."""
LEAST_GAIN, LEAST_LOAD = 0.5, 0.01
"""Least share of the motor's torque that the hand must bear, and of the load that motion and torque do not tell."""
STRIBECK_LEVEL = 0.999
"""Confidence level for Stribeck's term: the best of 24 speeds passes it by chance in about 1 % of recordings."""
STRIBECK_GAIN = 10.0
"""Schwarz's criterion must fall by this ("very strong" evidence) for Stribeck's term to stay."""
STRIBECK_SPEEDS = 24
STRIBECK_SLIDES = 4
LEAST_SPREAD = 0.1
"""Least ratio of the speed's standard deviation to its mean for viscous friction."""
SIGNAL_TO_ERROR = 10.0
"""Least ratio of variances between acceleration and the encoder's quantisation."""


@dataclass(frozen=True)
class Fit:
    """Friction fitted to samples; values are None if the data do not support them."""

    coulomb_Nm: Estimate
    viscous_Nms_rad: Estimate | None
    inertia_kg_m2: Estimate | None
    offset_Nm: Estimate | None
    stribeck_Nm: Estimate | None
    """F_s - c: static friction above Coulomb friction."""
    stribeck_rad_s: float | None
    residual_rms_Nm: float
    others: Mapping[str, Estimate] = field(default_factory=dict)
    """The coefficients of further columns."""

    @property
    def load_share(self) -> Estimate | None:
        """Friction that grows with the load, as a share of it."""
        return self.others.get(LOAD)

    def friction_Nm(self, v: Floats) -> Floats:
        """Return the fitted friction [Nm] at the speeds `v`, without inertia and offset."""
        level = np.full_like(v, self.coulomb_Nm.value)
        if self.viscous_Nms_rad is not None:
            level += self.viscous_Nms_rad.value * np.abs(v)
        if self.stribeck_Nm is not None and self.stribeck_rad_s is not None:
            level += self.stribeck_Nm.value * np.exp(-((v / self.stribeck_rad_s) ** 2))
        friction: Floats = np.sign(v) * level
        return friction

    def inertia_and_offset_Nm(self, a: Floats) -> Floats:
        """Return the fitted rest of the torque [Nm] at the accelerations `a`."""
        rest = np.zeros_like(a)
        if self.inertia_kg_m2 is not None:
            rest += self.inertia_kg_m2.value * a
        if self.offset_Nm is not None:
            rest += self.offset_Nm.value
        return rest

    def as_dict(self) -> dict[str, Any]:
        """Return value and interval of each parameter."""
        values: dict[str, Any] = {}
        for name in ("coulomb_Nm", "viscous_Nms_rad", "inertia_kg_m2", "offset_Nm", "stribeck_Nm", "load_share"):
            estimate = getattr(self, name)
            values[name] = None if estimate is None else estimate.value
            values[f"{name}_ci95"] = None if estimate is None else [estimate.low, estimate.high]
        return values | {"stribeck_rad_s": self.stribeck_rad_s, "residual_rms_Nm": self.residual_rms_Nm}


@dataclass(frozen=True)
class _Stribeck:
    speed: float
    shape: Floats


def _shape(equations: Equations, v_s: float) -> Floats:
    """Return exp(-(v/v_S)^2) sgn(v) after the equations' filter."""
    return np.sign(equations.v) * equations.smooth([np.exp(-((v / v_s) ** 2)) for v in equations.speeds])


def _stribeck(equations: Equations, X: Floats, y: Floats, variances: Floats) -> _Stribeck | None:
    """Return the best Stribeck term; None if no speed has enough slow samples, or Schwarz's criterion rejects it."""
    speed = np.abs(equations.v)
    wide = np.append(variances, 0.0)

    def rss(v_s: float) -> float:
        try:
            return solve(np.column_stack([X, _shape(equations, v_s)]), y, wide).rss
        except IdentifyError:
            return math.inf

    trials = []
    for v_s in np.geomspace(max(np.min(speed), 1e-6), 0.5 * np.max(speed), STRIBECK_SPEEDS):
        strong = np.abs(_shape(equations, v_s)) > 0.3
        if np.mean(strong) > 0.02 and len(np.unique(equations.slide[strong])) >= STRIBECK_SLIDES and not np.all(strong):
            trials.append((rss(float(v_s)), float(v_s)))
    if not trials:
        return None
    _, start = min(trials)
    refined = float(minimize_scalar(rss, bounds=(0.5 * start, 2 * start), method="bounded").x)
    independent = len(y) / 4  # windows overlap by three quarters

    def criterion(rss: float, parameters: int) -> float:
        return independent * math.log(max(rss, 1e-300) / len(y)) + parameters * math.log(independent)

    without = criterion(solve(X, y, variances).rss, X.shape[1])
    if criterion(rss(refined), X.shape[1] + 2) >= without - STRIBECK_GAIN:
        return None
    return _Stribeck(refined, _shape(equations, refined))


def load_column(
    equations: Equations, slides: Sequence[Slide], others: Mapping[str, Column] | None = None
) -> dict[str, Column]:
    r"""Return the column of a friction that grows with the load, :math:`|\tau_m|\,\mathrm{sgn}(v)`; empty without one.

    A motor that moves a free handle gives what the friction takes, so that any share of the load explains
    it. Therefore the load counts only if it is significant where the motor's torque has a coefficient of its own,
    and the hand bears it.

    Parameters
    ----------
    others : the further columns of the fit
    """
    motor_Nm = [slide.motor_Nm for slide in slides if len(slide.t_s) >= len(equations.weight)]
    load = np.sign(equations.v) * equations.smooth([np.abs(torque) for torque in motor_Nm])
    regressors = [np.sign(equations.v), equations.v, equations.a, np.ones_like(load), equations.motor_Nm]
    regressors += [values for values, _ in (others or {}).values()]
    matrix = np.column_stack(regressors)
    solution, *_ = np.linalg.lstsq(matrix, load, rcond=None)
    if float(np.std(load - matrix @ solution)) <= LEAST_LOAD * float(np.sqrt(np.mean(load**2))):
        return {}
    column: dict[str, Column] = {LOAD: (load, 0.0)}
    columns = {**(others or {}), MOTOR: (-equations.motor_Nm, 0.0), **column}
    fit = fit_friction(equations, equations.hand_Nm, None, columns)
    share, gain = fit.others[LOAD], fit.others[MOTOR]
    return column if share.value > LOAD_LEVEL * share.reach and gain.low > LEAST_GAIN else {}


def fit_friction(
    equations: Equations,
    torque: Floats,
    remarks: list[str] | None = None,
    others: Mapping[str, Column] | None = None,
    levels: SpeedLevels | None = None,
) -> Fit:
    """Fit friction to the equations of slides.

    Parameters
    ----------
    equations : of the slides
    torque : each equation's torque [Nm]: the transducer's, or with the motor's added
    remarks : list to which sentences on unsupported parameters are appended
    others : further columns, such as those of cogging
    levels : rows that share a quantisation error of the torque

    Raises
    ------
    IdentifyError
        too few equations for an interval
    """
    notes = [] if remarks is None else remarks
    sign, v, a = np.sign(equations.v), equations.v, equations.a
    clusters = clusters_of(equations.slide)
    if len(clusters) < LEAST_CLUSTERS:
        raise IdentifyError(
            f"the handle slides in {len(clusters)} separate pieces; expected at least {LEAST_CLUSTERS}: record more strokes, to and fro"
        )
    columns: dict[str, Column] = {"coulomb": (sign, 0.0)}
    speed = np.abs(v)
    if np.std(speed) > LEAST_SPREAD * np.mean(speed):
        columns["viscous"] = v, equations.v_variance
    else:
        notes.append("one speed only: viscous friction cannot be told from Coulomb's and is counted to it")
    if np.mean(a**2) > SIGNAL_TO_ERROR * equations.a_variance and np.any(a != 0.0):
        columns["inertia"] = a, equations.a_variance
    else:
        notes.append("the speed hardly changes: the inertia cannot be told")
    if min(np.mean(sign > 0), np.mean(sign < 0)) > 0.1:
        columns["offset"] = np.ones_like(v), 0.0
    else:
        notes.append(
            "one direction only: a bias of the transducer cannot be told from Coulomb friction and is counted to it"
        )
    columns |= others or {}
    X, variances = np.column_stack([c for c, _ in columns.values()]), np.array([e for _, e in columns.values()])
    solution = solve(X, torque, variances)
    error, freedom = standard_errors(solution, clusters)
    stribeck = _stribeck(equations, X, torque, variances) if "viscous" in columns else None
    if stribeck is not None:
        wide, wide_variances = np.column_stack([X, stribeck.shape]), np.append(variances, 0.0)
        wide_solution = solve(wide, torque, wide_variances)
        # v_S is fitted as well: the covariance includes its tangent
        step = 1e-4 * stribeck.speed
        tangent = (_shape(equations, stribeck.speed + step) - _shape(equations, stribeck.speed - step)) / (2 * step)
        height = wide_solution.beta[-1] / wide_solution.scale[-1]
        full = solve(np.column_stack([wide, height * tangent]), torque, np.append(wide_variances, 0.0))
        # at the optimum the tangent's own coefficient is 0, so residuals and coefficients are those of `wide_solution`
        wide_error, wide_freedom = standard_errors(full, clusters)
        low = height - stdtrit(wide_freedom[-2], 0.5 + STRIBECK_LEVEL / 2) * wide_error[-2]
        if low > 0.0:
            columns["stribeck"] = stribeck.shape, 0.0
            solution, error, freedom = wide_solution, wide_error[:-1], wide_freedom[:-1]
        else:
            stribeck = None
    if stribeck is None:
        notes.append("the data do not carry Stribeck's term")
    if levels is not None:
        error = np.sqrt(error**2 + levels.variance(solution))
    reach = stdtrit(freedom, 0.5 + CONFIDENCE / 2) * error
    wide = X if stribeck is None else np.column_stack([X, stribeck.shape])
    reach = np.hypot(reach, correction_reach(solution, wide, torque))
    beta = solution.beta / solution.scale

    def estimate(name: str) -> Estimate | None:
        if name not in columns:
            return None
        i = list(columns).index(name)
        return Estimate(float(beta[i]), float(beta[i] - reach[i]), float(beta[i] + reach[i]))

    coulomb = estimate("coulomb")
    assert coulomb is not None
    return Fit(
        coulomb_Nm=coulomb,
        viscous_Nms_rad=estimate("viscous"),
        inertia_kg_m2=estimate("inertia"),
        offset_Nm=estimate("offset"),
        stribeck_Nm=estimate("stribeck"),
        stribeck_rad_s=None if stribeck is None else stribeck.speed,
        residual_rms_Nm=math.sqrt(solution.rss / len(torque)),
        others={name: other for name in others or {} if (other := estimate(name)) is not None},
    )
