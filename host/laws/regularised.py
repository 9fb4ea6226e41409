"""Regularised Coulomb friction: a slope in the place of the jump."""

from __future__ import annotations

import math
from typing import Literal

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["regularised"]


class RegularisedParameters(Parameters):
    """[law.regularised]."""

    F_c_Nm: float = Field(1.0, ge=0, le=1e4, description="Coulomb friction")
    v_t_rad_s: float = Field(0.2, gt=0, le=1e4, description="speed of the slope's end")
    form: Literal["saturated", "tanh", "arctan"] = Field("saturated", description="how the slope ends")


@friction_law(RegularisedParameters, extremes=("F_c_Nm",))
def regularised(motion: MotionRecord, law: RegularisedParameters, state: LawStateRecord) -> float:
    r"""Regularised Coulomb friction: a slope in the place of the jump, a saturated damper.

    .. math::

        \psi = F_c\,\mathrm{sat}(v/v_t), \quad F_c \tanh(v/v_t), \quad
        \frac{2 F_c}{\pi} \arctan\frac{\pi v}{2 v_t}

    each with the slope :math:`F_c/v_t` at rest. It has no stiction: a load creeps. On a motor the
    slope is a damper, which a sampled loop bears up to a bound of its own: :math:`F_c/v_t <
    2m/T` for a mass m alone without delay. The brake bears :math:`|\psi|`.

    Source of the bound for haptic displays: N. Diolaiti, G. Niemeyer, F. Barbagli, J. K. Salisbury,
    Stability of haptic rendering, IEEE Trans. Robotics 22(2), 2006, doi:10.1109/TRO.2005.862487.
    """
    ratio = motion.v_rad_s / law.v_t_rad_s
    if law.form == 0.0:  # type: ignore[comparison-overlap]  # a choice is its place
        share = min(max(ratio, -1.0), 1.0)
    elif law.form == 1.0:  # type: ignore[comparison-overlap]  # a choice is its place
        share = math.tanh(ratio)
    else:
        share = math.atan(0.5 * math.pi * ratio) * 2.0 / math.pi
    state.brake_Nm = law.F_c_Nm * abs(share)
    return float(law.F_c_Nm * share)
