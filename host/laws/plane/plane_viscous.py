"""A viscous damper in the plane."""

from __future__ import annotations

import math

from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law

__all__ = ["plane_viscous"]


class PlaneViscousParameters(Parameters):
    """[law.plane_viscous]."""

    B_Ns_m: float = Field(10.0, ge=0, le=1e6, description="viscous friction")
    most_N: float = Field(5.0, ge=0, le=1e4, description="the force at which it ends")


@plane_law(PlaneViscousParameters, extremes=("most_N",))
def plane_viscous(
    motion: PlaneMotionRecord, law: PlaneViscousParameters, state: PlaneStateRecord
) -> tuple[float, float]:
    r"""A viscous damper in the plane that ends at a force: :math:`\psi = B v`, at most :math:`F_{max}` long.

    It turns with the velocity (rotation invariance). Along a straight line it is the law ``viscous``. The
    brakes hold nothing at rest.

    Source: J. E. Colgate, G. G. Schenkel, Passivity of a class of sampled-data systems, J. Robotic
    Systems 14(1), 1997, doi:10.1002/(SICI)1097-4563(199701)14:1<37::AID-ROB4>3.0.CO;2-V.
    """
    fx, fy = law.B_Ns_m * motion.v_m_s[0], law.B_Ns_m * motion.v_m_s[1]
    size = math.hypot(fx, fy)
    if size > law.most_N:
        return fx * law.most_N / size, fy * law.most_N / size
    return fx, fy
