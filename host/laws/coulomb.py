"""Coulomb's friction, the paper's eq. (4)."""

from __future__ import annotations

from coulombus.host.laws.law import Declaration, Field, LawRecord, LawStateRecord, MotionRecord, Parameters

__all__ = ["COULOMB", "coulomb"]


class CoulombParameters(Parameters):
    """Keys of [mode.*] and [law]."""

    F_d_Nm: float = Field(1.0, ge=0, le=1e4, description="c, the level of the friction")
    velocity_band_counts: int = Field(0, ge=0, le=2**31 - 1, description="no friction at or below this many counts")


def coulomb(motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> float:
    r"""Coulomb friction, eq. (4): :math:`\psi(v) = c\,\mathrm{sgn}(v)` with :math:`c = F_d` and
    :math:`\mathrm{sgn}(0) = 0`.

    Within the velocity band (0 counts for the paper's own simulation) psi is 0; the brake bears c
    at any speed. Describing function: :math:`\Psi(a) = 4c/(\pi a)`, eq. (5).
    """
    state.brake_Nm = law.F_d
    if abs(motion.v_counts) <= law.velocity_band_counts:
        state.stuck = 1
        return 0.0
    state.stuck = 0
    return law.F_d if motion.v_counts > 0.0 else -law.F_d


COULOMB = Declaration(coulomb, CoulombParameters, extremes=("F_d_Nm",), uses_mode_keys=True)
