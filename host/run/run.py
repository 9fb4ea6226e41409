"""A run as a value: everything that decides what is displayed, and the output files.

Every run, in virtual time (`lab.simulate.virtual_run`) or on a bus (`host.run.real_run`), begins as a `Run`. Its
recording has the attachment `RUN`, from which `recorded_run` returns the run again. Data are taken from the recording:
rig, mode, seed, the texts of fault file and script. Code never is: the caller names a law's file, a script's or a
world's function again, and its checksum must be the recorded one.
"""

from __future__ import annotations

import hashlib
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from coulombus.eds.regular_file import read_regular
from coulombus.host.laws.law_source import law_source, recorded_sha256
from coulombus.host.laws.plane.plane_laws import builtin_laws
from coulombus.host.run.buses import path_on
from coulombus.host.run.markers import BitMark
from coulombus.recording.file_content import Capture
from coulombus.recording.log_files import is_log
from coulombus.recording.pcapng_reader import iter_pcapng
from coulombus.recording.reading import attached_rig
from coulombus.recording.segments import Rotation
from coulombus.rigs.arguments import WrongCall, a_number
from coulombus.rigs.errors import nearest
from coulombus.rigs.rig import Rig, load_rig_text
from coulombus.rigs.toml_lines import read_text
from coulombus.system.errors import CoulombusError

__all__ = ["OUTSIDE", "RUN", "Code", "NamedText", "NotRepeatable", "Outputs", "Run", "recorded_run"]

RUN = "run.json"
"""Name of the attachment."""


class NotRepeatable(CoulombusError):
    """A recording's run cannot be repeated; the text says which part is missing."""

    exit_status = 2


@dataclass(frozen=True)
class Outputs:
    """Output files of a run; None: not written."""

    record: Path | None = None
    """The recording: a file, or with `rotation` a folder of segments."""
    rotation: Rotation | None = None
    """Rule for the end of a segment (`recording.segments`)."""
    meta: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """The user's notes on the recording, which are attached to it in real time."""
    mark_on: tuple[BitMark, ...] = ()
    """Bits of signals that set a marker when they become 1."""
    histogram: Path | None = None
    """Figure of the wake-up and the SYNC-to-RPDO times."""
    status: Path | None = None
    """Path of the status socket (`host.run.status_socket`)."""
    truth: Path | None = None
    """The plant's true course, in virtual time."""
    measured: bool | None = None
    """Compute the figures from the frames in memory, in virtual time; None: if nothing is recorded."""
    force: bool = False
    """Overwrite existing files."""

    def on(self, channel: str) -> Outputs:
        """Return the files of one bus of a rig with several."""
        record, truth = (None if path is None else path_on(path, channel) for path in (self.record, self.truth))
        return replace(self, record=record, truth=truth)


class _RunModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class NamedText(_RunModel):
    """The text of a fault file or a script; errors call it `name`."""

    name: str
    text: str

    @classmethod
    def read(cls, path: Path, kind: str, error: type[Exception]) -> NamedText:
        """Return the text of the file `path`, a `kind`; raise `error` if it cannot be read."""
        return cls(name=str(path), text=read_text(path, kind, error))


class Code(_RunModel):
    """A user's function in a run. A recording has its name and the SHA-256 of its file, never itself."""

    code: str
    sha256: str | None = None
    """None if it has no source file: then it cannot be compared."""
    function: Any = Field(default=None, exclude=True)

    @classmethod
    def from_function(cls, function: Callable[..., Any], name: str, call: str) -> Code:
        """Return the code of the argument `name`; `call` is a correct call, for the message.

        Raises
        ------
        coulombus.rigs.arguments.WrongCall
            it is no function
        """
        if not callable(function):
            raise WrongCall(f"{name} is {function!r}: expected a function, as in {call}")
        try:
            plain = function.func if isinstance(function, partial) else function
            is_object = not (inspect.isroutine(plain) or inspect.isclass(plain))
            source = inspect.getsourcefile(type(plain) if is_object else inspect.unwrap(plain))
            sha256 = None if source is None else hashlib.sha256(read_regular(Path(source))).hexdigest()
        except (OSError, TypeError):
            sha256 = None
        return cls(code=getattr(function, "__qualname__", type(function).__name__), sha256=sha256, function=function)


OUTSIDE = Code(code="another program")
"""The world of a real-time run."""


@dataclass(frozen=True)
class Run:
    """A run: its rig, mode and length, its random seed, what goes wrong in it, and the output files.

    Attributes
    ----------
    seconds : length of the display, from Operation Enabled; None: until it is stopped
    simulated : the true rig if it differs from the host's `rig`
    faults : fault file (`sim_bus.faults`), in virtual time
    script : script file (`sim_bus.network.script`) or function of the world, in virtual time
    world : returns what the handle meets, every `world_every` cycles; `OUTSIDE` in real time

    Raises
    ------
    ValueError, coulombus.rigs.arguments.WrongCall
        the rig has no such mode, or a value has the wrong type
    """

    rig: Rig
    mode: str
    seconds: float | None
    seed: int = 0
    simulated: Rig | None = None
    faults: NamedText | None = None
    script: NamedText | Code | None = None
    world: Code | None = None
    world_every: int = 1
    outputs: Outputs = field(default_factory=Outputs)
    virtual: bool = True

    def __post_init__(self) -> None:
        if self.mode not in self.rig.modes:
            modes = f"{', '.join(self.rig.modes)}{nearest(self.mode, self.rig.modes)}"
            raise ValueError(f"mode {self.mode!r}: the rig has {modes}")
        a_number(self.seed, "seed", "7", whole=True)
        a_number(self.world_every, "world_every", "5", whole=True)
        if self.world_every < 1:
            raise WrongCall(f"world_every is {self.world_every!r}: expected 1 or more")
        if self.seconds is None:
            if self.virtual:
                raise ValueError("seconds None: a run in virtual time has a length; expected a number above 0")
            return
        a_number(self.seconds, "seconds", "13.0")
        if not (math.isfinite(self.seconds) and self.seconds > 0):
            raise ValueError(f"seconds {self.seconds!r}: expected a number above 0")

    @property
    def files(self) -> tuple[Path, ...]:
        """The recordings and truths to be written, of all buses."""
        each = [self.outputs] if self.rig.one_cycle else [self.outputs.on(channel) for channel in self.rig.channels]
        return tuple(path for outputs in each for path in (outputs.record, outputs.truth) if path is not None)

    def attachments(self, recorded: Rig) -> dict[str, bytes]:
        """Return the run as the attachment of a recording to which the rig `recorded` is attached."""
        document = _RunDocument(
            virtual=self.virtual,
            mode=self.mode,
            seconds=None if self.seconds is None else float(self.seconds),
            seed=int(self.seed) if self.virtual else None,
            rig=None if recorded is self.rig else _RigTexts.from_rig(self.rig),
            simulated=None if self.simulated is None else _RigTexts.from_rig(self.simulated),
            faults=_without_folder(self.faults),
            script=_without_folder(self.script),
            world=self.world,
            world_every=int(self.world_every),
        )
        return {RUN: document.model_dump_json(indent=1, exclude_defaults=True).encode()}


def _without_folder(text: Any) -> Any:
    """Return the text with its file's name alone: the same run gives the same bytes in any folder."""
    return NamedText(name=Path(text.name).name, text=text.text) if isinstance(text, NamedText) else text


class _RigTexts(_RunModel):
    rig: str
    eds: dict[str, str]

    @classmethod
    def from_rig(cls, rig: Rig) -> _RigTexts:
        return cls(rig=rig.effective(), eds=dict(rig.eds_texts))

    def load(self, name: str) -> Rig:
        return load_rig_text(self.rig, name, self.eds, attached=True)


class _RunDocument(_RunModel):
    """The attachment; a missing `rig` is that of the recording."""

    virtual: bool
    mode: str
    seconds: float | None = Field(gt=0, le=1e8)
    seed: int | None = Field(default=None, ge=0)
    rig: _RigTexts | None = None
    simulated: _RigTexts | None = None
    faults: NamedText | None = None
    script: NamedText | Code | None = None
    world: Code | None = None
    world_every: int = Field(default=1, ge=1)


@dataclass(frozen=True)
class _NamedCode:
    """The code that the caller names for the run of a recording."""

    path: str
    law: str | None
    attachments: Mapping[str, bytes]

    def function(self, part: str, recorded: Any, function: Callable[..., Any] | None) -> Any:
        """Return the run's `part`: text of the recording, or the caller's function with the recorded checksum."""
        if not isinstance(recorded, Code):
            if function is not None:
                raise NotRepeatable(f"{self.path}: its run has no {part} in Python; leave {part} out")
            return recorded
        where = f"{self.path}: its run has the {part} {recorded.code}, a program: it is not taken from a recording"
        if recorded.sha256 is None:
            raise NotRepeatable(f"{where}, and its checksum is not known: the run cannot be repeated")
        if function is None:
            raise NotRepeatable(f"{where}; name it again in Python: coulombus.repeat({self.path!r}, {part}=FUNCTION)")
        code = Code.from_function(function, part, f"repeat({part}=FUNCTION)")
        if code.sha256 != recorded.sha256:
            raise NotRepeatable(f"{self.path}: {part} {code.code}: its file is not that of the run ({recorded.code})")
        return code

    def on(self, rig: Rig) -> Rig:
        """Return the rig with the law that the caller names, where it is not built in."""
        name = rig.law_function
        if name in builtin_laws(rig):
            if self.law not in (None, name):
                raise NotRepeatable(f"{self.path}: its run has the law {name}; leave --law {self.law} out")
            return rig
        if self.law is None:
            reason = f"its law {name} is a program: it is not taken from a recording"
            raise NotRepeatable(f"{self.path}: {reason}; name it again: --law FILE.py:FUNCTION")
        place, _, function = name.rpartition(":")
        law = f"{self.law}:{function}" if self.law.endswith(".py") else self.law
        folder = _folder_of(law, name)
        rig = rig.with_law(law) if folder is None else rig.with_law_in(folder)
        source, recorded = law_source(rig), recorded_sha256(self.attachments)
        if source is None:
            raise NotRepeatable(f"--law {self.law}: it cannot be read; the law of {self.path} was {name}")
        if source.sha256 != recorded:
            raise NotRepeatable(
                f"--law {self.law}: it is not the law of {self.path}, whose {place} has another checksum"
            )
        return rig


def _folder_of(law: str, recorded: str) -> Path | None:
    """Return the folder in which the recorded name ``file.py:function`` means `law`; None if there is none."""
    file, tail = (Path(name.rpartition(":")[0]) for name in (law, recorded))
    same = law.rpartition(":")[2] == recorded.rpartition(":")[2]
    if not same or tail.suffix != ".py" or tail.is_absolute() or file.parts[-len(tail.parts) :] != tail.parts:
        return None
    return Path(*file.parts[: -len(tail.parts)])


def recorded_run(
    path: str | Path,
    *,
    law: str | None = None,
    script: Callable[..., Any] | None = None,
    world: Callable[..., Any] | None = None,
    seconds: float | None = None,
    outputs: Outputs | None = None,
) -> Run:
    """Return the run of a recording, to be repeated in virtual time.

    Parameters
    ----------
    law : ``FILE.py:FUNCTION`` of the run's law, if it is not built in
    script, world : the run's functions, if it had any
    seconds : length of the display, if the run lasted until it was stopped
    outputs : output files of the repetition

    Raises
    ------
    NotRepeatable
        the recording has no run, its run is damaged, code is missing or has another checksum, or an output file
        is the recording itself
    coulombus.rigs.rig.RigError, coulombus.recording.pcapng_blocks.PcapngError
        the recording, or its rig, cannot be read
    """
    path = str(path)
    begin: list[Capture] = []
    for capture in () if is_log(path) else iter_pcapng(path):
        begin.append(capture)
        if len(capture.frames):
            break
    attachments = {name: content for capture in begin for name, content in capture.attachments.items()}
    if RUN not in attachments:
        remedy = "name rig, mode, seconds and seed yourself"
        raise NotRepeatable(
            f"{path}: no run is attached (an earlier version, another tool, or emulate made it); {remedy}"
        )
    try:
        document = _RunDocument.model_validate_json(attachments[RUN])
    except ValidationError as error:
        mistake = error.errors()[0]
        where = ".".join(map(str, mistake["loc"])) or "it"
        raise NotRepeatable(f"{path}: its attachment {RUN}: {where}: {mistake['msg']}; a newer version?") from None
    named = _NamedCode(path, law, attachments)
    rig = attached_rig(begin) if document.rig is None else document.rig.load(f"{path}[{RUN}]")
    if rig is None:
        raise NotRepeatable(f"{path}: a run is attached, and no rig")
    if document.seconds is not None and seconds not in (None, document.seconds):
        raise NotRepeatable(f"{path}: its run lasted {document.seconds:g} s; leave --seconds out")
    length = document.seconds or seconds
    if length is None:
        raise NotRepeatable(f"{path}: its run lasted until it was stopped; give --seconds")
    try:
        run = Run(
            named.on(rig),
            document.mode,
            length,
            document.seed or 0,
            simulated=None if document.simulated is None else document.simulated.load(f"{path}[{RUN}]"),
            faults=document.faults,
            script=named.function("script", document.script, script),
            world=named.function("world", document.world, world),
            world_every=document.world_every,
            outputs=outputs or Outputs(),
        )
    except ValueError as error:
        raise NotRepeatable(f"{path}: its attachment {RUN}: {error}") from None
    _refuse_itself(Path(path), run.files)
    return run


def _refuse_itself(recording: Path, files: tuple[Path, ...]) -> None:
    """Refuse an output file that is the recording, or in its folder: an interrupted run would have lost it."""
    for file in files:
        inside = recording.is_dir() and recording.resolve() in file.resolve().parents
        if inside or (file.exists() and file.samefile(recording)):
            raise NotRepeatable(
                f"{file}: that is the recording itself; nothing is written over it; choose another name"
            )
