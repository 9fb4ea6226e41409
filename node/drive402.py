"""CiA 402 motor drive as a kind of device: computed quantities, checks of writes, its part of the core.

The power states are in `node.states402`, the torque in `node.motion402`, the objects in
`node.slots402`. The loss of the host (heartbeat, guarding, bus-off) is a fault of our own drive;
another vendor's drive follows 6007h, as in CiA 402.

    n : the `NodeRecord`
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

from coulombus.eds.cia301 import Abort
from coulombus.eds.drive_scale import SCALE_OBJECTS, VELOCITY_UNIT, position_scale, velocity_unit
from coulombus.eds.own_devices import PRODUCTS
from coulombus.kernels.decorator import constant, kernel
from coulombus.node import emcy, motion402, servo402, slots402, states402
from coulombus.node.profile import (
    BY_RESET,
    SUPPLY_LOST,
    SUPPLY_MISSING,
    SUPPLY_THERE,
    Behaviour,
    CoreObject,
    Key,
    Objects,
    Profile,
    SdoAbort,
)
from coulombus.node.record import DriveFields, NodeRecord
from coulombus.wire.frame import Queue

__all__ = ["COUNTS_REV", "DRIVE402", "with_own_mode"]

_MODE, _SUPPORTED_MODES = 0x6060, 0x6502
_TARGET_TORQUE = (0x6071, 0)
_HOST_LOST = 1 << emcy.HEARTBEAT | 1 << emcy.LIFE_GUARDING | 1 << emcy.BUS_OFF
"""Causes of CiA 402's connection loss, for which 6007h applies."""
_SCALED = frozenset((0x2010, VELOCITY_UNIT, 0x60C2, *(index for index, _ in SCALE_OBJECTS)))
_TORQUE, _SPEED = constant(slots402.ACTS_TORQUE), constant(slots402.ACTS_SPEED)
_POSITION, _NO = constant(slots402.ACTS_POSITION), constant(0)
_AXIS: tuple[Key, ...] = ((0x607B, 1), (0x60B8, 0))
_SPEED_RAD_S = 300.0
"""Bandwidth of the speed control of a drive that knows its load."""
COUNTS_REV = 8192.0
"""Counts in one turn of the motor, for a drive that does not state them."""
_SUPPLY_mV = 48_000
"""Voltage of the DC link, for a file that does not state it."""


@kernel
def _apply(n: NodeRecord, t_ns: int, received_ns: int, carries: int, out: Queue) -> None:
    if carries & slots402.ACTS_TORQUE:
        states402.new_setpoint(n, received_ns, _TORQUE)
    if carries & slots402.ACTS_SPEED:
        states402.new_setpoint(n, received_ns, _SPEED)
    if carries & slots402.ACTS_POSITION:
        states402.new_setpoint(n, received_ns, _POSITION)
    if carries & slots402.ACTS_PROBE and n.servo:
        servo402.serve(n, servo402.PROBE, t_ns, 0)
    if carries & slots402.ACTS_CONTROLWORD:
        states402.new_controlword(n, t_ns, out)


@kernel
def _connection_lost(n: NodeRecord, t_ns: int, why: int) -> int:
    return states402.connection_lost(n, t_ns, 1 if why == BY_RESET else 0)


@kernel
def _react(n: NodeRecord, t_ns: int, cause: int) -> None:
    if n.abort_by_option and _HOST_LOST >> cause & 1:
        _abort_connection(n, t_ns, cause)
    elif emcy.FAULT_MASK >> cause & 1:
        states402.fault(n, t_ns, emcy.AT_ONCE_MASK >> cause & 1)


@kernel
def _abort_connection(n: NodeRecord, t_ns: int, cause: int) -> None:
    """Follow 6007h; only a fault by 6007h stays latched until the fault reset."""
    if states402.connection_lost(n, t_ns, _NO):
        n.held |= 1 << cause
        states402.fault(n, t_ns, _NO)
    else:
        n.held &= ~(1 << cause)


@kernel
def _supply(n: NodeRecord) -> int:
    if n.in_supply_ok:
        return SUPPLY_THERE
    return SUPPLY_LOST if states402.needs_supply(n) else SUPPLY_MISSING


@kernel
def _next_deadline(n: NodeRecord, t_ns: int, next_ns: int) -> int:
    return states402.next_deadline(n, next_ns)


def _scale(record: NodeRecord, objects: Objects) -> None:
    """Set the units, the gains 2010h, and the period 60C2h."""
    number, own_number = objects.number, objects.own_number

    def value(index: int, subindex: int) -> int:
        return number(index, subindex, 0)

    counts_rev = position_scale(value).counts_rev or COUNTS_REV
    record["index_counts"], record["unit_counts_s"] = counts_rev, 1.0
    with suppress(ValueError):
        record["unit_counts_s"] = velocity_unit(value)[0] / (2 * math.pi) * counts_rev
    kp, ki, position_kp = _gains(record)
    record["speed_kp"] = own_number(0x2010, 1, round(kp * 1e6)) * 1e-6
    record["speed_ki"] = own_number(0x2010, 2, round(ki * 1e6)) * 1e-6
    record["position_kp"] = own_number(0x2010, 3, round(position_kp * 1e3)) * 1e-3
    record["period_ns"] = round(number(0x60C2, 1) * 10.0 ** min(number(0x60C2, 2, -3), 0) * 1e9)


def _gains(record: NodeRecord) -> tuple[float, float, float]:
    """Return the gains for the load: proportional and integral of the speed control, and Kp of the position
    control.
    """
    unit = float(record["unit_counts_s"])
    load = float(record["load_counts_s2"]) / unit
    if not load:
        return 0.015 * unit, 0.3 * unit, 20.0
    return _SPEED_RAD_S / load, _SPEED_RAD_S**2 / load / 5, _SPEED_RAD_S / 5


def _modes(objects: Objects) -> int:
    """Return the offered modes: those of 6502h whose objects the file has."""
    supported = objects.number(_SUPPORTED_MODES, 0, states402.ALL_MODES)
    return sum(
        1 << mode - 1 for mode, row in slots402.SETPOINTS.items() if supported >> mode - 1 & 1 and row.key in objects
    )


def _is_servo(record: NodeRecord, objects: Objects) -> bool:
    """Tell whether the drive offers a position mode, has an object of the axis, or switches and 60FDh."""
    offered = _modes(objects)
    if any(offered >> mode - 1 & 1 for mode in motion402.POSITION_MODES) or any(key in objects for key in _AXIS):
        return True
    return (0x60FD, 0) in objects and any(math.isfinite(place) for place in record["switch_counts"])


def _started(record: NodeRecord, objects: Objects, t_ns: int) -> None:
    record["supply_mV"] = objects.number(0x6079, 0, 0) or _SUPPLY_mV
    ours = objects.own_number(0x1018, 1, 0) != 0  # our own drive takes the fault reaction regardless of 6007h
    record["abort_by_option"] = int(not ours and (0x6007, 0) in objects)
    record["modes"] = _modes(objects)
    record["servo"] = servo402.servo_address() if _is_servo(record, objects) else 0
    _scale(record, objects)
    states402.start(record, t_ns)


def _changed(record: NodeRecord, objects: Objects, index: int, subindex: int) -> None:
    if index in _SCALED:
        _scale(record, objects)


def _check(objects: Objects, index: int, subindex: int, value: int) -> None:
    """Admit only modes that 6502h states (bit n - 1 for mode n; mode 0 is "none") and whose set-point the
    file has, and option codes that the drive has.
    """
    if index == _MODE:
        if value < 0 or (value > 0 and not _modes(objects) >> (value - 1) & 1):
            raise SdoAbort(Abort.VALUE)
    elif value not in states402.OPTION_CODES.get(index, (value,)):
        raise SdoAbort(Abort.VALUE)


def with_own_mode(mode: int, setpoint: Key, per_mille: float) -> Profile:
    """Return a drive with a vendor-specific mode.

    Parameters
    ----------
    mode : its number in 6060h; it may be a mode of CiA, which then has this set-point
    setpoint : object that acts in this mode, at once as in CST
    per_mille : of the rated torque, for one count of the set-point
    """

    def started(record: NodeRecord, objects: Objects, t_ns: int) -> None:
        record["vendor_mode"], record["vendor_pm"] = mode, per_mille
        record["vendor_slot"] = slots402.TARGET_TORQUE if setpoint == _TARGET_TORQUE else slots402.VENDOR_TARGET
        if (_MODE, 0) not in objects:
            record["values"][slots402.MODE] = mode
        _started(record, objects, t_ns)

    def check(objects: Objects, index: int, subindex: int, value: int) -> None:
        if index != _MODE or value != mode:
            _check(objects, index, subindex, value)

    row = CoreObject(*setpoint, slots402.VENDOR_TARGET, acts=slots402.ACTS_TORQUE, named=True)
    rows = () if setpoint == _TARGET_TORQUE else (row,)
    return replace(DRIVE402.fitted(*rows), started=started, check=check)


DRIVE402 = Profile(
    "drive",
    objects=slots402.OBJECTS,
    fields=DriveFields,
    terminals=slots402.TERMINALS,
    behaviour=Behaviour(
        sample=states402.sample,
        actuate=states402.actuate,
        detect=states402.detect,
        apply=_apply,
        connection_lost=_connection_lost,
        react=_react,
        supply=_supply,
        next_deadline=_next_deadline,
    ),
    product=PRODUCTS["motor"],
    held=emcy.FAULT_MASK,
    started=_started,
    changed=_changed,
    check=_check,
)
"""A CiA 402 drive."""
