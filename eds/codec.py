"""The compiled PDO codec: up to 64 fields of 1-64 bits, at any bit offset, in one 8-byte word.

CiA 301 numbers bits from the least significant bit of byte 0 upwards (little endian, section
7.1.4), so a PDO is one 64-bit word and a field is a shift and a mask. A motor's TPDO1, as an
example::

    bit   63            48 47                            16 15             0
         +----------------+--------------------------------+----------------+
         | 6077h torque   | 6064h position (INTEGER32)     | 6041h status   |
         +----------------+--------------------------------+----------------+
    byte  7      6          5      4      3      2           1      0

Values are the objects' raw bits in int64: signed types are sign-extended, unsigned types are
zero-extended (UNSIGNED64 keeps its bit pattern), REAL32 and REAL64 keep their IEEE 754 bit pattern
(`real_bits`, `real_value`).
"""

from __future__ import annotations

import math
import struct
from typing import Annotated

from coulombus.eds.cia301 import MAX_FIELDS
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import IntegerField, Integers, Record, dtype_of

__all__ = [
    "MAX_FIELDS",
    "PDO",
    "PdoRecord",
    "get_field",
    "nearest_integer",
    "pack",
    "put_field",
    "real_bits",
    "real_value",
    "unpack",
]


class PdoRecord(Record):
    """A PDO's layout for packing and unpacking in kernels."""

    cob_id: int  # 11-bit identifier; -1: the PDO does not exist or is not valid (bit 31 set)
    transmission: int  # transmission type, CiA 301 table 72: 0, 1-240, 252-255
    inhibit_ns: int  # minimum time between two transmissions
    event_ns: int  # event timer of a TPDO, deadline of an RPDO; 0: none
    sync_start: int  # SYNC start value (1800h:06)
    rtr_allowed: int  # 1: remote frames may request it
    length: int  # data bytes
    count: int  # fields
    slot: Annotated[IntegerField, MAX_FIELDS]  # index of the field's value in the value array; -1: dummy
    start: Annotated[IntegerField, MAX_FIELDS]  # first bit
    bits: Annotated[IntegerField, MAX_FIELDS]  # width, 1-64
    signed: Annotated[IntegerField, MAX_FIELDS]  # 1: the field is sign-extended


PDO = dtype_of(PdoRecord)


@kernel
def get_field(word: int, start: int, bits: int, signed: int) -> int:
    """Return the field of `bits` bits that begins at bit `start` of `word`, sign-extended if `signed`."""
    if bits >= 64:
        return word
    half = 1 << (bits - 1)  # masks are built from halves: 1 << 63 would exceed int64
    value = (word >> start) & (half - 1 + half)
    if signed and value >= half:
        value = value - half - half
    return value


@kernel
def put_field(word: int, start: int, bits: int, value: int) -> int:
    """Return `word` with the low `bits` bits of `value` inserted at bit `start`."""
    if bits >= 64:
        return value
    half = 1 << (bits - 1)
    mask = half - 1 + half
    field = value & mask
    if start + bits >= 64:  # the field includes the word's sign bit
        if field >= half:
            field = field - half - half
        below = 1 << (start - 1)
        return (word & (below - 1 + below)) | (field << start)
    return (word & ~(mask << start)) | (field << start)


@kernel
def unpack(pdo: PdoRecord, word: int, values: Integers) -> None:
    """Write every field of the PDO `word` to its slot of `values` (int64)."""
    for i in range(pdo.count):
        slot = pdo.slot[i]
        if slot >= 0:
            values[slot] = get_field(word, pdo.start[i], pdo.bits[i], pdo.signed[i])


@kernel
def pack(pdo: PdoRecord, values: Integers) -> int:
    """Return the PDO's word from the slots of `values` (int64); dummy fields are 0."""
    word = 0
    for i in range(pdo.count):
        slot = pdo.slot[i]
        if slot >= 0:
            word = put_field(word, pdo.start[i], pdo.bits[i], values[slot])
    return word


@kernel
def nearest_integer(value: float, bits: int) -> int:
    """Return the signed integer of `bits` bits that is nearest to `value`: an end of their range if it lies beyond, the
    lowest for NaN.
    """
    lowest = -(1 << (bits - 1))
    if not value > float(lowest):
        return lowest
    if value > float(-lowest - 1):
        return -lowest - 1
    return math.floor(value + 0.5)


def real_bits(value: float, bits: int) -> int:
    """Return the IEEE 754 pattern of `value` in `bits` (32 or 64) bits, as a slot holds it."""
    if bits == 32:
        return int(struct.unpack("<I", struct.pack("<f", value))[0])
    return int(struct.unpack("<q", struct.pack("<d", value))[0])


def real_value(pattern: int, bits: int) -> float:
    """Return the number whose IEEE 754 pattern in `bits` (32 or 64) bits is `pattern`."""
    if bits == 32:
        return float(struct.unpack("<f", struct.pack("<I", pattern & 0xFFFFFFFF))[0])
    return float(struct.unpack("<d", struct.pack("<q", pattern))[0])
