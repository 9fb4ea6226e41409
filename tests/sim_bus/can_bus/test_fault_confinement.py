"""Fault confinement rule by rule (ISO 11898-1:2015, 12.1.4.2; the table in
`sim_bus.can_bus.fault_confinement`), overload frames, and who is out of step.

Each scenario is worked out by hand. Unless it is said otherwise station 0 sends 181h once, and 1
and 2 receive; `EOF1` is the first bit of the end of frame, so an error that all see in it is
followed by error flags from `EOF1 + 1` to `EOF1 + 6`, and a delimiter of eight bits.
"""

from __future__ import annotations

import pytest

from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.faults import TAIL_BIT, FaultKind
from coulombus.sim_bus.can_bus.records import Delivered, ErrorKind
from coulombus.sim_bus.can_bus.stuffing import TAIL_BITS
from coulombus.sim_bus.can_bus.tx_queue import withdraw
from coulombus.wire.bits import frame_bits
from coulombus.wire.frame import CAN_ERR_FLAG
from wire_bench import US, WireBench, carried, told

FRAME = b"\x55" * 8  # no stuff bits in its data
LENGTH = frame_bits(0x181, FRAME)  # with intermission
CRC_DELIMITER, ACK_SLOT, ACK_DELIMITER, EOF1 = range(TAIL_BIT, TAIL_BIT + 4)
INTERMISSION1 = TAIL_BIT + TAIL_BITS
PASSIVE = int(CanState.ERROR_PASSIVE)
LOSTARB, BUS_OFF, RESTARTED, OVERLOAD = 0x02, 0x40, 0x100, 0x20
MS = 1_000_000


def flipped(*bits, set_up=None, data=FRAME, can_id=0x181, one_shot=1):
    """The bus after 181h with these bits turned around: each for all, or (bit, station) for one."""
    bus = WireBench()
    bus.set(0, one_shot=one_shot)
    for station, values in (set_up or {}).items():
        bus.set(station, **values)
    for bit in bits:
        bit, station = bit if isinstance(bit, tuple) else (bit, None)
        values = {} if station is None else {"station": station}
        if bit >= INTERMISSION1 + 3:  # behind the frame
            begin = (LENGTH - 3 + bit - INTERMISSION1) * US
            bus.fault(FaultKind.STUCK_DOMINANT, from_ns=begin, until_ns=begin + US)
            continue
        bus.fault(FaultKind.FLIP, framed=1, match_id=can_id, match_mask=0x7FF, bit=bit, **values)
    bus.send(0, can_id, data)
    bus.rows = bus.run(until_ns=5 * MS)
    return bus


def counters(bus):
    return [bus.errors(station) for station in bus.stations]


def passive(tec=0, rec=0):
    return {"tec": tec, "rec": rec, "state": PASSIVE}


def test_a_and_b_the_receiver_that_is_first_counts_1_and_8():
    """Station 2 has a wrong bit, so a wrong CRC: its flag begins in EOF1, all others' flags one bit
    later, so it sees one dominant bit more.
    """
    assert counters(flipped((40, 2))) == [(8, 0), (0, 1), (0, 9)]


@pytest.mark.parametrize(("tec", "after"), [(0, 8), (120, 128), (136, 144)])
def test_c_a_transmitter_counts_8(tec, after):
    assert flipped(EOF1 + 2, set_up={0: {"tec": tec}}).errors(0) == (after, 0)


def test_c1_no_ack_in_error_passive_counts_nothing_unless_its_flag_meets_something_dominant():
    assert flipped((ACK_SLOT, 0)).errors(0) == (8, 0)
    assert flipped((ACK_SLOT, 0), set_up={0: passive(tec=130)}).errors(0) == (130, 0)
    assert flipped((ACK_SLOT, 0), (EOF1 + 2, 0), set_up={0: passive(tec=130)}).errors(0) == (138, 0)


def test_c2_a_stuff_error_in_the_arbitration_field_is_not_the_transmitters():
    """020h: SOF and four dominant bits, then a recessive stuff bit (5).

    Behind the arbitration, in the data, it counts.
    """
    bus = flipped(5, can_id=0x020)
    assert counters(bus) == [(0, 0), (0, 1), (0, 1)]
    assert bus[0].errors[ErrorKind.STUFF] == 1
    # 555h has no stuff bits; the DLC of eight bytes ends 000b, so with the data's first two
    # dominant bits a stuff bit is due: bit 21
    bus = flipped(21, can_id=0x555, data=b"\x00" + FRAME[1:])
    assert bus[0].errors[ErrorKind.BIT] == 1
    assert bus.errors(0) == (8, 0)


def test_d_and_e_a_flag_that_is_not_seen_dominant_begins_anew_and_counts_8():
    assert flipped(EOF1, (EOF1 + 3, 0)).errors(0) == (16, 0)
    # the new flag of one is three bits longer than the others': they see dominant after theirs
    # (rule b)
    assert counters(flipped(EOF1, (EOF1 + 3, 2))) == [(8, 0), (0, 9), (0, 9)]
    # an overload flag: no error before it
    assert flipped(INTERMISSION1, (INTERMISSION1 + 2, 0)).errors(0) == (8, 0)
    assert flipped(INTERMISSION1, (INTERMISSION1 + 2, 2)).errors(2) == (0, 8)


@pytest.mark.parametrize("more", [0, 1, 7, 8, 15, 16, 24])
@pytest.mark.parametrize("is_passive", [False, True])
def test_f_dominant_bits_after_a_flag(more, is_passive):
    """The wire is dominant from EOF1 on: six bits of flag, active or passive, and so many more.

    The transmitter's passive flag completes as well.
    """
    before = 128 if is_passive else 0
    set_up = {0: passive(tec=before), 2: passive(rec=before)} if is_passive else {}
    bus = WireBench()
    bus.set(0, one_shot=1)
    for station, values in set_up.items():
        bus.set(station, **values)
    begin = (LENGTH - 3 - 7) * US
    bus.fault(FaultKind.STUCK_DOMINANT, from_ns=begin, until_ns=begin + (7 + more) * US)
    bus.send(0, 0x181, FRAME)
    bus.run(until_ns=5 * MS)
    acknowledged = 119 if is_passive else 0  # rule h, in the ACK slot
    assert bus.errors(0) == (before + 8 + more // 8 * 8, 0)
    assert bus.errors(2) == (0, acknowledged + 1 + (8 if more else 0) + more // 8 * 8)


@pytest.mark.parametrize(("tec", "after"), [(0, 0), (1, 0), (128, 127), (200, 199)])
def test_g_a_frame_that_was_sent(tec, after):
    for flips in ((), ((1, 7),)):  # by its length, and bit by bit: station 7 is not there
        assert flipped(*flips, set_up={0: {"tec": tec, "state": PASSIVE if tec > 127 else 0}}).errors(0) == (after, 0)


@pytest.mark.parametrize(("rec", "after"), [(0, 0), (1, 0), (127, 126), (128, 119), (200, 119)])
def test_h_a_frame_that_was_received(rec, after):
    for flips in ((), ((1, 7),)):
        assert flipped(*flips, set_up={2: {"rec": rec, "state": PASSIVE if rec > 127 else 0}}).errors(2) == (0, after)


def test_h_counts_up_to_the_ack_slot():
    """What comes behind it counts on top: - 1 in the ACK slot, + 1 for the form error."""
    assert flipped(EOF1 + 2, set_up={2: {"rec": 50}}).errors(2) == (0, 50)
    assert flipped((40, 2), set_up={1: {"rec": 50}, 2: {"rec": 50}}).errors(2) == (0, 59)  # a wrong CRC: none


@pytest.mark.parametrize(("tec", "seen"), [(127, True), (128, False)])
def test_i_the_error_that_makes_it_error_passive_is_still_flagged_active(tec, seen):
    bus = flipped((EOF1 + 2, 0), set_up={0: {"tec": tec, "state": PASSIVE if tec > 127 else 0}})
    assert bus[0].state == PASSIVE
    assert bus.errors(1) == (0, 1 if seen else 0)
    assert len(carried(bus.rows)) == (0 if seen else 1)  # a passive flag destroys nothing: the receivers have it


@pytest.mark.parametrize(("tec", "state"), [(247, CanState.ERROR_PASSIVE), (248, CanState.BUS_OFF)])
def test_j_bus_off_above_255(tec, state):
    assert flipped(EOF1 + 2, set_up={0: {**passive(tec=tec), "restart_ns": -1}})[0].state == state


@pytest.mark.parametrize("tec", [128, 129])
def test_k_error_active_again_when_both_are_below_128(tec):
    """Error active with a warning, as Linux has it."""
    assert flipped(set_up={0: passive(tec=tec)})[0].state == (CanState.ERROR_WARNING if tec == 128 else PASSIVE)
    assert flipped(set_up={0: passive(tec=128, rec=128)})[0].state == PASSIVE


def off_and_back(rows):
    """When the bus-off and the recovery were told."""
    return [next(row.t_ns for row in rows if row.can_id & what) for what in (BUS_OFF, RESTARTED)]


def test_l_recovery_after_128_times_11_recessive_bits_to_the_bit():
    """On an idle wire: from the last dominant bit, the end of the others' flags, on."""
    bus = flipped(EOF1 + 2, set_up={0: passive(tec=248)})
    off, back = off_and_back(bus.rows)
    assert off == (LENGTH - 3 - 4) * US  # at the end of EOF3: it is silent from here on
    assert back == off + (6 + 128 * 11) * US
    assert bus.errors(0) == (0, 0)


def test_l_each_frame_has_one_run_of_11_recessive_bits():
    """Frame after frame, without a gap: ACK delimiter, end of frame and intermission are 11 bits,
    and there are no others.
    """
    bus = WireBench()
    bus.set(0, one_shot=1, **passive(tec=248))
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x181, match_mask=0x7FF, bit=EOF1 + 2)
    bus.send(0, 0x181, FRAME)
    for _ in range(140):
        bus.send(1, 0x200)
    off, back = off_and_back(rows := bus.run(until_ns=20 * MS))
    # eight bits of delimiter and three of intermission are the first run; what has been reached is
    # told at the end of the next frame
    assert len([row for row in rows if row.can_id == 0x200 and off < row.t_ns < back]) == 127


def test_l_a_glitch_breaks_a_run():
    """Ten recessive bits, one dominant, again and again, are no run at all."""
    bus = WireBench((0, 1))
    bus.set(0, listen_only=1)  # so nobody answers the glitches with a flag
    bus.set(1, state=int(CanState.BUS_OFF), restart_at_ns=0, runs_left=1)
    for n in range(20):
        bus.fault(FaultKind.STUCK_DOMINANT, from_ns=(1 + 11 * n) * US, until_ns=(2 + 11 * n) * US)
    (row,) = [row for row in bus.run(until_ns=MS) if row.can_id & RESTARTED]
    assert 0 <= row.t_ns - (1 + 11 * 19 + 1 + 11) * US <= 6 * US  # told when the other one is idle again


@pytest.mark.parametrize("bit", [INTERMISSION1, INTERMISSION1 + 1])
def test_overload_a_dominant_bit_in_the_first_two_of_intermission(bit):
    """No error: six bits of flag, eight of delimiter, and intermission again."""
    bus = WireBench()
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x181, match_mask=0x7FF, bit=bit)
    bus.send(0, 0x181, FRAME)
    bus.send(1, 0x200)
    first, error, second = bus.run()
    assert error.data[2] & OVERLOAD
    assert second.t_ns - first.t_ns == (bit - INTERMISSION1 + 1 + 6 + 8 + frame_bits(0x200)) * US
    assert counters(bus) == [(0, 0)] * 3
    assert [int(bus[station].overloads) for station in bus.stations] == [1, 1, 1]


def test_the_last_bit_of_a_delimiter_is_overload_the_one_before_it_a_form_error():
    delimiter8 = EOF1 + 6 + 8
    assert counters(flipped(EOF1, delimiter8)) == counters(flipped(EOF1)) == [(8, 0), (0, 1), (0, 1)]
    assert counters(flipped(EOF1, delimiter8 - 1)) == [(16, 0), (0, 2), (0, 2)]
    assert flipped(EOF1, delimiter8)[1].overloads == 1
    # behind an overload flag as well, and as often as the wire asks for it
    twice = flipped(INTERMISSION1, INTERMISSION1 + 6 + 8)
    assert counters(twice) == [(0, 0)] * 3
    assert [int(twice[station].overloads) for station in twice.stations] == [2, 2, 2]


def test_the_last_bit_of_the_end_of_frame_is_overload_for_receivers_an_error_for_the_transmitter():
    bus = flipped(EOF1 + 6)
    assert counters(bus) == [(8, 0), (0, 0), (0, 0)]
    assert [int(bus[station].overloads) for station in bus.stations] == [0, 1, 1]
    assert [row.receivers for row in carried(bus.rows)] == [(1, 2)]


@pytest.mark.parametrize(
    ("set_up", "joins"), [({}, True), ({1: passive(tec=130)}, True), ({0: passive(tec=130)}, False)]
)
def test_the_third_bit_of_intermission_is_a_start_of_frame_and_who_waits_joins_in(set_up, joins):
    """It sends its identifier next, so the frame ends one bit early.

    An error-passive sender of the last frame may not.
    """
    bus = WireBench()
    for station, values in set_up.items():
        bus.set(station, **values)
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x181, match_mask=0x7FF, bit=INTERMISSION1 + 2)
    sender = 1 if 1 in set_up or not set_up else 0
    bus.send(0, 0x181, FRAME)
    bus.send(sender, 0x200)
    rows = bus.run()
    first, second = carried(rows)
    assert second.receivers == tuple(station for station in bus.stations if station != sender)
    if joins:
        assert second.t_ns - first.t_ns == (frame_bits(0x200) - 1) * US
        assert [row for row in told(rows) if row.can_id & 0x80] == []
    else:  # all take the bit for a start of frame, find a stuff error in the sixth bit behind it, and flag that
        assert second.t_ns - first.t_ns == (3 + 6 + 6 + 8 + frame_bits(0x200)) * US
        assert bus[0].errors[ErrorKind.STUFF] == bus[1].errors[ErrorKind.STUFF] == 1


@pytest.mark.parametrize("gap", range(9))
def test_an_error_passive_receiver_that_alone_saw_an_error_is_behind_the_others(gap):
    """A wrong CRC: its passive flag is EOF1 to EOF6, its delimiter EOF7, intermission and four bits
    more, then its intermission.

    A frame that starts `gap` bits after the others' intermission is in the delimiter's bits 5, 6 or
    7 (form error, the frame is missed), in bit 8 or in the first two of intermission (overload
    flag: it destroys the frame), or is a start of frame for it too.
    """
    bus = WireBench()
    bus.set(2, **passive(rec=130))
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x181, match_mask=0x7FF, bit=40, station=2)
    bus.send(0, 0x181, FRAME)
    bus.send(1, 0x155, FRAME, (LENGTH + gap) * US)
    rows = bus.run()
    first, second = carried(rows)
    assert first.receivers == (1,)
    length = frame_bits(0x155, FRAME)
    if gap < 3:
        assert second.receivers == (0,)
        assert bus.errors(2) == (0, 132)
        assert second.t_ns == (LENGTH + gap + length - 3) * US
    elif gap < 6:
        assert second.receivers == (0, 2)
        assert bus[2].overloads == 1
        assert bus[1].retransmissions == 1
        assert bus.errors(2) == (0, 119)
    else:
        assert second.receivers == (0, 2)
        assert bus.errors(2) == (0, 119)
        assert second.t_ns == (LENGTH + gap + length - 3) * US
        assert bus[1].retransmissions == 0


def test_its_own_frame_waits_until_it_is_back():
    """The passive flag ends with EOF6.

    Eight bits of delimiter and three of intermission later it may send: seven bits after the
    others.
    """
    bus = WireBench()
    bus.set(2, **passive(rec=130))
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x181, match_mask=0x7FF, bit=40, station=2)
    bus.send(0, 0x181, FRAME)
    bus.send(2, 0x100, b"", 10 * US)
    assert carried(bus.run())[1].t_ns == (LENGTH + 7 + frame_bits(0x100) - 3) * US


def test_without_a_gap_it_never_comes_back():
    """As the standard says: it may need the bus idle for some bits, so a bus should not be loaded
    fully.
    """
    bus = WireBench()
    bus.set(2, **passive(rec=130))
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x181, match_mask=0x7FF, bit=40, station=2)
    bus.send(0, 0x181, FRAME)
    for n in range(5):
        bus.send(1, 0x200 + n)
    bus.send(1, 0x210, b"", MS)
    rows = carried(bus.run())
    assert [row.receivers for row in rows[1:-1]] == [(0,)] * 5
    assert rows[-1].receivers == (0, 2)


GLITCH = {"from_ns": 100 * US, "until_ns": 101 * US, "rate": 1.0}


def test_a_dominant_bit_on_an_idle_wire_is_a_start_of_frame():
    """Six bits later all find a stuff error, and flag it together.

    What is to be sent meanwhile waits for their intermission.
    """
    bus = WireBench()
    bus.fault(FaultKind.NOISE, **GLITCH)
    bus.send(0, 0x100, b"", 103 * US)
    error, frame = bus.run()
    assert (error.t_ns, error.data[2], error.data[3]) == (107 * US, 0x04, 0x02)
    assert frame.t_ns == (107 + 6 + 8 + 3 + frame_bits(0x100) - 3) * US
    assert counters(bus) == [(0, 1), (0, 0), (0, 0)]
    assert [int(bus[station].errors[ErrorKind.STUFF]) for station in bus.stations] == [1, 1, 1]


def test_a_dominant_bit_that_one_alone_sees():
    """Its flag is a start of frame for the others, and six dominant bits a stuff error: rule b for
    the one. A passive flag troubles nobody.
    """
    bus = WireBench()
    bus.fault(FaultKind.NOISE, station=1, **GLITCH)
    assert len(told(bus.run(until_ns=MS))) == 1
    assert counters(bus) == [(0, 1), (0, 9), (0, 1)]
    bus = WireBench()
    bus.set(1, **passive(rec=130))
    bus.fault(FaultKind.NOISE, station=1, **GLITCH)
    bus.run(until_ns=MS)
    assert counters(bus) == [(0, 0), (0, 131), (0, 0)]


def test_a_frame_that_starts_while_one_is_taken_in_by_a_glitch():
    """Station 1 is three bits into a frame that is none: what it makes of the real one ends in an
    error flag, and the frame is sent again.
    """
    bus = WireBench()
    bus.fault(FaultKind.NOISE, station=1, **GLITCH)
    bus.send(0, 0x100, FRAME, 103 * US)
    rows = bus.run(until_ns=MS)
    assert [row.receivers for row in carried(rows)] == [(1, 2)]
    assert bus[0].retransmissions == 1
    assert bus[1].errors.sum() == 1


def test_noise_strikes_an_idle_wire_as_often_as_a_busy_one():
    bus = WireBench((0, 1))
    bus.bus.noise.state = 12345
    bus.fault(FaultKind.NOISE, rate=1e-3, until_ns=200 * MS)
    rows = bus.run(until_ns=201 * MS)
    assert 200 - 4 * 14 < int(bus.bus.faults[0].fired) < 200 + 4 * 14  # Poisson, four standard deviations
    assert all(row.can_id & CAN_ERR_FLAG for row in rows)


def test_one_shot_is_given_up_after_a_lost_arbitration():
    """101h against 100h: identifier bit 0, the eleventh behind the start of frame, of which two
    bits are stuffed before.
    """
    bus = WireBench((0, 1, 2, 3))
    bus.set(1, one_shot=1)
    bus.set(3, one_shot=1)
    bus.send(0, 0x100, b"a")
    for can_id in (0x101, 0x102):
        bus.send(1, can_id)
    bus.send(2, 0x103)
    bus.send(3, 0x180)
    rows = bus.run()
    assert [(row.t_ns, row.can_id, row.source, row.data[0]) for row in told(rows)][:2] == [
        (5 * US, CAN_ERR_FLAG | 0x200 | LOSTARB, 3, 4),
        (13 * US, CAN_ERR_FLAG | 0x200 | LOSTARB, 1, 11),
    ]
    assert [row.can_id for row in carried(rows)] == [0x100, 0x102, 0x103]  # 103h is tried again, and loses once more
    assert [int(bus[station].dropped) for station in range(4)] == [0, 1, 0, 1]
    assert [int(bus[station].arbitration_lost) for station in range(4)] == [0, 1, 2, 1]
    assert counters(bus) == [(0, 0)] * 4


def test_one_shot_that_wins_or_is_alone_is_sent():
    bus = WireBench()
    bus.set(0, one_shot=1)
    bus.send(0, 0x100)
    bus.send(1, 0x101)
    bus.send(0, 0x102, b"", MS)
    assert [row.can_id for row in bus.run()] == [0x100, 0x101, 0x102]
    assert bus[0].dropped == 0


def test_of_one_hundred_that_lose_at_once_each_is_told():
    bus = WireBench(range(100))
    for station in range(1, 100):
        bus.set(station, one_shot=1)
        bus.send(station, 0x400 + station)
    bus.send(0, 0x000)
    rows = bus.run()
    assert [row.can_id for row in carried(rows)] == [0]
    assert sorted(row.source for row in told(rows)) == list(range(1, 100))
    assert sum(int(bus[station].dropped) for station in range(100)) == 99


@pytest.mark.parametrize("station", [0, 1])
def test_what_a_reset_node_had_on_the_wire_is_not_sent_again(station):
    """Station 0 sends, disturbed in its arbitration field, and 1 contends: who is reset in the
    midst of that has nothing to send any more.
    """
    bus = WireBench()
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x100, match_mask=0x7FF, bit=1)
    bus.send(0, 0x100)
    bus.send(1, 0x101)
    assert len(told(bus.run(rows=1))) == 1
    withdraw(bus.bus, bus.out, station)
    assert [row.can_id for row in carried(bus.run())] == [0x101 if station == 0 else 0x100]


def test_frames_of_one_station_with_one_identifier_need_no_closer_look():
    bus = WireBench()
    bus.set(2, loopback=1)  # so the bus is looked at closely
    for n in range(4):
        bus.send(0, 0x100, bytes((n,)))
    bus.run(rows=1)
    assert (bus.bus.delivered, bus.bus.play.bit) == (Delivered.HEARERS, 0)  # closely, and no bit was played
    assert [row.data[0] for row in bus.run()] == [1, 2, 3]


def test_who_only_listens_sends_nothing():
    bus = WireBench()
    bus.set(0, listen_only=1)
    bus.send(0, 0x100)
    assert bus.run(until_ns=MS) == []
    assert bus[0].dropped == 1


def test_all_that_contend_are_transmitters_of_an_error_in_the_arbitration_field():
    """Bit 2 of 100h and 101h, dominant for both, is seen recessive: a bit error of both; 300h has
    lost to neither by then.
    """
    bus = WireBench((0, 1, 2, 3))
    bus.fault(FaultKind.FLIP, framed=1, match_id=0x100, match_mask=0x7FF, bit=1)
    for station, can_id in ((0, 0x100), (1, 0x101), (2, 0x300)):
        bus.send(station, can_id)
    rows = bus.run()
    assert [row.can_id for row in carried(rows)] == [0x100, 0x101, 0x300]
    assert [bus.errors(station)[0] for station in range(4)] == [7, 7, 7, 0]
    assert [int(bus[station].retransmissions) for station in range(4)] == [1, 0, 0, 0]
