"""Records of a host of two joints: the split's limits and state, and the whole host."""

from __future__ import annotations

from typing import Annotated

from coulombus.host.laws.plane.plane_law import PlaneLawRecord, PlaneMotionRecord, PlaneStateRecord
from coulombus.kernels.records import FloatField, IntegerField, Record
from coulombus.rigs.kinematics.mechanisms import JOINTS, MechanismRecord, PoseRecord

__all__ = ["ACTIVE", "HYBRID", "PASSIVE", "TRACK", "PlaneHostRecord", "SplitControlRecord", "SplitStateRecord"]

ACTIVE, PASSIVE, HYBRID = 0, 1, 2
TRACK = 128
"""Size of the ring of positions for the speeds."""


class SplitControlRecord(Record):
    """Limits and model of the joints."""

    brake_limit_Nm: Annotated[FloatField, JOINTS]  # 0: no brakes (active)
    motor_limit_Nm: Annotated[FloatField, JOINTS]  # 0: no motors (passive)
    friction_Nm: Annotated[FloatField, JOINTS]  # the joints' own friction, which acts as a constant brake
    compensation_Nm: Annotated[FloatField, JOINTS]  # the part of that friction that the motors compensate
    coil_step: Annotated[FloatField, JOINTS]  # 1 - exp(-period / coil lag), 1 without a lag
    fluid_step: Annotated[FloatField, JOINTS]  # 1 - exp(-period / fluid lag), 1 without a lag
    reversal_s: Annotated[FloatField, JOINTS]  # time before a joint comes to rest in which its brake is released
    lead_s: float  # time from the measured speeds to the effect of the commands
    period_s: float
    inertia_kg_m2: Annotated[FloatField, 3]  # the part of the joints' inertia (11, 12, 22) that the motors compensate
    tip_mass_kg: float  # the part of the arm's mass at the tip that the motors compensate
    passivity_J: float  # largest excess of the motors' work over the absorbed energy


class SplitStateRecord(Record):
    """Commands, expected torques of the brakes, and energies."""

    brake_Nm: Annotated[FloatField, JOINTS]  # set-points of the brakes, >= 0
    motor_Nm: Annotated[FloatField, JOINTS]  # torques of the motors
    sent_Nm: Annotated[FloatField, JOINTS]  # set-points of the last cycle, which act now
    motor_sent_Nm: Annotated[FloatField, JOINTS]  # torques of the motors in the last cycle, which act now
    coil_Nm: Annotated[FloatField, JOINTS]  # modelled torque behind the coil's lag
    expected_Nm: Annotated[FloatField, JOINTS]  # modelled torque behind coil and fluid: the brake's torque now
    ahead_Nm: Annotated[FloatField, JOINTS]  # modelled brake torque at the end of the cycle in which the commands act
    motor_J: Annotated[FloatField, JOINTS]  # net work of each motor on its joint
    taken_J: float  # energy of the joints' motion absorbed by motors, brakes and friction together
    inertia_Nm: Annotated[FloatField, JOINTS]  # torques that move the arm in place of the hand
    push_Nm: Annotated[FloatField, JOINTS]  # the part of the motors' torques that pushes back (a wall's spring)
    clipped: Annotated[IntegerField, JOINTS]  # 1: a limit of motor or brake changes the law's output
    withheld: int  # cycles in which the motors' torques were reduced to stay passive


class PlaneHostRecord(Record):
    """State of a host of two joints: model, measurements and commands."""

    mechanism: MechanismRecord
    control: SplitControlRecord
    law: PlaneLawRecord
    mode: int
    window_cycles: int  # window of the joints' speeds, at most TRACK // 2 - 1
    turn_cycles: int  # time of the speeds' change; together with the speeds' window below TRACK
    count_rad: Annotated[FloatField, JOINTS]  # angle of an encoder count at the joint
    start_rad: Annotated[FloatField, JOINTS]  # the joints' angles at count 0
    least_condition: float  # smallest condition of a pose with force; below it, the pose is too near to singular
    low_m: Annotated[FloatField, 2]  # workspace of the tip
    high_m: Annotated[FloatField, 2]

    counts: Annotated[IntegerField, JOINTS]  # encoders
    hand_Nm: Annotated[FloatField, JOINTS]  # transducers: the hand's torques on the joints
    track: Annotated[IntegerField, (TRACK, JOINTS)]  # counts of the last cycles
    track_m: Annotated[FloatField, (TRACK, 2)]  # the tip's positions in the last cycles
    bend_cycles: int  # time between the positions of which an acceleration is computed; 0: no inertia is compensated
    cycle: int
    v_rad_s: Annotated[FloatField, JOINTS]
    rate_rad_s2: Annotated[FloatField, JOINTS]  # change of the speeds over `turn_cycles`
    pose: PoseRecord
    motion: PlaneMotionRecord
    state: PlaneStateRecord
    split: SplitStateRecord
    condition: float  # of the Jacobian: its smallest singular value over its largest
    display_cycles: int  # cycles in which the law was evaluated
    smallest_condition: float  # smallest condition since the law began
    gain: float  # gain of the law, 0 to 1
    psi_N: Annotated[FloatField, 2]  # the law's force, times the gain
    push_N: Annotated[FloatField, 2]  # the part of it that pushes back, times the gain
    hold_N: float  # force that the brakes hold at rest, times the gain; 0: none, or the tip does not stick
    outside: int  # cycles in a pose without force
