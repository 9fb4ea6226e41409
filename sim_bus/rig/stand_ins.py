"""Simulated devices of an axis: the kind of each device, and the objects for the plant's quantities.

The rig file's roles decide. The kind of device handles its own objects (6064h of a drive, 7130h of
our brake driver); the rig handles every other object with a role, and writes the plant's quantity
to it in the role's scale. If a scale of the rig file differs from `[plant]`, the object shows the
true value, with the plant's rated torque, ratio and encoder in place of their assumed values.

Another vendor's drive scales its position and velocity by its own objects (`eds.drive_scale`),
whatever the rig file says: so a wrong rig file fails here as it does on the real rig. Only a plant
with a deliberately different encoder overrides them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from coulombus.eds.drive_axis import first_axis_object, of_axis
from coulombus.eds.drive_scale import (
    POLARITY,
    Polarity,
    defaults,
    polarity,
    position_scale,
    resolution,
    velocity_unit,
)
from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.kernels.records import Record
from coulombus.node.brake404 import BRAKE404
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402, with_own_mode
from coulombus.node.io401 import ANALOGUE_OUT
from coulombus.node.kinds import of_description, on_axis
from coulombus.node.motion402 import MODES, POSITION_MODES
from coulombus.node.profile import CoreObject, Key, Profile
from coulombus.node.record import OUTPUTS
from coulombus.node.relaxed_eds import Opened, opened
from coulombus.node.slots import FIRST_FREE
from coulombus.rigs.axis import Axis
from coulombus.rigs.devices import DeviceSection, drive_axis_of
from coulombus.rigs.pdo_maps import mode_of
from coulombus.rigs.plant import Plant
from coulombus.rigs.roles import PER_MILLE, Binding
from coulombus.rigs.signals import Node
from coulombus.sim_bus.rig.coupling import BrakeOutput, Quantity
from coulombus.sim_bus.rig.records import PlantRecord

__all__ = ["StandIn", "couple", "stand_ins"]

_QUANTITIES: Mapping[str, Quantity] = {
    "position": Quantity.POSITION,
    "velocity": Quantity.VELOCITY,
    "torque": Quantity.TORQUE,
    "handle_torque": Quantity.HANDLE,
    "coil_current": Quantity.CURRENT,
    "coil_temperature": Quantity.TEMPERATURE,
}
"""Roles of measured quantities."""

_OWN_INPUTS: Mapping[str, Key] = {
    "handle_torque": (0x7130, 1),
    "coil_current": (0x7130, 2),
    "coil_temperature": (0x7130, 3),
}
_DRIVES_TORQUE = ((0x6077, 0), (0x6078, 0))
_SETPOINT, _POSITION, _INCREMENTS, _VELOCITY = (0x6071, 0), (0x6064, 0), (0x6063, 0), (0x606C, 0)
_BY_RATED, _BY_ENCODER, _BY_ROLE = "motor.rated_torque_Nm", "motor.encoder_counts_rev", "role."
"""Prefixes of the reasons for a scale (`rigs.roles`): the drive's own, and the rig file's."""


@dataclass(frozen=True)
class StandIn:
    """A device of an axis: its name, its file as served, and its kind."""

    node: Node
    node_id: int
    served: Opened
    profile: Profile


def stand_ins(axis: Axis) -> tuple[StandIn, ...]:
    """Return the devices of an axis, motor and brake first."""
    return tuple(_stand_in(axis, node) for node in axis.devices)


def _stand_in(axis: Axis, node: Node) -> StandIn:
    description = axis.description(node)
    base, number = DRIVE402 if node == "motor" else of_description(description), drive_axis_of(axis.part(node))
    profile = base if base is not DRIVE402 else on_axis(base, number)
    for binding in axis.allocation.bound.bindings:
        if binding.node == node and binding.kind.name in ("torque_setpoint", "brake_setpoint") and base is DRIVE402:
            profile = _drive(axis, binding)
    keys = [_key(binding) for binding in _shown(axis, {node: base})]
    first = max(FIRST_FREE, *(row.slot + 1 for row in profile.objects))
    rows = (CoreObject(*key, first + k, changing=True, named=True) for k, key in enumerate(keys))
    counts_rev = axis.simulation.plant.encoder_counts_rev if node == "motor" else 0
    served = opened(description, base, counts_rev, number)
    return StandIn(node, axis.part(node).node_id, served, profile.fitted(*rows))


class _OwnScale(NamedTuple):
    """Scale of a drive by its own objects.

    Attributes
    ----------
    counts_rev : of 6064h in one turn of the motor; None: by the plant's encoder
    increments : of 6063h in one turn of the motor; None: by the plant's encoder
    rad_s : of the motor, for one count of 606Ch; None: by the rig file
    sense : sign of its objects, relative to the drive as delivered, which is the plant's sign
    """

    counts_rev: float | None = None
    increments: float | None = None
    rad_s: float | None = None
    sense: Polarity = polarity(None)


def _own_scale(axis: Axis) -> _OwnScale:
    """Return the scale of another vendor's drive, from its file and the objects that the rig file writes to
    it.
    """
    description, number = axis.description("motor"), drive_axis_of(axis.motor)
    if is_own("motor", identity_from_1018h(description)):
        return _OwnScale()
    stored, written = defaults(description, number), {(row.index, row.sub): row.value for row in axis.motor.sdo}

    def value(index: int, subindex: int) -> int | None:
        return written.get((of_axis(index, number), subindex), stored(index, subindex))

    delivered, rad_s = polarity(stored(*POLARITY)), None
    sense = Polarity(*(now * then for now, then in zip(polarity(value(*POLARITY)), delivered, strict=True)))
    with suppress(ValueError):
        rad_s, _ = velocity_unit(value)
    if axis.simulation.plant.encoder_counts_rev != axis.motor.encoder_counts_rev:
        return _OwnScale(rad_s=rad_s, sense=sense)
    increments = resolution(value)
    counts_rev = position_scale(value).counts_rev
    return _OwnScale(counts_rev, None if increments is None else float(increments), rad_s, sense)


def _drive(axis: Axis, setpoint: Binding) -> Profile:
    """Return the drive with the rig file's mode and set-point."""
    part = axis.brake if setpoint.node == "brake" else axis.motor
    mode = mode_of(part, axis.description(setpoint.node))
    object_key = _own_key(part, setpoint)
    plain = object_key == _SETPOINT and mode in MODES and mode not in POSITION_MODES
    drive = DRIVE402 if plain else with_own_mode(mode, object_key, _per_mille(axis, setpoint))
    return on_axis(drive, drive_axis_of(part))


def _per_mille(axis: Axis, setpoint: Binding) -> float:
    """Return the per mille of rated torque for one count of a set-point."""
    if _by_profile(setpoint):
        return 1.0
    if setpoint.kind.name == "torque_setpoint":
        return abs(setpoint.scale) / (axis.motor.rated_torque_Nm * 1e-3 * axis.mechanics.ratio)
    if setpoint.table:
        return 1000 / abs(setpoint.table[-1][0])
    return 1000 * abs(setpoint.scale) / axis.brake.rated_torque_Nm


def _key(binding: Binding) -> Key:
    return binding.entry.index, binding.entry.subindex


def _own_key(part: DeviceSection, binding: Binding) -> Key:
    """Return the object of the first axis that corresponds to a role's object on the device's own axis."""
    index, subindex = _key(binding)
    first = first_axis_object(index)
    return (first if of_axis(first, drive_axis_of(part)) == index else index), subindex


def _by_profile(binding: Binding) -> bool:
    """Tell whether an object counts in per mille of a rated value."""
    return first_axis_object(binding.entry.index) in PER_MILLE


def _shown(axis: Axis, kinds: Mapping[Node, Profile]) -> Iterator[Binding]:
    """Yield the measured roles on the devices `kinds` whose objects the kind does not handle itself."""
    bound = axis.allocation.bound
    setpoint = bound.get("torque_setpoint")
    for binding in bound.bindings:
        kind, name = kinds.get(binding.node), binding.kind.name
        if kind is None or name not in _QUANTITIES:
            continue
        by_itself = kind is BRAKE404 and binding.node == "brake" and _OWN_INPUTS.get(name) == _key(binding)
        if by_itself and not binding.decided.startswith(_BY_ROLE) and binding.offset == 0.0:
            continue
        if kind is DRIVE402 and binding.node == "motor":
            object_key = _own_key(axis.motor, binding)
            if name == "position" and object_key == _POSITION and binding.decided.startswith(_BY_ENCODER):
                continue
            by_setpoint = setpoint is not None and _by_profile(setpoint) and binding.scale == setpoint.scale
            if (
                name == "torque"
                and object_key in _DRIVES_TORQUE
                and (by_setpoint or binding.decided.startswith(_BY_RATED))
            ):
                continue
        yield binding


def couple(axis: Axis, record: Record, plant: PlantRecord, rows: Mapping[Node, tuple[int, Device]]) -> None:
    """Write the coupling of an axis's devices to its records (`RigAxis`) and its plant; `rows`: row and device
    by name.
    """
    p, drive_scale = axis.simulation.plant, _own_scale(axis)
    if drive_scale.counts_rev is not None:
        plant["counts_rad"] = p.encoder_polarity * drive_scale.counts_rev * p.ratio / (2 * math.pi)
    plant["counts_rad"] *= drive_scale.sense.position
    kinds = {node: of_description(axis.description(node)) for node in rows}
    kinds["motor"] = DRIVE402
    shown = [*_shown(axis, kinds)]
    for k, binding in enumerate(shown):
        row, device = rows[binding.node]
        low, high = _range(binding)
        gain, offset = _truth(axis, p, binding, drive_scale)
        record["shown"][k] = (
            row,
            device.dictionary.slot(*_key(binding)),
            _QUANTITIES[binding.kind.name],
            gain,
            offset,
            low,
            high,
        )
    record["shown_count"] = len(shown)
    bound = axis.allocation.bound
    setpoint = bound.get("torque_setpoint")
    if setpoint is not None and _by_profile(setpoint) and setpoint.decided.startswith(_BY_ROLE):
        per_mille = abs(setpoint.scale) * p.ratio / axis.mechanics.ratio
        plant["motor_Nm_pm"] = p.motor_polarity * per_mille * p.motor_rated_torque_Nm / axis.motor.rated_torque_Nm
    plant["motor_Nm_pm"] *= drive_scale.sense.torque
    brake = bound.get("brake_setpoint")
    if brake is not None:
        _couple_brake(axis, record, brake, *rows[brake.node])
    record["foreign"] = int(bool(shown) or record["brake_output"] != BrakeOutput.TORQUE)


def _couple_brake(axis: Axis, record: Record, binding: Binding, row: int, device: Device) -> None:
    record["brake"] = row
    acts = {core.key: core.slot for core in device.profile.objects if core.acts}
    slot = acts.get(_key(binding), -1)
    if device.profile.behaviour is BRAKE404.behaviour and slot >= 0:
        by_rig = binding.decided.startswith(_BY_ROLE)
        record["brake_output"] = BrakeOutput.DRIVER if by_rig else BrakeOutput.TORQUE
        record["brake_counts"] = 10.0 ** device.dictionary.number(0x6302, 1)
        if not by_rig:
            return
    elif device.profile.behaviour is DRIVE402.behaviour:
        record["brake_output"], record["brake_counts"] = BrakeOutput.DRIVE, 1 / _per_mille(axis, binding)
    elif ANALOGUE_OUT <= slot < ANALOGUE_OUT + OUTPUTS:
        record["brake_output"], record["brake_channel"] = BrakeOutput.ANALOGUE, slot - ANALOGUE_OUT
    else:
        record["brake_output"], record["brake_channel"] = BrakeOutput.OBJECT, device.dictionary.slot(*_key(binding))
    record["brake_scale_Nm"] = binding.scale
    record["brake_points"] = len(binding.table)
    for k, (raw, torque) in enumerate(sorted(binding.table)):
        record["brake_table_raw"][k], record["brake_table_Nm"][k] = raw, torque


def _range(binding: Binding) -> tuple[int, int]:
    half = 1 << binding.entry.bits - 1
    return (-half, half - 1) if binding.entry.signed else (0, 2 * half - 1)


def _truth(axis: Axis, p: Plant, binding: Binding, drive_scale: _OwnScale) -> tuple[float, float]:
    """Return (counts per unit, the quantity at the count 0) of an object that shows a quantity of the true
    plant.
    """
    motor, believed = axis.motor, axis.mechanics
    counts, name = 1 / abs(binding.scale), binding.kind.name
    of_drive = binding.node == "motor"
    if name == "position":
        counts_rev = (
            {_POSITION: drive_scale.counts_rev, _INCREMENTS: drive_scale.increments}.get(_own_key(motor, binding))
            if of_drive
            else None
        )
        sense = p.encoder_polarity * (drive_scale.sense.position if of_drive else 1)
        if counts_rev is not None:
            return sense * counts_rev * p.ratio / (2 * math.pi), 0.0
        turns = p.encoder_counts_rev * p.ratio / (motor.encoder_counts_rev * believed.ratio)
        return sense * counts * turns, 0.0
    if name == "velocity":
        if of_drive and _own_key(motor, binding) == _VELOCITY and drive_scale.rad_s is not None:
            return p.encoder_polarity * drive_scale.sense.velocity * p.ratio / drive_scale.rad_s, 0.0
        return p.encoder_polarity * counts * p.ratio / believed.ratio, 0.0
    if name == "torque":
        torque = motor.rated_torque_Nm * believed.ratio / (p.motor_rated_torque_Nm * p.ratio)
        return p.motor_polarity * (drive_scale.sense.torque if of_drive else 1) * counts * torque, 0.0
    return counts, binding.offset * (believed.transducer_polarity if name == "handle_torque" else 1)
