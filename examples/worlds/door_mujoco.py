"""A door with a ball catch, simulated by MuJoCo: `pip install -e '.[worlds]'` or `pip install mujoco`.

python examples/worlds/door_mujoco.py           in virtual time: prints when the door opened and closed
python examples/worlds/door_mujoco.py live    on the display of `coulombus run --world --mode active`

The measured angle of the handle is the angle of the door. MuJoCo makes one step for each state, and says
what the door touches. From this the display gets a local model, which its own cycle renders: friction of
the hinge, a wall at the stop of the frame, and a spring for the catch.
"""

import sys
from typing import NamedTuple

from coulombus import LinearField, Model, Spring, Wall, connect, simulate

SCENE = """
<mujoco model="door">
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 0"/>
  <default><geom condim="1" solref="0.004 1"/></default>
  <worldbody>
    <geom name="stop" type="box" pos="0.09 -0.06 0" size="0.03 0.05 0.1" margin="0.01" solref="-1500 -20" priority="1"/>
    <geom name="bump" type="sphere" pos="0.179187 0.065409 0" size="0.03"/>
    <body name="door">
      <joint name="hinge" axis="0 0 1" frictionloss="0.3" damping="0.01"/>
      <geom name="panel" type="box" pos="0.06 0 0" size="0.06 0.01 0.1" mass="1"/>
      <body name="ball" pos="0.15 0 0">
        <joint name="ball" type="slide" axis="1 0 0" stiffness="500" damping="2" range="-0.03 0" solreflimit="0.004 1"/>
        <geom name="ball" type="sphere" size="0.03" mass="0.02"/>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="door" body2="ball"/></contact>
</mujoco>
"""
OPEN_RAD, CLOSED_RAD = 0.7, 0.05
LEAST_K_NM_RAD = 0.5


class Stop(NamedTuple):
    """A contact of the door with the frame."""

    gap_m: float  # from the door to the frame, negative inside it
    lever_m: float  # torque about the hinge by a force of 1 N; positive: it opens the door
    K_Nm_rad: float
    B_Nms_rad: float


class Catch(NamedTuple):
    """A contact of the ball with the bump of the frame."""

    push_N: float  # of the ball's spring
    K_N_m: float  # of the ball's spring
    slope_m_rad: float  # way of the ball by angle; positive: the push opens the door


def model_of(x_rad, friction_Nm, damping_Nms_rad, stop=None, catch=None):
    """Return the local model at an angle of the door."""
    wall = spring = None
    if stop is not None:
        side = "below" if stop.lever_m > 0 else "above"
        wall = Wall(x_rad - stop.gap_m / stop.lever_m, stop.K_Nm_rad, stop.B_Nms_rad, side)
    if catch is not None:
        K_Nm_rad = max(catch.K_N_m * catch.slope_m_rad**2, LEAST_K_NM_RAD)
        spring = Spring(x_rad + catch.push_N * catch.slope_m_rad / K_Nm_rad, K_Nm_rad)
    levels = {"F_s_Nm": friction_Nm, "F_d_Nm": friction_Nm}  # MuJoCo has one level for both
    return Model(wall=wall, spring=spring, field=LinearField(Nms_rad=-damping_Nms_rad), parameters=levels)


class Door:
    """MuJoCo's door; the handle turns it."""

    def __init__(self):
        import mujoco

        self.step = mujoco.mj_step
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)
        self.is_open, self.events, self.start_s = False, [], None

    def world(self, state):
        """Turn the door to the handle's angle, go on to the state's time, and return what the handle meets."""
        self.start_s = state.t_s if self.start_s is None else self.start_s
        while self.data.time <= state.t_s - self.start_s:
            self.data.joint("hinge").qpos, self.data.joint("hinge").qvel = state.x_rad, state.v_rad_s
            self.step(self.model, self.data)
        opens = not self.is_open and state.x_rad > OPEN_RAD
        closes = self.is_open and state.x_rad < CLOSED_RAD
        if opens or closes:
            self.is_open = opens
            self.events.append((round(state.t_s, 3), "open" if opens else "closed"))
        hinge = self.model.joint("hinge")
        stop, catch = self.contacts()
        return model_of(state.x_rad, float(hinge.frictionloss[0]), float(hinge.damping[0]), stop, catch)

    def contacts(self):
        """Return what the last step says of the stop and of the catch; None: no contact."""
        stops, catches = [], []
        for contact in self.data.contact:
            names = [self.model.geom(number).name for number in contact.geom]
            moved = next((name for name in names if name in ("panel", "ball")), None)
            x, y = contact.pos[:2]
            nx, ny = contact.frame[:2] if names[1] == moved else -contact.frame[:2]  # into the part that moves
            lever_m = float(x * ny - y * nx)
            if set(names) == {"panel", "stop"}:
                stops.append(self.stop(contact, lever_m))
            elif set(names) == {"ball", "bump"}:
                catches.append(self.catch(-float(self.data.joint("ball").xaxis[:2] @ (nx, ny)), lever_m))
        return min(stops, default=None), catches[0] if catches else None

    def stop(self, contact, lever_m):
        """Return a contact with the stop. A negative solref is -K and -B by inertia; solimp is taken as 1."""
        inertia = float(self.model.joint("hinge").M0[0])
        K_Nm_rad, B_Nms_rad = (-inertia * float(value) for value in contact.solref)
        return Stop(float(contact.dist), lever_m, K_Nm_rad, B_Nms_rad)

    def catch(self, share, lever_m):
        """Return the contact of the ball, whose axis has a share of the contact's normal."""
        K_N_m = float(self.model.joint("ball").stiffness[0])
        return Catch(max(-K_N_m * float(self.data.joint("ball").qpos[0]), 0.0), K_N_m, lever_m / share)


def in_virtual_time():
    """Let the simulated hand push and pull; return the events."""
    door = Door()
    result = simulate("bench", "active", 13, world=door.world)
    return door.events, result.trip


def live():
    """Render on the bus `coulombus:bench` until the host ends."""
    door = Door()
    with connect("coulombus:bench") as hand:
        for state in hand:
            if state.sequence == hand.state.sequence:  # a late program leaves out old states
                hand.render(door.world(state))


if __name__ == "__main__":
    if "live" in sys.argv:
        live()
    else:
        print("door", *in_virtual_time())
