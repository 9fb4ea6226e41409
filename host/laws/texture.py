"""Texture: friction whose level changes with the angle."""

from __future__ import annotations

import math
from types import MappingProxyType

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["texture"]


class TextureParameters(Parameters):
    """[law.texture]."""

    at_least = MappingProxyType({"F_c_Nm": "A_Nm"})

    F_c_Nm: float = Field(0.6, ge=0, le=1e4, description="mean level of the friction")
    A_Nm: float = Field(0.3, ge=0, le=1e4, description="by how much it changes")
    period_rad: float = Field(0.1, gt=0, le=1e6, description="angle from one ridge to the next")
    v_t_rad_s: float = Field(0.2, gt=0, le=1e4, description="speed at which the friction has its level")


@friction_law(TextureParameters)
def texture(motion: MotionRecord, law: TextureParameters, state: LawStateRecord) -> float:
    r"""Texture: friction whose level changes with the angle.

    .. math:: \psi = \left(F_c + A \cos\frac{2\pi x}{P}\right)\mathrm{sat}(v/v_t), \quad A \le F_c

    It never drives the handle: with :math:`A \le F_c` the level is never negative, so a brake can
    show it. The brake bears the level.

    Source: M. Minsky, M. Ouh-young, O. Steele, F. P. Brooks, M. Behensky, Feeling and seeing: issues
    in force display, Symp. Interactive 3D Graphics, 1990, doi:10.1145/91385.91451.
    """
    level = law.F_c_Nm + law.A_Nm * math.cos(2.0 * math.pi * motion.x_rad / law.period_rad)
    state.brake_Nm = max(level, 0.0)
    return float(level * min(max(motion.v_rad_s / law.v_t_rad_s, -1.0), 1.0))
