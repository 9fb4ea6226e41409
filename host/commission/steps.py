"""All steps, in their order."""

from __future__ import annotations

from coulombus.host.commission.friction import Friction
from coulombus.host.commission.step import Step

__all__ = ["STEPS"]

STEPS: tuple[Step, ...] = (Friction(),)
