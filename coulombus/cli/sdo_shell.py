"""The shell of ``coulombus sdo NODE``: lines of commands, completion of names, a history."""

from __future__ import annotations

import cmd
import os
import shlex
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import click

from coulombus.cli.tables import echo
from coulombus.eds.reader import EdsError
from coulombus.eds.sdo_frames import where
from coulombus.host.devices.device import KnownDevice
from coulombus.host.devices.nmt import COMMANDS, command
from coulombus.host.devices.running_host import check_alone
from coulombus.host.errors import HostError
from coulombus.host.sdo.sdo_client import store_parameters
from coulombus.system.exit import say
from coulombus.system.stop_signals import Stopped, forget
from coulombus.wire.address import BusUnavailable
from coulombus.wire.bus_link import BusLink

__all__ = ["Shell", "run"]

MOST_LISTED = 40
HISTORY_LINES = 1000


class Shell(cmd.Cmd):
    """The commands: get, set, ls, store, nmt, help, quit."""

    doc_header = "Commands (help COMMAND):"

    def __init__(self, link: BusLink, device: KnownDevice, *, beside: bool) -> None:
        super().__init__(stdin=sys.stdin)
        self._link, self.device, self._beside = link, device, beside
        self.interactive = sys.stdin.isatty()
        self.use_rawinput = self.interactive
        self.prompt = f"node {device.node_id}> " if self.interactive else ""

    # commands

    def do_get(self, line: str) -> None:
        """Read an object by number (6041h, 1018h:01) or name: get OBJECT."""
        (name,) = self._words(line, 1)
        reading = self.device.read(self.device.find(name))
        echo(str(reading))
        if reading.remark:
            say(reading.remark)

    def do_set(self, line: str) -> None:
        """Write an object and read it back: set OBJECT VALUE.

        "0.5 Nm" is converted, a number alone is raw.
        """
        name, value = self._words(line, 2)
        variable = self.device.find(name)
        data = self.device.parse(variable, value)
        self._alone()
        back = self.device.write(variable, data)
        echo("written" if back is None else str(back))

    def do_ls(self, line: str) -> None:
        """List the objects whose number or name has a text: ls [TEXT]."""
        text = line.strip().lower()
        rows = [
            (where(variable.index, variable.subindex), variable.access, name)
            for name, variable in self.device.names.items()
        ]
        rows = [row for row in rows if text in f"{row[0]} {row[2]}".lower()]
        shown = rows if not self.interactive else rows[:MOST_LISTED]
        for place, access, name in shown:
            echo(f"{place}  {access:<5}  {name}")
        if len(shown) < len(rows):
            echo(f"... and {len(rows) - len(shown)} more: ls TEXT lists those with the text")

    def do_store(self, line: str) -> None:
        """Let the device keep its parameters when it is switched off (1010h:01): store."""
        self._alone()
        store_parameters(self._link, self.device.node_id)
        echo("stored")

    def do_nmt(self, line: str) -> None:
        """Send the node a command: nmt start|stop|preop|reset|reset-communication."""
        (word,) = self._words(line, 1)
        if word not in COMMANDS:
            raise click.UsageError(f"{word!r}: expected one of {', '.join(COMMANDS)}")
        self._alone()
        for answer in command(self._link, word, self.device.node_id):
            echo(str(answer))

    def do_quit(self, line: str) -> bool:
        """End (Ctrl-D, too): quit."""
        return True

    def do_EOF(self, line: str) -> bool:
        """Ctrl-D: end."""
        if self.interactive:
            echo()
        return True

    def emptyline(self) -> bool:
        """Ignore an empty line; the last command is not repeated, because it may have written."""
        return False

    def default(self, line: str) -> None:
        """Refuse an unknown command."""
        commands = ", ".join(name[3:] for name in self.get_names() if name.startswith("do_") and name != "do_EOF")
        raise click.UsageError(f"{line.split()[0]!r} is not a command; expected one of {commands}")

    # completion

    def completenames(self, text: str, *_: object) -> list[str]:
        """Return the commands that begin with a text."""
        return [name for name in super().completenames(text) if name != "EOF"]

    def complete_get(self, text: str, line: str, begin: int, end: int) -> list[str]:
        """Return the names of objects that begin with a text."""
        return _beginning(text, self.device.names)

    def complete_set(self, text: str, line: str, begin: int, end: int) -> list[str]:
        """Return the names of objects that begin with a text, in the first place."""
        return _beginning(text, self.device.names) if len(line[:begin].split()) == 1 else []

    complete_ls = complete_get

    def complete_nmt(self, text: str, line: str, begin: int, end: int) -> list[str]:
        """Return the NMT commands that begin with a text."""
        return _beginning(text, COMMANDS)

    # course

    def onecmd(self, line: str) -> bool:
        """Execute one line; errors are printed, and the shell continues unless the bus has closed."""
        try:
            return bool(super().onecmd(line))
        except BusUnavailable:
            raise
        except (HostError, EdsError, OSError, ValueError, click.UsageError) as error:
            if not self.interactive:
                raise
            say(error.format_message() if isinstance(error, click.UsageError) else str(error))
        except Stopped:
            raise
        except KeyboardInterrupt:
            if not self.interactive:
                raise
            forget()
            say("interrupted")
        return False

    def _alone(self) -> None:
        host = check_alone(self._link, self._link.address, beside=self._beside)
        if host:
            say(f"a host is on the bus: {host}; its display may be disturbed")

    def _words(self, line: str, count: int) -> list[str]:
        """Return the words of a line; the last one contains the rest."""
        try:
            words = shlex.split(line)
        except ValueError as error:
            raise click.UsageError(f"{line!r}: {error}") from None
        if len(words) < count:
            raise click.UsageError(f"expected {count} word{'s' * (count > 1)}; `help` tells which")
        return [*words[: count - 1], " ".join(words[count - 1 :])]


def _beginning(text: str, words: Iterable[str]) -> list[str]:
    return [word for word in words if word.lower().startswith(text.lower()) and word.isprintable()]


def _history() -> Path:
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base, "coulombus", "sdo_history")


def _with_readline() -> Callable[[], None]:
    """Read the history; return a function that writes it. Without readline there is no history."""
    try:
        import readline
    except ImportError:
        return lambda: None
    readline.set_completer_delims(" \t\n")  # names have "-", "." and brackets
    path = _history()
    with suppress(OSError):
        readline.read_history_file(path)

    def write() -> None:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            readline.set_history_length(HISTORY_LINES)
            readline.write_history_file(path)

    return write


def run(shell: Shell) -> None:
    """Process lines until the end."""
    if not shell.interactive:
        shell.cmdloop()
        return
    write = _with_readline()
    described = shell.device.description
    say(f"{described.path if described else 'no EDS file: objects have numbers only'}; help, Tab, Ctrl-D ends")
    try:
        while True:
            try:
                shell.cmdloop()
                return
            except Stopped:
                raise
            except KeyboardInterrupt:  # at the prompt: discard the line
                forget()
                echo()
    finally:
        write()
