"""Common parts of the converters: numbers in files of sysfs, and claims on them.

Every access opens its file anew: an unplugged converter is detected at once, and found again when
it is back. A channel's value is a number in its own unit, `raw`.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from coulombus.system.errors import CoulombusError
from coulombus.system.file_lock import lock_file

__all__ = ["Claim", "HardwareError", "Input", "Output", "SafeWrite", "SysfsFile", "file_errors", "finite", "put"]

MOST_BYTES = 64
_INTEGER = re.compile(r"[+-]?\d{1,20}")


class HardwareError(CoulombusError):
    """A converter is missing, refuses, or returns an impossible value; the text names it."""

    exit_status = 3


class SafeWrite(NamedTuple):
    """A write that makes an output safe, for a process without further knowledge of it."""

    path: str
    """A file of sysfs, or ``board.py:Class`` of a Python class."""
    text: str
    """Text to write; for a Python class a mapping as JSON."""


class Input(Protocol):
    """A channel that is read once per period."""

    def read(self) -> float:
        """Return the present value; HardwareError if there is none."""


class Output(Protocol):
    """A channel that is written once per period."""

    def write(self, raw: float) -> None:
        """Output the value."""

    def read_back(self) -> float:
        """Return the present output value."""

    def spelled(self, raw: float) -> float:
        """Return the expected value of `read_back` after `write` of this value."""

    def orders(self, raw: float) -> Sequence[SafeWrite]:
        """Return the writes that output the value."""


@contextmanager
def file_errors(path: str) -> Iterator[None]:
    """Convert errors of the system to a HardwareError that names the file."""
    try:
        yield
    except OSError as error:
        raise HardwareError(f"{path}: {error.strerror or error}") from None


def finite(value: object, where: str) -> float:
    """Return a number from foreign code.

    Raises
    ------
    HardwareError
        The value is not a number, or not finite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise HardwareError(f"{where}: got {str(value)[:MOST_BYTES]!r}, expected a finite number")
    return float(value)


def put(path: str, text: str) -> None:
    """Write a text to an existing file, in one call.

    Raises
    ------
    HardwareError
        The file does not exist, or refuses.
    """
    with file_errors(path):
        descriptor = os.open(path, os.O_WRONLY | os.O_TRUNC | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            os.write(descriptor, text.encode())
        finally:
            os.close(descriptor)


@dataclass(frozen=True)
class SysfsFile:
    """A number in a file of sysfs: value = (count + offset) * scale, both 1:1 by default."""

    path: str
    scale: float = 1.0
    offset: float = 0.0

    def count(self) -> float:
        """Return the number in the file."""
        with file_errors(self.path):
            descriptor = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
            try:
                data = os.read(descriptor, MOST_BYTES + 1)
            finally:
                os.close(descriptor)
        text = data.decode("ascii", "replace").strip()
        if _INTEGER.fullmatch(text):
            return int(text)
        try:
            number = float(text) if len(data) <= MOST_BYTES else math.nan
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise HardwareError(f"{self.path}: got {text[:MOST_BYTES]!r}, expected a number")
        return number

    def _counts(self, raw: float) -> int:
        return round(raw / self.scale - self.offset)

    def read(self) -> float:
        """Return the value."""
        return (self.count() + self.offset) * self.scale

    def write(self, raw: float) -> None:
        """Write the integer count nearest to the value."""
        put(self.path, f"{self._counts(raw)}\n")

    def read_back(self) -> float:
        """Return the value in the file."""
        return self.read()

    def spelled(self, raw: float) -> float:
        """Return the value of the nearest integer count."""
        return (self._counts(raw) + self.offset) * self.scale

    def orders(self, raw: float) -> Sequence[SafeWrite]:
        """Return the one write that outputs the value."""
        return (SafeWrite(self.path, f"{self._counts(raw)}\n"),)


class Claim:
    """A lock on the file of an output: only one process drives it.

    The open file description holds it, so a process that inherits the descriptor also does; the kernel
    releases it when the last of them ends.
    """

    def __init__(self, path: str) -> None:
        with file_errors(path):
            self.descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        try:
            lock_file(self.descriptor)
        except OSError as error:
            os.close(self.descriptor)
            if isinstance(error, BlockingIOError):
                raise HardwareError(f"{path}: another process drives it already; end that one first") from None
            raise HardwareError(f"{path}: {error.strerror}") from None

    def close(self) -> None:
        """Release the lock."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1
