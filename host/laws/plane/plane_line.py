"""A virtual fixture: free along a line, stiff across it."""

from __future__ import annotations

import math

from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law

__all__ = ["plane_line"]


class PlaneLineParameters(Parameters):
    """[law.plane_line]."""

    x_m: float = Field(0.2, ge=-1e3, le=1e3, description="a point of the line, x")
    y_m: float = Field(0.0, ge=-1e3, le=1e3, description="a point of the line, y")
    angle_rad: float = Field(0.0, ge=-100, le=100, description="direction of the line")
    K_N_m: float = Field(500.0, ge=0, le=1e7, description="stiffness across, the motors' part")
    B_Ns_m: float = Field(5.0, ge=0, le=1e6, description="damping across, the brakes' part")
    most_N: float = Field(5.0, ge=0, le=1e4, description="the force at which it ends")


@plane_law(PlaneLineParameters, extremes=("most_N",), pushes=True)
def plane_line(motion: PlaneMotionRecord, law: PlaneLineParameters, state: PlaneStateRecord) -> tuple[float, float]:
    r"""A virtual fixture along a line: nothing along it, a spring and a damper across.

    With n across the line and :math:`e = n \cdot (x - x_0)`:

    .. math:: \psi = n\,\mathrm{sat}(K e + B\,n \cdot v), \qquad \psi_{motor} = n\,\mathrm{sat}(K e)

    Source: L. B. Rosenberg, Virtual fixtures: perceptual tools for telerobotic manipulation, IEEE
    VRAIS, 1993, doi:10.1109/VRAIS.1993.380795.
    """
    nx, ny = -math.sin(law.angle_rad), math.cos(law.angle_rad)
    off = law.K_N_m * (nx * (motion.x_m[0] - law.x_m) + ny * (motion.x_m[1] - law.y_m))
    damping = law.B_Ns_m * (nx * motion.v_m_s[0] + ny * motion.v_m_s[1])
    spring = min(max(off, -law.most_N), law.most_N)
    state.motor_N[0], state.motor_N[1] = spring * nx, spring * ny
    force = min(max(off + damping, -law.most_N), law.most_N)
    return force * nx, force * ny
