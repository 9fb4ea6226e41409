"""The cycle on other devices: widths, units, a brake that is a drive, further nodes, and roles that
are absent. Both senses.
"""

from __future__ import annotations

import re

import pytest

from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.controller import Controller
from coulombus.host.cycle.monitors import measure
from coulombus.host.cycle.phases import disable, enable, still
from coulombus.host.cycle.records import TABLE_POINTS, Image, Phase, SignResult, Trip
from coulombus.host.cycle.step import begin, brake_raw
from coulombus.rigs.rig import RigError, load_rig_text
from coulombus.wire.frame import CAN_RTR_FLAG
from eds_edit import SENSOR, gone
from host_bench import MS, HostBench
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
MOTOR, BRAKE = ((ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds"))
BOTH = pytest.mark.parametrize("sign", [1, -1])
TABLE = [[0, 0.0], [100, 0.5], [300, 1.5], [4000, 5.0]]


def edit(text, section, **keys):
    head, mark, rest = text.partition(f"[{section}]\n")
    assert mark, section
    body, gap, tail = rest.partition("\n\n")
    for key, value in keys.items():
        body = re.sub(f"(?m)^{key}=.*$", f"{key}={value}", body)
    return head + mark + body + gap + tail


def bench_of(text="", *overrides, motor=MOTOR, brake=BRAKE, mode="hybrid", **others):
    texts = {"motor.eds": motor, "mr_brake.eds": brake, **others}
    return HostBench(mode, rig=load_rig_text(BENCH + text, "r.toml", texts, overrides))


def none_of(*roles):
    return "".join(f'\n[role.{role}]\nobject = "none"\n' for role in roles)


# the position

NARROW = edit(MOTOR, "6064", DataType="0x0003", LowLimit="", HighLimit="")


@BOTH
def test_a_position_of_16_bits_is_followed_across_its_wrap(sign):
    bench = bench_of(motor=NARROW)
    h, c = bench.h, bench.c
    assert c.position_half == 1 << 15
    h.has_position, h.raw_position, h.counts, h.arrived = 1, sign * 32_760, 5, c.position_mask
    h.image[Image.POSITION] = -sign * 32_756  # 20 counts on
    assert measure(c, h) == Trip.NONE
    assert h.counts == 5 + sign * 20
    h.arrived, h.image[Image.POSITION] = c.position_mask, -sign * 32_756 + sign * 501
    assert measure(c, h) == Trip.ENCODER_JUMP


# the brake's table


@pytest.mark.parametrize(
    ("Nm", "raw"), [(0.0, 0), (0.25, 50), (0.5, 100), (1.0, 200), (1.5, 300), (3.25, 2150), (5.0, 4000), (7.0, 4000), (-1.0, 0),
                    (0.249, 50), (0.251, 50), (1.499, 300)]
)  # fmt: skip
@pytest.mark.parametrize("sense", [1, -1])
def test_a_table_is_interpolated_and_never_left(Nm, raw, sense):
    table = [[sense * x, y] for x, y in TABLE]
    signed = edit(BRAKE, "7300sub1", LowLimit=-5000)
    bench = bench_of(f"\n[role.brake_setpoint]\ntable = {table}\n", brake=signed)
    bench.h.brake_Nm = Nm
    assert brake_raw(bench.c, bench.h) == sense * raw


def test_a_table_may_have_as_many_points_as_there_is_room_for():
    table = [[30 * k, k / 10] for k in range(TABLE_POINTS)]
    bench = bench_of(f"\n[role.brake_setpoint]\ntable = {table}\n")
    assert bench.c.brake_points == TABLE_POINTS
    for k in (0, 1, TABLE_POINTS - 1, TABLE_POINTS, 2 * TABLE_POINTS):
        bench.h.brake_Nm = k / 10
        assert brake_raw(bench.c, bench.h) == 30 * min(k, TABLE_POINTS - 1)


def test_a_stronger_brake_has_never_a_smaller_set_point():
    bench = bench_of(f"\n[role.brake_setpoint]\ntable = {TABLE}\n")
    found = []
    for k in range(600):
        bench.h.brake_Nm = k / 100
        found.append(brake_raw(bench.c, bench.h))
    assert found == sorted(found)
    assert (found[0], found[-1]) == (0, 4000)


def test_a_tables_end_limits_the_brake_and_counts_beyond_the_object_are_refused():
    short = "\n[role.brake_setpoint]\ntable = [[0, 0.0], [1000, 4.0]]\n"
    assert bench_of(short).c.brake_limit_Nm == 4.0
    with pytest.raises(
        RigError, match=r"role.brake_setpoint.table: .* expected raw counts from 0 to 5000, which 7300h:01 takes"
    ):
        bench_of("\n[role.brake_setpoint]\ntable = [[0, 0.0], [5001, 4.0]]\n")


# a brake that is a CiA 402 drive

DRIVE = edit(MOTOR, "1018sub2", DefaultValue="0x404")
AS_DRIVE = "\n[role.brake_setpoint]\nscale_Nm = 0.005\n"


def drive_bench(*overrides, mode="hybrid"):
    return bench_of(AS_DRIVE, *overrides, brake=DRIVE, mode=mode)


def test_the_law_begins_only_when_brake_and_motor_are_enabled():
    bench = drive_bench()
    assert bench.c.brake_is_drive
    bench.cycles(400, until=lambda: bench.state == PowerState.OPERATION_ENABLED)
    for _ in range(5):
        bench.brake_state = int(PowerState.SWITCHED_ON)
        bench.cycle()
        assert bench.phase is Phase.ENABLE
    bench.arm()
    assert bench.phase is Phase.RUN
    assert (bench.state, bench.brake_state) == (PowerState.OPERATION_ENABLED,) * 2


def test_a_brake_that_is_not_switched_on_lets_nothing_be_enabled():
    bench = drive_bench("limits.still_timeout_s=0.4")
    for _ in range(450):
        bench.brake_state = int(PowerState.SWITCH_ON_DISABLED)
        bench.cycle()
        assert bench.state != PowerState.OPERATION_ENABLED
    assert bench.k.trip.startswith("ENABLE_TIMEOUT")


@pytest.mark.parametrize("motor", [True, False])
@pytest.mark.parametrize("brake", [True, False])
def test_nothing_is_enabled_before_both_are_switched_on(motor, brake):
    bench = drive_bench().enter(Phase.STILL)
    h = bench.h
    h.still, h.deadman_ok, h.fresh = bench.c.still_cycles, 1, 1
    ready, other = int(PowerState.SWITCHED_ON), int(PowerState.READY_TO_SWITCH_ON)
    h.drive, h.brake_drive = ready if motor else other, ready if brake else other
    assert still(bench.c, h)[1] == (Phase.ENABLE if motor and brake else Phase.STILL)


@pytest.mark.parametrize("motor", [True, False])
@pytest.mark.parametrize("brake", [True, False])
def test_the_sign_check_waits_until_both_are_enabled(motor, brake):
    bench = drive_bench().enter(Phase.ENABLE)
    h = bench.h
    ready, other = int(PowerState.OPERATION_ENABLED), int(PowerState.SWITCHED_ON)
    h.drive, h.brake_drive = ready if motor else other, ready if brake else other
    assert enable(bench.c, h, 123)[1] == (Phase.SIGN if motor and brake else Phase.ENABLE)
    assert h.enabled_ns == (123 if motor and brake else -1)


OFF = (PowerState.SWITCH_ON_DISABLED, PowerState.FAULT)


@pytest.mark.parametrize("motor", [*OFF, PowerState.OPERATION_ENABLED])
@pytest.mark.parametrize("brake", [*OFF, PowerState.OPERATION_ENABLED])
def test_the_end_is_there_when_both_are_disabled(motor, brake):
    bench = drive_bench().enter(Phase.DISABLE)
    bench.h.drive, bench.h.brake_drive = int(motor), int(brake)
    assert disable(bench.h)[1] == (Phase.DONE if motor in OFF and brake in OFF else Phase.DISABLE)


@pytest.mark.parametrize("state", [PowerState.FAULT, PowerState.SWITCH_ON_DISABLED, PowerState.QUICK_STOP_ACTIVE])
def test_a_brake_that_leaves_operation_enabled_trips_in_that_cycle(state):
    bench = drive_bench()
    bench.arm()
    bench.cycles(20)
    bench.brake_state = int(state)
    bench.cycle()
    assert bench.k.trip.startswith("DRIVE_STATE")
    assert (bench.phase, bench.motor_pm) == (Phase.SAFE, 0)


def test_the_brake_stays_enabled_while_it_is_ramped_off_and_is_disabled_then():
    bench = drive_bench()
    bench.arm()
    bench.h.brake_Nm = 1.0
    bench.k.stop()
    words = []
    for _ in range(900):
        bench.cycle()
        words.append((bench.phase, int(bench.h.image[Image.BRAKE_CONTROLWORD])))
    assert {word for phase, word in words if phase is Phase.SAFE} == {0x0F}
    assert words[-1] == (Phase.DONE, 0)
    assert bench.brake_state == PowerState.SWITCH_ON_DISABLED


# further nodes


def sensor_bench(*overrides):
    return bench_of(SENSOR, *overrides, **{"cell.eds": BRAKE})


def running(bench):
    bench.arm()
    bench.cycles(20)
    assert bench.phase is Phase.RUN
    return bench


@BOTH
def test_the_handle_torque_of_another_node_is_the_handle_torque(sign):
    bench = sensor_bench(f"mechanics.transducer_polarity={sign}")
    bench.handle_Nm = 0.125
    bench.cycle()
    assert bench.h.handle_Nm == pytest.approx(0.125)
    assert bench.c.handle_Nm_raw == sign * 0.001


def test_a_sensor_is_watched_like_the_others():
    bench = running(sensor_bench())
    assert bench.k.can_ids() >= {0x703, 0x083, 0x583, 0x183}
    bench.frame(0x083, 8, 0x5000)
    bench.cycle()
    assert bench.k.trip == "EMCY_SENSOR: the sensor cell sent an EMCY (error code 5000h)"
    bench = running(sensor_bench())
    bench.h.heard_ns[2] = bench.t_ns - 151 * MS
    bench.heartbeats = False
    bench.cycle()
    assert bench.k.trip == "HEARTBEAT_SENSOR: the heartbeat of the sensor cell was lost"
    bench = running(sensor_bench())
    bench.frame(0x703, 1, 4)
    bench.cycle()
    assert bench.k.trip.startswith("NMT_STATE")
    bench = running(sensor_bench())
    bench.silent = {"cell"}
    bench.cycles(3)
    assert bench.k.trip.startswith("TPDO_LOST")


# TPDOs by their own timer

BY_TIMER = edit(MOTOR, "1800sub2", AccessType="ro", DefaultValue=255)


def test_a_tpdo_by_timer_need_not_come_in_each_cycle_and_is_lost_in_the_end():
    bench = running(bench_of(motor=BY_TIMER))
    assert (bench.c.every_cycle, bench.c.awaited, bench.c.by_timer) == (0b10, 0b10, 0b01)
    for _ in range(3):
        bench.silent = {"motor"}
        bench.cycles(2)
        assert bench.k.trip is None
        bench.silent = set()
        bench.cycle()
    lost = int(bench.h.lost_pdos)
    bench.silent = {"motor"}
    bench.cycles(3)
    assert bench.k.trip.startswith("TPDO_LOST")
    assert bench.h.lost_pdos == lost


def test_a_tpdo_that_came_after_the_end_of_the_cycle_counts_for_the_next():
    bench = running(bench_of(motor=BY_TIMER))
    bench.counts = 7.0
    values = bench.tpdo_values()
    bench.silent = {"motor"}
    from coulombus.eds.codec import pack

    tpdo = bench.k.tpdos[0]
    bench.frame(int(tpdo.cob_id), int(tpdo.length), pack(tpdo, values))
    before = int(bench.h.counts)
    bench.cycle()
    assert bench.h.fresh == 1
    assert bench.h.counts - before == 7


def test_a_position_by_timer_is_fresh_once_and_ages_then():
    bench = running(bench_of(motor=BY_TIMER))
    ages = []
    for silent in (set(), {"motor"}, {"motor"}, set()):
        bench.silent = silent
        bench.cycle()
        ages.append((int(bench.h.fresh), int(bench.h.position_age), int(bench.h.oldest_tpdo)))
    assert ages == [(1, 0, 1), (0, 1, 2), (0, 2, 3), (1, 0, 1)]


def test_the_oldest_tpdo_is_the_oldest_of_those_by_timer_alone():
    bench = HostBench()
    assert bench.c.tpdos == 2
    for by_timer, oldest in ((0b00, 0), (0b01, 8), (0b10, 5), (0b11, 8)):
        bench.c.by_timer = by_timer
        bench.h.tpdo_age[0], bench.h.tpdo_age[1] = 7, 4
        bench.finish()
        assert bench.h.oldest_tpdo == oldest
        assert [int(age) for age in bench.h.tpdo_age[:2]] == [7 + (by_timer & 1), 4 + (by_timer >> 1)]


def test_a_heartbeat_of_a_stranger_changes_nothing():
    bench = running(bench_of())
    before = list(bench.h.nmt), list(bench.h.heard_ns)
    assert bench.frame(0x77F, 1, 4) == 2
    assert (list(bench.h.nmt), list(bench.h.heard_ns)) == before


def test_with_no_tpdo_in_each_cycle_the_wait_ends_with_all_or_with_the_window():
    by_timer = edit(BRAKE, "1800sub2", AccessType="ro", DefaultValue=254)
    bench = bench_of(motor=BY_TIMER, brake=by_timer)
    assert (bench.c.every_cycle, bench.c.awaited, bench.c.by_timer) == (0, 0b11, 0b11)
    running(bench)


# what stands for an absent role


def test_without_a_handle_torque_its_watch_and_its_checks_are_gone():
    bench = bench_of(none_of("handle_torque"))
    assert "motor" in bench.k.axis.devices
    bench.handle_Nm = 50.0
    bench.arm()
    assert bench.k.sign_result is SignResult.NO_HAND
    bench.cycles(600)
    assert bench.phase is Phase.RUN


@BOTH
def test_without_a_measured_torque_the_command_makes_the_net_work(sign):
    bench = bench_of(none_of("torque"), mode="active").enter(Phase.RUN)
    assert (bench.c.torque_Nm_raw, bench.c.torque_commanded) == (0.0, 1.0)
    bench.h.torque_Nm, bench.h.work_sum = sign * 1.0, 0.0
    bench.counts += sign * 100
    bench.cycle()
    assert bench.h.work_sum == pytest.approx(100 * abs(bench.c.rad_count))


def test_without_a_coil_current_the_command_heats_the_coil():
    bench = bench_of(
        none_of("coil_current"), "brake.coil_continuous_A=0.3", "brake.coil_time_constant_s=0.1", "brake.coil_A_Nm=0.2"
    )
    running(bench)
    bench.k.state[0].brake_Nm = 3.0
    for _ in range(400):
        bench.h.brake_Nm = 2.0
        bench.cycle()
        if bench.k.trip:
            break
    assert bench.k.trip.startswith("COIL_I2T")


# guarding, constants


def test_nodes_are_guarded_by_remote_frames():
    bench = HostBench()
    bench.c.guard_ns, bench.c.guarded = 20 * MS, 0b10
    sent = []
    for k in range(50):
        bench.out["count"] = 0
        begin(bench.axis, k * MS, bench.out)
        sent += [frame for frame in bench.frames() if frame[1] & CAN_RTR_FLAG]
    assert sent == [(t * MS, CAN_RTR_FLAG | 0x702, 1, 0) for t in (0, 20, 40)]
    bench.h.nmt[1], bench.h.heard_ns[1], bench.t_ns = 127, 0, 60 * MS
    assert bench.frame(0x702, 1, 0x85) == 2  # its toggle bit is no part of the state
    assert (bench.h.nmt[1], bench.h.heard_ns[1]) == (5, 60 * MS)


SLOW = ("motor.heartbeat_timeout_s=4.003", "brake.heartbeat_timeout_s=4.003")


@pytest.mark.parametrize(("motor", "brake", "guarded"), [(True, False, 0b01), (False, True, 0b10), (True, True, 0b11)])
def test_the_nodes_that_do_not_watch_the_host_s_heartbeat_are_guarded_at_its_pace(motor, brake, guarded):
    texts = {"motor": gone(MOTOR, *["1016sub1"] * motor), "brake": gone(BRAKE, *["1016sub1"] * brake)}
    c = bench_of("", "host.heartbeat_s=1.001", *SLOW, **texts).c
    assert (c.guarded, c.guard_ns) == (guarded, 1_001_000_000)
    assert list(c.heartbeat_timeout_ns[:2]) == [4003 * MS] * 2


def test_a_node_that_neither_beats_nor_is_guarded_is_not_watched_for_it():
    c = bench_of(motor=gone(MOTOR, "1017", "100C"), brake=gone(BRAKE, "1017", "100D")).c
    assert (c.guarded, c.guard_ns, list(c.heartbeat_timeout_ns[:2])) == (0, 0, [0, 0])


def test_what_a_fixed_rpdo_carries_besides_is_sent_with_its_constant():
    motor = MOTOR
    for number in range(4):
        for sub in range(9):
            motor = edit(motor, f"160{number}sub{sub}", AccessType="ro")
    for sub, word in enumerate((0x60600008, 0x60400010, 0x60710010), start=1):
        motor = edit(motor, f"1600sub{sub}", DefaultValue=f"0x{word:08X}")
    motor = edit(motor, "1600sub0", DefaultValue=3)
    bench = bench_of(motor=motor, mode="active").enter(Phase.RUN)
    bench.cycle()
    (word,) = [word for _, can_id, _, word in bench.frames() if can_id == 0x201]
    assert word & 0xFF == 10
    assert word >> 8 & 0xFFFF == 0x0F


def test_a_torque_in_the_makers_own_unit_is_limited_in_its_counts():
    text = '\n[role.torque_setpoint]\nobject = "60FF"\nscale_Nm = 0.00001\n'
    k = Controller(
        load_rig_text(BENCH + text, "r.toml", {"motor.eds": MOTOR, "mr_brake.eds": BRAKE}).one_axis(), "active"
    )
    assert k.control[0]["motor_Nm_raw"] == pytest.approx(0.00001 * 9.587)
    assert k.control[0]["motor_limit_raw"] == int(1.5 / (0.00001 * 9.587))
