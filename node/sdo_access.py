"""Reads and writes of SDO clients: the dictionary with CiA's rules, and the effects of a write."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from coulombus.eds.cia301 import ARRAY, RECORD, Abort
from coulombus.eds.convert import eds_text
from coulombus.node.communication_objects import Communication
from coulombus.node.dictionary import Dictionary, decode, encode
from coulombus.node.parameters import RESTORE, STORE, StoredParameters
from coulombus.node.profile import Profile, SdoAbort

__all__ = ["Access"]

_COMMUNICATION = range(0x1000, 0x2000)
_HISTORY, _STORE_EDS = 0x1003, 0x1021
_STRUCTURE = 0xFF

_LIMIT_PAIRS: Mapping[int, tuple[int, int]] = {0x607B: (1, 2), 0x607D: (1, 2)}
"""Objects whose two sub-indices are a minimum and its maximum (CiA 402: position range limit, software
position limit).
"""

_RECORDS: tuple[tuple[range, int], ...] = (
    (range(0x1018, 0x1019), 0x0023),
    (range(0x1200, 0x1300), 0x0022),
    (range(0x1400, 0x1600), 0x0020),
    (range(0x1600, 0x1800), 0x0021),
    (range(0x1800, 0x1A00), 0x0020),
    (range(0x1A00, 0x1C00), 0x0021),
)
"""Data types of the records of CiA 301, by index."""


class Access:
    """Backend of a device's SDO servers; `written` and `carries` tell the core which objects were written
    (`Profile.acts`).
    """

    def __init__(
        self,
        dictionary: Dictionary,
        communication: Communication,
        parameters: StoredParameters,
        profile: Profile,
        changed: Callable[[int, int], None],
    ) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._parameters = parameters
        self._profile = profile
        self._changed = changed
        self.written = False
        self.carries = 0

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object if it may be read."""
        if subindex == _STRUCTURE:
            return self._structure(index)
        variable = self._dictionary.check_read(index, subindex)
        if index == _HISTORY:
            self._communication.collect(index)
            if subindex > self._dictionary.number(_HISTORY):
                raise SdoAbort(Abort.NO_DATA)
        elif index == _STORE_EDS:
            return eds_text(self._dictionary.description).encode()
        return encode(variable, self._dictionary[index, subindex])

    def check_download(self, index: int, subindex: int, size: int | None) -> int:
        """Abort unless `size` bytes may be written; return the largest allowed number."""
        if subindex == _STRUCTURE:
            self._structure(index)
            raise SdoAbort(Abort.READ_ONLY)
        return self._dictionary.check_write(index, subindex, size)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object; an abort changes nothing."""
        try:
            value = decode(self._dictionary.find(index, subindex), data)
        except SdoAbort as abort:  # the EDS's limit of a map's count is its number of entries
            place = self._communication.pdos.locate(index)
            if place and place[2] and subindex == 0 and abort.code == Abort.VALUE_HIGH:
                raise SdoAbort(Abort.PDO_LENGTH) from None
            raise
        if isinstance(value, int):
            if index in (STORE, RESTORE):
                self._parameters.command(index, subindex, value)
                return
            if index in _COMMUNICATION:
                self._communication.check(index, subindex, value)
            elif index in _LIMIT_PAIRS:
                self._check_pair(index, subindex, value)
            else:
                self._profile.check(self._dictionary, index, subindex, value)
        elif isinstance(value, float) and not math.isfinite(value):
            raise SdoAbort(Abort.VALUE)
        before = self._dictionary[index, subindex]
        self._dictionary[index, subindex] = value
        self.written = True
        self.carries |= self._profile.acts.get((index, subindex), 0)
        if value != before:
            self._parameters.changed(index, subindex)
        self._changed(index, subindex)

    def _structure(self, index: int) -> bytes:
        """Return sub-index FFh: object code in bits 0-7, data type in bits 8-23 (CiA 301, 7.4.6.2); for an array,
        the data type of its elements.
        """
        entry = self._dictionary.description.objects.get(index)
        if entry is None:
            raise SdoAbort(Abort.NO_OBJECT)
        variable = entry.variables.get(1 if entry.object_type == ARRAY else 0)
        code = variable.data_type if variable else 0
        if entry.object_type == RECORD:
            code = next((code for indices, code in _RECORDS if index in indices), 0)
        return (entry.object_type | (code & 0xFFFF) << 8).to_bytes(4, "little")

    def _check_pair(self, index: int, subindex: int, value: int) -> None:
        pair = _LIMIT_PAIRS[index]
        if all((index, k) in self._dictionary for k in pair):
            low, high = (value if k == subindex else self._dictionary.number(index, k) for k in pair)
            if low > high:
                raise SdoAbort(Abort.MAX_BELOW_MIN)
