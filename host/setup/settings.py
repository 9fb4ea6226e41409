"""Settings of each device for bring-up, from its EDS file and the rig file alone.

No default value of a drive is assumed: PDOs are mapped anew if possible, inhibit times are set to 0,
limits are written and read back. In a third-party device the reactions to the host's loss are set, too,
and objects that may be constant are read first.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from coulombus.eds.cia301 import DATA_TYPES, CobId, predefined
from coulombus.eds.cia402 import OPERATION_MODE_PROFILE_TORQUE
from coulombus.eds.drive_axis import of_axis
from coulombus.eds.drive_scale import POLARITY
from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.eds.reader import Description, Variable
from coulombus.rigs.axis import Axis
from coulombus.rigs.device_services import emcy_default, emcy_identifier, is_guarded, is_mute, life_of
from coulombus.rigs.devices import Brake, DeviceSection, Motor, drive_axis_of
from coulombus.rigs.pdo_maps import mode_of, writable
from coulombus.rigs.roles import CIA401, CIA402, CIA404, Binding, profile_of
from coulombus.rigs.signals import RigPdo

__all__ = ["Setting", "encoded", "number_of", "settings_of", "torque_limits"]

INVALID, NO_RTR = 1 << 31, 1 << 30
CODE_OF_TYPE = {row.name: code for code, row in DATA_TYPES.items()}
MAX_TORQUE, MAX_CURRENT, TORQUE_LIMITS = 0x6072, 0x6073, (0x60E0, 0x60E1)
DISABLE_VOLTAGE, FREE, TO_PRE_OPERATIONAL = 2, 0, 0


@dataclass(frozen=True)
class Setting:
    """An object to write and read back.

    Attributes
    ----------
    key : the rig file's key that sets the value, or ""
    optional : a device without the object is accepted
    why : purpose of the setting
    lost : the protection that the host loses without it, or ""
    told : remark on a written setting: the device takes another value than the host intends
    soft : a device that refuses the value is accepted, too
    unless_equal : the object is read first, and written only if it differs
    verify : the object is read back
    type : the data type in the rig file, for an object that the EDS file may lack
    while_valid : an entry of a PDO mapping that is written although the PDO cannot be made invalid
    listed : the rig file names the object, as a role or in its list, so it may be manufacturer-specific
    """

    index: int
    subindex: int
    value: int
    key: str = ""
    optional: bool = False
    why: str = ""
    lost: str = ""
    told: str = ""
    soft: bool = False
    unless_equal: bool = False
    verify: bool = True
    type: str = ""
    listed: bool = False
    while_valid: bool = False

    @property
    def variable_bits(self) -> int:
        """Width of the data type in the rig file; 0 without one."""
        return DATA_TYPES[CODE_OF_TYPE[self.type]].bits if self.type else 0

    def variable(self, description: Description) -> Variable:
        """Return the object's description from the EDS file, else from the rig file."""
        if description.has(self.index, self.subindex) or not self.type:
            return description.variable(self.index, self.subindex)
        return Variable(
            *(self.index, self.subindex, "", CODE_OF_TYPE[self.type], "rw", None, False, None, None, False, 1)
        )


def settings_of(axis: Axis, node: str, mode: str, limit_pm: int) -> Iterator[Setting]:
    """Yield the settings of one device in their order.

    Parameters
    ----------
    limit_pm : the drive's torque limit in this mode [per mille of the rated torque]
    """
    part, description = axis.part(node), axis.description(node)
    ours = is_own(node, identity_from_1018h(description))
    pdos = [pdo for pdo in axis.pdos() if pdo.node == axis.prefix + node]
    yield from _listed(part, node, "before")
    yield from _unused_pdos(description, pdos, part.node_id)
    yield from _common_settings(axis, node, part, ours)
    if node == "motor":
        yield from _motor_settings(axis, mode, limit_pm, ours)
    elif node == "brake":
        yield from _brake_settings(axis, ours)
    deadline_ms = round(part.setpoint_fault_s * 1000) if isinstance(part, Motor | Brake) else 0
    for pdo in pdos:
        yield from _pdo_settings(pdo, node, deadline_ms, ours)
    yield from _listed(part, node, "after")
    yield from _listed(part, node, "end")


def _listed(part: DeviceSection, node: str, when: Literal["before", "after", "end"]) -> Iterator[Setting]:
    """Yield the settings that the rig file lists; a polarity is written only if the drive's differs."""
    polarity = of_axis(POLARITY[0], drive_axis_of(part)), POLARITY[1]
    for k, setting in enumerate(part.sdo):
        if setting.when == when:
            yield Setting(
                *(setting.index, setting.sub, setting.value),
                key=f"{node}.sdo.{k}",
                why="the rig file lists it",
                unless_equal=(setting.index, setting.sub) == polarity,
                verify=setting.verify,
                type=setting.type,
                listed=True,
            )


def _pdo_settings(pdo: RigPdo, node: str, deadline_ms: int, ours: bool) -> Iterator[Setting]:
    """Yield the settings of a PDO in the order of CiA 301, 7.5.2.36: invalid, no entries, parameters,
    entries, number of entries, valid.
    """
    layout, why = pdo.layout, f"{pdo.name} carries {', '.join(signal.key for signal in pdo.signals)}"
    receive = layout.direction == "rpdo"
    communication = (0x1400 if receive else 0x1800) + layout.number - 1
    mapping = communication + 0x200
    word = layout.cob_id | (0 if layout.rtr_allowed else NO_RTR)
    yield Setting(communication, 1, word | INVALID, why=why)
    anew = not pdo.fixed
    yield Setting(mapping, 0, 0, why=why, while_valid=anew)
    yield Setting(communication, 2, layout.transmission, "bus.actuation" if receive else "", optional=True, why=why)
    if receive:
        lost = "" if ours else "it does not detect a missing RPDO"
        yield Setting(
            *(communication, 5, deadline_ms, f"{node}.setpoint_fault_s"),
            optional=True,
            why="the deadline of the set-points",
            lost=lost,
        )
    else:
        yield Setting(communication, 3, 0, optional=True, why=why)
        timer = layout.event_ns // 1_000_000
        yield Setting(communication, 5, timer, optional=not timer, why=why)
        yield Setting(communication, 6, 0, optional=True, why=why)
    for i, entry in enumerate(layout.entries, start=1):
        yield Setting(mapping, i, entry.index << 16 | entry.subindex << 8 | entry.bits, why=why, while_valid=anew)
    yield Setting(mapping, 0, len(layout.entries), why=why, while_valid=anew)
    yield Setting(communication, 1, word, why=why)


def _unused_pdos(description: Description, pdos: Sequence[RigPdo], node_id: int) -> Iterator[Setting]:
    """Yield the settings that disable every unused PDO: a default PDO would load the bus without being
    planned.
    """
    used = {(pdo.layout.direction, pdo.layout.number) for pdo in pdos}
    described = sorted(description.objects)
    for base, direction in ((0x1400, "rpdo"), (0x1800, "tpdo")):
        for index in described[bisect_left(described, base) : bisect_left(described, base + 512)]:
            number = index - base + 1
            if description.has(index, 1) and (direction, number) not in used:
                default = description.default(index, 1, node_id)
                cob_id = default if isinstance(default, int) else predefined(index, 1, node_id) or INVALID
                if cob_id & INVALID:
                    continue
                mapping = index + 0x200
                lost = f"{direction.upper()}{number} cannot be switched off and may load the bus"
                stands = not writable(description.variable(index, 1))
                if stands and description.has(mapping, 0) and writable(description.variable(mapping, 0)):
                    why = "it is not used, and its identifier is read-only"
                    yield Setting(mapping, 0, 0, why=why, lost=lost, soft=True, while_valid=True)
                else:
                    yield Setting(index, 1, cob_id | INVALID, why="it is not used", lost=lost, soft=True)


def _common_settings(axis: Axis, node: str, part: DeviceSection, ours: bool) -> Iterator[Setting]:
    """Yield the settings of heartbeats in both directions or of guarding, of SYNC and its loss, and of EMCY."""
    description = axis.description(node)
    if is_guarded(description):
        guard_ms, factor = life_of(axis.host.heartbeat_s, part.heartbeat_timeout_s)
        yield Setting(0x1017, 0, 0, optional=True, why="the node is guarded, and a node has one error control")
        yield Setting(0x100C, 0, guard_ms, "host.heartbeat_s", why="the host guards the node in so many ms")
        yield Setting(0x100D, 0, factor, f"{node}.heartbeat_timeout_s", why="so many guard times are the life time")
    else:
        timeout_ms = round(part.heartbeat_timeout_s * 1000)
        yield Setting(
            *(0x1016, 1, axis.host.node_id << 16 | timeout_ms, f"{node}.heartbeat_timeout_s"),
            optional=True,
            why="the node watches the host's heartbeat",
        )
        lost = "the host does not hear whether it lives: only its TPDOs tell"
        beat = round(part.heartbeat_s * 1000)
        yield Setting(0x1017, 0, beat, f"{node}.heartbeat_s", optional=True, why="its own heartbeat", lost=lost)
    yield Setting(0x1005, 0, CobId.SYNC, optional=True, why="SYNC's identifier", unless_equal=not ours)
    yield _emergency(description, part.node_id)
    if isinstance(part, Motor | Brake):
        timeout_us = round(part.sync_timeout_s * 1e6)
        lost = f"the {'drive' if node == 'motor' else 'brake'} does not detect the loss of SYNC ({node}.sync_timeout_s)"
        yield Setting(0x2002, 0, timeout_us, f"{node}.sync_timeout_s", optional=True, why="the loss of SYNC", lost=lost)
    if not ours:
        period_us = round(axis.bus.period_s * 1e6)
        yield Setting(
            *(0x1006, 0, period_us, "bus.period_s"), optional=True, soft=True, unless_equal=True, why="SYNC's period"
        )
        yield Setting(
            *(0x1029, 1, TO_PRE_OPERATIONAL),
            optional=True,
            soft=True,
            unless_equal=True,
            why="a lost host ends its PDOs",
        )


def _emergency(description: Description, node_id: int) -> Setting:
    """Return the setting of EMCY's identifier, which is written only if the device's differs."""
    mute, default = is_mute(description, node_id), emcy_default(description, node_id)
    off = default is not None and bool(default & INVALID)
    refused = default == CobId.SYNC  # `device_plan` reports it
    return Setting(
        *(0x1014, 0, emcy_identifier(description, node_id)),
        optional=True,
        soft=mute or refused,
        unless_equal=True,
        why="EMCY's identifier",
        lost="it reports no fault to the host by EMCY" if mute else "",
        told="its EMCY is switched off in 1014h (bit 31); bring-up switches it on" if off and not mute else "",
    )


def _drive_settings(axis: Axis, part: Motor | Brake, setpoint: Binding, ours: bool) -> Iterator[Setting]:
    """Yield the settings of a CiA 402 drive: mode, set-point 0, torque slope, and no torque after faults."""
    description = axis.description(setpoint.node)

    def at(index: int) -> int:
        return of_axis(index, drive_axis_of(part))

    mode = mode_of(part, description)
    readable = not description.has(at(0x6060), 0) or description.variable(at(0x6060), 0).access != "wo"
    yield Setting(at(0x6060), 0, mode, f"{setpoint.node}.mode", why="the mode of operation", verify=readable)
    yield Setting(setpoint.entry.index, setpoint.entry.subindex, 0, why="no torque at the start", listed=True)
    if mode == OPERATION_MODE_PROFILE_TORQUE and description.has(at(0x6087), 0):
        rate = axis.limits.torque_rate_Nm_s / abs(setpoint.scale)
        steep = int(min(math.ceil(rate), description.variable(at(0x6087), 0).largest, 0x7FFFFFFF))
        yield Setting(
            at(0x6087), 0, steep, "limits.torque_rate_Nm_s", why="the torque's slope: it follows the host's own"
        )
    elif mode == OPERATION_MODE_PROFILE_TORQUE:
        lost = "nothing tells how fast the torque follows in mode 4"
        yield Setting(at(0x6087), 0, 0, optional=True, why="the torque's slope", lost=lost)
    if ours:
        return
    exponent = next(k for k in (-3, -4, -5, -6) if abs(axis.bus.period_s * 10**-k % 1) < 1e-6 or k == -6)
    cycle = round(axis.bus.period_s * 10.0**-exponent)
    for sub, value in ((1, cycle), (2, exponent)):
        yield Setting(at(0x60C2), sub, value, optional=True, soft=True, unless_equal=True, why="the cycle's period")
    reactions = (
        (0x6007, DISABLE_VOLTAGE, "the host's loss disables it"),
        *((index, FREE, "no torque when it stops") for index in (0x605A, 0x605B, 0x605C, 0x605E)),
    )
    for index, value, why in reactions:
        lost = "its reaction to the loss of the host is the drive's default" if index == 0x6007 else ""
        yield Setting(at(index), 0, value, optional=True, soft=True, unless_equal=True, why=why, lost=lost)


def torque_limits(description: Description, drive_axis: int = 1) -> tuple[int, ...]:
    """Return the objects that limit the torque of a drive's axis: 6072h, else 60E0h and 60E1h, else 6073h.

    Empty if none can be written.
    """
    max_torque, max_current = of_axis(MAX_TORQUE, drive_axis), of_axis(MAX_CURRENT, drive_axis)
    both_ways = tuple(of_axis(index, drive_axis) for index in TORQUE_LIMITS)

    def usable(index: int) -> bool:
        return description.has(index, 0) and description.variable(index, 0).access not in ("ro", "const")

    if usable(max_torque):
        return (max_torque,)
    if all(map(usable, both_ways)):
        return both_ways
    return (max_current,) if usable(max_current) else ()


def _motor_settings(axis: Axis, mode: str, limit_pm: int, ours: bool) -> Iterator[Setting]:
    description = axis.description("motor")
    yield from _drive_settings(axis, axis.motor, axis.allocation.bound["torque_setpoint"], ours)
    for index in torque_limits(description, drive_axis_of(axis.motor)):
        low = description.variable(index, 0).low
        value, note = limit_pm, ""
        if low is not None and limit_pm < low:
            value = int(low)
            note = (
                f"its own limit is {value} per mille, the least that {index:04X}h takes; the host limits to {limit_pm}"
            )
        yield Setting(index, 0, value, f"mode.{mode}.motor_limit_Nm", why="the drive's own torque limit", told=note)
    zero_us = round(axis.motor.setpoint_zero_cycles * axis.bus.period_s * 1e6)
    ended = any(
        pdo.node == axis.prefix + "motor"
        and pdo.layout.direction == "rpdo"
        and description.has(0x1400 + pdo.layout.number - 1, 5)
        for pdo in axis.pdos()
    )
    by = (
        "only the RPDO deadline 1400h:05 ends an old set-point"
        if ended
        else "an old set-point acts until the drive detects the loss of the host"
    )
    lost = f"no set-point becomes 0 after motor.setpoint_zero_cycles; {by}"
    yield Setting(
        *(0x2001, 0, zero_us, "motor.setpoint_zero_cycles"), optional=True, why="an old set-point is 0", lost=lost
    )


def _brake_settings(axis: Axis, ours: bool) -> Iterator[Setting]:
    setpoint = axis.allocation.bound["brake_setpoint"]
    if setpoint.node != "brake":
        return
    profile, sub = profile_of(axis.description("brake"), "brake"), setpoint.entry.subindex
    off = setpoint.table[0][0] if setpoint.table else 0
    if profile == CIA402:
        yield from _drive_settings(axis, axis.brake, setpoint, ours)
        return
    mode_object, value_object = {CIA404: (0x6340, 0x7341), CIA401: (0x6443, 0x6444)}[profile]
    lost = "without set-points it keeps the last one"
    yield Setting(mode_object, sub, 1, optional=not ours, soft=not ours, why="a fault value is taken", lost=lost)
    yield Setting(value_object, sub, off, optional=not ours, soft=not ours, why="its fault value is off", lost=lost)
    hold = "without set-points the brake does not hold for brake.hold_s and then ramp down by itself"
    hold_us, ramp_us = round(axis.brake.hold_s * 1e6), round(axis.brake.ramp_s * 1e6)
    yield Setting(0x2001, 0, hold_us, "brake.hold_s", optional=True, why="an old set-point is held", lost=hold)
    ramp = "the brake's own ramp does not take brake.ramp_s"
    yield Setting(0x2005, 0, ramp_us, "brake.ramp_s", optional=True, why="then ramped off", lost=ramp)


def encoded(variable: Variable, value: int) -> bytes:
    """Return the bytes of `value` in the object's data type.

    Raises
    ------
    OverflowError
        the value does not fit into the type; it is never truncated
    """
    limits = variable.whole
    if limits is None or not limits[0] <= value <= limits[1]:
        raise OverflowError(f"{value} does not fit into {variable.index:04X}h:{variable.subindex:02X}")
    return value.to_bytes((variable.bits + 7) // 8, "little", signed=limits[0] < 0)


def number_of(variable: Variable, data: bytes) -> int:
    """Return the number in the bytes of an integer object."""
    return int.from_bytes(data, "little", signed=variable.whole is not None and variable.whole[0] < 0)
