"""[world]: another program may say what the hand meets (docs/worlds.md)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from coulombus.rigs.model import Section

__all__ = ["WorldSection"]


class WorldSection(Section):
    """[world]: what the display shows while no program sends a model."""

    rest: Literal["law", "free"] = Field(
        "law", description="what is displayed without a model: the rig's friction law, or nothing"
    )
    ramp_s: float = Field(0.2, ge=0.001, le=10, description="a model that is over fades within this time")
    longest_life_s: float = Field(1.0, ge=0.002, le=60, description="largest time to live of a model")
