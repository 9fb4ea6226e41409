"""The objects that bring-up sets in each device, made from its EDS file and the rig file alone.

Nothing is assumed of a drive's defaults: PDOs are always mapped anew, inhibit times set to 0, limits written and read back.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from coulombus.eds.cia301 import CobId, predefined
from coulombus.eds.cia402 import OPERATION_MODE_CST
from coulombus.eds.reader import Description, Variable
from coulombus.rigs.axis import Axis
from coulombus.rigs.devices import Brake, Motor
from coulombus.rigs.signals import RigPdo

__all__ = ["Role", "Setting", "encoded", "settings_of"]

Role = Literal["motor", "brake"]
INVALID = 1 << 31


@dataclass(frozen=True)
class Setting:
    """One object to write and read back; `key` is the rig file's key that the value comes from, "" where there is none."""

    index: int
    subindex: int
    value: int
    key: str = ""
    optional: bool = False
    """True: a device without the object is accepted."""


def settings_of(axis: Axis, role: Role, mode: str, limit_pm: int) -> Iterator[Setting]:
    """Yield what one device is to be set to, in its order.

    Parameters
    ----------
    limit_pm : the drive's torque limit 6072h in this mode [per mille of the rated torque]
    """
    part = axis.motor if role == "motor" else axis.brake
    pdos = [pdo for pdo in axis.pdos() if pdo.node == axis.prefix + role]
    yield from _unused_pdos(axis.description(role), pdos, part.node_id)
    yield from _common_settings(axis, role, part)
    yield from _motor_settings(axis, mode, limit_pm) if role == "motor" else _brake_settings(axis)
    for pdo in pdos:
        yield from _pdo_settings(pdo, role, round(part.setpoint_fault_s * 1000))


def _pdo_settings(pdo: RigPdo, role: Role, deadline_ms: int) -> Iterator[Setting]:
    """The prescribed procedure: invalid, no entries, parameters, entries, their number, valid (CiA 301, 7.5.2.36)."""
    layout = pdo.layout
    receive = layout.direction == "rpdo"
    communication = (0x1400 if receive else 0x1800) + layout.number - 1
    mapping = communication + 0x200
    yield Setting(communication, 1, layout.cob_id | INVALID)
    yield Setting(mapping, 0, 0)
    yield Setting(communication, 2, layout.transmission, "bus.actuation" if receive else "")
    if receive:
        yield Setting(communication, 5, deadline_ms, f"{role}.setpoint_fault_s")
    else:
        yield Setting(communication, 3, 0, optional=True)
        yield Setting(communication, 5, 0, optional=True)
        yield Setting(communication, 6, 0, optional=True)
    for i, entry in enumerate(layout.entries, start=1):
        yield Setting(mapping, i, entry.index << 16 | entry.subindex << 8 | entry.bits)
    yield Setting(mapping, 0, len(layout.entries))
    yield Setting(communication, 1, layout.cob_id)


def _unused_pdos(description: Description, pdos: Sequence[RigPdo], node_id: int) -> Iterator[Setting]:
    """Switch every PDO off that the rig does not use: a default PDO would load the bus unplanned."""
    used = {(pdo.layout.direction, pdo.layout.number) for pdo in pdos}
    for base, direction in ((0x1400, "rpdo"), (0x1800, "tpdo")):
        for number in range(1, 513):
            index = base + number - 1
            if description.has(index, 1) and (direction, number) not in used:
                default = description.default(index, 1, node_id)
                cob_id = default if isinstance(default, int) else predefined(index, 1, node_id) or INVALID
                if not cob_id & INVALID:
                    yield Setting(index, 1, cob_id | INVALID)


def _common_settings(axis: Axis, role: Role, part: Motor | Brake) -> Iterator[Setting]:
    """Heartbeats both ways and the loss of SYNC."""
    timeout_ms = round(part.heartbeat_timeout_s * 1000)
    yield Setting(0x1016, 1, axis.host.node_id << 16 | timeout_ms, f"{role}.heartbeat_timeout_s")
    yield Setting(0x1017, 0, round(part.heartbeat_s * 1000), f"{role}.heartbeat_s")
    yield Setting(0x1005, 0, CobId.SYNC)
    yield Setting(0x2002, 0, round(part.sync_timeout_s * 1e6), f"{role}.sync_timeout_s", optional=True)


def _motor_settings(axis: Axis, mode: str, limit_pm: int) -> Iterator[Setting]:
    yield Setting(0x6060, 0, OPERATION_MODE_CST)
    yield Setting(0x6071, 0, 0)
    yield Setting(0x6072, 0, limit_pm, f"mode.{mode}.motor_limit_Nm")
    zero_us = round(axis.motor.setpoint_zero_cycles * axis.bus.period_s * 1e6)
    yield Setting(0x2001, 0, zero_us, "motor.setpoint_zero_cycles", optional=True)


def _brake_settings(axis: Axis) -> Iterator[Setting]:
    yield Setting(0x6340, 1, 1)
    yield Setting(0x7341, 1, 0)
    yield Setting(0x2001, 0, round(axis.brake.hold_s * 1e6), "brake.hold_s", optional=True)
    yield Setting(0x2005, 0, round(axis.brake.ramp_s * 1e6), "brake.ramp_s", optional=True)


def encoded(variable: Variable, value: int) -> bytes:
    """Return `value` as the object's type is transferred.

    Raises
    ------
    OverflowError
        The value does not fit into the type; nothing is ever cut.
    """
    limits = variable.whole
    if limits is None or not limits[0] <= value <= limits[1]:
        raise OverflowError(f"{value} does not fit into {variable.index:04X}h:{variable.subindex:02X}")
    return value.to_bytes((variable.bits + 7) // 8, "little", signed=limits[0] < 0)
