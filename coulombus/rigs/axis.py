"""One axis of a rig: a motor and a brake on one handle, the host's model of them, and the law.

Code that works per axis takes an `Axis`; buses, host and name belong to the `rigs.rig.Rig`. An axis is deeply frozen.
`AxisParts` builds it from the rig file's values: sections, EDS files of its devices, their PDOs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ConfigDict, Field, ValidationError

from coulombus.eds.reader import Description, parse_eds
from coulombus.rigs.devices import Brake, DeviceSection, Motor, Roles, Sensor
from coulombus.rigs.errors import RigError, Source, shown
from coulombus.rigs.field_help import explain, misspelt_sections
from coulombus.rigs.files import read_descriptions, read_schedules
from coulombus.rigs.frozen_map import FrozenMap
from coulombus.rigs.model import About, Bus, Host, Law, Limits, Mechanics, Modes, Section, WorldSection
from coulombus.rigs.pdo_maps import AxisPdos, allocate
from coulombus.rigs.plant import Operator, Phase, Plant
from coulombus.rigs.rules import check, check_roles
from coulombus.rigs.signals import Node, RigPdo
from coulombus.rigs.text import apply_override
from coulombus.rigs.toml_lines import Key, read_toml

__all__ = ["NO_DEVICES", "Axis", "AxisParts", "Origin", "Sections", "Simulation"]


NO_DEVICES = frozenset(("plant", "operator", "phases"))
"""Sections that describe neither the devices nor their set-up by the host."""


class Sections(Section):
    """The sections of a rig file for one axis: its own values, else the shared ones."""

    rig: About = Field(description="what the rig is called")
    bus: Bus = Field(description="the CAN bus and the cycle")
    host: Host = Field(description="the host as a CANopen node")
    motor: Motor = Field(description="the motor drive")
    brake: Brake = Field(description="the MR brake's driver")
    sensor: FrozenMap[Sensor] = Field(
        default_factory=FrozenMap, description="further nodes that only tell, each with a name of its own"
    )
    role: Roles = Field(Roles.model_validate({}), description="which object of which device has which role")
    mechanics: Mechanics = Field(description="the device, by the controller's model")
    law: Law = Field(description="the friction law")
    mode: Modes = Field(description="the modes, each with its parameters")
    limits: Limits = Field(description="what trips, and the safe state")
    world: WorldSection | None = Field(None, description="another program may say what the hand meets")
    plant: Plant | None = Field(None, description="the rig as it truly is, for the simulation")
    operator: Operator | None = Field(None, description="the simulated hand")
    phases: tuple[Phase, ...] = Field(
        (),
        alias="phase",
        strict=False,
        description="the operator's schedule",
        json_schema_extra={"expected": "[[phase]] in double brackets, once for each phase"},
    )

    @property
    def devices(self) -> tuple[Node, ...]:
        """The names of all devices: the motor, the brake, the sensors."""
        return ("motor", "brake", *self.sensor)

    def part(self, node: Node) -> DeviceSection:
        """Return the section of a device."""
        return self.motor if node == "motor" else self.brake if node == "brake" else self.sensor[node]


@dataclass(frozen=True)
class Origin:
    """Origin of a rig's values.

    Attributes
    ----------
    path : the file, or the name given to `load_rig_text`
    text : the source text, without overrides
    overrides : as given; the last of a key counts
    attached : the text comes from a recording, which may be untrusted
    law_named : the caller who loaded the rig named its law
    law_folder : folder of the law's file, if the caller named it
    """

    path: str
    text: str
    overrides: tuple[str, ...] = ()
    attached: bool = False
    law_named: bool = False
    law_folder: Path | None = None

    def source(self, axis: str = "") -> Source:
        """Return the `Source` of an axis' values."""
        document = read_toml(self.text)
        source = Source(self.path, document)
        for override in self.overrides:
            apply_override(document.values, override, source)
        return source.of_axis(axis) if axis else source


class Simulation(NamedTuple):
    """Sections of an axis that only the simulation uses."""

    plant: Plant
    operator: Operator


class Axis(Sections):
    """One axis: its sections of the rig file, its EDS files, and its PDOs.

    Attributes
    ----------
    name : "" where the rig has one axis; else its signals are called NAME.motor.position_rad
    joint : whether it is a joint of the rig's [kinematics]
    descriptions : parsed EDS files of its `devices`, in their order
    origin : where the values come from
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    name: str = Field("", exclude=True)
    joint: bool = Field(False, exclude=True)
    descriptions: tuple[Description, ...] = Field(exclude=True)
    origin: Origin = Field(exclude=True)

    @classmethod
    def from_sections(
        cls,
        sections: Sections,
        name: str,
        descriptions: Mapping[Node, Description],
        origin: Origin,
        allocation: AxisPdos | None = None,
        *,
        joint: bool = False,
    ) -> Axis:
        """Return the axis of these sections and EDS files; `allocation`: theirs, if already computed."""
        values: dict[str, Any] = {key: getattr(sections, key) for key in Sections.model_fields}
        ordered = tuple(descriptions[node] for node in sections.devices)
        axis = cls(**values, name=name, joint=joint, descriptions=ordered, origin=origin)
        if allocation is not None:
            axis.__dict__["allocation"] = allocation
        return axis

    def from_origin(self, origin: Origin) -> Axis:
        """Return a copy with another origin."""
        descriptions = dict(zip(self.devices, self.descriptions, strict=True))
        return Axis.from_sections(self, self.name, descriptions, origin, self.allocation, joint=self.joint)

    def has_devices_of(self, sections: Sections, descriptions: Mapping[Node, Description]) -> bool:
        """Return whether sections and EDS files equal this axis' own, `NO_DEVICES` aside."""
        names = Sections.model_fields.keys() - NO_DEVICES
        return all(getattr(sections, name) == getattr(self, name) for name in names) and [
            descriptions[node].text for node in sections.devices
        ] == [description.text for description in self.descriptions]

    def without(self, *roles: str) -> Axis:
        """Return the axis as if the rig file removed these roles (object = "none")."""
        roles_set = self.role.model_dump(exclude_none=True) | {role: {"object": "none"} for role in roles}
        lean = self.model_copy(update={"role": Roles.model_validate(roles_set)})
        descriptions = dict(zip(self.devices, self.descriptions, strict=True))
        return Axis.from_sections(lean, self.name, descriptions, self.origin, joint=self.joint)

    @property
    def prefix(self) -> str:
        """Prefix of the axis' node and signal names: "" or "NAME."."""
        return f"{self.name}." if self.name else ""

    @property
    def simulation(self) -> Simulation:
        """Sections that only the simulation uses.

        Raises
        ------
        RigError
            the rig file is for a host alone: it has no [plant] and [operator]
        """
        if self.plant is None or self.operator is None:
            lacking = " and ".join(f"[{name}]" for name in ("plant", "operator") if getattr(self, name) is None)
            raise RigError(
                [f"{self.origin.path}: the rig {self.rig.name} has no {lacking}; a rig that is simulated needs both"]
            )
        return Simulation(self.plant, self.operator)

    @property
    def phase_starts_s(self) -> tuple[float, ...]:
        """Start of each phase of the schedule, and the end of the last [s]."""
        return tuple(accumulate((phase.duration_s for phase in self.phases), initial=0.0))

    def description(self, node: Node) -> Description:
        """Return the EDS file of a device."""
        return self.descriptions[self.devices.index(node)]

    def pdos(self) -> tuple[RigPdo, ...]:
        """Return the PDOs that the host uses, with their signals."""
        return self.allocation.pdos

    @cached_property
    def allocation(self) -> AxisPdos:
        """The roles of the axis and the PDOs that carry them."""
        return allocate(self, self.prefix)

    @property
    def law_of_recording(self) -> bool:
        """Whether only a recording names the law: it is run then only if it is built in."""
        return self.origin.attached and not self.origin.law_named

    @property
    def law_directory(self) -> Path:
        """Folder searched for a law's file before the current one: the rig file's, never a recording's."""
        return self.origin.law_folder or (Path() if self.origin.attached else Path(self.origin.path).parent)

    def spell_keys(self, text: str) -> str:
        """Return `text` with its rig-file keys as the user wrote them: ``axis.NAME.limits.travel_rad`` if this axis has
        its own.
        """
        return self.origin.source(self.name).spell_keys(text) if self.name else text

    def refusal(self, key: str, text: str) -> RigError:
        """Return an error with the place of `key`, for later checks; `text` has the cause."""
        return self._at(tuple(key.split(".")), self.origin.source(self.name).spell_keys(text))

    def _at(self, path: Key, text: str) -> RigError:
        source = self.origin.source(self.name)
        return RigError([f"{source.where(path)[1]}: {source.spelled(path)}: {text}"])

    def mistake(self, key: str, expected: str) -> RigError:
        """Return an error with the place of `key`, its value, and the `expected` value, for later checks.

        A law's parameter may be absent and have its default.
        """
        path: Key = tuple(key.split("."))
        source = self.origin.source(self.name)
        value: Any = self.model_dump(by_alias=True)
        for part in path:
            value = value.get(part, {}) if isinstance(value, dict) else value[part]
        got = "by default" if value == {} else f"got '{shown(value)}'"
        return self._at(path, f"{got}, expected {source.spell_keys(expected)}")

    def _identity(self) -> tuple[Any, ...]:
        values = tuple(getattr(self, key) for key in Sections.model_fields)
        return self.name, *(description.text for description in self.descriptions), *values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Axis) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def __reduce__(self) -> tuple[Any, ...]:
        texts = tuple((description.path, description.text) for description in self.descriptions)
        return _reload, (self.model_dump(by_alias=True), self.name, self.joint, texts, self.origin)


def _reload(
    values: dict[str, Any], name: str, joint: bool, eds_texts: tuple[tuple[str, str], ...], origin: Origin
) -> Axis:
    sections = Sections.model_validate(values)
    descriptions = (parse_eds(text.encode(), path) for path, text in eds_texts)
    return Axis.from_sections(
        sections, name, dict(zip(sections.devices, descriptions, strict=True)), origin, joint=joint
    )


class _Unnamed:
    """An axis under check: its sections and the EDS files of its devices (`rigs.signals.Parts`)."""

    def __init__(self, sections: Sections, descriptions: Mapping[Node, Description]) -> None:
        self._sections, self._descriptions = sections, descriptions

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sections, name)

    def description(self, node: Node) -> Description:
        """Return the EDS file of a device."""
        return self._descriptions[node]


@dataclass(frozen=True)
class AxisParts:
    """The parts of an axis; `sections` is None if they are refused."""

    sections: Sections | None
    descriptions: Mapping[Node, Description]
    allocation: AxisPdos | None = None

    @classmethod
    def from_values(
        cls,
        name: str,
        values: dict[str, Any],
        source: Source,
        eds_texts: Mapping[str, str] | None,
        *,
        attached: bool,
        earlier: Axis | None,
    ) -> AxisParts:
        """Validate the values of one axis; errors are noted in `source`."""
        read_schedules(values, source, attached=attached)
        misspelt_sections(values, Sections, source)
        sections: Sections | None = None
        try:
            sections = Sections.model_validate(values)
        except ValidationError as error:
            explain(error, values, Sections, source)
        check(values, source)
        descriptions = read_descriptions(values, source, eds_texts, f"{name}." if name else "")
        allocation = None
        if sections is not None and len(descriptions) == len(sections.devices):
            if earlier is not None and earlier.has_devices_of(sections, descriptions):
                allocation = earlier.allocation
            else:
                parts = _Unnamed(sections, descriptions)
                allocation = allocate(parts, f"{name}." if name else "")
                check_roles(allocation.problems, parts, values, source)
        if sections is None and not source.found:
            raise AssertionError("an axis that pydantic refuses has a mistake that is explained")
        return cls(sections, descriptions, allocation)

    def axis(self, name: str, origin: Origin, *, joint: bool) -> Axis:
        """Return the axis; call only if nothing was refused."""
        assert self.sections is not None
        return Axis.from_sections(self.sections, name, self.descriptions, origin, self.allocation, joint=joint)
