"""The rig file: one TOML file says what hangs on the bus, what the controller believes, and what the simulation knows.

``load_rig("bench")`` finds a rig of the package, ``load_rig("lab/handle.toml")`` a file. The result is frozen and
complete; `docs/rig-file.md` explains every key. A rig of several axes is a rig for each of them (`Rig.axes`). Every
mistake of a file is reported at once, each with ``file:line``, the key, what stands there, what is expected and the
nearest known key.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr, ValidationError

from coulombus.eds.reader import Description
from coulombus.eds.regular_file import read_regular
from coulombus.rigs.axes import check_axes, split_axes
from coulombus.rigs.files import read_descriptions, read_schedules
from coulombus.rigs.mistakes import RigError, Source, dotted, nearest, shown
from coulombus.rigs.model import About, Brake, Bus, Host, Law, Limits, Mechanics, Modes, Motor, Section
from coulombus.rigs.plant import Operator, Phase, Plant
from coulombus.rigs.rules import check, remarks
from coulombus.rigs.signals import RigPdo, rig_pdos
from coulombus.rigs.text import apply_override, emit
from coulombus.rigs.toml_lines import MOST_CHARACTERS, Key, read_toml
from coulombus.rigs.words import explain

__all__ = ["Rig", "RigError", "RigNode", "known_rigs", "load_rig", "load_rig_text", "packaged_rig"]

HYBRID_MARGIN = 1.2


class RigFile(Section):
    """The sections of a rig file."""

    rig: About = Field(description="what the rig is called")
    bus: Bus = Field(description="the CAN bus and the cycle")
    host: Host = Field(description="the host as a CANopen node")
    motor: Motor = Field(description="the motor drive")
    brake: Brake = Field(description="the MR brake's driver")
    mechanics: Mechanics = Field(description="the device, as the controller believes it to be")
    law: Law = Field(description="the friction law")
    mode: Modes = Field(description="the modes, each with its parameters")
    limits: Limits = Field(description="what trips, and the safe state")
    plant: Plant = Field(description="the rig as it truly is, for the simulation")
    operator: Operator = Field(description="the simulated hand")
    phases: tuple[Phase, ...] = Field(
        (),
        alias="phase",
        strict=False,
        description="the operator's schedule",
        json_schema_extra={"expected": "[[phase]] in double brackets, once for each phase"},
    )


@dataclass(frozen=True)
class RigNode:
    """One device of a rig: "motor" or "brake", with its axis before the name ("x.motor") where there are several."""

    name: str
    role: Literal["motor", "brake"]
    part: Motor | Brake
    description: Description

    @property
    def node_id(self) -> int:
        """Its node id."""
        return self.part.node_id


class Rig(RigFile):
    """A rig: the file's sections, frozen, with the EDS files that it names.

    Attributes
    ----------
    path : str
        The file, or the name given to `load_rig_text`.
    text : str
        The source text, without overrides; `effective()` has them.
    overrides : tuple of str
        The overrides, as they were given.
    warnings : tuple of str
        What is allowed, and yet may not be meant, with ``file:line``.
    """

    _path: str = PrivateAttr("")
    _text: str = PrivateAttr("")
    _overrides: tuple[str, ...] = PrivateAttr(())
    _warnings: tuple[str, ...] = PrivateAttr(())
    _descriptions: dict[str, Description] = PrivateAttr(default_factory=dict)
    _pdos: tuple[RigPdo, ...] = PrivateAttr(())
    _axis: str = PrivateAttr("")
    _axes: tuple[Rig, ...] = PrivateAttr(())
    _values: dict[str, Any] | None = PrivateAttr(None)
    _attached: bool = PrivateAttr(False)
    _law_named: bool = PrivateAttr(False)

    @property
    def law_of_recording(self) -> bool:
        """Whether nobody but a recording names the law: then it is run only if it is one of the project's own."""
        return self._attached and not self._law_named

    @property
    def law_directory(self) -> Path:
        """Where the file of a law is looked for before the current folder: beside the rig file, never beside a recording."""
        return Path() if self._attached else Path(self._path).parent

    @property
    def axes(self) -> tuple[Rig, ...]:
        """The axes, each a rig of one motor and one brake; a rig of one axis is its own.

        The sections of a rig of several axes, where it is taken for one, are those of its first axis. So only what all axes share
        (`rigs.axes.SHARED`) may be asked of it.
        """
        return self._axes or (self,)

    @property
    def axis(self) -> str:
        """The axis' name, "" where the rig has only one; its signals are then called NAME.motor.position_rad."""
        return self._axis

    @property
    def phase_starts_s(self) -> tuple[float, ...]:
        """When each phase of the schedule begins, and when the last one ends [s]."""
        return tuple(accumulate((phase.duration_s for phase in self.phases), initial=0.0))

    @property
    def prefix(self) -> str:
        """What stands before the names of the axis' nodes and signals: "" or "NAME."."""
        return f"{self._axis}." if self._axis else ""

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the buses on which the axes hang, in the file's order; ("",) for one bus without a name."""
        return tuple(dict.fromkeys(axis.bus.channel for axis in self.axes))

    def one_axis(self, name: str | None = None) -> Rig:
        """Return the axis `name` as a rig of its own; without a name the rig itself, which must then have one axis only.

        Raises
        ------
        RigError
            the rig has several axes and none was named, or it has no such axis
        """
        names = [axis.axis for axis in self.axes if axis.axis]
        if name is None:
            if names:
                raise RigError(
                    [f"the rig {self.name} has the axes {', '.join(names)}; this is about one axis at a time"]
                )
            return self
        if name not in names:
            has = f"the axes {', '.join(names)}" if names else "one axis, without a name"
            raise RigError([f"--axis {name}: the rig {self.name} has {has}"])
        return self.axes[names.index(name)].alone

    @property
    def alone(self) -> Rig:
        """The axis as a rig of its own, whose nodes and signals have no axis in their names."""
        if not self._axis:
            return self
        return self._marks(load_rig_text(self.effective(), self.path, self.eds_texts, attached=self._attached))

    def _marks(self, rig: Rig) -> Rig:
        """Return `rig`, of which as much was said as of this one."""
        for one in (rig, *rig._axes):
            one._attached, one._law_named = self._attached, self._law_named
        return rig

    def on(self, channel: str) -> Rig:
        """Return the rig as it is on the bus `channel`: the axes that hang there and no other."""
        if self.channels == (channel,):
            return self
        there = [axis for axis in self.axes if axis.bus.channel == channel]
        if not there or self._values is None:
            raise KeyError(f"the rig has no bus '{channel}'; it has {', '.join(self.channels)}")
        return self._marks(
            _together(there, self._values | {"axis": {a.axis: self._values["axis"][a.axis] for a in there}})
        )

    @property
    def name(self) -> str:
        """The rig's short name."""
        return self.rig.name

    @property
    def path(self) -> str:
        """The file that the rig was read from."""
        return self._path

    @property
    def text(self) -> str:
        """The source text, without overrides."""
        return self._text

    @property
    def overrides(self) -> tuple[str, ...]:
        """The overrides, as they were given."""
        return self._overrides

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is allowed, and yet may not be meant."""
        return self._warnings

    @property
    def eds_texts(self) -> Mapping[str, str]:
        """The EDS files' texts by the names that the rig file has for them; a recording attaches them."""
        return {node.part.eds: node.description.text for node in self.nodes}

    def description(self, node: Literal["motor", "brake"]) -> Description:
        """Return what the EDS file says of a node.

        Raises
        ------
        TypeError
            the rig has several axes, and so several nodes of that role: ask one of `axes`
        """
        self._must_be_one("description")
        return self._descriptions[node]

    def _must_be_one(self, what: str) -> None:
        """Refuse to answer for a rig of several axes what each of them answers for itself: the first would stand for all."""
        if self._axes:
            names = ", ".join(axis.axis for axis in self._axes)
            raise TypeError(f"{what}: the rig {self.name} has the axes {names}; ask each of Rig.axes")

    @property
    def nodes(self) -> tuple[RigNode, ...]:
        """The devices of all axes: motor and brake of the first, of the second ..."""
        roles: tuple[Literal["motor", "brake"], ...] = ("motor", "brake")
        return tuple(
            RigNode(axis.prefix + role, role, axis.motor if role == "motor" else axis.brake, axis.description(role))
            for axis in self.axes
            for role in roles
        )

    def pdos(self) -> tuple[RigPdo, ...]:
        """Return the PDOs that the host maps, always the same five of each axis, with their signals."""
        return tuple(pdo for axis in self._axes for pdo in axis.pdos()) if self._axes else self._pdos

    def motor_limit_Nm(self, mode: str) -> float:
        """Return the largest motor torque at the handle [Nm] in a mode, which the drive's own limit 6072h is set to.

        In `hybrid` the motor has friction to compensate and nothing else: at most 1.2 times the identified friction.

        Raises
        ------
        TypeError
            the rig has several axes, each with a limit of its own: ask one of `axes`
        """
        self._must_be_one("motor_limit_Nm")
        limit = self.mode[mode].motor_limit_Nm
        return min(limit, HYBRID_MARGIN * self.mechanics.friction_Nm) if mode == "hybrid" else limit

    def effective(self) -> str:
        """Return the configuration after overrides as TOML text; loading it gives an equal rig."""
        values = self.model_dump(by_alias=True) if self._values is None else self._values
        return emit(values, f"The rig {self.name} as it was used, overrides included.")

    def variant(self, *overrides: str) -> Rig:
        """Return the rig with further overrides, as ``--set`` takes them."""
        if not overrides:
            return self
        found = load_rig_text(self.effective(), self.path, self.eds_texts, overrides, attached=self._attached)
        rig = self._marks(_named(found, self._axis))
        named = any(text.partition("=")[0].strip().endswith("law.function") for text in overrides)
        for one in (rig, *rig._axes):
            one._law_named |= named
        for one in (rig, *rig._axes):  # `mistake` says where a value came from
            one._text, one._overrides = self._text, (*self._overrides, *overrides)
        return rig

    def with_law(self, name: str) -> Rig:
        """Return the rig with another law, for all its axes."""
        own = [
            axis for axis in self._axes if self._values and "function" in self._values["axis"][axis.axis].get("law", ())
        ]
        return self.variant(f'law.function="{name}"', *(f'axis.{axis.axis}.law.function="{name}"' for axis in own))

    def mistake(self, key: str, expected: str) -> RigError:
        """Return the error that says where `key` stands, what stands there, and what was `expected`, for later checks."""
        path: Key = tuple(key.split("."))
        document = read_toml(self._text)
        set_keys = [text.partition("=")[0].strip() for text in self._overrides]
        if self._axis:  # what is set for the axis counts before what is set for all
            own: Key = ("axis", self._axis, *path)
            is_set = dotted(own) in set_keys
            path = own if is_set else Source(self._path, document, axis=("axis", self._axis)).full(path)
        value: Any = self.model_dump(by_alias=True)
        found = zip(reversed(set_keys), reversed(self._overrides), strict=True)
        given = next((f"--set {text}" for set_key, text in found if set_key == dotted(path)), None)
        place = given or f"{self._path}:{document.line(path)}"
        for part in path[2:] if path[0] == "axis" else path:
            value = value[part]
        return RigError([f"{place}: {dotted(path)}: '{shown(value)}' stands there; expected {expected}"])

    def _identity(self) -> tuple[str, str, tuple[tuple[str, str], ...]]:
        return self._axis, self.effective(), tuple(sorted(self.eds_texts.items()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rig) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def __copy__(self) -> Rig:
        return self  # frozen

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Rig:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        said = (self._attached, self._law_named)
        return _reload, (self.effective(), self.path, dict(self.eds_texts), self._axis, said)


def _named(rig: Rig, axis: str) -> Rig:
    """Return a rig of one axis with the axis' name."""
    if axis:
        rig._axis = axis
        rig._pdos = rig_pdos(rig)
    return rig


def _reload(text: str, path: str, eds_texts: Mapping[str, str], axis: str, said: tuple[bool, bool]) -> Rig:
    rig = _named(load_rig_text(text, path, eds_texts, attached=said[0]), axis)
    for one in (rig, *rig._axes):
        one._law_named = said[1]
    return rig


def packaged_rig(name: str) -> Path:
    """Return the file of a rig of the package."""
    return Path(str(resources.files("coulombus.rigs") / f"{name}.toml"))


def known_rigs() -> tuple[str, ...]:
    """Return the names of the package's rigs."""
    return tuple(
        sorted(entry.name[:-5] for entry in resources.files("coulombus.rigs").iterdir() if entry.name.endswith(".toml"))
    )


def load_rig(name_or_path: str, overrides: Sequence[str] = ()) -> Rig:
    """Load a rig by its name in the package, or from a file (a path has a separator or ends in .toml).

    Parameters
    ----------
    name_or_path : str
        "bench", "paper", or a path.
    overrides : sequence of str
        "SECTION.KEY=VALUE", a TOML value: "mode.active.F_s_Nm=1.0", "phase.1.duration_s=2" (phases count from 0).

    Raises
    ------
    RigError
        With every mistake that was found.
    """
    path = Path(name_or_path)
    if not ("/" in name_or_path or name_or_path.endswith(".toml")):
        known = known_rigs()
        if name_or_path not in known:
            hint = nearest(name_or_path, known)
            wanted = f"expected one of {', '.join(known)}, or a path such as ./{name_or_path or 'my-rig'}.toml"
            raise RigError([f"--rig {name_or_path}: no rig of this name; {wanted}{hint}"])
        path = packaged_rig(name_or_path)
    try:
        raw = read_regular(path, MOST_CHARACTERS)
    except OSError as error:
        known_names = ", ".join(known_rigs())
        reason = f"cannot be read ({error.strerror}); expected a rig file, or one of the rigs {known_names}"
        raise RigError([f"{path}: {reason}"]) from error
    try:
        text = raw.decode("utf-8-sig")
        broken = []
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        text = raw.decode("utf-8", "replace").removeprefix("\ufeff")
        broken = [
            (line, f"{path}:{line}: the byte 0x{raw[error.start]:02X} is no UTF-8; expected a file saved as UTF-8")
        ]
    return _load(text, str(path), None, overrides, broken)


def load_rig_text(
    text: str,
    name: str,
    eds_texts: Mapping[str, str] | None = None,
    overrides: Sequence[str] = (),
    *,
    attached: bool = False,
) -> Rig:
    """Load a rig from its text; `name` stands in for the file in errors, and gives the folder for relative paths.

    With `eds_texts` (by the names that the rig file has for them) no EDS file is read. With `attached` the text is of a recording, perhaps a
    stranger's: no file is read at all, and its law is run only if it is one of the project's own, or named by an override.

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
) -> Rig:
    document = read_toml(text)
    source = Source(path, document, found=list(broken))
    source.found += [(line, f"{path}:{line}: {problem}") for line, problem in document.problems]
    values = document.values
    axes_of_file = set(values["axis"]) if isinstance(values.get("axis"), dict) else set()
    for override in overrides:
        apply_override(values, override, source)
    for name in set(values.get("axis", ())) - axes_of_file:
        known = ", ".join(sorted(axes_of_file)) or "none: the file has no [axis.NAME]"
        source.say(("axis", name), f"there is no such axis; the rig's axes are {known}")
        if axes_of_file:
            del values["axis"][name]
    axes = split_axes(values, source)
    if axes is None:
        rig = _validated(values, source, eds_texts, attached)
        source.raise_all()
        rig = _finished(rig, text, overrides, source, values)
        rig._attached = attached
        return rig
    sources = {name: source.of_axis(name) for name in axes}
    rigs = [_validated(axes[name], sources[name], eds_texts, attached) for name in axes]
    check_axes(axes, sources)
    for one in sources.values():
        source.found += one.found
    source.raise_all()
    found = []
    for rig, name in zip(rigs, axes, strict=True):
        assert rig is not None
        rig._axis = name
        found.append(_finished(rig, text, overrides, sources[name], axes[name]))
    first = _validated(axes[found[0].axis], sources[found[0].axis], eds_texts, attached)
    whole = _finished(first, text, overrides, source, values)
    whole._axes, whole._values = tuple(found), values
    whole._warnings = tuple(dict.fromkeys(warning for rig in found for warning in rig.warnings))
    for rig_of_axis in (whole, *found):
        rig_of_axis._attached = attached
    return whole


def _together(axes: Sequence[Rig], values: dict[str, Any]) -> Rig:
    """Return the rig of several axes that `values` spells; its own sections are those of the first."""
    first = axes[0]
    whole = Rig.model_validate(first.model_dump(by_alias=True))
    whole._path, whole._text, whole._overrides = first.path, first.text, first.overrides
    whole._descriptions = first._descriptions
    whole._axes, whole._values = tuple(axes), values
    whole._warnings = tuple(dict.fromkeys(warning for axis in axes for warning in axis.warnings))
    return whole


def _validated(
    values: dict[str, Any], source: Source, eds_texts: Mapping[str, str] | None, attached: bool = False
) -> Rig | None:
    """Return the rig of one axis; None when it is refused. Mistakes are noted in `source`."""
    read_schedules(values, source, attached=attached)
    rig: Rig | None = None
    try:
        rig = Rig.model_validate(values)
    except ValidationError as error:
        explain(error, values, Rig, source)
    check(values, source)
    descriptions = read_descriptions(values, source, eds_texts)
    if rig is not None:
        rig._descriptions = descriptions
    elif not source.found:
        raise AssertionError("a rig that pydantic refuses has a mistake that is explained")
    return rig


def _finished(rig: Rig | None, text: str, overrides: Sequence[str], source: Source, values: Mapping[str, Any]) -> Rig:
    """Return the rig of one axis with all that is not in its sections."""
    assert rig is not None
    rig._path, rig._text, rig._overrides = source.path, text, tuple(overrides)
    rig._warnings = remarks(values, source)
    rig._pdos = rig_pdos(rig)
    return rig
