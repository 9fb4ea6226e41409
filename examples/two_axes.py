"""Two independent axes on one bus: run them, and compare what each hand felt."""

from pathlib import Path

from coulombus import read, simulate

out = Path("out")
out.mkdir(exist_ok=True)
result = simulate("two_axes", mode="hybrid", seconds=6.0, record=out / "two_axes.pcapng", force=True)
for recording in read(out / "two_axes.pcapng").axes:  # one recording for each axis, with the signals' plain names
    held = recording["brake.setpoint_Nm"].values.max()
    push = abs(recording["brake.handle_torque_Nm"].values).max()
    print(
        f"node {recording.rig.one_axis().motor.node_id}: the brake held up to {held:.2f} Nm, the hand pushed up to {push:.2f} Nm"
    )
for name, axis in result.axes.items():
    print(f"{name}: moved {axis['hold_counts_p2p']} counts while it was held, sign check {axis['sign_check']}")
