"""Which walls are displayed in full? Finds the stiffest wall that keeps a hand still, over the wall's damping.

python examples/worlds/z_width.py                         in virtual time; writes world-z-width.png

The hand leans on the wall and taps on it. A wall is displayed in full if the handle is still afterwards and nothing
of the stiffness is withheld (`state.softened`). Beside it are two computations of a motor alone, without what the
cycle does: the sampled loop's eigenvalues, and the bound of Colgate and Schenkel, b > K (T / 2 + delay) + B, with
the hand's damping in b (J. Robotic Systems 14(1), 1997).
"""

import numpy as np
from scipy.linalg import expm

from coulombus import Model, Wall, load_rig, simulate

MODES = {"active": 1.2, "hybrid": 3.5, "passive": 3.5}
"""F_s of the rig in each mode [Nm]: the hand's push is a share of it."""
STIFFNESS_NM_RAD = np.geomspace(10.0, 1e4, 19)
DAMPING_NMS_RAD = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5)
PUSH_NM, STILL_RAD_S = 0.72, 0.05
LEAN = (
    'phase=[{{kind = "rest", duration_s = 1.0}}, {{kind = "hold", duration_s = 4.0, push_F_s = {share}, '
    "frequency_Hz = 0.1, taps_s = [0.6, 2.1], tap_Nm = 0.6, tap_s = 0.01}}]"
)
INERTIA_KG_M2, HELD_NMS_RAD, HELD_NM_RAD, LAG_S, T_S = 3e-3, 0.105, 5.0, 1e-3, 1e-3
"""Of hand and handle together, of the drive, and the period."""
DELAY_S = 2.5 * T_S
"""From the position to the middle of its torque's effect."""


def in_full(mode, K_Nm_rad, B_Nms_rad):
    """Return whether a wall is displayed in full, and the hand is still on it."""
    seen = []

    def world(state):
        seen.append((state.v_rad_s, state.softened))
        return Model(wall=Wall(0.02, K_Nm_rad=K_Nm_rad, B_Nms_rad=B_Nms_rad), law=0.0)

    result = simulate(load_rig("bench", (LEAN.format(share=PUSH_NM / MODES[mode]),)), mode, 5.0, world=world)
    v_rad_s, softened = np.array(seen[-1000:]).T
    return result.trip is None and softened[-1] == 0.0 and np.sqrt(np.mean(v_rad_s**2)) < STILL_RAD_S


def stable(K_Nm_rad, B_Nms_rad):
    """Return whether the sampled loop of a motor alone is stable: its command acts from the next SYNC on."""
    A = np.zeros((4, 4))  # speed, angle, motor's torque, command
    A[0] = -HELD_NMS_RAD / INERTIA_KG_M2, -HELD_NM_RAD / INERTIA_KG_M2, 1.0 / INERTIA_KG_M2, 0.0
    A[1, 0], A[2, 2:] = 1.0, (-1.0 / LAG_S, 1.0 / LAG_S)
    held = expm(A * T_S)
    step = np.zeros((5, 5))  # the last sample of the angle, too: the speed is a difference
    step[:3, :4], step[4, 1] = held[:3], 1.0
    step[3, 1], step[3, 4] = -K_Nm_rad - B_Nms_rad / T_S, B_Nms_rad / T_S
    return np.abs(np.linalg.eigvals(step)).max() < 1.0


def largest_that_holds(holds, values=STIFFNESS_NM_RAD):
    """Return the largest of rising values that holds, if those below do, too; 0 if none does."""
    low, high = -1, len(values)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if holds(values[middle]) else (low, middle)
    return values[low] if low >= 0 else 0.0


def widths(mode, damping=DAMPING_NMS_RAD):
    """Return the stiffest wall [Nm/rad] that a mode displays in full, for each damping."""
    return [largest_that_holds(lambda K, B=B: in_full(mode, K, B)) for B in damping]


def draw(measured, path="world-z-width.png"):
    """Draw what each mode displays in full, and both computations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4.2), layout="constrained")
    axes = figure.subplots()
    for mode, marker in zip(measured, "os^", strict=True):
        axes.semilogy(DAMPING_NMS_RAD, measured[mode], marker=marker, label=mode)
    fine, stiff = np.linspace(0.0, 0.5, 101), np.geomspace(1.0, 1e4, 400)
    alone = np.array([largest_that_holds(lambda K, B=B: stable(K, B), stiff) for B in fine])
    axes.semilogy(fine, np.where(alone > 0.0, alone, np.nan), "0.4", label="motor alone, eigenvalues")
    colgate = (HELD_NMS_RAD - fine) / DELAY_S
    axes.semilogy(
        fine, np.where(colgate > 1.0, colgate, np.nan), "0.6", linestyle=":", label="motor alone, bound of Colgate"
    )
    axes.set(xlabel="damping of the wall [Nms/rad]", ylabel="stiffest wall that is displayed in full [Nm/rad]")
    axes.legend()
    figure.savefig(path, dpi=120)
    print(f"wrote {path}")


if __name__ == "__main__":
    all_widths = {mode: widths(mode) for mode in MODES}
    alone = [largest_that_holds(lambda K, B=B: stable(K, B), np.geomspace(1.0, 1e4, 400)) for B in DAMPING_NMS_RAD]
    print("| damping | " + " | ".join(MODES) + " | motor alone, eigenvalues |\n" + "|---" * 5 + "|")
    for k, B in enumerate(DAMPING_NMS_RAD):
        print(f"| {B:g} | " + " | ".join(f"{all_widths[mode][k]:.0f}" for mode in MODES) + f" | {alone[k]:.0f} |")
    draw(all_widths)
