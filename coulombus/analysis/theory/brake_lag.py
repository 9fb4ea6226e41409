r"""A lagging brake under a pushing hand: the largest slope of damping with smooth sliding.

*Ideal brake.* The handle is :math:`J\dot v + \beta v = f_h - F_b\,\mathrm{Sgn}(v)`, with
:math:`\beta` the damping of device and hand together. If the brake has the level
:math:`F_b = \lambda(v) \ge 0` at once, and :math:`\lambda(|v|) + \beta |v|` never falls with the
speed, two motions under the same :math:`f_h(t)` converge,

.. math:: \frac{d}{dt}\,\tfrac12 J (v_1 - v_2)^2 \le 0

because :math:`\lambda\,\mathrm{Sgn} + \beta` is monotone. So only the hand can cause an oscillation.

*Brake with a lag.* A brake with a delayed level, :math:`F_b = B\,L(s)\,|v|`, still opposes every
motion, but does not rise together with the speed. With a hand that pushes at a mean speed V, a
ripple :math:`v = V + a \sin\omega t` with :math:`a < V` has :math:`|v| = v`: the describing
function of the brake is :math:`B\,L(j\omega)` at any such amplitude, independent of the hand's
force. With a coil, a fluid and a delay,

.. math:: L(s) = \frac{e^{-s\tau}}{(1 + s T_1)(1 + s T_2)}, \qquad
          J s + \beta + B\,L(s) = 0

the ripple grows beyond the least B at which a root lies on the imaginary axis,

.. math:: \arg\{(J j\omega + \beta)(1 + j\omega T_1)(1 + j\omega T_2)\} + \omega\tau = \pi, \qquad
          B_{max} = |(J j\omega + \beta)(1 + j\omega T_1)(1 + j\omega T_2)|

The hand's mean push supplies the energy. The ripple grows until the handle stops in every period,
where this describing function is no longer valid. A sampled brake has its delay in cycles plus one
cycle: half for the backward difference, half for the hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import brentq

from coulombus.analysis.theory.parameters import ParameterError

__all__ = ["BrakeLag", "RippleLimit", "ripple_limit"]


@dataclass(frozen=True)
class BrakeLag:
    """The handle, the hand on it, and the brake's lags and delay; defaults are those of the rig ``bench``.

    Raises
    ------
    ParameterError
        an inertia that is not positive, or a damping, lag or delay that is negative or not finite
    """

    inertia_kg_m2: float = 3e-3
    """Inertia of handle and hand together."""
    damping_Nms_rad: float = 0.105
    """Damping of device and hand together."""
    coil_lag_s: float = 3e-3
    fluid_lag_s: float = 15e-3
    delay_s: float = 2e-3
    """Total delay from speed to the brake's set-point, including difference and hold."""

    def __post_init__(self) -> None:
        for name in ("inertia_kg_m2", "damping_Nms_rad", "coil_lag_s", "fluid_lag_s", "delay_s"):
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0.0 or (name == "inertia_kg_m2" and value == 0.0):
                raise ParameterError(f"{name} = {value}: expected a finite number that is not negative")

    def phase_rad(self, omega_rad_s: float) -> float:
        """Return the phase lag [rad] of the brake's torque, including the inertia."""
        lags = math.atan(omega_rad_s * self.coil_lag_s) + math.atan(omega_rad_s * self.fluid_lag_s)
        return math.atan2(omega_rad_s * self.inertia_kg_m2, self.damping_Nms_rad) + lags + omega_rad_s * self.delay_s


@dataclass(frozen=True)
class RippleLimit:
    """Limit above which a ripple grows."""

    damping_Nms_rad: float
    """B_max: the steepest slope of the brake with smooth sliding; infinite without a limit."""
    frequency_Hz: float
    """Frequency of the ripple there; NaN without a limit."""


def ripple_limit(brake: BrakeLag) -> RippleLimit:
    r"""Return the largest damping that a lagging brake displays smoothly to a pushing hand.

    Without a delay it follows from Routh's criterion, with :math:`a_3 = J T_1 T_2`,
    :math:`a_2 = J (T_1 + T_2) + \beta T_1 T_2`, :math:`a_1 = J + \beta (T_1 + T_2)`:
    :math:`B_{max} = a_1 a_2/a_3 - \beta`. With at most one lag and no delay every slope is smooth.
    """
    late = (brake.coil_lag_s > 0) + (brake.fluid_lag_s > 0)
    if brake.delay_s == 0.0 and late < 2:
        return RippleLimit(math.inf, math.nan)
    omega = 1.0
    while brake.phase_rad(omega) < math.pi:
        omega *= 2.0
    crossing = float(brentq(lambda w: brake.phase_rad(w) - math.pi, 0.0, omega, xtol=1e-12 * omega))
    size = math.hypot(crossing * brake.inertia_kg_m2, brake.damping_Nms_rad)
    size *= math.hypot(1.0, crossing * brake.coil_lag_s) * math.hypot(1.0, crossing * brake.fluid_lag_s)
    return RippleLimit(size, crossing / (2.0 * math.pi))
