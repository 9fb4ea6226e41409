"""How stiff may a wall be? Sends walls of 1 to 10,000 Nm/rad and draws the stiffness that the hand feels.

python examples/worlds/stiffness.py                       in virtual time; writes world-stiffness.png

The hand taps on the wall, leans on it, and pushes harder for two seconds. The stiffness that it feels is the
torque that it adds by the way that it makes, which is at least a count of the encoder.
"""

import numpy as np

from coulombus import Model, Wall, load_rig, simulate

WALLS_NM_RAD = np.geomspace(1.0, 1e4, 13)
MODES = {"active": 1.2, "hybrid": 3.5, "passive": 3.5}
"""F_s of the rig in each mode [Nm]: the hand's pushes are shares of it."""
PUSH_NM = 0.9
LEAN = (
    'phase=[{{kind = "rest", duration_s = 1.0}}, {{kind = "hold", duration_s = 5.0, push_F_s = {share}, '
    "frequency_Hz = 0.05, taps_s = [0.6, 1.6], tap_Nm = 0.6, tap_s = 0.01}}]"
)
COUNT_RAD = 2.0 * np.pi / (8192 * 9.587)
DELAY_S, DAMPING_NMS_RAD = 2.5e-3, 0.105
"""From the position to the middle of its torque's effect; of hand and handle."""


def felt(mode, K_Nm_rad):
    """Return the stiffness that the hand feels [Nm/rad], the share that is withheld, and the trip."""
    seen = []

    def world(state):
        seen.append((state.x_rad, state.handle_Nm, state.softened))
        return Model(wall=Wall(0.02, K_Nm_rad=K_Nm_rad), law=0.0)

    rig = load_rig("bench", (LEAN.format(share=PUSH_NM / MODES[mode]),))
    result = simulate(rig, mode, 5.0, world=world)
    x_rad, hand_Nm, softened = np.array(seen[-2000:]).T
    first, last = slice(0, 100), slice(-100, None)
    way_rad = max(x_rad[last].mean() - x_rad[first].mean(), COUNT_RAD)
    return (hand_Nm[last].mean() - hand_Nm[first].mean()) / way_rad, softened[-1], result.trip


def draw(runs, path="world-stiffness.png"):
    """Draw what is felt over what is sent."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4.2), layout="constrained")
    axes = figure.subplots()
    for mode, marker in zip(MODES, "os^", strict=True):
        axes.loglog(WALLS_NM_RAD, [stiffness for stiffness, _, _ in runs[mode]], marker=marker, label=mode)
    axes.loglog(WALLS_NM_RAD, WALLS_NM_RAD, color="0.6", linestyle="--", linewidth=1.0, label="as sent")
    axes.axvline(DAMPING_NMS_RAD / DELAY_S, color="0.6", linestyle=":", label="most of a motor without the remedies")
    axes.set(xlabel="stiffness that is sent [Nm/rad]", ylabel="stiffness that is felt [Nm/rad]")
    axes.legend()
    figure.savefig(path, dpi=120)
    print(f"wrote {path}")


if __name__ == "__main__":
    all_runs = {mode: [felt(mode, stiffness) for stiffness in WALLS_NM_RAD] for mode in MODES}
    print("| sent | " + " | ".join(MODES) + " |\n" + "|---" * 4 + "|")
    for k, stiffness in enumerate(WALLS_NM_RAD):
        cells = (f"{all_runs[mode][k][0]:.4g}" + (" trips" if all_runs[mode][k][2] else "") for mode in MODES)
        print(f"| {stiffness:.4g} | " + " | ".join(cells) + " |")
    draw(all_runs)
