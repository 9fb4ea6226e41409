"""SDO frames and their parts; by their first byte they are named as in Wireshark's CANopen dissector (CiA 301, section 7.2.4.3).

A segment of a block transfer has no command: its first byte is its number, 1 to 127, with bit 7 set
in the last segment (sections 7.2.4.3.10 and 7.2.4.3.14). So most first bytes have two meanings, and
the transfer in progress decides. An abort is unambiguous: 80h would be segment 0.
"""

from __future__ import annotations

import binascii
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = [
    "ABORT",
    "BLOCK_DOWNLOAD_ACK",
    "BLOCK_DOWNLOAD_END",
    "BLOCK_DOWNLOAD_ENDED",
    "BLOCK_DOWNLOAD_INITIATE",
    "BLOCK_DOWNLOAD_INITIATED",
    "BLOCK_SEGMENTS",
    "BLOCK_UPLOAD_ACK",
    "BLOCK_UPLOAD_END",
    "BLOCK_UPLOAD_ENDED",
    "BLOCK_UPLOAD_INITIATE",
    "BLOCK_UPLOAD_INITIATED",
    "BLOCK_UPLOAD_START",
    "DOWNLOAD_INITIATE",
    "DOWNLOAD_INITIATED",
    "DOWNLOAD_SEGMENT",
    "DOWNLOAD_SEGMENT_RESPONSE",
    "UPLOAD_INITIATE",
    "UPLOAD_INITIATED",
    "UPLOAD_SEGMENT",
    "UPLOAD_SEGMENT_REQUEST",
    "Form",
    "crc16",
    "form_of",
    "head",
    "named",
    "where",
]

ABORT = 0x80
BLOCK_SEGMENTS = 127
"""Largest number of segments in a block of an SDO block transfer."""


@dataclass(frozen=True)
class Form:
    """A kind of frame.

    Attributes
    ----------
    phase : its name
    commands : first bytes that the standard allows
    reserved : all bytes from this one on are 0; 8: none
    initiates : bytes 1 to 3 are an object's index and sub-index
    """

    phase: str
    commands: frozenset[int]
    reserved: int
    initiates: bool

    def exact(self, data: bytes) -> bool:
        """Tell whether a frame follows the standard, including its reserved bits and bytes."""
        named = not self.initiates or data[1] | data[2] << 8 != 0
        return data[0] in self.commands and named and not any(data[self.reserved :])


def _form(phase: str, commands: Iterable[int], reserved: int = 8) -> Form:
    return Form(phase, frozenset(commands), reserved, phase.startswith("Initiate"))


_SEGMENTS = [toggle | part for toggle in (0x00, 0x10) for part in (0x00, *range(0x01, 0x10, 2))]
_UPLOAD_ANSWERS = (0x40, 0x41, 0x42, 0x43, 0x47, 0x4B, 0x4F)
_ENDS = range(0xC1, 0xDA, 4)

DOWNLOAD_INITIATE = _form("Initiate download request", (0x20, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F))
DOWNLOAD_INITIATED = _form("Initiate download response", (0x60,), 4)
DOWNLOAD_SEGMENT = _form("Download segment request", _SEGMENTS)
DOWNLOAD_SEGMENT_RESPONSE = _form("Download segment response", (0x20, 0x30), 1)
UPLOAD_INITIATE = _form("Initiate upload request", (0x40,), 4)
UPLOAD_INITIATED = _form("Initiate upload response", _UPLOAD_ANSWERS)
UPLOAD_SEGMENT_REQUEST = _form("Upload segment request", (0x60, 0x70), 1)
UPLOAD_SEGMENT = _form("Upload segment response", _SEGMENTS)
BLOCK_UPLOAD_INITIATE = _form("Initiate block upload request", (0xA0, 0xA4), 6)
BLOCK_UPLOAD_INITIATED = _form("Initiate block upload response", (0xC0, 0xC2, 0xC4, 0xC6))
BLOCK_UPLOAD_START = _form("Start block upload", (0xA3,), 1)
BLOCK_UPLOAD_ACK = _form("Block upload response", (0xA2,), 3)
BLOCK_UPLOAD_END = _form("End block upload request", _ENDS, 3)
BLOCK_UPLOAD_ENDED = _form("End block upload response", (0xA1,), 1)
BLOCK_DOWNLOAD_INITIATE = _form("Initiate block download request", (0xC0, 0xC2, 0xC4, 0xC6))
BLOCK_DOWNLOAD_INITIATED = _form("Initiate block download response", (0xA0, 0xA4), 5)
BLOCK_DOWNLOAD_ACK = _form("Block download response", (0xA2,), 3)
BLOCK_DOWNLOAD_END = _form("End block download request", _ENDS, 3)
BLOCK_DOWNLOAD_ENDED = _form("End block download response", (0xA1,), 1)

_CLIENT = (
    *(DOWNLOAD_SEGMENT, DOWNLOAD_INITIATE, UPLOAD_INITIATE, UPLOAD_SEGMENT_REQUEST),
    *(BLOCK_UPLOAD_INITIATE, BLOCK_UPLOAD_START, BLOCK_UPLOAD_ACK, BLOCK_UPLOAD_ENDED),
    *(BLOCK_DOWNLOAD_INITIATE, BLOCK_DOWNLOAD_END),
)
_SERVER = (
    *(UPLOAD_SEGMENT, DOWNLOAD_SEGMENT_RESPONSE, UPLOAD_INITIATED, DOWNLOAD_INITIATED),
    *(BLOCK_DOWNLOAD_INITIATED, BLOCK_DOWNLOAD_ACK, BLOCK_DOWNLOAD_ENDED),
    *(BLOCK_UPLOAD_INITIATED, BLOCK_UPLOAD_END),
)


def _key(command: int) -> tuple[int, int]:
    """Return command specifier and, in a block transfer, sub-command."""
    specifier = command >> 5
    return specifier, command & {5: 3, 6: 1}.get(specifier, 0)


_FORMS = {
    (from_server, *_key(min(form.commands))): form
    for from_server, forms in ((False, _CLIENT), (True, _SERVER))
    for form in forms
}


def form_of(command: int, from_server: bool) -> Form | None:
    """Return the kind of a frame with this first byte, unless it is a segment of a block transfer or an
    abort; None if the standard does not define it.
    """
    return _FORMS.get((from_server, *_key(command)))


def crc16(data: bytes | bytearray) -> int:
    """Return the CRC of section 7.2.4.3.16 (polynomial 1021h, start 0); for b"123456789" it is 31C3h."""
    return binascii.crc_hqx(data, 0)


def head(command: int, index: int, subindex: int, data: bytes = b"") -> bytes:
    """Return an initiating request: command, multiplexor, four bytes."""
    return bytes((command, index & 0xFF, index >> 8, subindex)) + data.ljust(4, b"\0")


def where(index: int, subindex: int) -> str:
    """Return an object's name in CiA's notation: ``1017h:00``."""
    return f"{index:04X}h:{subindex:02X}"


def named(message: bytes) -> tuple[int, int]:
    """Return the object of an initiating message."""
    return int.from_bytes(message[1:3], "little"), message[3]
