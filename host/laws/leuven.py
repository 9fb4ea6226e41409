"""The Leuven law: LuGre's bristles on a hysteresis with non-local memory."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Annotated

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law
from coulombus.host.laws.stribeck import stribeck_level
from coulombus.kernels.records import FloatField

__all__ = ["leuven"]

PIECES = 12
"""A cycle has at most five: one for each element that begins to slip, and the last."""


class LeuvenParameters(Parameters):
    """[law.leuven]."""

    at_least = MappingProxyType({"F_s_Nm": "F_c_Nm"})

    F_c_Nm: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction")
    F_s_Nm: float = Field(1.2, gt=0, le=1e4, description="static friction, and what the hysteresis bears at most")
    v_s_rad_s: float = Field(0.5, gt=0, le=1e4, description="Stribeck speed")
    sigma_1_Nms_rad: float = Field(0.1, ge=0, le=1e6, description="damping of the bristles")
    sigma_2_Nms_rad: float = Field(0.0, ge=0, le=1e6, description="viscous friction")
    w_1: float = Field(1.0, gt=0, le=1e6, description="share of element 1, relative to the sum of all shares")
    w_2: float = Field(1.0, gt=0, le=1e6, description="share of element 2")
    w_3: float = Field(1.0, gt=0, le=1e6, description="share of element 3")
    w_4: float = Field(1.0, gt=0, le=1e6, description="share of element 4")
    k_1_Nm_rad: float = Field(100.0, gt=0, le=1e9, description="stiffness of element 1")
    k_2_Nm_rad: float = Field(50.0, gt=0, le=1e9, description="stiffness of element 2")
    k_3_Nm_rad: float = Field(25.0, gt=0, le=1e9, description="stiffness of element 3")
    k_4_Nm_rad: float = Field(12.5, gt=0, le=1e9, description="stiffness of element 4")


class LeuvenState(LawStateRecord):
    """What it keeps."""

    F_Nm: Annotated[FloatField, 4]


@friction_law(LeuvenParameters, state=LeuvenState, extremes=("F_s_Nm",))
def leuven(motion: MotionRecord, law: LeuvenParameters, state: LeuvenState) -> float:
    r"""The Leuven law: LuGre's bristles on a hysteresis with non-local memory.

    .. math::

        \dot z = v \left(1 - \mathrm{sgn}(v)\,\frac{F_h(z)}{g(v)}\right), \quad
        \psi = F_h(z) + \sigma_1 \dot z + \sigma_2 v

    with LuGre's g(v). F_h is that of four springs :math:`k_i` beside each other, each of which slips at
    its :math:`w_i F_s / \sum w`: what it is depends on every point of return that has not been passed
    again. With one element it is Dahl's law.

    Within a cycle v is one number, and F_h goes to :math:`g\,\mathrm{sgn}(v)` as an exponential of the
    way while the same springs stick. So each piece is solved exactly, with the place at which the next
    spring slips. The brake bears :math:`g(v) + \sigma_2 |v|`.

    Source: J. Swevers, F. Al-Bender, C. G. Ganseman, T. Prajogo, An integrated friction model structure
    with improved presliding behavior for accurate friction compensation, IEEE Trans. Automat. Control
    45(4), 2000, doi:10.1109/9.847103; with the hysteresis of V. Lampaert, J. Swevers, F. Al-Bender,
    Modification of the Leuven integrated friction model structure, IEEE Trans. Automat. Control 47(4),
    2002, doi:10.1109/9.995050; their exponent n is 1 here.
    """
    v = motion.v_rad_s
    g = stribeck_level(v, law.F_c_Nm, law.F_s_Nm, law.v_s_rad_s)
    state.brake_Nm = g + law.sigma_2_Nms_rad * abs(v)
    shares = (law.w_1, law.w_2, law.w_3, law.w_4)
    stiffness = (law.k_1_Nm_rad, law.k_2_Nm_rad, law.k_3_Nm_rad, law.k_4_Nm_rad)
    whole = law.w_1 + law.w_2 + law.w_3 + law.w_4
    sense = 0.0 if v == 0.0 else math.copysign(1.0, v)
    left = abs(v) * motion.dt_s
    bears = 0.0
    for i in range(4):
        bears += state.F_Nm[i]
    for _ in range(PIECES):
        short = 1.0 - sense * bears / g  # dz over the way, in the sense of the motion
        if left <= 0.0 or short == 0.0:
            break
        way = sense if short > 0.0 else -sense  # of z: back where g has fallen below what is borne
        stiff, edge = 0.0, math.inf
        for i in range(4):
            room = law.F_s_Nm * shares[i] / whole - way * state.F_Nm[i]
            if room > 0.0:
                stiff += stiffness[i]
                edge = min(edge, room / stiffness[i])
        if stiff == 0.0:
            break
        far = abs(short) * g / stiff  # how far z could go
        z = -far * math.expm1(-left * stiff / g)
        if z < edge or edge >= far:
            left = 0.0
        else:
            z = edge
            left += math.log1p(-edge / far) * g / stiff
        bears = 0.0
        for i in range(4):
            level = law.F_s_Nm * shares[i] / whole
            room = level - way * state.F_Nm[i]
            if room > 0.0:
                wound = state.F_Nm[i] + way * stiffness[i] * z
                state.F_Nm[i] = way * level if room <= stiffness[i] * z * (1.0 + 1e-12) else wound
            bears += state.F_Nm[i]
    z_rate = v * (1.0 - sense * bears / g)
    return float(bears + law.sigma_1_Nms_rad * z_rate + law.sigma_2_Nms_rad * v)
