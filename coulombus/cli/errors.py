"""Errors and signals that end a verb, as texts and exit statuses; the statuses have their single definition here.

Errors are printed to stderr, and with --json also to stdout. An exception that ends a verb has its status as
`exit_status`. A closed reader of stdout (``| head``) does not change the status: a verb with a verdict still ends
with it, and one that only prints (`decode`, `watch`, `dbc`) ends with 0. `emulate` and `node` continue until they are
stopped.
"""

from __future__ import annotations

import difflib
import errno
import json
import os
import re
import select
import signal
import socket
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from types import MappingProxyType
from typing import Any, NoReturn

import click

from coulombus.cli.tables import echo
from coulombus.system.c_library import NeedsLinux
from coulombus.system.errors import CoulombusError
from coulombus.system.exit import abandon_stdout, say, verdict
from coulombus.system.foreign_text import printable
from coulombus.system.stop_signals import Stopped, as_exceptions, end_line, raised, status_of

__all__ = [
    "EXIT_STATUS",
    "FAULT",
    "STATUSES",
    "Failure",
    "Verbs",
    "errors",
    "print_json",
    "remark",
]

FAULT = 70
"""Internal error: EX_SOFTWARE of sysexits.h.

It differs from all statuses on a rig or a file.
"""

STATUSES: Mapping[int, str] = MappingProxyType(
    {
        0: "ok",
        1: "a check failed",
        2: "usage: a wrong option or argument, a recording that cannot be read, a file that cannot be written, no memory left",
        3: "configuration: any file missing; rig, EDS, law, motion, fault or script file wrong; a device that differs from its files",
        4: "bus unavailable, or a system other than Linux where Linux is needed",
        5: "a node is missing",
        6: "a node aborted an SDO transfer, or its response is invalid",
        7: "safety: arming refused, or a trip led to the safe state (for example, a recording that cannot be continued)",
        8: "deadlines or frames lost beyond the limit",
        FAULT: "internal error, with a traceback: please report it",
        129: "the terminal was closed (SIGHUP); `emulate`, `node`, `watch` and `bridge` end with 0 by any of these signals once they run",
        130: "interrupted by Ctrl-C (SIGINT)",
        131: "interrupted by Ctrl-Backslash (SIGQUIT)",
        143: "terminated (SIGTERM)",
    }
)
"""Status -> meaning."""

EXIT_STATUS = "Exit status: 0 is ok; 'coulombus help exit' lists the others."
"""The last line of a verb's help."""

LINUX_MODULES = ("fcntl", "resource", "termios", "tty")

OTHER_VERBS = {
    ("emulate", "--eds"): "`coulombus node FILE` simulates the device of an EDS file.",
    ("simulate", "--eds"): "`coulombus node FILE` simulates the device of an EDS file.",
    ("check", "--eds"): "`coulombus eds check FILE` checks an EDS file, `coulombus explain LOG --eds 5=FILE` a log.",
    ("decode", "--dbc"): "--eds takes the devices' EDS files; `coulombus dbc` writes a DBC file for other tools.",
}
"""What to do instead of an option that a verb does not have."""

WORDS, RESULT, OUTPUTS = f"{__name__}.words", f"{__name__}.result", f"{__name__}.outputs"
"""Keys of a context: the words after the verb, whether the result has been printed, and the output file of each option.
"""


class Failure(Exception):
    """An error that ends a verb: a text and an exit status."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.status = status


class Verbs(click.Group):
    """The verbs. An error before the result is printed to stderr.

    With --json it is also an object on stdout.

    Ctrl-C gives exit status 130 at any time, even while a verb loads its modules; the same holds
    for the other signals of `system.stop_signals`. An unexpected exception is an internal error: it
    is reported with its place, and never as a failed check.
    """

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Parse the words up to the verb; ``--help`` and ``--version`` print here, perhaps to a broken stdout."""
        try:
            with _failures():
                return super().make_context(info_name, args, parent, **extra)
        except Failure as failure:
            _end(failure)
        except click.ClickException as error:
            _refuse(error)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Store the words, so that --json is known even if the rest is refused."""
        _open_all_streams()
        ctx.meta[WORDS] = tuple(args)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb."""

        def print_error(text: str, status: int) -> None:
            if "--json" in ctx.meta.get(WORDS, ()) and RESULT not in ctx.meta:
                with suppress(OSError):  # a broken stdout is reported on stderr
                    echo(json.dumps({"event": "error", "error": text, "exit_status": status}))

        try:
            try:
                with as_exceptions(), _failures():
                    return super().invoke(ctx)
            except click.UsageError as error:
                meant = _option_meant(error)
                if other := _of_other_verbs(error):
                    raise click.UsageError(other, error.ctx) from None
                if isinstance(error, click.NoSuchOption):  # for --mod, suggest --mode, not --record
                    begun = [option for option in error.possibilities or () if option.startswith(error.option_name)]
                    if begun:
                        raise click.NoSuchOption(error.option_name, None, begun, error.ctx) from None
                raise click.UsageError(f"{error.format_message()}{meant}", error.ctx) if meant else error from None
            except Stopped as stopped:
                raise Failure(f"ended by {stopped}", status_of(stopped.number)) from None
            except KeyboardInterrupt:
                raise _by_signal(signal.SIGINT) from None
        except Failure as failure:
            if failure.status == FAULT and raised():  # a consequence of the signal's exception
                failure = _by_signal(raised())
            print_error(str(failure), failure.status)
            _end(failure)
        except click.ClickException as error:
            print_error(error.format_message(), error.exit_code)
            _refuse(error)


def _refuse(error: click.ClickException) -> NoReturn:
    """Print click's error without control characters, and for a wrong option or argument one line on where the
    help is; exit with its status.
    """
    if isinstance(error, click.UsageError) and not isinstance(error, click.exceptions.NoArgsIsHelpError):
        with verdict(error.exit_code):
            if error.ctx is not None:
                say(f"Try '{error.ctx.command_path} --help' for help.")
            say(f"Error: {error.format_message()}")
    error.message = printable(error.message)  # type: ignore[misc]  # Final to typeshed alone
    raise error from None


def _of_other_verbs(error: click.UsageError) -> str:
    """Return an error on an option of another verb, or ""."""
    if not isinstance(error, click.NoSuchOption) or error.ctx is None:
        return ""
    instead = OTHER_VERBS.get((error.ctx.info_name or "", error.option_name))
    return f"No such option '{error.option_name}'. {instead}" if instead else ""


def _option_meant(error: click.UsageError) -> str:
    """Return the suggested or missing option as the end of the error's sentence, or ""."""
    verb = re.fullmatch(r"No such command '(\S+)'\.?", error.message)  # click has found no similar one
    if verb is not None and error.ctx is not None and isinstance(error.ctx.command, click.Group):
        name = verb[1].lower().removesuffix("_command").replace("_", "-")
        if name == "version":
            name = "--version"
        return f" Did you mean '{name}'?" if name in (*error.ctx.command.commands, "--version") else ""
    if isinstance(error, click.MissingParameter) and error.param is not None and "--bus" in error.param.opts:
        from coulombus.wire.address import live_bus_names

        names = ", ".join(f"coulombus:{name}" for name in live_bus_names())
        served = f"These are served: {names}" if names else "No virtual bus is served; `coulombus emulate` serves one"
        return f" {served}. A CAN interface is --bus socketcan:can0."
    if isinstance(error, click.BadParameter) and error.param is not None and isinstance(error.param.type, click.Choice):
        choice = (re.match(r"'([^']*)' is not one of", error.message) or ("", ""))[1].lower()
        near = difflib.get_close_matches(choice, map(str, error.param.type.choices), 1, 0.6)
        return f" Did you mean '{near[0]}'?" if near else ""
    comma = re.match(r"'?([-+]?\d+),(\d+)'?\b.*(a number|float|integer|range)", error.message)
    if isinstance(error, click.BadParameter) and comma:
        point = f"id you mean {comma[1]}.{comma[2]}?"
        return f" D{point}" if error.message.endswith(".") else f"; d{point}"
    extra = re.fullmatch(r"Got unexpected extra arguments? \((\S+).*\)", error.message)
    if extra is None or error.ctx is None:
        return ""
    word = extra[1]
    params = {option: param for param in error.ctx.command.params for option in param.opts}
    words = error.ctx.meta.get(WORDS, ())
    place = words.index(word) if word in words else 0
    if words[max(0, place - 2) : place - 1] == ("--set",) and "=" not in words[place - 1]:
        return f"; did you mean --set {words[place - 1]}={word}?"
    modes = getattr(params["--mode"].type, "choices", ()) if "--mode" in params else ()
    kinds = (
        ("--bus", re.match(r"(coulombus|socketcan):", word)),
        ("--record", word.endswith(".pcapng")),
        ("--mode", word in modes),
        ("--rig", word.endswith(".toml") or word in ("bench", "paper", "plane", "two_axes")),
    )
    meant = next((option for option, fits in kinds if fits and option in params), None)
    return f"; did you mean {meant} {word}?" if meant else ""


@contextmanager
def errors() -> Iterator[None]:
    """Turn every error into its text and its exit status.

    Announce the first compilation on the process' stderr.
    """
    if sys.stderr is sys.__stderr__:
        from coulombus.kernels.compile_notice import on_compiling

        on_compiling(lambda: say("compiling, which takes a minute or two and is kept ..."))
    with _failures():
        yield


@contextmanager
def _failures() -> Iterator[None]:
    """Turn an error into a `Failure`: the project's errors by their `exit_status`, system errors
    that a user can cause by their type, all others as FAULT.
    """
    try:
        yield
    except (Failure, click.ClickException, click.exceptions.Exit, click.Abort):
        raise
    except BrokenPipeError:  # the reader of a pipe closed it, as `head` does
        abandon_stdout()
        sys.exit(0)
    except CoulombusError as error:
        raise Failure(str(error), error.exit_status) from error
    except Exception as error:
        raise _failure(error) from error


def _failure(error: Exception) -> Failure:
    absent = _needs_linux(error)
    if absent:
        return Failure(str(NeedsLinux(absent)), NeedsLinux.exit_status)
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
    kernels = sys.modules.get("coulombus.kernels.decorator")
    if kernels is not None and kernels.CACHE_DIR is not None:
        from coulombus.kernels.kernel_cache import damaged, empty

        if damaged(error):
            empty(kernels.CACHE_DIR)
            return Failure(f"the compiled code in {kernels.CACHE_DIR} was damaged and is removed; start again", 2)
    return Failure(f"internal error, please report it: {type(error).__name__}: {error}", FAULT)


def _needs_linux(error: Exception) -> str:
    """Return the Linux feature that an error misses; "" for other errors."""
    if isinstance(error, ModuleNotFoundError) and error.name in LINUX_MODULES:
        return error.name
    if isinstance(error, AttributeError):
        return next(
            (f"{module.__name__}.{error.name}" for module in (os, select, signal, socket) if error.obj is module), ""
        )
    return ""


def _has_folder() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _by_signal(number: int) -> Failure:
    return Failure(end_line(number), status_of(number))


def _end(failure: Failure) -> NoReturn:
    """Print the error that ended a verb, an internal error with its traceback, and exit with its status."""
    if isinstance(failure.__cause__, OSError):
        try:
            sys.stdout.flush()
        except (OSError, ValueError):
            abandon_stdout()  # stdout is broken: `failure` says so, and the end does not repeat it
    with verdict(failure.status):
        if failure.status == FAULT and failure.__cause__ is not None:
            say("".join(traceback.format_exception(failure.__cause__)).rstrip())
        say(f"coulombus: {failure}")
    raise AssertionError("a verdict ends")


def _open_all_streams() -> None:
    """Open /dev/null for a closed stdin, stdout or stderr (``>&-``): otherwise the next opened file
    gets its descriptor.
    """
    for fd, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)  # the lowest free descriptor
            if null != fd:
                os.dup2(null, fd)
                os.close(null)
            setattr(sys, name, open(fd, mode, encoding="utf-8"))  # noqa: SIM115


def remark(texts: Iterable[str]) -> None:
    """Print the remarks on a recording or a run to stderr, sentence by sentence
    (`recording.signals.Recording.remarks`, `RunResult.losses`).
    """
    for text in texts:
        say(f"coulombus: {text}")


def print_json(value: Any) -> None:
    """Print a result to stdout; later errors go to stderr only."""
    echo(json.dumps(value, indent=2, allow_nan=False))
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[RESULT] = True
