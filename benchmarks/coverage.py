"""How often the intervals of commissioning hold the truth: random rigs, commissioned whole.

Each rig is drawn from the ranges of `random_rig` and commissioned by a rig file that believes
another one, in virtual time, step after step. A figure that is written with an interval must hold
the truth in 95 of 100 rigs; the table says in how many it did, and how far the figure was off.

    python -m benchmarks coverage --rigs 40 --seed 1

A setting to a mark by hand is as uncertain as `Given.marks_reach_rad` says: each rig's hand is off
by a normal error of that 95 % reach.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.size import size
from coulombus.host.commission.encoder import MOVE_S
from coulombus.host.commission.friction import SECONDS
from coulombus.host.commission.session import STEPS, Runner, Session
from coulombus.host.commission.step import Exercise, Finding, Given
from coulombus.host.run.result import RunResult
from coulombus.lab.commissioning import rehearsed
from coulombus.rigs.rig import Rig, load_rig, packaged_rig
from coulombus.system.errors import CoulombusError

__all__ = ["RandomRig", "Score", "commissioned", "coverage", "random_rig", "scores", "table"]

MEASURED = ("zero", "weight", "encoder", "motor", "friction", "brake", "response", "delay")
"""The steps that measure; `limits` and `display` follow from them."""
WEIGHT_NM, MARKS_RAD = 1.5, 1.5
NOMINAL_RATIO, NOMINAL_RATED_NM = 9.587, 0.180
BELIEVED_SCALE = 0.001
PLANT_STEP_MS = 0.05
"""The simulated coil and fluid lead by half a step each."""
PERIOD_US = 1000.0
"""Actuation on the next SYNC: the delay of torque and coil."""


@dataclass(frozen=True)
class RandomRig:
    """A rig as it truly is, and what its rig file believes otherwise than the bench's.

    Attributes
    ----------
    truth, believed : overrides of the bench rig
    figures : what is true, by the finding's key or name
    table : (raw, Nm) of the brake
    iron : whether its iron remembers
    effects : whether it has two effects beside the bench's model
    marks_error_rad : by which the hand misses the marks
    """

    seed: int
    truth: tuple[str, ...]
    believed: tuple[str, ...]
    figures: Mapping[str, float]
    table: tuple[tuple[int, float], ...]
    iron: bool
    effects: bool
    marks_error_rad: float


@dataclass
class Score:
    """What the figures of one kind came to over all rigs."""

    held: list[bool] = field(default_factory=list)
    error: list[float] = field(default_factory=list)
    """Relative; absolute where the truth may be 0."""
    without: int = 0
    """Figures that have no interval."""


def random_rig(seed: int) -> RandomRig:
    """Return the rig of a seed."""
    rng = np.random.default_rng([34, seed])

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    friction = log(0.02, 0.3)
    off = friction * rng.uniform(0.1, 0.7)
    inertia, viscous = log(1e-3, 1e-2), rng.uniform(0.002, 0.02)
    ratio = NOMINAL_RATIO * rng.uniform(0.93, 1.07)
    rated = NOMINAL_RATED_NM * rng.uniform(0.85, 1.15)
    count = log(7e-6, 310e-6)
    counts = round(2 * math.pi / (ratio * count))
    jump = math.ceil(1.5 * 15e-3 / (2 * math.pi / (ratio * counts)))
    cogging = 0.0 if rng.random() < 0.25 else rng.uniform(0.003, 0.03)
    periods = int(rng.integers(1, 61))
    noise = float(rng.choice([rng.uniform(0.0, 0.001), log(0.001, 0.01)]))
    scale, zero = BELIEVED_SCALE * rng.uniform(0.85, 1.15), rng.uniform(-0.1, 0.1)
    coil, fluid, motor_lag = rng.uniform(1e-3, 6e-3), rng.uniform(5e-3, 30e-3), rng.uniform(0.5e-3, 3e-3)
    polarity = [int(rng.choice([-1, 1])) for _ in range(3)]
    top, bend = rng.uniform(4.0, 5.0), rng.uniform(0.8, 1.3)
    table = tuple((raw, round(top * (raw / 5000) ** bend, 4)) for raw in range(0, 5001, 1000))
    iron = bool(rng.random() < 0.5)
    truth = [
        f"plant.coulomb_Nm={friction - off!r}",
        f"plant.brake_off_state_Nm={off!r}",
        f"plant.inertia_kg_m2={inertia!r}",
        f"plant.viscous_Nms_rad={viscous!r}",
        f"plant.ratio={ratio!r}",
        f"plant.motor_rated_torque_Nm={rated!r}",
        f"plant.motor_lag_s={motor_lag!r}",
        f"plant.encoder_counts_rev={counts}",
        f"plant.cogging_Nm={cogging!r}",
        f"plant.cogging_periods={periods}",
        f"plant.transducer_noise_Nm={noise!r}",
        f"plant.brake_coil_lag_s={coil!r}",
        f"plant.brake_fluid_lag_s={fluid!r}",
        f"plant.motor_polarity={polarity[0]}",
        f"plant.encoder_polarity={polarity[1]}",
        f"plant.transducer_polarity={polarity[2]}",
        f"role.handle_torque.scale_Nm={scale!r}",
        f"role.handle_torque.offset_Nm={zero!r}",
        f"role.brake_setpoint.table={[list(point) for point in table]}",
    ]
    if iron:
        truth.append(f"plant.iron={{play_Nm=[0.3, 0.8], weights=[{rng.uniform(0.02, 0.1)!r}, 0.05]}}")
    effects, drift = _effects(rng, friction - off) if seed % 3 == 0 else ({}, 0.0)
    truth += [f"plant.{key}={value}" for key, value in effects.items()]
    believed = (f"motor.encoder_counts_rev={counts}", f"limits.encoder_jump_counts={jump}")
    truth += believed
    figures = {
        "role.handle_torque.offset_Nm": zero,
        "role.handle_torque.scale_Nm": scale,
        "mechanics.ratio": ratio,
        "motor.rated_torque_Nm": rated,
        "mechanics.friction_Nm": friction + (friction - off) * drift * SECONDS / 2,
        "mechanics.viscous_Nms_rad": viscous,
        "mechanics.inertia_kg_m2": inertia,
        "mechanics.cogging_Nm": cogging,
        "mechanics.motor_polarity": polarity[0],
        "mechanics.encoder_polarity": polarity[1],
        "mechanics.transducer_polarity": polarity[2],
        "SYNC to motor's torque": PERIOD_US,
        "SYNC to coil's current": PERIOD_US,
        "time constant of the motor's torque": 1e3 * motor_lag,
        "time constant of the coil's current": 1e3 * coil,
        "brake: delay": 1e-3 * PERIOD_US - PLANT_STEP_MS,
        "brake: faster lag (coil)": 1e3 * min(coil, fluid),
        "brake: slower lag (fluid)": 1e3 * max(coil, fluid),
    }
    if "angle_share" in effects.get("friction", ""):
        del figures["mechanics.friction_Nm"]  # the least over the angle is written
    error = float(rng.standard_normal()) * Given().marks_reach_rad / 1.96
    return RandomRig(seed, tuple(truth), believed, figures, table, iron, bool(effects), error)


def _effects(rng: np.random.Generator, coulomb_Nm: float) -> tuple[dict[str, str], float]:
    """Return two effects that a third of the rigs has beside the bench's model, by the key of [plant], and
    the friction's drift [1/s].
    """
    uneven = (
        f"angle_share={rng.uniform(0.05, 0.2)!r}, angle_periods={rng.integers(1, 7)}, "
        f"angle_phase_rad={rng.uniform(0, 2 * math.pi)!r}"
    )
    bristle_rad = float(np.exp(rng.uniform(math.log(1e-4), math.log(3e-3))))
    stiffness = coulomb_Nm / bristle_rad
    bristles = f"law='lugre', sigma_0_Nm_rad={stiffness!r}, sigma_1_Nms_rad={0.01 * math.sqrt(stiffness)!r}"
    kinds = rng.choice(("uneven", "bristles", "stribeck", "ripple", "drift"), 2, replace=False)
    friction = [text for kind, text in (("uneven", uneven), ("bristles", bristles)) if kind in kinds]
    drift = rng.uniform(-1e-3, 1e-3) if "drift" in kinds else 0.0
    if drift:
        friction.append(f"drift_1_s={drift!r}")
    effects = {"friction": f"{{{', '.join(friction)}}}"} if friction else {}
    if "stribeck" in kinds:
        effects["stribeck_Nm"] = repr(rng.uniform(0.05, 0.5) * coulomb_Nm)
        effects["stribeck_rad_s"] = repr(rng.uniform(0.02, 0.2))
    if "ripple" in kinds:
        effects["ripple"] = f"{{share={rng.uniform(0.01, 0.05)!r}, periods={rng.integers(4, 40)}}}"
    return effects, drift


def _runner(drawn: RandomRig, truth: Rig) -> Runner:
    """Return what runs the exercises on the true rig, with a hand that misses the marks."""
    virtual = rehearsed(truth, seed=drawn.seed)
    speed = (MARKS_RAD + drawn.marks_error_rad) / MOVE_S

    def run(exercise: Exercise, path: Path) -> RunResult:
        if exercise.name == "encoder":
            exercise = replace(exercise, hand=(*exercise.hand, f"phase.1.speed_rad_s={speed!r}"))
        return virtual(exercise, path)

    return run


def commissioned(drawn: RandomRig, folder: Path, steps: Sequence[str] = MEASURED) -> tuple[list[Finding], list[str]]:
    """Commission a rig whole, in `folder`; return what was found, and why steps did not pass."""
    path = folder / f"rig{drawn.seed}.toml"
    path.write_text(packaged_rig("bench").read_text())
    truth = load_rig("bench", drawn.truth)
    measured = Given(weight_Nm=WEIGHT_NM, marks_rad=MARKS_RAD)
    session = Session(path, _runner(drawn, truth), measured, drawn.believed, now=lambda: "2026-11-22T14:03:05Z")
    by_name = {step.name: step for step in STEPS}
    findings: list[Finding] = []
    failures: list[str] = []
    for name in steps:
        try:
            end = session.do(by_name[name], lambda step, risk: True)
        except CoulombusError as error:
            failures.append(f"{name}: {error}")
            continue
        if end.outcome is None:
            failures.append(f"{name}: {end.what}: {end.why}")
        else:
            findings += end.outcome.findings
    return findings, failures


def _points(drawn: RandomRig, finding: Finding) -> Iterator[tuple[str, float, float, float | None]]:
    """Yield (name, value, truth, reach) of a finding with a known truth."""
    if finding.key == "role.brake_setpoint.table":
        if drawn.iron:
            return
        raws, torques = zip(*drawn.table, strict=True)
        for raw, Nm in finding.new[1:]:
            yield "brake's table, each point", Nm, float(np.interp(raw, raws, torques)), finding.uncertainty
        return
    name = finding.key if finding.key in drawn.figures else finding.name
    if name not in drawn.figures or finding.new is None:
        return
    truth = drawn.figures[name]
    if name == "role.handle_torque.offset_Nm" and finding.basis.startswith("mean of"):
        truth *= BELIEVED_SCALE / drawn.figures["role.handle_torque.scale_Nm"]  # before the scale is known
    yield name, float(finding.new), truth, finding.uncertainty


def scores(results: Sequence[tuple[RandomRig, list[Finding]]]) -> dict[str, Score]:
    """Return how the figures of all rigs did, by figure."""
    by_name: dict[str, Score] = {}
    for drawn, findings in results:
        for finding in findings:
            for name, value, truth, reach in _points(drawn, finding):
                score = by_name.setdefault(name, Score())
                absolute = "offset" in name or truth == 0
                score.error.append(abs(value - truth) / (1.0 if absolute else abs(truth)))
                if reach is None:
                    score.without += 1
                else:
                    score.held.append(abs(value - truth) <= reach)
    return by_name


def table(by_name: Mapping[str, Score]) -> list[str]:
    """Return the scores as the rows of a Markdown table."""
    rows = ["| figure | interval holds the truth | without one | median error | worst error |", "|---|---|---|---|---|"]
    for name, score in by_name.items():
        held = f"{sum(score.held)} of {len(score.held)}" if score.held else "-"
        unit = (lambda e: f"{1e3 * e:.2g} mNm") if "offset" in name else (lambda e: f"{100 * e:.2g} %")
        median, worst = unit(statistics.median(score.error)), unit(max(score.error))
        rows.append(f"| {name} | {held} | {score.without or '-'} | {median} | {worst} |")
    return rows


def coverage(rigs: int, seed: int, steps: Sequence[str] = MEASURED) -> dict[str, Any]:
    """Commission `rigs` random rigs, print the table, and return the scores."""
    rigs = size(rigs, 1)
    results: list[tuple[RandomRig, list[Finding]]] = []
    passed, begin = 0, time.perf_counter()
    for number in range(rigs):
        drawn = random_rig(1000 * seed + number)
        with tempfile.TemporaryDirectory() as folder:
            findings, failures = commissioned(drawn, Path(folder), steps)
        results.append((drawn, findings))
        passed += not failures
        for failure in failures:
            print(f"rig {drawn.seed}: {failure}", flush=True)
    print(f"\n{passed} of {rigs} rigs pass all {len(steps)} steps; {(time.perf_counter() - begin) / rigs:.1f} s a rig")
    for title, effects in (("as the bench", False), ("with two effects beside its model", True)):
        some = [(drawn, findings) for drawn, findings in results if drawn.effects == effects]
        print(f"\n{len(some)} rigs {title}:\n\n" + "\n".join(table(scores(some))), flush=True)
    return {"passed": passed, "scores": scores(results)}
