"""Dahl's friction in the plane: a spring that yields towards the Coulomb level along the motion."""

from __future__ import annotations

import math
from typing import Annotated

from coulombus.host.laws.plane.plane_law import Field, Parameters, PlaneMotionRecord, PlaneStateRecord, plane_law
from coulombus.kernels.records import FloatField

__all__ = ["plane_dahl"]


class PlaneDahlParameters(Parameters):
    """[law.plane_dahl]."""

    F_c_N: float = Field(3.0, gt=0, le=1e4, description="Coulomb friction")
    sigma_N_m: float = Field(2000.0, gt=0, le=1e9, description="stiffness at a friction of 0")


class PlaneDahlState(PlaneStateRecord):
    """State of the law."""

    F_N: Annotated[FloatField, 2]  # the spring's force


@plane_law(PlaneDahlParameters, state=PlaneDahlState, extremes=("F_c_N",))
def plane_dahl(motion: PlaneMotionRecord, law: PlaneDahlParameters, state: PlaneDahlState) -> tuple[float, float]:
    r"""Dahl's friction in the plane.

    .. math:: \frac{d\psi}{ds} = \sigma \left(\frac{v}{|v|} - \frac{\psi}{F_c}\right)

    along the path s; it depends on the path alone. A step is solved exactly: psi approaches
    :math:`F_c v/|v|` with :math:`e^{-\sigma |v| dt/F_c}`. With the stored energy :math:`|\psi|^2/2\sigma`
    the law is passive: it dissipates :math:`|\psi|^2/F_c` per length of path. It turns with the velocity
    (rotation invariance). Along a straight line it is the law ``dahl`` with alpha = 1.

    Source: P. R. Dahl, AIAA J. 14(12), 1976, doi:10.2514/3.61511; as a vector: V. Hayward, B. Armstrong,
    A new computational model of friction applied to haptic rendering, Experimental Robotics VI, 2000.
    """
    vx, vy = motion.v_m_s[0], motion.v_m_s[1]
    speed = math.hypot(vx, vy)
    state.hold_N = law.F_c_N
    if speed > 0.0:
        left = math.exp(-law.sigma_N_m * speed * motion.dt_s / law.F_c_N)
        level_x, level_y = law.F_c_N * vx / speed, law.F_c_N * vy / speed
        state.F_N[0] = level_x + (state.F_N[0] - level_x) * left
        state.F_N[1] = level_y + (state.F_N[1] - level_y) * left
    return state.F_N[0], state.F_N[1]
