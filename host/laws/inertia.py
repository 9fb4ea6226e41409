"""A virtual inertia beside the handle's own."""

from __future__ import annotations

import math

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["inertia"]


class InertiaParameters(Parameters):
    """[law.inertia]."""

    J_kg_m2: float = Field(1e-3, ge=0, le=1e3, description="inertia that is felt besides")
    filter_s: float = Field(0.02, gt=0, le=10, description="time constant of the acceleration's filter")
    most_Nm: float = Field(1.0, ge=0, le=1e4, description="the torque at which it ends")


class InertiaState(LawStateRecord):
    """What it keeps."""

    v_rad_s: float


@friction_law(InertiaParameters, state=InertiaState, extremes=("most_Nm",))
def inertia(motion: MotionRecord, law: InertiaParameters, state: InertiaState) -> float:
    r"""A virtual inertia beside the handle's own.

    .. math:: \dot v_f = (v - v_f)/\tau_f, \quad \psi = \mathrm{sat}(J \dot v_f/\tau_{max})\,\tau_{max}

    An encoder tells no acceleration, so it is that of a filtered speed: solved exactly within a
    cycle, and averaged over it. It stores energy and gives it back; a brake cannot, and bears nothing.

    Source of what a filter costs: J. E. Colgate, J. M. Brown, Factors affecting the Z-width of a
    haptic display, IEEE Int. Conf. Robotics and Automation, 1994, doi:10.1109/ROBOT.1994.351077.
    """
    state.brake_Nm = 0.0
    gained = (motion.v_rad_s - state.v_rad_s) * (1.0 - math.exp(-motion.dt_s / law.filter_s))
    state.v_rad_s += gained
    return float(min(max(law.J_kg_m2 * gained / motion.dt_s, -law.most_Nm), law.most_Nm))
