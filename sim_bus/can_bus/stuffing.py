"""Bit sequence of a frame on the wire (ISO 11898-1:2015, 10.4 and 10.5); `wire.bits` only counts the bits.

It is used only for frames with errors, so it is written for readability: bit by bit, from the start
of frame to the end of frame. Dominant is 0.
"""

from __future__ import annotations

from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Integers
from coulombus.wire.bits import CRC_POLYNOMIAL
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG

__all__ = ["CRC_BITS", "TAIL_BITS", "crc_step", "stuffed_bits"]

CRC_BITS = 15
TAIL_BITS = 10  # CRC delimiter, ACK slot, ACK delimiter, end of frame (7)


@kernel
def crc_step(crc: int, bit: int) -> int:
    """Return CRC-15 after one more bit."""
    feedback = (crc >> 14 & 1) ^ bit
    crc = crc << 1 & 0x7FFF
    return crc ^ CRC_POLYNOMIAL if feedback else crc


@kernel
def stuffed_bits(can_id: int, length: int, word: int, wrong_crc: int, bits: Integers) -> int:
    """Write the bits of a frame to `bits`, as its sender drives them (the ACK slot recessive), and
    return their number.

    `can_id` and `word` are those of `wire.frame.Frame`. `wrong_crc` is added (xor) to the CRC
    sequence, which is stuffed afterwards.
    """
    n = min(max(length, 0), 8)
    remote = 1 if can_id & CAN_RTR_FLAG else 0
    if can_id & CAN_EFF_FLAG:  # SOF id28..18 SRR IDE id17..0 RTR r1 r0 DLC
        head = (can_id >> 18 & 0x7FF) << 27 | 3 << 25 | (can_id & 0x3FFFF) << 7 | remote << 6 | n
        head_bits = 39
    else:  # SOF id10..0 RTR IDE r0 DLC
        head = (can_id & 0x7FF) << 7 | remote << 6 | n
        head_bits = 19
    data_bits = 0 if remote else 8 * n
    at, last, run, crc = 0, -1, 0, 0
    for i in range(head_bits + data_bits + CRC_BITS):
        if i < head_bits:
            bit = head >> (head_bits - 1 - i) & 1
        elif i < head_bits + data_bits:
            k = i - head_bits
            bit = word >> (8 * (k >> 3) + 7 - (k & 7)) & 1
        else:
            if i == head_bits + data_bits:
                sequence = crc ^ wrong_crc
            bit = sequence >> (head_bits + data_bits + CRC_BITS - 1 - i) & 1
        if i < head_bits + data_bits:
            crc = crc_step(crc, bit)
        run = run + 1 if bit == last else 1
        last = bit
        bits[at] = bit
        at += 1
        if run == 5:
            last = 1 - bit
            run = 1
            bits[at] = last
            at += 1
    for _ in range(TAIL_BITS):
        bits[at] = 1
        at += 1
    return at
