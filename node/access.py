"""What an SDO client reads and writes: the dictionary behind CiA's rules, and what a write leads to."""

from __future__ import annotations

from collections.abc import Callable

from eds.cia301 import Abort
from node import drive402
from node.communication import Communication
from node.dictionary import Dictionary, SdoAbort, decode, encode
from node.mapping import CARRIED
from node.records import KIND_DRIVE

__all__ = ["Access"]

_COMMUNICATION = range(0x1000, 0x2000)
_SUPPORTED_MODES = 0x6502


class Access:
    """The backend of a device's SDO server; `carries` tells the core what was written (`node.behaviour`)."""

    def __init__(
        self, dictionary: Dictionary, communication: Communication, kind: int, changed: Callable[[int, int], None]
    ) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._kind = kind
        self._changed = changed
        self.carries = 0

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object that may be read."""
        variable = self._dictionary.check_read(index, subindex)
        self._communication.collect(index)
        if index == 0x1003 and subindex > self._dictionary.number(0x1003):
            raise SdoAbort(Abort.NO_DATA)
        return encode(variable, self._dictionary[index, subindex])

    def check_download(self, index: int, subindex: int, size: int | None) -> int:
        """Abort unless `size` bytes may be written; return how many at most."""
        return self._dictionary.check_write(index, subindex, size)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object; nothing changes when it aborts."""
        value = decode(self._dictionary.find(index, subindex), data)
        if isinstance(value, int):
            if index in _COMMUNICATION:
                self._communication.check(index, subindex, value)
            elif self._kind == KIND_DRIVE and index == 0x6060:
                self._check_mode(value)
        self._dictionary[index, subindex] = value
        self.carries |= CARRIED[self._kind].get((index, subindex), 0)
        self._changed(index, subindex)

    def _check_mode(self, mode: int) -> None:
        """6502h tells the modes: bit n - 1 for mode n; mode 0 is "none"."""
        supported = self._dictionary.number(_SUPPORTED_MODES, 0, 0x208)
        if mode not in drive402.MODES or (mode > 0 and not supported >> (mode - 1) & 1):
            raise SdoAbort(Abort.VALUE)
