"""The records of the split: what two joints can give, and what they were last told to."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import FloatField, Record
from coulombus.rigs.kinematics.mechanism_records import JOINTS

__all__ = ["SplitControlRecord", "SplitStateRecord"]


class SplitControlRecord(Record):
    """What the joints can give, as the host believes it."""

    brake_limit_Nm: Annotated[FloatField, JOINTS]  # 0: no brakes (active)
    motor_limit_Nm: Annotated[FloatField, JOINTS]  # 0: no motors (passive)
    friction_Nm: Annotated[FloatField, JOINTS]  # the joints' own friction, which is there as a brake is
    compensation: float  # share of it that the motors may take off the joints
    coil_step: float  # 1 - exp(-period / coil lag), 1 without a lag
    fluid_step: float  # 1 - exp(-period / fluid lag), 1 without a lag
    reversal_s: float  # a joint that comes to rest within this time lets its brake go before
    lead_s: float  # from the instant that the measured speeds are of to that when the commands act
    period_s: float
    passivity_J: float  # energy that the motors may have given more than the whole has taken up


class SplitStateRecord(Record):
    """What is commanded, what the brakes are expected to give, and the energies."""

    brake_Nm: Annotated[FloatField, JOINTS]  # set-points of the brakes, >= 0
    motor_Nm: Annotated[FloatField, JOINTS]  # torques of the motors
    sent_Nm: Annotated[FloatField, JOINTS]  # set-points of the cycle before, which act now
    motor_sent_Nm: Annotated[FloatField, JOINTS]  # and the motors' torques
    coil_Nm: Annotated[FloatField, JOINTS]  # behind the coil's lag
    expected_Nm: Annotated[FloatField, JOINTS]  # behind the fluid's lag, too: what the brake can bear now
    ahead_Nm: Annotated[FloatField, JOINTS]  # what it can bear when the next commands act
    motor_J: Annotated[FloatField, JOINTS]  # net work of each motor on its joint
    taken_J: float  # what motors, brakes and friction together have taken up of the joints' motion
    withheld: int  # cycles in which the motors gave less than their part, for the whole to stay passive
