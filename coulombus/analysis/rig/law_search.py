"""Search of a law's parameters (`coulombus.analysis.rig.law_fit`): the variables, the motion, and the torque to explain."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from scipy.interpolate import make_interp_spline, make_smoothing_spline
from scipy.optimize import least_squares
from scipy.stats import qmc

from coulombus.host.laws.along import GivenLaw
from coulombus.host.laws.law import Declaration
from coulombus.host.laws.laws import LawError
from coulombus.rigs.field_help import unit_of

__all__ = ["Floats", "Motion", "Search", "Stretch", "TorqueSamples", "periods"]

Floats: TypeAlias = npt.NDArray[np.float64]

STARTS, SPREAD = 16, 3.0
"""Starts around the guess, a power of 2, and how far they reach, as a logarithm."""
PERIOD = "period_rad"
CANDIDATES, LIKELY, MOST_ROWS = 300, 3, 3000
FINEST, LONGEST = 60.0, 4.0
"""Search range of periods: from travel / FINEST to LONGEST times the travel."""
CLUSTER_S = 0.05
LEAD_S = 0.05
LEAST_SPLINE = 5
"""Samples below which there is no smooth motion between them."""
NOTHING = 1e-12
"""Cost relative to the squared torque at which the search ends."""
MOST_EVALUATIONS = 100


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples of one law. What it remembers at the first is not known; it is taken as relaxed."""

    t_s: Floats
    x_rad: Floats
    torque_Nm: Floats


class Search:
    """Search variables: the free parameters, logarithmic for scales."""

    def __init__(self, initial: GivenLaw, declared: Declaration, fixed: set[str], data: Sequence[Stretch]) -> None:
        self.initial, self.declared = initial, declared
        self.names = tuple(
            name
            for name, info in declared.parameters.model_fields.items()
            if name not in fixed and not get_args(info.annotation)
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
        values = self._within_ranges(u)
        place = {name: k for k, name in enumerate(self.names)}
        rules = [(a, b, 1.0) for a, b in self.declared.parameters.at_least.items()]
        rules += [(a, b, 1.0 + 1e-6) for a, b in self.declared.parameters.above.items()]
        for name, other, factor in rules:
            if name in place:
                floor = values[place[other]] if other in place else getattr(self.initial.parameters, other)
                values[place[name]] = max(values[place[name]], floor * factor)
            elif other in place:
                ceiling = getattr(self.initial.parameters, name) / factor
                values[place[other]] = min(values[place[other]], ceiling)
        return values

    def constrained(self, u: Floats) -> npt.NDArray[np.bool_]:
        """Tell which parameters are where another one holds them."""
        return np.asarray(self.values(u) != self._within_ranges(u))

    def _within_ranges(self, u: Floats) -> Floats:
        values = np.where(self.scale, self.guess * np.exp(np.clip(u, -700, 700)), self.guess * u)
        return np.asarray(np.clip(values, self.low, self.high))

    def law(self, values: Floats) -> GivenLaw:
        """Return the law with these parameters."""
        new = dict(zip(self.names, map(float, values), strict=True))
        try:
            parameters = type(self.initial.parameters)(**{**self.initial.parameters.model_dump(), **new})
        except ValidationError as error:  # a rule of the law
            raise LawError(f"law {self.initial.name!r}: no such parameters: {error}") from error
        return GivenLaw(self.initial.name, self.initial.pointer, self.declared, parameters)


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


class TorqueSamples:
    """The torque of those samples that count, without what inertia and bias explain of it."""

    def __init__(self, data: Sequence[Stretch], rig: bool) -> None:
        self.data = data
        self.used = np.concatenate([_behind_lead(stretch) for stretch in data])
        self.torque_Nm = np.concatenate([stretch.torque_Nm for stretch in data])[self.used]
        self.linear = np.zeros((len(self.torque_Nm), 0))
        if rig:
            a = [motion.acceleration_rad_s2(one.t_s) for motion, one in zip(self.motions, data, strict=True)]
            self.linear = np.column_stack((np.concatenate(a)[self.used], np.ones(len(self.torque_Nm))))
        self._basis = np.linalg.qr(self.linear)[0]

    @cached_property
    def motions(self) -> list[_SmoothMotion]:
        """The smooth motion of each stretch."""
        return [_SmoothMotion(stretch) for stretch in self.data]

    def without_linear(self, torque_Nm: Floats) -> Floats:
        """Return a torque without its part that is linear in acceleration and bias."""
        return torque_Nm - self._basis @ (self._basis.T @ torque_Nm)

    def clusters(self) -> tuple[npt.NDArray[np.int64], int]:
        """Return the number of each sample's cluster, and how many clusters there are."""
        labels, first = [], 0
        for stretch in self.data:
            size = max(1, round(CLUSTER_S / max(float(np.median(np.diff(stretch.t_s))), 1e-12)))
            labels.append(first + np.arange(len(stretch.t_s)) // size)
            first = int(labels[-1][-1]) + 1
        return np.concatenate(labels)[self.used], first

    def noise_Nm(self) -> float:
        """Return the standard deviation of white noise with such third differences; a jump of the torque is none."""
        thirds = np.concatenate([np.diff(stretch.torque_Nm, 3) for stretch in self.data])
        return float(np.median(np.abs(thirds)) / (0.6745 * math.sqrt(20.0)))


def _behind_lead(stretch: Stretch) -> npt.NDArray[np.bool_]:
    t = stretch.t_s - stretch.t_s[0]
    return np.asarray(t > min(LEAD_S, 0.1 * float(t[-1])))


class Motion:
    """The motion of all stretches, as straight lines between the samples or as a smooth curve in parts."""

    def __init__(self, search: Search, measured: TorqueSamples, parts: int = 1) -> None:
        """One part of an interval is a straight line, several are along the smooth curve."""
        self._search, self._measured, self.parts = search, measured, parts
        if parts == 1:
            self._courses = [(stretch.t_s, stretch.x_rad) for stretch in measured.data]
        else:
            self._courses = [
                (t_s, motion.angle_rad(t_s))
                for stretch, motion in zip(measured.data, measured.motions, strict=True)
                for t_s in (_divided(stretch.t_s, parts),)
            ]

    def law_torque(self, u: Floats) -> Floats:
        """Return the law's torque at the samples that count.

        Along a smooth motion the error of first order in the parts' length, half of which the speed is
        late, is extrapolated away from twice that length.
        """
        law = self._search.law(self._search.values(u))

        def torque(step: int) -> Floats:
            courses = [law.along(t_s[::step], x_rad[::step], 1e-9) for t_s, x_rad in self._courses]
            samples = [course.samples["torque_Nm"][:: self.parts // step] for course in courses]
            return np.asarray(np.concatenate(samples)[self._measured.used])

        return torque(1) if self.parts == 1 else 2.0 * torque(1) - torque(2)

    def residual(self, u: Floats) -> Floats:
        """Return the torque that neither the law nor inertia and bias explain."""
        e = self._measured.without_linear(self._measured.torque_Nm - self.law_torque(u))
        return np.where(np.isfinite(e), e, 1e6)

    def minimum(self, start: Floats, tolerance: float = 1e-8) -> Any:
        """Return scipy's least squares from a start, to a relative change of its cost and variables."""
        low, high = self._search.bounds
        return least_squares(
            self.residual,
            np.clip(start, low, high),
            bounds=(low, high),
            x_scale="jac",
            diff_step=1e-4,
            max_nfev=MOST_EVALUATIONS,
            ftol=tolerance,
            xtol=tolerance,
        )

    def explains(self, result: Any) -> bool:
        """Tell whether nothing of the torque is left."""
        return bool(result.cost <= NOTHING * float(self._measured.torque_Nm @ self._measured.torque_Nm))


def _divided(t_s: Floats, parts: int) -> Floats:
    """Return times `parts` times as fine."""
    return np.asarray(np.interp(np.arange((len(t_s) - 1) * parts + 1) / parts, np.arange(len(t_s)), t_s))


class _SmoothMotion:
    """The angle over the time [s]; the spline's samples are numbered, as cross-validation fails in seconds."""

    def __init__(self, stretch: Stretch) -> None:
        t, x = stretch.t_s, stretch.x_rad
        self._begin_s, self._period_s = t[0], float(np.median(np.diff(t)))
        number = (t - t[0]) / self._period_s
        self._spline = make_smoothing_spline(number, x) if len(t) >= LEAST_SPLINE else make_interp_spline(number, x, 1)

    def angle_rad(self, t_s: Floats) -> Floats:
        return np.asarray(self._spline((t_s - self._begin_s) / self._period_s))

    def acceleration_rad_s2(self, t_s: Floats) -> Floats:
        if self._spline.k < 2:
            return np.zeros_like(t_s)
        second = self._spline.derivative(2)
        return np.asarray(second((t_s - self._begin_s) / self._period_s) / self._period_s**2)
