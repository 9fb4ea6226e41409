"""Checks of a machine: its files and programs, the outcomes, and the execution, which never raises."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shlex
import socket
import struct
import subprocess
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from coulombus.system.quoting import comment
from coulombus.system.realtime import cpu_list

__all__ = [
    "Absent",
    "CannotRead",
    "Check",
    "CheckResult",
    "Machine",
    "Outcome",
    "examine",
    "hardware_stamps",
    "nonsense",
    "run_program",
    "script",
]

MOST_BYTES = 1 << 20
PROGRAM_S = 10.0
SIOCETHTOOL, ETHTOOL_GET_TS_INFO = 0x8946, 0x41
SOF_TIMESTAMPING_RX_HARDWARE = 1 << 2
SHOWN = 40  # shown characters of an invalid text


class CannotRead(Exception):
    """A value for a check cannot be read; the text has the value and the reason."""


class Absent(CannotRead):
    """The file or program does not exist, which is a valid result for many checks."""


def run_program(words: Sequence[str]) -> str:
    """Return the output of a program; CannotRead if it is not installed, fails, or does not end."""
    try:
        done = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROGRAM_S,
            env={**os.environ, "LC_ALL": "C"},
            check=False,
        )
    except FileNotFoundError:
        raise Absent(f"{words[0]} is not installed") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CannotRead(f"{shlex.join(words)}: {error}") from None
    if done.returncode != 0:
        raise CannotRead(f"{shlex.join(words)}: {done.stderr.strip() or f'status {done.returncode}'}")
    return done.stdout


def hardware_stamps(interface: str) -> bool:
    """Return whether the interface stamps received frames in hardware; CannotRead if it does not report it."""
    info = bytearray(struct.pack("<I40x", ETHTOOL_GET_TS_INFO))
    place = (ctypes.c_char * len(info)).from_buffer(info)
    request = struct.pack("16sP", interface.encode(), ctypes.addressof(place)) + bytes(16)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
            fcntl.ioctl(asker, SIOCETHTOOL, request)
    except OSError as error:
        raise CannotRead(f"{interface} does not tell how it stamps: {error.strerror}") from None
    return bool(struct.unpack_from("<I", info, 4)[0] & SOF_TIMESTAMPING_RX_HARDWARE)


@dataclass(frozen=True)
class Machine:
    """Interface of the checks to a machine.

    Attributes
    ----------
    root : the folder in place of ``/``
    ask : runs a program and returns its output; raises CannotRead
    stamps : returns whether an interface stamps frames in hardware; raises CannotRead
    """

    root: Path = Path("/")
    ask: Callable[[Sequence[str]], str] = run_program
    stamps: Callable[[str], bool] = hardware_stamps

    def path(self, name: str) -> Path:
        """Return the path of the machine's file `name`."""
        return self.root / name.lstrip("/")

    def text(self, name: str) -> str:
        """Return the text of a file, stripped, at most a megabyte.

        Raises
        ------
        Absent
            there is no such file
        CannotRead
            the file exists, but cannot be read
        """
        try:
            fd = os.open(self.path(name), os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
            with os.fdopen(fd, "rb") as file:
                return file.read(MOST_BYTES).decode(errors="replace").strip()
        except OSError as error:
            kind = Absent if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ENODEV) else CannotRead
            raise kind(f"{name} cannot be read: {error.strerror}") from None

    def number(self, name: str) -> int:
        """Return the integer in a file; CannotRead if there is none."""
        text = self.text(name)
        try:
            return int(text)
        except ValueError:
            raise nonsense(name, text, "an integer") from None

    def names(self, folder: str) -> list[str]:
        """Return the sorted names in a folder; empty if folder not found."""
        try:
            return sorted(path.name for path in self.path(folder).iterdir())
        except (FileNotFoundError, NotADirectoryError):
            return []
        except OSError as error:
            raise CannotRead(f"{folder} cannot be read: {error.strerror}") from None

    def cpus(self, name: str) -> frozenset[int]:
        """Return the CPUs of a list in the kernel's format, ``0-2,4``; CannotRead if it is not valid."""
        text = self.text(name)
        try:
            return cpu_list(text)
        except ValueError:
            raise nonsense(name, text, "a list of CPUs, as in 0-2,4") from None

    def online(self) -> frozenset[int]:
        """Return the online CPUs; CannotRead if the machine does not list them."""
        return self.cpus("/sys/devices/system/cpu/online")

    @property
    def root_user(self) -> bool:
        """Whether this process runs as root; CannotRead if that is unknown."""
        return self.status("Uid").split()[1:2] == ["0"]

    def status(self, key: str) -> str:
        """Return the value of a line of /proc/self/status; CannotRead if there is none."""
        for line in self.text("/proc/self/status").splitlines():
            name, colon, value = line.partition(":")
            if colon and name == key:
                return value.strip()
        raise CannotRead(f"/proc/self/status has no {key}")

    def capable(self, bit: int) -> bool:
        """Whether this process has a capability; CannotRead if that is unknown."""
        text = self.status("CapEff")
        try:
            return bool(int(text, 16) >> bit & 1)
        except ValueError:
            raise nonsense("/proc/self/status", text, "capabilities in hexadecimal digits") from None


def nonsense(name: str, text: str, expected: str) -> CannotRead:
    """Return the error for a file with unexpected content."""
    return CannotRead(f"{name} cannot be read: got {text[:SHOWN]!r}, expected {expected}")


class Outcome(NamedTuple):
    """Outcome of a check: whether it is ok, what it found, and the command that fixes it.

    Without such a command, the fix is a comment of the shell: ``# ...``.
    """

    ok: bool
    found: str
    fix: str = ""


Check: TypeAlias = tuple[str, Callable[[], Outcome]]
"""A check's name (SUBJECT.NAME) and its function."""


@dataclass(frozen=True)
class CheckResult:
    """The outcome of the check `check`."""

    check: str
    ok: bool
    found: str
    fix: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    """Figures of the latency test; else empty."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, without empty `figures`."""
        fields = asdict(self)
        return fields if self.figures else {name: fields[name] for name in fields if name != "figures"}


def examine(checks: Iterable[Check]) -> list[CheckResult]:
    """Run the checks.

    An unreadable value is reported as unknown, not as ok.
    """
    findings = []
    for name, check in checks:
        try:
            outcome = check()
        except CannotRead as error:
            outcome = Outcome(False, str(error), "# look at it by hand")
        except Exception as error:
            text = f"this check failed: {type(error).__name__}: {error}"
            outcome = Outcome(False, text, "# internal error, please report it")
        findings.append(CheckResult(name, outcome.ok, _line(outcome.found), "" if outcome.ok else outcome.fix))
    return findings


def _line(text: str) -> str:
    return " ".join(text.split())


def script(findings: Iterable[CheckResult]) -> str:
    """Return a shell script of all fixes, each once, with the findings as comments."""
    lines = ["#!/bin/sh", "# made by `coulombus doctor --fix`: read it before you run it", "set -eu", ""]
    done: set[str] = set()
    for finding in findings:
        if finding.ok or finding.fix in done:
            continue
        done.add(finding.fix)
        lines += [f"# {finding.check}: {comment(finding.found)}", finding.fix or "# no command fixes it", ""]
    if not done:
        lines += ["# nothing to fix", ""]
    return "\n".join(lines)
