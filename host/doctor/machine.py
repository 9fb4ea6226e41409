"""The machine that is looked at: files below a root folder, and the programs that are asked."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shlex
import socket
import struct
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from coulombus.system.realtime import cpu_list

__all__ = ["Absent", "CannotRead", "Machine", "hardware_stamps", "nonsense", "run_program"]

MOST_BYTES = 1 << 20
PROGRAM_S = 10.0
SIOCETHTOOL, ETHTOOL_GET_TS_INFO = 0x8946, 0x41
SOF_TIMESTAMPING_RX_HARDWARE = 1 << 2
SHOWN = 40  # characters of what makes no sense


class CannotRead(Exception):
    """What a check wanted to know cannot be read; the text says what and why."""


class Absent(CannotRead):
    """There is no such file: for many a check this is an answer."""


def run_program(words: Sequence[str]) -> str:
    """Return what a program prints; CannotRead where it is not there, fails, or does not end."""
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
    """Tell whether the interface stamps what it receives itself; CannotRead where it does not
    say.
    """
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
    """A machine as the checks see it.

    Attributes
    ----------
    root : the folder that stands for ``/``
    ask : runs a program and returns what it prints; raises CannotRead
    stamps : tells whether an interface stamps frames itself; raises CannotRead
    """

    root: Path = Path("/")
    ask: Callable[[Sequence[str]], str] = run_program
    stamps: Callable[[str], bool] = hardware_stamps

    def path(self, name: str) -> Path:
        """Return where the file `name` of the machine is."""
        return self.root / name.lstrip("/")

    def text(self, name: str) -> str:
        """Return what a file holds, without the blanks around it; at most a megabyte.

        Raises
        ------
        Absent
            there is no such file
        CannotRead
            it is there, and cannot be read
        """
        try:
            fd = os.open(self.path(name), os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
            with os.fdopen(fd, "rb") as file:
                return file.read(MOST_BYTES).decode(errors="replace").strip()
        except OSError as error:
            kind = Absent if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ENODEV) else CannotRead
            raise kind(f"{name} cannot be read: {error.strerror}") from None

    def number(self, name: str) -> int:
        """Return the integer that a file holds; CannotRead where it holds none."""
        text = self.text(name)
        try:
            return int(text)
        except ValueError:
            raise nonsense(name, text, "an integer") from None

    def names(self, folder: str) -> list[str]:
        """Return the names in a folder, sorted; none where there is no such folder."""
        try:
            return sorted(path.name for path in self.path(folder).iterdir())
        except (FileNotFoundError, NotADirectoryError):
            return []
        except OSError as error:
            raise CannotRead(f"{folder} cannot be read: {error.strerror}") from None

    def cpus(self, name: str) -> frozenset[int]:
        """Return the CPUs of a list as the kernel writes it: ``0-2,4``; CannotRead where it is
        none.
        """
        text = self.text(name)
        try:
            return cpu_list(text)
        except ValueError:
            raise nonsense(name, text, "a list of CPUs, as in 0-2,4") from None

    def online(self) -> frozenset[int]:
        """Return the CPUs that are running; CannotRead where that is not told."""
        return self.cpus("/sys/devices/system/cpu/online")

    @property
    def root_user(self) -> bool:
        """Whether this process is root's; CannotRead where that is not told."""
        return self.status("Uid").split()[1:2] == ["0"]

    def status(self, key: str) -> str:
        """Return a line of /proc/self/status; CannotRead where there is none."""
        for line in self.text("/proc/self/status").splitlines():
            name, colon, value = line.partition(":")
            if colon and name == key:
                return value.strip()
        raise CannotRead(f"/proc/self/status has no {key}")

    def capable(self, bit: int) -> bool:
        """Whether this process has a capability; CannotRead where that is not told."""
        text = self.status("CapEff")
        try:
            return bool(int(text, 16) >> bit & 1)
        except ValueError:
            raise nonsense("/proc/self/status", text, "capabilities in hexadecimal digits") from None


def nonsense(name: str, text: str, expected: str) -> CannotRead:
    """Return the error of a file that holds something else than it should."""
    return CannotRead(f"{name} cannot be read: got {text[:SHOWN]!r}, expected {expected}")
