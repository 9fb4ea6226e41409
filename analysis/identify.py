r"""Friction from a recording, by least squares: Coulomb, viscous, Stribeck where the data carry it, with confidence intervals.

While the handle slides, the hand's torque on it (the transducer's) is

.. math:: f = J\,\dot v + \bigl[c + b\,|v| + (F_s - c)\,e^{-(v/v_S)^2}\bigr]\,\mathrm{sgn}(v) + f_0

which is what the hand *feels*: the device's own friction, less what the motor compensates of it, plus whatever is displayed. With the motor's torque
(6077h) added to the left it is the *device's* friction, compensated or not. Both are fitted.

Samples. Only those slide that have :math:`|\hat v| > \Delta v` over a whole window, in one direction, during the display, and, where there are
enough, with the coil off. Speed and acceleration come from a quadratic through the window's positions (Savitzky-Golay), the torques go through the
same filter: an encoder's quantisation is averaged, not differentiated, and both sides of the equation are delayed alike. :math:`f_0` (the
transducer's bias) is fitted when both directions are there. :math:`v_S` is found on a grid, then refined (variable projection), and
Stribeck's term stays only if it lowers Schwarz's criterion clearly.

Confidence. Filtered residuals resemble their neighbours, so the covariance is Newey and West's, which counts that; the intervals are 95 %.

Sources: the paper, section 5 and Fig. 13; W. K. Newey, K. D. West, Econometrica 55(3):703-708, 1987, doi:10.2307/1913610.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.signal import savgol_filter

from eds.rig import Rig, load_rig
from lab.measures import phases
from lab.simulate import simulate
from scope.recording import Series, Source, blocks, series

__all__ = [
    "Estimate",
    "Fit",
    "FrictionStudy",
    "Identification",
    "IdentifyError",
    "fit_friction",
    "friction_study",
    "identify",
    "lines",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]

WINDOW_S = 0.021
"""Length of the window behind each sample's speed, acceleration and torques."""
COIL_OFF_S = 0.15
"""Set-point 0 for this long: the fluid has let go (from off it needs 54 ms to 95 %)."""
Z95 = 1.959963984540054
LEAST_SAMPLES = 100
STRIBECK_GAIN = 10.0
"""Schwarz's criterion must fall by this ("very strong" evidence) for Stribeck's term to stay."""
COMPENSATION = 0.97


class IdentifyError(ValueError):
    """The recording does not show friction: the text says what is missing."""

    exit_status = 1


@dataclass(frozen=True)
class Estimate:
    """A fitted value and its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:#.4g} [{self.low:#.4g}, {self.high:#.4g}]"


@dataclass(frozen=True)
class Fit:
    """Friction fitted to samples; None where the data do not carry it."""

    coulomb_Nm: Estimate
    viscous_Nms_rad: Estimate | None
    inertia_kg_m2: Estimate | None
    offset_Nm: Estimate | None
    stribeck_Nm: Estimate | None
    """F_s - c: what static friction has above Coulomb's."""
    stribeck_rad_s: float | None
    residual_rms_Nm: float

    def friction_Nm(self, v: Floats) -> Floats:
        """Return the fitted friction [Nm] at the speeds `v`, inertia and offset left out."""
        level = np.full_like(v, self.coulomb_Nm.value)
        if self.viscous_Nms_rad is not None:
            level += self.viscous_Nms_rad.value * np.abs(v)
        if self.stribeck_Nm is not None and self.stribeck_rad_s is not None:
            level += self.stribeck_Nm.value * np.exp(-((v / self.stribeck_rad_s) ** 2))
        friction: Floats = np.sign(v) * level
        return friction

    def as_dict(self) -> dict[str, Any]:
        """Return value and interval of each parameter."""
        found: dict[str, Any] = {}
        for name in ("coulomb_Nm", "viscous_Nms_rad", "inertia_kg_m2", "offset_Nm", "stribeck_Nm"):
            estimate = getattr(self, name)
            found[name] = None if estimate is None else estimate.value
            found[f"{name}_ci95"] = None if estimate is None else [estimate.low, estimate.high]
        return found | {"stribeck_rad_s": self.stribeck_rad_s, "residual_rms_Nm": self.residual_rms_Nm}


@dataclass(frozen=True)
class Identification:
    """What a recording says of friction."""

    path: str
    felt: Fit
    """What the hand feels at the handle."""
    device: Fit
    """The device's own: the motor's torque added."""
    samples: int
    coil_off: bool
    """True: only samples without brake were taken."""
    remarks: tuple[str, ...]
    v_rad_s: Floats
    felt_Nm: Floats
    """The samples, inertia and offset taken off; for the plot."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values: what is felt at the top, the device's under "device"."""
        return self.felt.as_dict() | {
            "device": self.device.as_dict(),
            "samples": self.samples,
            "coil_off": self.coil_off,
            "remarks": list(self.remarks),
        }


def _solve(X: Floats, y: Floats, lags: int) -> tuple[Floats, Floats, float]:
    """Return coefficients, their standard errors (Newey-West, Bartlett weights over `lags`) and the residuals' sum of squares."""
    scale = np.sqrt(np.mean(X**2, axis=0))
    Z = X / scale
    gram = Z.T @ Z
    beta = np.linalg.solve(gram, Z.T @ y)
    residual = y - Z @ beta
    scores = Z * residual[:, None]
    meat = scores.T @ scores
    for lag in range(1, min(lags, len(y) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (lags + 1)) * (cross + cross.T)
    inverse = np.linalg.inv(gram)
    covariance = inverse @ meat @ inverse * len(y) / max(len(y) - X.shape[1], 1)
    return beta / scale, np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale, float(residual @ residual)


def _refined(design: Callable[[float], Floats], torque: Floats, start: float) -> float:
    """Return the best v_S between half and twice the grid's."""
    found = minimize_scalar(
        lambda v_s: _solve(design(v_s), torque, 0)[2], bounds=(0.5 * start, 2 * start), method="bounded"
    )
    return float(found.x)


def fit_friction(v: Floats, a: Floats, torque: Floats, *, lags: int = 0, remarks: list[str] | None = None) -> Fit:
    """Fit friction to samples that slide.

    Parameters
    ----------
    v, a, torque : speed [rad/s], acceleration [rad/s2], torque [Nm] of each sample, in their order
    lags : how many samples residuals stay alike (twice the filter's window); 0: they are independent
    remarks : sentences on what the data do not carry are appended

    Raises
    ------
    IdentifyError
        fewer than `LEAST_SAMPLES` samples
    """
    notes = [] if remarks is None else remarks
    if len(v) < LEAST_SAMPLES:
        raise IdentifyError(
            f"{len(v)} samples slide; expected at least {LEAST_SAMPLES}: record strokes, to and fro, at two speeds or more"
        )
    sign = np.sign(v)
    columns: dict[str, Floats] = {"coulomb": sign}
    speed = np.abs(v)
    if np.std(speed) > 0.1 * np.mean(speed):
        columns["viscous"] = v
    else:
        notes.append("one speed only: viscous friction cannot be told from Coulomb's and is counted to it")
    if np.any(a != 0.0):
        columns["inertia"] = a
    if min(np.mean(sign > 0), np.mean(sign < 0)) > 0.1:
        columns["offset"] = np.ones_like(v)
    else:
        notes.append(
            "one direction only: a bias of the transducer cannot be told from Coulomb friction and is counted to it"
        )
    X = np.column_stack(list(columns.values()))
    beta, error, rss = _solve(X, torque, lags)
    independent = max(len(v) / (1 + lags), 2.0)

    def criterion(rss: float, parameters: int) -> float:
        return independent * math.log(max(rss, 1e-300) / len(v)) + parameters * math.log(independent)

    stribeck: tuple[float, float] | None = None
    if "viscous" in columns:
        candidates = np.geomspace(max(np.min(speed), 1e-6), 0.5 * np.max(speed), 24)
        trials = []
        for v_s in candidates:
            shape = sign * np.exp(-((v / v_s) ** 2))
            if np.mean(np.abs(shape) > 0.3) > 0.02:  # enough samples at low speed
                trials.append((_solve(np.column_stack([X, shape]), torque, 0)[2], v_s))
        best = min(trials, default=None)
        if best is not None and criterion(best[0], X.shape[1] + 2) < criterion(rss, X.shape[1]) - STRIBECK_GAIN:
            v_s = _refined(lambda v_s: np.column_stack([X, sign * np.exp(-((v / v_s) ** 2))]), torque, best[1])
            wide = np.column_stack([X, sign * np.exp(-((v / v_s) ** 2))])
            with_it, _, rss_with = _solve(wide, torque, lags)
            # v_S is fitted as well: its tangent belongs to what the covariance knows
            tangent = with_it[-1] * wide[:, -1] * 2 * v**2 / v_s**3
            _, error_with, _ = _solve(np.column_stack([wide, tangent]), torque, lags)
            if abs(with_it[-1]) > Z95 * error_with[-2]:
                beta, error, rss = with_it, error_with, rss_with
                stribeck = float(with_it[-1]), v_s
    if stribeck is None:
        notes.append("the data do not carry Stribeck's term")

    def estimate(name: str) -> Estimate | None:
        if name == "stribeck":
            i = len(beta) - 1
        elif name in columns:
            i = list(columns).index(name)
        else:
            return None
        return Estimate(float(beta[i]), float(beta[i] - Z95 * error[i]), float(beta[i] + Z95 * error[i]))

    coulomb = estimate("coulomb")
    assert coulomb is not None
    return Fit(
        coulomb_Nm=coulomb,
        viscous_Nms_rad=estimate("viscous"),
        inertia_kg_m2=estimate("inertia"),
        offset_Nm=estimate("offset"),
        stribeck_Nm=estimate("stribeck") if stribeck is not None else None,
        stribeck_rad_s=stribeck[1] if stribeck is not None else None,
        residual_rms_Nm=math.sqrt(rss / len(v)),
    )


def _nearest(series: Series, t: Floats, within_s: float) -> Floats:
    """Return the series' values nearest to `t`, NaN where none is `within_s`."""
    if not len(series):
        return np.full(len(t), np.nan)
    after = np.clip(np.searchsorted(series.t_s, t), 1, max(len(series) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(series) - 1)
    closer = np.where(np.abs(series.t_s[before] - t) <= np.abs(series.t_s[after] - t), before, after)
    values: Floats = np.asarray(series.values, np.float64)[closer]
    return np.where(np.abs(series.t_s[closer] - t) <= within_s, values, np.nan)


def _held(series: Series, t: Floats) -> Floats:
    """Return the series' last value at or before `t`, 0 before its first."""
    if not len(series):
        return np.zeros(len(t))
    last = np.searchsorted(series.t_s, t, side="right") - 1
    return np.where(last >= 0, np.asarray(series.values, np.float64)[np.maximum(last, 0)], 0.0)


def _lasting(flags: Flags, before: int, after: int) -> Flags:
    """Return where `flags` has been true for `before` samples, and stays so for `after` more."""
    total = np.concatenate(([0], np.cumsum(~flags)))
    index = np.arange(len(flags))
    first, last = np.maximum(index - before, 0), np.minimum(index + after + 1, len(flags))
    lasting: Flags = (total[last] == total[first]) & (index >= before) & (index + after < len(flags))
    return lasting


def identify(recording: Source | str | Path, *, window_s: float = WINDOW_S) -> Identification:
    """Identify friction from a recording (or its path): any run in which the handle slides.

    Raises
    ------
    IdentifyError
        the handle hardly slides, or there is no transducer's signal
    """
    if isinstance(recording, str | Path):
        recording = blocks(recording)
    period = recording.rig.bus.period_s
    half = max(round(0.5 * (window_s / period - 1)), 2)
    angle, transducer, drive_torque, setpoint = series(
        recording, "motor.position_rad", "brake.handle_torque_Nm", "motor.torque_Nm", "brake.setpoint_Nm"
    )
    if len(angle) < 4 * half:
        raise IdentifyError(f"{recording.path}: {len(angle)} samples of motor.position_rad; record a run with strokes")
    t = angle.t_s
    if any(np.any(np.diff(one.t_s) < 0.0) for one in (angle, transducer, drive_torque, setpoint)):
        raise IdentifyError(
            f"{recording.path}: its stamps go back, as in a file joined from several; sort it with 'reordercap IN OUT', or take one run"
        )
    count = abs(recording.scale("motor.position_rad"))
    handle = _nearest(transducer, t, 0.5 * period)
    motor = _nearest(drive_torque, t, 0.5 * period)
    counts = np.rint(np.diff(angle.values, prepend=angle.values[0]) / count)
    even = np.abs(np.diff(t, prepend=t[0] - period) - period) < 0.5 * period
    band = recording.rig.law.velocity_band_counts
    usable = even & np.isfinite(handle) & np.isfinite(motor)
    spans = phases(recording)
    if spans:  # not what comes before or after the display
        usable &= (t >= spans[0].begin_s) & (t < spans[-1].end_s)
    sliding = _lasting(usable & (counts > band), half, half) | _lasting(usable & (counts < -band), half, half)
    off = _lasting(_held(setpoint, t) == 0.0, round(COIL_OFF_S / period), half)
    coil_off = int(np.sum(sliding & off)) >= LEAST_SAMPLES
    notes: list[str] = []
    if coil_off:
        sliding &= off
    elif np.any(sliding):
        notes.append("hardly a sample slides with the coil off: what is felt includes the brake's display")
    if np.sum(sliding) < LEAST_SAMPLES:
        raise IdentifyError(
            f"{recording.path}: {int(np.sum(sliding))} samples slide with |v| > {band} counts a cycle; expected at least "
            f"{LEAST_SAMPLES}: record strokes, to and fro, at two speeds or more"
        )
    size = 2 * half + 1

    def smooth(values: Floats, order: int) -> Floats:
        whole = np.where(np.isfinite(values), values, 0.0)
        filtered: Floats = savgol_filter(whole, size, 2, deriv=order, delta=period)[sliding]
        return filtered

    v, a = smooth(angle.values, 1), smooth(angle.values, 2)
    hand, drive = smooth(handle, 0), smooth(motor, 0)
    felt = fit_friction(v, a, hand, lags=2 * size, remarks=notes)
    device = fit_friction(v, a, hand + drive, lags=2 * size)
    rest = hand.copy()
    if felt.inertia_kg_m2 is not None:
        rest -= felt.inertia_kg_m2.value * a
    if felt.offset_Nm is not None:
        rest -= felt.offset_Nm.value
    return Identification(
        path=recording.path,
        felt=felt,
        device=device,
        samples=int(np.sum(sliding)),
        coil_off=coil_off,
        remarks=tuple(notes),
        v_rad_s=v,
        felt_Nm=rest,
    )


def lines(found: Identification) -> list[str]:
    """Return an identification as text: each parameter with its 95 % confidence interval."""
    names = (
        ("Coulomb", "coulomb_Nm", "Nm"),
        ("viscous", "viscous_Nms_rad", "Nm s/rad"),
        ("Stribeck, F_s - c", "stribeck_Nm", "Nm"),
        ("inertia", "inertia_kg_m2", "kg m2"),
        ("transducer's bias", "offset_Nm", "Nm"),
    )
    text = [f"{found.samples} samples slide, {'coil off' if found.coil_off else 'brake on'}; 95 % confidence intervals"]
    for title, fit in (("felt at the handle", found.felt), ("the device's own (motor's torque added)", found.device)):
        text.append(f"\n{title}:")
        for name, attribute, unit in names:
            estimate = getattr(fit, attribute)
            if estimate is not None:
                speed = f" at {fit.stribeck_rad_s:.3g} rad/s" if attribute == "stribeck_Nm" else ""
                text.append(f"  {name:<18} {estimate} {unit}{speed}")
        text.append(f"  {'residual, RMS':<18} {fit.residual_rms_Nm:.3g} Nm")
    return text + [f"\nnote: {remark}" for remark in found.remarks]


@dataclass(frozen=True)
class FrictionStudy:
    """Fig. 13: friction at the handle, identified, compensated from what was identified, identified again."""

    before: Identification
    after: Identification
    compensation_Nm: float
    """What the motor was told to give in slip."""

    @property
    def coulomb_before_Nm(self) -> float:
        """Coulomb friction felt without compensation."""
        return self.before.felt.coulomb_Nm.value

    @property
    def coulomb_after_Nm(self) -> float:
        """Coulomb friction felt with the compensation."""
        return self.after.felt.coulomb_Nm.value

    @property
    def viscous_Nms_rad(self) -> float:
        """Viscous friction felt without compensation."""
        found = self.before.felt.viscous_Nms_rad
        return math.nan if found is None else found.value

    def as_dict(self) -> dict[str, Any]:
        """Return the figures of `coulombus analyse --json`, and both identifications."""
        return {
            "coulomb_before_Nm": self.coulomb_before_Nm,
            "coulomb_after_Nm": self.coulomb_after_Nm,
            "viscous_Nms_rad": self.viscous_Nms_rad,
            "compensation_Nm": self.compensation_Nm,
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
        }


STROKES = (
    (0.5, 1.2),
    (1.5, 0.8),
    (3.0, 0.6),
)  # speed [rad/s], length of a move [s]: slow ones tell Coulomb, fast ones the slope
EXPERIMENT = ", ".join(
    ["{kind='rest', duration_s=1.0}"]
    + [
        f"{{kind='stroke', duration_s={4 * (move + 0.1):g}, speed_rad_s={speed}, move_s={move}, dwell_s=0.1}}"
        for speed, move in STROKES
    ]
)


def _stroked(rig: Rig, directory: Path, name: str, seed: int) -> Identification:
    path = directory / f"{name}.pcapng"
    result = simulate(rig, "hybrid", sum(p.duration_s for p in rig.phases), record=path, seed=seed)
    if result.trip is not None:
        raise RuntimeError(f"identification experiment ({name}): the run tripped: {result.trip}")
    return identify(path)


def friction_study(rig: Rig | None = None, *, seed: int = 0) -> FrictionStudy:
    """Run the identification experiment before and after the compensation, through PDOs with the quantised encoder.

    The hand strokes the handle to and fro at three speeds, in mode hybrid with F_s = F_d = 0: the brake's coil is off, so what is felt is the
    device's own friction, the brake's off-state torque included. The first run compensates nothing. In the second one the motor gives
    97 % of the Coulomb friction that the first one identified - of the motor, nothing is known but that value.

    Parameters
    ----------
    rig : default is the bench rig; its own schedule is not used
    """
    rig = (load_rig("bench") if rig is None else rig).variant(
        f"phase=[{EXPERIMENT}]", "mode.hybrid.F_s_Nm=0.0", "mode.hybrid.F_d_Nm=0.0", "mode.hybrid.compensation=0.0"
    )
    with tempfile.TemporaryDirectory(prefix="coulombus-") as directory:
        before = _stroked(rig, Path(directory), "before", seed)
        found = before.felt.coulomb_Nm.value
        compensated = rig.variant(
            f"mechanics.friction_Nm={found!r}",
            f"mode.hybrid.compensation={COMPENSATION}",
            f"mode.hybrid.motor_limit_Nm={1.2 * found!r}",
        )
        after = _stroked(compensated, Path(directory), "after", seed)
    return FrictionStudy(before, after, COMPENSATION * found)
