"""The generalised Maxwell-slip law: four springs that slip one after the other."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Annotated

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law
from coulombus.host.laws.stribeck import stribeck_level
from coulombus.kernels.records import FloatField

__all__ = ["gms"]


class GmsParameters(Parameters):
    """[law.gms]."""

    at_least = MappingProxyType({"F_s_Nm": "F_c_Nm"})

    F_c_Nm: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction of all elements")
    F_s_Nm: float = Field(1.2, gt=0, le=1e4, description="static friction of all elements")
    v_s_rad_s: float = Field(0.5, gt=0, le=1e4, description="Stribeck speed")
    sigma_2_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="viscous friction")
    C_Nm_s: float = Field(50.0, gt=0, le=1e9, description="how fast a slipping element follows the Stribeck curve")
    w_1: float = Field(1.0, gt=0, le=1e6, description="share of element 1, relative to the sum of all shares")
    w_2: float = Field(1.0, gt=0, le=1e6, description="share of element 2")
    w_3: float = Field(1.0, gt=0, le=1e6, description="share of element 3")
    w_4: float = Field(1.0, gt=0, le=1e6, description="share of element 4")
    k_1_Nm_rad: float = Field(100.0, gt=0, le=1e9, description="stiffness of element 1")
    k_2_Nm_rad: float = Field(50.0, gt=0, le=1e9, description="stiffness of element 2")
    k_3_Nm_rad: float = Field(25.0, gt=0, le=1e9, description="stiffness of element 3")
    k_4_Nm_rad: float = Field(12.5, gt=0, le=1e9, description="stiffness of element 4")


class GmsState(LawStateRecord):
    """What it keeps."""

    F_Nm: Annotated[FloatField, 4]
    slips: Annotated[FloatField, 4]


@friction_law(GmsParameters, state=GmsState, extremes=("F_s_Nm",))
def gms(motion: MotionRecord, law: GmsParameters, state: GmsState) -> float:
    r"""The generalised Maxwell-slip law: four springs that slip one after the other.

    An element sticks, :math:`\dot F_i = k_i v`, until :math:`|F_i| = \alpha_i g(v)` with LuGre's
    g(v) and :math:`\alpha_i = w_i / \sum w`. Then it slips, until the motion turns or stops:

    .. math::

        \dot F_i = \mathrm{sgn}(v)\,C \left(\alpha_i - \frac{|F_i|}{g(v)}\right), \quad
        \psi = \sum F_i + \sigma_2 v

    Its hysteresis has a memory that is not local: behind a small loop it goes on along the large
    one, as if that had not been. Within a cycle v is one number, and both parts are solved exactly,
    with the instant between them. The brake bears :math:`g(v) + \sigma_2 |v|`.

    Source: F. Al-Bender, V. Lampaert, J. Swevers, The generalized Maxwell-slip model: a novel model
    for friction simulation and compensation, IEEE Trans. Automat. Control 50(11), 2005,
    doi:10.1109/TAC.2005.858676.
    """
    v = motion.v_rad_s
    g = stribeck_level(v, law.F_c_Nm, law.F_s_Nm, law.v_s_rad_s)
    state.brake_Nm = g + law.sigma_2_Nms_rad * abs(v)
    shares = (law.w_1, law.w_2, law.w_3, law.w_4)
    stiffness = (law.k_1_Nm_rad, law.k_2_Nm_rad, law.k_3_Nm_rad, law.k_4_Nm_rad)
    whole = law.w_1 + law.w_2 + law.w_3 + law.w_4
    sense = 0.0 if v == 0.0 else math.copysign(1.0, v)
    psi_Nm = law.sigma_2_Nms_rad * v
    for i in range(4):
        level = sense * g * shares[i] / whole
        left = motion.dt_s
        if sense == 0.0:
            state.slips[i] = 0.0
        elif state.slips[i] != sense:
            wound = state.F_Nm[i] + stiffness[i] * v * left
            if sense * (wound - level) < 0.0:
                state.F_Nm[i] = wound
                state.slips[i] = 0.0
            else:
                state.slips[i] = sense
                if sense * (state.F_Nm[i] - level) < 0.0:
                    left -= (level - state.F_Nm[i]) / (stiffness[i] * v)
                    state.F_Nm[i] = level
        if state.slips[i] != 0.0:
            state.F_Nm[i] = level + (state.F_Nm[i] - level) * math.exp(-law.C_Nm_s * max(left, 0.0) / g)
        psi_Nm += state.F_Nm[i]
    return float(psi_Nm)
