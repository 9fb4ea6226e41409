r"""Magnetic hysteresis of the brake's iron from a recording: play operators, their weights, the fluid's lag.

While the handle slides, the torque of hand and motor is

.. math:: f + \tau_m = \Bigl[g\,\Lambda_\tau\bigl(w_0 c + \sum_j w_j P_j(c)\bigr) + F_c\Bigr]
          \mathrm{sgn}(v) + b v + J \dot v + f_0

with the coil's torque :math:`c` (the set-points after the modelled lag of the coil), the play operators
:math:`P_j` of half plays :math:`r_j`, and the fluid's lag :math:`\Lambda_\tau`. For given :math:`r_j`
and :math:`\tau` the problem is linear, with non-negative weights (variable projection). A grid of
plays finds their number; the remaining plays are then moved to the least residual.

The brake's set-point must rise and fall while the handle slides. Encoder and torques pass one
filter (`recording.friction.sliding`). The iron starts demagnetised.

Sources: K. Kuhnen, European Journal of Control 9(4), 2003, doi:10.3166/ejc.9.407-418; G. Golub,
V. Pereyra, Inverse Problems 19(2), 2003, doi:10.1088/0266-5611/19/2/201.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares, lsq_linear

from coulombus.recording.friction.equations import Equations, equations
from coulombus.recording.friction.sliding import REVERSAL_S, WINDOW_S, IdentifyError, Slide, runs, signals, since
from coulombus.recording.signals import Source

__all__ = ["IronFit", "identify_iron", "iron_lines", "play"]

Floats: TypeAlias = npt.NDArray[np.float64]

GRID = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Half plays to try, relative to the largest set-point."""
LEAST_WEIGHT = 0.01
"""Least weight of an operator."""
LAGS_S = (1e-4, 0.1)
START_LAG_S = 0.015
LEAST_SAMPLES = 500
LEAST_SWING_NM = 0.1
NOTHING = 0.005
"""Least hysteresis relative to the torque."""


@dataclass(frozen=True)
class IronFit:
    """The brake's iron and fluid, fitted to a recording."""

    play_Nm: tuple[float, ...]
    weights: tuple[float, ...]
    gain: float
    """Torque at the handle per Nm of the set-point, once the iron has followed."""
    fluid_lag_s: float
    coulomb_Nm: float
    viscous_Nms_rad: float
    residual_rms_Nm: float
    residual_without_Nm: float
    """The same without hysteresis."""
    samples: int

    def as_dict(self) -> dict[str, Any]:
        """Return plain values: the keys of [brake.iron] under "iron"."""
        return {
            "iron": {"play_Nm": list(self.play_Nm), "weights": list(self.weights)},
            "gain": self.gain,
            "fluid_lag_s": self.fluid_lag_s,
            "coulomb_Nm": self.coulomb_Nm,
            "viscous_Nms_rad": self.viscous_Nms_rad,
            "residual_rms_Nm": self.residual_rms_Nm,
            "residual_without_Nm": self.residual_without_Nm,
            "samples": self.samples,
        }


def play(coil_Nm: Floats, r_Nm: float) -> Floats:
    """Return the output of a play operator of half play `r_Nm` for the coil's torque, starting at 0."""
    out, y = np.empty(len(coil_Nm)), 0.0
    for k, c in enumerate(coil_Nm.tolist()):
        y = max(c - r_Nm, min(c + r_Nm, y))
        out[k] = y
    return out


def _lagged(values: Floats, lag_s: float, period_s: float) -> Floats:
    share = 1.0 - np.exp(-period_s / lag_s) if lag_s > 0 else 1.0
    from scipy.signal import lfilter  # slow to load

    lagged: Floats = np.asarray(lfilter([share], [1.0, share - 1.0], values), np.float64)
    return lagged


@dataclass(frozen=True)
class _CoilEquations:
    """The equations and the coil's torque for them."""

    rows: Equations
    spans: tuple[tuple[int, int], ...]
    senses: tuple[float, ...]
    coil_Nm: Floats
    period_s: float
    y: Floats

    def column(self, course: Floats) -> Floats:
        """Return a signal over all cycles as a column of the equations."""
        return self.rows.smooth([s * course[a:b] for (a, b), s in zip(self.spans, self.senses, strict=True)])

    def solve(self, plays: Floats, lag_s: float) -> tuple[Floats, Floats]:
        """Return the linear unknowns (direct term, plays, F_c, b, J, f_0) and the residual."""
        courses = [self.coil_Nm, *(play(self.coil_Nm, float(r)) for r in plays)]
        columns = [self.column(_lagged(course, lag_s, self.period_s)) for course in courses]
        columns += [self.column(np.ones(len(self.coil_Nm))), self.rows.v, self.rows.a, np.ones(len(self.y))]
        X = np.column_stack(columns)
        sizes = np.maximum(np.linalg.norm(X, axis=0), 1e-12)
        low = np.zeros(X.shape[1])
        low[-1] = -np.inf
        solution = lsq_linear(X / sizes, self.y, (low, np.inf), method="bvls")
        return solution.x / sizes, X @ (solution.x / sizes) - self.y


def _data(recording: Source) -> _CoilEquations:
    axis, period = recording.rig.one_axis(), recording.rig.bus.period_s
    seen = signals(recording)
    whole = np.isfinite(seen.x) & np.isfinite(seen.hand) & np.isfinite(seen.motor)
    even = np.abs(np.diff(seen.t, prepend=seen.t[:1] - period) - period) < 0.5 * period
    good = seen.shown & whole & even & (np.abs(seen.moved) > axis.law.velocity_band_counts)
    one_way = good & np.concatenate(([False], seen.moved[1:] * seen.moved[:-1] > 0.0))
    settled = since(one_way) >= round(REVERSAL_S / period)
    size = 2 * max(round(0.5 * (WINDOW_S / period - 1)), 2) + 1
    spans = tuple((a, b) for a, b in runs(settled) if b - a >= size)
    count = sum(b - a for a, b in spans)
    used = np.concatenate([seen.brake[a:b] for a, b in spans]) if spans else np.zeros(1)
    if count < LEAST_SAMPLES or float(np.ptp(used)) < LEAST_SWING_NM:
        raise IdentifyError(
            f"{recording.path}: {count} samples slide, and the brake's set-point goes from {used.min():.3g} to {used.max():.3g} Nm "
            f"meanwhile; expected at least {LEAST_SAMPLES}, and set-points that change by {LEAST_SWING_NM:g} Nm, up and down: record "
            "strokes of changing speed in mode passive with --law viscous"
        )
    slides = tuple(Slide(seen.t[a:b], seen.x[a:b], seen.hand[a:b], seen.motor[a:b]) for a, b in spans)
    rows = equations(slides, period, seen.count_rad)
    coil = _lagged(np.asarray(seen.brake, np.float64), axis.brake.coil_lag_s, period)
    senses = tuple(float(np.sign(seen.moved[a])) for a, _ in spans)
    return _CoilEquations(rows, spans, senses, coil, period, rows.hand_Nm + rows.motor_Nm)


def identify_iron(recording: Source) -> IronFit:
    """Identify the brake's magnetic hysteresis.

    Raises
    ------
    coulombus.recording.friction.sliding.IdentifyError
        there is no transducer, the handle hardly slides, or the set-point hardly changes
    """
    data = _data(recording)
    lag = recording.rig.one_axis().brake.fluid_lag_s or START_LAG_S

    def moved(u: Floats) -> Floats:
        return data.solve(np.exp(u[1:]), float(np.exp(u[0])))[1]

    def best(plays: Floats, lag_s: float) -> Any:
        ends = [np.log(LAGS_S[0])] + [-12.0] * len(plays), [np.log(LAGS_S[1])] + [5.0] * len(plays)
        start = np.clip(np.log([lag_s, *plays]), np.array(ends[0]) + 1e-6, np.array(ends[1]) - 1e-6)
        return least_squares(moved, start, bounds=ends, diff_step=1e-3, max_nfev=30)

    plain = best(np.zeros(0), lag)
    grid = np.array(GRID) * float(data.coil_Nm.max())
    unknowns, _ = data.solve(grid, float(np.exp(plain.x[0])))
    share = unknowns[1 : 1 + len(grid)] / max(float(np.sum(unknowns[: 1 + len(grid)])), 1e-12)
    groups: list[list[int]] = []
    for k in np.flatnonzero(share > LEAST_WEIGHT).tolist():  # neighbours on the grid are one operator
        if groups and k == groups[-1][-1] + 1 and len(groups[-1]) < 2:
            groups[-1].append(k)
        else:
            groups.append([k])
    plays = np.array([np.exp(np.average(np.log(grid[g]), weights=share[g])) for g in groups])
    fit = best(plays, float(np.exp(plain.x[0])))
    plays, lag = np.exp(fit.x[1:]), float(np.exp(fit.x[0]))
    unknowns, rest = data.solve(plays, lag)
    gain = float(np.sum(unknowns[: 1 + len(plays)]))
    order = [int(k) for k in np.argsort(plays) if unknowns[1 + k] > LEAST_WEIGHT * gain]
    without = float(np.sqrt(np.mean(plain.fun**2)))
    residual = float(np.sqrt(np.mean(rest**2)))
    if without - residual < NOTHING * float(np.sqrt(np.mean(data.y**2))) or gain <= 0.0:
        order = []
    weights = [float(unknowns[1 + k]) / gain for k in order]
    return IronFit(
        play_Nm=tuple(float(f"{plays[k]:.4g}") for k in order),
        weights=tuple(float(f"{weight:.4g}") for weight in weights),
        gain=gain,
        fluid_lag_s=lag,
        coulomb_Nm=float(unknowns[-4]),
        viscous_Nms_rad=float(unknowns[-3]),
        residual_rms_Nm=residual,
        residual_without_Nm=without,
        samples=sum(b - a for a, b in data.spans),
    )


def iron_lines(fit: IronFit) -> list[str]:
    """Return a fit as text, with the rig file's section."""
    text = [f"{fit.samples} samples slide; residual, RMS: {fit.residual_rms_Nm:.3g} Nm with hysteresis, "
            f"{fit.residual_without_Nm:.3g} Nm without"]  # fmt: skip
    text.append(f"torque for each Nm of the set-point {fit.gain:.4g}, fluid's lag {fit.fluid_lag_s * 1e3:.3g} ms")
    text.append(f"Coulomb {fit.coulomb_Nm:.4g} Nm, viscous {fit.viscous_Nms_rad:.3g} Nm s/rad")
    if not fit.play_Nm:
        return [*text, "no hysteresis is seen: no [brake.iron] is needed"]
    plays, weights = (", ".join(map(str, values)) for values in (fit.play_Nm, fit.weights))
    return [*text, "", "[brake.iron]", f"play_Nm = [{plays}]", f"weights = [{weights}]"]
