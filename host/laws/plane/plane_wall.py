"""A virtual wall in the plane: the motors' stiffness and the brakes' damping."""

from __future__ import annotations

import math

from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law

__all__ = ["plane_wall"]


class PlaneWallParameters(Parameters):
    """[law.plane_wall]."""

    angle_rad: float = Field(0.0, ge=-100, le=100, description="direction into the wall, at right angles to its face")
    distance_m: float = Field(0.3, ge=-1e3, le=1e3, description="of the wall's face from (0, 0) along angle_rad")
    K_N_m: float = Field(500.0, ge=0, le=1e7, description="stiffness, the motors' part")
    B_Ns_m: float = Field(5.0, ge=0, le=1e6, description="damping within, the brakes' part")
    most_N: float = Field(5.0, ge=0, le=1e4, description="the force at which it ends")


@plane_law(PlaneWallParameters, extremes=("most_N",), pushes=True)
def plane_wall(motion: PlaneMotionRecord, law: PlaneWallParameters, state: PlaneStateRecord) -> tuple[float, float]:
    r"""A virtual wall in the plane, without friction along its face.

    Within, for the depth :math:`p = n \cdot x - d > 0` with :math:`n = (\cos\beta, \sin\beta)`:

    .. math:: \psi = n\,\mathrm{sat}(\max(K p + B\,n \cdot v, 0)), \quad \psi_{motor} = n\,\mathrm{sat}(K p)

    Outside both are 0. The wall never pulls. Along n this is the law ``wall`` of one axis.

    Source: the paper, Fig. 8; J. J. Abbott, A. M. Okamura, IEEE Trans. Robotics 21(5), 2005,
    doi:10.1109/TRO.2005.851377.
    """
    nx, ny = math.cos(law.angle_rad), math.sin(law.angle_rad)
    depth = nx * motion.x_m[0] + ny * motion.x_m[1] - law.distance_m
    if depth <= 0.0:
        state.motor_N[0] = state.motor_N[1] = 0.0
        return 0.0, 0.0
    spring = min(law.K_N_m * depth, law.most_N)
    state.motor_N[0], state.motor_N[1] = spring * nx, spring * ny
    damping = law.B_Ns_m * (nx * motion.v_m_s[0] + ny * motion.v_m_s[1])
    force = min(max(law.K_N_m * depth + damping, 0.0), law.most_N)
    return force * nx, force * ny
