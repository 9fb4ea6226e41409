"""SDO messages in bytes, for whoever is a client: CiA 301, section 7.2.4.3."""

from __future__ import annotations

__all__ = ["crc16", "head", "where"]


def crc16(data: bytes) -> int:
    """Return the block transfer's CRC: polynomial 1021h, start 0 (section 7.2.4.3.16)."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def head(command: int, index: int, subindex: int, data: bytes = b"") -> bytes:
    """Return an initiating request: command, multiplexor, four bytes."""
    return bytes((command, index & 0xFF, index >> 8, subindex)) + data.ljust(4, b"\0")


def where(index: int, subindex: int) -> str:
    """Return an object's name as CiA writes it: ``1017h:00``."""
    return f"{index:04X}h:{subindex:02X}"
