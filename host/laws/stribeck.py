"""Stribeck friction: a level that falls with speed (three forms), and a viscous part."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Literal

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law
from coulombus.kernels.decorator import inlined

__all__ = ["stribeck", "stribeck_level"]


class StribeckParameters(Parameters):
    """[law.stribeck]."""

    at_least = MappingProxyType({"F_s_Nm": "F_c_Nm"})

    F_c_Nm: float = Field(1.0, ge=0, le=1e4, description="Coulomb friction")
    F_s_Nm: float = Field(1.2, ge=0, le=1e4, description="static friction")
    v_s_rad_s: float = Field(0.5, gt=0, le=1e4, description="Stribeck speed")
    sigma_2_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="viscous friction")
    form: Literal["gauss", "tustin", "lorentz"] = Field("gauss", description="how the level falls with the speed")


@inlined
def stribeck_level(v: float, F_c_Nm: float, F_s_Nm: float, v_s_rad_s: float) -> float:
    r"""Return the Stribeck curve :math:`g(v) = F_c + (F_s - F_c)\,e^{-(v/v_s)^2}` [Nm]."""
    ratio = v / v_s_rad_s
    return F_c_Nm + (F_s_Nm - F_c_Nm) * math.exp(-ratio * ratio)


@friction_law(StribeckParameters, extremes=("F_s_Nm",))
def stribeck(motion: MotionRecord, law: StribeckParameters, state: LawStateRecord) -> float:
    r"""Stribeck friction: a level that falls with speed (three forms), and a viscous part.

    .. math::

        \psi = \left(F_c + (F_s - F_c)\,s(v)\right)\mathrm{sgn}(v) + \sigma_2 v, \quad
        \mathrm{sgn}(0) = 0

    with :math:`s = e^{-(v/v_s)^2}` (gauss), :math:`e^{-|v|/v_s}` (tustin),
    :math:`1/(1 + (v/v_s)^2)` (lorentz). With F_s = F_c it is Coulomb and viscous friction. The brake
    bears :math:`|\psi|`, at rest F_s.

    Source: B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools
    and compensation methods for the control of machines with friction, Automatica 30(7), 1994,
    doi:10.1016/0005-1098(94)90209-7.
    """
    v = motion.v_rad_s
    ratio = abs(v) / law.v_s_rad_s
    if law.form == 0.0:  # type: ignore[comparison-overlap]  # a choice is its place
        level = stribeck_level(v, law.F_c_Nm, law.F_s_Nm, law.v_s_rad_s)
    else:
        share = math.exp(-ratio) if law.form == 1.0 else 1.0 / (1.0 + ratio * ratio)  # type: ignore[comparison-overlap]
        level = law.F_c_Nm + (law.F_s_Nm - law.F_c_Nm) * share
    level += law.sigma_2_Nms_rad * abs(v)
    state.brake_Nm = level
    if v == 0.0:
        return 0.0
    return math.copysign(level, v)
