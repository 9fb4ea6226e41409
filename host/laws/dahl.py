"""Dahl's friction: a spring that yields towards the Coulomb level."""

from __future__ import annotations

import math

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["dahl"]


class DahlParameters(Parameters):
    """[law.dahl]."""

    F_c_Nm: float = Field(1.0, gt=0, le=1e4, description="Coulomb friction")
    sigma_Nm_rad: float = Field(100.0, gt=0, le=1e9, description="stiffness at a reversal of a friction of 0")
    alpha: float = Field(1.0, ge=0, le=10, description="shape of the loop: 0 elastic-plastic, 1 Dahl's solid")


class DahlState(LawStateRecord):
    """What it keeps."""

    F_Nm: float


@friction_law(DahlParameters, state=DahlState, extremes=("F_c_Nm",))
def dahl(motion: MotionRecord, law: DahlParameters, state: DahlState) -> float:
    r"""Dahl's friction: a spring that yields towards the Coulomb level.

    .. math::

        \frac{dF}{dx} = \sigma \left(1 - \frac{F}{F_c}\,\mathrm{sgn}(v)\right)^{\alpha}, \quad
        \psi = F

    It depends on the path alone, not on the time. Along a step :math:`s = |\Delta x|` in one sense
    it is solved exactly. With :math:`u = 1 - (F/F_c)\,\mathrm{sgn}(v)`, which lies in 0 to 2:

    .. math::

        u \leftarrow u\,e^{-\sigma s/F_c} \quad (\alpha = 1), \qquad
        u^{1-\alpha} \leftarrow u^{1-\alpha} + (\alpha - 1)\,\sigma s/F_c \quad (\alpha \ne 1)

    For :math:`\alpha < 1` the level is reached within a finite path, and u stays 0 from there on.
    The brake bears F_c.

    Source: P. R. Dahl, A solid friction model, TOR-0158(3107-18)-1, The Aerospace Corporation,
    1968, doi:10.21236/ADA041920; Solid friction damping of mechanical vibrations, AIAA J. 14(12),
    1976, doi:10.2514/3.61511.
    """
    state.brake_Nm = law.F_c_Nm
    step = motion.v_rad_s * motion.dt_s
    if step != 0.0:
        sense = 1.0 if step > 0.0 else -1.0
        u = max(1.0 - sense * state.F_Nm / law.F_c_Nm, 0.0)
        path = law.sigma_Nm_rad * abs(step) / law.F_c_Nm
        if law.alpha == 1.0:
            u *= math.exp(-path)
        elif u > 1e-30:  # less is none, and its powers would not be finite
            power = 1.0 - law.alpha
            left = u**power - power * path
            u = left ** (1.0 / power) if left > 0.0 else 0.0
        state.F_Nm = sense * law.F_c_Nm * (1.0 - u)
    psi_Nm: float = state.F_Nm
    return psi_Nm
