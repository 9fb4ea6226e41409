"""Fields of data words as columns, against the same field of one word."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coulombus.eds.pdo import Entry
from coulombus.recording.pdo_columns import decode_field


@given(st.data(), st.integers(-(1 << 63), (1 << 63) - 1), st.booleans())
def test_a_column_and_one_word_have_the_same_integer(data, word, signed):
    bits = data.draw(st.integers(1, 64))
    start = data.draw(st.integers(0, 64 - bits))
    entry = Entry(0x6064, 0, bits, signed, "int", "position")
    assert entry.number(word, start) == decode_field(np.array([word]), start, entry)[0].item()


@pytest.mark.parametrize("bits", [32, 64])
@given(st.data(), st.integers(-(1 << 63), (1 << 63) - 1))
def test_a_column_and_one_word_have_the_same_real(bits, data, word):
    start = data.draw(st.integers(0, 64 - bits))
    entry = Entry(0x7130, 1, bits, False, "real", "torque")
    number, column = entry.number(word, start), decode_field(np.array([word]), start, entry)
    assert np.array_equal([number], column, equal_nan=True)
