"""A bit of a signal sets a marker when it becomes 1."""

from __future__ import annotations

import pytest

from coulombus.host.run.markers import BitMark, BitMarks, bit_mark
from coulombus.kernels.records import new_records
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame

RIG = load_rig("bench")


def frames(*words, can_id=0x181, length=8, first_ns=0):
    """Return a frame a millisecond."""
    some = new_records(Frame, len(words))
    some["t_ns"] = [first_ns + 1_000_000 * k for k in range(len(words))]
    some["can_id"], some["length"], some["word"] = can_id, length, words
    return some


def test_a_signal_and_its_bits_are_found_in_the_pdo():
    mark = bit_mark("motor.statusword:0x400=target reached", RIG)
    (layout,) = (pdo.layout for pdo in RIG.pdos() if "motor.statusword" in [one.name for one in pdo.signals])
    assert (mark.can_id, mark.length) == (layout.cob_id, layout.length)
    assert mark.mask == 0x400 << layout.starts[0]
    assert mark.text == "mark target reached"


def test_each_rise_is_marked_at_its_frame_across_batches():
    bits = BitMarks([BitMark("motor.statusword", 0x181, 8, 0b110, "mark there")], RIG)
    assert bits.edges(frames(0b110, 0, 0b010, 0b111)) == [(3_000_000, "mark there")]
    assert bits.edges(frames(0b110, 0, first_ns=4_000_000)) == []
    assert bits.edges(frames(0b110, 0b110, first_ns=6_000_000)) == [(6_000_000, "mark there")]


def test_the_sign_bit_of_a_word_is_a_bit_like_another():
    bits = BitMarks([BitMark("motor.statusword", 0x181, 8, 1 << 63, "mark there")], RIG)
    assert bits.edges(frames(0, -(1 << 63))) == [(1_000_000, "mark there")]


@pytest.mark.parametrize("other", [{"can_id": 0x182}, {"length": 7}, {"can_id": 0x181 | 1 << 31}])
def test_other_frames_are_not_looked_at(other):
    bits = BitMarks([BitMark("motor.statusword", 0x181, 8, 1, "mark there")], RIG)
    assert bits.edges(frames(0, 1, **other)) == []


def test_a_signal_of_another_bus_is_not_looked_for_in_this_ones_frames():
    bits = BitMarks([BitMark("left.motor.statusword", 0x181, 8, 1, "mark there")], RIG)
    assert bits.edges(frames(0, 1)) == []


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ("motor.statusword", "expected SIGNAL:MASK=TEXT"),
        ("motor.statusword=there", "expected SIGNAL:MASK=TEXT"),
        ("motor.statusword:bit3=there", "expected SIGNAL:MASK=TEXT"),
        ("motor.statusword:0=there", "expected SIGNAL:MASK=TEXT"),
        ("motor.statusword:-1=there", "expected SIGNAL:MASK=TEXT"),
        ("motor.statusword:0x10000=there", "motor.statusword has 16 bits"),
        ("motor.statuswort:0x1=there", "no PDO of the rig carries the signal 'motor.statuswort'.*motor.statusword"),
        ("motor.statusword:0x1=", "'motor.statusword:0x1=': expected a text of 1 to"),
        ("motor.statusword:0x1=a\nb", "expected a text of 1 to"),
    ],
)
def test_what_names_no_bits_is_refused_with_the_reason(given, reason):
    with pytest.raises(ValueError, match=reason):
        bit_mark(given, RIG)
