"""The drive's modes of operation on a load of its own: speeds, limits, windows, changes of the
mode.
"""

from __future__ import annotations

import pytest

from node_bench import MS, motor

ENABLE = 0x0F
PULL = 7000.0  # counts/s^2 for one per mille, about the bench rig's
PV, TQ, CSV, CST = 3, 4, 9, 10
REACHED, LIMIT, BIT12, SLIPPAGE = 0x400, 0x800, 0x1000, 0x2000


class Loaded:
    """A drive with an inertia and a little friction at its shaft, looked at every 0.5 ms."""

    def __init__(self, mode: int, *, limit: int = 1000, drag: float = 2.0) -> None:
        self.bench = motor(limit=limit)
        self.speed, self.position, self.drag = 0.0, 0.0, drag
        self.torques: list[float] = []
        self.speeds: list[float] = []
        self.bench.write(0x6060, 0, mode, 1)

    def enable(self) -> None:
        for word in (0x06, 0x07, ENABLE):
            self.bench.write(0x6040, 0, word, 2)

    def run(self, ms: float) -> None:
        node, step = self.bench.node, MS // 2
        for _ in range(round(2 * ms)):
            torque = float(node.out_torque_pm)
            self.torques.append(torque)
            self.speed += (torque * PULL - self.drag * self.speed) * step * 1e-9
            self.position += self.speed * step * 1e-9
            self.speeds.append(self.speed)
            node.in_velocity_counts_s = self.speed
            node.in_position_counts = round(self.position)
            self.bench.run(step)

    def write(self, index: int, value: int, size: int = 4, subindex: int = 0) -> None:
        self.bench.write(index, subindex, value, size)

    @property
    def word(self) -> int:
        return self.bench.number(0x6041)

    @property
    def out(self) -> float:
        return float(self.bench.node.out_torque_pm)


def test_6502h_tells_exactly_the_modes_that_6060h_takes():
    bench = motor()
    told = {bit + 1 for bit in range(32) if bench.number(0x6502) >> bit & 1}
    taken = set()
    for mode in range(1, 33):
        answer = bench.request(bytes((0x2F, 0x60, 0x60, 0x00, mode, 0, 0, 0)))
        assert answer[0] in (0x60, 0x80)
        if answer[0] == 0x80:
            assert answer[4:] == bytes.fromhex("30000906")
        else:
            taken.add(mode)
            assert bench.number(0x6061) == mode
    assert told == taken == {PV, TQ, CSV, CST}


def test_profile_velocity_ramps_reaches_and_tells():
    load = Loaded(PV)
    load.write(0x6083, 200_000)
    load.write(0x606D, 500, 2)
    load.write(0x606E, 20, 2)
    load.enable()
    load.run(20)
    assert load.out == 0
    assert load.word & BIT12  # speed 0
    load.write(0x60FF, 50_000)
    load.run(100)
    assert load.bench.number(0x606B, signed=True) == pytest.approx(20_000, abs=300)  # 200000 counts/s^2 for 100 ms
    assert load.speed == pytest.approx(20_000, rel=0.15)
    assert not load.word & (REACHED | BIT12)
    load.run(500)
    assert load.speed == pytest.approx(50_000, rel=0.002)
    assert load.word & (REACHED | BIT12 | LIMIT) == REACHED
    load.write(0x60FF, -10_000)
    assert not load.word & REACHED
    load.run(1000)
    assert load.speed == pytest.approx(-10_000, rel=0.01)
    load.bench.write(0x6040, 0, ENABLE | 0x100, 2)  # halt
    load.run(500)
    assert abs(load.speed) < 50
    assert load.word & (REACHED | BIT12) == REACHED | BIT12


def test_the_window_time_counts_from_the_entry_into_the_window():
    load = Loaded(PV)
    load.write(0x606D, 1000, 2)
    load.write(0x606E, 50, 2)
    load.enable()
    load.write(0x60FF, 3000)
    node, bench = load.bench.node, load.bench
    for ms, inside, expected in ((0, False, False), (10, True, False), (49, True, False), (51, True, True)):
        node.in_velocity_counts_s = 2500.0 if inside else 0.0
        bench.until(bench.t - bench.t % MS + MS)
        if ms == 0:
            assert not load.word & REACHED
            begin = bench.t
            continue
        bench.until(begin + ms * MS)
        assert bool(load.word & REACHED) == expected, ms


def test_the_torque_limits_bound_the_velocity_loop_and_the_integral_does_not_wind_up():
    load = Loaded(PV, limit=30)
    load.write(0x6083, 100_000_000)
    load.enable()
    load.write(0x60FF, 60_000)
    load.run(150)
    assert max(map(abs, load.torques)) == 30
    assert load.word & LIMIT
    load.run(1500)
    assert load.speed == pytest.approx(60_000, rel=0.005)
    assert max(load.speeds) < 63_000
    blocked = Loaded(PV, limit=30)  # the shaft is held for a while, then let go
    blocked.enable()
    blocked.write(0x60FF, 10_000)
    blocked.bench.run(400 * MS)
    assert blocked.out == 30
    blocked.run(1000)
    assert blocked.speed == pytest.approx(10_000, rel=0.01)


def test_slippage_bit_13():
    load = Loaded(PV, limit=5)
    load.write(0x60F8, 20_000)
    load.write(0x6083, 10_000_000)
    load.enable()
    load.write(0x60FF, 100_000)
    load.run(20)
    assert load.word & SLIPPAGE
    load.write(0x60F8, 200_000)
    assert not load.word & SLIPPAGE


def test_cyclic_velocity_follows_at_once_with_its_offset():
    load = Loaded(CSV)
    load.enable()
    load.write(0x60B1, 1000)
    load.write(0x60FF, 4000)
    load.run(1)
    assert load.bench.number(0x606B, signed=True) == 5000
    assert load.word & BIT12
    load.run(500)
    assert load.speed == pytest.approx(5000, rel=0.01)


def test_607fh_bounds_the_target_velocity():
    load = Loaded(PV)
    load.write(0x607F, 8000)
    load.enable()
    load.write(0x60FF, -50_000)
    load.run(800)
    assert load.speed == pytest.approx(-8000, rel=0.01)
    assert load.word & LIMIT


@pytest.mark.parametrize("mode", [TQ, CST])
def test_software_position_limits_cut_what_pushes_further_out(mode):
    load = Loaded(mode)
    load.write(0x607D, -1000, 4, 1)
    load.write(0x607D, 1000, 4, 2)
    load.enable()
    node = load.bench.node
    for position, torque, acts in (
        (0, 50, 50), (999, 50, 50), (1000, 50, 0), (5000, 50, 0), (5000, -50, -50), (-1000, -50, 0), (-1000, 50, 50), (-999, -50, -50),
    ):  # fmt: skip
        node.in_position_counts = position
        load.write(0x6071, torque, 2)
        load.bench.run(2 * MS)
        assert load.out == acts, (position, torque)
        assert bool(load.word & LIMIT) == (acts == 0)


def test_software_position_limits_stop_a_speed():
    load = Loaded(PV)
    load.write(0x607D, 3000, 4, 2)
    load.write(0x6084, 20_000_000)
    load.enable()
    load.write(0x60FF, 20_000)
    load.run(600)
    assert 3000 <= load.position < 4500
    assert abs(load.speed) < 200
    assert load.word & LIMIT
    load.write(0x60FF, -5000)
    load.run(300)
    assert load.speed == pytest.approx(-5000, rel=0.05)


def test_max_motor_speed_cuts_the_torque_in_that_direction():
    load = Loaded(CST)
    load.write(0x6080, 60)  # rpm, of 8192 counts: 8192 counts/s
    load.enable()
    node = load.bench.node
    for speed, torque, acts in ((8000, 100, 100), (8192, 100, 0), (9000, 100, 0), (9000, -100, -100), (-8192, -100, 0)):
        node.in_velocity_counts_s = float(speed)
        load.write(0x6071, torque, 2)
        assert load.out == acts, (speed, torque)
    load.write(0x608F, 16384, 4, 1)
    node.in_velocity_counts_s = -8192.0
    load.write(0x6071, -100, 2)
    assert load.out == -100


def test_max_current_bounds_the_torque():
    load = Loaded(CST)
    load.write(0x6073, 70, 2)
    load.enable()
    load.write(0x6071, -300, 2)
    assert load.out == -70


@pytest.mark.parametrize(
    ("before", "after"), [(a, b) for a in (PV, TQ, CSV, CST) for b in (PV, TQ, CSV, CST, 0) if a != b]
)
def test_a_change_of_the_mode_goes_through_torque_zero_without_a_jump(before, after):
    load = Loaded(before)
    load.enable()
    load.write(0x6071, 200, 2)
    load.write(0x60FF, 30_000)
    load.run(30)
    assert load.out != 0
    begin = load.out
    load.write(0x6087, 10_000)  # 10 per mille a ms
    load.torques.clear()
    load.write(0x6060, after, 1)
    load.run(60)
    assert load.bench.number(0x6061) == after
    steps = [abs(b - a) for a, b in zip([begin, *load.torques], load.torques, strict=False)]
    assert max(steps) <= 10 + 1e-6  # what 6087h allows in 1 ms, the drive's own step
    assert load.out == 0  # until the next set-point ...
    load.write(0x60FF if after in (PV, CSV) else 0x6071, 100, 4 if after in (PV, CSV) else 2)
    load.run(30)
    assert (load.out != 0) == (after != 0)  # ... of the new mode


def test_a_set_point_of_another_mode_does_not_keep_this_one_alive():
    load = Loaded(PV)
    load.write(0x2001, 5000)
    load.enable()
    load.write(0x60FF, 30_000)
    load.run(4)
    assert load.out != 0
    load.write(0x6071, 10, 2)
    load.run(2)
    assert load.out == 0


def test_quick_stop_of_a_speed_uses_6085h_and_ends_without_torque():
    load = Loaded(PV)
    load.write(0x605A, 6, 2)
    load.write(0x6085, 200_000)
    load.enable()
    load.write(0x60FF, 40_000)
    load.run(600)
    load.bench.write(0x6040, 0, 0x02, 2)
    load.run(100)
    assert load.word & 0x6F == 0x07
    assert load.bench.number(0x606B, signed=True) == pytest.approx(20_000, abs=300)
    load.run(110)
    assert load.word & (0x6F | REACHED) == 0x07 | REACHED
    assert load.out == 0
    assert abs(load.speed) < 4000


def test_gains_are_objects():
    outs = []
    for gain in (10_000, 20_000):
        load = Loaded(CSV)
        load.write(0x2010, gain, 4, 1)
        load.write(0x2010, 0, 4, 2)
        load.enable()
        load.write(0x60FF, 1000)
        outs.append(load.out)
    assert outs == [pytest.approx(10), pytest.approx(20)]


def test_a_mode_by_pdo_that_is_not_there_gives_no_torque():
    load = Loaded(CST)
    load.enable()
    load.write(0x6071, 100, 2)
    assert load.out == 100
    load.bench.device[0x6060, 0] = 7  # as an RPDO writes it: past the check
    load.bench.run(2 * MS)
    assert (load.out, load.bench.number(0x6061)) == (0, 0)


@pytest.mark.parametrize("speed", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("mode", [PV, CSV])
@pytest.mark.parametrize("word", [ENABLE, 0x02])
def test_a_speed_that_is_no_number_gives_no_torque(mode, speed, word):
    load = Loaded(mode)
    load.write(0x605A, 6, 2)
    load.enable()
    load.write(0x60FF, 20_000)
    load.run(10)
    assert load.out != 0
    node = load.bench.node
    node.in_velocity_counts_s = speed
    load.bench.write(0x6040, 0, word, 2)
    load.bench.run(2 * MS)
    assert load.out == 0
    node.in_velocity_counts_s = 0.0
    load.run(10)
    assert (load.out != 0) == (word == ENABLE)
