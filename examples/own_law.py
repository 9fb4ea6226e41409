"""A friction law of one's own: Stribeck friction, which falls from F_s to F_d as the handle gets
faster.

    python examples/own_law.py

The command line runs the same law: coulombus simulate --set
law.function=$PWD/examples/own_law.py:stribeck --set law.user=[0.5]
"""

from __future__ import annotations

import math
from pathlib import Path

from coulombus import read, simulate


def stribeck(motion, law, state):
    """Return the friction at the present speed [Nm]; law.user[0] is the Stribeck speed [rad/s]."""
    level = law.F_d + (law.F_s - law.F_d) * math.exp(-((motion.v_rad_s / law.user[0]) ** 2))
    state.brake_Nm = level  # the brake bears this much in both directions, at rest as well
    if abs(motion.v_counts) <= law.velocity_band_counts:
        return 0.0  # at rest the motor shows nothing: it would chatter
    return math.copysign(level, motion.v_rad_s)


def main() -> None:
    here = Path(__file__).resolve()
    path = Path("own_law.pcapng")
    overrides = (f"law.function={here}:stribeck", "law.user=[0.5]", "mode.hybrid.F_d_Nm=1.5")
    result = simulate("bench", "hybrid", 13.0, record=path, overrides=overrides, force=True)
    print(f"trip: {result.trip}; hold: {result.hold_counts_p2p} counts peak to peak")

    recording = read(path)
    when = {text: time for time, text in recording.markers}
    setpoint = recording["brake.setpoint_Nm"]
    stroke = (setpoint.t_s > when["phase stroke"]) & (setpoint.t_s < when["phase end"])
    values = setpoint.values[stroke]
    print(f"stroke: the brake was told {values.min():.2f} to {values.max():.2f} Nm")


if __name__ == "__main__":
    main()
