r"""Fit a law's parameters to a recording: the law, driven along the recorded motion, reproduces the torque.

.. math:: f_k = \psi_\theta(x_0 \ldots x_k) + J\,a_k + f_0 + e_k,
          \qquad \hat\theta = \arg\min \sum_k e_k^2

J and f_0 are linear: they are solved for each theta (variable projection) if the recording contains
inertia and bias. Scale parameters are searched in their logarithm, from starts that fill a box around
a guess, within the ranges that the law declares. The fit uses the law's compiled function, so any law with named
parameters can be fitted, including user-defined ones.

**Between two samples** the angle is a straight line where a cycle evaluated the law, and a smooth
curve where friction is that of a body. Both are tried, and the one that leaves less of the torque is
taken. The smooth curve is the cubic spline whose stiffness generalised cross-validation chooses, so
an encoder's counts are not taken for motion; the law is driven along it in `FINAL_PARTS` parts of
each interval. What a law remembers from before a stretch is not known, so the first `LEAD_S` of a
stretch, or a tenth of it, do not count.

**Intervals** of 95 %: the covariance is that of Gauss and Newton, with the residuals' correlation
counted by clusters of `CLUSTER_S` (a sandwich), and Student's t of as many degrees of freedom as
clusters decide about the parameter (Satterthwaite). Singular values reveal directions of the
parameters on which the torque hardly depends; parameters in such a direction are reported as *not
determined*, and so are those of which another minimum, which the data cannot tell from the least one
(a ratio of likelihoods within 95 %), says something else. A parameter that ends at its range has no
interval either, nor one that a rule between two parameters holds. An interval is that of a law that holds: `LawFit.misfit` compares the residual with
the noise of the torque, which its third differences show whatever the law is.

Sources: G. Golub, V. Pereyra, Separable nonlinear least squares: the variable projection method and its
applications, Inverse Problems 19(2), 2003, doi:10.1088/0266-5611/19/2/201; L. Ljung, System
Identification: Theory for the User, 2nd ed. 1999, chapter 9; P. Craven, G. Wahba, Smoothing noisy data
with spline functions, Numerische Mathematik 31, 1978, doi:10.1007/BF01404567.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from coulombus.analysis.rig.law_search import Floats, Motion, Search, Stretch, TorqueSamples
from coulombus.host.laws.along import given_law
from coulombus.host.laws.laws import LawError
from coulombus.recording.friction.regression import Estimate
from coulombus.recording.friction.sliding import IdentifyError, stretches
from coulombus.recording.signals import Source

__all__ = ["LawFit", "Stretch", "fit_law", "lines", "stretches_of"]

SEARCH_PARTS, FINAL_PARTS = 4, 16
"""Parts of a sample's interval along a smooth motion: while the minimum is searched, and at its place."""
SEARCH_TOLERANCE = 1e-6
MISFIT = 3.0
"""Times the noise from which on a residual is not the noise's."""
EXACT = 1e-3
"""Share of the torque below which a residual is that of the computation."""
WEAK = 1e-5
"""Relative singular value below which a direction of the parameters is not determined."""
NO_PART = 1e-9
"""Relative contribution to the torque below which a parameter is not determined."""
LEAST_SAMPLES = 50


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
    noise_Nm: float
    """Standard deviation of the torque's noise, from its third differences."""
    torque_rms_Nm: float
    smooth: bool
    """Whether the motion between two samples is a smooth curve instead of a straight line."""
    samples: int

    @property
    def misfit(self) -> float | None:
        """The residual as a multiple of the torque's noise; None if the noise alone explains it."""
        noise_Nm = max(self.noise_Nm, EXACT / MISFIT * self.torque_rms_Nm)
        return None if self.residual_rms_Nm <= MISFIT * noise_Nm else self.residual_rms_Nm / noise_Nm

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
            "noise_Nm": self.noise_Nm,
            "misfit": self.misfit,
            "motion": "smooth" if self.smooth else "straight",
            "samples": self.samples,
        }


def stretches_of(recording: Source) -> tuple[Stretch, ...]:
    """Return the hand's torque over the angle while the display is at full gain and the brake's set-point is constant.

    Raises
    ------
    coulombus.recording.friction.sliding.IdentifyError
        there is no transducer, or hardly a sample
    """
    return tuple(Stretch(stretch.t_s, stretch.x_rad, stretch.hand_Nm) for stretch in stretches(recording))


def fit_law(name: str, data: Sequence[Stretch], overrides: Sequence[str] = (), *, rig: bool | None = True) -> LawFit:
    """Fit a law's parameters.

    Parameters
    ----------
    name : the law, as in ``law.function``
    data : stretches of samples; the torque is the friction, positive against a positive speed
    overrides : "KEY=VALUE" holds a parameter at a value
    rig : whether the torque includes inertia and a transducer's bias; None: it does if the law alone leaves
        more than noise, and more than it leaves with them

    Raises
    ------
    coulombus.recording.friction.sliding.IdentifyError
        the data do not support the fit
    coulombus.host.laws.laws.LawError, coulombus.rigs.rig.RigError
        there is no such law, or a held parameter is refused
    """
    if rig is None:
        alone = fit_law(name, data, overrides, rig=False)
        if alone.misfit is None:
            return alone
        return min(alone, fit_law(name, data, overrides, rig=True), key=lambda fit: fit.residual_rms_Nm)
    law = given_law(name, overrides)
    if law.declaration is None:
        raise LawError(f"law {name!r} names no parameters: there is nothing to identify (docs/laws.md)")
    if law.declaration.uses_mode_keys:
        raise LawError(
            f"law {name!r} has its parameters in [mode.*]; `coulombus identify` without --law fits Coulomb, viscous and "
            "Stribeck friction"
        )
    count = sum(len(stretch.t_s) for stretch in data)
    if count < LEAST_SAMPLES:
        raise IdentifyError(f"{count} samples; expected at least {LEAST_SAMPLES} in which the law is felt")
    held = {override.partition("=")[0].strip().removeprefix(f"law.{law.declaration.name}.") for override in overrides}
    if all(float(np.ptp(stretch.x_rad)) == 0.0 for stretch in data):
        raise IdentifyError("the handle does not move: no law can be told from that; record strokes, to and fro")
    search = Search(law, law.declaration, held, data)
    if not search.names:
        raise IdentifyError(f"law {name!r}: every parameter is held by --set: there is nothing to identify")
    measured = TorqueSamples(data, rig)
    motion, starts = Motion(search, measured), list(search.starts(data))
    best = motion.minimum(starts[0])
    minima = [best]
    if not motion.explains(best):
        coarse, smooth = Motion(search, measured, SEARCH_PARTS), Motion(search, measured, FINAL_PARTS)
        minima = sorted((coarse.minimum(start, SEARCH_TOLERANCE) for start in starts), key=lambda fit: float(fit.cost))
        best = motion.minimum(minima[0].x)
        final = smooth.minimum(minima[0].x)
        if final.cost < best.cost:
            motion, best = smooth, final
    return _fit_of(search, best, minima, motion, measured)


def _as_likely(search: Search, minima: Sequence[Any], samples: int) -> Floats:
    """Return the parameters of all minima that the data cannot tell from the least one."""
    cost_limit = minima[0].cost * (1.0 + float(chi2.ppf(0.95, len(search.names))) / samples)
    return np.array([search.values(fit.x) for fit in minima if fit.cost <= cost_limit])


def _fit_of(search: Search, best: Any, minima: Sequence[Any], motion: Motion, measured: TorqueSamples) -> LawFit:
    """Return the fit with its intervals."""
    u, e = np.asarray(best.x, np.float64), np.asarray(best.fun, np.float64)
    values, n = search.values(u), len(u)
    J = np.empty((len(e), n))
    for k in range(n):  # central differences over relative changes of the parameters
        h = 1e-4
        up, down = u.copy(), u.copy()
        up[k] += h
        down[k] -= h
        J[:, k] = -(motion.residual(up) - motion.residual(down)) / (2 * h)
    sizes = np.linalg.norm(J, axis=0)
    largest = float(sizes.max())
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    _, singular, V = np.linalg.svd(J / sizes, full_matrices=False)
    weak = singular <= WEAK * singular[0]
    parts = np.sqrt(np.sum(V[weak] ** 2, axis=0)) if np.any(weak) else np.zeros(n)
    inverse = V.T @ np.diag(np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, singular) ** 2)) @ V / np.outer(sizes, sizes)
    cluster, clusters = measured.clusters()
    scores = np.zeros((clusters, n))
    np.add.at(scores, cluster, J * e[:, None])
    free = max(clusters - n, 1)
    covariance = inverse @ (scores.T @ scores) @ inverse * clusters / free
    classical = inverse * float(e @ e) / max(len(e) - n, 1)
    weights = np.zeros((clusters, n))
    np.add.at(weights, cluster, (J @ inverse) ** 2)
    deciding = np.sum(weights, axis=0) ** 2 / np.maximum(np.sum(weights**2, axis=0), 1e-300)
    quantile = student.ppf(0.975, np.clip(deciding, 1.0, free))
    half = quantile * np.sqrt(np.maximum(np.diag(covariance), np.diag(classical)))
    likely, constrained = _as_likely(search, minima, len(e)), search.constrained(u)
    estimates: dict[str, Estimate | None] = {}
    not_determined = []
    for k, name in enumerate(search.names):
        at_end = constrained[k] or values[k] >= search.high[k] * (1 - 1e-6) or values[k] <= search.low[k] * (1 + 1e-6)
        zero = search.low[k] == 0.0 and values[k] <= 0.0
        if search.scale[k]:
            low, high = values[k] * math.exp(-min(half[k], 700)), values[k] * math.exp(min(half[k], 700))
        else:
            low, high = values[k] - half[k] * search.guess[k], values[k] + half[k] * search.guess[k]
        weakly = parts[k] > 0.1 or (at_end and not zero) or np.linalg.norm(J[:, k]) <= NO_PART * largest
        if weakly or np.any(np.abs(likely[:, k] - likely[0, k]) > high - low):
            not_determined.append(name)
            estimates[name] = None
            continue
        estimates[name] = Estimate(float(values[k]), max(float(low), float(search.low[k])), float(high))
    left = measured.torque_Nm - motion.law_torque(u)
    extra = np.linalg.lstsq(measured.linear, left, rcond=None)[0] if measured.linear.shape[1] else None
    dumped = search.initial.parameters.model_dump()
    return LawFit(
        law=search.initial.name,
        estimates=estimates,
        values=dict(zip(search.names, map(float, values), strict=True)),
        held={name: value for name, value in dumped.items() if name not in search.names},
        not_determined=tuple(not_determined),
        inertia_kg_m2=None if extra is None else float(extra[0]),
        offset_Nm=None if extra is None else float(extra[1]),
        residual_rms_Nm=float(np.sqrt(np.mean(e**2))),
        noise_Nm=measured.noise_Nm(),
        torque_rms_Nm=float(np.sqrt(np.mean(measured.torque_Nm**2))),
        smooth=motion.parts > 1,
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
    if fit.misfit is not None:
        text.append(
            f"note: the law alone does not describe these data: the residual is {fit.misfit:.3g} times the torque's noise of "
            f"{fit.noise_Nm:.3g} Nm; the intervals hold for a law that does"
        )
    if fit.not_determined:
        names = ", ".join(fit.not_determined)
        text.append(f"note: these data do not tell {names}; hold one with --set, or record more kinds of motion")
    return text
