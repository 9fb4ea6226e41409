"""Frame lengths against an oracle that writes the frame out as a string of bits, CRC by polynomial
division.
"""

import random
import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.bit_oracle import classical, crc, numbered
from coulombus.wire.bits import data_frame_bits, frame_bits, worst_case_bits
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG

as_python = getattr(data_frame_bits, "py_func", data_frame_bits)
POLYNOMIAL = int("1100010110011001", 2)  # ISO 11898-1: x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1


def remainder(bits: str) -> str:
    """CRC as the remainder of the whole message, times x^15, divided by the polynomial."""
    message = int(bits + "0" * 15, 2)
    while message.bit_length() > 15:
        message ^= POLYNOMIAL << (message.bit_length() - 16)
    return f"{message:015b}"


def stuffed(bits: str) -> str:
    sent = ""
    for bit in bits:
        sent += bit
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent += "10"[int(bit)]
    return sent


def on_wire(can_id: int, data: bytes, extended: bool = False, remote: bool = False) -> str:
    rtr = "1" if remote else "0"
    if extended:
        base, rest = f"{can_id:029b}"[:11], f"{can_id:029b}"[11:]
        head = "0" + base + "1" + "1" + rest + rtr + "00"
    else:
        head = "0" + f"{can_id:011b}" + rtr + "0" + "0"
    body = head + f"{len(data):04b}" + ("" if remote else "".join(f"{b:08b}" for b in data))
    return stuffed(body + remainder(body)) + "1" + "0" + "1" + "1" * 7 + "111"


def word(data: bytes) -> int:
    value = sum(b << (8 * i) for i, b in enumerate(data))
    return value - (1 << 64) if value >> 63 else value


def test_crc_of_the_oracle_is_the_published_one():
    # check value of CRC-15/CAN in the catalogue of parametrised CRC algorithms
    assert remainder("".join(f"{b:08b}" for b in b"123456789")) == f"{0x059E:015b}"


@pytest.mark.slow
@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("remote", [False, True])
def test_20000_seeded_random_frames(extended: bool, remote: bool):
    rng = random.Random(20260727)
    flags = CAN_EFF_FLAG * extended | CAN_RTR_FLAG * remote
    for i in range(5000):
        can_id = rng.getrandbits(29 if extended else 11)
        data = (
            rng.randbytes(rng.randrange(9)) if i % 3 else bytes(rng.choices([0, 0xFF, 0xF8, 0x1F], k=rng.randrange(9)))
        )
        expected = len(on_wire(can_id, data, extended, remote))
        assert data_frame_bits(can_id | flags, len(data), word(data)) == expected
        assert as_python(can_id | flags, len(data), word(data)) == expected
        assert frame_bits(can_id, data, extended=extended, remote=remote) == expected


@given(
    st.booleans().flatmap(lambda e: st.tuples(st.just(e), st.integers(0, 0x1FFFFFFF if e else 0x7FF))),
    st.binary(max_size=8),
    st.booleans(),
)
@settings(deadline=None)
@example((False, 0), b"", False)
@example((False, 0x7FF), b"\xff" * 8, False)
@example((True, 0x1FFFFFFF), b"\xff" * 8, False)
@example((True, 0), bytes(8), True)
def test_any_frame(kind: tuple[bool, int], data: bytes, remote: bool):
    extended, can_id = kind
    bits = frame_bits(can_id, data, extended=extended, remote=remote)
    assert bits == len(on_wire(can_id, data, extended, remote))
    sent = 0 if remote else len(data)
    assert 47 + 20 * extended + 8 * sent <= bits <= worst_case_bits(sent, extended)
    flags = CAN_EFF_FLAG * extended | CAN_RTR_FLAG * remote
    assert as_python(can_id | flags, len(data), word(data)) == bits


def test_sync_by_hand():
    # SOF, id 00010000000, RTR IDE r0, DLC 0, CRC 001110000000101; "i" is an inserted 1
    by_hand = "0000 1 00000 i 00000 i 0000 0 i 0 111 00000 i 00 101 1 0 1 1111111 111"
    bits = by_hand.replace(" ", "").replace("i", "1")
    assert on_wire(0x080, b"") == bits
    assert frame_bits(0x080, b"") == len(bits) == 51


def test_worst_cases_of_the_design():
    assert [worst_case_bits(n) for n in (0, 4, 5, 8)] == [55, 95, 105, 135]
    assert worst_case_bits(8, extended=True) == 160


def test_unused_bits_do_not_matter():
    assert data_frame_bits(0x181, 2, -1) == frame_bits(0x181, b"\xff\xff")
    assert data_frame_bits(0x181, 0, -(1 << 63)) == frame_bits(0x181, b"")
    assert data_frame_bits(CAN_RTR_FLAG | 0x181, 6, -1) == frame_bits(0x181, 6, remote=True)


def test_a_length_beyond_the_classical_frame_counts_as_eight():
    assert data_frame_bits(0x181, 15, -1) == frame_bits(0x181, b"\xff" * 8)
    assert data_frame_bits(0x181, -1, -1) == frame_bits(0x181, b"")


@pytest.mark.parametrize(
    ("arguments", "fix"),
    [
        ((0x800, b""), "extended=True"),
        ((-1, b""), "never negative"),
        ((0x80000123, b""), "can_id & 0x1FFFFFFF"),
        ((0x181, bytes(9)), "0 to 8"),
        ((0x181, 4), "remote=True"),
    ],
)
def test_a_callers_mistake_says_how_to_mend_it(arguments: tuple[int, bytes], fix: str):
    with pytest.raises(ValueError, match=re.escape(fix)):
        frame_bits(*arguments)


def test_mistakes_of_extended_and_remote_frames():
    with pytest.raises(ValueError, match="0x1fffffff"):
        frame_bits(0x20000000, b"", extended=True)
    with pytest.raises(ValueError, match="9 data bytes"):
        frame_bits(0x181, 9, remote=True)
    with pytest.raises(ValueError, match="9 data bytes"):
        worst_case_bits(9)


def test_the_second_oracle_agrees():
    # check value of CRC-15/CAN in the catalogue of parametrised CRC algorithms
    assert crc([bit for byte in b"123456789" for bit in numbered(byte, 8)]) == numbered(0x059E, 15)
    rng = random.Random(5)
    for _ in range(1000):
        extended, remote = rng.random() < 0.5, rng.random() < 0.3
        can_id, n = rng.getrandbits(29 if extended else 11), rng.randrange(9)
        data = rng.randbytes(n) if rng.random() < 0.6 else bytes(rng.choices([0, 0xFF, 0xF8, 0x1F, 0x83], k=n))
        sent = classical(can_id, data, extended, remote)
        assert frame_bits(can_id, data, extended=extended, remote=remote) == len(sent)
        assert "".join(map(str, sent)) == on_wire(can_id, data, extended, remote)
