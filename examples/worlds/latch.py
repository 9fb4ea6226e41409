"""A latch: a spring holds the handle until it is pulled out, with a click; back at 0 it catches again.

python examples/worlds/latch.py           in virtual time: prints when the latch opened and closed
python examples/worlds/latch.py live    on the display of `coulombus run --world --mode active`
"""

import sys

from coulombus import Model, Spring, TorqueProfile, connect, simulate

OPENS_RAD, CLOSES_RAD = 0.15, 0.02
CLICK_NM = (0.3, 0.3, -0.3, -0.3, 0.15, 0.15, -0.15, -0.15)


class Latch:
    """The latch's state between two calls."""

    def __init__(self):
        self.closed, self.events, self.click = True, [], None

    def world(self, state):
        """Return what the handle meets."""
        opens = self.closed and abs(state.x_rad) > OPENS_RAD
        closes = not self.closed and abs(state.x_rad) < CLOSES_RAD
        if opens or closes:
            self.closed = closes
            self.events.append((round(state.t_s, 3), "closed" if closes else "open"))
            self.click = TorqueProfile(CLICK_NM)  # a new object is played
        spring = Spring(0.0, K_Nm_rad=6.0, B_Nms_rad=0.02) if self.closed else None
        return Model(spring=spring, profile=self.click, law=0.0 if self.closed else 0.3)


def in_virtual_time():
    """Let the simulated hand pull; return the events."""
    latch = Latch()
    result = simulate("bench", "active", 13, world=latch.world)
    return latch.events, result.trip


def live():
    """Render on the bus `coulombus:bench` until the host ends."""
    latch = Latch()
    with connect("coulombus:bench") as hand:
        for state in hand:
            hand.render(latch.world(state))


if __name__ == "__main__":
    if "live" in sys.argv:
        live()
    else:
        print("latch", *in_virtual_time())
