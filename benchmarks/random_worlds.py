"""Random worlds outside: does any feed the hand, shake it, or trip?

Walls, springs and fields, some of which move, in each mode and for five hands, on the bench or at an arm's
tip; the law is off. A hand pushes slowly and taps. What it gets, less what the world's own motion gives, must be at
most `MOST_J`; in the last half second it must be still; and a world that does not move must not trip.

    python -m benchmarks worlds --rigs 300 --seed 1
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.size import size
from coulombus import LinearField, Model, PlaneField, PlaneSpring, PlaneWall, Spring, Wall, load_rig, simulate
from coulombus.host.world.state import State

__all__ = ["MOST_J", "STILL_RAD_S", "Outcome", "on_arm", "on_bench", "random_worlds", "run_world"]

MOST_J, STILL_RAD_S, STILL_M_S = 0.02, 0.05, 0.01
HANDS = ((0.005, 1e-4), (0.02, 1e-3), (0.1, 5e-4), (0.2, 1e-2), (0.5, 0.1))
"""Damping [Nms/rad] and inertia [kg m2] of the hands of the bench."""
TIP_HANDS = ((1.0, 0.1), (3.0, 0.3), (5.0, 0.3), (10.0, 0.6), (20.0, 1.0))
"""Damping [Ns/m] and mass [kg] of the hands of the arm."""
MODES = ("passive", "hybrid", "active")
SECONDS, TIP_SECONDS = 4.5, 4.0
LEAN = (
    'phase=[{{kind="rest", duration_s=1.0}}, {{kind="hold", duration_s=4.0, push_F_s={share!r}, frequency_Hz=0.1, '
    "taps_s=[0.6, 2.1], tap_Nm=0.6, tap_s=0.01}}]"
)
TIP_LEAN = (
    'phase=[{{kind="rest", duration_s=1.5}}, {{kind="tip_hold", duration_s=3.0, push_F_s=0.6, frequency_Hz=0.1, '
    "direction_rad={way!r}, taps_s=[0.6, 1.6], tap_N=2.0, tap_s=0.01}}]"
)


@dataclass(frozen=True)
class Outcome:
    """What a hand met."""

    given_J: float
    """What the hand got, less the work of the world's own motion."""
    speed: float
    """RMS of the last half second, in rad/s or m/s."""
    softened: float
    trip: str | None


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def run_world(rig: Any, mode: str, seconds: float, model: Callable[[State], Model], rows: list[Any]) -> Outcome:
    """Run; `rows` has (place, hand's force, own power's force, own way) of each state."""
    softened = [0.0]

    def world(state: State) -> Model:
        softened[0] = state.softened
        return model(state)

    result = simulate(rig, mode, seconds, world=world)
    place, hand, push, anchor = (np.array(column, float).reshape(len(rows), -1) for column in zip(*rows, strict=True))
    ways, forces = np.diff(place, axis=0), 0.5 * (hand[1:] + hand[:-1])
    own_J = float(np.sum(0.5 * (push[1:] + push[:-1]) * np.diff(anchor, axis=0)))
    last = round(0.5 / (seconds - 1.0) * len(rows))
    period_s = rig.bus.period_s
    speed = float(np.sqrt(np.mean(np.sum((ways[-last:] / period_s) ** 2, axis=1))))
    return Outcome(-float(np.sum(forces * ways)) - own_J, speed, softened[0], result.trip)


def on_bench(seed: int, mode: str, hand: tuple[float, float]) -> tuple[str, Outcome]:
    """Return the world of a seed as text, and what a hand met."""
    rng = np.random.default_rng([49, seed])
    kind = str(rng.choice(("wall", "spring", "field", "wall and spring")))
    stiff, damps = _log(rng, 10.0, 3000.0), _log(rng, 0.01, 1.0) * float(rng.random() < 0.5)
    moves_rad = 0.05 * float(rng.random() < 0.25 and kind == "wall")
    most_Nm, pull = _log(rng, 0.3, 3.0), _log(rng, 1.0, 300.0)
    rows: list[Any] = []

    def model(state: State) -> Model:
        anchor = 0.02 + moves_rad * math.sin(2.0 * math.pi * 0.3 * state.t_s)
        rows.append((state.x_rad, state.handle_Nm, state.world_Nm, anchor))
        wall = Wall(anchor, K_Nm_rad=stiff, B_Nms_rad=damps) if "wall" in kind else None
        spring = Spring(0.0, K_Nm_rad=pull, B_Nms_rad=damps, most_Nm=most_Nm) if "spring" in kind else None
        field = LinearField(Nm_rad=-pull, Nms_rad=-damps) if kind == "field" else None
        return Model(wall=wall, spring=spring, field=field, law=0.0, life_s=0.5)

    F_s_Nm = {"active": 1.2}.get(mode, 3.5)
    text = (f"operator.damping_Nms_rad={hand[0]!r}", f"operator.inertia_kg_m2={hand[1]!r}", "operator.tremor_Nm=0.0")
    rig = load_rig("bench", (LEAN.format(share=float(rng.uniform(0.3, 0.9)) / F_s_Nm), *text))
    name = f"{kind} K={stiff if 'wall' in kind else pull:.0f} B={damps:.2f}" + " moves" * bool(moves_rad)
    return name, run_world(rig, mode, SECONDS, model, rows)


def on_arm(seed: int, mode: str, hand: tuple[float, float]) -> tuple[str, Outcome]:
    """Return the world of a seed at an arm's tip as text, and what a hand met."""
    rng = np.random.default_rng([50, seed])
    kind = str(rng.choice(("wall", "spring", "field")))
    stiff, damps = _log(rng, 30.0, 3000.0), _log(rng, 0.3, 10.0) * float(rng.random() < 0.5)
    way, most_N = float(rng.uniform(0.0, 2.0 * math.pi)), _log(rng, 1.0, 10.0)
    ahead = np.array((math.cos(way), math.sin(way)))
    start: list[Any] = []
    rows: list[Any] = []

    def model(state: State) -> Model:
        tip = np.array((state.tip_x_m, state.tip_y_m))
        start.append(tip)
        rows.append((tip, (state.hand_x_N, state.hand_y_N), (0.0, 0.0), (0.0, 0.0)))
        point = tuple(start[0] + 0.005 * ahead)
        if kind == "wall":
            return Model(wall=PlaneWall(point, tuple(-ahead), K_N_m=stiff, B_Ns_m=damps), law=0.0, life_s=0.5)
        if kind == "spring":
            return Model(spring=PlaneSpring(tuple(start[0]), stiff, damps, most_N), law=0.0, life_s=0.5)
        field = PlaneField(tuple(stiff * start[0]), ((-stiff, 0.0), (0.0, -stiff)), ((-damps, 0.0), (0.0, -damps)))
        return Model(field=field, law=0.0, life_s=0.5)

    text = (f"plane.hand_damping_Ns_m=[{hand[0]}, {hand[0]}]", f"plane.hand_mass_kg={hand[1]}")
    rig = load_rig("plane", (TIP_LEAN.format(way=way), *text))
    return f"{kind} K={stiff:.0f} B={damps:.2f}", run_world(rig, mode, TIP_SECONDS, model, rows)


def random_worlds(worlds: int, seed: int) -> dict[str, int]:
    """Print each run that does not hold, and return how many of each kind there are."""
    counts = {"runs": 0, "feed": 0, "shake": 0, "trip": 0}
    for rig, run, hands, still in (("bench", on_bench, HANDS, STILL_RAD_S), ("arm", on_arm, TIP_HANDS, STILL_M_S)):
        for number in range(size(worlds, 1)):
            mode, hand = MODES[number % 3], hands[number // 3 % 5]
            name, outcome = run(1000 * seed + number, mode, hand)
            faults = {
                "feed": outcome.given_J > MOST_J,
                "shake": outcome.speed > still,
                "trip": outcome.trip is not None,
            }
            counts["runs"] += 1
            for kind, fault in faults.items():
                counts[kind] += fault
            if any(faults.values()):
                print(f"{rig} {mode} hand {hand} {name}: {outcome}", flush=True)
    print(counts)
    return counts
