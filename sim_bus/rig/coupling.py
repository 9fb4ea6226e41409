"""Compiled coupling between an axis's plant and devices other than our own two.

Our own motor drive and brake driver exchange physical quantities, without this module. Another
vendor's device has counts:

    shown  = clip(floor((quantity - offset) * gain + 1/2), low, high), or its low bits if the object wraps (a position)
    brake  = table(raw) or scale * raw, never below 0,   raw: an analogue output, a drive's set-point, or the value of an object

In the kernels: `axis` a record of `sim_bus.rig.records.RigAxis`, `p` its plant.
"""

from __future__ import annotations

import math
from enum import IntEnum

from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import RecordArray
from coulombus.node.record import NodeRecord
from coulombus.sim_bus.rig.plant import encoder_rad
from coulombus.sim_bus.rig.records import PlantRecord, RigAxis

__all__ = ["BrakeOutput", "Quantity", "brake_torque", "show"]


class Quantity(IntEnum):
    """Quantity of the plant that an object shows."""

    POSITION = 0  # rad at the handle
    VELOCITY = 1  # rad/s
    TORQUE = 2  # Nm of the motor, at the handle
    HANDLE = 3  # Nm, measured by the transducer
    CURRENT = 4  # A in the coil
    TEMPERATURE = 5  # degC of the coil


class BrakeOutput(IntEnum):
    """Source of the brake's torque."""

    TORQUE = 0  # out_brake_Nm of our own driver
    ANALOGUE = 1  # an analogue output of a CiA 401 or 404 module
    DRIVE = 2  # the torque of a CiA 402 drive, in counts of its set-point
    DRIVER = 3  # output of our own driver, in counts of 7300h: the rig file gives its own scale
    OBJECT = 4  # value of an object


@kernel
def _interpolated(axis: RigAxis, raw: float) -> float:
    """Return the torque from the table, constant beyond its ends."""
    points, raws, torques = axis.brake_points, axis.brake_table_raw, axis.brake_table_Nm
    if raw <= raws[0]:
        return float(torques[0])
    for k in range(1, points):
        if raw <= raws[k]:
            share = (raw - raws[k - 1]) / (raws[k] - raws[k - 1])
            return float(torques[k - 1] + share * (torques[k] - torques[k - 1]))
    return float(torques[points - 1])


@kernel
def brake_torque(axis: RigAxis, brake: NodeRecord) -> float:
    """Return the torque [Nm] commanded by the brake's device; `brake` is its record."""
    if axis.brake_output == BrakeOutput.TORQUE:
        return float(brake.out_brake_Nm)
    if axis.brake_output == BrakeOutput.ANALOGUE:
        raw = float(brake.out_analogue[axis.brake_channel])
    elif axis.brake_output == BrakeOutput.DRIVE:
        raw = brake.out_torque_pm * axis.brake_counts
    elif axis.brake_output == BrakeOutput.DRIVER:
        raw = brake.out_brake_Nm * axis.brake_counts
    else:
        raw = float(brake.values[axis.brake_channel]) if brake.powered != 0 else 0.0
    torque = _interpolated(axis, raw) if axis.brake_points > 0 else raw * axis.brake_scale_Nm
    return max(torque, 0.0)


@kernel
def _wrapped(value: float, low: int, high: int) -> int:
    """Return the low bits of a count, like a counter of that width."""
    span = high - low + 1
    count = math.floor(value + 0.5)
    return int((count - low) % span + low)


@kernel
def show(axis: RigAxis, p: PlantRecord, nodes: RecordArray[NodeRecord], handle_Nm: float, coil_A: float) -> None:
    """Write the plant's quantities to the objects, and the actual current to a drive that feeds the coil."""
    for k in range(axis.shown_count):
        channel = axis.shown[k]
        if channel.quantity == Quantity.POSITION:
            nodes[channel.row].values[channel.slot] = _wrapped(
                (encoder_rad(p) - channel.offset) * channel.gain, channel.low, channel.high
            )
            continue
        value = p.v
        if channel.quantity == Quantity.TORQUE:
            value = p.motor
        elif channel.quantity == Quantity.HANDLE:
            value = handle_Nm
        elif channel.quantity == Quantity.CURRENT:
            value = coil_A
        elif channel.quantity == Quantity.TEMPERATURE:
            value = p.temperature
        count = min(max((value - channel.offset) * channel.gain, float(channel.low)), float(channel.high))
        nodes[channel.row].values[channel.slot] = math.floor(count + 0.5)
    if axis.brake_output == BrakeOutput.DRIVE:
        nodes[axis.brake].in_torque_pm = nodes[axis.brake].out_torque_pm
