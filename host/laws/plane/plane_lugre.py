"""The LuGre law in the plane: one bristle that bends as a vector."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Annotated

from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law
from coulombus.host.laws.stribeck import stribeck_level
from coulombus.kernels.records import FloatField

__all__ = ["plane_lugre"]


class PlaneLuGreParameters(Parameters):
    """[law.plane_lugre]."""

    at_least = MappingProxyType({"F_s_N": "F_c_N"})

    F_c_N: float = Field(3.0, gt=0, le=1e4, description="Coulomb friction")
    F_s_N: float = Field(3.3, gt=0, le=1e4, description="static friction")
    v_s_m_s: float = Field(0.05, gt=0, le=1e4, description="Stribeck speed")
    sigma_0_N_m: float = Field(2000.0, gt=0, le=1e9, description="stiffness of the bristle")
    sigma_1_Ns_m: float = Field(2.0, ge=0, le=1e6, description="damping of the bristle")
    sigma_2_Ns_m: float = Field(0.0, ge=0, le=1e6, description="viscous friction")


class PlaneLuGreState(PlaneStateRecord):
    """State of the law."""

    z_m: Annotated[FloatField, 2]  # deflection of the bristle


@plane_law(PlaneLuGreParameters, state=PlaneLuGreState, extremes=("F_s_N",))
def plane_lugre(motion: PlaneMotionRecord, law: PlaneLuGreParameters, state: PlaneLuGreState) -> tuple[float, float]:
    r"""The LuGre law in the plane, with a bristle z that is a vector.

    .. math::

        \dot z = v - \frac{\sigma_0 |v|}{g(|v|)}\,z, \quad
        g = F_c + (F_s - F_c)\,e^{-(|v|/v_s)^2}, \quad
        \psi = \sigma_0 z + \sigma_1 \dot z + \sigma_2 v

    Within a cycle v is constant, and z approaches :math:`g v/(\sigma_0 |v|)` by its exact exponential. So
    :math:`|z| \le F_s/\sigma_0` always holds. The law turns with the velocity (rotation invariance). Along a
    straight line it is the law ``lugre``.

    Source: E. Velenis, P. Tsiotras, C. Canudas de Wit, M. Sorine, Dynamic tyre friction models for
    combined longitudinal and lateral vehicle motion, Vehicle System Dynamics 43(1), 2005; C. Canudas
    de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE Trans. Automat. Control 40(3), 1995,
    doi:10.1109/9.376053.
    """
    vx, vy = motion.v_m_s[0], motion.v_m_s[1]
    speed = math.hypot(vx, vy)
    state.hold_N = law.F_s_N
    if speed == 0.0:
        return law.sigma_0_N_m * state.z_m[0], law.sigma_0_N_m * state.z_m[1]
    g = stribeck_level(speed, law.F_c_N, law.F_s_N, law.v_s_m_s)
    bend = g / (law.sigma_0_N_m * speed)
    rate = speed * law.sigma_0_N_m / g
    decay = math.exp(-rate * motion.dt_s)
    away_x, away_y = (state.z_m[0] - bend * vx) * decay, (state.z_m[1] - bend * vy) * decay
    state.z_m[0], state.z_m[1] = bend * vx + away_x, bend * vy + away_y
    damping = law.sigma_1_Ns_m * rate
    return (
        law.sigma_0_N_m * state.z_m[0] - damping * away_x + law.sigma_2_Ns_m * vx,
        law.sigma_0_N_m * state.z_m[1] - damping * away_y + law.sigma_2_Ns_m * vy,
    )
