"""The rig file: one TOML file says what hangs on the bus, what the controller believes, and what the simulation knows.

``load_rig("bench")`` finds a rig of the package, ``load_rig("lab/handle.toml")`` a file. The result is frozen and
complete; `docs/rig-file.md` explains every key. Every mistake of a file is reported at once, each with ``file:line``,
the key, what stands there, what is expected and the nearest known key.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr, ValidationError

from eds.reader import Description
from eds.rig_checks import check, remarks
from eds.rig_errors import RigError, Source, nearest, shown
from eds.rig_files import read_descriptions, read_schedules
from eds.rig_model import About, Brake, Bus, Host, Law, Limits, Mechanics, Modes, Motor, Section
from eds.rig_plant import Operator, Phase, Plant
from eds.rig_text import apply_override, emit
from eds.rig_words import explain
from eds.signals import RigPdo, rig_pdos
from eds.toml_lines import read_toml

__all__ = ["Rig", "RigError", "known_rigs", "load_rig", "load_rig_text"]

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
        return {self.motor.eds: self.description("motor").text, self.brake.eds: self.description("brake").text}

    def description(self, node: Literal["motor", "brake"]) -> Description:
        """Return what the EDS file says of a node."""
        return self._descriptions[node]

    def pdos(self) -> tuple[RigPdo, ...]:
        """Return the PDOs that the host maps, always the same five, with their signals."""
        return self._pdos

    def motor_limit_Nm(self, mode: str) -> float:
        """Return the largest motor torque at the handle [Nm] in a mode, which the drive's own limit 6072h is set to.

        In `hybrid` the motor has friction to compensate and nothing else: at most 1.2 times the identified friction.
        """
        limit = self.mode[mode].motor_limit_Nm
        return min(limit, HYBRID_MARGIN * self.mechanics.friction_Nm) if mode == "hybrid" else limit

    def effective(self) -> str:
        """Return the configuration after overrides as TOML text; loading it gives an equal rig."""
        return emit(self.model_dump(by_alias=True), f"The rig {self.name} as it was used, overrides included.")

    def variant(self, *overrides: str) -> Rig:
        """Return the rig with further overrides, as ``--set`` takes them."""
        return load_rig_text(self.effective(), self.path, self.eds_texts, overrides)

    def mistake(self, key: str, expected: str) -> RigError:
        """Return the error that says where `key` stands, what stands there, and what was `expected`, for later checks."""
        path = tuple(key.split("."))
        given = next(
            (f"--set {text}" for text in reversed(self._overrides) if text.partition("=")[0].strip() == key), None
        )
        place = given or f"{self._path}:{read_toml(self._text).line(path)}"
        value: Any = self.model_dump(by_alias=True)
        for part in path:
            value = value[part]
        return RigError([f"{place}: {key}: '{shown(value)}' stands there; expected {expected}"])

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
        return load_rig_text, (self.effective(), self.path, dict(self.eds_texts))


def known_rigs() -> tuple[str, ...]:
    """Return the names of the package's rigs."""
    return tuple(sorted(entry.name[:-5] for entry in resources.files("rigs").iterdir() if entry.name.endswith(".toml")))


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
        path = Path(str(resources.files("rigs") / f"{name_or_path}.toml"))
    try:
        raw = path.read_bytes()
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
    text: str, name: str, eds_texts: Mapping[str, str] | None = None, overrides: Sequence[str] = ()
) -> Rig:
    """Load a rig from its text; `name` stands in for the file in errors, and gives the folder for relative paths.

    With `eds_texts` (by the names that the rig file has for them) no file is read, as a recording needs it.

    Raises
    ------
    RigError
        With every mistake that was found.
    """
    return _load(text, name, eds_texts, overrides, [])


def _load(
    text: str,
    path: str,
    eds_texts: Mapping[str, str] | None,
    overrides: Sequence[str],
    broken: Sequence[tuple[float, str]],
) -> Rig:
    document = read_toml(text)
    source = Source(path, document, found=list(broken))
    source.found += [(line, f"{path}:{line}: {problem}") for line, problem in document.problems]
    values = document.values
    for override in overrides:
        apply_override(values, override, source)
    read_schedules(values, source)
    rig: Rig | None = None
    try:
        rig = Rig.model_validate(values)
    except ValidationError as error:
        explain(error, values, Rig, source)
    check(values, source)
    descriptions = read_descriptions(values, source, eds_texts)
    if rig is None or source.found:
        source.raise_all()
        raise AssertionError("a rig that pydantic refuses has a mistake that is explained")
    rig._path, rig._text, rig._overrides = path, text, tuple(overrides)
    rig._descriptions = descriptions
    rig._warnings = remarks(values, source)
    rig._pdos = rig_pdos(rig)
    return rig
