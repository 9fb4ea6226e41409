"""Converters supported by Linux, as numbers in files of sysfs, and claims on them.

    IIO      DEVICE/out_voltageN_raw, DEVICE/in_voltageN_raw    value = (raw + offset) * scale
    PWM      CHIP/pwmN/period, duty_cycle, enable               nanoseconds
    counter  DEVICE/countN/count

The kernel documents these files in Documentation/ABI/testing/sysfs-bus-iio, sysfs-class-pwm,
sysfs-bus-counter.

Every access opens its file anew: an unplugged converter is detected at once, and found again when
it is back. A channel's value is a number in its own unit, `raw`.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from coulombus.system.errors import CoulombusError
from coulombus.system.file_lock import lock_file

__all__ = [
    "COUNTERS",
    "IIO",
    "PWM",
    "Claim",
    "HardwareError",
    "Input",
    "Output",
    "PwmOutput",
    "SafeWrite",
    "SysfsFile",
    "counter",
    "file_errors",
    "find",
    "finite",
    "iio",
    "put",
]

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


IIO = Path("/sys/bus/iio/devices")
PWM = Path("/sys/class/pwm")
COUNTERS = Path("/sys/bus/counter/devices")


def find(root: Path, device: str) -> Path:
    """Return a device's folder, given by its path, its name below `root`, or the content of its file `name`.

    The kernel numbers devices in the order of detection; `name` is stable.

    Raises
    ------
    HardwareError
        No device has the name, or several have it.
    """
    if "/" in device:
        path = Path(device)
        if not path.is_dir():
            raise HardwareError(f"{device}: folder not found")
        return path
    if (root / device).is_dir():
        return root / device
    names: dict[Path, str] = {}
    for folder in sorted(root.glob("*")):
        with suppress(OSError):
            names[folder] = (folder / "name").read_text(errors="replace").strip()
    folders = [folder for folder, name in names.items() if name == device]
    if len(folders) == 1:
        return folders[0]
    if folders:
        raise HardwareError(f"{root}: {len(folders)} devices are called {device!r}; give the path of one")
    listed = ", ".join(f"{folder.name} ({name})" for folder, name in names.items()) or "none"
    raise HardwareError(f"{root}: there is no device {device!r}; there are: {listed}")


def iio(device: str, channel: str, *, scaled: bool) -> SysfsFile:
    """Return a channel of an IIO device, such as ``in_voltage0`` or ``out_voltage1``.

    With `scaled` its value has IIO's unit (mV, mA, milli degrees C ...), from the files
    ``CHANNEL_scale`` and ``CHANNEL_offset``, or those of the channel's type; otherwise it is the
    converter's count.
    """
    folder = find(IIO, device)
    path = folder / f"{channel}_raw"
    if not path.exists():
        channels = sorted(file.name.removesuffix("_raw") for file in folder.glob("*_raw"))
        raise HardwareError(f"{folder}: it has no channel {channel!r}; it has {', '.join(channels) or 'none'}")
    if not scaled:
        return SysfsFile(str(path))
    scale, offset = _of_channel(folder, channel, "scale", 1.0), _of_channel(folder, channel, "offset", 0.0)
    if scale == 0.0:
        raise HardwareError(f"{folder}: the scale of {channel} is 0")
    return SysfsFile(str(path), scale, offset)


def _of_channel(folder: Path, channel: str, what: str, absent: float) -> float:
    for stem in (channel, channel.rstrip("0123456789")):
        path = folder / f"{stem}_{what}"
        if path.exists():
            return SysfsFile(str(path)).count()
    return absent


def counter(device: str, channel: str) -> SysfsFile:
    """Return a count of a counter device, such as ``count0``."""
    return SysfsFile(str(find(COUNTERS, device) / channel / "count"))


class PwmOutput:
    """A PWM channel: `raw` is the on-time [ns] in each period.

    The safe duty cycle is written before the channel is switched on; the channel is never switched off
    again, because off is not 0 on every chip.
    """

    def __init__(self, device: str, channel: int, period_ns: int) -> None:
        self._chip = find(PWM, device)
        self._folder, self._period_ns = self._chip / f"pwm{channel}", period_ns
        if not self._folder.is_dir():
            put(str(self._chip / "export"), f"{channel}\n")
        self._duty = SysfsFile(str(self._folder / "duty_cycle"))
        self.path = self._duty.path
        """File that is claimed."""

    def set_up(self, safe_ns: float) -> None:
        """Set the period, with the safe duty cycle before and after it, and switch the channel on."""
        period = SysfsFile(str(self._folder / "period"))
        if period.count() >= max(safe_ns, 1):
            self.write(safe_ns)
        period.write(self._period_ns)
        self.write(safe_ns)
        put(str(self._folder / "enable"), "1\n")

    def write(self, raw: float) -> None:
        """Write the duty cycle."""
        self._duty.write(self.spelled(raw))

    def read_back(self) -> float:
        """Return the duty cycle; HardwareError if the channel was switched off by another program."""
        if SysfsFile(str(self._folder / "enable")).count() != 1:
            raise HardwareError(f"{self._folder}: it is switched off")
        return self._duty.count()

    def spelled(self, raw: float) -> float:
        """Return the duty cycle in integer nanoseconds, within the period."""
        return min(max(round(raw), 0), self._period_ns)

    def orders(self, raw: float) -> Sequence[SafeWrite]:
        """Return the write that sets the duty cycle."""
        return (SafeWrite(self.path, f"{int(self.spelled(raw))}\n"),)
