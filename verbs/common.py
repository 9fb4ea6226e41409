"""What the verbs of the command line have in common: options, exit statuses, errors as texts,
progress.
"""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from coulombus.recording.output_file import is_stream, reason_against
from coulombus.verbs.exit_status import FAULT, STATUSES
from coulombus.wire.folding import columns_of, hanging
from coulombus.wire.stopping import Stopped, as_exceptions, raised, status_of, told
from coulombus.wire.verdict import abandon_stdout, printed, say, verdict

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = [
    "BIT_RATE",
    "CPU",
    "EXIT_STATUS",
    "MODES",
    "PICTURE",
    "SECONDS",
    "InputPath",
    "OutputDirectory",
    "OutputFile",
    "RecordingPlace",
    "Verbs",
    "bus_option",
    "buses_option",
    "channel_option",
    "check_mode",
    "check_shared_machine",
    "display_s",
    "errors",
    "faults_option",
    "force_option",
    "json_option",
    "listed",
    "load",
    "mode_option",
    "on_terminal",
    "print_json",
    "printable",
    "printed",
    "progress",
    "record_option",
    "recording_argument",
    "remark",
    "rig_option",
    "say",
    "script_option",
    "seconds_option",
    "seed_option",
    "set_option",
    "shared_machine_option",
    "signals_option",
    "table_console",
    "verdict",
]

EXIT_STATUS = (
    "\b\nExit status:\n"
    + "".join(hanging(f"{status:>3}  {text}", 76, 5) + "\n" for status, text in STATUSES.items())
    + """With --json, what ends a verb before its result is an object on stdout, too:
{"event": "error", "error": TEXT, "exit_status": N}
"""
)

WORDS, RESULT, OUTPUTS = f"{__name__}.words", f"{__name__}.result", f"{__name__}.outputs"
"""What a context keeps: the words after the verb, that the result has been printed, and which
option writes which file.
"""
MODES = ("active", "passive", "hybrid")


_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")


class Failure(Exception):
    """What ends a verb: a text and an exit status."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.status = status


class Verbs(click.Group):
    """The verbs. What ends one before its result is told on stderr.

    With --json it is an object on stdout, too.

    Ctrl-C is exit status 130 at any time, also while a verb still loads what it needs; so with the
    other signals of `wire.stopping`. What no verb foresees is a mistake of this program: it is told
    with its place, and is no "a check failed".
    """

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Read the words up to the verb; ``--help`` and ``--version`` print here, on a stdout that
        may take nothing.
        """
        try:
            with _failures():
                return super().make_context(info_name, args, parent, **extra)
        except Failure as failure:
            _end(failure)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Keep the words, to know of --json even where the rest of them is refused."""
        _open_all_streams()
        ctx.meta[WORDS] = tuple(args)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb."""

        def tell(text: str, status: int) -> None:
            if "--json" in ctx.meta.get(WORDS, ()) and RESULT not in ctx.meta:
                with suppress(OSError):  # of a stdout that takes nothing, stderr tells
                    click.echo(json.dumps({"event": "error", "error": text, "exit_status": status}))

        try:
            try:
                with as_exceptions(), _failures():
                    return super().invoke(ctx)
            except click.UsageError as error:
                meant = _option_meant(error)
                raise click.UsageError(f"{error.message}{meant}", error.ctx) if meant else error from None
            except Stopped as stopped:
                raise Failure(f"ended by {stopped}", status_of(stopped.number)) from None
            except KeyboardInterrupt:
                raise _by_signal(signal.SIGINT) from None
        except Failure as failure:
            if failure.status == FAULT and raised():  # what became of the signal's own exception
                failure = _by_signal(raised())
            tell(str(failure), failure.status)
            _end(failure)
        except click.ClickException as error:
            tell(error.format_message(), error.exit_code)
            raise


def _option_meant(error: click.UsageError) -> str:
    """Return which option an argument too many is of, behind a semicolon; nothing where that is not
    known.
    """
    if re.match(r"No such command '(help|\?)'", error.message, re.IGNORECASE):
        return " The list of verbs is coulombus --help."
    found = re.fullmatch(r"Got unexpected extra arguments? \((\S+).*\)", error.message)
    if found is None or error.ctx is None:
        return ""
    word = found[1]
    kinds = (
        ("--bus", re.match(r"(coulombus|socketcan):", word)),
        ("--record", word.endswith(".pcapng")),
        ("--mode", word in MODES),
        ("--rig", word.endswith(".toml") or word in ("bench", "paper", "two_axes")),
    )
    known = {option for param in error.ctx.command.params for option in param.opts}
    meant = next((option for option, fits in kinds if fits and option in known), None)
    return f"; did you mean {meant} {word}?" if meant else ""


@contextmanager
def errors() -> Iterator[None]:
    """Turn every error into its text and its exit status.

    Tell on a terminal when something has to be compiled first.
    """
    if sys.stderr.isatty():
        from coulombus.compiled.notice import on_compiling

        on_compiling(lambda: say("compiling, which takes a minute or two and is kept ..."))
    with _failures():
        yield


@contextmanager
def _failures() -> Iterator[None]:
    """Turn an error into a `Failure`: one that a user can cause by its attribute `exit_status` or
    what it is, all else by FAULT.
    """
    try:
        yield
    except (Failure, click.ClickException, click.exceptions.Exit, click.Abort):
        raise
    except BrokenPipeError:  # the reader of a pipe went away, as `head` does
        abandon_stdout()
        sys.exit(0)
    except Exception as error:
        raise _failure(error) from error


def _failure(error: Exception) -> Failure:
    status = getattr(error, "exit_status", None)
    if status is not None:
        return Failure(str(error), status)
    if isinstance(error, MemoryError):
        return Failure("no memory is left; end other programs, or raise the limit (ulimit -v)", 2)
    if isinstance(error, ModuleNotFoundError) and (error.name or "").startswith("coulombus."):
        room = (error.name or "").split(".")[1]
        text = f"this installation has no coulombus.{room}, which this verb needs: it is the host's alone; install coulombus whole"
        return Failure(text, 2)
    if isinstance(error, OSError):  # a file that cannot be read or written
        if isinstance(error, FileNotFoundError) and not error.filename and not _has_folder():
            return Failure("the current folder is no longer there; change into another one (cd)", 2)
        where = f"{error.filename}: " if error.filename else ""
        full = "; free some space, or write elsewhere" if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        return Failure(f"{where}{error.strerror or error}{full}", 2)
    return Failure(f"a mistake of this program, please report it: {type(error).__name__}: {error}", FAULT)


def _has_folder() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _by_signal(number: int) -> Failure:
    return Failure(told(number), status_of(number))


def _end(failure: Failure) -> NoReturn:
    """Tell what ended a verb, a mistake of this program with its traceback, and end with its
    status.
    """
    with verdict(failure.status):
        if failure.status == FAULT and failure.__cause__ is not None:
            say("".join(traceback.format_exception(failure.__cause__)).rstrip())
        say(f"coulombus: {printable(str(failure))}")
    raise AssertionError("a verdict ends")


def printable(text: str) -> str:
    """Return a text without control characters, by which a stranger's file would command the
    terminal.
    """
    return _CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


def _open_all_streams() -> None:
    """Put /dev/null where the shell has closed stdin, stdout or stderr (``>&-``): else the next
    file that is opened gets its number.
    """
    for fd, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
            if null != fd:
                os.dup2(null, fd)
                os.close(null)
            setattr(sys, name, open(fd, mode, encoding="utf-8"))  # noqa: SIM115


def remark(texts: Iterable[str]) -> None:
    """Say on stderr what a recording or a run lacks, sentence by sentence
    (`recording.signals.Recording.remarks`, `RunResult.losses`).
    """
    for text in texts:
        say(f"coulombus: {printable(text)}")


def load(rig_name: str, overrides: tuple[str, ...]) -> Rig:
    """Load a rig and say on stderr what is allowed in it and yet may not be meant."""
    from coulombus.rigs.rig import load_rig

    rig = load_rig(rig_name, overrides)
    for warning in rig.warnings:
        say(f"warning: {warning}")
    return rig


def check_shared_machine(addresses: Iterable[BusAddress]) -> None:
    """Refuse --shared-machine on a bus that is not built in."""
    real = [str(address) for address in addresses if address.kind != "coulombus"]
    if real:
        text = (
            f"for simulated nodes only: on {real[0]} a motor could push unwatched for 50 ms; choose each limit by --set"
        )
        raise click.BadParameter(text, param_hint="--shared-machine")


def check_mode(rig: Rig, rig_name: str, mode: str) -> None:
    """Refuse a mode that the rig does not have."""
    if mode not in rig.modes:
        raise click.BadParameter(f"{mode!r}: rig {rig_name!r} has {', '.join(rig.modes)}", param_hint="--mode")


def display_s(rig: Rig, seconds: float | None) -> float:
    """Return how long to display: so many seconds, or the rig's schedule."""
    total = rig.schedule_s if seconds is None else seconds
    if not total > 0:
        raise click.UsageError(
            f"the rig {rig.name} has no schedule ([[phase]]) that would tell how long to display: give --seconds"
        )
    return total


def print_json(value: Any) -> None:
    """Print a result to stdout; what goes wrong after it is told on stderr only."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[RESULT] = True


class InputPath(click.Path):
    """A file or a folder that is read.

    One that is not there ends the verb as a missing rig file does, and says what may be meant.
    """

    def __init__(self, *, file_okay: bool = True) -> None:
        super().__init__(file_okay=file_okay, exists=True, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; `Failure` where nothing stands, BadParameter where it is of no use."""
        from coulombus.eds.regular_file import mode_of

        try:
            mode_of(value)
        except FileNotFoundError as error:
            raise Failure(f"{value}: cannot be read ({error.strerror})", 3) from None
        except OSError as error:
            self.fail(f"{value}: {error.strerror}", param, ctx)
        return super().convert(value, param, ctx)


class OutputFile(click.Path):
    """A file that will be written: what forbids it is told before anything is run for it.

    See `recording.output_file`.

    A file that exists is refused unless the verb's parameter `overwrite` is given (`force_option`).

    Parameters
    ----------
    suffixes : endings of the name, one of which it must have; none: any
    dash : whether ``-`` may stand for the standard output
    """

    def __init__(self, *suffixes: str, dash: bool = False) -> None:
        super().__init__(dir_okay=False, path_type=Path)
        self.suffixes, self.dash = suffixes, dash

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; BadParameter says what is wrong with it."""
        if self.dash and str(value) in ("-", "/dev/stdout"):
            return Path("-")
        path = Path(str(super().convert(value, param, ctx)))
        pipe = ".pcapng" in self.suffixes and is_stream(path)  # it may have any name
        if not pipe:
            self._named(path, param, ctx)
        force = None if ctx is None else next((p for p in ctx.command.params if p.name == "overwrite"), None)
        remedy = "choose another name" + (f", or replace it with {force.opts[0]}" if force else "")
        given = ctx is not None and bool(ctx.params.get("overwrite"))
        reason = reason_against(path, force=given, remedy=remedy)
        if reason is not None:
            self.fail(reason, param, ctx)
        if not pipe:
            self._named(path.resolve(), param, ctx)  # what a link stands for would be replaced
        if ctx is not None and param is not None and not is_stream(path):
            first = ctx.meta.setdefault(OUTPUTS, {}).setdefault(path.resolve(), param.opts[0])
            if first != param.opts[0]:
                self.fail(f"{path}: {first} writes there, too; choose another name", param, ctx)
        return path

    def _named(self, path: Path, param: click.Parameter | None, ctx: click.Context | None) -> None:
        if self.suffixes and path.suffix.lower() not in self.suffixes:
            self.fail(f"{path}: expected a name that ends in {', '.join(self.suffixes)}", param, ctx)


class OutputDirectory(click.Path):
    """A directory, made where it is not there yet.

    What forbids it is told before anything is run for it.
    """

    def __init__(self) -> None:
        super().__init__(file_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; BadParameter says what is wrong with it."""
        path = Path(value)
        if path.suffix.lower() == ".toml" and not path.is_dir():
            self.fail(f"{path}: expected a folder, and this is the name of a rig file: --rig {path}", param, ctx)
        super().convert(value, param, ctx)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            self.fail(f"{path}: expected a folder, and it is none", param, ctx)
        except OSError as error:
            self.fail(f"{path}: cannot be made: {error.strerror}", param, ctx)
        return path


class RecordingPlace(OutputFile):
    """Where a run is recorded: a new file ``F.pcapng``, or a folder for segments - one that exists,
    or any name where the verb's parameter `rotate` is given.
    """

    def __init__(self) -> None:
        super().__init__(".pcapng")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; BadParameter says what is wrong with it."""
        path = Path(value)
        rotated = ctx is not None and ctx.params.get("rotate") is not None
        if path.suffix.lower() != ".pcapng" and not is_stream(path) and (path.is_dir() or rotated):
            return OutputDirectory().convert(value, param, ctx)
        return super().convert(value, param, ctx)


PICTURE = OutputFile(".png", ".svg", ".pdf")


class _Seconds(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A length of time in s: a number above 0, at most a year."""

    name = "seconds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            seconds = float(value)
        except ValueError:
            seconds = float("nan")
        if not 0 < seconds <= YEAR_S:
            self.fail(f"{value!r}: expected a number above 0, at most {YEAR_S} (a year), in s", param, ctx)
        return seconds


class _Cpu(click.ParamType):  # type: ignore[type-arg]
    """The number of a CPU that this process may use."""

    name = "cpu"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        from coulombus.wire.realtime import usable_cpus

        allowed = sorted(usable_cpus())
        if not str(value).isdecimal() or int(value) not in allowed:
            self.fail(f"{value!r}: this process may use the CPUs {', '.join(map(str, allowed))}", param, ctx)
        return int(value)


class _BitRate(click.ParamType):  # type: ignore[type-arg]
    """A bit rate in bit/s; k and M stand for a thousand and a million."""

    name = "bit rate"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        found = re.fullmatch(r"(\d{1,9}(?:\.\d{1,6})?)\s*([kM]?)(?:bit/s|bps)?", str(value))
        rate = float(found[1]) * {"": 1, "k": 1e3, "M": 1e6}[found[2]] if found else 0.0
        if not (10_000 <= rate <= 20_000_000 and rate == int(rate)):
            self.fail(f"{value!r}: expected a bit rate from 10k to 20M, such as 1000000, 500k or 1M", param, ctx)
        return int(rate)


YEAR_S = 31_557_600
SECONDS = _Seconds()
CPU = _Cpu()
BIT_RATE = _BitRate()

mode_option = click.option(
    "--mode", type=click.Choice(MODES), default="hybrid", show_default=True, help="Who displays the friction."
)
seconds_option = click.option(
    "--seconds",
    type=SECONDS,
    default=None,
    help="Length of the display.  [default: the rig's schedule]",
)
record_option = click.option(
    "--record", type=OutputFile(".pcapng"), metavar="F.pcapng", help="Record every frame there, in a new file."
)
recording_argument = click.argument("file", type=InputPath())
signals_option = click.option(
    "--signals",
    "signals",
    multiple=True,
    callback=lambda ctx, param, texts: listed(texts),
    metavar="A,B",
    help="Only these signals, by their names.  [default: all]",
)
force_option = click.option(
    "--force", "overwrite", is_flag=True, is_eager=True, help="Replace files that exist; else they are refused."
)
rig_option = click.option(
    "--rig",
    "rig_name",
    default="bench",
    show_default=True,
    metavar="R",
    help="A packaged rig (bench, paper, two_axes) or the path of a rig file.",
)
set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="SECTION.KEY=V",
    help="Set any key of the rig file, as in --set plant.inertia_kg_m2=3e-3. May be given several times.",
)
shared_machine_option = click.option(
    "--shared-machine", is_flag=True, help="Wider limits, for simulated nodes on a machine that does other work, too."
)
faults_option = click.option(
    "--faults",
    type=click.Path(path_type=Path),
    metavar="F.toml",
    help="A fault file: what goes wrong on the bus, and when.",
)
seed_option = click.option("--seed", default=0, show_default=True, help="Start of everything random.")
bus_option = click.option(
    "--bus", "bus_name", metavar="B", help="coulombus:NAME or socketcan:IF.  [default: coulombus:RIG]"
)
buses_option = click.option(
    "--bus",
    "bus_names",
    multiple=True,
    metavar="B",
    help="coulombus:NAME or socketcan:IF; CHANNEL=B for each bus of a rig that has several.  [default: coulombus:RIG]",
)
channel_option = click.option(
    "--channel",
    metavar="C",
    help="Only the axes on this bus of a rig that has several.  [default: all, a process each]",
)
script_option = click.option(
    "--script",
    type=click.Path(path_type=Path),
    metavar="F.toml",
    help="Switch nodes off and on, reset them, let device faults come and go at given times.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON to stdout.")


def table_console(width: int) -> Console:
    """Return the console for a table on stdout: the terminal, or so many columns of a file or a
    pipe.
    """
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=width)


def print_fitting(console: Console, build: Callable[[Collection[str]], Table], leave: Sequence[str]) -> None:
    """Print the table that ``build(left out)`` makes with as few of the columns `leave`, the first
    first, left out as the console's width asks for: no cell of it is cut as long as that helps.
    """
    from rich.measure import Measurement

    left: list[str] = []
    wide = console.options.update(max_width=10_000)
    for name in (None, *leave):
        left += [] if name is None else [name]
        table = build(left)
        if Measurement.get(console, wide, table).maximum <= console.width:
            break
    console.print(table)


def on_terminal(line: str, indent: int) -> str:
    """Return a line of stdout: broken as `hanging` does where a terminal ends, whole in a file or a
    pipe.
    """
    columns = columns_of(sys.stdout)
    return line if columns is None else hanging(line, columns, indent)


def listed(texts: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the names of one option or several, None where there is none."""
    return tuple(name.strip() for text in texts for name in text.split(",") if name.strip()) or None


@contextmanager
def progress(enabled: bool, done: str = "displayed") -> Iterator[Callable[[str, float, float | None], None]]:
    """Show live bars on stderr: call what is yielded with a label, the time reached and the whole
    time (None: nobody knows); `done` is what is said of it.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not enabled or not console.is_terminal:
        yield lambda label, t, total: None
        return
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(40),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
    )
    bars = Progress(*columns, console=console)
    starting = bars.add_task("starting", total=None, told="")
    tasks: dict[str, TaskID] = {}
    shown = suppress(OSError)  # a terminal that was closed takes nothing more: what is shown there goes on without it

    def report(label: str, t: float, total: float | None) -> None:
        with shown:
            if label not in tasks:
                bars.update(starting, visible=False)
                tasks[label] = bars.add_task(label, total=total, told="")
            t = t if total is None else min(t, total)
            whole = "" if total is None else f" of {total:.0f}"
            bars.update(tasks[label], completed=t, told=f"{t:5.1f}{whole} s {done}")

    with shown:
        bars.start()
    try:
        yield report
    finally:
        with shown:
            bars.update(starting, visible=False)
            bars.stop()
