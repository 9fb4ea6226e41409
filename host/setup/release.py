r"""Speed of a hand when the brake releases it, for `check`.

The hand that leans on the brake is the rig file's [operator]: a spring :math:`K`, loaded to the brake's
limit :math:`F`, with damping :math:`B`. Hand and handle have the inertia :math:`J`. While the brake's
torque falls at the rate :math:`R`, the handle moves by

.. math:: J \dot v + B v + K \int v\,dt = R t.

Its speed begins at 0, approaches :math:`R / K`, and overshoots it by the share
:math:`e^{-\pi\zeta/\sqrt{1-\zeta^2}}` with :math:`\zeta = B / (2\sqrt{JK})`. The pauses of the release
only reduce the speed. A brake that is switched off at once gives the step response of the same system.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from coulombus.rigs.axis import Axis
from coulombus.rigs.plant import Operator

__all__ = ["GENTLE_RAD_S", "Release", "release_of", "speed_of_ramp", "speed_of_step"]

GENTLE_RAD_S = 1.2
"""Largest speed of a release that does not throw a hand."""
LIGHT_HAND = Operator(
    inertia_kg_m2=5e-4, damping_Nms_rad=0.1, stiffness_Nm_rad=5.0, tremor_Nm=0.0, tremor_Hz=0.0, population=0.0
)
"""Default hand for a rig file without [operator]."""


class Release(NamedTuple):
    """The release of a hand that bears `load_Nm`, the brake's limit.

    Attributes
    ----------
    speed_rad_s, within_s : largest speed and duration when the host ramps the brake off, after an end or
        a trip
    alone_rad_s : largest speed when the brake's own driver ends the torque, as after the host's loss
    """

    axis: str
    load_Nm: float
    speed_rad_s: float
    within_s: float
    alone_rad_s: float

    def __str__(self) -> str:
        axis = f"{self.axis}: " if self.axis else ""
        return (
            f"{axis}a hand that bears {self.load_Nm:g} Nm is let go with at most {self.speed_rad_s:.2g} rad/s after an end or a "
            f"trip, within {self.within_s:g} s; with {self.alone_rad_s:.2g} rad/s where the brake's driver ends its torque alone"
        )

    @property
    def is_gentle(self) -> bool:
        """Whether the host's release does not throw a hand."""
        return self.speed_rad_s <= GENTLE_RAD_S


def _damping(B: float, K: float, J: float) -> float:
    """Return the damping ratio."""
    return B / (2.0 * math.sqrt(J * K))


def speed_of_ramp(rate_Nm_s: float, B: float, K: float, J: float) -> float:
    """Return the largest speed [rad/s] while the brake's torque falls at a rate.

    It is infinite for a hand without a spring; `speed_of_step`, at which the damping bears the load, bounds
    the speed of such a hand.
    """
    if K <= 0.0:
        return math.inf
    zeta = _damping(B, K, J)
    overshoot = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta * zeta)) if zeta < 1.0 else 0.0
    return rate_Nm_s / K * (1.0 + overshoot)


def speed_of_step(load_Nm: float, B: float, K: float, J: float) -> float:
    """Return the largest speed [rad/s] when the brake's torque ends at once."""
    if K <= 0.0:
        return math.inf if B <= 0.0 else load_Nm / B
    zeta, natural = _damping(B, K, J), math.sqrt(K / J)
    if zeta < 1.0:
        root = math.sqrt(1.0 - zeta * zeta)
        share = math.exp(-zeta / root * math.acos(zeta))
    elif zeta == 1.0:
        share = math.exp(-1.0)
    else:
        root = math.sqrt(zeta * zeta - 1.0)
        share = math.exp(-zeta / root * math.acosh(zeta))
    return load_Nm / (J * natural) * share


def release_of(axis: Axis, load_Nm: float, driver_ramp_s: float) -> Release:
    """Return the worst release of an axis.

    Parameters
    ----------
    load_Nm : the brake's limit
    driver_ramp_s : time in which the brake's own driver ramps it off; 0: at once
    """
    limits, hand = axis.limits, axis.operator or LIGHT_HAND
    J = axis.mechanics.inertia_kg_m2 + hand.inertia_kg_m2
    B, K = axis.mechanics.viscous_Nms_rad + hand.damping_Nms_rad, hand.stiffness_Nm_rad
    at_once = speed_of_step(load_Nm, B, K, J)

    def ramped(time_s: float) -> float:
        return min(speed_of_ramp(load_Nm / time_s, B, K, J), at_once) if time_s > 0.0 else at_once

    within_s = max(limits.safe_ramp_s, axis.bus.period_s) + limits.safe_hold_s
    return Release(axis.name, load_Nm, ramped(limits.safe_ramp_s), within_s, ramped(driver_ramp_s))
