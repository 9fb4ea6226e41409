"""Random worlds outside: does any feed the hand, shake it, or trip?

Walls, springs, fields and profiles, some of which move, on the bench and at an arm's tip; the law is off.
A hand pushes slowly and taps twice. The energy that it gets, less the work of the world's own motion and of its
profile, must be at most `MOST_J`; in the last half second, when nothing moves but the push, it must be still; and a world
that neither moves nor plays a profile must not trip.

    python -m benchmarks worlds --rigs 300 --modes 3 --hands 5 --seed 1
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.size import size
from coulombus import (
    LinearField,
    Model,
    PlaneField,
    PlaneProfile,
    PlaneSpring,
    PlaneWall,
    Spring,
    TorqueProfile,
    Wall,
    load_rig,
    simulate,
)
from coulombus.host.world.state import State
from coulombus.rigs.rig import Rig

__all__ = [
    "HANDS",
    "MODES",
    "MOST_J",
    "STILL_M_S",
    "STILL_RAD_S",
    "TIP_HANDS",
    "Course",
    "Outcome",
    "on_arm",
    "on_bench",
    "random_worlds",
    "run_world",
]

MOST_J, STILL_RAD_S, STILL_M_S = 0.02, 0.05, 0.01
HANDS = ((0.005, 1e-4), (0.02, 1e-3), (0.1, 5e-4), (0.2, 1e-2), (0.5, 0.1))
"""Damping [Nms/rad] and inertia [kg m2] of the hands of the bench."""
TIP_HANDS = ((1.0, 0.1), (3.0, 0.3), (5.0, 0.3), (10.0, 0.6), (20.0, 1.0))
"""Damping [Ns/m] and mass [kg] of the hands of the arm."""
MODES = ("passive", "hybrid", "active")
SECONDS, TIP_SECONDS, LAST_S = 3.1, 4.0, 0.5
MOTION_S, PROFILE_AT_S = 1.6, 0.9
"""From the first state on: duration of the world's own motion, which ends where it began, and the profile's begin."""
PROFILE_SAMPLES, SAMPLE_S = 32, 0.002
STATIC_CYCLES, MOVING_CYCLES = 100, 2
"""Cycles between two models of a world that rests, and of one that moves."""
LEAN = (
    'phase=[{{kind="rest", duration_s=0.5}}, {{kind="hold", duration_s=4.0, push_F_s={share!r}, frequency_Hz=0.11, '
    "taps_s=[0.3, 1.1], tap_Nm=0.6, tap_s=0.01}}]"
)
TIP_LEAN = (
    'phase=[{{kind="rest", duration_s=1.5}}, {{kind="tip_hold", duration_s=3.0, push_F_s=0.6, frequency_Hz=0.11, '
    "direction_rad={way!r}, taps_s=[0.4, 1.2], tap_N=2.0, tap_s=0.01}}]"
)


@dataclass(frozen=True)
class Outcome:
    """The energy and the motion of a hand at a world."""

    given_J: float
    """Energy that the hand got, less the work of the world's own motion and profile."""
    speed: float
    """RMS of the last half second, in rad/s or m/s."""
    softened: float
    trip: str | None
    passive: bool = True
    """Whether the world neither moves nor plays a profile."""


@dataclass
class Course:
    """A world's states, a row each: place, hand's force, the moving part's force, its place, the profile's force."""

    period_s: float
    moves: float = 0.0
    """Amplitude of the world's own motion [rad or m]."""
    plays: float = 0.0
    """Amplitude of its profile [Nm or N]."""
    displayed: float = math.inf
    """Largest part of the profile that the mode's motor displays."""
    rows: list[Any] = field(default_factory=list)

    @property
    def t_s(self) -> float:
        """Time since the first state [s]."""
        return len(self.rows) * self.period_s

    @property
    def due(self) -> bool:
        """Whether the world sends a model now."""
        return len(self.rows) % (MOVING_CYCLES if self.moves or self.plays else STATIC_CYCLES) == 0

    @property
    def shift(self) -> float:
        """Way of the moving part from its first place."""
        return 0.5 * self.moves * (1.0 - math.cos(2.0 * math.pi * min(self.t_s / MOTION_S, 1.0)))

    @property
    def samples(self) -> tuple[float, ...]:
        """The profile's samples: a period of a sine."""
        return tuple(self.plays * math.sin(2.0 * math.pi * k / PROFILE_SAMPLES) for k in range(PROFILE_SAMPLES))

    @property
    def begun(self) -> bool:
        """Whether the profile has begun."""
        return self.plays > 0.0 and self.t_s >= PROFILE_AT_S

    @property
    def profile(self) -> float:
        """The profile's force that the motor displays now."""
        number = math.floor((self.t_s - PROFILE_AT_S) / SAMPLE_S)
        force = self.samples[number] if self.begun and number < PROFILE_SAMPLES else 0.0
        return min(max(force, -self.displayed), self.displayed)

    def note(self, place: Any, hand: Any, push: Any, anchor: Any, profile: Any = 0.0) -> None:
        """Add a row; scalars, or vectors of the plane."""
        self.rows.append(
            np.concatenate(
                [np.zeros_like(np.atleast_1d(place)) + value for value in (place, hand, push, anchor, profile)]
            )
        )

    def outcome(self, softened: float, trip: str | None) -> Outcome:
        """Return the energies at the hand's port, and the speed at the end."""
        place, hand, push, anchor, profile = np.split(np.array(self.rows), 5, axis=1)
        ways = np.diff(place, axis=0)

        def work_J(force: Any, along: Any) -> float:
            return float(np.sum(0.5 * (force[1:] + force[:-1]) * along))

        own_J = work_J(push, np.diff(anchor, axis=0)) + work_J(profile, ways)
        last = ways[-round(LAST_S / self.period_s) :]
        speed = float(np.sqrt(np.mean(np.sum((last / self.period_s) ** 2, axis=1))))
        return Outcome(-work_J(hand, ways) - own_J, speed, softened, trip, not (self.moves or self.plays))


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def run_world(rig: Rig, mode: str, seconds: float, model: Callable[[State], Model | None], course: Course) -> Outcome:
    """Run a world that notes its states in `course`."""
    softened = [0.0]

    def world(state: State) -> Model | None:
        softened[0] = max(softened[0], state.softened)
        return model(state)

    result = simulate(rig, mode, seconds, world=world)
    return course.outcome(softened[0], result.trip)


def on_bench(seed: int, mode: str, hand: tuple[float, float]) -> tuple[str, Outcome]:
    """Return the world of a seed as text, and what a hand met."""
    rng = np.random.default_rng([49, seed])
    kind = str(rng.choice(("wall", "spring", "field", "wall and spring", "profile", "wall and profile")))
    stiff, damps = _log(rng, 10.0, 3000.0), _log(rng, 0.01, 1.0) * float(rng.random() < 0.5)
    most_Nm, pull = _log(rng, 0.3, 3.0), _log(rng, 5.0, 300.0)
    push_Nm = float(rng.uniform(0.3, 0.9)) * (
        min(most_Nm, 1.0) if kind == "spring" else 0.2 if kind == "profile" else 1.0
    )
    moves_rad = float(rng.uniform(-0.1, 0.1)) * float(rng.random() < 0.3 and kind in ("wall", "spring"))
    F_s_Nm = {"active": 1.2}.get(mode, 3.5)
    text = (f"operator.damping_Nms_rad={hand[0]!r}", f"operator.inertia_kg_m2={hand[1]!r}", "operator.tremor_Nm=0.0")
    limit = ("mode.hybrid.motor_limit_Nm=1.5",) if rng.random() < 0.5 else ()
    rig = load_rig("bench", (LEAN.format(share=push_Nm / F_s_Nm), *text, *limit))
    plays_Nm = _log(rng, 0.05, 0.4) * float("profile" in kind)
    course = Course(
        rig.bus.period_s, moves_rad, plays_Nm, 0.0 if mode == "passive" else rig.axes[0].mode[mode].motor_limit_Nm
    )
    played: list[TorqueProfile] = []

    def model(state: State) -> Model | None:
        due, shift = course.due, course.shift
        if course.begun and not played:
            played.append(TorqueProfile(course.samples, SAMPLE_S))
        course.note(state.x_rad, state.handle_Nm, state.world_Nm if moves_rad else 0.0, shift, course.profile)
        if not due:
            return None
        wall = Wall(0.02 + shift, K_Nm_rad=stiff, B_Nms_rad=damps) if "wall" in kind else None
        spring = Spring(shift, K_Nm_rad=pull, B_Nms_rad=damps, most_Nm=most_Nm) if "spring" in kind else None
        linear = LinearField(Nm_rad=-pull, Nms_rad=-damps) if kind == "field" else None
        return Model(wall=wall, spring=spring, field=linear, profile=played[0] if played else None, law=0.0, life_s=0.5)

    name = f"{kind} K={stiff if 'wall' in kind else pull:.0f} B={damps:.2f}" + " moves" * bool(moves_rad)
    return name, run_world(rig, mode, SECONDS, model, course)


def on_arm(seed: int, mode: str, hand: tuple[float, float]) -> tuple[str, Outcome]:
    """Return the world of a seed at an arm's tip as text, and what a hand met."""
    rng = np.random.default_rng([50, seed])
    kind = str(rng.choice(("wall", "spring", "field", "wall and profile")))
    stiff, damps = _log(rng, 30.0, 3000.0), _log(rng, 0.3, 10.0) * float(rng.random() < 0.5)
    way, most_N = float(rng.uniform(0.0, 2.0 * math.pi)), _log(rng, 1.0, 10.0)
    moves_m = 0.02 * float(rng.uniform(-1.0, 1.0)) * float(rng.random() < 0.3 and kind in ("wall", "spring"))
    plays_N = _log(rng, 0.3, 2.0) * float("profile" in kind)
    ahead = np.array((math.cos(way), math.sin(way)))
    text = (f"plane.hand_damping_Ns_m=[{hand[0]}, {hand[0]}]", f"plane.hand_mass_kg={hand[1]}")
    rig = load_rig("plane", (TIP_LEAN.format(way=way), *text))
    course = Course(rig.bus.period_s, moves_m, plays_N, 0.0 if mode == "passive" else math.inf)
    start: list[Any] = []
    played: list[PlaneProfile] = []

    def model(state: State) -> Model | None:
        due, shift = course.due, course.shift * ahead
        tip = np.array((state.tip_x_m, state.tip_y_m))
        start.append(tip)
        if course.begun and not played:
            played.append(PlaneProfile(course.samples, tuple(ahead), SAMPLE_S))
        push = np.array((state.world_x_N, state.world_y_N)) * bool(moves_m)
        course.note(tip, (state.hand_x_N, state.hand_y_N), push, shift, course.profile * ahead)
        if not due:
            return None
        point, profile = tuple(start[0] + 0.005 * ahead + shift), played[0] if played else None
        if "wall" in kind:
            wall = PlaneWall(point, tuple(-ahead), K_N_m=stiff, B_Ns_m=damps)
            return Model(wall=wall, profile=profile, law=0.0, life_s=0.5)
        if kind == "spring":
            return Model(spring=PlaneSpring(tuple(start[0] + shift), stiff, damps, most_N), law=0.0, life_s=0.5)
        force = PlaneField(tuple(stiff * start[0]), ((-stiff, 0.0), (0.0, -stiff)), ((-damps, 0.0), (0.0, -damps)))
        return Model(field=force, law=0.0, life_s=0.5)

    return f"{kind} K={stiff:.0f} B={damps:.2f}" + " moves" * bool(moves_m), run_world(
        rig, mode, TIP_SECONDS, model, course
    )


def _runs(worlds: int, modes: int, hands: int) -> Iterator[tuple[int, str, int]]:
    """Yield number, mode and hand; with fewer than all, the next world has the next ones."""
    for number in range(worlds):
        for mode in range(modes):
            for hand in range(hands):
                yield number, MODES[(number + mode) % 3], (number + number // 5 + mode + hand) % 5


def random_worlds(worlds: int, seed: int, modes: int = 1, hands: int = 1) -> dict[str, int]:
    """Print each run that does not hold, and a table; return how many of each kind there are.

    Parameters
    ----------
    modes, hands : how many of the three modes and of the five hands each world meets
    """
    counts = {"runs": 0, "feed": 0, "shake": 0, "trip": 0}
    met: dict[tuple[str, str], list[Outcome]] = {}
    for number, mode, hand in _runs(size(worlds, 1), modes, hands):
        for rig, run, of_rig, still in (("bench", on_bench, HANDS, STILL_RAD_S), ("arm", on_arm, TIP_HANDS, STILL_M_S)):
            name, outcome = run(1000 * seed + number, mode, of_rig[hand])
            met.setdefault((rig, mode), []).append(outcome)
            faults = {
                "feed": outcome.given_J > MOST_J,
                "shake": outcome.speed > still,
                "trip": outcome.passive and outcome.trip is not None,
            }
            counts["runs"] += 1
            for kind, fault in faults.items():
                counts[kind] += fault
            if any(faults.values()):
                print(f"{rig} {mode} hand {of_rig[hand]} world {number} {name}: {outcome}", flush=True)
    print(
        "| rig, mode | runs | most energy to the hand [J] | largest speed at the end | softened |\n|---|---|---|---|---|"
    )
    for (rig, mode), outcomes in sorted(met.items()):
        energy_J, speed = max(o.given_J for o in outcomes), max(o.speed for o in outcomes)
        print(
            f"| {rig}, {mode} | {len(outcomes)} | {energy_J:.3f} | {speed:.3f} | {sum(o.softened > 0 for o in outcomes)} |"
        )
    print(counts)
    return counts
