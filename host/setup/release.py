r"""Speed of a hand when the brake releases it, for `check`.

The hand that leans on the brake is the rig file's [operator]: a spring :math:`K`, loaded to the brake's
limit :math:`F`, with damping :math:`B`. Hand and handle have the inertia :math:`J`. While the brake's
torque falls at the rate :math:`R`, the handle moves by

.. math:: J \dot v + B v + K \int v\,dt = R t.

Its speed begins at 0, approaches :math:`R / K`, and overshoots it by the share
:math:`e^{-\pi\zeta/\sqrt{1-\zeta^2}}` with :math:`\zeta = B / (2\sqrt{JK})`. The pauses of the release
only reduce the speed. A brake that is switched off at once gives the step response of the same system.

In mode active the motor bears the load. An orderly end lets the brake rise first, so the same release follows.
When the motor fails, the handle is free until the host notices, and the brake takes over behind its lags
(`speed_of_failure`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from coulombus.host.cycle.brake_model import DEFAULT_LAG_S
from coulombus.host.cycle.output_limits import brake_bears_motor, brake_limit, motor_limit_Nm
from coulombus.host.setup.law_demand import law_extremes
from coulombus.rigs.axis import Axis
from coulombus.rigs.plant import Operator

__all__ = [
    "GENTLE_RAD_S",
    "MotorFailure",
    "Release",
    "failure_of",
    "release_of",
    "speed_of_failure",
    "speed_of_ramp",
    "speed_of_step",
]

GENTLE_RAD_S = 1.2
"""Largest speed of a release that does not throw a hand."""
STEP_S, LONGEST_S = 1e-5, 0.5
"""Step and end of the integration after the motor's failure."""
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


def _loaded(axis: Axis) -> tuple[float, float, float]:
    """Return damping, stiffness and inertia of the hand on the handle."""
    hand = axis.operator or LIGHT_HAND
    B = axis.mechanics.viscous_Nms_rad + hand.damping_Nms_rad
    return B, hand.stiffness_Nm_rad, axis.mechanics.inertia_kg_m2 + hand.inertia_kg_m2


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
    limits = axis.limits
    B, K, J = _loaded(axis)
    at_once = speed_of_step(load_Nm, B, K, J)

    def ramped(time_s: float) -> float:
        return min(speed_of_ramp(load_Nm / time_s, B, K, J), at_once) if time_s > 0.0 else at_once

    within_s = max(limits.safe_ramp_s, axis.bus.period_s) + limits.safe_hold_s
    return Release(axis.name, load_Nm, ramped(limits.safe_ramp_s), within_s, ramped(driver_ramp_s))


class MotorFailure(NamedTuple):
    """A hand in mode active bears `load_Nm` besides the friction, and the motor's torque ends.

    Attributes
    ----------
    load_Nm : the law's largest output, at most the motor's limit
    noticed_s : longest time until the brake's set-point acts
    speed_rad_s : largest speed of the handle
    alone_rad_s : largest speed if the brake gives no torque either
    brake_bears : whether the brake can bear as much as the motor
    """

    axis: str
    load_Nm: float
    noticed_s: float
    speed_rad_s: float
    alone_rad_s: float
    brake_bears: bool

    def __str__(self) -> str:
        axis = f"{self.axis}: " if self.axis else ""
        text = (
            f"{axis}mode active: when the motor fails, the brake takes over {self.load_Nm:g} Nm after {1e3 * self.noticed_s:.3g} ms "
            f"and its lag; the hand moves with at most {self.speed_rad_s:.2g} rad/s, and with {self.alone_rad_s:.2g} rad/s if "
            "the brake has failed"
        )
        return text if self.brake_bears else f"{text}. The brake is weaker than the motor and bears only a part of it"


def speed_of_failure(axis: Axis, load_Nm: float, noticed_s: float) -> float:
    """Return the largest speed [rad/s] of a hand whose load on the motor falls to the brake.

    The hand's equation is that of the release; the brake's torque is 0 for `noticed_s`, then that of its lags
    (`[brake]`, else the default lag) behind a set-point at its limit, up to the load.
    """
    B, K, J = _loaded(axis)
    limit_Nm = brake_limit(axis)[0]
    coil_s, fluid_s = axis.brake.coil_lag_s, axis.brake.fluid_lag_s
    if coil_s <= 0.0 and fluid_s <= 0.0:
        fluid_s = DEFAULT_LAG_S
    v = x = coil = fluid = t = fastest_rad_s = 0.0
    dt = STEP_S
    while v >= 0.0 and t < LONGEST_S:
        setpoint_Nm = 0.0 if t < noticed_s else limit_Nm if fluid < load_Nm else load_Nm
        coil = setpoint_Nm if coil_s <= 0.0 else coil + (setpoint_Nm - coil) * min(dt / coil_s, 1.0)
        fluid = coil if fluid_s <= 0.0 else fluid + (coil - fluid) * min(dt / fluid_s, 1.0)
        v += (load_Nm - min(fluid, load_Nm) - B * v - K * x) / J * dt
        x += v * dt
        t += dt
        fastest_rad_s = max(fastest_rad_s, v)
    return fastest_rad_s


def failure_of(axis: Axis) -> MotorFailure:
    """Return the worst failure of an axis' motor in mode active: its power or its TPDOs are lost."""
    limit_Nm = motor_limit_Nm(axis, "active")
    load_Nm = min(max(law_extremes(axis, "active"), default=limit_Nm), limit_Nm)
    noticed_s = (axis.limits.missed_tpdo_cycles + axis.bus.cycles_to_actuation) * axis.bus.period_s
    speed = speed_of_failure(axis, load_Nm, noticed_s)
    alone = speed_of_failure(axis, load_Nm, math.inf)
    return MotorFailure(axis.name, load_Nm, noticed_s, speed, alone, brake_bears_motor(axis, "active"))
