"""The PDOs that the host uses, and the SI values of their raw numbers.

For the project's own devices::

    motor  RPDO1  6040 controlword   6071 target torque                       from the host
           TPDO1  6041 statusword    6064 position       6077 torque          to the host
    brake  RPDO1  7300:1 set-point
           TPDO1  7130:1 handle torque   7130:2 coil current   7130:3 coil temperature

`rigs.roles` assigns objects to roles, `rigs.pdo_maps` assigns them to PDOs. A signal is named by its role, on whichever
device: "brake.handle_torque_Nm" is also the handle torque of a transducer's own node.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from coulombus.eds.pdo import Entry, PdoLayout
from coulombus.eds.reader import Description
from coulombus.rigs.devices import Brake, DeviceSection, Motor, Roles, Sensor
from coulombus.rigs.frozen_map import FrozenMap
from coulombus.rigs.model import Bus, Host, Limits, Mechanics

__all__ = ["ConstantEntry", "Direction", "Node", "Parts", "RigPdo", "Signal"]

Node: TypeAlias = str
"""A device of an axis: "motor", "brake", or a sensor's name."""
Direction = Literal["rpdo", "tpdo"]


@dataclass(frozen=True)
class Signal:
    """One object in a PDO: SI value = raw x `scale` + `offset`, in `unit` ("" for a word of
    bits).
    """

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

    @property
    def identifier(self) -> str:
        """The last part of the name as an identifier for any tool; an object without a role, "6060h:0", is
        "object_6060h_0".
        """
        word = re.sub(r"\W", "_", self.name.rpartition(".")[2])
        return f"object_{word}" if word[:1].isdigit() else word

    @property
    def plain_name(self) -> str:
        """The name as words, without its unit: "motor.position" of "motor.position_rad"."""
        unit = "_" + self.unit.replace("/", "_").replace(" ", "_")
        head, dot, _ = self.name.rpartition(".")
        return head + dot + (self.identifier.removesuffix(unit) if self.unit else self.identifier)

    def si(self, raw: float) -> float:
        """Return the SI value of a raw number."""
        return raw * self.scale + self.offset

    def raw(self, value: float) -> int:
        """Return the raw number nearest to an SI value."""
        return round((value - self.offset) / self.scale)


@dataclass(frozen=True)
class ConstantEntry:
    """An entry of an RPDO that the host does not command: it is always sent with the same value."""

    index: int
    subindex: int
    value: int


@dataclass(frozen=True)
class RigPdo:
    """One PDO that the host uses, with one signal for each entry of its layout.

    Attributes
    ----------
    node : the device, with its axis as prefix ("x.motor") if the rig has several
    fixed : bring-up cannot change its map
    constants : of an RPDO, the entries that the host does not command
    """

    node: str
    node_id: int
    layout: PdoLayout
    signals: tuple[Signal, ...]
    fixed: bool = False
    constants: tuple[ConstantEntry, ...] = ()

    @property
    def device(self) -> str:
        """Its device within the axis: "motor", "brake" or a sensor's name."""
        return self.node.rpartition(".")[2]

    @property
    def name(self) -> str:
        """Its name within the node, as "TPDO1"."""
        return f"{self.layout.direction.upper()}{self.layout.number}"

    def fields(self) -> Iterator[tuple[Signal, Entry, int]]:
        """Yield signal, entry and first bit of its content, without gaps."""
        for signal, entry, start in zip(self.signals, self.layout.entries, self.layout.starts, strict=True):
            if not entry.dummy:
                yield signal, entry, start

    def value(self, place: int, word: int) -> float:
        """Return the value of the signal at `place` in a frame's data word: in SI, of a word of bits raw."""
        signal, raw = self.signals[place], self.layout.entries[place].number(word, self.layout.starts[place])
        return raw if not signal.unit and signal.scale == 1 else signal.si(raw)

    @property
    def every_cycle(self) -> bool:
        """Whether the device sends it after each SYNC.

        Otherwise the device's timer or a change triggers it.
        """
        return self.layout.transmission == 1


class Parts(Protocol):
    """The parts of an axis that determine its roles and PDOs (`rigs.axis.Axis`)."""

    @property
    def bus(self) -> Bus:
        """The axis' bus."""

    @property
    def host(self) -> Host:
        """The host."""

    @property
    def motor(self) -> Motor:
        """The drive."""

    @property
    def brake(self) -> Brake:
        """The brake's driver."""

    @property
    def sensor(self) -> FrozenMap[Sensor]:
        """Further nodes, by name."""

    @property
    def role(self) -> Roles:
        """The rig file's [role]."""

    @property
    def mechanics(self) -> Mechanics:
        """Ratio and signs."""

    @property
    def limits(self) -> Limits:
        """Trip limits."""

    @property
    def devices(self) -> tuple[Node, ...]:
        """The names of all devices."""

    def part(self, node: Node) -> DeviceSection:
        """Return the section of a device."""

    def description(self, node: Node) -> Description:
        """Return the EDS file of a device."""
