"""The nearest integer of an object's width: its range has two ends."""

import math

import pytest

from coulombus.eds.codec import nearest_integer


@pytest.mark.parametrize(("bits", "lowest", "highest"), [(16, -32768, 32767), (32, -2147483648, 2147483647)])
def test_the_nearest_integer_ends_at_the_ends_of_its_range(bits, lowest, highest):
    for value in (lowest, lowest + 1, -1, 0, 1, highest - 1, highest):
        assert nearest_integer(float(value), bits) == value
        assert nearest_integer(value + 0.4, bits) == nearest_integer(value - 0.4, bits) == value
    for value in (highest + 1.0, highest + 0.6, math.inf):
        assert nearest_integer(value, bits) == highest
    for value in (lowest - 1.0, lowest - 0.6, -math.inf, math.nan):
        assert nearest_integer(value, bits) == lowest
