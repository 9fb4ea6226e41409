"""A wall at 0.3 rad, and less friction on this side of it than the rig's law has.

python examples/worlds/wall_with_friction.py           in virtual time: prints the largest depth
python examples/worlds/wall_with_friction.py live    on the display of `coulombus run --world`
"""

import sys

from coulombus import Model, Wall, connect, simulate

WALL = Wall(x_rad=0.3, K_Nm_rad=8.0, B_Nms_rad=0.05)
PARAMETERS = {"F_s_Nm": 1.0, "F_d_Nm": 0.8}


def world(state):
    """Return the wall, and the friction before it; within the wall there is none."""
    return Model(wall=WALL, law=0.0 if state.x_rad > WALL.x_rad else 1.0, parameters=PARAMETERS)


def in_virtual_time():
    """Let the simulated hand push; return the largest depth [rad] and the largest torque of the brake [Nm]."""
    depths, torques = [0.0], [0.0]

    def watched(state):
        depths.append(state.x_rad - WALL.x_rad)
        torques.append(state.world_brake_Nm)
        return world(state)

    result = simulate("bench", "hybrid", 8, world=watched)
    return max(depths), max(torques), result.trip


def live():
    """Render on the bus `coulombus:bench` until the host ends."""
    with connect("coulombus:bench") as hand:
        for state in hand:
            hand.render(world(state))


if __name__ == "__main__":
    if "live" in sys.argv:
        live()
    else:
        print("depth, brake torque", *in_virtual_time())
