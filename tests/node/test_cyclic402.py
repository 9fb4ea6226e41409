"""Cyclic and interpolated positions, touch probes, the position range and units of a drive."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from coulombus.eds.reader import Description
from coulombus.node.drive402 import DRIVE402
from node_bench import MS, Bench, SdoAborted, description
from servo_bench import BIT12, CSP, CSV, ENABLE, HOMING, IP, LIMIT, PP, REACHED, Servo

HALT, RELATIVE = 0x100, 0x40


def without(*indices: int) -> Description:
    file = description("servo")
    return replace(file, objects={index: entry for index, entry in file.objects.items() if index not in indices})


@pytest.mark.parametrize(("period_ms", "known"), [(2, True), (2, False), (10, True), (10, False)])
def test_csp_follows_a_sine(period_ms, known):
    servo = Servo(CSP, position=200)
    if known:
        servo.write(0x60C2, period_ms, 1, 1)
    servo.enable()
    assert servo.word & BIT12 == 0
    errors = []
    for k in range(0, 600, period_ms):
        target = 200 + round(2000 * (1 - math.cos(2 * math.pi * k / 600)))
        servo.write(0x607A, target)
        assert servo.word & BIT12
        servo.run(period_ms)
        errors.append(servo.position - target)
    speed = 2000 * 2 * math.pi / 0.6
    assert max(map(abs, errors)) < speed * (period_ms * 1e-3 if not known else 0.003) + 25
    assert servo.word & 0x6F == 0x27


def test_csp_holds_until_its_first_set_point_and_after_the_last():
    servo = Servo(CSP, position=900)
    servo.write(0x607A, -5000)
    servo.enable()
    servo.run(50)
    assert servo.position == pytest.approx(900, abs=2)
    servo.write(0x607A, 905)
    servo.run(100)
    assert servo.demand == 905
    servo.control(ENABLE | HALT)
    servo.run(20)
    assert not servo.word & BIT12
    servo.write(0x607A, 990)
    servo.run(50)
    assert servo.demand == 905


def test_csp_offsets():
    servo = Servo(CSP, dry=0.0, drag=0.0)
    servo.enable()
    servo.write(0x60B0, 30)
    servo.write(0x607A, 100)
    servo.run(50)
    assert servo.demand == 130
    before = float(servo.node.out_torque_pm)
    servo.write(0x60B2, 70, 2)
    assert float(servo.node.out_torque_pm) == pytest.approx(before + 70, abs=0.5)
    servo.run(300)
    servo.write(0x60B2, 0, 2)
    servo.run(300)
    demand = float(servo.node.speed_demand)
    servo.write(0x60B1, 400)
    assert float(servo.node.speed_demand) == pytest.approx(demand + 400, abs=2)


def test_csp_stays_within_the_software_limits():
    servo = Servo(CSP)
    servo.write(0x607D, 50, 4, 2)
    servo.enable()
    servo.write(0x607A, 60)
    servo.run(10)
    assert servo.demand == 50
    assert servo.word & LIMIT
    servo.write(0x607A, 40)
    servo.run(10)
    assert not servo.word & LIMIT


def test_interpolated_position_acts_with_bit_4():
    servo = Servo(IP)
    servo.write(0x60C2, 5, 1, 1)
    servo.enable()
    servo.write(0x60C1, 100, 4, 1)
    servo.run(20)
    assert servo.demand == 0
    assert not servo.word & BIT12
    servo.control(ENABLE | 0x10)
    servo.write(0x60C1, 100, 4, 1)
    assert servo.word & BIT12
    servo.run(3)
    assert servo.demand == pytest.approx(60)
    servo.run(10)
    assert servo.demand == 100
    servo.until(REACHED)
    servo.control(ENABLE)
    assert not servo.word & BIT12


@pytest.mark.parametrize(
    ("mode", "index"),
    [(1, 0x607A), (3, 0x60FF), (4, 0x6071), (6, 0x6098), (7, 0x60C1), (8, 0x607A), (9, 0x60FF), (10, 0x6071)],
)
def test_a_mode_needs_its_object_and_6502h(mode, index):
    for file, offered in ((description("servo"), True), (without(index), False)):
        bench = Bench("servo", 5, DRIVE402, file)
        bench.power_on()
        if offered:
            bench.write(0x6060, 0, mode, 1)
            assert bench.number(0x6061) == mode
            continue
        with pytest.raises(SdoAborted):
            bench.write(0x6060, 0, mode, 1)
        bench.device[0x6060, 0] = mode  # as an RPDO writes it
        assert bench.number(0x6061) == 0
    bench = Bench("servo", 5, DRIVE402)
    bench.power_on()
    with pytest.raises(SdoAborted):
        bench.write(0x6060, 0, 2, 1)  # not in 6502h


RISING, FALLING, ENABLE_PROBE, CONTINUOUS, INDEX = 0x10, 0x20, 0x01, 0x02, 0x04


def probing(function: int) -> Servo:
    servo = Servo(PP)
    servo.write(0x608F, 1000, 4, 1)
    servo.switches(home=(300.0, 450.0))
    servo.enable()
    servo.write(0x60B8, function, 2)
    return servo


def go(servo: Servo, target: int) -> None:
    servo.control(ENABLE)
    servo.move(target)
    servo.until(REACHED)


def test_probe_1_latches_both_edges_of_the_home_switch_once():
    servo = probing(ENABLE_PROBE | RISING | FALLING)
    assert servo.bench.number(0x60B9) == 1
    go(servo, 400)
    assert servo.bench.number(0x60B9) == 3
    assert servo.read(0x60BA) == 300
    go(servo, 600)
    assert servo.bench.number(0x60B9) == 7
    assert servo.read(0x60BB) == 450
    go(servo, 0)  # a second pass changes nothing
    assert (servo.read(0x60BA), servo.read(0x60BB)) == (300, 450)
    servo.write(0x60B8, 0, 2)
    assert servo.bench.number(0x60B9) == 0
    servo.write(0x60B8, ENABLE_PROBE | RISING, 2)
    go(servo, 600)
    assert servo.bench.number(0x60B9) == 3
    go(servo, 420)
    assert servo.read(0x60BA) == 300  # once


def test_probe_2_latches_the_index_continuously():
    servo = probing((ENABLE_PROBE | CONTINUOUS | INDEX | RISING) << 8)
    assert servo.bench.number(0x60B9) == 0x100
    go(servo, 999)
    assert servo.bench.number(0x60B9) == 0x100
    go(servo, 1500)
    assert servo.bench.number(0x60B9) == 0x300
    assert servo.read(0x60BC) == 1000
    go(servo, 2600)
    assert servo.read(0x60BC) == 2000
    go(servo, 1900)
    assert servo.read(0x60BC) == 2000
    assert servo.read(0x60BA) == 0


@pytest.mark.parametrize(
    ("option", "target", "end"),
    [
        (0x00, 3500, 3500), (0x00, 50, 50), (0xC0, 3500, -100), (0xC0, 50, 50), (0x40, 3500, -100), (0x40, 50, -3550),
        (0x80, 3500, 3500), (0xC0, 1900, -1700),
    ],
)  # fmt: skip
def test_the_position_range_wraps_and_60f2h_gives_the_way(option, target, end):
    servo = Servo(PP)
    servo.write(0x607B, 3599, 4, 2)
    servo.write(0x60F2, option, 2)
    servo.enable()
    servo.move(target)
    servo.until(REACHED)
    assert servo.demand == end
    assert servo.read(0x6064) == pytest.approx(target, abs=3)
    servo.control(ENABLE | RELATIVE)
    servo.move(4000, RELATIVE)
    servo.until(REACHED)
    assert servo.demand == end + 4000
    assert servo.read(0x6062) == (target + 4000) % 3600


def test_the_counter_overflows_and_targets_lie_in_its_turn():
    servo = Servo(PP, position=(1 << 31) - 100)
    servo.enable()
    servo.move((1 << 31) - 20)
    servo.until(REACHED)
    assert servo.demand == (1 << 31) - 20
    servo.control(ENABLE)
    servo.move(200, RELATIVE)
    servo.until(REACHED)
    assert servo.read(0x6062) == -(1 << 31) + 180


def test_velocities_in_revolutions_per_minute():
    file = description("servo")
    objects = dict(file.objects)
    template = objects[0x6085]
    unit = replace(template.variables[0], index=0x60A9, default=0x00B44700)
    objects[0x60A9] = replace(template, index=0x60A9, variables={0: unit})
    servo = Servo(PP, eds=replace(file, objects=objects))
    servo.node.in_velocity_counts_s = 0.0
    assert float(servo.node.unit_counts_s) == pytest.approx(8192 / 60)
    servo.write(0x6081, 60)  # 8192 counts/s
    servo.write(0x6083, 600)
    servo.enable()
    servo.move(20_000)
    servo.bench.run(50 * MS)
    assert servo.demand == pytest.approx(81_920 * 0.05**2 / 2, rel=0.01)
    assert float(servo.node.profile_speed) == pytest.approx(4096, rel=0.01)
    assert float(servo.node.speed_demand) >= 30
    servo.node.in_velocity_counts_s = 4096.0
    servo.bench.run(MS)
    assert servo.read(0x606C) == 30


def test_homing_stays_after_a_change_of_the_mode_and_ends_with_reset():
    servo = Servo(HOMING, position=50)
    servo.write(0x6098, 35, 1)
    servo.enable()
    servo.control(ENABLE | 0x10)
    assert servo.read(0x6064) == 0
    servo.bench.nmt(0x81)
    assert servo.read(0x6064) == 50


POSITION_MODES, AXIS = (0x607A, 0x6098, 0x60C1), (0x607B, 0x60B8)


@pytest.mark.parametrize("present", AXIS)
def test_a_drive_without_position_modes_has_the_servo_part_for_an_object_of_the_axis(present):
    servo = Servo(CSV, eds=without(*POSITION_MODES, *(index for index in AXIS if index != present)), position=-130)
    assert servo.node.servo != 0
    if present == 0x607B:
        servo.write(0x607B, 0, subindex=1)
        servo.write(0x607B, 99, subindex=2)
        assert servo.read(0x6064) == 70


def test_the_digital_inputs_of_no_switch_are_the_users():
    servo = Servo(HOMING, position=50)
    servo.bench.device[0x60FD, 0] = 0x10005
    assert servo.read(0x60FD) == 0x10005


def test_a_drive_with_none_of_them_has_no_servo_part():
    servo = Servo(CSV, eds=without(*POSITION_MODES, *AXIS), position=-130)
    assert servo.node.servo == 0
    assert [servo.read(index) for index in (0x6062, 0x6063, 0x6064, 0x60F4)] == [-130, -130, -130, 0]
    servo.write(0x60FF, 500)
    servo.enable()
    servo.run(100)
    assert servo.speed > 100
    bench = Bench("motor", 5)
    bench.power_on()
    assert bench.node.servo == 0
