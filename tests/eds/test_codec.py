"""The PDO codec against an oracle that moves one bit at a time, compiled and as plain Python."""

import struct
from types import FunctionType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds import codec
from coulombus.eds.codec import PDO, real_bits, real_value

exact = settings(derandomize=True, database=None, deadline=None, max_examples=120)


def plain(kernel):
    """The kernel as interpreted Python, together with the kernels that it calls."""
    function = getattr(kernel, "py_func", kernel)
    inner = {n: getattr(getattr(codec, n), "py_func", getattr(codec, n)) for n in ("get_field", "put_field")}
    return FunctionType(function.__code__, {**vars(codec), **inner})


FORMS = {
    "compiled": (codec.get_field, codec.put_field, codec.pack, codec.unpack),
    "plain": tuple(plain(k) for k in (codec.get_field, codec.put_field, codec.pack, codec.unpack)),
}
forms = pytest.mark.parametrize("form", FORMS)


# The oracle: a word is a list of 64 bits, least significant first. No shift, no mask.


def to_bits(number, width):
    """Bits of the two's complement of `number`, by repeated halving."""
    bits = []
    for _ in range(width):
        bits.append(number % 2)
        number = (number - number % 2) // 2
    return bits


def from_bits(bits, signed):
    weights = [2**i for i in range(len(bits))]
    if signed:
        weights[-1] = -weights[-1]
    return sum(w for w, bit in zip(weights, bits, strict=True) if bit)


def word_of(bits):
    return from_bits(bits, signed=True)


words = st.integers(-(2**63), 2**63 - 1)


@st.composite
def fields(draw):
    start = draw(st.integers(0, 63))
    return start, draw(st.integers(1, 64 - start)), draw(st.booleans())


@st.composite
def layouts(draw):
    """Fields side by side in 64 bits, any widths; None: a dummy."""
    rows, start = [], 0
    while start < 64 and len(rows) < 64:
        width = draw(st.one_of(st.integers(1, 4), st.sampled_from((8, 16, 24, 32, 40, 48, 56, 63, 64))))
        width = min(width, 64 - start)
        rows.append((start, width, draw(st.booleans()), draw(st.integers(0, 9)) == 0))
        start += width
        if draw(st.integers(0, 7)) == 0:
            break
    return rows


def record_of(rows):
    record = np.zeros(1, PDO).view(np.recarray)[0]
    record["count"] = len(rows)
    record["length"] = (sum(width for _, width, _, _ in rows) + 7) // 8
    record["slot"] = -1
    for i, (start, width, signed, dummy) in enumerate(rows):
        record["slot"][i] = -1 if dummy else i
        record["start"][i], record["bits"][i], record["signed"][i] = start, width, signed
    return record


@forms
@exact
@given(words, fields())
def test_a_field_is_read_bit_by_bit(form, word, field):
    start, width, signed = field
    expected = from_bits(to_bits(word, 64)[start : start + width], signed or width == 64)
    assert FORMS[form][0](word, start, width, int(signed)) == expected


@forms
@exact
@given(words, fields(), words)
def test_a_field_is_written_and_its_neighbours_are_untouched(form, word, field, value):
    start, width, _ = field
    bits = to_bits(word, 64)
    bits[start : start + width] = to_bits(value, 64)[:width]
    assert FORMS[form][1](word, start, width, value) == word_of(bits)


@pytest.mark.slow
@forms
@exact
@given(layouts(), st.lists(words, min_size=64, max_size=64))
def test_pack_places_every_field(form, rows, numbers):
    bits = [0] * 64
    for i, (start, width, _, dummy) in enumerate(rows):
        if not dummy:
            bits[start : start + width] = to_bits(numbers[i], 64)[:width]
    assert FORMS[form][2](record_of(rows), np.array(numbers, np.int64)) == word_of(bits)


@pytest.mark.slow
@forms
@exact
@given(layouts(), words)
def test_unpack_reads_every_field_and_no_other_slot(form, rows, word):
    values = np.full(66, 12345, np.int64)
    FORMS[form][3](record_of(rows), word, values)
    expected = [12345] * 66
    for i, (start, width, signed, dummy) in enumerate(rows):
        if not dummy:
            expected[i] = from_bits(to_bits(word, 64)[start : start + width], signed or width == 64)
    assert values.tolist() == expected


@pytest.mark.slow
@forms
@exact
@given(layouts(), words)
def test_pack_after_unpack_gives_the_mapped_bits_back(form, rows, word):
    _, _, pack, unpack = FORMS[form]
    record, values = record_of(rows), np.zeros(64, np.int64)
    unpack(record, word, values)
    bits = to_bits(word, 64)
    for i in range(64):
        if not any(start <= i < start + width and not dummy for start, width, _, dummy in rows):
            bits[i] = 0
    assert pack(record, values) == word_of(bits)


@forms
def test_numpy_integers_are_taken_as_they_stand_in_a_record(form):
    get, put, _, _ = FORMS[form]
    for start in range(64):
        for width in range(1, 65 - start):
            where = np.int64(start), np.int64(width)
            assert get(np.int64(-1), *where, np.int64(1)) == -1
            written = put(np.int64(0), *where, np.int64(-1))
            assert to_bits(int(written), 64) == [int(start <= i < start + width) for i in range(64)]


@forms
@pytest.mark.parametrize(
    ("octets", "number"),
    [
        ("01 00 00", 1),
        ("ff ff ff", -1),
        ("ff ff 7f", 8388607),
        ("00 00 80", -8388608),
        ("56 34 92", 0x923456 - 2**24),
    ],
)
def test_integer24_is_three_bytes_least_significant_first(form, octets, number):
    get, put, _, _ = FORMS[form]
    data = bytes.fromhex(octets)
    for byte in range(6):
        word = int.from_bytes(bytes(byte) + data + bytes(5 - byte), "little", signed=True)
        assert get(word, 8 * byte, 24, 1) == number
        assert put(0, 8 * byte, 24, number) == word


@forms
def test_a_motor_s_tpdo_byte_by_byte(form):
    """6041 = 0x1637, 6064 = -2, 6077 = -1000 as the bytes stand in a candump line."""
    _, _, pack, unpack = FORMS[form]
    record = record_of([(0, 16, False, False), (16, 32, True, False), (48, 16, True, False)])
    word = int.from_bytes(bytes.fromhex("37 16 fe ff ff ff 18 fc"), "little", signed=True)
    values = np.zeros(3, np.int64)
    unpack(record, word, values)
    assert values.tolist() == [0x1637, -2, -1000]
    assert pack(record, values) == word


@forms
@exact
@given(st.floats(width=32), st.integers(0, 32))
def test_real32_keeps_its_pattern_at_any_bit(form, number, start):
    get, put, _, _ = FORMS[form]
    pattern = real_bits(number, 32)
    assert to_bits(pattern, 32) == [b >> i & 1 for b in struct.pack("<f", number) for i in range(8)]
    back = real_value(get(put(-1, start, 32, pattern), start, 32, 0), 32)
    assert back == number or (np.isnan(back) and np.isnan(number))


@exact
@given(st.floats())
def test_real64_keeps_its_pattern(number):
    back = real_value(real_bits(number, 64), 64)
    assert back == number or (np.isnan(back) and np.isnan(number))
    assert -(2**63) <= real_bits(number, 64) < 2**63


def test_the_sign_of_a_real_does_not_spill_into_the_slot():
    assert real_bits(-1.0, 32) == 0xBF800000
    assert real_value(0xBF800000 - 2**32, 32) == -1.0
