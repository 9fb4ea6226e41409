"""Kikuuwe's friction: Coulomb's, by implicit Euler, behind a spring and a damper."""

from __future__ import annotations

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["kikuuwe"]


class KikuuweParameters(Parameters):
    """[law.kikuuwe]."""

    F_c_Nm: float = Field(1.0, ge=0, le=1e4, description="Coulomb friction")
    K_Nm_rad: float = Field(100.0, gt=0, le=1e9, description="stiffness before it slips")
    B_Nms_rad: float = Field(0.05, ge=0, le=1e6, description="damping beside that spring")


class KikuuweState(LawStateRecord):
    """What it keeps."""

    e_rad: float


@friction_law(KikuuweParameters, state=KikuuweState, extremes=("F_c_Nm",))
def kikuuwe(motion: MotionRecord, law: KikuuweParameters, state: KikuuweState) -> float:
    r"""Kikuuwe's friction: Coulomb's, by implicit Euler, behind a spring and a damper.

    .. math::

        \psi = K e + B \dot e \in F_c\,\mathrm{Sgn}(v - \dot e) \quad\Rightarrow\quad
        \psi_k = \mathrm{sat}\left(\frac{K e_{k-1} + (K T + B) v_k}{F_c}\right) F_c, \quad
        e_k = e_{k-1} + T\,\frac{\psi_k - K e_{k-1}}{K T + B}

    e is how far the spring is wound. There is no velocity band and no chatter at any period: the
    torque is bounded by F_c, and at rest it holds. For B = 0 it is exact along any path; with B it
    is of the first order in the time between two samples. The brake bears F_c.

    Source: R. Kikuuwe, N. Takesue, A. Sano, H. Mochiyama, H. Fujimoto, Admittance and impedance
    representations of friction based on implicit Euler integration, IEEE Trans. Robotics 22(6),
    2006, doi:10.1109/TRO.2006.886262.
    """
    state.brake_Nm = law.F_c_Nm
    T = motion.dt_s
    wound = law.K_Nm_rad * state.e_rad
    stiff = law.K_Nm_rad * T + law.B_Nms_rad
    psi_Nm: float = min(max(wound + stiff * motion.v_rad_s, -law.F_c_Nm), law.F_c_Nm)
    state.e_rad += T * (psi_Nm - wound) / stiff
    return psi_Nm
