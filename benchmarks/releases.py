"""How fast a loaded hand is let go, by end, mode and rig: the table of docs/safety.md, from simulated runs.

In each run a hand pushes slowly and rests, and bears a share of F_s when the display ends. The figure is the handle's
largest speed behind the marker of the end, over 10 ms, on the failed axis; that of further axes is their encoder's.

    python -m benchmarks releases                  # the table
    python -m benchmarks releases --ends 100       # as many random ends and trips in each mode
"""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coulombus import read, simulate
from coulombus.kernels.records import Floats
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.script import read_script

__all__ = ["ENDS", "RIGS", "Ended", "ended", "random_ends", "releases", "table"]

WINDOW_S = 0.01


class End(NamedTuple):
    """An end of a display: the fault file or the script that leads to it; neither: the run's own end."""

    faults: str = ""
    script: str = ""

    def files(self, at_s: float, axis: str) -> tuple[str, str]:
        """Return the texts of both files for a time after enabling and the first of several axes."""
        node = f'node = "{axis}.' if axis else 'node = "'
        faults, script = (
            text.replace("= AT", f'= {at_s}\nafter = "enabled"').replace('node = "', node) for text in self
        )
        return faults, script


def _lost(frame: str, node: int) -> End:
    """Return the end when the host no longer receives a node's frames of a kind."""
    on = f'on = {{frame = "{frame}", node = {node}, every = 1}}'
    return End(f'[[fault]]\nkind = "drop"\nat_s = AT\n{on}\nlost_for = "host"\n')


def _sent(can_id: int, data: str, lasts_s: float) -> End:
    """Return the end when the brake sends a frame that is not its own, each millisecond."""
    frame = f'node = "brake"\ncan_id = {can_id}\ndata = "{data}"'
    return End(f'[[fault]]\nkind = "babble"\nat_s = AT\n{frame}\nperiod_us = 1000\nduration_s = {lasts_s}\n')


def _done(node: str, action: str, more: str = "") -> End:
    """Return the end by an action of a script."""
    return End(script=f'[[at]]\nt_s = AT\nnode = "{node}"\naction = "{action}"\n{more}\n')


def _failed(node: str, fault: str) -> End:
    """Return the end by a fault of a device."""
    return _done(node, "fault", f'fault = "{fault}"')


ENDS: Mapping[str, End] = {
    "orderly end": End(),
    "motor: EMCY, over-current": _failed("motor", "over_current"),
    "motor: EMCY, encoder lost": _failed("motor", "encoder_lost"),
    "motor: supply lost": _failed("motor", "supply_low"),
    "motor: all power lost": _done("motor", "power_off"),
    "motor: TPDO lost": _lost("TPDO1", 1),
    "motor: heartbeat lost": _lost("HEARTBEAT", 1),
    "motor: NMT stop by another node": _sent(0, "02 01", 0.0005),
    "another node commands 1.5 Nm": _sent(0x201, "0F 00 65 03", 0.1),
    "brake: TPDO lost": _lost("TPDO1", 2),
    "brake: EMCY, coil open": _failed("brake", "coil_open"),
    "brake: all power lost": _done("brake", "power_off"),
}
"""Ends by what leads to them. Each trip that no device's fault leads to ends as `another node commands` does, without its torque."""

MODES = ("active", "passive", "hybrid")
LAGS = ("plant.brake_fluid_lag_s=0.04", "brake.coil_lag_s=0.003")
RIGS: Mapping[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "bench": ("bench", (), MODES),
    "two axes": ("two_axes", (), MODES),
    "paper": ("paper", (), MODES),
    "plane": ("plane", (), MODES),
    "slow brake, 40 ms": ("bench", (*LAGS, "brake.fluid_lag_s=0.04"), MODES),
    "brake of 0.6 Nm": ("bench", ("limits.brake_torque_Nm=0.6",), ("active",)),
    "backlash of 20 mrad": (
        "bench",
        (
            "plant.cable.stiffness_Nm_rad=200",
            "plant.cable.damping_Nms_rad=0.05",
            "plant.cable.backlash_rad=0.02",
            "plant.cable.motor_inertia_kg_m2=1e-3",
        ),
        MODES,
    ),
}
"""Packaged rig, overrides, and modes, by name."""


class Ended(NamedTuple):
    """A run's end: the marker, the handle's largest speed behind it, and the brake's largest set-point there."""

    marker: str
    speed_rad_s: float
    setpoint_Nm: float


def ended(
    rig: str, mode: str, end: End, push: float, seconds: float, overrides: tuple[str, ...] = (), seed: int = 0
) -> Ended:
    """Simulate a display of a hand that pushes `push` times F_s, and its end after `seconds`."""
    packaged_rig = load_rig(rig)
    kind = "tip_hold" if packaged_rig.kinematics else "hold"
    phase = f'phase=[{{kind = "rest", duration_s = 1.0}}, {{kind = "{kind}", duration_s = 60.0, push_F_s = {push}, frequency_Hz = 0.1}}]'
    axis, nodes = next(iter(packaged_rig.axis_names), ""), [node.name for node in packaged_rig.nodes]
    faults, script = end.files(seconds, axis)
    with tempfile.TemporaryDirectory() as folder:
        path, truth, fault_file, script_file = (
            Path(folder, name) for name in ("run.pcapng", "truth.npz", "faults.toml", "script.toml")
        )
        fault_file.write_text(faults)
        script_file.write_text(script)
        simulate(
            rig,
            mode,
            seconds + (2.5 if faults or script else 0.0),
            record=path,
            truth=truth,
            overrides=(phase, *overrides),
            faults=fault_file if faults else None,
            script=(lambda world: world.plan(read_script(script_file, nodes))) if script else None,
            seed=seed,
        )
        recording = read(path)
        with np.load(truth) as columns:
            courses = [(columns["t_s"], columns["angle_rad"])]  # of the failed axis, whose encoder may be lost
    at, marker = next(
        ((t, text) for t, text in recording.markers if text == "safe" or text.startswith("trip")), (np.inf, "none")
    )
    courses += [(x.t_s, x.values) for x in (each["motor.position_rad"] for each in recording.axes[1:])]
    brakes = [each["brake.setpoint_Nm"] for each in recording.axes]
    return Ended(
        marker.split(":")[0],
        max(_largest_speed(t_s, x_rad, at) for t_s, x_rad in courses),
        max(float(brake.values[brake.t_s > at].max(initial=0.0)) for brake in brakes),
    )


def _largest_speed(t_s: Floats, x_rad: Floats, at: float) -> float:
    """Return the largest speed after a time, over `WINDOW_S` [rad/s]."""
    k = max(1, round(WINDOW_S / float(np.median(np.diff(t_s)))))
    way = np.abs(x_rad[k:] - x_rad[:-k]) / (t_s[k:] - t_s[:-k])
    return float(way[t_s[k:] > at].max(initial=0.0))


def table() -> Iterator[str]:
    """Yield the rows of the table of docs/safety.md: the largest speeds of each rig in its modes."""
    names = [f"{name}: {', '.join(modes)}" for name, (_, _, modes) in RIGS.items()]
    yield f"| end | {' | '.join(names)} |"
    yield "|---" * (len(RIGS) + 1) + "|"
    for what, end in ENDS.items():
        cells = []
        for rig, overrides, modes in RIGS.values():
            speeds = [ended(rig, mode, end, 0.9, 3.5, overrides).speed_rad_s for mode in modes]
            cells.append(", ".join(f"{speed:.2f}" for speed in speeds))
        yield f"| {what} | {' | '.join(cells)} |"


def random_ends(mode: str, count: int) -> Iterator[tuple[str, float, Ended]]:
    """Yield the end, the push and the course of `count` random ends of the bench in a mode."""
    draw = random.Random(count)
    for seed in range(count):
        what = draw.choice([*ENDS])
        push = draw.uniform(0.2, 0.97)
        yield what, push, ended("bench", mode, ENDS[what], push, draw.uniform(2.5, 6.0), seed=seed)


def releases(show: Callable[..., None], ends: int) -> None:
    """Print the table, or the worst of `ends` random ends of each kind and mode."""
    if not ends:
        for row in table():
            print(row, flush=True)
        return
    for mode in ("active", "passive", "hybrid"):
        worst: dict[str, tuple[float, float]] = {}
        for what, push, run in random_ends(mode, ends):
            worst[what] = max(worst.get(what, (0.0, 0.0)), (run.speed_rad_s, push))
        for what, (speed, push) in sorted(worst.items()):
            show(f"{mode}, {what}", f"{speed:.2f} rad/s", f"the worst, at a push of {push:.2f} F_s")
