"""A servo drive in every kind of mode, in virtual time, beside the profile that its objects describe.

python examples/servo_motions.py FILE.eds      writes servo-motions.png

The drive stands alone: it turns an inertia with friction (docs/devices.md). `canopen` writes its objects.
"""

import math
import sys
from pathlib import Path

import numpy as np

from coulombus.recording.pictures.style import BLUE, VERMILION, figure, label
from coulombus.sim_bus.server.live_nodes import LiveNodes

EDS = Path(sys.argv[1]) if __name__ == "__main__" and len(sys.argv) > 1 else None
NODE_ID = 5
ENABLE, START, NOW = 0x0F, 0x10, 0x20
SPEED, UP, DOWN = 40_000, 200_000, 100_000


class Servo:
    """The drive, enabled in a mode, and its course."""

    def __init__(self, eds, mode):
        self.network = LiveNodes(((eds, NODE_ID),)).make_world(1_000_000, True)
        self.network.power_on()
        self.network.wait_ns(10_000_000)
        self.node = self.network.canopen().add_node(NODE_ID, str(eds))
        self.node.nmt.state = "OPERATIONAL"
        self.write({0x6060: mode, 0x6081: SPEED, 0x6083: UP, 0x6084: DOWN})
        for word in (6, 7, ENABLE):
            self.node.sdo[0x6040].raw = word
        self.rows, self.begin_ns = [], self.network.t_ns

    def write(self, values):
        for index, value in values.items():
            self.node.sdo[index].raw = value

    def run(self, seconds, index=0x6064):
        """Let time pass; store time, and the object's value, each ms or so."""
        until = self.network.t_ns + round(seconds * 1e9)
        while self.network.t_ns < until:
            self.network.wait_ns(1_000_000)
            self.rows.append(((self.network.t_ns - self.begin_ns) * 1e-9, self.node.sdo[index].raw))

    def course(self):
        return np.array(self.rows).T


def trapezoid(t, distance):
    """The position at `t` of a move from rest to rest: s = v^2 / 2 up at first, and so on."""
    up, down = SPEED / UP, SPEED / DOWN
    even = abs(distance) / SPEED - (up + down) / 2
    t = np.clip(t, 0.0, up + even + down)
    rising, falling = np.minimum(t, up), np.maximum(t - up - even, 0.0)
    way = UP * rising**2 / 2 + SPEED * np.clip(t - up, 0.0, even + down) - DOWN * falling**2 / 2
    return math.copysign(1.0, distance) * way


def positions(eds):
    servo = Servo(eds, 1)
    expected = []
    for start, target in ((0, 30_000), (30_000, -10_000)):
        begin_s = (servo.network.t_ns - servo.begin_ns) * 1e-9
        servo.write({0x607A: target})
        servo.write({0x6040: ENABLE | START | NOW})
        servo.run(1.9)
        servo.write({0x6040: ENABLE})
        t = servo.course()[0]
        expected.append(start + trapezoid(t[t >= begin_s] - begin_s, target - start))
    return (*servo.course(), np.concatenate(expected))


def speeds(eds):
    servo = Servo(eds, 3)
    expected, speed = [], 0.0
    for target in (SPEED, -SPEED // 2, 0):
        begin = len(servo.rows)
        servo.write({0x60FF: target})
        servo.run(0.9, 0x606C)
        t = servo.course()[0][begin:]
        for dt in np.diff(t, prepend=t[0]):
            faster = speed == 0 or (speed * target > 0 and abs(target) > abs(speed))
            step = (UP if faster else DOWN) * dt
            goal = target if speed * target >= 0 else 0.0
            speed = min(speed + step, goal) if goal >= speed else max(speed - step, goal)
            expected.append(speed)
    return (*servo.course(), np.array(expected))


def home(eds):
    servo = Servo(eds, 6)
    servo.write({0x6098: 17})
    servo.write({0x6040: ENABLE | START})
    servo.run(3.0, 0x6063)
    return (*servo.course(), None)


def sine(eds):
    servo = Servo(eds, 8)
    expected = []
    for step in range(300):
        expected.append(8000 * math.sin(2 * math.pi * step * 0.005))
        servo.write({0x607A: round(expected[-1])})
        servo.run(0.005)
    t, x = servo.course()
    return t, x, np.interp(t, np.linspace(0, t[-1], len(expected)), expected)


MOTIONS = {
    "Profile position (1)": (positions, "6064h, counts"),
    "Profile velocity (3)": (speeds, "606Ch, counts/s"),
    "Homing (6), method 17": (home, "6063h, counts"),
    "Cyclic synchronous position (8)": (sine, "6064h, counts"),
}


def draw(motions, path="servo-motions.png"):
    with figure(10, 6.5, 2, 2) as (made, axes):
        for panel, (title, (t, x, expected)) in zip(axes.flat, motions.items(), strict=True):
            if expected is not None:
                panel.plot(t, expected, color=VERMILION, linewidth=3, alpha=0.5, label="profile")
            panel.plot(t, x, color=BLUE, linewidth=1, label="drive")
            label(panel, "time, s", MOTIONS[title][1], title)
            panel.legend()
        made.savefig(path, metadata={"Software": None})


if __name__ == "__main__":
    drawn = {title: motion(EDS) for title, (motion, _) in MOTIONS.items()}
    draw(drawn)
    for title, (_, x, expected) in drawn.items():
        if expected is not None:
            print(f"{title}: largest difference {np.abs(x - expected).max():.0f}")
