"""The wire in slow motion, against the rules of ISO 11898-1 worked out by hand and against a
bitwise wire of its own.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.sim_bus.can_bus.bit_level import add_sender, begin_bits, run_bits
from coulombus.sim_bus.can_bus.fault_confinement import CanState, state_of
from coulombus.sim_bus.can_bus.faults import FaultKind
from coulombus.sim_bus.can_bus.noise import seeded
from coulombus.sim_bus.can_bus.records import CLIENTS, ErrorKind, Stage
from coulombus.sim_bus.can_bus.stations import attach, restart
from coulombus.sim_bus.can_bus.stuffing import stuffed_bits
from coulombus.wire.bits import frame_bits
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, arbitration_key, data_word
from wire_bench import WireBench, carried, told

US = 1_000
MS = 1_000_000
FRAME = b"\x55" * 8  # no stuff bits in its data
BUS_OFF, RESTARTED, ACK, CRTL = 0x40, 0x100, 0x20, 0x04


def wire_bits(can_id, data, remote=False, extended=False):
    """A frame as text, stuffed, up to the CRC's end: written from the standard's figures, with no
    code of the project's.
    """
    n = f"{len(data):04b}"
    if extended:
        plain = f"0{can_id >> 18:011b}11{can_id & 0x3FFFF:018b}{int(remote)}00{n}"
    else:
        plain = f"0{can_id:011b}{int(remote)}00{n}"
    plain += "" if remote else "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in plain:
        crc <<= 1
        if (crc >> 15) ^ int(bit):
            crc ^= 0x4599
        crc &= 0x7FFF
    plain += f"{crc:015b}"
    out = ""
    for bit in plain:
        out += bit
        if out.endswith(bit * 5):
            ended = len(out) - 5
            # a run that begins with a stuff bit counts it too: what was sent is what is counted
            if ended == 0 or out[ended - 1] != bit:
                out += "1" if bit == "0" else "0"
    return out


@settings(max_examples=60)
@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.booleans(), st.booleans())
def test_the_bits_of_a_frame(number, data, extended, remote):
    can_id = number if extended else number & 0x7FF
    flags = (CAN_EFF_FLAG if extended else 0) | (CAN_RTR_FLAG if remote else 0)
    out = np.zeros(160, np.int8)
    count = stuffed_bits(can_id | flags, len(data), 0 if remote else data_word(data), 0, out)
    assert "".join(map(str, out[:count])) == wire_bits(can_id, data, remote, extended) + "1" * 10
    assert count + 3 == frame_bits(can_id, len(data) if remote else data, extended=extended, remote=remote)


def flip(bus, bit, **values):
    bus.fault(FaultKind.FLIP, bit=bit, framed=1, match_id=0x181, match_mask=0x7FF, **values)


def test_a_bit_error_costs_flag_delimiter_and_the_frame_once_more():
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    flip(bus, 40)
    (error, frame) = bus.run()
    # bit 40 is wrong: flag 41..46, the receivers' flags begin with their sixth dominant bit at the
    # latest six bits later
    length = frame_bits(0x181, FRAME)
    assert error.t_ns == 41 * US
    restart = frame.t_ns - (length - 3) * US
    assert 41 + 6 + 8 + 3 <= restart // US <= 41 + 12 + 8 + 3
    assert frame.receivers == (1, 2)
    assert bus.errors(0) == (7, 0)  # + 8, and - 1 for the frame
    assert bus.errors(1) == bus.errors(2) == (0, 0)  # + 1 and - 1
    assert bus[0].errors[ErrorKind.BIT] == 1


def test_error_frame_of_the_kernels_format():
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    flip(bus, 40)
    (error,) = told(bus.run())
    assert error.can_id == CAN_ERR_FLAG | 0x200 | 0x80 | 0x08  # CNT, BUSERROR, PROT
    assert error.data[2] in (0x80 | 0x08, 0x80 | 0x10)  # TX, and the bit that could not be sent
    assert error.data[3] == 0x0A  # data section
    assert error.data[5:] == bytes((0, 8, 0))


@pytest.mark.parametrize(("bit", "place"), [(0, 0x03), (5, 0x02), (1000, 0x18), (1002, 0x1B), (1005, 0x1A)])
def test_the_place_of_an_error(bit, place):
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    flip(bus, bit)
    rows = bus.run()
    assert told(rows)[0].data[3] == place
    assert len(carried(rows)) == 1


def test_a_wrong_crc_is_seen_by_receivers_and_by_nobody_acknowledged():
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    bus.fault(FaultKind.CORRUPT_CRC, framed=1, match_id=0x181, match_mask=0x7FF)
    rows = bus.run()
    assert told(rows)[0].can_id & ACK
    assert len(carried(rows)) == 1
    assert bus[0].errors[ErrorKind.ACK] == 1
    assert (
        bus[1].errors[ErrorKind.CRC] + bus[1].errors[ErrorKind.FORM] == 1
    )  # the sender's flag falls on its ACK delimiter


def test_one_receiver_alone_disturbed_spoils_the_frame_for_all():
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    flip(bus, 40, station=2)
    rows = bus.run()
    assert [row.receivers for row in carried(rows)] == [(1, 2)]
    assert bus.errors(0) == (7, 0)
    assert bus.errors(2)[1] == 8  # + 1, + 8 (first bit behind its flag is dominant: rule b), - 1


def test_the_last_bit_but_one_and_the_last_bit_of_the_end_of_frame():
    """The classic: receivers have accepted, the sender sends again."""
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    flip(bus, 1009, station=0)
    assert [row.receivers for row in carried(bus.run())] == [(1, 2), (1, 2)]
    bus = WireBench()
    bus.send(0, 0x181, FRAME)
    flip(bus, 1009, station=2)  # a receiver: an overload frame, no error
    assert [row.receivers for row in carried(bus.run())] == [(1, 2)]
    assert bus.errors(0) == (0, 0)
    assert bus[2].overloads == 1


def test_alone_it_becomes_error_passive_and_never_bus_off():
    bus = WireBench((0,))
    bus.send(0, 0x181)
    rows = bus.run(until_ns=50 * MS)
    assert carried(rows) == []
    assert bus.errors(0) == (128, 0)
    assert bus[0].state == CanState.ERROR_PASSIVE
    assert all(row.can_id & ACK for row in rows if not row.can_id & CRTL)
    starts = [row.t_ns for row in rows if row.can_id & ACK]
    length = frame_bits(0x181, b"")
    # up to the ACK slot, six bits of flag, eight of delimiter, three of intermission; then eight
    # more: suspend transmission
    to_ack = length - 3 - 8
    assert {b - a for a, b in pairwise(starts[1:16])} == {(to_ack + 17) * US}
    assert {b - a for a, b in pairwise(starts[18:41])} == {(to_ack + 25) * US}


def test_who_comes_acknowledges():
    bus = WireBench((0,))
    bus.send(0, 0x181)
    bus.run(until_ns=50 * MS)
    attach(bus.bus, 1)
    bus.stations = (0, 1)
    (frame,) = carried(bus.run(until_ns=60 * MS))
    assert frame.receivers == (1,)
    assert bus.errors(0) == (127, 0)


def test_one_identifier_from_two_stations():
    bus = WireBench()
    bus.send(0, 0x181, b"\x01")
    bus.send(1, 0x181, b"\x00")
    rows = bus.run(until_ns=20 * MS)
    # both count + 8 each time, until both are error passive; then nobody is disturbed by the
    # loser's flag, and the dominant bit goes through
    assert bus[0].errors[ErrorKind.BIT] >= 16 <= bus[1].errors[ErrorKind.BIT]
    assert [(row.data, row.source) for row in carried(rows)] == [(b"\x00", 1), (b"\x01", 0)]
    assert bus[0].passives == bus[1].passives == 1
    # identical frames are one
    bus = WireBench()
    bus.send(0, 0x181, b"\x01")
    bus.send(1, 0x181, b"\x01")
    (frame,) = bus.run()
    assert frame.receivers == (2,)


def test_bus_off_and_128_times_11_recessive_bits():
    bus = WireBench()
    bus.fault(FaultKind.FLIP, bit=40, framed=1, match_id=0x181, match_mask=0x7FF, every=1)
    for _ in range(40):
        bus.send(0, 0x181, FRAME)
        bus.send(0, 0x182, FRAME)
    # every new frame of 181h is disturbed once: + 8 - 1 each, - 1 for each 182h
    rows = bus.run(until_ns=100 * MS)
    assert bus[0].passives == 1
    bus = WireBench()
    bus.set(0, tec=248)
    flip(bus, 40)
    bus.send(0, 0x181, FRAME)
    rows = bus.run(until_ns=100 * MS)
    off, back = (next(row for row in rows if row.can_id & what) for what in (BUS_OFF, RESTARTED))
    assert off.data[6] == 255
    runs = (back.t_ns - off.t_ns) / (11 * US)
    assert 127 <= runs <= 131
    assert bus.errors(0) == (0, 0)
    assert bus[0].state == CanState.ERROR_ACTIVE
    assert carried(rows) == []  # what it had to send is gone with it
    assert "bus-off" in str(state_of(bus[0]))


def test_bus_off_by_hand_only():
    bus = WireBench()
    bus.set(0, tec=255, restart_ns=-1)
    flip(bus, 40)
    bus.send(0, 0x181, FRAME)
    bus.run(until_ns=500 * MS)
    assert bus[0].state == CanState.BUS_OFF
    bus.send(0, 0x181, FRAME, 500 * MS)
    assert carried(bus.run(until_ns=600 * MS)) == []
    restart(bus.bus, 0, 600 * MS)
    bus.run(until_ns=700 * MS)
    assert bus[0].state == CanState.ERROR_ACTIVE


def test_error_passive_waits_eight_bits_longer():
    bus = WireBench()
    bus.set(0, tec=200, state=int(CanState.ERROR_PASSIVE))
    bus.send(0, 0x100)
    bus.send(0, 0x101)
    first, second = bus.run()
    assert second.t_ns - first.t_ns == (3 + 8 + frame_bits(0x101) - 3) * US
    bus = WireBench()
    bus.set(0, tec=200, state=int(CanState.ERROR_PASSIVE))
    bus.send(0, 0x100)
    bus.send(0, 0x101)
    bus.send(1, 0x7FF)  # another one uses the pause, whatever its identifier
    assert [row.can_id for row in bus.run()] == [0x100, 0x7FF, 0x101]


def test_rec_above_127_falls_to_119():
    bus = WireBench()
    bus.set(1, rec=140, state=int(CanState.ERROR_PASSIVE))
    bus.send(0, 0x100)
    bus.run()
    assert bus.errors(1) == (0, 119)
    assert bus[1].state == CanState.ERROR_WARNING


def test_stuck_dominant():
    bus = WireBench()
    bus.fault(FaultKind.STUCK_DOMINANT, from_ns=1 * MS, until_ns=2 * MS)
    bus.send(0, 0x181, FRAME, 1 * MS - 30 * US)  # in the midst of it the wire sticks
    bus.send(1, 0x182, FRAME, 1 * MS + 100 * US)
    rows = bus.run(until_ns=20 * MS)
    # the sender: + 8, then + 8 for each eight dominant bits more: bus-off within (256 / 8 - 1) x 8
    # bits and the flag
    off = next(row for row in rows if row.can_id & BUS_OFF)
    assert off.source == 0
    assert 31 * 8 - 8 <= (off.t_ns - 1 * MS) / US <= 31 * 8 + 24
    assert [row.can_id for row in carried(rows)] == [0x182]
    assert carried(rows)[0].t_ns > 2 * MS
    assert bus[1].passives == 1


def test_listen_only_loopback_one_shot_and_a_short_queue():
    bus = WireBench((0, 1))
    bus.set(1, listen_only=1)
    bus.send(0, 0x181)
    rows = bus.run(until_ns=5 * MS)  # it does not acknowledge, so the sender tries for ever;
    assert bus.errors(0) == (128, 0)
    assert bus.errors(1) == (0, 0)
    # as soon as the sender is error passive its flag is recessive, and who only listens takes each
    # attempt for a good frame
    first = next(row.t_ns for row in carried(rows))
    assert first > next(row.t_ns for row in told(rows) if row.can_id & CRTL and row.data[1] & 0x20)
    bus = WireBench((0,))
    bus.set(0, loopback=1)
    bus.send(0, 0x181)
    assert [row.receivers for row in bus.run()] == [(0,)]
    bus = WireBench()
    bus.set(0, one_shot=1)
    bus.send(0, 0x181, FRAME)
    flip(bus, 40)
    assert carried(bus.run()) == []
    assert bus[0].dropped == 1
    bus = WireBench()
    bus.set(0, queue_limit=2)
    for n in range(5):
        bus.send(0, 0x181, bytes((n,)))
    assert [row.data[0] for row in bus.run()] == [0, 1]
    assert bus[0].dropped == 3


def test_drop_delay_duplicate():
    bus = WireBench()
    bus.fault(FaultKind.DROP, framed=1, match_id=0x181, match_mask=0x7FF, station=2)
    bus.fault(FaultKind.DELAY, framed=1, match_id=0x182, match_mask=0x7FF, delay_ns=3 * MS)
    bus.fault(FaultKind.DUPLICATE, framed=1, match_id=0x183, match_mask=0x7FF)
    for can_id in (0x181, 0x182, 0x183):
        bus.send(0, can_id)
    rows = bus.run()
    assert [(row.can_id, row.receivers) for row in rows] == [
        *((0x181, (1,)), (0x183, (1, 2)), (0x183, (1, 2)), (0x182, (1, 2)))
    ]
    assert rows[-1].t_ns >= 3 * MS
    assert bus.errors(0) == (0, 0)


def test_a_babbler_with_the_highest_identifier_starves_all():
    bus = WireBench()
    row = {"can_id": 0, "station": 2, "period_ns": 10 * US, "from_ns": MS, "until_ns": 3 * MS}
    bus.fault(FaultKind.BABBLE, **row)
    for n in range(20):
        bus.send(0, 0x181, bytes((n,)), n * 200 * US)
    rows = bus.run(until_ns=20 * MS)
    mine = [row.t_ns for row in rows if row.can_id == 0x181]
    assert len(mine) == 20
    assert not [t for t in mine if 1.2 * MS < t < 3 * MS]
    assert sum(row.can_id == 0 for row in rows) > 30


@settings(max_examples=10)
@given(st.integers(0, 2**32), st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_noise_loses_nothing_unseen(seed, rate):
    """Each frame is received by all the others, perhaps twice, or its sender has been bus-off.

    Same seed, same rows.
    """

    def course():
        bus = WireBench()
        bus.bus.noise.state = seeded(seed)
        bus.fault(FaultKind.NOISE, rate=rate)
        for n in range(15):
            bus.send(n % 3, 0x100 + n, bytes((n, 0, 255)), n * 150 * US)
        return bus, bus.run(until_ns=50 * MS)

    bus, rows = course()
    got = {s: {row.can_id for row in carried(rows) if s in row.receivers} for s in range(3)}
    dropped = sum(int(bus[s].dropped) for s in range(3))
    lost = [n for n in range(15) if any(0x100 + n not in got[s] for s in range(3) if s != n % 3)]
    assert len(lost) <= dropped or any(bus[s].bus_offs for s in range(3))
    assert rows == course()[1]
    assert all(a.t_ns <= b.t_ns for a, b in pairwise(rows))


@settings(max_examples=40)
@given(st.integers(0, 0x7FF), st.integers(0, 0x7FF), st.booleans(), st.booleans())
def test_arbitration_bit_by_bit(a, b, extended, remote):
    """Played bit by bit, the station with the lower key has the wire: the same that the arbiter
    finds without a look at the bits.
    """
    other = (b << 18 | 77) | CAN_EFF_FLAG if extended else b | (CAN_RTR_FLAG if remote else 0)
    if other == a:
        return
    bus = WireBench()
    for source, can_id in ((0, a), (1, other)):
        add_sender(bus.bus, 0, can_id, 0, 0, source, 0)
    begin_bits(bus.bus, 0)
    while bus.bus.stage != Stage.OVER:
        run_bits(bus.bus)
    first = 0 if arbitration_key(a) < arbitration_key(other) else 1
    assert list(bus.bus.tx["state"][:2]) == ([1, 3] if first == 0 else [3, 1])
    assert bus.errors(0) == bus.errors(1) == (0, 0)


STRUCK = {"framed": 1, "match_id": 0x100, "match_mask": 0x7FF}


def test_a_frame_that_is_put_off_or_duplicated_is_no_retransmission():
    for kind, values in ((FaultKind.DELAY, {"delay_ns": 500 * US}), (FaultKind.DUPLICATE, {})):
        bench = WireBench()
        bench.fault(kind, **STRUCK, **values)
        bench.send(0, 0x100, b"a")
        assert len(carried(bench.run())) == (2 if kind == FaultKind.DUPLICATE else 1)
        assert (bench.bus.retransmissions, bench[0].retransmissions) == (0, 0)


def test_a_drop_and_a_duplicate_hold_for_a_frame_that_is_disturbed_too():
    """What the fault's count says has happened: the frame is destroyed first, and when it passes it
    is lost or sent twice.
    """
    for kind, receivers in ((FaultKind.DROP, [()]), (FaultKind.DUPLICATE, [(1, 2), (1, 2)])):
        bench = WireBench()
        bench.fault(kind, **STRUCK)
        bench.fault(FaultKind.FLIP, **STRUCK, bit=25)
        bench.send(0, 0x100, b"a")
        assert [row.receivers for row in carried(bench.run())] == receivers
        assert bench[0].retransmissions == 1


def test_the_remote_bit_of_a_base_frame_is_linuxs_srtr():
    """CAN_ERR_PROT_LOC_SRTR, 04h, is "substitute RTR (SFF: RTR)"; 0Ch is the extended frame's."""
    for can_id, bit, place in ((0x155, 12, 0x04), (0x80000000 | 0x15555555, 32, 0x0C)):
        bench = WireBench()
        bench.fault(FaultKind.FLIP, framed=1, match_id=can_id, match_mask=0xFFFFFFFF, bit=bit)
        bench.send(0, can_id, b"a")
        assert told(bench.run())[0].data[3] == place


def test_two_noises_at_a_time_and_one_goes_on_alone():
    """Each with its own rate, for all or for one receiver.

    The end of one is not the end of the other.
    """
    bus = WireBench()
    bus.bus.noise.state = seeded(1)
    bus.fault(FaultKind.NOISE, rate=5e-4)
    bus.fault(FaultKind.NOISE, rate=2e-4, station=1, until_ns=50 * MS)
    for n in range(600):
        bus.send(0, 0x100 + n % 7, FRAME, n * 200 * US)
    bus.run(120 * MS, rows=10_000)
    for_all, for_one = bus.bus.faults[0], bus.bus.faults[1]
    assert 30 < for_all.fired < 95  # of 120,000 bits, with frames or idle: 60
    assert 1 < for_one.fired < 24  # of 50,000 bits: 10
    assert for_one.last_ns < 51 * MS < 100 * MS < for_all.last_ns


@pytest.mark.parametrize("bit", range(44, 56))
def test_a_bit_that_the_frame_has_not_is_not_struck(bit):
    """SYNC has 47 bits with its stuff bits, and 3 of intermission: what is counted has happened."""
    bus = WireBench()
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x80, match_mask=0x7FF, bit=bit)
    bus.send(0, 0x80)
    rows = bus.run()
    assert bus.bus.faults[0].fired == len(told(rows)) == (1 if bit < 51 else 0)


def test_who_is_put_off_is_struck_by_nothing_else():
    """Neither at once nor, by mistake, the frame that goes instead."""
    bus = WireBench()
    for kind in (FaultKind.DROP, FaultKind.DUPLICATE, FaultKind.DELAY):
        bus.fault(kind, framed=1, match_id=0x80, match_mask=0x7FF, delay_ns=MS)
    bus.send(0, 0x80)
    bus.send(1, 0x90)
    assert [(row.can_id, row.receivers) for row in bus.run()] == [(0x90, (0, 2)), (0x80, (1, 2))]
    assert [int(fault.fired) for fault in bus.bus.faults[:3]] == [0, 0, 1]


def test_all_clients_as_one():
    """As senders of what a fault waits for, and as those whom it strikes.

    Bit 10 of SYNC is a stuff bit: who sees it dominant has an error.
    """
    bus = WireBench((0, 1, 128, 159))
    match = {"framed": 1, "match_mask": 0x7FF, "station": CLIENTS}
    bus.fault(FaultKind.FLIP, match_id=0x80, bit=10, **match)
    bus.fault(FaultKind.DROP, match_id=0x90, match_source=CLIENTS, **match)
    bus.fault(FaultKind.DROP, match_id=0xA0, **match)
    for source, can_id, t_ns in ((0, 0x80, 0), (0, 0x90, 0), (0, 0xA0, 0), (159, 0x90, MS)):
        bus.send(source, can_id, t_ns=t_ns)
    rows = bus.run()
    assert [row.source for row in told(rows)] == [128]
    assert [row.receivers for row in carried(rows)] == [(1, 128, 159), (1, 128, 159), (1,), (0, 1)]
