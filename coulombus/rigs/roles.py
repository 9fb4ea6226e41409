"""The roles of an axis: quantities that the host's cycle needs, and the device objects that supply them.

A role is bound by the rig file's ``[role.NAME]``; otherwise it follows from the CANopen profile of the device (1000h):

====================  =====================  ==========================  ==================
role                  CiA 402 (motor)        CiA 404 (brake, sensors)    CiA 401, 402 (brake)
====================  =====================  ==========================  ==================
controlword           6040h                                              402: 6040h
torque set-point      6071h                  7300h:1 (brake's)           6411h:1; 6071h
statusword            6041h                                              402: 6041h
position              6064h
torque                6077h, else 6078h
handle torque                                7130h:1
coil current                                 7130h:2
coil temperature                             7130h:3
====================  =====================  ==========================  ==================

Of a drive of several axes these are the objects of the axis that `drive_axis` names. A drive's
torque counts in per mille of its rated torque and its position in encoder counts (CiA 402); the rig file's ratio and
polarity refer them to the handle. A CiA 404 block carries its unit (6131, 6301) and its decimal digits (6132, 6302):
the EDS gives the scale, and a wrong unit is refused unless the rig file gives the scale. A role that no device has is
absent, and the host's loss is reported.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from coulombus.eds.drive_axis import first_axis_object, of_axis
from coulombus.eds.drive_scale import VELOCITY_UNIT, defaults, velocity_unit
from coulombus.eds.pdo import Entry, entry_of
from coulombus.eds.reader import Description
from coulombus.eds.units import BLOCK_UNITS, NOTATION
from coulombus.rigs.devices import BrakeRole, Role, drive_axis_of
from coulombus.rigs.errors import Problem
from coulombus.rigs.pdo_records import mapping_sentence
from coulombus.rigs.signals import Direction, Node, Parts

__all__ = [
    "CIA401",
    "CIA402",
    "CIA404",
    "ROLES",
    "Binding",
    "Bound",
    "RoleKind",
    "bind",
    "checked_entry",
    "profile_of",
]

CIA401, CIA402, CIA404 = 401, 402, 404
UNITS = {name: index for index, name in NOTATION.items() if name in ("Nm", "A", "degC")}
"""Notation indices of CiA 303-2: the numerator of a unit."""
PER_MILLE = (0x6071, 0x6074, 0x6077, 0x6078)
"""Objects in per mille of a rated value."""
DEVICE = "DEVICE"
"""Placeholder for the device in a remedy."""
WIDEST = 32
"""Widest integer of the host [bits]."""


class RoleKind(NamedTuple):
    """A role: its signal, direction and unit, whether it is optional, and the host's loss without it."""

    name: str
    signal: str
    direction: Direction
    unit: str
    needed: bool
    lost: str = ""

    @property
    def home(self) -> Node:
        """The default device: that of its signal's name."""
        return self.signal.partition(".")[0]


ROLES = (
    RoleKind("controlword", "motor.controlword", "rpdo", "", True),
    RoleKind("torque_setpoint", "motor.target_torque_Nm", "rpdo", "Nm", True),
    RoleKind("statusword", "motor.statusword", "tpdo", "", True),
    RoleKind("position", "motor.position_rad", "tpdo", "rad", True),
    RoleKind(
        *("torque", "motor.torque_Nm", "tpdo", "Nm", False),
        "the motor's torque is not measured: the watch of its net work (limits.net_work_J) takes the command for it",
    ),
    RoleKind("velocity", "motor.velocity_rad_s", "tpdo", "rad/s", False),
    RoleKind("brake_controlword", "brake.controlword", "rpdo", "", False),
    RoleKind("brake_setpoint", "brake.setpoint_Nm", "rpdo", "Nm", True),
    RoleKind("brake_statusword", "brake.statusword", "tpdo", "", False),
    RoleKind(
        *("handle_torque", "brake.handle_torque_Nm", "tpdo", "Nm", False),
        "the handle torque is not measured: no watch of it against the brake's command (limits.handle_mismatch_Nm), no check before arming "
        "that nothing loads the handle (limits.still_handle_torque_Nm), no sign check of a transducer",
    ),
    RoleKind(
        *("coil_current", "brake.coil_current_A", "tpdo", "A", False),
        "the coil's current is not measured: its I2t watch takes the command times brake.coil_A_Nm for it",
    ),
    RoleKind(
        *("coil_temperature", "brake.coil_temperature_degC", "tpdo", "degC", False),
        "the coil's temperature is not measured, and not recorded",
    ),
)
"""Every role, in the order of PDO allocation."""

Objects = tuple[tuple[int, int], ...]
MOTOR_OBJECTS: Mapping[str, Objects] = {
    "controlword": ((0x6040, 0),),
    "torque_setpoint": ((0x6071, 0),),
    "statusword": ((0x6041, 0),),
    "position": ((0x6064, 0),),
    "torque": ((0x6077, 0), (0x6078, 0)),
}
SENSED: Mapping[str, Objects] = {
    "handle_torque": ((0x7130, 1),),
    "coil_current": ((0x7130, 2),),
    "coil_temperature": ((0x7130, 3),),
}
BRAKE_OBJECTS: Mapping[int, Mapping[str, Objects]] = {
    CIA404: {"brake_setpoint": ((0x7300, 1),), **SENSED},
    CIA401: {"brake_setpoint": ((0x6411, 1),)},
    CIA402: {
        "brake_controlword": ((0x6040, 0),),
        "brake_setpoint": ((0x6071, 0),),
        "brake_statusword": ((0x6041, 0),),
    },
}


@dataclass(frozen=True)
class Binding:
    """A role and its object: SI value = raw x `scale` + `offset`; `decided` names the scale's source.

    `table` is the brake's, raw counts and torque at the handle; `scale` is then that of its last step.
    """

    kind: RoleKind
    node: Node
    entry: Entry
    scale: float = 1.0
    offset: float = 0.0
    decided: str = ""
    table: tuple[tuple[int, float], ...] = ()

    @property
    def place(self) -> tuple[Node, int, int]:
        """The device and the object."""
        return self.node, self.entry.index, self.entry.subindex


@dataclass(frozen=True)
class Bound:
    """The bound roles, the losses by absent roles, and the reasons for a refusal."""

    bindings: tuple[Binding, ...]
    losses: tuple[str, ...]
    problems: tuple[Problem, ...]

    def get(self, role: str) -> Binding | None:
        """Return the binding of a role, or None."""
        return next((binding for binding in self.bindings if binding.kind.name == role), None)

    def __getitem__(self, role: str) -> Binding:
        binding = self.get(role)
        if binding is None:
            raise KeyError(role)
        return binding


class _Refused(Exception):
    def __init__(self, problem: Problem) -> None:
        self.problem = problem


def profile_of(description: Description, node: Node) -> int:
    """Return the CANopen profile of a device: that of 1000h, else the one whose objects it has; a motor's is always CiA
    402.
    """
    if node == "motor":
        return CIA402
    device_type = description.variable(0x1000, 0).default if description.has(0x1000, 0) else None
    number = device_type & 0xFFFF if isinstance(device_type, int) else 0
    if number in BRAKE_OBJECTS:
        return number
    signs = ((0x7300, CIA404), (0x7130, CIA404), (0x6411, CIA401), (0x6071, CIA402), (0x6040, CIA402))
    return next((profile for index, profile in signs if description.has(index)), CIA404)


def bind(parts: Parts) -> Bound:
    """Bind every role of an axis by its rig file and its devices' profiles."""
    bindings: list[Binding] = []
    losses: list[str] = []
    problems: list[Problem] = []
    for kind in ROLES:
        try:
            binding = _bind(parts, kind, bindings)
        except _Refused as refused:
            problems.append(refused.problem)
            continue
        if binding is not None:
            bindings.append(binding)
        elif kind.lost:
            losses.append(kind.lost)
    bound_names = {binding.kind.name for binding in bindings}
    if len(bound_names & {"brake_controlword", "brake_statusword"}) == 1 and not problems:
        text = "a brake that is a CiA 402 drive has a statusword and a controlword"
        problems.append(Problem("brake_statusword", "brake", "", text, "bind both of them, or none"))
    return Bound(tuple(bindings), tuple(losses), (*problems, *_twice(bindings)))


def _twice(bindings: list[Binding]) -> Iterator[Problem]:
    owners: dict[tuple[Node, int, int], str] = {}
    for binding in bindings:
        before = owners.setdefault(binding.place, binding.kind.name)
        if before != binding.kind.name:
            label = f"{binding.entry.index:04X}h:{binding.entry.subindex:X}"
            text = f"{label} of {binding.node} is the {before} already"
            yield Problem(binding.kind.name, binding.node, label, text, "bind another object")


def _bind(parts: Parts, kind: RoleKind, bindings: list[Binding]) -> Binding | None:
    """Return the binding of a role; None if no device has it."""
    role: Role = getattr(parts.role, kind.name) or Role(node="", object="")
    node = role.node or kind.home
    if node not in parts.devices:
        text = f"there is no device '{node}'"
        raise _Refused(Problem(kind.name, node, role.object, text, f"name one of {', '.join(parts.devices)}"))
    if role.object == "none":
        if kind.needed:
            text = "the host cannot do without this role"
            raise _Refused(Problem(kind.name, node, role.object, text, "name the object that it is"))
        return None
    description = parts.description(node)
    candidates = _named(role.object) or _by_profile(kind, description, node, drive_axis_of(parts.part(node)))
    entry_place = next((at for at in candidates if not _lacks(description, *at, kind.direction)), None)
    if entry_place is None:
        if not candidates and not (kind.needed or role.node):
            return None
        if not candidates:
            text = f"{description.path} is of a profile that has no {kind.name} by itself"
            raise _Refused(Problem(kind.name, node, "", text, f"name its object in [role.{kind.name}]"))
        lack = _lacks(description, *candidates[0], kind.direction)
        if not (kind.needed or role.object or role.node):
            return None
        place = f"{candidates[0][0]:04X}h:{candidates[0][1]:X}"
        remedy = lack.remedy.replace(DEVICE, node) if not role.object else "name another one"
        raise _Refused(Problem(kind.name, node, place, lack.text, remedy))
    entry = checked_entry(description, *entry_place, kind.direction)
    scaled = _scaled(parts, Binding(kind, node, entry), role, bindings)
    if kind.unit and entry.bits > WIDEST:
        where = f"{description.path}:{description.variable(*entry_place).line}"
        text = f"{where}: {entry.index:04X}h:{entry.subindex:X} has {entry.bits} bits"
        raise _Refused(
            Problem(
                kind.name, node, f"{entry.index:04X}h:{entry.subindex:X}", text, f"take one of at most {WIDEST} bits"
            )
        )
    return scaled


def _named(text: str) -> Objects:
    if not text:
        return ()
    index, _, subindex = text.partition(":")
    return ((int(index, 16), int(subindex or "0", 16)),)


def _by_profile(kind: RoleKind, description: Description, node: Node, drive_axis: int) -> Objects:
    """Return a profile's objects for a role; for a drive, those of its axis."""
    profile = profile_of(description, node)
    if node in ("motor", "brake"):
        objects = MOTOR_OBJECTS if node == "motor" else BRAKE_OBJECTS[profile]
        places = objects.get(kind.name, ())
        return tuple((of_axis(index, drive_axis), sub) for index, sub in places) if profile == CIA402 else places
    return SENSED["handle_torque"] if kind.name in SENSED and profile == CIA404 else ()


class Lack(NamedTuple):
    """The reason why an object cannot be mapped; falsy if it can."""

    text: str = ""
    remedy: str = ""

    def __bool__(self) -> bool:
        return bool(self.text)


def _lacks(description: Description, index: int, subindex: int, direction: Direction) -> Lack:
    label = f"{index:04X}h:{subindex}"
    if not description.has(index, subindex):
        what = f"{description.path} describes no {label}, which the host maps"
        return Lack(what, "take a device that has it, or bind the role to another object")
    variable = description.variable(index, subindex)
    where = f"{description.path}:{variable.line}: {label}"
    entry = entry_of(variable)
    if not 1 <= entry.bits <= 64 or entry.kind != "int":
        return Lack(f"{where} has the data type 0x{variable.data_type:04X}", "expected an integer")
    refused = ("ro", "const", "rwr") if direction == "rpdo" else ("wo", "rww")
    if not variable.pdo_mappable or variable.access in refused:
        way = "an RPDO" if direction == "rpdo" else "a TPDO"
        remedy = "expected PDOMapping=1 and a matching AccessType"
        if variable.access not in refused:
            remedy += f', or host.accept = ["{mapping_sentence(DEVICE, index, subindex)}"] where the device maps it all the same'
        return Lack(f"{where} cannot be mapped into {way}", remedy)
    return Lack()


def checked_entry(description: Description, index: int, subindex: int, direction: Direction) -> Entry:
    """Return the entry that maps an object; raise ValueError with the lack in the EDS file."""
    lack = _lacks(description, index, subindex, direction)
    if lack:
        raise ValueError(f"{lack.text}; {lack.remedy}")
    return entry_of(description.variable(index, subindex))


# scales


def _scaled(parts: Parts, binding: Binding, role: Role, bindings: list[Binding]) -> Binding:
    """Return the binding with its scale at the handle, and the scale's source."""
    m, name = parts.mechanics, binding.kind.name
    turned = {
        "position": m.encoder_polarity,
        "velocity": m.encoder_polarity,
        "torque_setpoint": m.motor_polarity,
        "torque": m.motor_polarity,
        "handle_torque": m.transducer_polarity,
    }.get(name, 1)
    at_motor = {"torque_setpoint": m.ratio, "torque": m.ratio, "velocity": 1 / m.ratio}.get(name, 1.0)
    if not binding.kind.unit:
        return binding
    if isinstance(role, BrakeRole) and role.table:
        (raw_0, Nm_0), (raw_1, Nm_1) = role.table[-2:]
        step = (Nm_1 - Nm_0) / (raw_1 - raw_0)
        return _with(binding, step, 0.0, "role.brake_setpoint.table", role.table)
    key = f"scale_{binding.kind.unit.replace('/', '_')}"
    scale = getattr(role, key, None)
    offset = getattr(role, f"offset_{binding.kind.unit}", 0.0) * turned
    if scale is not None:
        return _with(binding, scale * at_motor * turned, offset, f"role.{name}.{key}")
    if name == "position":
        angle = m.encoder_polarity * 2 * math.pi / (parts.motor.encoder_counts_rev * m.ratio)
        return _with(binding, angle, 0.0, "motor.encoder_counts_rev and mechanics.ratio")
    if name in ("torque_setpoint", "torque") and binding.node == "motor" and _per_mille(binding):
        setpoint = next((other for other in bindings if other.kind.name == "torque_setpoint"), None)
        if setpoint is not None and _per_mille(setpoint) and setpoint.decided.startswith("role."):
            return _with(binding, setpoint.scale, 0.0, setpoint.decided)
        torque = parts.motor.rated_torque_Nm * 1e-3 * m.ratio * m.motor_polarity
        return _with(binding, torque, 0.0, "motor.rated_torque_Nm and mechanics.ratio")
    description = parts.description(binding.node)
    try:
        if name == "velocity":
            per_count, where = _velocity_unit(description, drive_axis_of(parts.part(binding.node)))
        else:
            per_count, where = _block_scale(description, binding.entry.index, binding.entry.subindex, binding.kind.unit)
    except ValueError as error:
        label = f"{binding.entry.index:04X}h:{binding.entry.subindex:X}"
        choice = " or table" if name == "brake_setpoint" else ""
        optional = "" if binding.kind.needed else ', or take the role out with object = "none"'
        remedy = f"give [role.{name}] its {key}{choice}{optional}"
        raise _Refused(Problem(name, binding.node, label, str(error), remedy)) from None
    return _with(binding, per_count * at_motor * turned, offset, where)


def _with(
    binding: Binding, scale: float, offset: float, decided: str, table: tuple[tuple[int, float], ...] = ()
) -> Binding:
    return Binding(binding.kind, binding.node, binding.entry, scale, offset, decided, table)


def _per_mille(binding: Binding) -> bool:
    """Return whether the profile has an object in per mille of a rated value."""
    return first_axis_object(binding.entry.index) in PER_MILLE


def _velocity_unit(description: Description, drive_axis: int) -> tuple[float, str]:
    """Return rad/s per count of 606Ch by 60A9h, and the place of that value."""
    try:
        return velocity_unit(defaults(description, drive_axis))
    except ValueError as error:
        unit = of_axis(VELOCITY_UNIT, drive_axis)
        line = f":{description.variable(unit, 0).line}" if description.has(unit, 0) else ""
        raise ValueError(f"{description.path}{line}: {error}") from None


def _block_scale(description: Description, index: int, subindex: int, unit: str) -> tuple[float, str]:
    """Return SI units per raw count of a CiA 404 block, 10^-decimals, with the prefix of its unit object; and its
    place.

    The unit's four bytes are, from the highest: prefix (power of ten, INTEGER8), numerator,
    denominator, reserved.
    """
    if index not in BLOCK_UNITS:
        raise ValueError(f"no object tells what a count of {index:04X}h:{subindex} is")
    unit_index, digits_index = BLOCK_UNITS[index]
    values = []
    for object_ in (unit_index, digits_index):
        place = f"{object_:04X}h:{subindex}"
        if not description.has(object_, subindex):
            raise ValueError(f"{description.path} describes no {place}, so that {index:04X}h:{subindex} has no scale")
        value = description.variable(object_, subindex).default
        line = description.variable(object_, subindex).line
        if not isinstance(value, int):
            raise ValueError(f"{description.path}:{line}: {place} has no default; expected a number")
        values.append((value, f"{description.path}:{line}: {place}"))
    (code, where), (digits, digits_where) = values
    prefix = (code >> 24 & 0xFF) - (0x100 if code >> 31 & 1 else 0)
    if (code >> 16 & 0xFF, code >> 8 & 0xFF) != (UNITS[unit], 0):
        wanted_code = UNITS[unit] << 16
        raise ValueError(
            f"{where} is 0x{code & 0xFFFFFFFF:08X}; expected 0x{wanted_code:08X} ({unit}), a prefix allowed"
        )
    if not 0 <= digits <= 9:
        raise ValueError(f"{digits_where} is {digits}; expected 0 to 9 decimal digits")
    return float(10.0 ** (prefix - digits)), f"{unit_index:04X}h and {digits_index:04X}h of the EDS file"
