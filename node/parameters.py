"""Persistent parameters (CiA 301, 7.5.2.13, 14 and 24): 1010h store, 1011h restore, 1020h verify configuration.

A group is a range of objects. Store saves the present values of the group's writable objects; every
reset that would set these objects to their defaults loads them. Restore deletes the group's stored
values, so the defaults return with the next such reset, not before. Set-points and controlwords are
never stored: a device that is switched on must not move.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping

from coulombus.eds.cia301 import Abort
from coulombus.node.dictionary import Dictionary, decode, encode
from coulombus.node.profile import SdoAbort
from coulombus.node.store import Store

__all__ = ["LOAD", "SAVE", "StoredParameters"]

SAVE, LOAD = 0x65766173, 0x64616F6C
"""Signatures "save" and "load"."""

STORE, RESTORE, VERIFY = 0x1010, 0x1011, 0x1020

_ALL = 1
_GROUP: Mapping[int, str] = {
    2: "communication",
    3: "application",
}  # by sub-index of 1010h and 1011h; others are manufacturer-specific
_RANGES: Mapping[str, range] = {
    "communication": range(0x1000, 0x2000),
    "manufacturer": range(0x2000, 0x6000),
    "application": range(0x6000, 0x10000),
}
_WRITABLE = ("rw", "rwr", "rww")
_NO_PARAMETERS = frozenset((0x1003, STORE, RESTORE))


class StoredParameters:
    """Stored parameters of a device; `commands` are objects that make it act (controlword, set-points)."""

    def __init__(self, dictionary: Dictionary, store: Store, commands: Mapping[tuple[int, int], int]) -> None:
        self._dictionary, self._store, self._commands = dictionary, store, commands
        self.ignored = 0
        """Number of stored values that did not fit their objects when they were loaded."""
        number, text = dictionary.number, dictionary.description.text.encode()
        product = f"{number(0x1018, 1):08X}-{number(0x1018, 2):08X}"
        store.attach(f"{number(0x1000):08X}-{product}-eds {zlib.crc32(text):08x}")

    def is_parameter(self, index: int, subindex: int) -> bool:
        """Tell whether an object is stored, and verified by 1020h."""
        if index in _NO_PARAMETERS or (index, subindex) in self._commands:
            return False
        return self._dictionary.description.variable(index, subindex).access in _WRITABLE

    def load(self, first: int, last: int) -> None:
        """Set the objects from `first` to `last` to their stored values; an object whose value does not fit keeps
        its default.
        """
        for name in _RANGES:
            for key, data in self._store.section(name).items():
                try:
                    index, subindex = (int(part, 16) for part in key.split(":"))
                    if first <= index <= last and self.is_parameter(index, subindex):
                        variable = self._dictionary.find(index, subindex)
                        self._dictionary.check_write(index, subindex, len(data))
                        self._dictionary[index, subindex] = decode(variable, data)
                except (ValueError, KeyError, SdoAbort):
                    self.ignored += 1

    def command(self, index: int, subindex: int, value: int) -> None:
        """Serve a write to 1010h or 1011h, sub-index 1 or more; nothing changes when it aborts."""
        if value != (SAVE if index == STORE else LOAD):
            raise SdoAbort(Abort.CANNOT_STORE)
        names = list(_RANGES) if subindex == _ALL else [_GROUP.get(subindex, "manufacturer")]
        try:
            self._store.put({name: dict(self._present(name)) if index == STORE else {} for name in names})
        except OSError as error:
            raise SdoAbort(Abort.HARDWARE) from error

    def _present(self, name: str) -> Iterator[tuple[str, bytes]]:
        for index, entry in self._dictionary.description.objects.items():
            if index in _RANGES[name]:
                for subindex, variable in entry.variables.items():
                    if self.is_parameter(index, subindex):
                        yield f"{index:04X}:{subindex:02X}", encode(variable, self._dictionary[index, subindex])

    def changed(self, index: int, subindex: int) -> None:
        """Invalidate 1020h after a client has changed an object."""
        if index != VERIFY and (VERIFY, 1) in self._dictionary and self.is_parameter(index, subindex):
            for k in (1, 2):
                if (VERIFY, k) in self._dictionary:
                    self._dictionary[VERIFY, k] = 0
