"""Let go of a hand that leans on the brake: at once, and as the safe state does it.

python examples/release.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from coulombus import read, simulate

Floats = npt.NDArray[np.float64]
AT_ONCE = ("limits.safe_ramp_s=0.0", "limits.safe_hold_s=0.0")
BEFORE_S = 0.1


class Release(NamedTuple):
    """The end of a run against the time since the safe state began [s]; [Nm], [rad/s]."""

    t_s: Floats
    load_Nm: Floats
    brake_Nm: Floats
    speed_rad_s: Floats


def release(folder: Path, overrides: tuple[str, ...] = ()) -> Release:
    """Simulate mode hybrid for 13 s, at whose end the hand leans on the brake."""
    record, truth = folder / "run.pcapng", folder / "truth.npz"
    simulate("bench", "hybrid", 13.0, record=record, truth=truth, overrides=overrides, force=True)
    safe_s = next(time for time, text in read(record).markers if text.startswith("safe"))
    with np.load(truth) as columns:
        part = columns["t_s"] >= safe_s - BEFORE_S
        t_s, load, brake, speed = (columns[name][part] for name in ("t_s", "operator_Nm", "brake_Nm", "speed_rad_s"))
    return Release(t_s - safe_s, load, brake, speed)


def draw(torque: Axes, speed: Axes, shown: Release) -> None:
    """Draw load and brake above, the handle's speed below."""
    torque.plot(shown.t_s, np.abs(shown.load_Nm), label="the hand's load")
    torque.plot(shown.t_s, np.abs(shown.brake_Nm), label="the brake")
    speed.plot(shown.t_s, np.abs(shown.speed_rad_s), color="tab:red")
    speed.axhline(1.2, color="grey", linestyle=":")
    speed.set_xlabel("time since the end of the run [s]")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        at_once, gently = release(Path(folder), AT_ONCE), release(Path(folder))
    figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharex=True, sharey="row", layout="constrained")
    for column, (title, shown) in enumerate((("let go at once", at_once), ("released", gently))):
        draw(axes[0, column], axes[1, column], shown)
        axes[0, column].set_title(f"{title}: at most {np.abs(shown.speed_rad_s).max():.2f} rad/s")
    axes[0, 0].set_ylabel("torque [Nm]")
    axes[1, 0].set_ylabel("handle's speed [rad/s]")
    axes[0, 1].legend()
    figure.savefig("release.png", dpi=110)
    print(
        f"at once: {np.abs(at_once.speed_rad_s).max():.2f} rad/s; released: {np.abs(gently.speed_rad_s).max():.2f} rad/s"
    )
    print("wrote release.png")


if __name__ == "__main__":
    main()
