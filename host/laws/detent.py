"""Detents: places at which the handle likes to rest."""

from __future__ import annotations

import math

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["detent"]


class DetentParameters(Parameters):
    """[law.detent]."""

    A_Nm: float = Field(0.5, ge=0, le=1e4, description="largest torque of a detent")
    F_c_Nm: float = Field(0.1, ge=0, le=1e4, description="level of the damping, which the brake bears")
    v_t_rad_s: float = Field(0.5, gt=0, le=1e4, description="speed at which the damping has its level")
    period_rad: float = Field(0.5, gt=0, le=1e6, description="angle from one detent to the next")


@friction_law(DetentParameters)
def detent(motion: MotionRecord, law: DetentParameters, state: LawStateRecord) -> float:
    r"""Detents: places at which the handle likes to rest.

    .. math:: \psi = A \sin\frac{2\pi x}{P} + F_c\,\mathrm{sat}(v/v_t)

    The first part is the slope of a potential: it gives back what it takes, and pulls the handle to
    the angles n P. The second makes up for what a sampled display gives besides. The brake bears
    F_c.

    Source of the bound of its stiffness :math:`2\pi A/P` in a sampled display: J. J. Abbott, A. M.
    Okamura, Effects of position quantization and sampling rate on virtual-wall passivity, IEEE
    Trans. Robotics 21(5), 2005, doi:10.1109/TRO.2005.851377.
    """
    share = min(max(motion.v_rad_s / law.v_t_rad_s, -1.0), 1.0)
    state.brake_Nm = law.F_c_Nm * abs(share)
    return float(law.A_Nm * math.sin(2.0 * math.pi * motion.x_rad / law.period_rad) + law.F_c_Nm * share)
