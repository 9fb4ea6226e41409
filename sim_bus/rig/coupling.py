"""How the devices of an axis and its plant feel each other, compiled, where they are not our own
two.

Our own motor drive and brake driver take and give physical quantities, and this costs them nothing.
Another maker's device has counts:

    shown  = clip(floor((quantity - offset) * gain + 1/2), low, high), or the low bits of it where the object counts on (a position)
    brake  = table(raw) or scale * raw, never below 0,   raw: an analogue output, a drive's set-point, or the value of an object

In the kernels: `axis` a record of `sim_bus.network.kernel.AXIS`, `p` its plant.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Record, Records
from coulombus.rigs.devices import TABLE_POINTS
from coulombus.sim_bus.rig.plant import encoder_rad

__all__ = ["COUPLING", "MOST_SHOWN", "SHOWN", "BrakeOutput", "Quantity", "brake_torque", "show"]


class Quantity(IntEnum):
    """What an object shows of the plant."""

    POSITION = 0  # rad at the handle
    VELOCITY = 1  # rad/s
    TORQUE = 2  # Nm of the motor, at the handle
    HANDLE = 3  # Nm, as the transducer reads them
    CURRENT = 4  # A in the coil
    TEMPERATURE = 5  # degC of the coil


class BrakeOutput(IntEnum):
    """What the brake's torque is made of."""

    TORQUE = 0  # out_brake_Nm of our own driver
    ANALOGUE = 1  # an analogue output of a CiA 401 or 404 module
    DRIVE = 2  # the torque of a CiA 402 drive, in counts of its set-point
    DRIVER = 3  # the output of our own driver, in counts of 7300h: the rig file gives a scale of its own
    OBJECT = 4  # an object's value


MOST_SHOWN = 6

SHOWN = np.dtype(
    [
        ("row", np.int64),  # the device, and where the object stands in its values
        ("slot", np.int64),
        ("quantity", np.int64),
        ("gain", np.float64),  # counts for one unit
        ("offset", np.float64),  # the quantity at the count 0
        ("low", np.int64),
        ("high", np.int64),
    ],
    align=True,
)

COUPLING = [
    ("foreign", np.int64),  # 0: our own two devices, and nothing below is used
    ("shown_count", np.int64),
    ("shown", SHOWN, (MOST_SHOWN,)),
    ("brake_output", np.int64),
    ("brake_channel", np.int64),  # of the module, or the object's slot
    ("brake_counts", np.float64),  # counts of the set-point for one per mille of a drive, or one Nm of our driver
    ("brake_scale_Nm", np.float64),  # for one count, where there is no table
    ("brake_points", np.int64),  # of the table; 0: none
    ("brake_table_raw", np.float64, (TABLE_POINTS,)),  # ascending
    ("brake_table_Nm", np.float64, (TABLE_POINTS,)),
]
"""Fields of `sim_bus.network.kernel.AXIS`."""


@kernel
def _interpolated(axis: Record, raw: float) -> float:
    """Return the table's torque, its ends beyond them."""
    points, raws, torques = axis.brake_points, axis.brake_table_raw, axis.brake_table_Nm
    if raw <= raws[0]:
        return float(torques[0])
    for k in range(1, points):
        if raw <= raws[k]:
            share = (raw - raws[k - 1]) / (raws[k] - raws[k - 1])
            return float(torques[k - 1] + share * (torques[k] - torques[k - 1]))
    return float(torques[points - 1])


@kernel
def brake_torque(axis: Record, brake: Record) -> float:
    """Return the torque [Nm] that the brake's device commands; `brake` is its record."""
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
    """Return the low bits of a count, as a counter of that width has them."""
    span = high - low + 1
    count = math.floor(value + 0.5)
    return int((count - low) % span + low)


@kernel
def show(axis: Record, p: Record, nodes: Records, handle_Nm: float, coil_A: float) -> None:
    """Let the objects show the plant, and a drive that feeds the coil the current that flows."""
    for k in range(axis.shown_count):
        one = axis.shown[k]
        if one.quantity == Quantity.POSITION:
            nodes[one.row].values[one.slot] = _wrapped((encoder_rad(p) - one.offset) * one.gain, one.low, one.high)
            continue
        value = p.v
        if one.quantity == Quantity.TORQUE:
            value = p.motor
        elif one.quantity == Quantity.HANDLE:
            value = handle_Nm
        elif one.quantity == Quantity.CURRENT:
            value = coil_A
        elif one.quantity == Quantity.TEMPERATURE:
            value = p.temperature
        count = min(max((value - one.offset) * one.gain, float(one.low)), float(one.high))
        nodes[one.row].values[one.slot] = math.floor(count + 0.5)
    if axis.brake_output == BrakeOutput.DRIVE:
        nodes[axis.brake].in_torque_pm = nodes[axis.brake].out_torque_pm
