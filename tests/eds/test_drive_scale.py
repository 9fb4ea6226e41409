"""A drive's scale of its position and velocity, and its polarity, against CiA 402-2's formula
reckoned here from increments.
"""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coulombus.eds.drive_scale import polarity, position_scale, velocity_unit

NUMBERS = st.integers(1, 10**6)
MILLIDEGREES, INCREMENTS = 0xFD410000, 0x00B50000


def values(**objects):
    """Return what tells objects: ``x6091=(10, 1)`` are the sub-indices 1 and 2, a number is 0."""
    stored = {}
    for name, value in objects.items():
        index = int(name[1:], 16)
        stored |= {(index, 0): value} if isinstance(value, int) else {(index, k): v for k, v in enumerate(value, 1)}
    return lambda index, subindex: stored.get((index, subindex))


def user_units(increments, resolution, gear, feed):
    """Position actual value, CiA 402-2, 6064h."""
    return Fraction(increments) * feed / (resolution * gear)


@given(st.integers(16, 10**7), NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_a_turn_of_the_motor_has_the_units_of_cia_402s_formula(increments, motor, shaft, feed, turns, revolutions):
    told = position_scale(values(x608F=(increments, revolutions), x6091=(motor, shaft), x6092=(feed, turns))).counts_rev
    if Fraction(feed, turns) == 1:  # nobody has set the feed
        resolution = Fraction(increments, revolutions)
        assert told == (pytest.approx(float(resolution)) if resolution >= 16 else None)
        return
    one_turn = Fraction(increments, revolutions)
    expected = user_units(one_turn, Fraction(increments, revolutions), Fraction(motor, shaft), Fraction(feed, turns))
    assert told == pytest.approx(float(expected))


@given(st.integers(16, 10**7), NUMBERS, NUMBERS)
def test_the_position_factor_of_the_first_edition_is_increments_in_a_unit(increments, numerator, denominator):
    told = position_scale(values(x608F=(increments, 1), x6093=(numerator, denominator)))
    factor = Fraction(numerator, denominator)  # position units x factor = increments
    assert told.counts_rev == pytest.approx(float(increments / factor))
    assert ("6093h" in told.by) == (factor != 1)


def test_a_position_factor_without_the_encoders_increments_tells_no_scale():
    assert position_scale(values(x6093=(8192, 360))).counts_rev is None
    assert position_scale(values(x6093=(8192, 360), x60A8=MILLIDEGREES)).counts_rev is None


@given(
    st.sampled_from([(0x10, 2 * math.pi), (0x41, 360), (0x42, 21_600), (0x43, 1_296_000)]), st.integers(-6, 0), NUMBERS
)
def test_an_angles_unit_tells_the_units_in_a_turn(unit, prefix, motor):
    numerator, turn = unit
    code = (prefix & 0xFF) << 24 | numerator << 16
    scale = position_scale(values(x608F=(8192, 1), x60A8=code, x6091=(motor, 1)))
    assert scale.counts_rev == pytest.approx(turn * 10**-prefix / motor)
    assert f"60A8h = 0x{code:08X}" in scale.by


@pytest.mark.parametrize(
    ("objects", "counts_rev"),
    [
        ({"x608F": (8192, 1), "x6091": (10, 1), "x6092": (3600, 1)}, 360),
        ({"x608F": (8192, 1), "x60A8": MILLIDEGREES}, 360_000),
        ({"x608F": (2000, 1), "x6091": (1, 1), "x6092": (1, 1), "x60A8": INCREMENTS}, 2000),
        ({"x608F": (4000, 1), "x6092": (51_200, 1)}, 51_200),
        ({"x608F": (20_000, 2)}, 10_000),
        ({"x608F": (20_000, 0)}, 20_000),
        ({"x608F": (8192, 1), "x60A8": 0x00B40000}, 8192),  # whole turns: nobody has set it
        ({"x608F": (1, 1), "x6092": (1, 1)}, None),
        ({}, None),
    ],
)
def test_what_stands_in_drives_of_the_field(objects, counts_rev):
    assert position_scale(values(**objects)).counts_rev == counts_rev


def test_a_unit_that_contradicts_the_feed_is_told():
    scale = position_scale(values(x608F=(8192, 1), x6092=(3600, 1), x60A8=MILLIDEGREES))
    assert scale.counts_rev == 3600
    assert "60A8h = 0xFD410000 means 360000 in a turn" in scale.by


def test_a_rig_file_agrees_but_for_the_rounding():
    scale = position_scale(values(x6091=(3, 1), x6092=(1000, 1)))
    assert scale.whole == 333
    assert scale.agrees(333)
    assert not scale.agrees(334)
    assert not scale.agrees(8192)
    assert position_scale(values()).agrees(8192)


@pytest.mark.parametrize(
    ("objects", "rad_s"),
    [
        ({"x60A9": 0x00B44700}, 2 * math.pi / 60),
        ({"x60A9": 0xFDB44700}, 2e-3 * math.pi / 60),
        ({"x60A9": 0xFD410300}, 1e-3 * math.pi / 180),
        ({"x60A9": 0x00B44700, "x6091": (10, 1)}, 20 * math.pi / 60),
        ({"x60A9": 0x00B50300, "x608F": (8192, 1), "x6091": (10, 1)}, 2 * math.pi / 8192),
    ],
)
def test_a_velocitys_unit_is_that_of_the_motor(objects, rad_s):
    assert velocity_unit(values(**objects)) == (pytest.approx(rad_s), "60A9h")


@pytest.mark.parametrize("objects", [{}, {"x60A9": 0x00010300}, {"x60A9": 0x00B50300}, {"x60A9": 0x00B40000}])
def test_a_velocity_without_an_angle_per_time_is_refused(objects):
    with pytest.raises(ValueError, match="60A9h"):
        velocity_unit(values(**objects))


@pytest.mark.parametrize(
    ("code", "signs"),
    [(None, (1, 1, 1)), (0, (1, 1, 1)), (0xC0, (-1, -1, 1)), (0x80, (-1, 1, 1)), (0x20, (1, 1, -1)), (0x1F, (1, 1, 1))],
)
def test_the_bits_of_the_polarity(code, signs):
    assert tuple(polarity(code)) == signs
