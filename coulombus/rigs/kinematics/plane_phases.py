"""Phases of the operator's schedule in the plane: what the hand does with the tip of two coupled joints."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from coulombus.rigs.model import Section

__all__ = ["PLANE_KINDS", "PlanePhase", "TipCirclePhase", "TipEightPhase", "TipHoldPhase", "TipLinePhase"]


class _Phase(Section):
    duration_s: float = Field(gt=0, le=86400, description="length of the phase")


class TipHoldPhase(_Phase):
    """[[phase]] of kind "tip_hold": a slow push on the tip below the static friction, with taps."""

    kind: Literal["tip_hold"]
    push_F_s: float = Field(ge=-10, le=10, description="amplitude of the push, as a share of the law's F_s_N")
    frequency_Hz: float = Field(ge=0, le=1e3, description="frequency of the push (a sine)")
    direction_rad: float = Field(0.0, ge=-100, le=100, description="direction of push and taps; 0: along x")
    taps_s: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        (),
        strict=False,
        max_length=1000,
        description="when taps begin, from the phase's start",
        json_schema_extra={"expected": "a list of at most 1000 numbers from 0 on, in s"},
    )
    tap_N: float = Field(0.0, ge=-1e5, le=1e5, description="force of a tap")
    tap_s: float = Field(0.01, gt=0, le=60, description="length of a tap")


class TipLinePhase(_Phase):
    """[[phase]] of kind "tip_line": to and fro on a straight line, a sine of time."""

    kind: Literal["tip_line"]
    length_m: float = Field(gt=0, le=100, description="length of the line; it begins where the hand is")
    direction_rad: float = Field(0.0, ge=-100, le=100, description="direction of the line; 0: along x")
    frequency_Hz: float = Field(gt=0, le=1e3, description="ways to and fro in a second")


class TipCirclePhase(_Phase):
    """[[phase]] of kind "tip_circle": out to a circle about the hand's place, then round and round."""

    kind: Literal["tip_circle"]
    radius_m: float = Field(gt=0, le=100, description="radius of the circle")
    frequency_Hz: float = Field(ge=-1e3, le=1e3, description="laps in a second; negative: clockwise")
    direction_rad: float = Field(0.0, ge=-100, le=100, description="direction of the circle's first point; 0: along x")
    approach_s: float = Field(0.5, gt=0, le=3600, description="time from the centre to the first point")


class TipEightPhase(_Phase):
    """[[phase]] of kind "tip_eight": a figure of eight through the hand's place."""

    kind: Literal["tip_eight"]
    width_m: float = Field(gt=0, le=100, description="width along x")
    height_m: float = Field(gt=0, le=100, description="height along y")
    frequency_Hz: float = Field(gt=0, le=1e3, description="figures in a second")


PlanePhase: TypeAlias = TipHoldPhase | TipLinePhase | TipCirclePhase | TipEightPhase
PLANE_KINDS = ("tip_hold", "tip_line", "tip_circle", "tip_eight")
"""Kinds of phases of a rig with [kinematics]; "rest" is a kind of every rig."""
