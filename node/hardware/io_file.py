"""The I/O file of ``coulombus node --io``: the converter channel of each object.

The models are the schema; a test compares docs/own-device.md with them. `read_io_file` reports all
mistakes together, each with file:line.

    raw = raw_at_zero + raw_per_unit * value

`value` is the object's physical value: Nm, A and degrees C for the brake's objects, the object's
own number for all others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import Field, ValidationError

from coulombus.eds.description import Description, object_key
from coulombus.eds.regular_file import NoRegularFile, read_regular
from coulombus.node.profile import Key, Profile, Terminal
from coulombus.rigs.errors import RigError, Source
from coulombus.rigs.field_help import explain
from coulombus.rigs.model import Section
from coulombus.rigs.toml_lines import read_toml

__all__ = [
    "CounterInput",
    "IioInput",
    "IioOutput",
    "IoFile",
    "IoPlan",
    "Line",
    "PwmOutput",
    "PythonInput",
    "PythonOutput",
    "read_io_file",
]

LEAST_PERIODS = 3
"""Least number of periods within the watchdog's time."""
_COMMUNICATION = range(0x2000)


class Loop(Section):
    """[loop]: times of reading and writing the converters."""

    period_s: float = Field(0.001, ge=1e-4, le=0.1, description="from one reading and writing to the next")
    watchdog_s: float = Field(
        0.05, ge=0.001, le=1.0, description="if the node hangs for so long, its outputs become safe"
    )


class Brake(Section):
    """[brake]: data of the coil, for the brake's driver."""

    coil_A_Nm: float = Field(
        0.0, ge=0, le=1e3, description="current for 1 Nm; with it an open and a short coil are found; 0: unknown"
    )


class Python(Section):
    """[python]: the class for the channels of kind "python"."""

    board: str = Field(min_length=3, description='"FILE.py:Class" beside this file, or "module:Class"')


class _Wired(Section):
    object: str = Field(min_length=1, description='"7300:01", or the name of the object in the EDS')
    raw_at_zero: float = Field(0.0, description="the channel's input or output at the value 0")
    raw_per_unit: float = Field(1.0, description="by how much that grows for one unit of the value")


class _Output(_Wired):
    low: float = Field(description="least value that is put out")
    high: float = Field(description="largest value that is put out")
    safe: float = Field(description="value at start, after a fault, and at the end")


class _Input(_Wired):
    low: float = Field(-1e30, description="a reading below it is a fault")
    high: float = Field(1e30, description="a reading above it is a fault")


class _Iio(Section):
    kind: Literal["iio"]
    device: str = Field(min_length=1, description='folder, its name as "iio:device0", or what its file `name` says')
    scaled: bool = Field(
        False,
        description="count by IIO's unit (mV, mA ...), with the files CHANNEL_scale and CHANNEL_offset",
        json_schema_extra={"expected": "true or false"},
    )


class _PythonChannel(Section):
    kind: Literal["python"]
    channel: str = Field(min_length=1, description="its name in what write() gets and read() returns")


class IioOutput(_Output, _Iio):
    """[[output]] of kind "iio": a DAC."""

    channel: str = Field(pattern=r"^out_\w+$", description='as "out_voltage0"')


class PwmOutput(_Output):
    """[[output]] of kind "pwm": `raw` is the on-time [ns] in each period."""

    kind: Literal["pwm"]
    device: str = Field(min_length=1, description='folder, or its name as "pwmchip0"')
    channel: int = Field(0, ge=0, le=63, description="number of the chip's channel")
    pwm_period_s: float = Field(ge=1e-7, le=1.0, description="period of the pulses")


class PythonOutput(_Output, _PythonChannel):
    """[[output]] of kind "python"."""


class IioInput(_Input, _Iio):
    """[[input]] of kind "iio": an ADC, or a quadrature counter (in_count0)."""

    channel: str = Field(pattern=r"^in_\w+$", description='as "in_voltage0"')
    buffered: bool = Field(
        False,
        description="all such channels of the device are sampled together, by its trigger and buffer where it has them",
        json_schema_extra={"expected": "true or false"},
    )


class CounterInput(_Input):
    """[[input]] of kind "counter"."""

    kind: Literal["counter"]
    device: str = Field(min_length=1, description='folder, or its name as "counter0"')
    channel: str = Field("count0", pattern=r"^count\d+$", description='as "count0"')


class PythonInput(_Input, _PythonChannel):
    """[[input]] of kind "python"."""


Output: TypeAlias = Annotated[IioOutput | PwmOutput | PythonOutput, Field(discriminator="kind")]
Input: TypeAlias = Annotated[IioInput | CounterInput | PythonInput, Field(discriminator="kind")]


class IoFile(Section):
    """The whole file."""

    loop: Loop = Field(Loop.model_validate({}), description="when the converters are read and written")
    brake: Brake = Field(Brake.model_validate({}), description="the coil behind a node of kind brake")
    python: Python | None = Field(None, description='the class behind the channels of kind "python"')
    outputs: tuple[Output, ...] = Field(
        (),
        alias="output",
        strict=False,
        description="what is put out",
        json_schema_extra={"expected": "[[output]] in double brackets, once for each channel"},
    )
    inputs: tuple[Input, ...] = Field(
        (),
        alias="input",
        strict=False,
        description="what is read",
        json_schema_extra={"expected": "[[input]] in double brackets, once for each channel"},
    )


Channel: TypeAlias = IioOutput | PwmOutput | PythonOutput | IioInput | CounterInput | PythonInput


@dataclass(frozen=True)
class Line:
    """A channel and its object; `where` is its position in the file."""

    channel: Channel
    key: Key
    terminal: Terminal | None
    """None: no kind acts on the object; its value is output, or read, directly."""
    where: str


@dataclass(frozen=True)
class IoPlan:
    """An I/O file that fits its device."""

    path: str
    file: IoFile
    outputs: tuple[Line, ...]
    inputs: tuple[Line, ...]

    @property
    def folder(self) -> Path:
        """Folder of the file."""
        return Path(self.path).parent


def read_io_file(path: str | Path, description: Description, profile: Profile) -> IoPlan:
    """Read an I/O file for a device.

    Raises
    ------
    coulombus.rigs.errors.RigError
        lists all mistakes, each with file:line
    """
    try:
        text = read_regular(path).decode("utf-8-sig")
    except (NoRegularFile, OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise RigError((f"{path}: {why}; expected an I/O file (docs/own-device.md)",)) from None
    document = read_toml(text)
    source = Source(str(path), document)
    source.found += [(line, f"{path}:{line}: {problem}") for line, problem in document.problems]
    try:
        file = IoFile.model_validate(document.values)
    except ValidationError as error:
        explain(error, document.values, IoFile, source)
        source.raise_all()
        raise
    outputs = tuple(_lines("output", file.outputs, source, description, profile))
    inputs = tuple(_lines("input", file.inputs, source, description, profile))
    _check(file, source, profile)
    source.raise_all()
    return IoPlan(str(path), file, outputs, inputs)


def _check(file: IoFile, source: Source, profile: Profile) -> None:
    if not file.outputs and not file.inputs:
        source.found.append((1, f"{source.path}:1: got no channel; expected [[output]] or [[input]]"))
    if file.loop.watchdog_s < LEAST_PERIODS * file.loop.period_s:
        expected = f"at least {LEAST_PERIODS} times loop.period_s, {LEAST_PERIODS * file.loop.period_s:g} s"
        source.stands(("loop", "watchdog_s"), file.loop.watchdog_s, expected)
    if file.brake.coil_A_Nm and profile.name != "brake":
        source.say(("brake",), f"the node is of kind {profile.name}; expected no such section")
    if file.python is None:
        for name, channels in (("output", file.outputs), ("input", file.inputs)):
            for i, channel in enumerate(channels):
                if channel.kind == "python":
                    source.say((name, i, "kind"), "got 'python', but there is no class; expected [python] with `board`")


def _lines(
    name: str, channels: tuple[Channel, ...], source: Source, description: Description, profile: Profile
) -> Iterator[Line]:
    terminals = {terminal.key: terminal for terminal in profile.terminals if terminal.is_output == (name == "output")}
    other = {terminal.key for terminal in profile.terminals if terminal.is_output != (name == "output")}
    numbers: dict[object, int] = {}
    for i, channel in enumerate(channels):
        here = (name, i)
        if channel.raw_per_unit == 0:
            source.stands((*here, "raw_per_unit"), 0, "a number other than 0")
        if channel.low >= channel.high:
            source.stands((*here, "low"), channel.low, f"less than `high`, {channel.high:g}")
        elif isinstance(channel, _Output) and not channel.low <= channel.safe <= channel.high:
            source.stands((*here, "safe"), channel.safe, f"{channel.low:g} to {channel.high:g}, the limits")
        if isinstance(channel, PwmOutput):
            _check_pwm(channel, here, source)
        key = object_key(channel.object, description)
        if isinstance(key, str):
            source.stands((*here, "object"), channel.object, key)
            continue
        if key[0] in _COMMUNICATION:
            source.stands((*here, "object"), channel.object, "an object from 2000h on")
        elif key in other:
            source.stands((*here, "object"), channel.object, f"no [[{name}]], as it is the device's other direction")
        elif key not in terminals and description.variable(*key).whole is None and _is_text(description, key):
            source.stands((*here, "object"), channel.object, "an object that is a number")
        device = getattr(channel, "device", "")
        for what, part in ((key, "object"), ((channel.kind, device, channel.channel), "channel")):
            if what in numbers:
                source.say((*here, part), f"is in [[{name}]] number {numbers[what] + 1} already; expected it once")
            numbers[what] = i
        _, where = source.where(here)
        yield Line(channel, key, terminals.get(key), where)


def _check_pwm(channel: PwmOutput, here: tuple[str, int], source: Source) -> None:
    period_ns = channel.pwm_period_s * 1e9
    for end in ("low", "high"):
        duty_ns = channel.raw_at_zero + channel.raw_per_unit * getattr(channel, end)
        if not -0.5 <= duty_ns <= period_ns + 0.5:
            expected = f"a value whose raw is 0 to {period_ns:g} ns, the period; here it is {duty_ns:g}"
            source.stands((*here, end), getattr(channel, end), expected)


def _is_text(description: Description, key: Key) -> bool:
    return description.variable(*key).data_type not in (0x0008, 0x0011)  # REAL32, REAL64
