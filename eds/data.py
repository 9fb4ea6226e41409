"""Conversion between an object's value and the bytes of an SDO transfer; which objects act when written."""

from __future__ import annotations

import struct

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.description import Value, Variable

__all__ = ["READ_ONLY", "decode", "encode", "is_output", "without_fill"]

READ_ONLY = ("ro", "const")
_SETPOINTS = (0x6040, 0x6060, 0x6071, 0x607A, 0x6042, 0x60FF, 0x60B0, 0x60B1, 0x60B2, 0x60FE)


def is_output(variable: Variable) -> bool:
    """Tell whether writing the object may cause motion: an object from 2000h on that a PDO may write, or a
    target value of CiA 402.
    """
    mapped = variable.pdo_mappable and variable.access not in READ_ONLY
    return variable.index >= 0x2000 and (mapped or variable.access == "rww" or variable.index in _SETPOINTS)


def encode(variable: Variable, value: Value) -> bytes:
    """Return `value` as the bytes of the variable's type, little endian.

    Text has no closing zero; a number of unknown type has four bytes.
    """
    kind = DATA_TYPES.get(variable.data_type)
    if isinstance(value, bytes):
        return value
    if isinstance(value, str):
        return value.encode("utf-16-le" if kind and kind.kind == "unicode" else "latin-1", "replace")
    if kind and kind.kind == "real":
        return struct.pack("<f" if kind.bits == 32 else "<d", value or 0.0)
    size = (kind.bits + 7) // 8 if kind and kind.bits else 4
    return (int(value or 0) & ((1 << 8 * size) - 1)).to_bytes(size, "little")


def decode(variable: Variable, data: bytes) -> int | float | str | bytes:
    """Return the value of `data` in the variable's type.

    Data of another length than the type's stay bytes. Text ends at its first zero.
    """
    kind = DATA_TYPES.get(variable.data_type)
    if kind is None or kind.kind in ("bytes", "domain", "record", "time"):
        return data
    if kind.kind == "text":
        return data.split(b"\0")[0].decode("latin-1")
    if kind.kind == "unicode":
        return data.decode("utf-16-le", "replace").split("\0")[0]
    if len(data) != (kind.bits + 7) // 8:
        return data
    if kind.kind == "real":
        number: float = struct.unpack("<f" if kind.bits == 32 else "<d", data)[0]
        return number
    return int.from_bytes(data, "little", signed=kind.signed)


def without_fill(variable: Variable, data: bytes) -> bytes:
    """Return the bytes of the variable's type if the bytes after them only extend its number (a server may
    send four bytes for a shorter number); otherwise return all.
    """
    size = (variable.bits + 7) // 8
    if not 0 < size < len(data):
        return data
    sign = _signed(variable) and data[size - 1] & 0x80
    return data[:size] if data[size:] == (b"\xff" if sign else b"\0") * (len(data) - size) else data


def _signed(variable: Variable) -> bool:
    return variable.whole is not None and variable.whole[0] < 0
