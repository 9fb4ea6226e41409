"""One way of a bridge, without a bus: what passes, what waits, what is dropped and how that is
counted.
"""

from __future__ import annotations

import random

import pytest

from coulombus.sim_bus.server import bridge as module
from coulombus.sim_bus.server.bridge import QUEUE_FRAMES, Result, SameBus, bridge, faults
from coulombus.wire.address import BusAddress, parse_address
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_RTR_FLAG
from coulombus.wire.client import CAN_FRAME, BusDown, BusFull

MS = 1_000_000
FRAME = (0x181, 3, b"\x01\x02\x03\0\0\0\0\0")


class Client:
    """One end: frames to receive, and what is sent."""

    def __init__(self, kind="coulombus"):
        self.address, self.waiting, self.sent, self.error = BusAddress(kind, "x"), [], [], None
        self.lost, self.malformed, self.held = 0, 0, False
        self.stamps_ns = []  # of what was sent

    def receive(self):
        """Frames, each received 100 ns after the one before it."""
        if self.error:
            raise self.error
        found, self.waiting = self.waiting, []
        return [(100 * k, *frame) for k, frame in enumerate(found)]

    def hold(self, held):
        self.held = held

    def send(self, message, stamp_ns=0):
        if self.error:
            raise self.error
        self.sent.append([can_id for can_id, _, _ in CAN_FRAME.iter_unpack(message)])
        self.stamps_ns.append(stamp_ns)


def way(between=None, ranges=(), room=QUEUE_FRAMES, kind="coulombus"):
    source, sink = Client(), Client(kind)
    return module._Way(source, sink, between or faults(), ranges, room), source, sink


def frame(can_id):
    return can_id, *FRAME[1:]


# what happens in between


def test_a_frame_goes_on_as_it_is_where_nothing_happens_to_it():
    assert list(faults()(FRAME)) == [(0, FRAME)]
    ((delay_ns, found),) = faults(2.5)(FRAME)
    assert (type(delay_ns), delay_ns, found) == (int, 2_500_000, FRAME)


@pytest.mark.parametrize("share", [0.25, 0.75])
@pytest.mark.parametrize("kind", ["drop", "duplicate", "corrupt"])
def test_each_fault_has_its_share_by_the_dice(kind, share):
    """The dice are those of the seed: one throw for each fault that there is."""
    between, dice = faults(seed=3, **{kind: share}), random.Random(3)
    for _ in range(100):
        hit = dice.random() < share
        found = list(between(FRAME))
        if kind == "corrupt":
            bit = dice.randrange(24) if hit else None
            data = bytearray(FRAME[2])
            if bit is not None:
                data[bit // 8] ^= 1 << bit % 8
            assert found == [(0, (0x181, 3, bytes(data)))]
        else:
            assert len(found) == ({"drop": 0, "duplicate": 2}[kind] if hit else 1)
            assert set(found) <= {(0, FRAME)}


@pytest.mark.parametrize(
    ("given", "turned"),
    [
        ((0x181, 0, bytes(8)), False),
        ((0x181 | CAN_RTR_FLAG, 8, bytes(8)), False),
        ((0x181, 1, bytes(8)), True),
        ((0x181 | CAN_EFF_FLAG, 8, bytes(8)), True),
    ],
)
def test_a_bit_is_turned_in_data_only(given, turned):
    ((_, (can_id, length, data)),) = faults(corrupt=1.0)(given)
    assert (can_id, length, len(data)) == (*given[:2], 8)
    assert sum(byte.bit_count() for byte in data) == turned
    assert data[length:] == bytes(8 - length)


@pytest.mark.parametrize("kind", ["drop", "duplicate", "corrupt"])
def test_a_throw_of_just_the_share_is_no_hit(kind):
    assert list(faults(seed=3, **{kind: random.Random(3).random()})(FRAME)) == [(0, FRAME)]


def test_faults_that_are_certain_happen_to_every_frame():
    assert not list(faults(drop=1.0)(FRAME))
    assert len(list(faults(1.0, duplicate=1.0)(FRAME))) == 2


# one way


@pytest.mark.parametrize(("kind", "at_once"), [("coulombus", 64), ("socketcan", 1)])
def test_frames_go_in_their_order_as_many_at_once_as_the_bus_takes(kind, at_once):
    one, source, sink = way(kind=kind)
    source.waiting = [frame(k) for k in range(1, 71)]
    one.receive(5)
    assert one.next_ns == 5
    one.give(4)
    assert sink.sent == []
    one.give(5)
    assert [len(message) for message in sink.sent] == ([64, 6] if at_once == 64 else [1] * 70)
    assert [one for message in sink.sent for one in message] == list(range(1, 71))
    assert one.next_ns is None
    assert (one.counts.received, one.counts.forwarded, one.counts.refused) == (70, 70, 0)


def test_a_frame_that_is_delayed_less_overtakes():
    delays = iter([3 * MS, MS, 2 * MS, MS])
    one, source, sink = way(lambda given: [(next(delays), given)])
    source.waiting = [frame(k) for k in (1, 2, 3, 4)]
    one.receive(10 * MS)
    assert one.next_ns == 11 * MS
    one.give(11 * MS - 1)
    assert sink.sent == []
    one.give(11 * MS)
    assert sink.sent == [[2, 4]]
    one.give(13 * MS)
    assert sink.sent == [[2, 4], [3, 1]]


def test_a_message_has_the_time_at_which_its_first_frame_came_and_the_delay():
    delays = iter([0, 0, 2 * MS, 2 * MS])
    forward, source, sink = way(lambda can_frame: [(next(delays), can_frame)])
    source.waiting = [frame(k) for k in (1, 2, 3, 4)]
    forward.receive(0)
    forward.give(2 * MS - 1)
    forward.give(2 * MS)
    assert (sink.sent, sink.stamps_ns) == ([[1, 2], [3, 4]], [0, 200 + 2 * MS])


@pytest.mark.parametrize(("room", "half"), [(4, 2), (5, 2)])
def test_a_bus_is_held_while_more_than_half_of_the_room_waits(room, half):
    delays = iter([0, MS, 2 * MS, 3 * MS])
    forward, source, _ = way(lambda can_frame: [(next(delays), can_frame)], room=room)
    for count in range(1, 5):
        source.waiting = [FRAME]
        forward.receive(0)
        assert source.held == (count > half)
    for sent in range(1, 5):
        forward.give((sent - 1) * MS)
        assert source.held == (4 - sent > half)


@pytest.mark.parametrize("flag", [0, CAN_RTR_FLAG])
def test_only_the_identifiers_that_were_asked_for_pass(flag):
    one, source, sink = way(ranges=((0x181, 0x183), (0x200, 0x200)))
    source.waiting = [frame(k | flag) for k in (0x180, 0x181, 0x183, 0x184, 0x1FF, 0x200, 0x201)]
    one.receive(0)
    one.give(0)
    assert sink.sent == [[k | flag for k in (0x181, 0x183, 0x200)]]
    assert (one.counts.received, one.counts.filtered, one.counts.dropped) == (7, 4, 0)


def test_a_frame_of_which_nothing_goes_on_is_dropped_and_one_without_room_overflows():
    turns = iter([0, 1, 2, 0, 1])
    one, source, _ = way(lambda given: [(0, given)] * next(turns), room=2)
    source.lost = 3
    source.waiting = [frame(k) for k in range(1, 6)]
    one.receive(0)
    counts = one.counts
    assert (counts.received, counts.dropped, counts.overflow, counts.lost) == (5, 2, 2, 3)
    one.give(0)
    assert one.counts.forwarded == 2


@pytest.mark.parametrize("error", [BusFull("full"), BusDown("down")])
def test_what_a_bus_does_not_take_is_tried_again_a_millisecond_later_in_its_order(error):
    one, source, sink = way()
    source.waiting = [frame(k) for k in (1, 2, 3)]
    one.receive(0)
    sink.error = error
    one.give(7)
    assert (one.counts.refused, one.counts.forwarded) == (1, 0)
    assert one.next_ns == 7 + MS
    sink.error = None
    one.give(6 + MS)
    assert sink.sent == []
    one.give(7 + MS)
    assert sink.sent == [[1, 2, 3]]
    assert (one.counts.refused, one.counts.forwarded) == (1, 3)
    source.waiting = [frame(4)]
    one.receive(9 * MS)
    assert one.next_ns == 9 * MS


def test_nothing_is_taken_of_a_bus_that_is_down():
    one, source, _ = way()
    source.error, source.lost = BusDown("down"), 5
    one.receive(0)
    assert (one.counts.received, one.counts.lost, one.next_ns) == (0, 0, None)


# both


def test_a_bus_is_not_joined_with_itself():
    address = parse_address("coulombus:a")
    with pytest.raises(SameBus, match=r"^both ends are coulombus:a: a bridge joins two buses$") as refused:
        bridge(address, parse_address("coulombus:a"))
    assert refused.value.exit_status == 2


@pytest.mark.parametrize(("gone", "status"), [(None, 0), ("bus a is gone", 4)])
def test_a_bus_that_has_gone_is_an_exit_status(gone, status):
    result = Result(gone=gone)
    assert result.exit_status == status
    assert result.as_dict() == {"ways": {}, "seconds": 0.0, "gone": gone}
