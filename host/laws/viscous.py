"""A viscous damper, with or without an end."""

from __future__ import annotations

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["viscous"]


class ViscousParameters(Parameters):
    """[law.viscous]."""

    B_Nms_rad: float = Field(0.05, ge=0, le=1e6, description="viscous friction")
    most_Nm: float = Field(1.0, ge=0, le=1e4, description="the torque at which it ends")


@friction_law(ViscousParameters, extremes=("most_Nm",))
def viscous(motion: MotionRecord, law: ViscousParameters, state: LawStateRecord) -> float:
    r"""A viscous damper that ends at a torque.

    .. math:: \psi = \mathrm{sat}(B v / \tau_{max})\,\tau_{max}

    The brake bears :math:`|\psi|`. What B a sampled display bears is bounded: J. E. Colgate, G. G.
    Schenkel, Passivity of a class of sampled-data systems, J. Robotic Systems 14(1), 1997,
    doi:10.1002/(SICI)1097-4563(199701)14:1<37::AID-ROB4>3.0.CO;2-V.
    """
    psi_Nm: float = min(max(law.B_Nms_rad * motion.v_rad_s, -law.most_Nm), law.most_Nm)
    state.brake_Nm = abs(psi_Nm)
    return psi_Nm
