r"""Friction from a recording by least squares: Coulomb, viscous and, if supported, Stribeck, with confidence intervals.

While the handle slides, the hand's torque on it (the transducer's) is

.. math:: f = J\,\dot v + \bigl[c + b\,|v| + (F_s - c)\,e^{-(v/v_S)^2}\bigr]\,\mathrm{sgn}(v) + f_0

This is the friction that the hand *feels*: the device's own, minus the motor's compensation, plus
the display. With the motor's torque (6077h) added on the left it is the *device's* friction,
compensated or not. Both are fitted.

A gear's friction grows with the torque that it carries: the device's fit has :math:`\mu\,|\tau_m|\,\mathrm{sgn}(v)`
where the hand bears the motor's torque and :math:`\mu` is significant.

Significant cogging adds :math:`A\,\sin(\kappa x + \varphi)` (`recording.friction.angle_waves`). The
drive's measured torque may be late by :math:`\delta`: the device's fit includes
:math:`\delta\,\dot\tau_m`, so that the delay is not mistaken for inertia.

`recording.friction.sliding` selects the samples for which the equation holds and builds equations,
`recording.friction.friction_fit` solves them. :math:`f_0` (the transducer's bias) is fitted if both
directions occur. The intervals are 95 %; docs/theory.md has their coverage.

Source: the paper, section 5 and Fig. 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.friction.angle_waves import AngleWave, Kind, find_waves, wave_columns
from coulombus.recording.friction.equations import Equations, equations
from coulombus.recording.friction.friction_fit import Fit, fit_friction, load_column
from coulombus.recording.friction.regression import Column, SpeedLevels
from coulombus.recording.friction.sliding import REVERSAL_S, WINDOW_S, IdentifyError, Sliding, sliding
from coulombus.recording.reading import blocks
from coulombus.recording.signals import Source

__all__ = ["Identification", "IdentifyError", "identified", "identify", "lines", "torque_delay"]

Floats: TypeAlias = npt.NDArray[np.float64]

MISFIT, MISFIT_SHARE = 3.0, 0.02
"""From this multiple of the noise on, and this share of the Coulomb friction, a residual is not the noise's."""
LEAST_RATE_NM_S = 1e-3
"""Least mean rate of torque from which a delay can be fitted."""


@dataclass(frozen=True)
class Identification:
    """Friction identified from a recording."""

    path: str
    felt: Fit
    """Friction felt at the handle."""
    device: Fit
    """The device's own friction: with the motor's torque."""
    samples: int
    coil_off: bool
    """Whether only samples without brake were taken."""
    left_out: dict[str, int]
    """Number of omitted samples by reason."""
    remarks: tuple[str, ...]
    waves: tuple[AngleWave, ...]
    """Significant torque waves over the angle; their coefficients are in `device`."""
    v_rad_s: Floats
    felt_Nm: Floats
    """The samples without inertia and offset; for the plot."""

    @property
    def cogging(self) -> AngleWave | None:
        """The motor's cogging, if significant."""
        return next((wave for wave in self.waves if wave.kind == "cogging"), None)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values: felt friction at the top, the device's under "device"."""
        return self.felt.as_dict() | {
            "device": self.device.as_dict(),
            "samples": self.samples,
            "left_out": self.left_out,
            "coil_off": self.coil_off,
            "remarks": list(self.remarks),
        }


def identify(
    recording: Source | str | Path, *, window_s: float = WINDOW_S, reversal_s: float = REVERSAL_S
) -> Identification:
    """Identify friction from a recording (or its path): any run in which the handle slides.

    `reversal_s`: time ignored at the beginning of a slide (`recording.friction.sliding`).

    Raises
    ------
    IdentifyError
        the handle hardly slides while friction is displayed, or the transducer's signal is missing
    """
    if isinstance(recording, str | Path):
        recording = blocks(recording)
    slides = sliding(recording, window_s, reversal_s)
    try:
        return identified(slides, recording.path, window_s, recording.rig.one_axis().mechanics.ratio)
    except IdentifyError as error:
        raise IdentifyError(f"{recording.path}: {error}") from error


def identified(
    slides: Sliding,
    path: str,
    window_s: float,
    ratio: float | None,
    count_Nm: float = 0.0,
    kinds: Sequence[Kind] = ("cogging",),
) -> Identification:
    """Identify friction from slides.

    Parameters
    ----------
    ratio : of the motor; None: cogging is not fitted
    count_Nm : resolution of the motor's measured torque if a controller holds the speeds; 0: its error averages out
    kinds : of torque waves over the angle to look for

    Raises
    ------
    IdentifyError
        the slides do not support a fit
    """
    rows = equations(slides.slides, slides.period_s, slides.count_rad, window_s)
    notes = list(slides.remarks)
    candidates = () if ratio is None else find_waves(slides, ratio, kinds)
    delay = torque_delay(rows, slides)
    levels = SpeedLevels.from_speeds(rows.v, count_Nm) if count_Nm > 0 else None

    def fitted(waves: Sequence[AngleWave]) -> Fit:
        columns = wave_columns(waves, rows, slides.slides) | delay
        columns |= load_column(rows, slides.slides, columns)
        return fit_friction(rows, rows.hand_Nm + rows.motor_Nm, None, columns, levels)

    device = fitted(candidates)
    significant = tuple(wave for wave in candidates if wave.kind != "cogging" or wave.stands_out(device.others))
    if significant != candidates:
        device = fitted(significant)
    noise_Nm = _row_noise_Nm(rows, slides)
    if device.residual_rms_Nm > max(MISFIT * noise_Nm, MISFIT_SHARE * device.coulomb_Nm.value):
        notes.append(
            f"the fit leaves {device.residual_rms_Nm:.2g} Nm, the transducer's noise would leave {noise_Nm:.2g} Nm: the device "
            "has a torque that is not in it (by angle, load or temperature), so the intervals do not hold"
        )
    waves = wave_columns(significant, rows, slides.slides)
    felt = fit_friction(rows, rows.hand_Nm, notes, waves)
    return Identification(
        path=path,
        felt=felt,
        device=device,
        samples=slides.samples,
        coil_off=slides.coil_off,
        left_out=slides.left_out,
        remarks=tuple(notes),
        waves=significant,
        v_rad_s=rows.v,
        felt_Nm=rows.hand_Nm - felt.inertia_and_offset_Nm(rows.a),
    )


def _row_noise_Nm(rows: Equations, slides: Sliding) -> float:
    """Return the noise of an equation's torque, from the third differences of the hand's torque."""
    thirds = np.concatenate([np.diff(slide.hand_Nm, 3) for slide in slides.slides])
    return float(np.sqrt(np.mean(thirds**2) / 20.0) * np.linalg.norm(rows.weight))


def torque_delay(rows: Equations, slides: Sliding) -> dict[str, Column]:
    """Return the column for a delay of the motor's measured torque; empty if the torque never changes."""
    rate = rows.rate([slide.motor_Nm for slide in slides.slides if len(slide.t_s) >= len(rows.weight)])
    changes = float(np.sqrt(np.mean(rate**2))) > LEAST_RATE_NM_S
    return {"torque's delay": (rate, 0.0)} if changes else {}


def lines(identification: Identification) -> list[str]:
    """Return an identification as text: each parameter with its 95 % confidence interval."""
    names = (
        ("Coulomb", "coulomb_Nm", "Nm"),
        ("viscous", "viscous_Nms_rad", "Nm s/rad"),
        ("Stribeck, F_s - c", "stribeck_Nm", "Nm"),
        ("share of the load", "load_share", ""),
        ("inertia", "inertia_kg_m2", "kg m2"),
        ("transducer's bias", "offset_Nm", "Nm"),
    )
    text = [
        f"{identification.samples} samples slide, {'coil off' if identification.coil_off else 'brake on'}; 95 % confidence intervals"
    ]
    text += [f"  left out {n:>8}: {reason}" for reason, n in identification.left_out.items() if n]
    for title, fit in (
        ("felt at the handle", identification.felt),
        ("the device's own (motor's torque added)", identification.device),
    ):
        text.append(f"\n{title}:")
        for name, attribute, unit in names:
            estimate = getattr(fit, attribute)
            if estimate is not None:
                speed = f" at {fit.stribeck_rad_s:.3g} rad/s" if attribute == "stribeck_Nm" else ""
                text.append(f"  {name:<18} {estimate} {unit}{speed}")
        text.append(f"  {'residual, RMS':<18} {fit.residual_rms_Nm:.3g} Nm")
    return text + [f"\nnote: {remark}" for remark in identification.remarks]
