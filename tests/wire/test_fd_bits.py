"""CAN FD frame lengths against a station that sends bit by bit, and by hand."""

from __future__ import annotations

import random
import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.bit_oracle import CRC_15, CRC_17, CRC_21, classical, crc, fd_lengths, flexible, numbered
from coulombus.wire.bits import FD_LENGTHS, fd_duration_ns, fd_frame_bits, frame_bits

CHECK = [bit for byte in b"123456789" for bit in numbered(byte, 8)]


@pytest.mark.parametrize(("kind", "check"), [(CRC_15, 0x059E), (CRC_17, 0x04F03), (CRC_21, 0x0ED841)])
def test_the_oracles_crcs_are_the_published_ones(kind, check):
    # check values of the catalogue of parametrised CRC algorithms, which begins at 0
    width, polynomial, _ = kind
    assert crc(CHECK, (width, polynomial, 0)) == numbered(check, width)


def test_the_oracle_by_hand():
    # id 555h: SOF, 10101010101, RRS IDE FDF res BRS | ESI, DLC 1, 2Ah | fixed bit, stuff count
    # 0000, ...
    station = flexible(0x555, b"\x2a")
    wire = "".join(map(str, station.wire))
    assert wire.startswith("0 10101010101 0 0 1 0 1 0 0001 00101010 1 0000 1".replace(" ", ""))
    assert wire.endswith("1 01 1111111 111".replace(" ", ""))
    assert fd_lengths(0x555, b"\x2a") == (17 + 12, 5 + 8 + 4 + 17 + 6 + 1)


def payload(rng, n):
    return rng.randbytes(n) if rng.random() < 0.6 else bytes(rng.choices([0, 0xFF, 0xF8, 0x1F, 0x83], k=n))


@pytest.mark.slow
@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("switch", [False, True])
def test_20000_seeded_random_frames(extended, switch):
    rng = random.Random(20261121)
    for _ in range(5000):
        can_id = rng.getrandbits(29 if extended else 11)
        data = payload(rng, rng.choice(FD_LENGTHS[:11] if rng.random() < 0.8 else FD_LENGTHS))
        expected = fd_lengths(can_id, data, extended, switch)
        assert fd_frame_bits(can_id, data, extended=extended, bitrate_switch=switch) == expected


@given(st.integers(0, 0x7FF), st.sampled_from(FD_LENGTHS).flatmap(lambda n: st.binary(min_size=n, max_size=n)))
@settings(deadline=None)
@example(0, b"")
@example(0x7FF, b"\xff" * 64)
@example(0, bytes(64))
def test_any_base_frame(can_id, data):
    assert fd_frame_bits(can_id, data) == fd_lengths(can_id, data)
    assert fd_frame_bits(can_id, data, bitrate_switch=False) == fd_lengths(can_id, data, switch=False)


def test_a_stuff_bit_due_after_the_last_data_bit_is_the_first_fixed_one():
    free, due = fd_frame_bits(0x555, b"\x2f"), fd_frame_bits(0x555, b"\x3f")
    assert free == fd_frame_bits(0x555, b"\x2a")  # four 1s at the end: none is due
    assert due[1] == free[1] + 1  # six 1s: one after the fifth, within the field
    assert fd_frame_bits(0x555, b"\x5f")[1] == free[1]  # five at the very end: the fixed one serves


def test_the_field_under_crc_21_is_five_bits_longer():
    data = b"\xaa" * 16
    assert fd_frame_bits(0x555, data + b"\xaa" * 4)[1] - fd_frame_bits(0x555, data)[1] == 32 + 4 + 1


def test_without_a_switch_all_bits_are_nominal():
    nominal, fast = fd_frame_bits(0x555, b"\xaa" * 8)
    assert fd_frame_bits(0x555, b"\xaa" * 8, bitrate_switch=False) == (nominal + fast, 0)


@pytest.mark.parametrize(("length", "fix"), [(9, "to 12"), (13, "to 16"), (17, "to 20"), (33, "to 48"), (63, "to 64")])
def test_another_length_is_told_the_next_larger_one(length, fix):
    with pytest.raises(ValueError, match=f"{length} data bytes.*{fix}"):
        fd_frame_bits(0x123, bytes(length))


def test_mistakes():
    with pytest.raises(ValueError, match="split the data"):
        fd_frame_bits(0x123, bytes(65))
    with pytest.raises(ValueError, match=re.escape("0..0x7ff")):
        fd_frame_bits(0x800)
    with pytest.raises(ValueError, match=re.escape("0..0x1fffffff")):
        fd_frame_bits(1 << 29, extended=True)
    with pytest.raises(ValueError, match="above 0"):
        fd_duration_ns(1, b"", 0, 1)
    with pytest.raises(ValueError, match="swap"):
        fd_duration_ns(1, b"", 2_000_000, 500_000)


def test_durations():
    assert fd_frame_bits(0x555, b"\x2a") == (29, 41)
    assert fd_duration_ns(0x555, b"\x2a", 500_000, 2_000_000) == 29 * 2000 + 41 * 500
    assert fd_duration_ns(0x555, b"\x2a", 1_000_000, 1_000_000) == 70_000
    assert fd_duration_ns(0x555, b"\x2a", 1_000_000, 3_000_000) == 29_000 + 13_667  # rounded up


def test_the_second_oracle_agrees_on_classical_frames():
    rng = random.Random(5)
    for _ in range(1000):
        extended, remote = rng.random() < 0.5, rng.random() < 0.3
        can_id, data = rng.getrandbits(29 if extended else 11), payload(rng, rng.randrange(9))
        sent = classical(can_id, data, extended, remote).wire
        assert frame_bits(can_id, data, extended=extended, remote=remote) == len(sent)
