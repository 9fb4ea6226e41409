"""Karnopp's friction in the plane: a stick spring within an ellipse of forces, and a level in slip."""

from __future__ import annotations

import math
from typing import Annotated

from coulombus.host.laws.plane.limit_ellipse import gauge, slip_force
from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law
from coulombus.kernels.records import FloatField

__all__ = ["plane_karnopp"]


class PlaneKarnoppParameters(Parameters):
    """[law.plane_karnopp]."""

    K_p_N_m: float = Field(5000.0, gt=0, le=1e8, description="stiffness of the stick spring")
    F_s_N: float = Field(3.3, ge=0, le=1e4, description="static friction along angle_rad")
    F_d_N: float = Field(3.0, ge=0, le=1e4, description="dynamic friction along angle_rad")
    ratio: float = Field(1.0, ge=0.01, le=100, description="both levels across over those along; 1: isotropic")
    angle_rad: float = Field(0.0, ge=-100, le=100, description="direction of the levels along")
    band_m_s: float = Field(0.005, ge=0, le=1e3, description="stuck at or below this speed")


class PlaneKarnoppState(PlaneStateRecord):
    """State of the law."""

    anchor_m: Annotated[FloatField, 2]  # position at which the stick spring is at rest


@plane_law(PlaneKarnoppParameters, state=PlaneKarnoppState, extremes=("F_s_N", "F_d_N"))
def plane_karnopp(
    motion: PlaneMotionRecord, law: PlaneKarnoppParameters, state: PlaneKarnoppState
) -> tuple[float, float]:
    r"""Karnopp's stick-slip friction in the plane.

    .. math::

        \psi = \begin{cases} F_d\,v/|v| & |v| > \Delta v \\
               K_p (x - x_{stuck}) \text{ within the disc } F_s & |v| \le \Delta v \end{cases}

    At stick entry and on saturation :math:`x_{stuck} = x - \psi/K_p`. The limit is the ellipse of
    `host.laws.plane.limit_ellipse`; a spring force beyond it is shortened along its own direction. Along
    a straight line this is the law ``karnopp`` of one axis. With ``ratio`` 1 nothing depends on the
    direction (rotation invariance).

    Source: D. Karnopp, J. Dyn. Sys. Meas. Control 107(1), 1985, doi:10.1115/1.3140698.
    """
    vx, vy = motion.v_m_s[0], motion.v_m_s[1]
    hand = math.hypot(motion.hand_N[0], motion.hand_N[1])
    share = gauge(motion.hand_N[0], motion.hand_N[1], law.F_s_N, law.ratio, law.angle_rad)
    state.hold_N = hand / share if hand > 0.0 and share > 0.0 else law.F_s_N * min(law.ratio, 1.0)
    if math.hypot(vx, vy) > law.band_m_s:
        state.stuck = 0
        return slip_force(vx, vy, law.F_d_N, law.ratio, law.angle_rad)
    if state.stuck == 0:
        state.stuck = 1
        for i in range(2):
            state.anchor_m[i] = motion.x_m[i] - state.psi_N[i] / law.K_p_N_m
    fx = law.K_p_N_m * (motion.x_m[0] - state.anchor_m[0])
    fy = law.K_p_N_m * (motion.x_m[1] - state.anchor_m[1])
    beyond = gauge(fx, fy, law.F_s_N, law.ratio, law.angle_rad)
    if beyond > 1.0:
        fx, fy = fx / beyond, fy / beyond
        state.anchor_m[0] = motion.x_m[0] - fx / law.K_p_N_m
        state.anchor_m[1] = motion.x_m[1] - fy / law.K_p_N_m
    return fx, fy
