"""Records of the split: capabilities of two joints, and their state."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import FloatField, Record
from coulombus.rigs.kinematics.mechanism_records import JOINTS

__all__ = ["SplitControlRecord", "SplitStateRecord"]


class SplitControlRecord(Record):
    """Limits and model of the joints."""

    brake_limit_Nm: Annotated[FloatField, JOINTS]  # 0: no brakes (active)
    motor_limit_Nm: Annotated[FloatField, JOINTS]  # 0: no motors (passive)
    friction_Nm: Annotated[FloatField, JOINTS]  # the joints' own friction, which acts as a constant brake
    compensation: float  # share of that friction that the motors compensate
    coil_step: float  # 1 - exp(-period / coil lag), 1 without a lag
    fluid_step: float  # 1 - exp(-period / fluid lag), 1 without a lag
    reversal_s: float  # time before a joint comes to rest in which its brake is released
    lead_s: float  # time from the measured speeds to the effect of the commands
    period_s: float
    passivity_J: float  # largest excess of the motors' work over the absorbed energy


class SplitStateRecord(Record):
    """Commands, expected torques of the brakes, and energies."""

    brake_Nm: Annotated[FloatField, JOINTS]  # set-points of the brakes, >= 0
    motor_Nm: Annotated[FloatField, JOINTS]  # torques of the motors
    sent_Nm: Annotated[FloatField, JOINTS]  # set-points of the last cycle, which act now
    motor_sent_Nm: Annotated[FloatField, JOINTS]  # torques of the motors in the last cycle, which act now
    coil_Nm: Annotated[FloatField, JOINTS]  # modelled torque behind the coil's lag
    expected_Nm: Annotated[FloatField, JOINTS]  # modelled torque behind coil and fluid: the brake's torque now
    ahead_Nm: Annotated[FloatField, JOINTS]  # modelled brake torque at the time when the next commands act
    motor_J: Annotated[FloatField, JOINTS]  # net work of each motor on its joint
    taken_J: float  # energy of the joints' motion absorbed by motors, brakes and friction together
    withheld: int  # cycles in which the motors' torques were reduced to stay passive
