"""A wall of 20 Nm/rad over a slow link: as a local model, and as a stream of torques. Draws a map.

python examples/worlds/stability_map.py                   in virtual time; writes world-stability.png

The hand leans on the wall. A tenth of the messages is lost, and all are late. The host renders a local
model in its own cycle, so neither rate nor delay matters. A stream computes the torque from what it hears,
too late, and feeds the energy of a limit cycle: the hand shakes, or the host trips (NET_WORK).
"""

import random

import numpy as np

from coulombus import LinearField, Model, Wall, load_rig, simulate

WALL = Wall(x_rad=0.05, K_Nm_rad=20.0, B_Nms_rad=0.05)
RATES_HZ = (30, 60, 200, 1000)
DELAYS_MS = (0, 5, 10, 20, 50)
LOST = 0.1
STILL_RAD_S = 0.1
LEAN = (
    'phase=[{kind = "rest", duration_s = 1.0}, {kind = "hold", duration_s = 3.0, push_F_s = 1.0, frequency_Hz = 0.1}]'
)


def local_model(state):
    """Say where the wall is."""
    return Model(wall=WALL, law=0.0, life_s=0.5)


def torque_stream(state):
    """Compute the wall's torque for the state that was heard."""
    depth_rad = state.x_rad - WALL.x_rad
    torque_Nm = -WALL.K_Nm_rad * depth_rad - WALL.B_Nms_rad * state.v_rad_s if depth_rad > 0 else 0.0
    return Model(field=LinearField(Nm=torque_Nm), law=0.0, life_s=0.5)


def shaking(say, rate_Hz, delay_ms, seed=1):
    """Return the velocity of the leaning hand in the last second [rad/s, RMS], and the trip."""
    lottery, on_the_way, velocities = random.Random(seed), [], []

    def world(state):
        velocities.append(state.v_rad_s)
        ms = len(velocities)  # a cycle takes a millisecond
        if ms % round(1000 / rate_Hz) == 0 and lottery.random() >= LOST:
            on_the_way.append((ms + delay_ms, say(state)))
        return on_the_way.pop(0)[1] if on_the_way and on_the_way[0][0] <= ms else None

    result = simulate(load_rig("bench", (LEAN,)), "active", 4.0, world=world)
    return float(np.sqrt(np.mean(np.square(velocities[-1000:])))), result.trip


def in_virtual_time(rates_Hz=RATES_HZ, delays_ms=DELAYS_MS):
    """Return the velocities of both kinds [rad/s], by rate and delay; and in which runs the host tripped."""
    velocities, tripped = {}, {}
    for kind, say in (("local model", local_model), ("torque stream", torque_stream)):
        runs = [[shaking(say, rate, delay) for delay in delays_ms] for rate in rates_Hz]
        velocities[kind] = np.array([[velocity for velocity, _ in row] for row in runs])
        tripped[kind] = np.array([[trip is not None for _, trip in row] for row in runs])
    return velocities, tripped


def table(velocities, tripped, rates_Hz=RATES_HZ, delays_ms=DELAYS_MS):
    """Return the lines of a table: in each cell first the local model, then the torque stream."""
    shown = [np.where(tripped[kind], "trips", np.char.mod("%.3f", cells)) for kind, cells in velocities.items()]
    yield "| messages a second | " + " | ".join(f"{delay} ms" for delay in delays_ms) + " |"
    yield "|---" * (len(delays_ms) + 1) + "|"
    for rate, *row in zip(rates_Hz, *shown, strict=True):
        yield f"| {rate} | " + " | ".join(" / ".join(cell) for cell in zip(*row, strict=True)) + " |"


def draw(maps, path="world-stability.png"):
    """Draw both maps."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    for axes, (title, cells) in zip(figure.subplots(1, 2, sharey=True), maps.items(), strict=True):
        image = axes.imshow(cells, vmin=0.0, vmax=1.0, cmap="OrRd", aspect="auto")
        axes.set(title=title, xlabel="delay of a message [ms]", xticks=range(len(DELAYS_MS)), xticklabels=DELAYS_MS)
        axes.set(yticks=range(len(RATES_HZ)), yticklabels=RATES_HZ)
        for (row, column), value in np.ndenumerate(cells):
            text = "still" if value < STILL_RAD_S else f"{value:.1f}"
            axes.text(column, row, text, ha="center", va="center", color="white" if value > 0.6 else "black")
    figure.axes[0].set_ylabel("messages per second")
    figure.colorbar(image, ax=figure.axes, label="velocity of the hand [rad/s]")
    figure.suptitle("A hand that leans on a wall of 20 Nm/rad, 10 % of the messages lost")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    velocities, tripped = in_virtual_time()
    print("\n".join(table(velocities, tripped)))
    draw(velocities)
