"""The buffer of an IIO device: all its channels sampled together, at the device's own trigger.

    DEVICE/scan_elements/CHANNEL_en, CHANNEL_index, CHANNEL_type    content and format of a scan
    DEVICE/trigger/current_trigger                                  starts a scan, if necessary
    DEVICE/buffer/length, buffer/enable                             the kernel's FIFO
    /dev/iio:deviceN                                                the scans

A scan has the enabled channels in the order of their index, each aligned to its own size, and its
length is a multiple of the largest (Linux: Documentation/iio/iio_devbuf.rst). A type reads
``le:s12/16>>4``: byte order, sign, valid bits, stored bits, shift to the right.

Only the newest scan counts. A scan older than `stale_ns` is a fault: a stopped trigger must not
look like a constant torque.
"""

from __future__ import annotations

import os
import re
import select
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from coulombus.node.hardware.channels import HardwareError, SysfsFile, file_errors, put

__all__ = ["DEV", "BufferedInput", "IioBuffer", "NoBuffer"]

DEV = Path("/dev")
LENGTH = 64
"""Number of scans that the kernel buffers."""
MOST_READ = 1 << 16
_TYPE = re.compile(r"([bl]e):([su])(\d+)/(\d+)(?:X(\d+))?>>(\d+)")


class NoBuffer(HardwareError):
    """The device has no usable buffer; its channels can be read one by one."""


@dataclass(frozen=True)
class Element:
    """A channel in a scan."""

    index: int
    big_endian: bool
    signed: bool
    bits: int
    size: int
    """Number of stored bytes."""
    shift: int
    offset: int = 0
    """Offset of its first byte in the scan."""

    def value(self, scan: bytes) -> int:
        """Return the channel's count in a scan."""
        stored = int.from_bytes(scan[self.offset : self.offset + self.size], "big" if self.big_endian else "little")
        count = stored >> self.shift & (1 << self.bits) - 1
        return count - (1 << self.bits) if self.signed and count >> self.bits - 1 else count


class IioBuffer:
    """The buffer of a device, and its channels.

    Parameters
    ----------
    folder : of the device, in sysfs
    channels : such as ``in_voltage0``, each once
    stale_ns : age from which a scan is too old

    Raises
    ------
    NoBuffer
        the device has no buffer, or no trigger is set
    HardwareError
        a channel is not in the scans, or its type is unknown
    """

    def __init__(self, folder: Path, channels: Iterable[str], stale_ns: int) -> None:
        self.folder, self.channels, self.stale_ns = folder, tuple(channels), stale_ns
        self._fd = -1
        self._scan = b""
        self._rest = b""
        self._scan_ns: int | None = None
        if not (folder / "buffer" / "enable").exists() or not (folder / "scan_elements").is_dir():
            raise NoBuffer(f"{folder}: it has no buffer")
        trigger = folder / "trigger" / "current_trigger"
        if trigger.exists() and not trigger.read_text(errors="replace").strip():
            raise NoBuffer(f"{trigger}: no trigger is set; write the name of one to it")
        self.elements, self.size = self._layout()

    def _layout(self) -> tuple[dict[str, Element], int]:
        """Return the channels' elements, and the size of a scan."""
        elements = sorted(
            ((self._element(channel), channel) for channel in self.channels), key=lambda pair: pair[0].index
        )
        placed, offset, largest = {}, 0, 1
        for element, channel in elements:
            offset = -(-offset // element.size) * element.size
            placed[channel] = replace(element, offset=offset)
            offset += element.size
            largest = max(largest, element.size)
        return placed, -(-offset // largest) * largest

    def _element(self, channel: str) -> Element:
        scans = self.folder / "scan_elements"
        path = scans / f"{channel}_type"
        with file_errors(str(path)):
            text = path.read_text(errors="replace").strip()
        match = _TYPE.fullmatch(text)
        if match is None or match[5] not in (None, "1"):
            raise HardwareError(f"{path}: got {text[:64]!r}, expected a type as 'le:s12/16>>4'")
        bits, stored, shift = int(match[3]), int(match[4]), int(match[6])
        if stored not in (8, 16, 32, 64) or not 1 <= bits <= stored - shift:
            raise HardwareError(f"{path}: got {text!r}; {bits} bits and a shift of {shift} do not fit {stored} bits")
        index = int(SysfsFile(str(scans / f"{channel}_index")).count())
        return Element(index, match[1] == "be", match[2] == "s", bits, stored // 8, shift)

    # life cycle

    def open(self, wait_s: float) -> None:
        """Enable the buffer with only these channels, and wait for the first scan.

        Raises
        ------
        HardwareError
            an error of the device, or no scan came
        """
        self.close()
        put(str(self.folder / "buffer" / "enable"), "0\n")
        for path in sorted((self.folder / "scan_elements").glob("*_en")):
            put(str(path), f"{int(path.name.removesuffix('_en') in self.elements)}\n")
        put(str(self.folder / "buffer" / "length"), f"{LENGTH}\n")
        put(str(self.folder / "buffer" / "enable"), "1\n")
        node = DEV / self.folder.resolve().name
        with file_errors(str(node)):
            self._fd = os.open(node, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        self._rest, self._scan, self._scan_ns = b"", b"", None
        select.select([self._fd], [], [], wait_s)
        self._read_scans()
        if not self._scan:
            raise HardwareError(f"{node}: no scan within {wait_s:g} s; does the trigger run?")

    def close(self) -> None:
        """Disable the buffer; ignore errors of the device."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            with suppress(HardwareError):
                put(str(self.folder / "buffer" / "enable"), "0\n")

    # readings

    def refresh(self, t_ns: int) -> None:
        """Read the newest scan.

        Raises
        ------
        HardwareError
            the device is gone, or its last scan is too old
        """
        if self._read_scans() or self._scan_ns is None:
            self._scan_ns = t_ns
        elif t_ns - self._scan_ns > self.stale_ns:
            raise HardwareError(
                f"{self.folder}: no scan for {(t_ns - self._scan_ns) * 1e-6:.0f} ms; the trigger stopped"
            )

    def count(self, channel: str) -> int:
        """Return a channel's count in the newest scan."""
        return self.elements[channel].value(self._scan)

    def _read_scans(self) -> bool:
        """Read the available bytes; tell whether a complete scan came."""
        came = False
        with file_errors(str(self.folder)):
            while True:
                try:
                    data = os.read(self._fd, MOST_READ)
                except BlockingIOError:
                    return came
                if not data:
                    return came
                data = self._rest + data
                whole = len(data) // self.size * self.size
                self._rest = data[whole:]
                if whole:
                    self._scan, came = data[whole - self.size : whole], True


@dataclass(frozen=True)
class BufferedInput:
    """A channel of a buffer: value = (count + offset) * scale."""

    buffer: IioBuffer
    channel: str
    scale: float = 1.0
    offset: float = 0.0

    def read(self) -> float:
        """Return the value in the newest scan."""
        return (self.buffer.count(self.channel) + self.offset) * self.scale
