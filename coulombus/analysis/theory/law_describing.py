r"""Describing functions of laws with named parameters, in closed form.

For :math:`v = a \sin\theta` the law's fundamental is :math:`p \sin\theta + q \cos\theta`, and
:math:`\Psi = (p + jq)/a`.

With r = a/v_s, the three forms of Stribeck friction are

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

from scipy.special import dawsn, iv, modstruve

__all__ = ["arctan_psi", "jenkins_psi", "stribeck_psi"]

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
