"""All steps, in their order."""

from __future__ import annotations

from coulombus.host.commission.brake import Brake
from coulombus.host.commission.delay import Delay
from coulombus.host.commission.display import Display
from coulombus.host.commission.encoder import Encoder
from coulombus.host.commission.friction import Friction
from coulombus.host.commission.limits import Limits
from coulombus.host.commission.motor import Motor
from coulombus.host.commission.response import Response
from coulombus.host.commission.step import Step
from coulombus.host.commission.transducer import Weight, Zero

__all__ = ["STEPS"]

STEPS: tuple[Step, ...] = (
    Zero(),
    Weight(),
    Encoder(),
    Motor(),
    Friction(),
    Brake(),
    Response(),
    Delay(),
    Limits(),
    Display(),
)
