r"""Friction from a table of angle and torque: slow ramps, strokes, chirps.

Rows become slides as in a recording (`recording.friction.sliding`). The table supplies the rig
file's values: the period is the median difference of the times; the encoder's count is the smallest
step of the angle if all steps are whole multiples of it. Unevenly spaced rows are interpolated.

A column `load` is the torque of a load that drives the angle, too: a friction that grows with it is fitted.

The breakaway torque is the largest before each slide from rest; its interval is Student's over the slides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from coulombus.recording.friction.columns import TorqueTable
from coulombus.recording.friction.equations import equations
from coulombus.recording.friction.identify import Identification, identified
from coulombus.recording.friction.regression import CONFIDENCE, Estimate
from coulombus.recording.friction.sliding import (
    COIL_S,
    LEAST_SAMPLES,
    REVERSAL_S,
    WINDOW_S,
    Floats,
    IdentifyError,
    Slide,
    Sliding,
    one_sense,
    runs,
    since,
)

__all__ = ["TableIdentification", "identify_table", "table_lines"]

SLOW_SHARE = 0.05
"""Least speed of sliding, relative to the fast strokes."""
EVEN = 0.01
REST_S, BEFORE_S = 0.1, 0.02
STILL_SHARE = 1e-4
"""Largest motion at rest, relative to the whole travel, for an angle without counts."""
LEAST_LETS = 3
LEAST_SIZE = 5
"""Samples of the shortest window."""


@dataclass(frozen=True)
class TableIdentification:
    """Friction from a table: of its torque and its load together."""

    identification: Identification
    breakaway_Nm: Estimate | None
    """None if fewer than three slides begin from rest."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        breakaway = self.breakaway_Nm
        return {key: value for key, value in self.identification.as_dict().items() if key != "device"} | {
            "breakaway_Nm": None if breakaway is None else breakaway.value,
            "breakaway_Nm_ci95": None if breakaway is None else [breakaway.low, breakaway.high],
        }


def identify_table(table: TorqueTable, ratio: float | None = None) -> TableIdentification:
    """Identify friction from a table.

    `ratio`: motor revolutions per revolution of the angle; None: cogging is not fitted.

    Raises
    ------
    IdentifyError
        the angle moves too little for the fit
    """
    slides, window_s, lets = _slides(table)
    try:
        identification = identified(slides, table.path, window_s, ratio)
    except IdentifyError as error:
        raise IdentifyError(f"{table.path}: {error}") from error
    if table.load_Nm is not None:
        device, rows = identification.device, equations(slides.slides, slides.period_s, slides.count_rad, window_s)
        bare_Nm = rows.hand_Nm + rows.motor_Nm - device.inertia_and_offset_Nm(rows.a)
        identification = replace(identification, felt=device, felt_Nm=bare_Nm)
    return TableIdentification(identification, _mean(lets))


def _mean(values: list[float]) -> Estimate | None:
    if len(values) < LEAST_LETS:
        return None
    n, mean = len(values), float(np.mean(values))
    reach = float(stdtrit(n - 1, 0.5 + CONFIDENCE / 2) * np.std(values, ddof=1) / math.sqrt(n))
    return Estimate(mean, mean - reach, mean + reach)


def _even(table: TorqueTable) -> tuple[float, TorqueTable, tuple[str, ...]]:
    """Return the period, and the table resampled to it."""
    steps = np.diff(table.t_s)
    period = float(np.median(steps))
    t = table.t_s[0] + period * np.arange(int((table.t_s[-1] - table.t_s[0]) / period) + 1)
    if len(t) == len(table.t_s) and np.max(np.abs(t - table.t_s)) < EVEN * period:
        return period, table, ()
    angle, torque = (np.interp(t, table.t_s, column) for column in (table.angle_rad, table.torque_Nm))
    load = None if table.load_Nm is None else np.interp(t, table.t_s, table.load_Nm)
    brake = table.brake
    if brake is not None:
        brake = brake[np.clip(np.searchsorted(table.t_s, t, side="right") - 1, 0, len(brake) - 1)]
    note = f"the rows come unevenly: they are interpolated to one each {1e3 * period:.4g} ms"
    return period, TorqueTable(table.path, t, angle, torque, brake, load), (note,)


def _count(angle: Floats) -> float:
    """Return the encoder's count [rad]; 0 if the angle is continuous."""
    steps = np.abs(np.diff(angle))
    steps = steps[steps > 1e-12]
    if not len(steps):
        return 0.0
    least = float(np.min(steps))
    multiples = steps / least
    return least if np.all(np.abs(multiples - np.rint(multiples)) < 0.01 * np.maximum(multiples, 1.0)) else 0.0


def _slides(table: TorqueTable) -> tuple[Sliding, float, list[float]]:
    """Return the slides, their window, and the torque before each slide from rest."""
    period, table, notes = _even(table)
    x, count = table.angle_rad, _count(table.angle_rad)
    unit = count or 1e-9 * max(float(np.ptp(x)), 1e-9)
    moved = np.diff(x, prepend=x[:1]) / unit
    width = max(round(REST_S / 5 / period), 1)
    speed = np.abs(np.convolve(np.gradient(x, period), np.ones(width) / width, "same"))
    fast = float(np.percentile(speed, 95))
    if not fast > 0.0:
        raise IdentifyError(f"{table.path}: the angle never moves")
    moves, sense = one_sense(moved, period, unit, SLOW_SHARE * fast)
    moves &= speed > SLOW_SHARE * fast
    coil_off = True
    if table.brake is not None:
        same = since(np.concatenate(([True], np.diff(table.brake) == 0.0))) >= round(COIL_S / period)
        off = same & (table.brake == 0.0)
        coil_off = int(np.sum(moves & off)) >= LEAST_SAMPLES
        moves &= off if coil_off else same
    spans = [(a, b) for a, b in runs(moves) if np.ptp(sense[a:b]) == 0.0]
    lengths = [(b - a) * period for a, b in spans]
    if not spans:
        raise IdentifyError(f"{table.path}: the angle never moves in one sense for long enough")
    typical = float(np.percentile(lengths, 75))
    window_s = min(max(LEAST_SIZE * period, min(WINDOW_S, typical / 4)), typical)
    margin = round(min(REVERSAL_S, typical / 10) / period)
    load = np.zeros(len(x)) if table.load_Nm is None else table.load_Nm
    slides = tuple(
        Slide(table.t_s[a:b], x[a:b], table.torque_Nm[a:b], load[a:b])
        for a, b in ((a + margin, b) for a, b in spans)
        if b - a >= window_s / period
    )
    samples = sum(len(slide.t_s) for slide in slides)
    if samples < LEAST_SAMPLES:
        raise IdentifyError(
            f"{table.path}: {samples} samples slide; expected at least {LEAST_SAMPLES}: record strokes, to and fro"
        )
    rest, before = round(REST_S / period), max(round(BEFORE_S / period), 2)
    still = max(2 * count, STILL_SHARE * float(np.ptp(x)))
    lets = [
        float(np.max(np.abs(table.torque_Nm[a - before : a + before])))
        for a, _ in spans
        if a >= rest > before and float(np.ptp(x[a - rest : a - before])) <= still
    ]
    return Sliding(slides, period, count, coil_off, {}, notes), window_s, lets


def table_lines(fitted: TableIdentification) -> list[str]:
    """Return it as text: each parameter with its 95 % interval."""
    fit = fitted.identification.felt
    rows = (
        ("Coulomb", fit.coulomb_Nm, "Nm"),
        ("viscous", fit.viscous_Nms_rad, "Nm s/rad"),
        ("Stribeck, F_s - c", fit.stribeck_Nm, "Nm"),
        ("share of the load", fit.load_share, ""),
        ("inertia", fit.inertia_kg_m2, "kg m2"),
        ("torque's bias", fit.offset_Nm, "Nm"),
        ("break-away", fitted.breakaway_Nm, "Nm"),
    )
    text = [f"{fitted.identification.samples} samples slide; 95 % confidence intervals", "", "friction:"]
    text += [f"  {name:<18} {estimate} {unit}" for name, estimate, unit in rows if estimate is not None]
    text.append(f"  {'residual, RMS':<18} {fit.residual_rms_Nm:.3g} Nm")
    return text + [f"\nnote: {remark}" for remark in fitted.identification.remarks]
