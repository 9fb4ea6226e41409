"""A wheel with detents: a spring to the nearest of them, ten on a turn.

python examples/worlds/detent_wheel.py           in virtual time: prints which detents were met
python examples/worlds/detent_wheel.py live    on the display of `coulombus run --world --mode active`
"""

import math
import sys

from coulombus import Model, Spring, connect, simulate

PITCH_RAD = 2.0 * math.pi / 10


def detent(state):
    """Return the number of the nearest detent."""
    return round(state.x_rad / PITCH_RAD)


def world(state):
    """Return a spring to the nearest detent, without friction."""
    return Model(spring=Spring(detent(state) * PITCH_RAD, K_Nm_rad=3.0, B_Nms_rad=0.02, most_Nm=1.0), law=0.0)


def in_virtual_time():
    """Turn the wheel by the simulated hand; return the detents in the order in which they were met."""
    met = []

    def watched(state):
        if not met or met[-1] != detent(state):
            met.append(detent(state))
        return world(state)

    result = simulate("bench", "active", 8, world=watched)
    return met, result.trip


def live():
    """Render on the bus `coulombus:bench` until the host ends."""
    with connect("coulombus:bench") as hand:
        for state in hand:
            hand.render(world(state))


if __name__ == "__main__":
    if "live" in sys.argv:
        live()
    else:
        print("detents", *in_virtual_time())
