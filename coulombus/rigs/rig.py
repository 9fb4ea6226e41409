"""The rig file: one TOML file for the devices on the bus, the controller's model, and the simulated rig.

``load_rig("bench")`` finds a rig of the package, ``load_rig("lab/handle.toml")`` a file. The result
is frozen and complete; `docs/rig-file.md` explains every key. A rig has buses, a host, and one or
more axes (`rigs.axis`): a motor and a brake each. All errors of a file are reported together, each with ``file:line``,
the key, its value, the expected value and the nearest known key.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from coulombus.eds.reader import Description
from coulombus.rigs.arguments import WrongCall, path_text, texts
from coulombus.rigs.axes import check_axes, split_axes
from coulombus.rigs.axis import Axis, AxisParts, Origin
from coulombus.rigs.device_services import emcy_identifier
from coulombus.rigs.devices import DeviceSection
from coulombus.rigs.errors import RigError, Source
from coulombus.rigs.kinematics.kinematics_rules import PLANE_SECTIONS, PlaneSections, check_phases, read_plane
from coulombus.rigs.kinematics.kinematics_section import Kinematics
from coulombus.rigs.model import About, Bus, Host
from coulombus.rigs.rig_file import known_rigs, named_rig, packaged_rig, read_rig_file
from coulombus.rigs.rules import remarks
from coulombus.rigs.signals import Node, RigPdo
from coulombus.rigs.text import apply_override, emit
from coulombus.rigs.toml_lines import Table, of_another_kind, read_toml

__all__ = ["Rig", "RigError", "RigNode", "known_rigs", "load_rig", "load_rig_text", "packaged_rig"]

JOINT_LAW = "karnopp"
"""Law of a joint of [kinematics] that is used alone; its parameters are in [mode.NAME]."""


@dataclass(frozen=True)
class RigNode:
    """One device of a rig: "motor", "brake" or a sensor's name, with its axis as prefix ("x.motor") if there are
    several.
    """

    name: str
    device: Node
    part: DeviceSection
    description: Description
    channel: str = ""
    """The name of its bus."""

    @property
    def node_id(self) -> int:
        """Its node id."""
        return self.part.node_id

    @property
    def emcy_id(self) -> int:
        """Identifier of its EMCYs."""
        return emcy_identifier(self.description, self.node_id)


@dataclass(frozen=True, eq=False, repr=False)
class Rig:
    """A rig: the parts shared by all axes, and the axes.

    Frozen, with the EDS files that the rig file names.

    Devices, mechanics, law, modes, limits and schedule belong to one of `axes`, or to `one_axis()`.

    Attributes
    ----------
    axes : tuple of Axis
        At least one. Their host is the same, and so is their cycle: period, actuation, window, law,
        names of the modes (`rigs.axes.SHARED`).
    origin : Origin
        Origin of the values.
    warnings : tuple of str
        Legal but unlikely values, with ``file:line``.
    in_plane : PlaneSections or None
        Kinematics and plant of the axes as joints of one tip in a plane; None if they are independent.
    """

    axes: tuple[Axis, ...]
    origin: Origin
    warnings: tuple[str, ...] = ()
    in_plane: PlaneSections | None = None
    _spelled: str = ""
    """The values of a rig with named axes, as TOML; shared values occur once."""

    def __repr__(self) -> str:
        return f"<rig {self.name} of {self.path}>"

    @property
    def about(self) -> About:
        """The rig's name and title."""
        return self.axes[0].rig

    @property
    def name(self) -> str:
        """The rig's short name."""
        return self.about.name

    @property
    def host(self) -> Host:
        """The host, which drives all axes."""
        return self.axes[0].host

    @property
    def modes(self) -> tuple[str, ...]:
        """The names of the modes, which all axes have; their parameters are an axis' own."""
        return tuple(self.axes[0].mode)

    @property
    def law_function(self) -> str:
        """The compiled law's name, one for all axes; its parameters are an axis' own."""
        return self.axes[0].law.function

    @property
    def buses(self) -> tuple[Bus, ...]:
        """The buses of the axes, in the file's order."""
        return tuple({axis.bus.channel: axis.bus for axis in reversed(self.axes)}[name] for name in self.channels)

    @property
    def bus(self) -> Bus:
        """The bus of a rig that one host serves (`one_cycle`): the first one, where there are several; their
        cycle is the same.

        Raises
        ------
        TypeError
            each of the rig's buses has a host: use one of `buses`, or the rig's part on one of them (`on`)
        """
        if not self.one_cycle:
            raise TypeError(f"the rig {self.name} has the buses {', '.join(self.channels)}; take it on one with Rig.on")
        return self.axes[0].bus

    @property
    def one_cycle(self) -> bool:
        """Whether one host serves the whole rig in one cycle: it has one bus, or its axes are the joints of one arm."""
        return len(self.channels) == 1 or self.in_plane is not None

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the axes' buses, in the file's order; ("",) for one unnamed bus."""
        return tuple(dict.fromkeys(axis.bus.channel for axis in self.axes))

    @property
    def schedule_s(self) -> float:
        """The length of the operator's schedule; of several axes', the longest [s].

        0.0 if there is none.
        """
        return max(axis.phase_starts_s[-1] for axis in self.axes)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The axes' names; empty if the rig file names no axis."""
        return tuple(axis.name for axis in self.axes if axis.name)

    def one_axis(self, name: str | None = None) -> Axis:
        """Return the axis `name`; without a name, the only axis of a rig whose file names none.

        Raises
        ------
        RigError
            the rig has named axes and none was given, or it has no such axis
        """
        names = self.axis_names
        if name is None:
            if names:
                raise RigError(
                    [f"the rig {self.name} has the axes {', '.join(names)}; this is about one axis at a time"]
                )
            return self.axes[0]
        if name not in names:
            has = f"the axes {', '.join(names)}" if names else "one axis, without a name"
            raise RigError([f"--axis {name}: the rig {self.name} has {has}"])
        return self.axes[names.index(name)]

    def alone(self, name: str | None = None) -> Rig:
        """Return the axis `name` as a separate rig, without the axis in node and signal names.

        A joint alone has no tip: its law is `JOINT_LAW`, and its hand rests.

        Raises
        ------
        RigError
            see `one_axis`
        """
        axis = self.one_axis(name)
        if not axis.name:
            return self
        texts = {axis.part(node).eds: axis.description(node).text for node in axis.devices}
        text = _alone(axis) if axis.joint else _emitted(axis)
        return self._as_said(load_rig_text(text, self.path, texts, attached=self.origin.attached))

    def _as_said(self, rig: Rig) -> Rig:
        """Copy the provenance of the law (`law_named`, `law_folder`) onto `rig`."""
        law_named = self.origin.law_named or rig.origin.law_named
        return _from(rig, replace(rig.origin, law_named=law_named, law_folder=self.origin.law_folder))

    def on(self, channel: str) -> Rig:
        """Return the rig's part on the bus `channel`: only its axes."""
        if self.channels == (channel,):
            return self
        axes = tuple(axis for axis in self.axes if axis.bus.channel == channel)
        if not axes:
            raise KeyError(f"the rig has no bus '{channel}'; it has {', '.join(self.channels)}")
        values = read_toml(self._spelled).values
        values["axis"] = {axis.name: values["axis"][axis.name] for axis in axes}
        values = {name: section for name, section in values.items() if name not in PLANE_SECTIONS}
        return replace(self, axes=axes, in_plane=None, _spelled=_spelled(self.name, values))

    @property
    def kinematics(self) -> Kinematics | None:
        """Kinematics of the axes in a plane; None if they are independent."""
        return None if self.in_plane is None else self.in_plane.kinematics

    @property
    def path(self) -> str:
        """The rig's file."""
        return self.origin.path

    @property
    def text(self) -> str:
        """The source text, without overrides."""
        return self.origin.text

    @property
    def overrides(self) -> tuple[str, ...]:
        """The overrides, as they were given."""
        return self.origin.overrides

    @property
    def law_of_recording(self) -> bool:
        """Whether only a recording names the law: it is run then only if it is built in."""
        return self.axes[0].law_of_recording

    @property
    def law_directory(self) -> Path:
        """Folder searched for a law's file before the current one: the rig file's, never a recording's."""
        return self.axes[0].law_directory

    @property
    def eds_texts(self) -> Mapping[str, str]:
        """The EDS files' texts by their names in the rig file; a recording attaches them."""
        return {node.part.eds: node.description.text for node in self.nodes}

    @property
    def nodes(self) -> tuple[RigNode, ...]:
        """The devices of all axes: motor, brake and sensors of the first, of the second ..."""
        return tuple(
            RigNode(axis.prefix + node, node, axis.part(node), axis.description(node), axis.bus.channel)
            for axis in self.axes
            for node in axis.devices
        )

    def pdos(self) -> tuple[RigPdo, ...]:
        """Return the PDOs of all axes that the host uses, with their signals."""
        return tuple(pdo for axis in self.axes for pdo in axis.pdos())

    def effective(self) -> str:
        """Return the configuration after overrides as TOML text; loading it gives an equal rig."""
        return self._effective

    @cached_property
    def _effective(self) -> str:
        return self._spelled or _emitted(self.axes[0])

    def variant(self, *overrides: str) -> Rig:
        """Return the rig with further overrides, as ``--set`` takes them."""
        not_text = next((override for override in overrides if not isinstance(override, str)), None)
        if not_text is not None:
            raise WrongCall(f"{not_text!r} is not an override: expected texts, as in variant('mode.active.F_s_Nm=1.0')")
        if not overrides:
            return self
        attached = self.origin.attached
        changed = _load(self.effective(), self.path, self.eds_texts, overrides, [], attached, self.axes)
        both = (*self.overrides, *overrides)  # on the original text: `Axis.mistake` needs each value's origin
        return self._as_said(_from(changed, replace(changed.origin, text=self.text, overrides=both)))

    def with_law(self, name: str) -> Rig:
        """Return the rig with another law, for all its axes."""
        if name.endswith(".py"):
            raise RigError([f"--law {name}: name the function: {name}:NAME"])
        axis_values = read_toml(self._spelled).values["axis"] if self._spelled else {}
        named = [axis for axis, values in axis_values.items() if "function" in values.get("law", ())]
        return self.variant(f'law.function="{name}"', *(f'axis.{axis}.law.function="{name}"' for axis in named))

    def with_law_in(self, folder: Path) -> Rig:
        """Return the rig of a recording whose law's file the caller names: it is in `folder`."""
        return _from(self, replace(self.origin, law_named=True, law_folder=folder))

    def with_world(self) -> Rig:
        """Return the rig with [world]; unchanged if all its axes have it."""
        return self if all(axis.world is not None for axis in self.axes) else self.variant('world.rest="law"')

    def _identity(self) -> tuple[str, tuple[tuple[str, str], ...]]:
        return self.effective(), tuple(sorted(self.eds_texts.items()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rig) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def __copy__(self) -> Rig:
        return self  # frozen

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Rig:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _reload, (self.effective(), dict(self.eds_texts), self.origin)


def _from(rig: Rig, origin: Origin) -> Rig:
    """Return `rig` with another origin."""
    return replace(rig, axes=tuple(axis.from_origin(origin) for axis in rig.axes), origin=origin)


def _spelled(name: str, values: Table) -> str:
    return emit(values, f"The rig {name} as it was used, overrides included.")


def _emitted(axis: Axis) -> str:
    return _spelled(axis.rig.name, axis.model_dump(by_alias=True))


def _alone(joint: Axis) -> str:
    values = joint.model_dump(by_alias=True)
    values["law"] = {key: value for key, value in values["law"].items() if not isinstance(value, dict)}
    values["law"]["function"] = JOINT_LAW
    values["phase"] = [{"kind": "rest", "duration_s": phase.duration_s} for phase in joint.phases]
    return _spelled(joint.rig.name, values)


def _reload(text: str, eds_texts: Mapping[str, str], origin: Origin) -> Rig:
    rig = load_rig_text(text, origin.path, eds_texts, attached=origin.attached)
    return _from(rig, replace(rig.origin, law_named=origin.law_named, law_folder=origin.law_folder))


def load_rig(name_or_path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Rig:
    """Load a rig by its name in the package, or from a file (a path has a separator or ends in
    .toml).

    Parameters
    ----------
    name_or_path : str, os.PathLike
        "bench", "paper", or a path.
    overrides : sequence of str
        "SECTION.KEY=VALUE", a TOML value: "mode.active.F_s_Nm=1.0", "phase.1.duration_s=2" (phases
        count from 0).

    Raises
    ------
    RigError
        With every mistake that was found.
    coulombus.rigs.arguments.WrongCall
        `name_or_path` is neither a name nor a path, or `overrides` no list of texts.
    """
    if isinstance(name_or_path, Rig):
        raise WrongCall(f"load_rig() is given the rig {name_or_path.name}, which is loaded already: use it as it is")
    name = path_text(name_or_path, "the rig", 'load_rig("bench")')
    overrides, path = texts(overrides, "overrides", "mode.active.F_s_Nm=1.0"), Path(name)
    if isinstance(name_or_path, str) and not ("/" in name or name.endswith(".toml")):
        path = named_rig(name)
    text, broken = read_rig_file(path)
    return _load(text, str(path), None, overrides, broken)


def load_rig_text(
    text: str,
    name: str,
    eds_texts: Mapping[str, str] | None = None,
    overrides: Sequence[str] = (),
    *,
    attached: bool = False,
) -> Rig:
    """Load a rig from its text; `name` is the file's name in errors, and gives the folder for relative paths.

    With `eds_texts` (by their names in the rig file) no EDS file is read. With `attached` the text comes from a
    recording, which may be untrusted: no file is read at all, and its law is run only if it is built in or named by an
    override.

    Raises
    ------
    RigError
        With every mistake that was found.
    """
    return _load(text, name, {} if attached and eds_texts is None else eds_texts, overrides, [], attached)


def _load(
    text: str,
    path: str,
    eds_texts: Mapping[str, str] | None,
    overrides: Sequence[str],
    broken: Sequence[tuple[float, str]],
    attached: bool = False,
    earlier: Sequence[Axis] = (),
) -> Rig:
    """Load a rig (see `load_rig_text`), reusing results of `earlier` axes that have the same devices."""
    document = read_toml(text)
    source = Source(path, document, found=list(broken))
    source.found += [(line, f"{path}:{line}: {problem}") for line, problem in document.problems]
    values = document.values
    if not attached and (other := of_another_kind(values, "rig")):
        raise RigError([f"{path}: {other}"])
    axes_of_file = set(values["axis"]) if isinstance(values.get("axis"), dict) else set()
    for override in overrides:
        apply_override(values, override, source)
    for name in set(values.get("axis", ())) - axes_of_file:
        axis_names = ", ".join(sorted(axes_of_file)) or "none: the file has no [axis.NAME]"
        source.say(("axis", name), f"there is no such axis; the rig's axes are {axis_names}")
        if axes_of_file:
            del values["axis"][name]
    separate = {name: section for name, section in values.items() if name not in PLANE_SECTIONS}
    named = split_axes(separate, source)
    own_values = {"": separate} if named is None else named
    sources = {"": source} if named is None else {name: source.of_axis(name) for name in named}
    before = {axis.name: axis for axis in earlier}
    parts = [
        AxisParts.from_values(name, axis_values, sources[name], eds_texts, attached=attached, earlier=before.get(name))
        for name, axis_values in own_values.items()
    ]
    if named is not None:
        check_axes(named, sources, one_cycle="kinematics" in values)
        for part_source in sources.values():
            source.found += part_source.found
            source.lacking += part_source.lacking
            source.problems += part_source.problems
    in_plane = read_plane(values, tuple(named or ()), source, attached=attached)
    check_phases(values, source, in_plane="kinematics" in values)
    source.raise_all()
    law_named = any(override.partition("=")[0].strip().endswith("law.function") for override in overrides)
    origin = Origin(path, text, tuple(overrides), attached, law_named)
    joint = in_plane is not None
    axes = tuple(part.axis(name, origin, joint=joint) for name, part in zip(own_values, parts, strict=True))
    warnings = [text for name, axis_values in own_values.items() for text in remarks(axis_values, sources[name])]
    spelled = "" if named is None else _spelled(axes[0].rig.name, values)
    return Rig(axes, origin, tuple(dict.fromkeys(warnings)), in_plane, spelled)
