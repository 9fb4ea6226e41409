r"""Step "response": the brake's response to a step of its set-point, coil and fluid, at the hand.

A hand strokes the handle while the brake is switched on and off. Two lags in series are fitted to the
hand's torque. The 95 % intervals of the two time constants include that of the inertia, and
the hysteresis of the brake's table: iron that remembers a share of the torque follows later than the coil. A
remark says whether they may be equal within their intervals.

In slip the hand bears the device's friction, the inertia and the brake,

.. math:: f - J\,\dot v = \mathrm{sgn}(v)\,(c + b\,|v| + D\,B(t)) + f_0 + A \sin(\kappa x + \varphi),

where B is the recorded set-point, delayed by d from the SYNC before it was sent, after two lags,

.. math:: \frac{B(s)}{u(s)} = \frac{e^{-d s}}{1 + S s + P s^2}, \quad S = \tau_c + \tau_f, \; P = \tau_c \tau_f.

B is computed along the whole recording. Both sides pass the same filter (`recording.friction.equations`), so
inertia and torque are smoothed in the same way. Least squares fits d, S and :math:`q = 4 P/S^2`; the other
coefficients follow by variable projection (G. H. Golub, V. Pereyra, SIAM Journal on Numerical Analysis
10(2):413-432, 1973, doi:10.1137/0710036). For equal lags (q = 1) the model is smooth in S and q, but not in
the time constants,

.. math:: \tau_{f,c} = \tfrac{S}{2} \bigl(1 \pm \sqrt{\max(1 - q, 0)}\bigr).

So their intervals are computed from draws of the normal distribution of (d, S, q). Its covariance is that
of clusters, one for each stroke, with the model's tangents as columns (`recording.friction.regression`), plus
the effect of the inertia's own interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter
from scipy.special import stdtrit

from coulombus.host.commission.brake import STROKING_HAND
from coulombus.host.commission.samples import Floats, held, sync_before, thinned
from coulombus.host.commission.step import (
    INERTIA,
    TABLE,
    CommissionError,
    Curve,
    Exercise,
    ExerciseResult,
    Finding,
    Given,
    Outcome,
    Risk,
    Step,
    exercise,
    lacks_roles,
    move_s,
    rounded,
    strokes,
)
from coulombus.host.cycle.output_limits import brake_end_Nm
from coulombus.recording.friction.equations import Equations, equations
from coulombus.recording.friction.regression import covariance_of, solve
from coulombus.recording.friction.sliding import IdentifyError, Slide, one_sense, runs, signals
from coulombus.recording.signals import Recording, Series
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["LagFit", "ResponseStep", "step_answer"]

BRAKE_NM, HALF_S, SECONDS = 0.6, 0.187, 24.0
"""The number of steps in a stroke is not an integer, so each step falls on another angle."""
SPEED_RAD_S, MOVE_S, DWELL_S = 1.5, 1.5, 0.1
WINDOW_S = 0.021
SKIP_S, MARGIN_S = 0.5, 0.01
LEAST_STEPS = 12
LEAST_ROWS = 400
DRAWS, SEED = 4000, 0
LOW, HIGH = (0.0, 5e-4, 1e-3), (0.03, 0.3, 2.0)
"""Bounds of d [s], S [s] and q."""
STARTS = ((1e-3, 0.012, 0.8), (1e-3, 0.025, 0.4))
CURVE_S = 0.15
TOGETHER = 0.025
"""Share of draws with equal lags above which the two lags cannot be distinguished."""


class ResponseStep(Step):
    """The brake's step response."""

    name = "response"
    title = "brake's answer to a step: delay, coil, fluid"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role that the rig lacks, or None."""
        return lacks_roles(axis, "handle_torque")

    def _brake(self, axis: Axis) -> float:
        return min(BRAKE_NM, axis.limits.brake_torque_Nm)

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the brake's torque and the operator's strokes."""
        return Risk(
            "The brake is switched on and off five times in two seconds.",
            brake_Nm=self._brake(axis),
            speed_rad_s=SPEED_RAD_S,
            travel_rad=SPEED_RAD_S * move_s(axis, SPEED_RAD_S, MOVE_S),
            seconds=SECONDS,
            operator=f"Stroke the handle to and fro, about {SPEED_RAD_S:g} rad/s, "
            f"{move_s(axis, SPEED_RAD_S, MOVE_S):g} s each way, with a firm hand that does not give way to the brake.",
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the run with the steps."""
        move = move_s(rig.one_axis(), SPEED_RAD_S, MOVE_S)
        stroke = strokes(SECONDS, SPEED_RAD_S, move, DWELL_S)
        user = [0.0, HALF_S, self._brake(rig.one_axis())]
        return (exercise(self.name, rig, "square", user, [stroke], hand=STROKING_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return times and time constants; the rig file has no key for them."""
        mechanics = axis.mechanics
        wave_rad = mechanics.cogging_periods * mechanics.ratio if mechanics.cogging_Nm > 0 else None
        fit = fit_lags(runs[0].recording, mechanics.inertia_kg_m2, inputs.share(INERTIA), wave_rad)
        iron_share = inputs.share(TABLE) * brake_end_Nm(axis) / self._brake(axis)
        basis = f"{fit.samples} samples in slip, inertia {mechanics.inertia_kg_m2:g} kg m2 taken off"
        findings = tuple(
            Finding("", name, None, rounded(1e3 * value, 1e3 * reach), "ms", 1e3 * reach, basis)
            for name, (value, reach) in fit.figures(iron_share).items()
        )
        remarks = inputs.exact({"the inertia (step friction)": (INERTIA,), "the brake's table (step brake)": (TABLE,)})
        if fit.together:
            remarks += ("coil and fluid cannot be told apart: their lags may be equal within the intervals",)
        t = np.linspace(0.0, float(fit.curve[0][-1]), 200)
        lines = {
            "measured": (*thinned(1e3 * fit.curve[0], fit.curve[1]), "."),
            "two lags": (*thinned(1e3 * t, step_answer(t, *fit.best)), "-"),
        }
        curve = Curve("Brake's answer to a step", "time since the SYNC before [ms]", "share", lines)
        return Outcome(findings, remarks, (curve,))


def step_answer(t: Floats, delay_s: float, total_s: float, q: float) -> Floats:
    """Return the response of the two lags to a step of 1 at time 0."""
    s = np.maximum(t - delay_s, 0.0)
    spread = np.sqrt(complex(1.0 - min(max(q, 1e-6), 4.0)))
    if abs(spread) < 1e-4:
        spread = complex(1e-4)
    slow, fast = 0.5 * total_s * (1 + spread), 0.5 * total_s * (1 - spread)
    answer: Floats = np.real(1 - (slow * np.exp(-s / slow) - fast * np.exp(-s / fast)) / (slow - fast))
    return answer


@dataclass(frozen=True)
class LagFit:
    """Result of the fit.

    Attributes
    ----------
    best : delay d [s], sum of the time constants S [s], q
    covariance : covariance of `best`
    samples : number of sliding samples
    curve : times since the SYNC [s] and shares, the mean of the upward steps
    """

    best: Floats
    covariance: Floats
    samples: int
    curve: tuple[Floats, Floats]

    @cached_property
    def draws(self) -> Floats:
        """Draws from the normal distribution of `best`, shape (3, n)."""
        rng = np.random.default_rng(SEED)
        drawn = rng.multivariate_normal(self.best, self.covariance, DRAWS, method="eigh").T
        return np.clip(drawn, np.array(LOW)[:, None], np.array([1.0, 1.0, 4.0])[:, None])

    @property
    def together(self) -> bool:
        """Whether the two time constants may be equal."""
        return bool(np.mean(self.draws[2] >= 1.0) > TOGETHER)

    def figures(self, iron_share: float = 0.0) -> dict[str, tuple[float, float]]:
        """Return each time [s] with half of its 95 % interval.

        `iron_share`: share of the torque by which the brake's iron remembers. That share follows the coil later, by
        about the coil's time, which the recording does not tell from a delay: so the intervals include it.
        """
        names: dict[str, Callable[[float, float, float], float]] = {
            "brake: 63 % after": lambda delay, total, q: _reached(1 - math.exp(-1), delay, total, q),
            "brake: 95 % after": lambda delay, total, q: _reached(0.95, delay, total, q),
            "brake: delay": lambda delay, total, q: delay,
            "brake: faster lag (coil)": lambda delay, total, q: 0.5 * total * (1 - math.sqrt(max(1 - q, 0.0))),
            "brake: slower lag (fluid)": lambda delay, total, q: 0.5 * total * (1 + math.sqrt(max(1 - q, 0.0))),
        }
        late_s = iron_share * names["brake: faster lag (coil)"](*self.best)
        figures = {}
        for name, figure in names.items():
            value = float(figure(*self.best))
            every = self.draws.T if "after" not in name else self.draws.T[: DRAWS // 20]
            low, high = np.percentile([figure(*draw) for draw in every], (2.5, 97.5))
            figures[name] = value, math.hypot(float(max(high - value, value - low)), late_s)
        return figures


def _reached(share: float, delay: float, total: float, q: float) -> float:
    t = np.linspace(0.0, delay + 8 * total, 2000)
    return float(np.interp(share, step_answer(t, delay, total, q), t))


@dataclass(frozen=True)
class _Rows:
    """Data of the regression."""

    rows: Equations
    slides: tuple[Slide, ...]
    first: tuple[int, ...]
    """Index of the first sample of each slide."""
    setpoint: Floats
    """Set-point at the SYNC of each sample of the recording [Nm]."""
    period_s: float
    linear: Floats
    """Columns that do not depend on the lags."""

    def brake(self, parameters: Floats) -> Floats:
        """Return the column of the brake's torque for (d, S, q)."""
        course = _lagged(self.setpoint, self.period_s, *parameters)
        parts = [course[k : k + len(slide.t_s)] for k, slide in zip(self.first, self.slides, strict=True)]
        return np.sign(self.rows.v) * self.rows.smooth(parts)


def _lagged(u: Floats, period_s: float, delay_s: float, total_s: float, q: float) -> Floats:
    """Return the set-point after delay and lags, at the SYNCs."""
    whole, part = divmod(delay_s / period_s, 1.0)
    late = np.concatenate([np.full(int(whole) + 1, u[0]), u])
    end = len(late)
    shifted = (1 - part) * late[1:end][: len(u)] + part * late[: end - 1][: len(u)]
    product = 0.25 * q * total_s**2
    numerator, denominator, _ = cont2discrete(([1.0], [product, total_s, 1.0]), period_s)
    answer: Floats = lfilter(np.ravel(numerator), denominator, shifted)
    return answer


def _gathered(recording: Recording, wave_rad: float | None) -> _Rows:
    """Return the data of the regression.

    Raises
    ------
    CommissionError
        the handle slides through too few steps
    """
    period = recording.rig.bus.period_s
    try:
        seen = signals(recording)
    except IdentifyError as error:
        raise CommissionError(str(error)) from error
    setpoints = recording["brake.setpoint_Nm"]
    sampled, sent = sync_before(recording, seen.t), sync_before(recording, setpoints.t_s)
    setpoint = held(Series(sent, setpoints.values, setpoints.unit), sampled + 1e-9)
    moves, sense = one_sense(seen.moved, period, seen.count_rad)
    good = seen.shown & np.isfinite(seen.x) & np.isfinite(seen.hand) & moves
    good &= np.abs(np.diff(seen.t, prepend=seen.t[:1] - period) - period) < 0.5 * period
    margin = round(MARGIN_S / period)
    edges = [(a + margin, b - margin) for a, b in runs(good) if b - a > 4 * margin]
    begin = seen.t[0] + SKIP_S
    spans = [(a, b) for a, b in edges if seen.t[a] > begin and np.ptp(sense[a:b]) == 0.0]
    jumps = np.abs(np.diff(setpoint)) > 0.5 * np.ptp(setpoint) + 1e-9
    steps = sum(int(np.sum(jumps[a:b])) for a, b in spans)
    slides = tuple(Slide(seen.t[a:b], seen.x[a:b], seen.hand[a:b], seen.motor[a:b]) for a, b in spans)
    if steps < LEAST_STEPS:
        raise CommissionError(
            f"the handle slid through {steps} steps; expected {LEAST_STEPS}: stroke it with a firmer hand"
        )
    rows = equations(slides, period, seen.count_rad, WINDOW_S)
    if len(rows.v) < LEAST_ROWS or rows.v.min() >= 0 or rows.v.max() <= 0:
        raise CommissionError("the handle slid too little, or in one sense alone: stroke it to and fro")
    size = len(rows.weight)
    long = [(slide, a) for slide, (a, _) in zip(slides, spans, strict=True) if len(slide.t_s) >= size]
    linear = [np.sign(rows.v), rows.v, np.ones_like(rows.v)]
    if wave_rad is not None:
        linear += [rows.smooth([wave(wave_rad * slide.x_rad) for slide, _ in long]) for wave in (np.sin, np.cos)]
    return _Rows(rows, tuple(s for s, _ in long), tuple(a for _, a in long), setpoint, period, np.column_stack(linear))


def _best(gathered: _Rows, torque: Floats, starts: tuple[tuple[float, ...], ...]) -> tuple[Floats, float]:
    """Return the (d, S, q) with the smallest residual, and the brake's coefficient."""
    base, _ = np.linalg.qr(gathered.linear)
    left = torque - base @ (base.T @ torque)

    def projected(parameters: Floats) -> tuple[Floats, float]:
        column = gathered.brake(parameters)
        column = column - base @ (base.T @ column)
        size = float(column @ left) / max(float(column @ column), 1e-12)
        return left - size * column, size

    fits = [
        least_squares(lambda p: projected(p)[0], start, bounds=(LOW, HIGH), x_scale=(1e-3, 1e-2, 0.3))
        for start in starts
    ]
    best = min(fits, key=lambda fit: float(fit.cost)).x
    return np.asarray(best, np.float64), projected(best)[1]


def fit_lags(recording: Recording, inertia: float, inertia_share: float, wave_rad: float | None) -> LagFit:
    """Fit delay and lags.

    Parameters
    ----------
    inertia : inertia at the handle [kg m2]
    inertia_share : relative 95 % reach of the inertia
    wave_rad : phase of the motor's cogging per rad of the handle; None: no cogging

    Raises
    ------
    CommissionError
        the recording does not permit the fit
    """
    gathered = _gathered(recording, wave_rad)
    rows = gathered.rows
    torque = rows.hand_Nm - inertia * rows.a
    best, size = _best(gathered, torque, STARTS)
    if not size > 0.05:
        raise CommissionError("the brake has hardly answered: is the coil connected, and the hand firm?")
    tangents = []
    for j, step in enumerate((1e-5, 1e-5, 1e-3)):
        shift = np.eye(3)[j] * step * (1 if best[j] + step <= HIGH[j] else -1)
        tangents.append(size * (gathered.brake(best + shift) - gathered.brake(best)) / shift[j])
    columns = np.column_stack([gathered.linear, gathered.brake(best), *tangents])
    variances = np.zeros(columns.shape[1])
    variances[1] = rows.v_variance
    try:
        solution = solve(columns, torque, variances)
    except IdentifyError as error:
        raise CommissionError(str(error)) from error
    strokes = np.split(np.arange(len(torque)), np.flatnonzero(np.diff(rows.slide)) + 1)
    student = float(stdtrit(max(len(strokes) - 1, 2), 0.975)) / 1.96
    covariance = student**2 * covariance_of(solution, strokes)[-3:, -3:]
    moved, _ = _best(gathered, torque - inertia * inertia_share * rows.a, (tuple(best),))
    covariance = covariance + np.outer(moved - best, moved - best) / 1.96**2
    rest = np.sign(rows.v) * (torque - gathered.linear @ (solution.beta / solution.scale)[: gathered.linear.shape[1]])
    return LagFit(best, covariance, sum(len(s.t_s) for s in gathered.slides), _curve(gathered, rest / size))


def _curve(gathered: _Rows, share: Floats) -> tuple[Floats, Floats]:
    """Return the mean response to the upward steps, for the figure."""
    rows, period, half = gathered.rows, gathered.period_s, len(gathered.rows.weight) // 2
    counts = [(len(slide.t_s) - len(rows.weight)) // rows.hop + 1 for slide in gathered.slides]
    at = np.concatenate(
        [first + half + rows.hop * np.arange(n) for first, n in zip(gathered.first, counts, strict=True)]
    )
    jumps = np.diff(gathered.setpoint)
    lags, shares = [], []
    for edge in 1 + np.flatnonzero(jumps > 0.5 * np.ptp(gathered.setpoint) + 1e-9):
        inside = (at >= edge) & (at < edge + round(CURVE_S / period))
        lags.append((at[inside] - edge) * period)
        shares.append(share[inside] / np.ptp(gathered.setpoint))
    t, y = np.concatenate(lags), np.concatenate(shares)
    bins = np.unique(t)
    return bins, np.array([float(np.mean(y[t == time])) for time in bins])
