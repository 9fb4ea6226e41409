"""Bliman and Sorine's friction of the second order: Dahl's, with a peak at break-away."""

from __future__ import annotations

import math
from types import MappingProxyType

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["bliman_sorine"]


class BlimanSorineParameters(Parameters):
    """[law.bliman_sorine]."""

    above = MappingProxyType({"f_1_Nm": "f_2_Nm"})

    f_1_Nm: float = Field(1.5, gt=0, le=1e4, description="level of the fast part")
    f_2_Nm: float = Field(0.5, ge=0, le=1e4, description="level of the slow part, which is taken off")
    epsilon_f_rad: float = Field(0.02, gt=0, le=1e6, description="path of the slow part")
    eta: float = Field(0.25, gt=0, le=0.99, description="path of the fast part, as a share of that")


class BlimanSorineState(LawStateRecord):
    """What it keeps."""

    x_1_Nm: float
    x_2_Nm: float


@friction_law(BlimanSorineParameters, state=BlimanSorineState)
def bliman_sorine(motion: MotionRecord, law: BlimanSorineParameters, state: BlimanSorineState) -> float:
    r"""Bliman and Sorine's friction of the second order: Dahl's, with a peak at break-away.

    With the path :math:`s = \int |v|\,dt`:

    .. math::

        \eta \varepsilon_f \frac{dx_1}{ds} = -x_1 + f_1\,\mathrm{sgn}(v), \quad
        \varepsilon_f \frac{dx_2}{ds} = -x_2 - f_2\,\mathrm{sgn}(v), \quad \psi = x_1 + x_2

    It depends on the path alone, and is solved exactly. In slip the level is f_1 - f_2; on the way
    there it passes a peak, which the speed does not change: below f_1 from rest, below f_1 + f_2 after
    a reversal. The brake bears f_1 - f_2.

    Source: P.-A. Bliman, M. Sorine, Easy-to-use realistic dry friction models for automatic
    control, European Control Conference, 1995; described in H. Olsson, K. J. Astrom, C. Canudas de
    Wit, M. Gafvert, P. Lischinsky, Friction models and friction compensation, European J. Control
    4(3), 1998, doi:10.1016/S0947-3580(98)70113-X.
    """
    state.brake_Nm = law.f_1_Nm - law.f_2_Nm
    step = motion.v_rad_s * motion.dt_s
    if step != 0.0:
        sense = 1.0 if step > 0.0 else -1.0
        path = abs(step) / law.epsilon_f_rad
        end_1, end_2 = sense * law.f_1_Nm, -sense * law.f_2_Nm
        state.x_1_Nm = end_1 + (state.x_1_Nm - end_1) * math.exp(-path / law.eta)
        state.x_2_Nm = end_2 + (state.x_2_Nm - end_2) * math.exp(-path)
    return float(state.x_1_Nm + state.x_2_Nm)
