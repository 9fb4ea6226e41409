"""Coulomb's friction in the plane."""

from __future__ import annotations

import math

from coulombus.host.laws.plane.limit_ellipse import gauge, slip_force
from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law

__all__ = ["plane_coulomb"]


class PlaneCoulombParameters(Parameters):
    """[law.plane_coulomb]."""

    F_d_N: float = Field(3.0, ge=0, le=1e4, description="c, the level of the friction along angle_rad")
    ratio: float = Field(1.0, ge=0.01, le=100, description="the level across over that along; 1: isotropic")
    angle_rad: float = Field(0.0, ge=-100, le=100, description="direction of the level along")
    band_m_s: float = Field(0.0, ge=0, le=1e3, description="no friction at or below this speed")


@plane_law(PlaneCoulombParameters, extremes=("F_d_N",))
def plane_coulomb(
    motion: PlaneMotionRecord, law: PlaneCoulombParameters, state: PlaneStateRecord
) -> tuple[float, float]:
    r"""Coulomb friction in the plane: :math:`\psi = c\,v/|v|`, or on an ellipse.

    Within the velocity band psi is 0, and brakes hold the level. The force in slip is that of
    `host.laws.plane.limit_ellipse`; with ``ratio`` 1 it turns with the velocity (rotation invariance).
    """
    vx, vy = motion.v_m_s[0], motion.v_m_s[1]
    hand = math.hypot(motion.hand_N[0], motion.hand_N[1])
    share = gauge(motion.hand_N[0], motion.hand_N[1], law.F_d_N, law.ratio, law.angle_rad)
    state.hold_N = hand / share if hand > 0.0 and share > 0.0 else law.F_d_N * min(law.ratio, 1.0)
    if math.hypot(vx, vy) <= law.band_m_s:
        state.stuck = 1
        return 0.0, 0.0
    state.stuck = 0
    return slip_force(vx, vy, law.F_d_N, law.ratio, law.angle_rad)
