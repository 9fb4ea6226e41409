"""A servo drive with an axis of its own: an inertia with viscous and dry friction, limits by switches."""

from __future__ import annotations

import math

from coulombus.eds.reader import Description
from coulombus.node.drive402 import DRIVE402
from node_bench import MS, Bench, description

PP, PV, TQ, HOMING, IP, CSP, CSV, CST = 1, 3, 4, 6, 7, 8, 9, 10
ENABLE = 0x0F
REACHED, LIMIT, BIT12, BIT13 = 0x400, 0x800, 0x1000, 0x2000
PULL = 2000.0  # counts/s^2 for one per mille
STEP_NS = MS // 4


class Servo:
    """A drive with `eds/servo.eds`, OPERATIONAL, and its axis."""

    def __init__(
        self,
        mode: int = PP,
        *,
        position: int = 0,
        knows_load: bool = True,
        eds: Description | None = None,
        step_ns: int = STEP_NS,
        **axis: float,
    ) -> None:
        self.bench = Bench("servo", 5, DRIVE402, eds or description("servo"))
        self.node = self.bench.node
        self.position, self.speed = float(position), 0.0
        self.pull, self.drag = axis.get("pull", PULL), axis.get("drag", 0.5)
        self.dry = axis.get("dry", 20.0)  # per mille
        self.blocked, self.step_ns = False, step_ns
        self.trace: list[tuple[int, float, float]] = []
        """By quarter of a millisecond: time, demand, position."""
        self.speeds: list[tuple[int, float, float]] = []
        """By computation of the drive: time, demand, its speed."""
        self.node.in_position_counts = position
        self.node.load_counts_s2 = self.pull if knows_load else 0.0
        self.bench.power_on()
        self.bench.nmt(1)
        self.write(0x6060, mode, 1)

    def switches(
        self, negative: float = -math.inf, home: tuple[float, float] = (math.inf, math.inf), positive: float = math.inf
    ) -> None:
        self.node.switch_counts[:] = negative, *home, positive

    def enable(self) -> None:
        for word in (0x06, 0x07, ENABLE):
            self.control(word)
        assert self.word & 0x6F == 0x27

    def control(self, word: int) -> None:
        self.bench.write(0x6040, 0, word, 2)

    def write(self, index: int, value: int, size: int = 4, subindex: int = 0) -> None:
        self.bench.write(index, subindex, value, size)

    def read(self, index: int, subindex: int = 0) -> int:
        return self.bench.number(index, subindex, signed=True)

    @property
    def word(self) -> int:
        return self.bench.number(0x6041)

    @property
    def demand(self) -> float:
        return float(self.node.position_demand)

    @property
    def error(self) -> float:
        return self.demand - self.position

    def run(self, ms: float) -> None:
        for _ in range(round(ms * MS / self.step_ns)):
            self._step()

    def until(self, bits: int, *, ms: float = 20_000, mask: int = 0) -> float:
        """Run until these bits of the statusword are set; return the milliseconds."""
        begin = self.bench.t
        while self.word & (mask or bits) != bits:
            assert self.bench.t - begin < ms * MS, (hex(self.word), self.position, self.demand)
            self._step()
        return (self.bench.t - begin) / MS

    def _step(self) -> None:
        dt = self.step_ns * 1e-9
        if self.blocked:
            self.speed = 0.0
        else:
            force = float(self.node.out_torque_pm) - self.drag * self.speed / self.pull
            if self.speed == 0.0 and abs(force) <= self.dry:
                force = 0.0
            else:
                force -= math.copysign(self.dry, self.speed or force)
            speed = self.speed + force * self.pull * dt
            if self.speed * speed < 0.0 and abs(float(self.node.out_torque_pm)) <= self.dry:
                speed = 0.0
            self.position += (self.speed + speed) / 2 * dt
            self.speed = speed
        self.node.in_velocity_counts_s = self.speed
        self.node.in_position_counts = math.floor(self.position + 0.5)
        self.bench.run(self.step_ns)
        self.trace.append((self.bench.t, self.demand, self.position))
        row = int(self.node.demand_ns), self.demand, float(self.node.profile_speed)
        if not self.speeds or row[0] > self.speeds[-1][0]:
            self.speeds.append(row)

    def move(self, target: int, bits: int = 0) -> None:
        """A set-point: 607Ah, and the rising edge of bit 4."""
        self.write(0x607A, target)
        self.control(ENABLE | bits)
        self.control(ENABLE | bits | 0x10)
