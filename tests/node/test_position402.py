"""Profile position of a drive: its profile computed apart, the handshake of set-points, limits, windows."""

from __future__ import annotations

import math

import pytest

from coulombus.node import position402, slots402
from node_bench import MS
from servo_bench import BIT12, BIT13, CSV, ENABLE, HOMING, LIMIT, PP, PV, REACHED, Servo

NEW, AT_ONCE, RELATIVE, HALT, ON_SETPOINT = 0x10, 0x20, 0x40, 0x100, 0x200


def trapezoid(distance: float, speed: float, up: float, down: float, t: float) -> float:
    """The way after `t` seconds of a move from rest to rest, by the areas under its speed."""
    sign, way = math.copysign(1, distance), abs(distance)
    peak = min(speed, math.sqrt(2 * way * up * down / (up + down)))
    rise, fall = peak / up, peak / down
    even = (way - peak * (rise + fall) / 2) / peak
    if t < rise:
        return sign * up * t * t / 2
    if t < rise + even:
        return sign * peak * (t - rise / 2)
    left = max(rise + even + fall - t, 0.0)
    return sign * (way - down * left * left / 2)


def duration_ms(distance: float, speed: float, up: float, down: float) -> float:
    peak = min(speed, math.sqrt(2 * abs(distance) * up * down / (up + down)))
    return 1e3 * (peak / up + peak / down + (abs(distance) - peak * peak * (1 / up + 1 / down) / 2) / peak)


def ready(position: int = 0, **settings: int) -> Servo:
    servo = Servo(PP, position=position)
    servo.write(0x6081, settings.get("speed", 40_000))
    servo.write(0x6083, settings.get("up", 200_000))
    servo.write(0x6084, settings.get("down", 400_000))
    servo.enable()
    return servo


@pytest.mark.parametrize(
    ("start", "target", "speed", "up", "down"),
    [
        (0, 9000, 40_000, 200_000, 400_000),
        (-700, -20_700, 40_000, 400_000, 200_000),
        (1234, 1734, 40_000, 100_000, 300_000),
        (500, 499, 1000, 50_000, 50_000),
    ],
)
def test_the_demand_is_the_trapezoid_and_the_axis_follows(start, target, speed, up, down):
    servo = ready(start, speed=speed, up=up, down=down)
    servo.move(target)
    began = servo.bench.t
    took = servo.until(REACHED)
    for t_ns, demand, position in servo.trace:
        expected = start + trapezoid(target - start, speed, up, down, (t_ns - began) * 1e-9)
        if (t_ns - began) % MS == 0:
            assert demand == pytest.approx(expected, abs=1e-3)
            assert position == pytest.approx(expected, abs=12)
    assert servo.demand == target
    assert servo.read(0x6062) == target
    assert servo.read(0x6064) == pytest.approx(target, abs=2)
    profile_ms = duration_ms(target - start, speed, up, down)
    assert profile_ms <= took <= profile_ms + 20


def test_single_set_points_are_acknowledged_and_one_waits():
    servo = ready(100)
    assert not servo.word & BIT12
    servo.move(4000)
    assert servo.word & (BIT12 | REACHED) == BIT12
    servo.control(ENABLE)
    assert not servo.word & BIT12
    servo.run(20)
    servo.write(0x6081, 20_000)
    servo.move(6000)
    servo.control(ENABLE)
    assert servo.word & BIT12  # the place is taken
    servo.move(-5000)  # a third is ignored
    servo.control(ENABLE)
    reached = servo.until(REACHED)
    assert servo.demand == 6000
    assert not servo.word & BIT12
    first, second = duration_ms(3900, 40_000, 200_000, 400_000) - 20, duration_ms(2000, 20_000, 200_000, 400_000)
    assert first + second <= reached <= first + second + 20
    _, _, speed = min(servo.speeds, key=lambda row: abs(row[1] - 4000))
    assert abs(speed) < 500  # it stops between them
    servo.run(500)
    assert servo.demand == 6000


def test_a_set_point_needs_the_rising_edge_of_bit_4():
    servo = ready()
    servo.move(3000)
    servo.write(0x607A, -3000)
    servo.control(ENABLE | NEW)
    servo.run(1000)
    assert servo.demand == 3000


@pytest.mark.parametrize(("second", "at_ms"), [(-2000, 100), (12_000, 100), (2600, 130)])
def test_a_set_point_changed_immediately_has_no_jump(second, at_ms):
    servo = ready(-50)
    servo.move(8000)
    servo.control(ENABLE)
    servo.run(at_ms)
    servo.move(second, AT_ONCE)
    servo.until(REACHED)
    assert servo.demand == second
    for (before_ns, _, before), (after_ns, _, after) in zip(servo.speeds, servo.speeds[1:], strict=False):
        assert abs(after - before) <= 400_000 * (after_ns - before_ns) * 1e-9 * 1.001 + 1e-6  # 6084h
    assert max(abs(speed) for _, _, speed in servo.speeds) <= 40_000 * (1 + 1e-9)


def test_change_on_set_point_passes_the_first_target_at_its_speed():
    servo = ready()
    servo.move(6000)
    servo.control(ENABLE)
    servo.run(60)
    servo.write(0x6081, 10_000)
    servo.move(9000, ON_SETPOINT)
    servo.control(ENABLE | ON_SETPOINT)
    while servo.demand < 5990:
        servo.run(0.25)
        assert not servo.word & REACHED
    assert float(servo.node.profile_speed) == pytest.approx(40_000)
    servo.until(REACHED)
    assert servo.demand == 9000
    begin = len(servo.trace)
    servo.move(7000)  # back again: it stops in between
    servo.control(ENABLE)
    servo.run(20)
    servo.move(8000, ON_SETPOINT)
    servo.control(ENABLE)
    servo.until(REACHED)
    assert servo.demand == 8000
    assert min(demand for _, demand, _ in servo.trace) >= 0
    assert min(demand for _, demand, _ in servo.trace[begin:]) == pytest.approx(7000, abs=2)


@pytest.mark.parametrize(("option", "end"), [(0, 5300), (1, None), (2, None)])
def test_relative_set_points(option, end):
    servo = ready(300)
    servo.write(0x60F2, option, 2)
    servo.move(4000, RELATIVE)
    servo.control(ENABLE | RELATIVE)
    servo.run(100)
    demand, position = servo.demand, servo.node.in_position_counts
    assert demand < 4000
    servo.move(1000, RELATIVE | AT_ONCE)
    servo.until(REACHED)
    assert servo.demand == pytest.approx({0: 5300, 1: demand + 1000, 2: float(position) + 1000}[option], abs=0.01)
    servo.control(ENABLE)
    servo.move(-700, RELATIVE)
    before = servo.demand
    servo.until(REACHED)
    assert servo.demand == pytest.approx(before - 700, abs=10 if option == 2 else 0.01)


@pytest.mark.parametrize(("option", "down"), [(1, 400_000), (2, 1_000_000)])
def test_halt_stops_and_the_target_is_reached_after_it(option, down):
    servo = ready(10)
    servo.write(0x605D, option, 2)
    servo.move(9000)
    servo.control(ENABLE)
    servo.run(150)
    speed, demand = float(servo.node.profile_speed), servo.demand
    assert speed == pytest.approx(30_000, rel=0.01)
    servo.control(ENABLE | HALT)
    assert not servo.word & REACHED
    servo.until(REACHED)
    rest = demand + speed * speed / 2 / down
    assert servo.demand == pytest.approx(rest, abs=2)
    servo.run(100)
    servo.move(100, HALT)  # takes the place of the next
    servo.control(ENABLE | HALT)
    servo.run(100)
    assert servo.demand == pytest.approx(rest, abs=2)
    servo.control(ENABLE)
    assert not servo.word & REACHED
    servo.until(REACHED)
    assert servo.demand == 100
    assert max(demand for _, demand, _ in servo.trace) == pytest.approx(9000, abs=0.1)


def test_software_limits_clip_the_target():
    servo = ready(50)
    servo.write(0x607D, -1000, 4, 1)
    servo.write(0x607D, 3000, 4, 2)
    for target, end, limited in ((5000, 3000, True), (2000, 2000, False), (-1001, -1000, True), (3000, 3000, False)):
        servo.control(ENABLE)
        servo.move(target)
        servo.run(1)
        assert bool(servo.word & LIMIT) == limited
        servo.until(REACHED)
        assert servo.demand == end
        assert servo.position == pytest.approx(end, abs=5)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("limit", "value", "speed", "up", "down"),
    [
        (0x607F, 20_000, 20_000, 200_000, 400_000),
        (0x6080, 60, 8192, 200_000, 400_000),
        (0x60C5, 100_000, 40_000, 100_000, 400_000),
        (0x60C6, 100_000, 40_000, 200_000, 100_000),
        (0x60C5, 0, 40_000, 200_000, 400_000),
    ],
)
def test_limits_of_speed_and_acceleration(limit, value, speed, up, down):
    servo = ready()
    servo.write(limit, value)
    servo.move(-12_000)
    expected = duration_ms(-12_000, speed, up, down)
    assert expected <= servo.until(REACHED) <= expected + 20


def test_a_profile_velocity_of_0_does_not_move():
    servo = ready(7)
    servo.write(0x6081, 0)
    servo.move(1000)
    servo.run(50)
    assert servo.demand == 7


def test_the_position_window_and_its_time():
    servo = ready()
    servo.write(0x6067, 100)
    servo.write(0x6068, 30, 2)
    servo.blocked = True
    servo.write(0x6065, 0xFFFFFFFF)
    servo.move(80)
    servo.control(ENABLE)
    expected = duration_ms(80, 40_000, 200_000, 400_000)
    assert expected + 29 <= servo.until(REACHED) <= expected + 32
    servo.move(101)
    servo.control(ENABLE)
    servo.run(200)
    assert not servo.word & REACHED
    servo.write(0x6067, 0xFFFFFFFF)  # off
    servo.run(50)
    assert servo.word & REACHED


def test_a_blocked_axis_is_a_following_error_with_8611h_and_a_fault():
    servo = ready(-40)
    servo.write(0x6065, 500)
    servo.write(0x6066, 20, 2)
    servo.blocked = True
    servo.bench.emcy()
    servo.move(5000)
    late = math.sqrt(2 * 500 / 200_000) * 1e3
    servo.run(late + 18)
    assert servo.word & (0x6F | BIT13) == 0x27
    assert servo.read(0x60F4) > 500
    servo.run(5)
    assert servo.word & 0x4F == 0x08
    assert servo.bench.emcy() == [(0x8611, 0x21, 0)]
    assert servo.bench.number(0x603F) == 0x8611
    assert servo.node.out_torque_pm == 0
    servo.blocked = False
    servo.control(0x80)
    assert servo.word & 0x4F == 0x40
    assert servo.bench.emcy() == [(0, 0, 0)]
    servo.enable()
    servo.run(100)
    assert servo.position == pytest.approx(-40, abs=3)  # it holds, and does not go on


def test_a_blocked_axis_without_a_following_window_is_7121h_after_half_a_second():
    servo = ready(-40)
    servo.write(0x6065, 0xFFFFFFFF)
    servo.blocked = True
    servo.bench.emcy()
    servo.move(-500_000)
    servo.run(490)
    assert servo.word & 0x6F == 0x27
    servo.run(400)
    assert servo.word & 0x4F == 0x08
    assert servo.bench.emcy() == [(0x7121, 0x21, 0)]
    assert servo.node.out_torque_pm == 0
    servo.blocked = False
    servo.control(0x80)
    assert servo.word & 0x4F == 0x40
    assert servo.bench.emcy() == [(0, 0, 0)]


def test_the_fault_reaction_slows_the_axis_down():
    servo = ready()
    servo.write(0x605E, 2, 2)
    servo.write(0x6085, 400_000)
    servo.write(0x6065, 100)
    servo.move(20_000)
    servo.run(180)
    servo.write(0x60E0, 10, 2)  # too weak for its friction
    while servo.word & 0x4F == 0x07:
        servo.run(1)
    assert servo.word & 0x4F == 0x0F
    servo.write(0x60E0, 1000, 2)
    speed = servo.speed
    servo.run(speed / 400 + 30)
    assert servo.word & 0x4F == 0x08
    assert abs(servo.speed) < 3000


def test_the_following_error_has_no_window_where_it_is_off():
    servo = ready()
    servo.write(0x6065, 0xFFFFFFFF)
    servo.blocked = True
    servo.move(60_000)
    servo.run(300)
    assert servo.word & (0x6F | BIT13) == 0x27


def test_a_following_error_that_ends_in_time_is_none():
    servo = ready()
    servo.write(0x6065, 300)
    servo.write(0x6066, 100, 2)
    servo.blocked = True
    servo.move(2000)
    servo.run(100)
    servo.blocked = False
    servo.run(400)
    assert servo.word & 0x6F == 0x27


def test_a_change_of_the_mode_holds_and_drops_what_waits():
    servo = ready()
    servo.move(9000)
    servo.control(ENABLE)
    servo.move(100)
    servo.run(100)
    servo.write(0x6060, HOMING, 1)
    servo.run(300)
    assert servo.read(0x6061) == HOMING
    assert abs(servo.speed) < 1
    position = servo.position
    servo.write(0x6060, PV, 1)
    servo.run(100)
    assert servo.read(0x6061) == PV
    servo.write(0x6060, PP, 1)
    servo.run(100)
    assert servo.position == pytest.approx(position, abs=200)
    assert servo.word & (REACHED | BIT12) == REACHED
    servo.control(ENABLE)
    servo.move(500, AT_ONCE)
    servo.until(REACHED)
    assert servo.demand == 500


def test_a_quick_stop_slows_by_6085h():
    servo = ready(speed=100_000)
    servo.write(0x605A, 6, 2)
    servo.move(90_000)
    servo.run(300)
    speed = servo.speed
    servo.control(0x02)
    servo.run(1e3 * speed / 1_000_000 / 2)
    assert servo.speed == pytest.approx(speed / 2, rel=0.15)
    servo.run(1e3 * speed / 1_000_000)
    assert servo.word & 0x6F == 0x07
    assert abs(servo.speed) < 5000


def test_without_its_load_the_drive_still_arrives():
    servo = Servo(PP, knows_load=False)
    servo.enable()
    servo.write(0x6083, 20_000)
    servo.write(0x6084, 20_000)
    servo.move(8000)
    servo.until(REACHED, ms=4000)
    assert servo.position == pytest.approx(8000, abs=10)


def test_offsets_of_cyclic_velocity_reach_the_torque():
    outs = []
    for offset in (0, 50):
        servo = Servo(CSV)
        servo.write(0x60B2, offset, 2)
        servo.enable()
        servo.write(0x60FF, 0)
        outs.append(float(servo.node.out_torque_pm))
    assert outs == [0, 50]


def test_a_negative_largest_speed_is_none():
    """A file may give 607Fh a signed type."""
    servo = Servo(PP)
    servo.node.values[slots402.MAX_VELOCITY] = -100_000
    assert position402.fastest(servo.node) == 0.0
