"""Bytes of SDO messages, for clients: CiA 301, section 7.2.4.3."""

from __future__ import annotations

import binascii

__all__ = ["crc16", "head", "where"]


def crc16(data: bytes | bytearray) -> int:
    """Return the CRC of section 7.2.4.3.16 (polynomial 1021h, start 0); for b"123456789" it is 31C3h."""
    return binascii.crc_hqx(data, 0)


def head(command: int, index: int, subindex: int, data: bytes = b"") -> bytes:
    """Return an initiating request: command, multiplexor, four bytes."""
    return bytes((command, index & 0xFF, index >> 8, subindex)) + data.ljust(4, b"\0")


def where(index: int, subindex: int) -> str:
    """Return an object's name in CiA's notation: ``1017h:00``."""
    return f"{index:04X}h:{subindex:02X}"
