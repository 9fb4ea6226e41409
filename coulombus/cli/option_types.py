"""Types of options and arguments: files, folders, times, rates."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from coulombus.cli.errors import OUTPUTS, Failure
from coulombus.recording.output_file import is_stream, named_after, reason_against

__all__ = [
    "BIT_RATE",
    "CPU",
    "OUTPUT_FOLDER",
    "PICTURE",
    "SECONDS",
    "SECONDS_OR_NONE",
    "UNCHECKED_PATH",
    "InputPath",
    "OutputDirectory",
    "OutputFile",
    "RecordingPlace",
    "output_named_after",
]


class InputPath(click.Path):
    """An input file or folder.

    A missing one ends the verb like a missing rig file, with a suggestion.
    """

    def __init__(self, *, file_okay: bool = True) -> None:
        super().__init__(file_okay=file_okay, exists=True, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; `Failure` if it does not exist, BadParameter if it is unusable."""
        from coulombus.eds.regular_file import mode_of

        try:
            mode_of(value)
        except FileNotFoundError as error:
            bus = f": a bus is given with --bus {value}" if str(value).startswith(BUSES) else ""
            raise Failure(f"{value}: cannot be read ({error.strerror}){bus}", 3) from None
        except OSError as error:
            self.fail(f"{value}: {error.strerror}", param, ctx)
        return super().convert(value, param, ctx)


class OutputFile(click.Path):
    """An output file, checked before anything is run.

    See `recording.output_file`.

    An existing file is refused unless the verb's parameter `overwrite` is given (`force_option`).

    Parameters
    ----------
    suffixes : permitted suffixes of the name; empty: any
    dash : whether ``-`` means the standard output
    """

    def __init__(self, *suffixes: str, dash: bool = False) -> None:
        super().__init__(dir_okay=False, path_type=Path)
        self.suffixes, self.dash = suffixes, dash

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; BadParameter has the reason of a refusal."""
        if self.dash and str(value) in ("-", "/dev/stdout"):
            return Path("-")
        path = Path(str(super().convert(value, param, ctx)))
        pipe = ".pcapng" in self.suffixes and is_stream(path)  # a pipe may have any name
        if not pipe:
            self._named(path, param, ctx)
        force = None if ctx is None else next((p for p in ctx.command.params if p.name == "overwrite"), None)
        remedy = "choose another name" + (f", or replace it with {force.opts[0]}" if force else "")
        may_overwrite = ctx is not None and bool(ctx.params.get("overwrite"))
        reason = reason_against(path, force=may_overwrite, remedy=remedy)
        if reason is not None:
            self.fail(reason, param, ctx)
        if not pipe:
            self._named(path.resolve(), param, ctx)  # the target of a link would be overwritten
        if ctx is not None and param is not None and not is_stream(path):
            first = ctx.meta.setdefault(OUTPUTS, {}).setdefault(path.resolve(), param.opts[0])
            if first != param.opts[0]:
                self.fail(f"{path}: {first} writes there, too; choose another name", param, ctx)
        return path

    def _named(self, path: Path, param: click.Parameter | None, ctx: click.Context | None) -> None:
        if self.suffixes and path.suffix.lower() not in self.suffixes:
            self.fail(f"{path}: expected a name that ends in {', '.join(self.suffixes)}", param, ctx)


def output_named_after(file: Path, suffix: str, overwrite: bool) -> Path:
    """Return the output of a verb without -o, which is named after its input; refuse an existing file."""
    path = named_after(file, suffix)
    reason = reason_against(path, force=overwrite, remedy="choose another name by -o, or replace it with --overwrite")
    if reason is not None:
        raise click.UsageError(reason)
    return path


class OutputDirectory(click.Path):
    """A directory, created if missing.

    It is checked before anything is run. With `make` false the verb creates it once nothing can be refused any more.
    """

    def __init__(self, *, make: bool = True) -> None:
        super().__init__(file_okay=False, path_type=Path)
        self.make = make

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; BadParameter has the reason of a refusal."""
        path = Path(value)
        if path.suffix.lower() == ".toml" and not path.is_dir():
            self.fail(f"{path}: expected a folder, and this is the name of a rig file: --rig {path}", param, ctx)
        super().convert(value, param, ctx)
        if not self.make:
            return path
        try:
            path.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            self.fail(f"{path}: it is not a folder", param, ctx)
        except OSError as error:
            self.fail(f"{path}: cannot be made: {error.strerror}", param, ctx)
        return path


class RecordingPlace(OutputFile):
    """Destination of a recording: a new file ``F.pcapng``, or a folder for segments: an existing
    one, or any name if the verb's parameter `rotate` is given.
    """

    def __init__(self) -> None:
        super().__init__(".pcapng")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; BadParameter has the reason of a refusal."""
        path = Path(value)
        rotated = ctx is not None and ctx.params.get("rotate") is not None
        if path.suffix.lower() != ".pcapng" and not is_stream(path) and (path.is_dir() or rotated):
            return OutputDirectory().convert(value, param, ctx)
        return super().convert(value, param, ctx)


PICTURE = OutputFile(".png", ".svg", ".pdf")


class _Seconds(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A duration in s: a number above 0, at most a year; with `zero` also 0."""

    name = "seconds"

    def __init__(self, zero: bool = False) -> None:
        self._zero = zero

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            seconds = float(value)
        except ValueError:
            seconds = float("nan")
        if not 0 < seconds <= YEAR_S and not (self._zero and seconds == 0):
            least = "of 0 or more" if self._zero else "above 0"
            self.fail(f"{value!r}: expected a number {least}, at most {YEAR_S} (a year), in s", param, ctx)
        return seconds


class _Cpu(click.ParamType):  # type: ignore[type-arg]
    """The number of a CPU that this process may use."""

    name = "cpu"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        from coulombus.system.realtime import usable_cpus

        allowed = sorted(usable_cpus())
        if not str(value).isdecimal() or int(value) not in allowed:
            self.fail(f"{value!r}: this process may use the CPUs {', '.join(map(str, allowed))}", param, ctx)
        return int(value)


class _BitRate(click.ParamType):  # type: ignore[type-arg]
    """A bit rate in bit/s; k and M stand for a thousand and a million."""

    name = "bit rate"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,6})?)\s*([kM]?)(?:bit/s|bps)?", str(value))
        rate = float(match[1]) * {"": 1, "k": 1e3, "M": 1e6}[match[2]] if match else 0.0
        if not (10_000 <= rate <= 20_000_000 and rate == int(rate)):
            self.fail(f"{value!r}: expected a bit rate from 10k to 20M, such as 1000000, 500k or 1M", param, ctx)
        return int(rate)


BUSES = ("coulombus:", "socketcan:", "can:")
YEAR_S = 31_557_600
SECONDS, SECONDS_OR_NONE = _Seconds(), _Seconds(zero=True)
CPU = _Cpu()
BIT_RATE = _BitRate()
OUTPUT_FOLDER = click.Path(readable=False, file_okay=False, path_type=Path)
"""Of many runs, which its writer continues: what stands there is its writer's to judge."""
UNCHECKED_PATH = click.Path(readable=False, path_type=Path)
"""Of a file whose reader says what is wrong with it."""
