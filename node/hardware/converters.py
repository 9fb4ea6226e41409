"""Converters supported by Linux: IIO, PWM, counters, and the locations of their files.

    IIO      DEVICE/out_voltageN_raw, DEVICE/in_voltageN_raw    value = (raw + offset) * scale
    PWM      CHIP/pwmN/period, duty_cycle, enable               nanoseconds
    counter  DEVICE/countN/count

The kernel documents these files in Documentation/ABI/testing/sysfs-bus-iio, sysfs-class-pwm,
sysfs-bus-counter.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from coulombus.node.hardware.channels import HardwareError, SafeWrite, SysfsFile, put

__all__ = ["COUNTERS", "IIO", "PWM", "PwmOutput", "counter", "find", "iio"]

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
