"""The wire: arbitration by identifier, one frame at a time, durations by the bit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coulombus.sim_bus.can_bus.arbiter import end_frame, new_bus, start_frame, start_ns
from coulombus.wire.bits import frame_bits
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import (
    CAN_EFF_FLAG,
    CAN_RTR_FLAG,
    QUEUE_CAPACITY,
    arbitration_key,
    data_word,
    frames,
    new_queue,
    push,
)


def carry(waiting, bitrate=1_000_000):
    """Carry frames (ready_ns, can_id, data) until none waits.

    Return (id, start, end) in the order of the wire.
    """
    bus = new_bus(bitrate)
    out = new_queue()
    log = frames(len(waiting))
    for source, (ready, can_id, data) in enumerate(waiting):
        push(out, source, ready, can_id, len(data), data_word(data))
    carried = []
    while (now := start_ns(bus[0], out)) < NEVER_NS:
        start_frame(bus[0], out, now)
        end_frame(bus[0], log, len(carried))
        carried.append((int(log["can_id"][len(carried)]), now, int(log["t_ns"][len(carried)])))
    assert bus["held"][0] == 0
    return carried


def test_lowest_identifier_of_those_that_are_ready_goes_first():
    order = carry([(0, 0x300, b""), (0, 0x081, b""), (0, 0x201, b"\1")])
    assert [can_id for can_id, _, _ in order] == [0x081, 0x201, 0x300]


def test_a_frame_on_the_wire_is_not_interrupted():
    order = carry([(0, 0x700, b"\5"), (1_000, 0x080, b"")])
    assert [can_id for can_id, _, _ in order] == [0x700, 0x080]


def test_times_are_the_frames_bits():
    data = b"\x00\x00\x12\x34"
    (first, second) = carry([(5_000, 0x181, data), (5_000, 0x182, data)], 500_000)
    bits = frame_bits(0x181, data)
    assert first[1:] == (5_000, 5_000 + (bits - 3) * 2_000)
    assert second[1] == 5_000 + bits * 2_000  # three bits of inter-frame space lie between


def test_equal_identifiers_keep_their_order():
    out = new_queue()
    bus, log = new_bus(1_000_000), frames(3)
    for n in range(3):
        push(out, 0, 0, 0x181, 1, n)
    for row in range(3):
        start_frame(bus[0], out, start_ns(bus[0], out))
        end_frame(bus[0], log, row)
    assert list(log["word"]) == [0, 1, 2]


def arbitration_bits(can_id):
    """The arbitration field as it is sent, most significant bit first (ISO 11898-1)."""
    remote = int(bool(can_id & CAN_RTR_FLAG))
    if can_id & CAN_EFF_FLAG:
        number = f"{can_id & 0x1FFFFFFF:029b}"
        return number[:11] + "1" + "1" + number[11:] + str(remote)
    return f"{can_id & 0x7FF:011b}" + str(remote) + "0"


identifiers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda i: i | CAN_EFF_FLAG)).flatmap(
    lambda i: st.sampled_from([i, i | CAN_RTR_FLAG])
)


@given(identifiers, identifiers)
def test_arbitration_agrees_with_a_bitwise_wire(a, b):
    """Dominant (0) wins at the first bit in which two fields differ."""
    one, two = arbitration_bits(a), arbitration_bits(b)
    differ = next((i for i, (x, y) in enumerate(zip(one, two, strict=False)) if x != y), None)
    if differ is None:
        return
    a_wins = one[differ] == "0"
    assert (arbitration_key(a) < arbitration_key(b)) == a_wins


def test_a_full_queue_drops_and_counts():
    out = new_queue()
    for n in range(QUEUE_CAPACITY + 3):
        push(out, 0, 0, n, 0, 0)
    assert out["count"] == QUEUE_CAPACITY
    assert out["dropped"] == 3


@pytest.mark.parametrize("bitrate", [125_000, 1_000_000, 8_000_000])
def test_the_bus_counts_its_bits(bitrate):
    bus, log = new_bus(bitrate), frames(1)
    out = new_queue()
    push(out, 0, 0, 0x80, 0, 0)
    start_frame(bus[0], out, 0)
    end_frame(bus[0], log, 0)
    assert bus["bits"][0] == frame_bits(0x80, b"")
    assert bus["free_ns"][0] == frame_bits(0x80, b"") * 1_000_000_000 // bitrate
