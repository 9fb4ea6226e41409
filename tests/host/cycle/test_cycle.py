"""The host's cycle, function by function: SYNC, frames, the motor's limit, and what each phase
sends; both senses, away from 0.
"""

from __future__ import annotations

import math
from functools import cache

import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.cycle.step import SOURCE_HOST, _doubt_clipped_law, begin, limit_torque
from coulombus.host.laws.laws import compile_law
from host_bench import MS, VELOCITY, HostBench

BOTH = pytest.mark.parametrize("sign", [1, -1])
TPDO1, TPDO2, BRAKE_TPDO = 0x181, 0x281, 0x182


def test_the_host_is_no_station_of_the_bus():
    assert SOURCE_HOST == -1


# begin


def begun(bench, t_ns):
    bench.out.count = 0
    begin(bench.axis, t_ns, bench.out)
    return bench.frames()


def test_a_cycle_begins_with_sync_and_a_window_for_the_tpdos():
    bench = HostBench("hybrid", *VELOCITY).enter(Phase.RUN)
    bench.h.heartbeat_due_ns = 10**12
    bench.h.arrived = 0b111
    assert begun(bench, 101 * MS) == [(101 * MS, 0x80, 0, 0)]
    h = bench.h
    assert (h.cycle, h.sync_ns, h.next_ns) == (101, 101 * MS, 101 * MS + bench.c.window_ns)
    assert (h.arrived, h.waiting, h.lost_pdos) == (0, 1, 0)
    assert bench.out.frames[0].source == SOURCE_HOST


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("arrived", range(8))
@pytest.mark.parametrize("cycle", [0, 1, 9])
def test_a_cycle_that_lacked_a_tpdo_is_counted_until_the_safe_state(phase, arrived, cycle):
    bench = HostBench("hybrid", *VELOCITY)
    assert bench.c.tpdos == 3
    bench.h.phase, bench.h.arrived, bench.h.cycle, bench.h.lost_pdos = int(phase), arrived, cycle, 7
    begun(bench, 5 * MS)
    assert bench.h.lost_pdos == 7 + (cycle > 0 and phase < Phase.SAFE and arrived != 7)


@pytest.mark.parametrize("early_ns", [1, 0, -1])
def test_the_hosts_heartbeat_goes_out_when_it_is_due(early_ns):
    bench = HostBench()
    bench.h.heartbeat_due_ns = 8 * MS + early_ns
    beat = [(8 * MS, 0x700 + bench.c.host_id, 1, 5)] if early_ns <= 0 else []
    assert begun(bench, 8 * MS) == [(8 * MS, 0x80, 0, 0), *beat]
    assert bench.h.heartbeat_due_ns == (8 * MS + bench.c.heartbeat_ns if beat else 8 * MS + 1)


def test_a_heartbeat_of_one_nanosecond_is_one_and_of_none_is_none():
    bench = HostBench()
    bench.c.heartbeat_ns = 0
    assert len(begun(bench, 8 * MS)) == 1
    bench.c.heartbeat_ns = 1
    assert len(begun(bench, 9 * MS)) == 2


def test_an_axis_that_does_not_lead_sends_neither_sync_nor_heartbeat():
    bench = HostBench()
    bench.c.sync_cob_id = -1
    assert begun(bench, 8 * MS) == []
    assert bench.h.cycle == 1
    bench.c.sync_cob_id = 0
    assert begun(bench, 9 * MS)[0][1] == 0


# frames


def test_the_tpdo_that_completes_the_cycle_says_so():
    bench = HostBench("hybrid", *VELOCITY)
    bench.h.waiting = 1
    assert [bench.frame(i, 8 if i == TPDO1 else n, 0) for i, n in ((TPDO1, 8), (BRAKE_TPDO, 6), (TPDO2, 4))] == [
        0,
        0,
        1,
    ]
    assert bench.h.arrived == 7
    assert bench.frame(TPDO2, 4, 0) == 1  # again: nothing is lacking
    bench.h.waiting = 0  # too late
    assert bench.frame(TPDO2, 4, 0) == 0
    assert (bench.h.malformed_pdos, bench.h.stray_frames) == (0, 0)


@pytest.mark.parametrize("k", range(3))
def test_a_tpdo_fills_its_own_slots_and_its_own_bit(k):
    bench = HostBench("hybrid", *VELOCITY)
    bench.h.waiting, bench.h.malformed_pdos = 1, 2
    pdo = bench.k.tpdos[k]
    before = list(bench.h.image)
    assert bench.frame(int(pdo.cob_id), int(pdo.length), 0x0102030405060708 & ((1 << 8 * int(pdo.length)) - 1)) == 0
    changed = {slot for slot, (a, b) in enumerate(zip(before, bench.h.image, strict=True)) if a != b}
    assert changed == {int(slot) for slot in pdo.slot[: pdo.count]}
    assert bench.h.arrived == 1 << k
    for length in (pdo.length - 1, pdo.length + 1):
        bench.h.arrived = 0
        kept = list(bench.h.image)
        assert bench.frame(int(pdo.cob_id), int(length), -1) == 0
        assert list(bench.h.image) == kept
        assert bench.h.arrived == 0
    assert bench.h.malformed_pdos == 4


@pytest.mark.parametrize("node", ["motor", "brake"])
def test_a_heartbeat_is_news_when_the_state_is(node):
    bench = HostBench()
    h = bench.h
    k = ["motor", "brake"].index(node)
    node_id = bench.c.node_id[k]
    bench.t_ns = 33 * MS
    answers = [bench.frame(0x700 + node_id, 1, state) for state in (5, 127, 0x80 | 127, 127, 4, 5)]
    assert answers == [0, 2, 0, 0, 2, 2]
    assert h.nmt[k] == 5
    assert h.heard_ns[k] == 33 * MS
    assert (h.nmt[1 - k], h.heard_ns[1 - k]) == (5, 0)
    assert h.stray_frames == 0
    assert bench.frame(0x700 + node_id, 1, 127) == 2
    assert h.nmt[k] == 127


def test_a_heartbeat_of_another_node_or_of_no_length_is_none_of_ours():
    bench = HostBench()
    assert bench.frame(0x705, 1, 127) == 2  # not known: the control plane looks at it
    for length in (0, 2):
        assert bench.frame(0x701, length, 127) == 0
    assert [bench.frame(can_id, 1, 127) for can_id in (0x083, 0x101)] == [0, 0]
    assert (bench.h.stray_frames, bench.h.malformed_services) == (2, 2)
    assert (bench.h.nmt[0], bench.h.nmt[1]) == (5, 5)


def test_answers_of_sdo_servers_go_to_the_control_plane():
    bench = HostBench()
    assert [bench.frame(i, 8, 0) for i in (0x581, 0x582, 0x5FF, 0x601)] == [2, 2, 2, 0]
    assert bench.h.stray_frames == 1


@pytest.mark.parametrize(("can_id", "trip"), [(0x081, Trip.EMCY_MOTOR), (0x082, Trip.EMCY_BRAKE)])
def test_an_emcy_asks_for_a_trip_and_the_first_code_stays(can_id, trip):
    bench = HostBench()
    h = bench.h
    assert bench.frame(can_id, 8, 0x11_0000) == 2  # an error reset
    assert h.emcy == Trip.NONE
    assert bench.frame(0x083, 8, 0x11_8250) == 0
    assert (h.emcy, h.stray_frames) == (Trip.NONE, 1)
    assert bench.frame(can_id, 6, 0x11_0000) == 2  # a short error reset: counted, and no doubt of the device
    assert (h.emcy, h.malformed_services) == (Trip.NONE, 1)
    assert bench.frame(can_id, 8, 0x11_0001) == 2
    assert (h.emcy, h.emcy_code) == (trip, 1)
    assert bench.frame(0x081, 8, 0x11_F250) == bench.frame(0x082, 8, 0x11_F250) == 2
    assert (h.emcy, h.emcy_code) == (trip, 1)


@pytest.mark.parametrize("length", range(9))
def test_an_emcy_trips_whatever_its_length(length):
    bench = HostBench()
    code = 0x2310 & (1 << 8 * min(length, 2)) - 1
    assert bench.frame(0x082, length, 0x11_2310 & (1 << 8 * length) - 1) == 2
    assert (bench.h.emcy, bench.h.emcy_code) == (Trip.EMCY_BRAKE, code)
    assert bench.h.malformed_services == (length != 8)


def test_an_emcy_is_heard_where_1014h_says_that_it_comes():
    bench = HostBench()
    bench.c.emcy_id[1] = 0x0A2
    assert bench.frame(0x082, 8, 0x2310) == 0
    assert bench.h.emcy == Trip.NONE
    assert bench.frame(0x0A2, 8, 0x2310) == 2
    assert bench.h.emcy == Trip.EMCY_BRAKE


@pytest.mark.parametrize("length", [0, 1, 6, 7])
def test_an_sdo_response_of_another_length_is_counted(length):
    bench = HostBench()
    assert bench.frame(0x582, 8, 0) == 2
    assert bench.h.malformed_services == 0
    assert bench.frame(0x582, length, 0) == 2
    assert bench.h.malformed_services == 1


STRANGERS = [
    ((0x201, 4, 0x0064_000F), True),  # a set-point of the motor
    ((0x202, 2, 4500), True),  # ... of the brake, in any length
    ((0x202, 0, 0), True),
    ((0x601, 8, 0x0064_6072_2B), True),  # an expedited download
    ((0x602, 8, 0x0064_1016_21), True),  # a segmented one begins
    ((0x602, 8, 0x0064_1016_C6), True),  # a block download begins
    ((0x601, 8, 0x6041_40), False),  # an upload reads only
    ((0x601, 8, 0x6041_E0), False),  # no client command
    ((0x401, 8, 0x0064_6072_2B), False),  # no SDO request
    ((0x601, 0, 0), False),
    ((0x603, 8, 0x0064_6072_2B), False),  # another node's
    ((0x205, 4, 0x0064_000F), False),
]


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize(("frame", "doubtful"), STRANGERS)
def test_what_only_the_host_sends_makes_the_axis_safe_when_it_comes_from_another(frame, doubtful, phase):
    bench = HostBench("hybrid").enter(phase, counts=40)
    assert bench.frame(*frame) == 0
    watched = doubtful and Phase.OFF < phase < Phase.SAFE
    assert bench.h.foreign_id == (frame[0] if doubtful and Phase.OFF < phase < Phase.DONE else -1)
    assert bench.h.stray_frames == 1
    bench.cycle()
    if watched:
        assert (bench.phase, bench.h.trip, bench.controlword) == (Phase.SAFE, Trip.SECOND_HOST, 0)
    else:
        assert bench.h.trip == Trip.NONE


@pytest.mark.parametrize("can_id", [0x7FE, 0x7FF])
def test_a_set_point_of_the_highest_identifiers_is_the_hosts_too(can_id):
    bench = HostBench("hybrid").enter(Phase.RUN, counts=40)
    bench.axis.rpdos[0].cob_id = can_id
    assert bench.frame(can_id, 4, 0) == 0
    assert (bench.h.foreign_id, bench.h.stop) == (can_id, Trip.SECOND_HOST)


def test_a_trip_of_before_is_not_written_over_by_a_stranger():
    bench = HostBench("hybrid").enter(Phase.RUN, counts=40)
    bench.h.stop = int(Trip.ENCODER_JUMP)
    bench.frame(0x201, 4, 0)
    bench.cycle()
    assert bench.h.trip == Trip.ENCODER_JUMP


def test_a_stranger_is_told_though_the_end_was_asked_for():
    bench = HostBench("hybrid").enter(Phase.RUN, counts=40)
    bench.h.stop = 1
    bench.frame(0x201, 4, 0)
    bench.cycle()
    assert bench.h.trip == Trip.SECOND_HOST


@pytest.mark.parametrize(
    ("length", "trip"), [(0, Trip.EMCY_MOTOR), (1, Trip.EMCY_MOTOR), (2, Trip.NONE), (8, Trip.NONE)]
)
def test_an_emcy_without_a_code_is_a_doubt_and_an_error_reset_is_none(length, trip):
    bench = HostBench()
    bench.frame(0x081, length, 0)
    assert bench.h.emcy == trip


@pytest.mark.parametrize(
    ("phase", "clipped", "balance", "stop", "after", "trip"),
    [
        (Phase.RUN, 1, 9, 0, 10, 0),
        (Phase.RUN, 1, 10, 0, 11, Trip.LAW_CLIPPED),
        (Phase.RUN, 1, 10, 1, 11, Trip.LAW_CLIPPED),
        (Phase.RUN, 1, 10, 2, 11, 2),
        (Phase.RUN, 0, 5, 0, 4, 0),
        (Phase.RUN, 0, 0, 0, 0, 0),
        (Phase.SIGN, 1, 10, 0, 10, 0),
    ],
)
def test_clipped_cycles_are_weighed_against_the_others_in_run(phase, clipped, balance, stop, after, trip):
    bench = HostBench("active").enter(phase)
    h = bench.h
    bench.c.clipped_cycles, h.clipped, h.clipped_balance, h.stop = 10, clipped, balance, stop
    _doubt_clipped_law(bench.c, h)
    assert (h.clipped, h.clipped_balance) == (0, after)
    assert h.stop == (trip or stop)


@pytest.mark.parametrize(
    ("torque_Nm", "rate_Nm", "clipped"), [(math.nan, 9.0, 1), (1.6, 9.0, 1), (1.4, 1.0, 1), (1.4, 9.0, 0)]
)
def test_each_limit_of_the_torque_counts_as_clipped(torque_Nm, rate_Nm, clipped):
    bench = HostBench("active").enter(Phase.RUN, counts=40)
    bench.c.motor_rate_Nm, bench.h.torque_Nm = rate_Nm, 0.0
    limit_torque(bench.c, bench.h, torque_Nm)
    assert bench.h.clipped == clipped


@pytest.mark.parametrize("code", [0x8250, 0xFFFF, 0x7FFF])
def test_the_code_of_an_emcy_has_16_bits(code):
    bench = HostBench()
    bench.frame(0x081, 8, 0xFF_0000 | code)
    assert bench.h.emcy_code == code


@pytest.mark.parametrize("can_id", [0x800, 0x8000_0081, 0x4000_0081, 0x2000_0081, 0x881, 0xF01, 0x333, 0x101, 0x7FF])
def test_a_frame_of_nobody_is_counted_and_does_nothing(can_id):
    bench = HostBench()
    image = list(bench.h.image)
    assert bench.frame(can_id, 8 if can_id != 0x7FF else 2, 0x8250) == 0
    assert (bench.h.stray_frames, bench.h.emcy, bench.h.arrived) == (1, Trip.NONE, 0)
    assert list(bench.h.image) == image


# the motor's limit


def limited(
    wanted, *, before=0.0, v_counts=0.0, age=0, motor=1, encoder=1, limit_pm=256, phase=Phase.SIGN, counter="clipped"
):
    bench = HostBench("active").enter(phase)
    c, h = bench.c, bench.h
    c.motor_Nm_raw, c.rad_count, c.period_ns = motor * 2.0**-8, encoder * 2.0**-6, 500_000_000
    c.motor_limit_raw, c.motor_rate_Nm, c.speed_limit = limit_pm, 0.5, 20.0
    h.torque_Nm, h.v_counts, h.position_age, h.clipped_torque = before, v_counts, age, 5
    h.slowed_torque = 5
    torque = limit_torque(c, h, wanted)
    return torque, getattr(h, f"{counter}_torque") - 5


@BOTH
@pytest.mark.parametrize("motor", [1, -1])
@pytest.mark.parametrize("encoder", [1, -1])
@pytest.mark.parametrize(
    ("wanted", "before", "speed", "expected", "clipped"),
    [
        (0.25, 0.0, 0, 0.25, 0),
        (0.75, 0.0, 0, 0.5, 0),  # rate
        (0.75, 0.5, 0, 0.75, 0),
        (-0.75, 0.5, 0, 0.0, 0),
        (-0.25, 0.25, 0, -0.25, 0),
        (1.0, 0.75, 0, 1.0, 0),
        (1.25, 0.75, 0, 1.0, 1),  # size
        (9.0, 1.0, 0, 1.0, 1),
        (0.25, 0.0, 16.0, 0.25, 0),  # at 0.8 of the speed limit
        (0.25, 0.0, 16.25, 0.0, 0),  # above it
        (-0.25, 0.0, 16.25, -0.25, 0),  # braking
        (0.25, 0.0, -16.0, 0.25, 0),
        (0.25, 0.0, -16.25, 0.25, 0),
        (-0.25, 0.0, -16.25, 0.0, 0),
        (2.0**-8, 0.0, 16.25, 0.0, 0),
        (-(2.0**-8), 0.0, 16.25, -(2.0**-8), 0),
    ],
)
def test_the_motor_is_limited_in_rate_size_and_near_the_speed_limit(
    sign, motor, encoder, wanted, before, speed, expected, clipped
):
    v_counts = sign * encoder * speed * 0.5 * 2**6
    done = limited(sign * wanted, before=sign * before, v_counts=v_counts, motor=motor, encoder=encoder)
    assert done == (sign * expected, clipped)


@BOTH
@pytest.mark.parametrize("motor", [1, -1])
def test_a_small_limit_keeps_the_torques_sense(sign, motor):
    assert limited(sign * 0.5, motor=motor, limit_pm=64) == (sign * 0.25, 1)
    assert limited(sign * 0.5, motor=motor, limit_pm=0) == (0.0, 1)


COUNT = 2.0**-8


@BOTH
@pytest.mark.parametrize("phase", Phase)
def test_only_the_phases_that_show_torque_pass_any(sign, phase):
    shows = Phase.SIGN <= phase <= Phase.RUN
    assert limited(sign * 0.25, phase=phase) == (sign * 0.25 if shows else 0.0, 0)


@BOTH
@pytest.mark.parametrize(("beyond", "clipped"), [(0.0, 0), (COUNT, 0), (1.5 * COUNT, 1)])
def test_less_than_a_count_beyond_the_limit_is_rounding(sign, beyond, clipped):
    assert limited(sign * (1.0 + beyond), before=sign * 0.75) == (sign * 1.0, clipped)


@BOTH
@pytest.mark.parametrize(
    ("wanted", "before", "slowed"),
    [
        (0.25, 0.0, 0),
        (0.5 + COUNT, 0.0, 0),  # a count is rounding
        (0.5 + 2 * COUNT, 0.0, 1),
        (0.75, 0.0, 1),
        (0.25, 1.0, 1),
        (9.0, 1.0, 0),  # clipped, not slowed
        (9.0, 0.25, 1),
    ],
)
def test_a_torque_that_the_rate_holds_back_is_counted_while_the_law_is_shown(sign, wanted, before, slowed):
    for phase in (Phase.SIGN, Phase.SETTLE, Phase.RUN):
        _, counted = limited(sign * wanted, before=sign * before, phase=phase, counter="slowed")
        assert counted == (slowed if phase is Phase.RUN else 0)


@BOTH
def test_a_position_older_than_one_cycle_is_torque_zero(sign):
    assert limited(sign * 0.25, age=1) == (sign * 0.25, 0)
    assert limited(sign * 0.25, age=2) == (0.0, 0)
    assert limited(math.nan, age=2) == (0.0, 0)


def test_what_is_no_number_is_torque_zero_and_counted():
    assert limited(math.nan, before=0.5) == (0.0, 1)


# finish


@pytest.mark.parametrize("late_ns", [0, 1])
def test_a_cycle_that_ends_after_the_next_should_begin_is_counted(late_ns):
    bench = HostBench().enter(Phase.OFF)
    h = bench.h
    h.sync_ns, h.waiting, h.late_cycles = 100 * MS, 1, 4
    bench.t_ns = 101 * MS + late_ns
    bench.finish()
    assert (h.waiting, h.next_ns, h.late_cycles) == (0, 101 * MS, 4 + late_ns)


@pytest.mark.parametrize("arrived", range(8))
def test_cycles_without_all_tpdos_are_counted_in_a_row(arrived):
    bench = HostBench("hybrid", *VELOCITY).enter(Phase.OFF)
    bench.h.arrived, bench.h.missed_in_a_row = arrived, 1
    bench.finish()
    assert bench.h.missed_in_a_row == (0 if arrived == 7 else 2)


@pytest.mark.parametrize("phase", [p for p in Phase if p < Phase.SAFE])
@pytest.mark.parametrize("state", PowerState)
def test_a_drive_that_leaves_operation_enabled_by_itself_trips(phase, state):
    bench = HostBench().enter(phase, counts=-400)
    bench.state = int(state)
    bench.cycle()
    leaves = Phase.ENABLE < phase < Phase.SAFE and state != PowerState.OPERATION_ENABLED
    assert bench.h.trip == (Trip.DRIVE_STATE if leaves else Trip.NONE)
    assert (bench.phase is Phase.SAFE) == leaves


@pytest.mark.parametrize("phase", [p for p in Phase if p < Phase.SAFE])
def test_a_dead_mans_switch_that_is_let_go_trips_once_arming_has_begun(phase):
    bench = HostBench().enter(phase, counts=300)
    bench.h.deadman_ok = 0
    bench.cycle()
    assert bench.h.trip == (Trip.DEADMAN if phase > Phase.STILL else Trip.NONE)


@pytest.mark.parametrize("value", [0, 1, 255, -1])
def test_a_switch_in_the_process_image_holds_while_it_is_not_zero(value):
    bench = HostBench().enter(Phase.RUN, counts=300)
    bench.c.deadman_slot = int(Image.DEADMAN)
    bench.h.image[Image.DEADMAN], bench.h.deadman_ok = value, 0 if value else 1
    bench.cycle()
    assert bench.h.deadman_ok == (value != 0)
    assert bench.h.trip == (Trip.NONE if value else Trip.DEADMAN)


@pytest.mark.parametrize(
    ("mask", "value", "held"),
    [
        (0x6, 0x6, 1),
        (0x6, 0xF, 1),
        (0x6, 0x2, 0),
        (0x6, 0x4, 0),
        (0x6, 0x9, 0),
        (0x6, 0, 0),
        (0x8, 0x8, 1),
        (0x8, 0x7, 0),
    ],
)
def test_all_bits_of_the_mask_hold_the_switch(mask, value, held):
    bench = HostBench().enter(Phase.RUN, counts=300)
    bench.c.deadman_slot, bench.c.deadman_mask = int(Image.DEADMAN), mask
    bench.h.image[Image.DEADMAN], bench.h.deadman_ok = value, 1 - held
    bench.cycle()
    assert bench.h.deadman_ok == held
    assert bench.h.trip == (Trip.NONE if held else Trip.DEADMAN)


def test_slot_0_may_hold_the_switch_and_minus_1_is_none():
    bench = HostBench().enter(Phase.RUN)
    bench.c.deadman_slot, bench.h.image[0] = 0, 0
    bench.cycle()
    assert bench.h.trip == Trip.DEADMAN
    bench = HostBench().enter(Phase.RUN)
    assert bench.c.deadman_slot == -1
    bench.h.image[-1] = 0
    bench.cycle()
    assert bench.h.trip == Trip.NONE


def test_the_first_doubt_of_a_cycle_is_the_one_that_is_told():
    """Encoder, then motion, then devices, then the drive, then the switch, then the wish
    to stop.
    """
    wrong = [
        (Trip.ENCODER_JUMP, lambda b: setattr(b, "counts", b.counts + 600)),
        (Trip.SPEED, lambda b: setattr(b.c, "speed_limit", -1.0)),
        (Trip.NMT_STATE, lambda b: b.h.nmt.__setitem__(0, 4)),
        (Trip.DRIVE_STATE, lambda b: setattr(b, "state", int(PowerState.SWITCHED_ON))),
        (Trip.DEADMAN, lambda b: setattr(b.h, "deadman_ok", 0)),
        (Trip.RECORDING, lambda b: setattr(b.h, "stop", int(Trip.RECORDING))),
    ]
    for k, (trip, _) in enumerate(wrong):
        bench = HostBench().enter(Phase.RUN, counts=300)
        for _, doubt in wrong[k:]:
            doubt(bench)
        bench.cycle()
        assert bench.h.trip == trip


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("stop", [0, 1, 2, int(Trip.RECORDING)])
def test_a_wish_to_stop_leads_to_the_safe_state_once(phase, stop):
    bench = HostBench().enter(phase, counts=-300)
    bench.h.stop, bench.h.phase_cycle = stop, 40
    bench.h.level_Nm = bench.h.brake_lagged_Nm = 0.5
    bench.h.end_cycles = bench.c.rise_cycles + bench.c.fade_cycles if stop == 1 else 0
    bench.cycle()
    stops = stop and phase < Phase.SAFE
    assert bench.h.trip == (stop if stops and stop > 1 else Trip.NONE)
    if stops:
        assert bench.phase is Phase.SAFE
        assert bench.h.phase_cycle == 1
        assert bench.h.trip_ns == bench.t_ns
    elif phase in (Phase.SAFE, Phase.DISABLE):
        assert bench.h.phase_cycle == 41
    else:
        assert bench.phase is phase


CONTROLWORDS = {
    # phase: the controlword by the drive's state, Not Ready to Switch On to Fault
    Phase.OFF: [0x00] * 8,
    Phase.STILL: [0x00, 0x06, 0x07, 0x07, 0x0F, 0x00, 0x00, 0x80],
    Phase.ENABLE: [0x00, 0x06, 0x07, 0x0F, 0x0F, 0x00, 0x00, 0x80],
    Phase.SIGN: [0, 0, 0, 0, 0x0F, 0, 0, 0],
    Phase.SETTLE: [0, 0, 0, 0, 0x0F, 0, 0, 0],
    Phase.RUN: [0, 0, 0, 0, 0x0F, 0, 0, 0],
    Phase.SAFE: [0x00] * 8,
    Phase.DISABLE: [0x00] * 8,
    Phase.DONE: [0x00] * 8,
}


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("state", PowerState)
def test_the_controlword_by_phase_and_state_of_the_drive(phase, state):
    bench = HostBench().enter(phase, counts=100)
    bench.c.sign_check = 1
    bench.state = int(state)
    bench.cycle()
    assert bench.controlword == CONTROLWORDS[phase][state]


@pytest.mark.parametrize("phase", [Phase.STILL, Phase.ENABLE])
def test_a_statusword_of_no_state_is_sent_no_command(phase):
    bench = HostBench().enter(phase)
    h = bench.h
    h.arrived, h.image[Image.POSITION], h.image[Image.STATUSWORD] = 7, 0, 0x0001
    bench.finish()
    assert bench.controlword == 0


@pytest.mark.parametrize("phase", Phase)
def test_only_the_phases_of_an_enabled_drive_send_torque(phase):
    bench = HostBench("active").enter(phase, counts=50)
    bench.h.torque_Nm, bench.h.brake_Nm = 0.3, 0.7
    bench.k.state[0].x_stuck -= 0.01  # the law would push back
    bench.cycle()
    assert (bench.motor_pm != 0) == (Phase.SIGN <= phase <= Phase.RUN)
    if phase in (Phase.OFF, Phase.DISABLE, Phase.DONE):
        assert bench.h.brake_Nm == 0.0
        assert bench.brake_Nm == 0.0


def test_the_safe_state_shows_the_brakes_torque_that_it_keeps():
    bench = HostBench().enter(Phase.SAFE, counts=50)
    bench.h.level_Nm, bench.h.handle_Nm, bench.c.release_Nm = 3.0, 2.0, 0.5
    bench.c.still_handle_Nm = math.inf
    bench.cycle()
    assert bench.brake_Nm == 2.5


def test_a_handle_that_was_still_for_long_enough_is_enabled():
    bench = HostBench().enter(Phase.STILL, counts=50)
    bench.h.still = bench.c.still_cycles - 1
    bench.cycle()
    assert bench.phase is Phase.ENABLE
    assert bench.controlword == 0x07  # from the next cycle on
    bench.cycle()
    assert bench.controlword == 0x0F


@pytest.mark.parametrize("sign_check", [0, 1])
def test_operation_enabled_leads_to_the_sign_check_or_to_the_law(sign_check):
    bench = HostBench().enter(Phase.ENABLE, counts=-70)
    bench.c.sign_check = sign_check
    bench.h.sign_direction, bench.h.torque_Nm, bench.c.motor_rate_Nm = -1, 0.3, 0.125
    bench.state = int(PowerState.OPERATION_ENABLED)
    bench.cycle()
    assert bench.h.enabled_ns == bench.t_ns
    assert bench.motor_pm == 0
    assert bench.h.phase_cycle == 0
    assert bench.controlword == 0x0F
    assert bench.h.display_cycles == 1
    if sign_check:
        assert bench.phase is Phase.SIGN
        assert bench.h.sign_direction == 1
        assert bench.h.armed_ns == -1
    else:
        assert bench.phase is Phase.RUN
        assert bench.h.armed_ns == bench.t_ns


def test_a_drive_that_does_not_enable_is_given_its_time_and_no_more():
    bench = HostBench().enter(Phase.ENABLE)
    bench.h.phase_cycle = bench.c.enable_timeout_cycles - 1
    bench.cycle()
    assert bench.phase is Phase.ENABLE
    assert bench.h.display_cycles == 0
    bench.state = int(PowerState.SWITCHED_ON)
    bench.cycle()
    assert bench.h.trip == Trip.ENABLE_TIMEOUT


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("enabled_ns", [-1, 0, 7])
def test_cycles_of_display_are_counted_from_enabled_to_safe(phase, enabled_ns):
    bench = HostBench().enter(phase)
    bench.state = int(PowerState.SWITCHED_ON if phase <= Phase.ENABLE else PowerState.OPERATION_ENABLED)
    bench.h.enabled_ns, bench.h.display_cycles = enabled_ns, 10
    bench.cycle()
    assert bench.h.display_cycles == 10 + (enabled_ns >= 0 and phase < Phase.SAFE)


@BOTH
def test_settling_takes_the_torque_back_by_steps_in_either_sense(sign):
    """Five steps of the ramp a cycle; the law begins at 0 and with the handle still."""
    bench = HostBench().enter(Phase.SETTLE, counts=-900)
    c, h = bench.c, bench.h
    h.sign_direction, h.torque_Nm = sign, sign * 0.0175
    shown = []
    for _ in range(c.settle_cycles):
        bench.cycle()
        shown.append(h.torque_Nm)
    assert shown[:4] == pytest.approx([sign * 0.0125, sign * 0.0075, sign * 0.0025, 0.0])
    assert bench.phase is Phase.RUN
    assert (h.armed_ns, h.gain) == (bench.t_ns, 0.0)
    assert bench.k.state[0].x_stuck == -900 * c.rad_count


@BOTH
def test_settling_waits_for_torque_zero_and_a_still_handle(sign):
    bench = HostBench().enter(Phase.SETTLE, counts=900)
    c, h = bench.c, bench.h
    h.sign_direction, h.torque_Nm, h.still = sign, sign * 0.0125, c.settle_cycles - 1
    bench.cycle()  # still for long enough, but there is torque
    assert bench.phase is Phase.SETTLE
    bench.counts += (c.still_counts + 1) * sign
    bench.cycles(2)
    assert h.still == 1
    assert bench.phase is Phase.SETTLE
    h.phase_cycle = c.still_timeout_cycles - 1
    bench.cycle()
    assert bench.phase is Phase.SETTLE
    bench.cycle()
    assert h.trip == Trip.NOT_STILL


def told(motion, law, state):
    """Return what the law is told, one after another."""
    k = state.user[0]
    state.user[1], state.user[2], state.user[3] = motion.x_rad, motion.v_rad_s, motion.v_counts
    state.user[4] = motion.handle_Nm
    state.user[5] += 1.0
    state.brake_Nm, state.motor_Nm = law.user[1], law.user[2]
    return law.user[0] + k


@cache
def told_law():
    return compile_law(told)


@BOTH
@pytest.mark.parametrize("encoder", [1, -1])
def test_the_law_is_told_the_handle_in_the_handles_sense(sign, encoder):
    bench = HostBench("active", f"mechanics.encoder_polarity={encoder}").enter(Phase.RUN, counts=700)
    bench.k.law_function = told_law()
    bench.k.law[0].user[0], bench.k.law[0].user[1] = 0.0625, 0.5
    bench.counts += encoder * sign * 30
    bench.handle_Nm = sign * 0.5
    bench.cycle()
    user, rad = bench.k.state[0].user, abs(bench.c.rad_count)
    assert user[1] == pytest.approx((encoder * 700 + sign * 30) * rad)
    assert user[2] == pytest.approx(sign * 30 * rad / 1e-3)
    assert user[3] == sign * 30
    assert user[4] == pytest.approx(sign * 0.5)
    assert bench.k.state[0].psi_Nm == 0.0625


@pytest.mark.parametrize("phase", Phase)
def test_the_law_is_asked_in_the_phase_run_only(phase):
    bench = HostBench("active").enter(phase, counts=40)
    bench.k.law_function = told_law()
    bench.cycle()
    assert bench.k.state[0].user[5] == (phase is Phase.RUN)


NO_NUMBERS = (math.nan, math.inf, -math.inf)


@pytest.mark.parametrize(
    ("psi", "brake", "motor"),
    [
        *((wrong, 1.0, 0.0) for wrong in NO_NUMBERS),
        *((0.5, wrong, 0.0) for wrong in NO_NUMBERS),
        *((0.5, 1.0, wrong) for wrong in NO_NUMBERS),
        (math.nan, math.nan, math.nan),
    ],
)
def test_a_law_that_gives_no_finite_number_trips_and_is_not_kept(psi, brake, motor):
    bench = HostBench("active").enter(Phase.RUN, counts=40)
    bench.k.law_function = told_law()
    bench.k.law[0].user[0], bench.k.law[0].user[1], bench.k.law[0].user[2] = psi, brake, motor
    bench.k.state[0].psi_Nm = 0.25
    bench.cycle()
    assert bench.h.trip == Trip.LAW
    assert bench.h.trip_ns == bench.t_ns
    assert bench.motor_pm == 0
    assert bench.k.state[0].psi_Nm == 0.25
    parts = {f"{psi:g} Nm": psi, f"{brake:g} Nm for the brake": brake, f"{motor:g} Nm for the motor": motor}
    value = next(text for text, part in parts.items() if not math.isfinite(part))
    assert (
        bench.k.trip == f"LAW: the friction law karnopp returned {value}, which is not a finite number (law.function)"
    )


@pytest.mark.parametrize("state", PowerState)
@pytest.mark.parametrize("cycles", [99, 100])
def test_disabling_ends_when_the_drive_says_so_or_after_100_cycles(state, cycles):
    bench = HostBench().enter(Phase.DISABLE)
    bench.state, bench.h.phase_cycle = int(state), cycles
    bench.cycle()
    done = state in (PowerState.SWITCH_ON_DISABLED, PowerState.FAULT) or cycles == 100
    assert bench.phase is (Phase.DONE if done else Phase.DISABLE)


@pytest.mark.parametrize("phase", [Phase.OFF, Phase.RUN])
def test_a_disabled_drive_ends_no_other_phase(phase):
    bench = HostBench().enter(phase)
    bench.state = int(PowerState.SWITCH_ON_DISABLED)
    bench.cycle()
    assert bench.phase is (Phase.OFF if phase is Phase.OFF else Phase.SAFE)


@pytest.mark.parametrize(
    ("brake_Nm", "raw"), [(2.0, 2000), (2.0004, 2000), (2.0006, 2001), (-0.5, 0), (-3.0, 0), (40.0, 5000), (5.0, 5000)]
)
def test_the_brakes_set_point_is_rounded_not_negative_and_within_its_object(brake_Nm, raw):
    bench = HostBench().enter(Phase.STILL)
    bench.c.brake_limit_raw = 5000
    bench.h.brake_Nm = brake_Nm
    bench.cycle()
    assert bench.h.image[Image.BRAKE_SETPOINT] == raw


@BOTH
@pytest.mark.parametrize("motor", [1, -1])
def test_the_target_torque_is_rounded_and_in_the_motors_sense(sign, motor):
    bench = HostBench("active", f"mechanics.motor_polarity={motor}").enter(Phase.RUN, counts=5)
    bench.k.law_function = told_law()
    bench.k.law[0].user[0] = -sign * 100.4 * abs(bench.c.motor_Nm_raw)
    bench.cycle()
    assert bench.motor_pm == motor * sign * 100
    bench.k.law[0].user[0] = -sign * 100.6 * abs(bench.c.motor_Nm_raw)
    bench.cycle()
    assert bench.motor_pm == motor * sign * 101


def test_every_rpdo_goes_out_in_the_cycle_that_trips_too():
    bench = HostBench("active").enter(Phase.RUN, counts=5)
    bench.h.nmt[0] = 4
    bench.cycle()
    pdos = [bench.k.rpdos[i] for i in range(bench.c.rpdos)]
    sent = [f for f in bench.frames() if f[1] not in (0x80, 0x77F)]
    assert [(f[0], f[1], f[2]) for f in sent] == [(bench.t_ns, int(p.cob_id), int(p.length)) for p in pdos]
    assert sent[0][3] == 0  # controlword "disable voltage", torque 0


# a law on which the limits act


def asked(motion, law, state):
    state.brake_Nm, state.motor_Nm = abs(law.user[0]), 0.0
    return law.user[0]


@cache
def asked_law():
    return compile_law(asked)


def clipping(law_Nm, cycles, mode="active"):
    """Run a law that asks for these torques in turn; yield the bench behind each cycle, of which 10
    that are clipped trip.
    """
    bench = HostBench(mode).enter(Phase.RUN, counts=40)
    bench.c.clipped_cycles, bench.c.gain_step, bench.c.friction_Nm, bench.h.gain = 10, 1.0, 0.0, 1.0
    bench.c.compensation_Nm, bench.c.passivity_J = 0.0, math.inf
    bench.k.law_function = asked_law()
    for k in range(cycles):
        bench.k.law[0].user[0] = law_Nm[k % len(law_Nm)]
        bench.cycle()
        yield bench


@pytest.mark.parametrize("law", [(1e300, -1e300), (9.0,), (1.0, 9.0, 9.0)])
def test_a_law_that_limits_clip_in_most_cycles_trips(law):
    *_, bench = clipping(law, 60)
    assert bench.h.trip == Trip.LAW_CLIPPED
    assert "karnopp" in bench.k.trip


@pytest.mark.parametrize("law", [(1.0,), (9.0, 1.4, 1.4), (1.0, -1.0)])
def test_a_law_that_limits_clip_now_and_then_goes_on(law):
    *_, bench = clipping(law, 60)
    assert bench.h.trip == Trip.NONE


def test_the_brakes_set_point_falls_and_rises_at_its_rates():
    shown = []
    for bench in clipping((4.0, 4.0, 4.0, 0.0, 0.0, 0.0), 7, "passive"):
        bench.c.brake_fall_Nm, bench.c.brake_rise_Nm = 0.5, 1.25
        shown.append(float(bench.h.brake_Nm))
    assert shown == pytest.approx([1.8, 3.05, 4.0, 3.5, 3.0, 2.5, 3.75])
    assert bench.h.slowed_setpoints == 3


def test_a_set_point_that_falls_at_its_rate_itself_is_not_slowed():
    shown = []
    for bench in clipping((1.5, 1.0, 0.5), 3, "passive"):
        bench.c.brake_fall_Nm, bench.c.brake_rise_Nm = 0.5, math.inf
        shown.append(float(bench.h.brake_Nm))
    assert shown == [1.5, 1.0, 0.5]
    assert (bench.h.slowed_setpoints, bench.h.clipped_balance) == (0, 0)


@pytest.mark.parametrize("law", [(9.0,), (4.0, 0.0, 0.0, 0.0)])
def test_a_law_that_the_brake_cannot_follow_trips(law):
    for bench in clipping(law, 80, "passive"):
        bench.c.brake_fall_Nm = 0.5
    assert bench.h.trip == Trip.LAW_CLIPPED
    assert ("clipped_setpoints" if law == (9.0,) else "slowed_setpoints") in bench.k.trip


def shaking(mode, period, cycles, size=1.4, **limits):
    """A square law of +-`size` with a period in cycles, on the motor or as the brake's set-point from 0 on."""
    asked = [size if k < period // 2 else -size if mode == "active" else 0.0 for k in range(period)]
    for bench in clipping(asked, cycles, mode):
        bench.c.clipped_cycles = 10**6
        for name, limit in limits.items():
            setattr(bench.c, name, limit)
    return bench


@pytest.mark.parametrize("period", [2, 4, 6])
@pytest.mark.parametrize("mode", ["active", "passive"])
def test_a_law_that_shakes_motor_or_brake_trips(mode, period):
    bench = shaking(mode, period, 600)
    assert bench.h.trip == Trip.LAW_OSCILLATES
    assert ("motor" if mode == "active" else "brake") in bench.k.trip
    assert bench.h.trip_ns - bench.h.armed_ns < 560 * MS


@pytest.mark.parametrize(
    ("mode", "period", "size"), [("active", 8, 1.4), ("active", 6, 1.2), ("passive", 6, 0.1), ("passive", 8, 1.4)]
)
def test_a_law_as_fast_as_frictions_limit_cycle_or_far_below_the_limits_goes_on(mode, period, size):
    assert shaking(mode, period, 900, size).h.trip == Trip.NONE


def test_on_reception_friction_itself_oscillates_faster():
    bounds = [
        HostBench("active", f'bus.actuation="{actuation}"').c.most_reversals
        for actuation in ("next_sync", "on_reception")
    ]
    assert bounds == pytest.approx([1.15 * 2 * 0.25 / 8e-3, 1.15 * 2 * 0.25 / 4e-3])


def test_the_lead_of_a_brakes_lags_is_no_oscillation_of_the_law():
    assert shaking("passive", 6, 900, fluid_step=0.5).h.trip == Trip.NONE


def test_a_short_oscillation_does_not_trip():
    assert shaking("active", 6, 200).h.trip == Trip.NONE
