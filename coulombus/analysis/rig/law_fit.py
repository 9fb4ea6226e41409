r"""Fit a law's parameters to a recording: the law, driven along the recorded motion, reproduces the torque.

.. math:: f_k = \psi_\theta(x_0 \ldots x_k) + J\,a_k + f_0 + e_k,
          \qquad \hat\theta = \arg\min \sum_k e_k^2

J and f_0 are linear: they are solved for each theta (variable projection) if the recording contains
inertia and bias. Scale parameters are searched in their logarithm, from starts that fill a box around
a guess, within the ranges that the law declares. The fit uses the law's compiled function, so any law with named
parameters can be fitted, including user-defined ones.

**Intervals** of 95 %: the covariance is that of Gauss and Newton, with the residuals' correlation
counted by clusters of `CLUSTER_S` (a sandwich), and Student's t of the clusters' number. Singular
values reveal directions of the parameters on which the torque hardly depends; parameters in such a
direction are reported as *not determined*. A parameter that ends at its range has no interval
either.

Sources: G. Golub, V. Pereyra, Separable nonlinear least squares: the variable projection method and its
applications, Inverse Problems 19(2), 2003, doi:10.1088/0266-5611/19/2/201; L. Ljung, System
Identification: Theory for the User, 2nd ed. 1999, chapter 9.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.stats import qmc
from scipy.stats import t as student

from coulombus.host.laws.along import GivenLaw, given_law
from coulombus.host.laws.law import Declaration
from coulombus.host.laws.laws import LawError
from coulombus.recording.friction.regression import Estimate
from coulombus.recording.friction.sliding import IdentifyError, stretches
from coulombus.recording.signals import Source
from coulombus.rigs.field_help import unit_of

__all__ = ["LawFit", "Stretch", "fit_law", "lines", "periods", "stretches_of"]

Floats: TypeAlias = npt.NDArray[np.float64]

STARTS, SPREAD = 16, 2.0
"""Starts around the guess, a power of 2, and how far they reach, as a logarithm."""
PERIOD = "period_rad"
CANDIDATES, LIKELY, MOST_ROWS = 300, 3, 3000
FINEST, LONGEST = 60.0, 4.0
"""Search range of periods: from travel / FINEST to LONGEST times the travel."""
CLUSTER_S = 0.05
WEAK = 1e-5
"""Relative singular value below which a direction of the parameters is not determined."""
NO_PART = 1e-9
"""Relative contribution to the torque below which a parameter is not determined."""
LEAST_SAMPLES = 50
NOTHING = 1e-12
"""Cost relative to the squared torque at which the search ends."""
SMOOTH = 15
"""Samples in the window of a recorded speed."""
MOST_EVALUATIONS = 100


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples of one displayed law. The law is relaxed at the first."""

    t_s: Floats
    x_rad: Floats
    torque_Nm: Floats


@dataclass(frozen=True)
class LawFit:
    """A law's parameters, fitted to a recording."""

    law: str
    estimates: dict[str, Estimate | None]
    """None if the data do not support an interval: see `not_determined`."""
    values: dict[str, float]
    held: dict[str, Any]
    """Parameters held at given values."""
    not_determined: tuple[str, ...]
    inertia_kg_m2: float | None
    offset_Nm: float | None
    residual_rms_Nm: float
    samples: int

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "law": self.law,
            "parameters": self.values,
            "ci95": {
                name: None if estimate is None else [estimate.low, estimate.high]
                for name, estimate in self.estimates.items()
            },
            "held": self.held,
            "not_determined": list(self.not_determined),
            "inertia_kg_m2": self.inertia_kg_m2,
            "offset_Nm": self.offset_Nm,
            "residual_rms_Nm": self.residual_rms_Nm,
            "samples": self.samples,
        }


def stretches_of(recording: Source) -> tuple[Stretch, ...]:
    """Return the hand's torque over the angle while the display is at full gain and the brake's set-point is constant.

    Raises
    ------
    coulombus.recording.friction.sliding.IdentifyError
        there is no transducer, or hardly a sample
    """
    smoothed = []
    for stretch in stretches(recording):
        x = savgol_filter(stretch.x_rad, SMOOTH, 2) if len(stretch.x_rad) >= SMOOTH else stretch.x_rad
        smoothed.append(Stretch(stretch.t_s, np.asarray(x, np.float64), stretch.hand_Nm))
    return tuple(smoothed)


class _Search:
    """Search variables: the free parameters, logarithmic for scales."""

    def __init__(self, given: GivenLaw, declared: Declaration, held: set[str], data: Sequence[Stretch]) -> None:
        self.given, self.declared = given, declared
        self.names = tuple(
            name
            for name, info in declared.parameters.model_fields.items()
            if name not in held and not get_args(info.annotation)
        )
        self.low, self.high = (np.array([_range(declared, name)[end] for name in self.names]) for end in (0, 1))
        self.guess = np.array([_guess(declared, name, data) for name in self.names])
        self.guess = np.clip(self.guess, np.maximum(self.low, 1e-12), self.high)
        # a parameter that may be 0 or less is searched as a multiple of its guess, others in their logarithm
        self.scale = self.low > 0.0

    def starts(self, data: Sequence[Stretch]) -> Iterator[Floats]:
        """Yield the starts: the guess, with each of the `periods` if the law has one; then others around it."""
        guess = np.where(self.scale, 0.0, 1.0)
        at = next((k for k, name in enumerate(self.names) if name == PERIOD), None)
        for period in [math.nan] if at is None else periods(data):
            if at is not None:
                guess[at] = math.log(period / self.guess[at])
            yield guess.copy()
        for point in qmc.Sobol(len(self.names), scramble=False).random(STARTS):
            spread = SPREAD * (2.0 * point - 1.0)
            if at is not None:
                spread[at] = guess[at]
            yield np.where(self.scale, spread, np.exp(spread))

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Bounds of the search."""
        with np.errstate(divide="ignore", invalid="ignore"):
            low = np.where(self.scale, np.log(np.maximum(self.low, 1e-300) / self.guess), self.low / self.guess)
            high = np.where(self.scale, np.log(self.high / self.guess), self.high / self.guess)
        return low - 1e-9, high + 1e-9

    def values(self, u: Floats) -> Floats:
        """Return the parameters, within their ranges and mutual constraints."""
        values = np.where(self.scale, self.guess * np.exp(np.clip(u, -700, 700)), self.guess * u)
        values = np.clip(values, self.low, self.high)
        place = {name: k for k, name in enumerate(self.names)}
        rules = [(a, b, 1.0) for a, b in self.declared.parameters.at_least.items()]
        rules += [(a, b, 1.0 + 1e-6) for a, b in self.declared.parameters.above.items()]
        for name, other, factor in rules:
            if name in place:
                floor = values[place[other]] if other in place else getattr(self.given.parameters, other)
                values[place[name]] = max(values[place[name]], floor * factor)
            elif other in place:
                ceiling = getattr(self.given.parameters, name) / factor
                values[place[other]] = min(values[place[other]], ceiling)
        return values

    def law(self, values: Floats) -> GivenLaw:
        """Return the law with these parameters."""
        new = dict(zip(self.names, map(float, values), strict=True))
        try:
            parameters = type(self.given.parameters)(**{**self.given.parameters.model_dump(), **new})
        except ValidationError as error:  # a rule of the law
            raise LawError(f"law {self.given.name!r}: no such parameters: {error}") from error
        return GivenLaw(self.given.name, self.given.pointer, self.declared, parameters)


def periods(data: Sequence[Stretch]) -> Floats:
    """Return candidate periods [rad] of the torque over the angle, the likeliest first, signed with
    the direction or not: by linear least squares of a wave for each of `CANDIDATES`.

    A small error of the period shifts the law by many waves, so gradient descent cannot find it.
    """
    step = max(sum(len(stretch.t_s) for stretch in data) // MOST_ROWS, 1)
    x, y, s = (
        np.concatenate(parts)[::step]
        for parts in (
            [stretch.x_rad for stretch in data],
            [stretch.torque_Nm for stretch in data],
            [np.sign(np.gradient(stretch.x_rad)) for stretch in data],
        )
    )
    way = float(np.ptp(x))
    tried = np.geomspace(way / FINEST, LONGEST * way, CANDIDATES)
    left = []
    for period in tried:
        wave, across = np.sin(2 * np.pi / period * x), np.cos(2 * np.pi / period * x)
        columns = np.column_stack((np.ones(len(x)), s, wave, across, s * wave, s * across))
        left.append(float(np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) ** 2)))
    lows = [k for k in range(1, len(left) - 1) if left[k] <= min(left[k - 1], left[k + 1])] or [int(np.argmin(left))]
    return np.asarray(tried[sorted(lows, key=left.__getitem__)[:LIKELY]], np.float64)


def _range(declared: Declaration, name: str) -> tuple[float, float]:
    low, high = -math.inf, math.inf
    for rule in declared.parameters.model_fields[name].metadata:
        if getattr(rule, "gt", None) is not None:
            low = max(low, float(rule.gt) if rule.gt > 0 else 1e-9)
        if getattr(rule, "ge", None) is not None:
            low = max(low, float(rule.ge))
        if getattr(rule, "le", None) is not None:
            high = min(high, float(rule.le))
        if getattr(rule, "lt", None) is not None:
            high = min(high, float(rule.lt) * (1 - 1e-9))
    return low, high


def _guess(declared: Declaration, name: str, data: Sequence[Stretch]) -> float:
    """Return an initial guess of a parameter from its unit and the data."""
    torque = max(float(np.quantile(np.abs(np.concatenate([stretch.torque_Nm for stretch in data])), 0.8)), 1e-6)
    way = max(float(np.ptp(stretch.x_rad)) for stretch in data) or 1.0
    speed = (
        max(float(np.quantile(np.abs(np.diff(stretch.x_rad) / np.diff(stretch.t_s)), 0.7)) for stretch in data) or 1.0
    )
    default = float(declared.parameters.model_fields[name].default)
    by_unit = {
        "Nm": torque * (1.2 if name in declared.parameters.at_least else 1.0),
        "Nm/rad": 20.0 * torque / way,
        "Nms/rad": 0.02 * torque / speed,
        "Nm s/rad": 0.02 * torque / speed,
        "rad/s": 0.3 * speed,
        "rad": 0.1 * way,
    }
    return by_unit.get(unit_of(name) or "", default) or 1.0


def fit_law(name: str, data: Sequence[Stretch], overrides: Sequence[str] = (), *, rig: bool = True) -> LawFit:
    """Fit a law's parameters.

    Parameters
    ----------
    name : the law, as in ``law.function``
    data : stretches of samples; the torque is the friction, positive against a positive speed
    overrides : "KEY=VALUE" holds a parameter at a value
    rig : whether the torque includes inertia and a transducer's bias

    Raises
    ------
    coulombus.recording.friction.sliding.IdentifyError
        the data do not support the fit
    coulombus.host.laws.laws.LawError, coulombus.rigs.rig.RigError
        there is no such law, or a held parameter is refused
    """
    given = given_law(name, overrides)
    if given.declaration is None:
        raise LawError(f"law {name!r} names no parameters: there is nothing to identify (docs/laws.md)")
    if given.declaration.uses_mode_keys:
        raise LawError(
            f"law {name!r} has its parameters in [mode.*]; `coulombus identify` without --law fits Coulomb, viscous and "
            "Stribeck friction"
        )
    count = sum(len(stretch.t_s) for stretch in data)
    if count < LEAST_SAMPLES:
        raise IdentifyError(f"{count} samples; expected at least {LEAST_SAMPLES} in which the law is felt")
    held = {override.partition("=")[0].strip().removeprefix(f"law.{given.declaration.name}.") for override in overrides}
    if all(float(np.ptp(stretch.x_rad)) == 0.0 for stretch in data):
        raise IdentifyError("the handle does not move: no law can be told from that; record strokes, to and fro")
    search = _Search(given, given.declaration, held, data)
    if not search.names:
        raise IdentifyError(f"law {name!r}: every parameter is held by --set: there is nothing to identify")
    y = np.concatenate([stretch.torque_Nm for stretch in data])
    linear = _regressors(data) if rig else np.zeros((len(y), 0))
    basis = np.linalg.qr(linear)[0] if linear.shape[1] else linear

    def law_torque(u: Floats) -> Floats:
        law = search.law(search.values(u))
        return np.concatenate([law.along(stretch.t_s, stretch.x_rad, 1e-9).samples["torque_Nm"] for stretch in data])

    def residual(u: Floats) -> Floats:
        e: Floats = y - law_torque(u)
        if basis.shape[1]:
            e = e - basis @ (basis.T @ e)
        return np.where(np.isfinite(e), e, 1e6)

    best = None
    for start in search.starts(data):
        start = np.clip(start, search.bounds[0], search.bounds[1])
        fit = least_squares(
            residual, start, bounds=search.bounds, x_scale="jac", diff_step=1e-4, max_nfev=MOST_EVALUATIONS
        )
        if best is None or fit.cost < best.cost:
            best = fit
        if best.cost <= NOTHING * float(y @ y):
            break
    assert best is not None
    return _fit_of(search, best, residual, (y - law_torque(best.x), linear), data)


def _regressors(data: Sequence[Stretch]) -> Floats:
    columns = []
    for stretch in data:
        period = float(np.median(np.diff(stretch.t_s)))
        size = min(31, 2 * ((len(stretch.x_rad) - 1) // 2) - 1)
        a = savgol_filter(stretch.x_rad, size, 2, deriv=2, delta=period) if size >= 5 else np.zeros(len(stretch.x_rad))
        columns.append(np.column_stack((a, np.ones(len(a)))))
    return np.concatenate(columns)


def _fit_of(search: _Search, best: Any, residual: Any, rest: tuple[Floats, Floats], data: Sequence[Stretch]) -> LawFit:
    """Return the fit with its intervals."""
    u, e = np.asarray(best.x, np.float64), np.asarray(best.fun, np.float64)
    values, n = search.values(u), len(u)
    J = np.empty((len(e), n))
    for k in range(n):  # central differences over relative changes of the parameters
        h = 1e-4
        up, down = u.copy(), u.copy()
        up[k] += h
        down[k] -= h
        J[:, k] = -(residual(up) - residual(down)) / (2 * h)
    sizes = np.linalg.norm(J, axis=0)
    largest = float(sizes.max())
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    _, singular, V = np.linalg.svd(J / sizes, full_matrices=False)
    weak = singular <= WEAK * singular[0]
    parts = np.sqrt(np.sum(V[weak] ** 2, axis=0)) if np.any(weak) else np.zeros(n)
    inverse = V.T @ np.diag(np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, singular) ** 2)) @ V / np.outer(sizes, sizes)
    labels, first = [], 0
    for stretch in data:
        size = max(1, round(CLUSTER_S / max(float(np.median(np.diff(stretch.t_s))), 1e-12)))
        own = first + np.arange(len(stretch.t_s)) // size
        labels.append(own)
        first = int(own[-1]) + 1
    cluster = np.concatenate(labels)
    scores = np.zeros((first, n))
    np.add.at(scores, cluster, J * e[:, None])
    free = max(first - n, 1)
    covariance = inverse @ (scores.T @ scores) @ inverse * first / free
    classical = inverse * float(e @ e) / max(len(e) - n, 1)
    half = float(student.ppf(0.975, free)) * np.sqrt(np.maximum(np.diag(covariance), np.diag(classical)))
    estimates: dict[str, Estimate | None] = {}
    not_determined = []
    for k, name in enumerate(search.names):
        at_end = values[k] >= search.high[k] * (1 - 1e-6) or values[k] <= search.low[k] * (1 + 1e-6)
        zero = search.low[k] == 0.0 and values[k] <= 0.0
        if parts[k] > 0.1 or (at_end and not zero) or np.linalg.norm(J[:, k]) <= NO_PART * largest:
            not_determined.append(name)
            estimates[name] = None
            continue
        if search.scale[k]:
            low, high = values[k] * math.exp(-min(half[k], 700)), values[k] * math.exp(min(half[k], 700))
        else:
            low, high = values[k] - half[k] * search.guess[k], values[k] + half[k] * search.guess[k]
        estimates[name] = Estimate(float(values[k]), max(float(low), float(search.low[k])), float(high))
    left, linear = rest
    extra = np.linalg.lstsq(linear, left, rcond=None)[0] if linear.shape[1] else None
    dumped = search.given.parameters.model_dump()
    return LawFit(
        law=search.given.name,
        estimates=estimates,
        values=dict(zip(search.names, map(float, values), strict=True)),
        held={name: value for name, value in dumped.items() if name not in search.names},
        not_determined=tuple(not_determined),
        inertia_kg_m2=None if extra is None else float(extra[0]),
        offset_Nm=None if extra is None else float(extra[1]),
        residual_rms_Nm=float(np.sqrt(np.mean(e**2))),
        samples=len(e),
    )


def lines(fit: LawFit) -> list[str]:
    """Return a fit as text."""
    text = [f"law {fit.law}: {fit.samples} samples; 95 % confidence intervals"]
    width = max(len(name) for name in (*fit.values, *fit.held))
    for name, value in fit.values.items():
        estimate = fit.estimates[name]
        text.append(
            f"  {name:<{width}} {value:#.4g} not determined" if estimate is None else f"  {name:<{width}} {estimate}"
        )
    text += [f"  {name:<{width}} {value} held" for name, value in fit.held.items()]
    if fit.inertia_kg_m2 is not None:
        text.append(f"  {'inertia':<{width}} {fit.inertia_kg_m2:.4g} kg m2")
        text.append(f"  {'bias':<{width}} {fit.offset_Nm:.4g} Nm")
    text.append(f"  {'residual, RMS':<{width}} {fit.residual_rms_Nm:.3g} Nm")
    if fit.not_determined:
        names = ", ".join(fit.not_determined)
        text.append(f"note: these data do not tell {names}; hold one with --set, or record more kinds of motion")
    return text
