"""Magnetic hysteresis of the brake: the true one ([plant.iron]) or the host's model ([brake.iron])."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from coulombus.rigs.model import Section

__all__ = ["MOST_PLAYS", "Iron"]

MOST_PLAYS = 8


class Iron(Section):
    """[plant.iron], [brake.iron]: the brake's magnetic hysteresis, a sum of play operators."""

    play_Nm: tuple[Annotated[float, Field(gt=0, le=1e4)], ...] = Field(
        strict=False,
        min_length=1,
        max_length=MOST_PLAYS,
        description="half of each operator's play, as the torque of its coil current",
        json_schema_extra={"expected": f"a list of 1 to {MOST_PLAYS} numbers above 0, in Nm"},
    )
    weights: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(
        strict=False,
        min_length=1,
        max_length=MOST_PLAYS,
        description="weight of each operator; what is left to 1 follows at once",
        json_schema_extra={"expected": "a list of as many numbers from 0 to 1 as play_Nm has, together at most 1"},
    )
