"""The LuGre law: bristles that bend, with the Stribeck effect."""

from __future__ import annotations

import math
from types import MappingProxyType

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law
from coulombus.host.laws.stribeck import stribeck_level

__all__ = ["lugre"]


class LuGreParameters(Parameters):
    """[law.lugre]."""

    at_least = MappingProxyType({"F_s_Nm": "F_c_Nm"})

    F_c_Nm: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction")
    F_s_Nm: float = Field(1.2, gt=0, le=1e4, description="static friction")
    v_s_rad_s: float = Field(0.5, gt=0, le=1e4, description="Stribeck speed")
    sigma_0_Nm_rad: float = Field(100.0, gt=0, le=1e9, description="stiffness of the bristles")
    sigma_1_Nms_rad: float = Field(0.1, ge=0, le=1e6, description="damping of the bristles")
    sigma_2_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="viscous friction")


class LuGreState(LawStateRecord):
    """What it keeps."""

    z_rad: float


@friction_law(LuGreParameters, state=LuGreState, extremes=("F_s_Nm",))
def lugre(motion: MotionRecord, law: LuGreParameters, state: LuGreState) -> float:
    r"""The LuGre law: bristles that bend, with the Stribeck effect.

    .. math::

        \dot z = v - \frac{\sigma_0 |v|}{g(v)}\,z, \quad
        g(v) = F_c + (F_s - F_c)\,e^{-(v/v_s)^2}, \quad
        \psi = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v

    Within a cycle v is one number, and the equation of z is linear: z is carried on by its exact
    exponential, and :math:`\dot z` is that at the end of the cycle. So the law is stable at any
    stiffness and any period, and :math:`|z| \le F_s/\sigma_0` always. The brake bears
    :math:`g(v) + \sigma_2 |v|`.

    Source: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of
    systems with friction, IEEE Trans. Automat. Control 40(3), 1995, doi:10.1109/9.376053.
    """
    v = motion.v_rad_s
    g = stribeck_level(v, law.F_c_Nm, law.F_s_Nm, law.v_s_rad_s)
    state.brake_Nm = g + law.sigma_2_Nms_rad * abs(v)
    if v == 0.0:
        return float(law.sigma_0_Nm_rad * state.z_rad)
    end = math.copysign(g / law.sigma_0_Nm_rad, v)
    rate = abs(v) * law.sigma_0_Nm_rad / g
    away = (state.z_rad - end) * math.exp(-rate * motion.dt_s)
    state.z_rad = end + away
    z_rate = -rate * away
    return float(law.sigma_0_Nm_rad * state.z_rad + law.sigma_1_Nms_rad * z_rate + law.sigma_2_Nms_rad * v)
