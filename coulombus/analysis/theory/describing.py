r"""Describing functions, eq. (2): numerically for any friction law, analytically if known.

For :math:`v = a\sin\theta` the law's fundamental is :math:`p\sin\theta + q\cos\theta` and
:math:`\Psi = (p + jq)/a`. A law without memory has q = 0 and eq. (2); a law with memory, such as
Karnopp's with its spring, also depends on the frequency.

Every law is paired with its analytic :math:`\Psi` in `ANALYTIC` (keyed by the law's function, like
python-control's nonlinearities); a test compares the pairs.

The laws with named parameters have their own closed forms. With r = a/v_s, the three forms of Stribeck friction are

.. math::

    \Psi = \frac{4}{\pi a} \left(F_c + (F_s - F_c)\,m(r)\right) + \sigma_2, \qquad
    m = \begin{cases} D(r)/r & \text{gauss, D: Dawson's function} \\
                      1 + \tfrac{\pi}{2}(L_1(r) - I_1(r)) & \text{tustin, L: modified Struve's function} \\
                      \dfrac{\mathrm{arsinh}\,r}{r\sqrt{1 + r^2}} & \text{lorentz} \end{cases}

the arctangent with its slope F_c/v_t, :math:`k = \pi a/(2 v_t)`:
:math:`\Psi = 4 F_c (\sqrt{1 + k^2} - 1)/(\pi a k)`; and a spring K that slips at F (Jenkins' element),
with :math:`X = a/\omega`, :math:`d = F/K`, :math:`\cos\varphi = 1 - 2d/X`, for X > d:

.. math:: p = \frac{4F}{\pi}\left(1 - \frac{d}{X}\right), \qquad
          q = -\frac{K X}{\pi}\left(\varphi - \tfrac12 \sin 2\varphi\right)

and p = 0, q = -K X below. It is Kikuuwe's law without its damper, and Dahl's with alpha = 0.

Source: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design,
1968, appendix B; the integrals are derived in these terms and tested numerically.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.special import dawsn, iv, modstruve

from coulombus.analysis.theory.operators import ParameterError
from coulombus.host.laws.laws import coulomb, karnopp

__all__ = [
    "ANALYTIC",
    "LawParameters",
    "analytic",
    "arctan_psi",
    "coulomb_psi",
    "jenkins_psi",
    "karnopp_psi",
    "numeric",
    "regularised",
    "regularised_psi",
    "stribeck_psi",
]

LawFunction = Callable[[Any, Any, Any], float]
SAMPLES = 10_000
"""Samples of the last period; a jump between two samples causes an error of at most 1/SAMPLES of its size."""


@dataclass(frozen=True)
class LawParameters:
    """Inputs of a law, on a linear or a rotary axis: the mode's parameters of a rig file, and the encoder's resolution."""

    F_d: float = 10.0
    F_s: float = 10.0
    K_p: float = 1e4
    band_v: float = 0.0
    """Velocity band Delta v, in m/s or rad/s."""
    paper_entry: bool = False
    user: tuple[float, ...] = ()

    def record(self, count_v: float) -> Any:
        """Return the law's record `host.laws.laws.LAW` if one encoder count per cycle is the speed `count_v`."""
        return SimpleNamespace(
            K_p=self.K_p,
            F_s=self.F_s,
            F_d=self.F_d,
            velocity_band_counts=self.band_v / count_v,
            paper_entry=int(self.paper_entry),
            brake_spring=0,
            user=np.array(self.user + (0.0,) * (16 - len(self.user))),
        )


def coulomb_psi(a: float, frequency_Hz: float, law: LawParameters) -> complex:
    r"""Return Psi of `host.laws.laws.coulomb`: :math:`\frac{4c}{\pi a}\sqrt{1-(\Delta v/a)^2}`, eq.
    (5) for no band; 0 within the band.
    """
    return 4 * law.F_d / (math.pi * a) * math.sqrt(1 - (law.band_v / a) ** 2) if a > law.band_v else 0.0


def karnopp_psi(a: float, frequency_Hz: float, law: LawParameters) -> complex:
    r"""Return Psi of `host.laws.laws.karnopp` with a continuous stick entry, for a > Delta v.

    Slip ends at :math:`\pi-\theta_0`, :math:`\sin\theta_0 = \Delta v/a`, and the spring is entered
    with F_d. It is loaded by :math:`A(-\cos\theta-\cos\theta_0)`, :math:`A = K_p a/\omega`, up to
    F_s, and unloaded from the turning point by :math:`A(1+\cos\theta)`, down to -F_s, until slip
    begins at :math:`\pi+\theta_0`. The half period is made of pieces
    :math:`\alpha+\beta\cos\theta`, whose fundamentals are known.
    """
    if a <= law.band_v:
        raise ParameterError(f"amplitude {a:g} is within the velocity band {law.band_v:g}: the law never slips")
    if law.paper_entry:
        raise ParameterError("Psi of Karnopp's law is known for the continuous stick entry only; use `numeric`")
    theta_0 = math.asin(law.band_v / a)
    A = law.K_p * a / (2 * math.pi * frequency_Hz)
    F_d, F_s = law.F_d, law.F_s
    pieces = [(theta_0, math.pi - theta_0, F_d, 0.0)]
    entry = min(F_d, F_s)
    wound = math.cos(theta_0) + (F_s - entry) / A  # -cos(theta) where the spring reaches F_s
    full = math.acos(-wound) if wound < 1 else math.pi
    pieces.append((math.pi - theta_0, full, entry - A * math.cos(theta_0), -A))
    pieces.append((full, math.pi, F_s, 0.0))
    top = F_s if wound < 1 else entry + A * (1 - math.cos(theta_0))
    unwound = (top + F_s) / A - 1  # cos(theta) where it reaches -F_s
    empty = 2 * math.pi - math.acos(unwound) if unwound < 1 else math.inf
    end = math.pi + theta_0
    pieces.append((math.pi, min(empty, end), top - A, -A))
    if empty < end:
        pieces.append((empty, end, -F_s, 0.0))
    p = q = 0.0
    for begin, after, alpha, beta in pieces:
        s0, s1, c0, c1 = math.sin(begin), math.sin(after), math.cos(begin), math.cos(after)
        p += alpha * (c0 - c1) + 0.5 * beta * (s1 * s1 - s0 * s0)
        q += alpha * (s1 - s0) + 0.5 * beta * (after - begin + s1 * c1 - s0 * c0)
    return 2 / (math.pi * a) * complex(p, q)


def regularised(motion: Any, law: Any, state: Any) -> float:
    r"""Coulomb friction with a slope: :math:`\psi = c\,\mathrm{sat}(v/\Delta)`, :math:`c` = F_d and
    :math:`\Delta` = the velocity band.

    A certificate of `analysis.theory.absolute` concerns its slope :math:`c/\Delta`.
    """
    share = motion.v_counts / law.velocity_band_counts
    return float(law.F_d * min(max(share, -1.0), 1.0))


def regularised_psi(a: float, frequency_Hz: float, law: LawParameters) -> complex:
    r"""Return Psi of `regularised`: :math:`\frac{2k}{\pi}(\arcsin\rho + \rho\sqrt{1-\rho^2})`,
    :math:`\rho = \min(1, \Delta/a)`, k = c/Delta.
    """
    rho = min(1.0, law.band_v / a)
    return 2 * law.F_d / (math.pi * law.band_v) * (math.asin(rho) + rho * math.sqrt(1 - rho * rho))


ANALYTIC: dict[LawFunction, Callable[[float, float, LawParameters], complex]] = {
    coulomb: coulomb_psi,
    karnopp: karnopp_psi,
    regularised: regularised_psi,
}


def analytic(function: LawFunction, a: float, frequency_Hz: float, law: LawParameters) -> complex:
    """Return the analytic Psi of a law.

    Raises
    ------
    ParameterError
        none is known; `numeric` works for any law
    """
    psi = ANALYTIC.get(function)
    if psi is None:
        name = getattr(function, "__name__", str(function))
        raise ParameterError(
            f"law {name!r} has no analytic describing function here; coulombus.analysis.theory.describing.numeric does any law"
        )
    return psi(a, frequency_Hz, law)


def numeric(
    function: LawFunction,
    a: float,
    frequency_Hz: float,
    law: LawParameters,
    *,
    samples: int = SAMPLES,
    periods: int = 3,
) -> complex:
    """Return Psi(a, frequency) of any law `function(motion, law, state)`, in force per velocity.

    The law is driven by v = a sin(theta) and its integral for `periods` periods; the fundamental of
    the last one counts, by the midpoint rule. `function` is the plain Python function of a law,
    such as `host.laws.laws.karnopp`.
    """
    if not a > 0 or not frequency_Hz > 0:
        raise ParameterError(f"amplitude {a} and frequency {frequency_Hz}: must be positive")
    w = 2 * math.pi * frequency_Hz
    count_v = a * 1e-6
    record = law.record(count_v)
    motion = SimpleNamespace(x_rad=0.0, v_rad_s=0.0, v_counts=0.0, dt_s=1 / (frequency_Hz * samples), handle_Nm=0.0)
    state = SimpleNamespace(stuck=0, x_stuck=0.0, psi_Nm=0.0, brake_Nm=0.0, user=np.zeros(16))
    theta = (np.arange(samples) + 0.5) * (2 * math.pi / samples)
    sines, cosines, force = np.sin(theta), np.cos(theta), np.zeros(samples)
    for _ in range(periods):
        for i in range(samples):
            motion.x_rad = float(-a / w * cosines[i])
            motion.v_rad_s = float(a * sines[i])
            motion.v_counts = motion.v_rad_s / count_v
            force[i] = function(motion, record, state)
            state.psi_Nm = force[i]
    return complex(force @ sines, force @ cosines) * 2 / (samples * a)


LARGE = 15.0
"""Argument above which Struve's and Bessel's functions agree to all digits: the series is used."""


def stribeck_psi(a: float, F_c: float, F_s: float, v_s: float, sigma_2: float = 0.0, form: str = "gauss") -> float:
    """Return Psi [Nm s/rad] of Stribeck friction; `form` is gauss, tustin or lorentz."""
    r = a / v_s
    if form == "gauss":
        share = float(dawsn(r)) / r
    elif form == "tustin" and r > LARGE:  # 2 + pi (L_1 - I_1) -> 2/r^2 + 6/r^4 + 90/(4 r^6) ...
        share = 1 / r**2 + 3 / r**4 + 45 / r**6
    elif form == "tustin":
        share = 1.0 + 0.5 * math.pi * float(modstruve(1, r) - iv(1, r))
    elif form == "lorentz":
        share = math.asinh(r) / (r * math.sqrt(1.0 + r * r))
    else:
        raise ValueError(f"form = {form!r}: expected gauss, tustin or lorentz")
    return 4.0 / (math.pi * a) * (F_c + (F_s - F_c) * share) + sigma_2


def arctan_psi(a: float, F_c: float, v_t: float) -> float:
    """Return Psi [Nm s/rad] of the regularised law in its form arctan."""
    k = 0.5 * math.pi * a / v_t
    return 4.0 * F_c * (math.sqrt(1.0 + k * k) - 1.0) / (math.pi * a * k)


def jenkins_psi(a: float, frequency_Hz: float, F: float, K: float) -> complex:
    """Return Psi [Nm s/rad] of a spring K that slips at F."""
    X, d = a / (2.0 * math.pi * frequency_Hz), F / K
    if d >= X:
        return complex(0.0, -K * X) / a
    phi = math.acos(1.0 - 2.0 * d / X)
    return complex(4.0 * F / math.pi * (1.0 - d / X), -K * X / math.pi * (phi - 0.5 * math.sin(2.0 * phi))) / a
