r"""Bounds from the literature for a virtual spring of stiffness K.

The device has viscous friction b and Coulomb friction c.

Karnopp's friction is such a spring whenever it sticks (K = K_p). The bounds depend on the sampling
time T, the delay :math:`\tau` and the encoder resolution :math:`\Delta`, and assume only that the
hand is passive. All concern a spring; none of them certifies the *slip* phase, whose relay has
infinite slope. They complement a map of the loop's behaviour, but do not replace it.

Derivation: a held spring force lags the true one by T/2 on average, and quantisation adds an error
of at most :math:`\Delta/2`, so the excess power of the spring at speed v is at most

.. math:: K\,(T/2 + \tau)\,v^2 + \tfrac12 K \Delta\,|v|, \qquad \text{and the device dissipates}\quad b\,v^2 + c\,|v|.

Comparing by powers of v gives them all (and the speed below which a device with enough c, but too
little b, is quiet).

Sources: J. E. Colgate, G. G. Schenkel, J. Robotic Systems 14(1):37-47, 1997,
doi:10.1002/(SICI)1097-4563(199701)14:1<37::AID-ROB4>3.0.CO;2-V; J. J. Abbott, A. M. Okamura, IEEE
T-RO 21(5):952-964, 2005, doi:10.1109/TRO.2005.851377; N. Diolaiti, G. Niemeyer, F. Barbagli, J. K.
Salisbury, IEEE T-RO 22(2):256-268, 2006, doi:10.1109/TRO.2005.862487.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Bounds", "abbott_okamura_stiffness", "bounds", "colgate_stiffness", "diolaiti_speed", "diolaiti_stiffness"]


@dataclass(frozen=True)
class Bounds:
    """Largest stiffness that each bound allows [Nm/rad], and whether `stiffness` is within it."""

    stiffness_Nm_rad: float
    colgate_Nm_rad: float
    abbott_okamura_Nm_rad: float
    diolaiti_Nm_rad: float
    diolaiti_quiet_below_rad_s: float
    """Speed below which friction dissipates the spring's excess energy: infinite within the bound,
    0 if quantisation alone exceeds c.
    """

    @property
    def certified(self) -> dict[str, bool]:
        """Return whether each bound certifies the stiffness; False is "not certified", not "unstable"."""
        return {
            "colgate": self.stiffness_Nm_rad <= self.colgate_Nm_rad,
            "abbott_okamura": self.stiffness_Nm_rad <= self.abbott_okamura_Nm_rad,
            "diolaiti": self.stiffness_Nm_rad <= self.diolaiti_Nm_rad,
        }


def _check(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} = {value!r}: expected a finite number of at least 0")
    if values.get("period_s") == 0:
        raise ValueError("period_s = 0: expected a sampling time above 0")


def colgate_stiffness(viscous: float, period_s: float, virtual_damping: float = 0.0) -> float:
    r"""Return the largest passive stiffness :math:`K = 2 (b - |B|) / T` of a sampled wall (Colgate,
    Schenkel 1997; no delay, no quantisation).
    """
    _check(viscous=viscous, period_s=period_s)
    return max(2.0 * (viscous - abs(virtual_damping)) / period_s, 0.0)


def abbott_okamura_stiffness(viscous: float, coulomb: float, period_s: float, count: float) -> float:
    r"""Return :math:`K = \min(2b/T,\; 2c/\Delta)`, necessary and sufficient for a passive wall
    (Abbott, Okamura 2005; no delay).
    """
    _check(viscous=viscous, coulomb=coulomb, period_s=period_s, count=count)
    quantised = 2.0 * coulomb / count if count > 0 else math.inf
    return min(2.0 * viscous / period_s, quantised)


def diolaiti_stiffness(viscous: float, coulomb: float, period_s: float, delay_s: float, count: float) -> float:
    r"""Return :math:`K = \min(b/(T/2 + \tau),\; 2c/\Delta)`: delay included (after Diolaiti et al.
    2006); quiet at any speed.
    """
    _check(viscous=viscous, coulomb=coulomb, period_s=period_s, delay_s=delay_s, count=count)
    quantised = 2.0 * coulomb / count if count > 0 else math.inf
    return min(viscous / (0.5 * period_s + delay_s), quantised)


def diolaiti_speed(
    stiffness: float, viscous: float, coulomb: float, period_s: float, delay_s: float, count: float
) -> float:
    r"""Return the speed [rad/s] below which the device dissipates more than the spring's excess energy.

    .. math:: v^* = \frac{c - K\Delta/2}{K (T/2 + \tau) - b}

    Infinite if b alone is enough; 0 if quantisation generates more than c dissipates. Above v* nothing is certified.
    """
    _check(stiffness=stiffness, viscous=viscous, coulomb=coulomb, period_s=period_s, delay_s=delay_s, count=count)
    left = coulomb - 0.5 * stiffness * count
    excess = stiffness * (0.5 * period_s + delay_s) - viscous
    if left < 0:
        return 0.0
    return left / excess if excess > 0 else math.inf


def bounds(
    stiffness: float, viscous: float, coulomb: float, period_s: float, delay_s: float = 0.0, count: float = 0.0
) -> Bounds:
    """Return all bounds for one loop.

    The friction c is the device's own minus compensation.
    """
    return Bounds(
        stiffness_Nm_rad=stiffness,
        colgate_Nm_rad=colgate_stiffness(viscous, period_s),
        abbott_okamura_Nm_rad=abbott_okamura_stiffness(viscous, coulomb, period_s, count),
        diolaiti_Nm_rad=diolaiti_stiffness(viscous, coulomb, period_s, delay_s, count),
        diolaiti_quiet_below_rad_s=diolaiti_speed(stiffness, viscous, coulomb, period_s, delay_s, count),
    )
