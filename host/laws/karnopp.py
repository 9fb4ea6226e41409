"""Karnopp's friction: a stick spring and a level in slip."""

from __future__ import annotations

from typing import Literal

from coulombus.host.laws.law import Declaration, Field, LawRecord, LawStateRecord, MotionRecord, Parameters

__all__ = ["KARNOPP", "karnopp"]


class KarnoppParameters(Parameters):
    """Keys of [mode.*] and [law]."""

    K_p_Nm_rad: float = Field(100.0, gt=0, le=1e7, description="stiffness of the stick spring")
    F_s_Nm: float = Field(1.2, ge=0, le=1e4, description="static friction")
    F_d_Nm: float = Field(1.0, ge=0, le=1e4, description="dynamic friction")
    velocity_band_counts: int = Field(2, ge=0, le=2**31 - 1, description="stuck at or below this many counts a cycle")
    stick_entry: Literal["continuous", "paper"] = Field("continuous", description="where x_stuck is set on entry")
    brake_stick: Literal["hold", "spring"] = Field("hold", description="the brake's set-point while stuck")


def karnopp(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> float:
    r"""Karnopp's stick-slip friction, as corrected from the paper's eq. (20).

    .. math::

        \psi = \begin{cases} F_d\,\mathrm{sgn}(v) & |v| > \Delta v \\
               \mathrm{sgn}(F_a)\,\min(|F_a|, F_s) & |v| \le \Delta v \end{cases}
        \qquad F_a = K_p\,(x - x_{stuck})

    At stick entry and on saturation :math:`x_{stuck} = x - F/K_p`, so the torque neither jumps nor
    winds up. ``paper_entry`` takes the paper's :math:`x_{stuck} = x` at entry instead. The brake
    bears F_s whenever stuck and F_d in slip; with ``brake_spring`` it shows the spring, which on an
    encoder is a coarse switch (K_p = 10000 Nm/rad is 0.8 Nm a count).

    Source: the paper, section 5; D. Karnopp, J. Dyn. Sys. Meas. Control 107(1), 1985,
    doi:10.1115/1.3140698.
    """
    if abs(motion.v_counts) > law.velocity_band_counts:
        state.stuck = 0
        state.brake_Nm = law.F_d
        return law.F_d if motion.v_counts > 0.0 else -law.F_d
    if state.stuck == 0:
        state.stuck = 1
        if law.paper_entry:
            state.x_stuck = motion.x_rad
        else:
            state.x_stuck = motion.x_rad - state.psi_Nm / law.K_p
    force = law.K_p * (motion.x_rad - state.x_stuck)
    if abs(force) > law.F_s:
        force = law.F_s if force > 0.0 else -law.F_s
        state.x_stuck = motion.x_rad - force / law.K_p
    state.brake_Nm = abs(force) if law.brake_spring else law.F_s
    return force


KARNOPP = Declaration(
    karnopp, KarnoppParameters, extremes=("F_s_Nm", "F_d_Nm"), uses_mode_keys=True
)  # the spring ends at F_s
