"""All steps, in their order."""

from __future__ import annotations

from coulombus.host.commission.brake import BrakeStep
from coulombus.host.commission.delay import DelayStep
from coulombus.host.commission.display import DisplayStep
from coulombus.host.commission.encoder import EncoderStep
from coulombus.host.commission.friction import FrictionStep
from coulombus.host.commission.limits import LimitsStep
from coulombus.host.commission.motor import MotorStep
from coulombus.host.commission.response import ResponseStep
from coulombus.host.commission.step import Step
from coulombus.host.commission.transducer import WeightStep, ZeroStep

__all__ = ["STEPS"]

STEPS: tuple[Step, ...] = (
    ZeroStep(),
    WeightStep(),
    EncoderStep(),
    MotorStep(),
    FrictionStep(),
    BrakeStep(),
    ResponseStep(),
    DelayStep(),
    LimitsStep(),
    DisplayStep(),
)
