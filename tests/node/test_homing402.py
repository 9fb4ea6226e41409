"""Homing of a drive: every method on an axis with switches and an index, offset, interruption, errors."""

from __future__ import annotations

import pytest

from coulombus.node import homing402, slots402
from node_bench import MS, SdoAborted
from servo_bench import BIT12, BIT13, ENABLE, HOMING, PP, REACHED, Servo

START, HALT = 0x10, 0x100
TURN = 512
LOW, FROM, TO, HIGH = -2050.0, -150.0, 250.0, 2100.0
ATTAINED = REACHED | BIT12
MASK = REACHED | BIT12 | BIT13

EDGES = {
    1: (LOW, 1), 2: (HIGH, -1), 3: (FROM, -1), 4: (FROM, 1), 5: (TO, 1), 6: (TO, -1),
    7: (FROM, -1), 8: (FROM, 1), 9: (TO, -1), 10: (TO, 1), 11: (TO, 1), 12: (TO, -1), 13: (FROM, 1), 14: (FROM, -1),
}  # fmt: skip
"""CiA 402, figures of the homing methods: the edge that counts, and the direction across it."""


def index_beyond(place: float, direction: int) -> int:
    place = round(place)
    return next(k for k in range(place + direction, place + direction * (TURN + 2), direction) if k % TURN == 0)


def ready(position: int, method: int) -> Servo:
    servo = Servo(HOMING, position=position, step_ns=MS)
    servo.write(0x608F, TURN, 4, 1)
    servo.write(0x6099, 8000, 4, 1)
    servo.switches(LOW, (FROM, TO), HIGH)
    servo.write(0x6098, method, 1)
    servo.enable()
    return servo


def start(servo: Servo) -> None:
    servo.control(ENABLE | START)


def starts(method: int) -> tuple[int, ...]:
    """Positions from which a method finds its edge."""
    if method in (1, 2):
        return (-2070, 0, 2090)
    if method in (3, 4):  # a home switch on the positive side
        return (-900, 50)
    if method in (5, 6):
        return (900, 50)
    return (-900, 50, 900)


CASES = [(method, place) for method in EDGES for place in starts(method)]


@pytest.mark.thorough
@pytest.mark.parametrize(("method", "place"), CASES)
@pytest.mark.parametrize("without_index", [0, 16])
def test_each_method_finds_its_place_from_everywhere(method, place, without_index):
    edge, direction = EDGES[method]
    home = round(edge) if without_index else index_beyond(edge, direction)
    servo = ready(place, method + without_index)
    servo.write(0x607C, 123)
    start(servo)
    assert servo.word & MASK == 0
    servo.until(ATTAINED, mask=MASK, ms=30_000)
    servo.run(20)
    assert servo.read(0x6062) == 123
    assert servo.read(0x6064) == pytest.approx(123, abs=10)
    assert servo.node.zero_counts == home - 123
    assert servo.position == pytest.approx(home, abs=10)
    assert min(position for _, _, position in servo.trace) > LOW - 300
    assert max(position for _, _, position in servo.trace) < HIGH + 300


@pytest.mark.parametrize(("method", "home"), [(33, 512), (34, 1024)])
def test_the_index_in_a_direction(method, home):
    servo = ready(900, method)
    start(servo)
    servo.until(ATTAINED, mask=MASK)
    assert servo.node.zero_counts == home


@pytest.mark.parametrize("method", [35, 37])
def test_the_present_position_is_home(method):
    servo = ready(-777, method)
    servo.write(0x607C, -50)
    start(servo)
    assert servo.word & MASK == ATTAINED
    assert servo.read(0x6064) == -50
    assert servo.read(0x6063) == -777
    servo.write(0x6060, PP, 1)
    servo.move(1000)
    servo.until(REACHED)
    assert servo.position == pytest.approx(1000 - 777 + 50, abs=3)
    servo.write(0x6060, HOMING, 1)
    assert servo.word & MASK == ATTAINED  # it is homed still


def test_a_slow_search_goes_on_at_its_speed():
    """100 counts/s lead 1e12 counts away in more ns than an integer of 64 bits has."""
    servo = ready(0, 17)
    servo.write(0x6099, 100, 4, 1)
    start(servo)
    servo.run(500)
    assert servo.demand == pytest.approx(-50.0, abs=1.0)
    assert servo.node.homing == homing402._SEARCH


@pytest.mark.parametrize("method", [100, -1, 38, 2_000_000])
def test_a_method_that_none_is_has_no_edge(method):
    """Another one than at the start comes by an RPDO only."""
    servo = ready(0, 17)
    start(servo)
    servo.run(20)
    servo.node.values[slots402.HOMING_METHOD] = method
    servo.run(500)
    assert servo.node.homing == homing402._FAILED  # at the limit switch, from which no method 0 turns


def test_speeds_and_acceleration():
    servo = ready(-1900, 19)
    servo.write(0x6099, 10_000, 4, 1)
    servo.write(0x6099, 500, 4, 2)
    servo.write(0x609A, 100_000)
    start(servo)
    servo.until(ATTAINED, mask=MASK)
    speeds = [speed for _, _, speed in servo.speeds]
    assert max(speeds) == pytest.approx(10_000)
    assert min(speeds) == pytest.approx(-500)
    rises = [
        (b - a) / (after - before) * 1e9
        for (before, _, a), (after, _, b) in zip(servo.speeds, servo.speeds[1:], strict=False)
    ]
    assert max(map(abs, rises)) == pytest.approx(100_000, rel=0.01)


def test_bits_before_the_start():
    servo = ready(0, 17)
    assert servo.word & MASK == REACHED  # not started
    servo.run(50)
    assert servo.position == pytest.approx(0, abs=1)


@pytest.mark.parametrize("word", [ENABLE, ENABLE | HALT, ENABLE | START | HALT])
def test_the_end_of_bit_4_and_halt_interrupt(word):
    servo = ready(0, 17)
    start(servo)
    servo.run(100)
    assert servo.speed == pytest.approx(-8000, rel=0.02)
    servo.control(word)
    servo.run(5)
    assert servo.word & MASK == 0
    servo.run(300)
    assert servo.word & MASK == REACHED
    assert abs(servo.speed) < 1
    assert servo.position > LOW
    servo.control(ENABLE)
    start(servo)
    servo.until(ATTAINED, mask=MASK)
    assert servo.node.zero_counts == LOW


@pytest.mark.parametrize(("method", "place"), [(3, 900), (4, 900), (21, -900), (22, -900), (34, 2060), (33, -2049)])
def test_a_limit_switch_in_the_way_is_an_error(method, place):
    servo = ready(place, method)
    start(servo)
    servo.until(BIT13 | REACHED, mask=MASK)
    assert abs(servo.speed) < 50
    assert servo.node.zero_counts == 0
    assert servo.word & 0x6F == 0x27
    servo.control(ENABLE)
    servo.write(0x6098, 35, 1)
    start(servo)
    assert servo.word & MASK == ATTAINED


def test_an_axis_without_switches_ends_in_a_time_out():
    servo = Servo(HOMING)
    servo.write(0x6098, 18, 1)
    servo.enable()
    start(servo)
    servo.run(1000)
    servo.node.homing_ns = servo.bench.t - 59_990 * MS
    servo.run(5)
    assert servo.word & MASK == 0
    servo.until(BIT13 | REACHED, mask=MASK, ms=300)


@pytest.mark.parametrize(("index", "subindex"), [(0x6099, 1), (0x6099, 2)])
def test_a_speed_of_0_is_an_error(index, subindex):
    servo = ready(0, 17)
    servo.write(index, 0, 4, subindex)
    start(servo)
    assert servo.word & MASK == BIT13 | REACHED


def test_method_0_cannot_be_started_and_unknown_ones_are_refused():
    servo = ready(0, 0)
    start(servo)
    assert servo.word & MASK == BIT13 | REACHED
    for method in (15, 16, 31, 32, 36, 38, -1):
        with pytest.raises(SdoAborted):
            servo.write(0x6098, method, 1)


def test_a_blocked_axis_ends_the_homing_in_a_fault():
    servo = ready(0, 17)
    servo.blocked = True
    start(servo)
    servo.run(1000)
    assert servo.word & 0x4F == 0x08
    assert servo.bench.emcy()[-1][0] == 0x8611


def test_digital_inputs_show_the_switches():
    servo = ready(0, 0)
    for place, bits in (
        (LOW, 1),
        (LOW + 1, 0),
        (FROM - 1, 0),
        (FROM, 4),
        (TO, 4),
        (TO + 1, 0),
        (HIGH - 1, 0),
        (HIGH, 2),
    ):
        servo.node.in_position_counts = int(place)
        assert servo.bench.number(0x60FD) == bits


def test_software_limits_count_from_home():
    servo = ready(5000, 35)
    start(servo)
    servo.write(0x607D, -100, 4, 1)
    servo.write(0x607D, 200, 4, 2)
    servo.write(0x6060, PP, 1)
    servo.control(ENABLE)
    servo.move(1000)
    servo.until(REACHED)
    assert servo.position == pytest.approx(5200, abs=2)
