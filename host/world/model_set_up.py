"""The local model of an axis before the run, from the rig file and the limits of the cycle."""

from __future__ import annotations

import math
from typing import Any

from coulombus.host.world.local_model import ACTIVE, HYBRID, PASSIVE
from coulombus.host.world.softening import DRIVE_LAG_S
from coulombus.rigs.axis import Axis

__all__ = ["set_up_model"]

SWING_COUNTS = 3
"""Smaller swings are those of the encoder."""
MODES = {"passive": PASSIVE, "hybrid": HYBRID, "active": ACTIVE}


def set_up_model(record: Any, axis: Axis, mode: str, control: Any) -> None:
    """Set the fixed values of a `LocalModelRecord`; without [world] in the rig file, none.

    Parameters
    ----------
    control : the axis' CONTROL record, which has the limits
    """
    if axis.world is None:
        return
    period_s = axis.bus.period_s
    record["on"] = 1
    record["K_p_ratio"] = 1.0
    record["rest"] = record["law_share"] = float(axis.world.rest == "law")
    record["ramp_step"] = period_s / axis.world.ramp_s
    record["period_ns"] = control["period_ns"]
    record["mode"] = MODES[mode]
    record["motor_limit_Nm"] = float(control["motor_limit_raw"]) * abs(float(control["motor_Nm_raw"]))
    record["motor_rate_Nm"] = control["motor_rate_Nm"]
    record["brake_limit_Nm"] = control["brake_limit_Nm"]
    record["brake_fall_Nm"] = control["brake_fall_Nm"]
    record["acts_at_once"] = axis.bus.actuation != "next_sync"
    # a command waits for its SYNC, and is held for a cycle; the velocity is that of the last two differences
    record["ahead_s"] = (axis.bus.cycles_to_actuation + 1.5) * period_s + DRIVE_LAG_S
    record["drive_step"] = 1.0 - math.exp(-period_s / DRIVE_LAG_S)
    record["swing_band_rad"] = SWING_COUNTS * abs(float(control["rad_count"]))
