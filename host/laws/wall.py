"""A virtual wall: the motor's stiffness and the brake's damping."""

from __future__ import annotations

from coulombus.host.laws.law import Field, LawStateRecord, MotionRecord, Parameters, friction_law

__all__ = ["wall"]


class WallParameters(Parameters):
    """[law.wall]."""

    x_wall_rad: float = Field(0.0, ge=-1e6, le=1e6, description="angle at which the wall begins, from the start")
    K_Nm_rad: float = Field(20.0, ge=0, le=1e7, description="stiffness, the motor's part")
    B_Nms_rad: float = Field(0.02, ge=0, le=1e6, description="damping within, the brake's part")
    most_Nm: float = Field(1.2, ge=0, le=1e4, description="the torque at which it ends")


@friction_law(WallParameters, extremes=("most_Nm",), pushes=True)
def wall(motion: MotionRecord, law: WallParameters, state: LawStateRecord) -> float:
    r"""A virtual wall: stiffness by the motor, damping by the brake, the paper's Fig. 8.

    Within, for :math:`p = x - x_{wall} > 0`:

    .. math:: \psi = \mathrm{sat}\left(\max(K p + B v, 0)/\tau_{max}\right)\tau_{max}, \quad
        \tau_{brake} = \min(B |v|, \tau_{max}), \quad \tau_{motor} = \min(K p, \tau_{max})

    Outside all are 0. The wall never pulls: on the way out the brake has at most
    :math:`\tau_{motor}`, so that it does not hold the hand in the wall. Mode active shows :math:`\psi`, damping included. In
    hybrid the motor has the stiffness, which must push back when the hand lets go, and the brake the
    damping, which only takes. In passive the brake has the damping alone.

    Source: the paper, Fig. 8; of what stiffness a sampled wall bears, J. J. Abbott, A. M. Okamura,
    Effects of position quantization and sampling rate on virtual-wall passivity, IEEE Trans.
    Robotics 21(5), 2005, doi:10.1109/TRO.2005.851377.
    """
    p = motion.x_rad - law.x_wall_rad
    if p <= 0.0:
        state.brake_Nm = state.motor_Nm = 0.0
        return 0.0
    damping = law.B_Nms_rad * motion.v_rad_s
    state.motor_Nm = min(law.K_Nm_rad * p, law.most_Nm)
    state.brake_Nm = min(abs(damping), law.most_Nm if damping >= 0.0 else state.motor_Nm)
    return float(min(max(law.K_Nm_rad * p + damping, 0.0), law.most_Nm))
