"""Run the bench rig in one mode, read its recording, print the figures.

With --png draw torque and velocity.

python examples/simulate_and_plot.py --mode active --png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from coulombus import read, simulate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mode", choices=("active", "passive", "hybrid"), default="hybrid")
    parser.add_argument("--seconds", type=float, default=13.0)
    parser.add_argument("--out", type=Path, default=Path("."), help="directory of the recording and the picture")
    parser.add_argument("--png", action="store_true", help="draw the run")
    options = parser.parse_args()

    path = options.out / f"{options.mode}.pcapng"
    result = simulate("bench", options.mode, options.seconds, record=path, force=True)
    print(f"{result.cycles} cycles, {result.lost_pdos} PDOs lost, trip: {result.trip}")
    print(f"hold: {result.hold_counts_p2p} counts peak to peak, {result.torque_flips_per_s:.1f} torque flips a second")

    recording = read(path)
    for time, text in recording.markers:
        print(f"{time:9.3f} s  {text}")
    for name in ("motor.position_rad", "motor.target_torque_Nm", "brake.setpoint_Nm", "brake.handle_torque_Nm"):
        signal = recording[name]
        print(f"{name:24} {np.min(signal.values):8.3f} to {np.max(signal.values):7.3f} {signal.unit}")

    if options.png:
        from coulombus.lab.demo.traces import figure_14

        picture = path.with_suffix(".png")
        figure_14({options.mode: (options.mode, recording)}, picture)
        print(f"wrote {picture}")


if __name__ == "__main__":
    main()
