"""The PDOs that the host maps, always the same five, and what their raw numbers mean in SI units.

::

    motor  RPDO1  6040 controlword   6071 target torque                       from the host
           TPDO1  6041 statusword    6064 position       6077 torque          to the host
           TPDO2  606C velocity
    brake  RPDO1  7300:1 set-point
           TPDO1  7130:1 handle torque   7130:2 coil current   7130:3 coil temperature

A drive's torque counts in per mille of its rated torque and its position in encoder counts (CiA 402); ratio and
polarity, which turn them to the handle, are the rig file's. A CiA 404 block carries its unit (6131, 6301) and its
decimal digits (6132, 6302): the EDS gives the scale, and a unit that is not what the signal's name says is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from coulombus.eds.cia301 import CobId
from coulombus.eds.pdo import PDO_BITS, Entry, PdoLayout, entry_of
from coulombus.eds.reader import Description
from coulombus.rigs.model import Brake, Bus, Host, Mechanics, Motor

__all__ = [
    "PDO_MAP",
    "Node",
    "RigPdo",
    "Signal",
    "Switch",
    "axis_pdos",
    "deadman_mask",
    "deadman_object",
    "shortcomings",
]

Node: TypeAlias = Literal["motor", "brake"]
Direction = Literal["rpdo", "tpdo"]
UNITS = {"Nm": 0x56, "A": 0x04, "degC": 0x2D}
"""Notation indices of CiA 303-2: the numerator of a unit."""

COB_ID = {("rpdo", 1): CobId.RPDO1, ("tpdo", 1): CobId.TPDO1, ("tpdo", 2): CobId.TPDO2}
"""The predefined connection set, CiA 301 section 7.3.5, less the node id."""

PDO_MAP: tuple[tuple[Node, Direction, int, tuple[tuple[int, int, str], ...]], ...] = (
    ("motor", "rpdo", 1, ((0x6040, 0, "controlword"), (0x6071, 0, "target_torque_Nm"))),
    ("motor", "tpdo", 1, ((0x6041, 0, "statusword"), (0x6064, 0, "position_rad"), (0x6077, 0, "torque_Nm"))),
    ("motor", "tpdo", 2, ((0x606C, 0, "velocity_rad_s"),)),
    ("brake", "rpdo", 1, ((0x7300, 1, "setpoint_Nm"),)),
    (
        "brake",
        "tpdo",
        1,
        ((0x7130, 1, "handle_torque_Nm"), (0x7130, 2, "coil_current_A"), (0x7130, 3, "coil_temperature_degC")),
    ),
)
"""(node, direction, number, ((index, sub-index, signal's name without the node), ...))."""

DEADMAN_PDO: tuple[tuple[Node, int], ...] = (("motor", 2), ("brake", 1))
"""The TPDOs that have room for a dead man's switch, in the order in which the nodes are searched for it."""

ANY_BIT = 8
"""Up to so many bits an object may be a switch by itself. A wider one has other inputs beside it, such as limit switches in 60FDh."""


@dataclass(frozen=True)
class Signal:
    """One object in a PDO: SI value = raw x `scale` + `offset`, in `unit` ("" for a word of bits)."""

    name: str
    index: int
    subindex: int
    scale: float
    offset: float
    unit: str

    @property
    def key(self) -> str:
        """The name without its axis: "motor.position_rad"."""
        return ".".join(self.name.split(".")[-2:])

    def si(self, raw: float) -> float:
        """Return the SI value of a raw number."""
        return raw * self.scale + self.offset

    def raw(self, value: float) -> int:
        """Return the raw number nearest to an SI value."""
        return round((value - self.offset) / self.scale)


@dataclass(frozen=True)
class RigPdo:
    """One PDO that the host maps, with one signal for each entry of its layout.

    `node` is "motor" or "brake", with its axis before it ("x.motor") where the rig has several.
    """

    node: str
    node_id: int
    layout: PdoLayout
    signals: tuple[Signal, ...]

    @property
    def role(self) -> str:
        """What the node is: "motor" or "brake"."""
        return self.node.rpartition(".")[2]

    @property
    def name(self) -> str:
        """Which PDO of the node it is, as "TPDO1"."""
        return f"{self.layout.direction.upper()}{self.layout.number}"


class Parts(Protocol):
    """What the PDOs of an axis follow from (`rigs.axis.Axis`)."""

    bus: Bus
    motor: Motor
    brake: Brake
    host: Host
    mechanics: Mechanics

    @property
    def prefix(self) -> str:
        """What stands before the names of the axis' nodes and signals."""

    def description(self, node: Node) -> Description:
        """Return the EDS file of "motor" or "brake"."""


def axis_pdos(axis: Parts) -> tuple[RigPdo, ...]:
    """Return the PDOs of `axis`, whose EDS files have no `shortcomings`."""
    found = []
    switch = deadman_object(axis.host.deadman, {node: axis.description(node) for node, _ in DEADMAN_PDO})
    for node, direction, number, objects in PDO_MAP:
        if switch is not None and direction == "tpdo" and (node, number) == (switch.node, switch.number):
            objects = (*objects, (switch.index, switch.subindex, "deadman"))
        part = axis.motor if node == "motor" else axis.brake
        description = axis.description(node)
        deadline_ns = round(part.setpoint_fault_s * 1e9) if direction == "rpdo" else 0
        layout = PdoLayout(
            number=number,
            direction=direction,
            cob_id=COB_ID[direction, number] + part.node_id,
            transmission=axis.bus.transmission if direction == "rpdo" else 1,
            inhibit_ns=0,
            event_ns=deadline_ns,
            sync_start=0,
            rtr_allowed=False,
            entries=tuple(_entry(description, index, subindex, direction) for index, subindex, _ in objects),
        )
        signals = tuple(_signal(axis, node, index, subindex, name) for index, subindex, name in objects)
        found.append(RigPdo(axis.prefix + node, part.node_id, layout, signals))
    return tuple(found)


@dataclass(frozen=True)
class Switch:
    """A dead man's switch that is an object: the node that has it, the number of the TPDO that it is mapped into, its bits.

    It is held while all bits of `mask` are 1; 0: while any bit is.
    """

    node: Node
    number: int
    index: int
    subindex: int
    mask: int


def deadman_mask(deadman: str) -> int:
    """Return the mask of ``host.deadman``; 0 where it names none."""
    parts = deadman.split(":")
    return int(parts[3], 16) if len(parts) == 4 else 0


def deadman_object(deadman: str, descriptions: Mapping[Node, Description]) -> Switch | None:
    """Return the dead man's switch that ``host.deadman`` names; None when it is no object.

    Raises
    ------
    ValueError
        no node has the object, it cannot be mapped, or its mask is missing, 0 or wider than the object
    """
    if not deadman.startswith("object:"):
        return None
    index, subindex = (int(part, 16) for part in deadman.split(":")[1:3])
    for node, number in DEADMAN_PDO:
        description = descriptions[node]
        if not description.has(index, subindex):
            continue
        entry = _entry(description, index, subindex, "tpdo")
        mapped = next(o for owner, way, n, o in PDO_MAP if (owner, way, n) == (node, "tpdo", number))
        bits = sum(_entry(description, i, sub, "tpdo").bits for i, sub, _ in mapped)
        if any((index, subindex) == (i, sub) for owner, _, _, o in PDO_MAP if owner == node for i, sub, _ in o):
            raise ValueError(f"{index:04X}h:{subindex} of the {node} is mapped already; it is no switch")
        if bits + entry.bits > PDO_BITS:
            raise ValueError(f"{index:04X}h:{subindex} of the {node} has {entry.bits} bits; {PDO_BITS - bits} are left")
        return Switch(node, number, index, subindex, _checked_mask(deadman, node, entry))
    raise ValueError(f"no EDS file describes {index:04X}h:{subindex}")


def _checked_mask(deadman: str, node: Node, entry: Entry) -> int:
    """Return the mask of the switch; ValueError says what is wrong with it."""
    what = f"{entry.index:04X}h:{entry.subindex} of the {node}"
    mask = deadman_mask(deadman)
    if deadman.count(":") < 3:
        if entry.bits > ANY_BIT:
            example = f'"{deadman}:0x{1 << entry.bits // 2:0{entry.bits // 4}X}"'
            raise ValueError(
                f"{what} has {entry.bits} bits, and any of them would hold the switch: name the switch's own by a mask, as in {example}"
            )
    elif mask == 0:
        raise ValueError(f"the mask is 0, and a switch has at least one bit of {what}")
    elif mask >> entry.bits:
        raise ValueError(f"the mask 0x{mask:X} is wider than {what}, which has {entry.bits} bits")
    return mask


def shortcomings(description: Description, node: str) -> Iterator[str]:
    """Yield what an EDS file lacks for the PDOs of `node`, each with file:line."""
    for owner, direction, number, objects in PDO_MAP:
        bits = {}
        for index, subindex, name in objects if owner == node else ():
            try:
                bits[index, subindex] = _entry(description, index, subindex, direction).bits
                if node == "brake":
                    _block_scale(description, index, subindex, _unit(name))
            except ValueError as error:
                yield str(error)
        if sum(bits.values()) > PDO_BITS:
            wide = " and ".join(f"{index:04X}h:{subindex} in {width} bits" for (index, subindex), width in bits.items())
            yield (
                f"{description.path} describes {wide}, which the host maps into {direction.upper()}{number}; "
                f"at most {PDO_BITS} bits fit, take a device with narrower ones"
            )


def _unit(name: str) -> str:
    """Return the unit in a signal's name, as the name spells it; "" where it has none."""
    return next((unit for unit in ("rad_s", "rad", "Nm", "A", "degC") if name.endswith(f"_{unit}")), "")


def _entry(description: Description, index: int, subindex: int, direction: Direction) -> Entry:
    """Return the entry that maps an object; ValueError says what the EDS file lacks."""
    if not description.has(index, subindex):
        raise ValueError(
            f"{description.path} describes no {index:04X}h:{subindex}, which the host maps; take a device that has it"
        )
    variable = description.variable(index, subindex)
    where = f"{description.path}:{variable.line}: {index:04X}h:{subindex}"
    entry = entry_of(variable)
    if not 1 <= entry.bits <= 64 or entry.kind != "int":
        raise ValueError(f"{where} has the data type 0x{variable.data_type:04X}; expected an integer")
    refused = ("ro", "const", "rwr") if direction == "rpdo" else ("wo", "rww")
    if not variable.pdo_mappable or variable.access in refused:
        way = "an RPDO" if direction == "rpdo" else "a TPDO"
        raise ValueError(f"{where} cannot be mapped into {way}; expected PDOMapping=1 and a matching AccessType")
    return entry


def _signal(axis: Parts, node: Node, index: int, subindex: int, name: str) -> Signal:
    unit = _unit(name)
    scale = 1.0
    if node == "motor" and unit:
        torque = axis.motor.rated_torque_Nm * 1e-3 * axis.mechanics.ratio * axis.mechanics.motor_polarity
        angle = axis.mechanics.encoder_polarity * 2 * math.pi / (axis.motor.encoder_counts_rev * axis.mechanics.ratio)
        scale = torque if unit == "Nm" else angle
    elif node == "brake" and unit:
        scale = _block_scale(axis.description(node), index, subindex, unit)
        if name == "handle_torque_Nm":
            scale *= axis.mechanics.transducer_polarity
    return Signal(f"{axis.prefix}{node}.{name}", index, subindex, scale, 0.0, unit.replace("rad_s", "rad/s"))


def _block_scale(description: Description, index: int, subindex: int, unit: str) -> float:
    """Return SI units per raw count of a CiA 404 block: 10^-decimals, with the prefix of its unit object.

    The unit's four bytes are, from the highest: prefix (power of ten, INTEGER8), numerator, denominator, reserved.
    """
    unit_index, digits_index = (0x6131, 0x6132) if index == 0x7130 else (0x6301, 0x6302)
    values = []
    for wanted in (unit_index, digits_index):
        place = f"{wanted:04X}h:{subindex}"
        if not description.has(wanted, subindex):
            raise ValueError(f"{description.path} describes no {place}, so that {index:04X}h:{subindex} has no scale")
        value = description.variable(wanted, subindex).default
        line = description.variable(wanted, subindex).line
        if not isinstance(value, int):
            raise ValueError(f"{description.path}:{line}: {place} has no default; expected a number")
        values.append((value, f"{description.path}:{line}: {place}"))
    (code, where), (digits, digits_where) = values
    prefix = (code >> 24 & 0xFF) - (0x100 if code >> 31 & 1 else 0)
    if (code >> 16 & 0xFF, code >> 8 & 0xFF) != (UNITS[unit], 0):
        wanted_code = UNITS[unit] << 16
        raise ValueError(f"{where} is 0x{code:08X}; expected 0x{wanted_code:08X} ({unit}), a prefix allowed")
    if not 0 <= digits <= 9:
        raise ValueError(f"{digits_where} is {digits}; expected 0 to 9 decimal digits")
    return float(10.0 ** (prefix - digits))
