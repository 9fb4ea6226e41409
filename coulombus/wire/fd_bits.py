"""Exact length of a CAN FD frame on the wire: bits at the nominal
rate, bits at the data rate (ISO 11898-1:2015).

The frame as an error active station sends it; what stands right of the BRS bit's sample point, up
to that of the CRC delimiter, goes at the data rate when BRS is recessive. BRS counts as nominal
here and the CRC delimiter as data::

    base      SOF 1 | id 11 | RRS 1 | IDE 1 | FDF 1 | res 1 | BRS 1 ||
    extended  SOF 1 | id 11 | SRR 1 | IDE 1 | id 18 | RRS 1 | FDF 1 | res 1 | BRS 1 ||
    then      ESI 1 | DLC 4 | data 8n | stuff count 4 | CRC 17 or 21 | fixed stuff bits 6 or 7 | CRC delimiter 1 ||
    then      ACK slot 1 | ACK delimiter 1 | end of frame 7 | inter-frame space 3

Two kinds of stuffing. From the start of frame to the end of the data field a bit is inserted after
five equal ones, as in a classical frame. In the CRC field stuff bits stand at fixed places,
whatever the bits are: before the stuff count, and after each four bits from there on. A sixth bit
that is due after the last data bit is the first of the fixed ones; there are never two. So neither
the stuff count nor the CRC's value changes the length: CRC-17 (up to 16 data bytes) has 4 + 17 bits
and 6 fixed stuff bits, CRC-21 has 4 + 21 and 7.
"""

from __future__ import annotations

__all__ = ["FD_LENGTHS", "fd_duration_ns", "fd_frame_bits"]

FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Data bytes by DLC."""
CRC_17_LENGTH = 16
"""Longest data field under CRC-17."""
AFTER_CRC_DELIMITER = 12  # ACK slot and delimiter, end of frame, inter-frame space


def _crc_field_bits(length: int) -> int:
    """Return the bits of stuff count, CRC and fixed stuff bits."""
    bits = 4 + (17 if length <= CRC_17_LENGTH else 21)
    return bits + (bits + 3) // 4


def _stuffed(bits: str, last: str, run: int) -> tuple[int, str, int]:
    """Send `bits` after `run` bits of value `last`; return the stuff
    bits that are due, last bit and run after them.
    """
    inserted = 0
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            inserted += 1
            last, run = ("1" if bit == "0" else "0"), 1
    return inserted, last, run


def fd_frame_bits(
    can_id: int, data: bytes | bytearray | memoryview = b"", *, extended: bool = False, bitrate_switch: bool = True
) -> tuple[int, int]:
    """Return (bits at the nominal rate, bits at the data rate) of a
    CAN FD frame, stuffing and inter-frame space included.

    Parameters
    ----------
    can_id
        Identifier without flags: 0 to 0x7FF, or 0 to 0x1FFFFFFF when `extended`.
    data
        0 to 8, 12, 16, 20, 24, 32, 48 or 64 bytes.
    extended
        29-bit identifier.
    bitrate_switch
        BRS recessive. When it is dominant all bits are nominal: (all of them, 0).

    Raises
    ------
    ValueError
        Identifier out of range, or no length of CAN FD; the text names the next larger one.

    Examples
    --------
    >>> fd_frame_bits(0x123, b"")  # 17 + 12 nominal bits; ESI, DLC, CRC field with its 6 fixed bits, delimiter
    (29, 33)
    """
    limit = 0x1FFFFFFF if extended else 0x7FF
    if not 0 <= can_id <= limit:
        fix = "pass it without Linux's flags, and extended=True for a 29-bit identifier"
        raise ValueError(f"identifier {can_id:#x} is not in 0..{limit:#x}: {fix}")
    payload = bytes(data)
    length = len(payload)
    if length not in FD_LENGTHS:
        larger = next((n for n in FD_LENGTHS if n > length), None)
        fix = "64 is the longest: split the data" if larger is None else f"pad the data to {larger}"
        raise ValueError(f"{length} data bytes: a CAN FD frame has 0 to 8, 12, 16, 20, 24, 32, 48 or 64; {fix}")
    switch = "1" if bitrate_switch else "0"
    if extended:
        identifier = f"{can_id:029b}"
        head = f"0{identifier[:11]}11{identifier[11:]}010{switch}"
    else:
        head = f"0{can_id:011b}0010{switch}"
    rest = f"0{FD_LENGTHS.index(length):04b}" + "".join(f"{byte:08b}" for byte in payload)
    before, last, run = _stuffed(head, "", 0)
    between, _, _ = _stuffed(rest[:-1], last, run)  # one that is due after the last bit is the first fixed one
    nominal = len(head) + before + AFTER_CRC_DELIMITER
    fast = len(rest) + between + _crc_field_bits(length) + 1
    return (nominal, fast) if bitrate_switch else (nominal + fast, 0)


def fd_duration_ns(
    can_id: int,
    data: bytes | bytearray | memoryview,
    nominal_bit_s: int,
    data_bit_s: int,
    *,
    extended: bool = False,
    bitrate_switch: bool = True,
) -> int:
    """Return how long the frame occupies the bus [ns], inter-frame space included, rounded up.

    duration = nominal bits / `nominal_bit_s` + data bits / `data_bit_s` (rates in bit/s)

    Raises
    ------
    ValueError
        As `fd_frame_bits`; or a rate that is not positive, or a data rate below the nominal one.
    """
    if nominal_bit_s <= 0 or data_bit_s <= 0:
        raise ValueError(f"rates of {nominal_bit_s} and {data_bit_s} bit/s: both must be above 0")
    if bitrate_switch and data_bit_s < nominal_bit_s:
        raise ValueError(f"data rate {data_bit_s} bit/s is below the nominal one, {nominal_bit_s}: swap them")
    nominal, fast = fd_frame_bits(can_id, data, extended=extended, bitrate_switch=bitrate_switch)
    return -(-(nominal * data_bit_s + fast * nominal_bit_s) * 1_000_000_000 // (nominal_bit_s * data_bit_s))
