"""Exact length of a CAN frame on the wire, in bits.

Layout of a classical CAN frame (ISO 11898-1); bits are stuffed from the start of frame to the end
of the CRC::

    base      SOF 1 | id 11 | RTR 1 | IDE 1 | r0 1 | DLC 4 | data 8n | CRC 15 |
    extended  SOF 1 | id 11 | SRR 1 | IDE 1 | id 18 | RTR 1 | r1 r0 2 | DLC 4 | data 8n | CRC 15 |
    then      CRC delimiter 1 | ACK slot 1 | ACK delimiter 1 | end of frame 7 | inter-frame space 3

After five equal bits the sender inserts a bit of the other value, which is the first of the next
run. A frame has 34 + 8n (base) or 54 + 8n (extended) stuffable bits L, 13 more, and at most
floor((L - 1)/4) stuff bits: 55 bits for SYNC, 135 for eight data bytes, 160 with an extended
identifier.

The kernel works byte by byte, with two tables: the CRC is linear, so each byte adds (xor) its own
remainder to the register; stuffing is an automaton of nine states (nothing sent yet, a run of 1-4
zeros, of 1-4 ones).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import kernel
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, data_word

__all__ = [
    "CRC_POLYNOMIAL",
    "data_frame_bits",
    "frame_bits",
    "worst_case_bits",
]

CRC_POLYNOMIAL = 0x4599  # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
MAX_LENGTH = 8
AFTER_CRC = 13  # CRC delimiter, ACK slot and delimiter, end of frame, inter-frame space
CRC_BYTES = 13  # bytes under the CRC at most: 5 of an extended header (39 bits, zero-filled in front) and 8 of data


def _crc_tables() -> npt.NDArray[np.int16]:
    """Return the remainder that byte b leaves in the CRC when k bytes follow it, at index 256 k + b."""
    table = np.zeros((CRC_BYTES, 256), np.int16)
    crc = np.arange(256) << 7
    for followers in range(CRC_BYTES):
        for _ in range(8):
            crc = ((crc << 1) ^ np.where(crc & 0x4000, CRC_POLYNOMIAL, 0)) & 0x7FFF
        table[followers] = crc
    return table.ravel()


def _stuff_step(state: int, value: int, bits: int) -> int:
    """Send `bits` bits of `value` from `state`; return 256 x next state + stuff bits inserted."""
    inserted = 0
    last, run = (-1, 0) if state == 0 else ((state - 1) // 4, (state - 1) % 4 + 1)
    for i in range(bits - 1, -1, -1):
        bit = (value >> i) & 1
        last, run = bit, (run + 1 if bit == last else 1)
        if run == 5:
            inserted += 1
            last, run = 1 - bit, 1
    return (1 + 4 * last + run - 1) << 8 | inserted


def _stuff_table(bits: int) -> npt.NDArray[np.int16]:
    """Return `_stuff_step` for all nine states and all values of `bits` bits, at index 256 x state + value."""
    table = np.zeros((9, 256), np.int16)
    for state in range(9):
        for value in range(1 << bits):
            table[state, value] = _stuff_step(state, value, bits)
    return table.ravel()


CRC_OF = _crc_tables()
STUFF_8 = _stuff_table(8)
STUFF_7 = _stuff_table(7)
STUFF_3 = _stuff_table(3)[:8].copy()  # the first three bits of a base frame: only from "nothing sent yet"


@kernel
def data_frame_bits(can_id: int, length: int, data_word: int) -> int:
    """Return the length of any `FRAME` on the wire in bits, stuffing and inter-frame space included
    (takes about 20 ns).

    `can_id` carries Linux's flags: ``CAN_EFF_FLAG`` marks an extended frame, ``CAN_RTR_FLAG`` a
    remote frame (`length` is then its DLC, and there is no data). A `length` above 8 counts as 8,
    like a DLC of 9-15 on the wire.
    """
    n = min(max(length, 0), 8)
    count = n
    follow = 2  # bytes of the header after its first, incomplete one
    fixed = 47
    header = (can_id & 0x7FF) << 7 | n  # 19 bits
    if can_id & 0xC0000000 != 0:
        if can_id & 0x40000000 != 0:
            count = 0
            header |= 0x40
        if can_id & 0x80000000 != 0:  # 39 bits; SRR and IDE are recessive (1)
            header = (can_id & 0x1FFC0000) << 9 | 3 << 25 | (can_id & 0x3FFFF) << 7 | (header & 0x40) | n
            follow = 4
            fixed = 67
    byte = header >> (8 * follow)
    entry = int(STUFF_3[byte]) if follow == 2 else int(STUFF_7[byte])
    stuff = entry & 0xFF
    crc = int(CRC_OF[(count + follow) << 8 | byte])
    for k in range(follow - 1, -1, -1):
        byte = (header >> (8 * k)) & 0xFF
        crc ^= int(CRC_OF[(count + k) << 8 | byte])
        entry = int(STUFF_8[(entry & 0xF00) | byte])
        stuff += entry & 0xFF
    for i in range(count):
        byte = (data_word >> (8 * i)) & 0xFF
        crc ^= int(CRC_OF[(count - 1 - i) << 8 | byte])
        entry = int(STUFF_8[(entry & 0xF00) | byte])
        stuff += entry & 0xFF
    entry = int(STUFF_7[(entry & 0xF00) | crc >> 8])
    stuff += entry & 0xFF
    entry = int(STUFF_8[(entry & 0xF00) | (crc & 0xFF)])
    return fixed + 8 * count + stuff + (entry & 0xFF)


def frame_bits(
    can_id: int, data: bytes | bytearray | memoryview | int = b"", *, extended: bool = False, remote: bool = False
) -> int:
    """Return the bits on the wire from the start of frame to the end
    of the inter-frame space, stuffing included.

    Parameters
    ----------
    can_id
        Identifier without flags: 0 to 0x7FF, or 0 to 0x1FFFFFFF when `extended`.
    data
        Up to eight data bytes. For a remote frame: as many bytes as it requests (no value is sent),
        or the DLC.
    extended, remote
        29-bit identifier; remote frame.

    Raises
    ------
    ValueError
        Identifier or length out of range.

    Examples
    --------
    >>> frame_bits(0x80, b"")  # SYNC: 47 bits and four stuff bits
    51
    """
    limit = 0x1FFFFFFF if extended else 0x7FF
    if not 0 <= can_id <= limit:
        if can_id > 0x1FFFFFFF:
            fix = (
                "pass it without Linux's flags: can_id & 0x1FFFFFFF, and extended=True or remote=True where they stand"
            )
        elif can_id > limit:
            fix = "pass extended=True for a 29-bit identifier"
        else:
            fix = "an identifier is never negative"
        raise ValueError(f"identifier {can_id:#x} is not in 0..{limit:#x}: {fix}")
    if isinstance(data, int):
        if not remote:
            raise ValueError(f"data is the number {data}: pass bytes, or remote=True for a remote frame of that DLC")
        length, word = data, 0
    else:
        payload = bytes(data)
        length, word = len(payload), data_word(payload[:8])
    if not 0 <= length <= MAX_LENGTH:
        raise ValueError(f"{length} data bytes: a classical CAN frame has 0 to 8; split the data, or send an SDO")
    flags = (CAN_EFF_FLAG if extended else 0) | (CAN_RTR_FLAG if remote else 0)
    return int(data_frame_bits(can_id | flags, length, word))


def worst_case_bits(length: int, extended: bool = False) -> int:
    """Return the largest `frame_bits` of a data frame of `length` bytes: L + 13 + floor((L - 1)/4).

    L = 34 + 8 length, or 54 + 8 length with an extended identifier, is the number of stuffable bits
    (Davis, Burns, Bril and Lukkien 2007, doi:10.1007/s11241-007-9012-7, equations 1 and 2, and the
    three bits of inter-frame space in the 13).

    Raises
    ------
    ValueError
        `length` out of 0..8.
    """
    if not 0 <= length <= MAX_LENGTH:
        raise ValueError(f"{length} data bytes: a classical CAN frame has 0 to 8")
    stuffable = (54 if extended else 34) + 8 * length
    return stuffable + AFTER_CRC + (stuffable - 1) // 4
