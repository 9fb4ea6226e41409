"""The paper's experiment: one hand holds and strokes the handle, with active and hybrid force feedback.

All figures come from the recordings. The demo passes if the active display shows the limit cycle
and the hybrid one holds still under a real push.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Outputs, Run
from coulombus.lab.simulate import virtual_run
from coulombus.rigs.rig import Rig

__all__ = ["DEMO_MODES", "TITLES", "Criterion", "Demo", "JudgedDemo", "displays", "judge", "run_demo"]

DEMO_MODES = ("active", "hybrid")
"""The paper's comparison."""
SAME = "hybrid-as-active"
"""The hybrid display with the active display's friction."""
TITLES = {
    "active": "active: motor alone",
    "hybrid": "hybrid: motor and brake",
    SAME: "hybrid, friction as active",
    "passive": "passive: brake alone",
}
"""Titles of the displays' columns, by the name of their files."""

ACTIVE_RMS_RAD_S = (0.1, 3.0)
ACTIVE_FLIPS_PER_S = 20.0
ACTIVE_PEAK_HZ = (20.0, 200.0)
HYBRID_COUNTS = 2
HYBRID_RMS_RAD_S = 0.005
HYBRID_PUSH_SHARE = 0.5  # of F_s


@dataclass(frozen=True)
class Criterion:
    """A criterion of the demo: the demand, the result, and whether it holds."""

    text: str
    found: str
    holds: bool | None
    """None if the rig lacks the measurement."""


@dataclass(frozen=True)
class JudgedDemo:
    """The verdict on a demo."""

    criteria: tuple[Criterion, ...]

    @property
    def passed(self) -> bool:
        """True if every criterion that can be judged holds."""
        return all(criterion.holds is not False for criterion in self.criteria)

    def as_dict(self) -> dict[str, Any]:
        """Return the demo as plain values for JSON."""
        criteria = [{"text": c.text, "found": c.found, "holds": c.holds} for c in self.criteria]
        return {"passed": self.passed, "criteria": criteria}


@dataclass(frozen=True)
class Demo(JudgedDemo):
    """The runs by the name of their files, and the verdict on them."""

    results: dict[str, RunResult]

    def as_dict(self) -> dict[str, Any]:
        """Return the demo as plain values for JSON."""
        return {name: result.as_dict() for name, result in self.results.items()} | super().as_dict()


def displays(rig: Rig, seed: int = 0) -> dict[str, Run]:
    """Return the runs by the name of their files, those of `TITLES`: the paper's comparison, hybrid at the
    active display's friction, and the brake alone if the rig has that mode.
    """
    active, seconds = rig.one_axis().mode["active"], rig.schedule_s
    same = rig.variant(f"mode.hybrid.F_s_Nm={active.F_s_Nm}", f"mode.hybrid.F_d_Nm={active.F_d_Nm}")
    runs = {mode: Run(rig, mode, seconds, seed) for mode in DEMO_MODES}
    runs[SAME] = Run(same, "hybrid", seconds, seed)
    return runs | {mode: Run(rig, mode, seconds, seed) for mode in ("passive",) if mode in rig.modes}


def _between(value: float | None, low: float, high: float) -> bool:
    return value is not None and low <= value <= high


def _number(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{value:.4g} {unit}"


def judge(rig: Rig, results: dict[str, RunResult]) -> tuple[Criterion, ...]:
    """Judge an active and a hybrid run, and a hybrid run at the active one's friction if there is one."""
    active, hybrid = results["active"], results["hybrid"]
    push = HYBRID_PUSH_SHARE * rig.one_axis().mode["hybrid"].F_s_Nm
    counts, rms = hybrid.hold_counts_p2p, hybrid.hold_velocity_rms_rad_s
    still = counts is not None and rms is not None and counts <= HYBRID_COUNTS and rms <= HYBRID_RMS_RAD_S
    measured = rig.one_axis().allocation.bound.get("handle_torque") is not None
    low, high = ACTIVE_RMS_RAD_S
    first, last = ACTIVE_PEAK_HZ
    runs = tuple(
        Criterion(f"{name}: no trip", result.trip or "none", result.trip is None) for name, result in results.items()
    )
    return (
        *runs,
        Criterion(
            f"active hold oscillates: velocity RMS {low:g} to {high:g} rad/s",
            _number(active.hold_velocity_rms_rad_s, "rad/s"),
            _between(active.hold_velocity_rms_rad_s, low, high),
        ),
        Criterion(
            f"active hold: at least {ACTIVE_FLIPS_PER_S:g} sign changes of the torque a second",
            _number(active.torque_flips_per_s, "/s"),
            _between(active.torque_flips_per_s, ACTIVE_FLIPS_PER_S, float("inf")),
        ),
        Criterion(
            f"active hold: spectral peak at {first:g} to {last:g} Hz",
            _number(active.hold_peak_Hz, "Hz"),
            _between(active.hold_peak_Hz, first, last),
        ),
        Criterion(
            f"hybrid hold is still: within {HYBRID_COUNTS} counts, velocity RMS at most {HYBRID_RMS_RAD_S:g} rad/s",
            f"{counts} counts, {_number(rms, 'rad/s')}",
            still,
        ),
        Criterion(
            f"hybrid hold: pushed with at least {push:.3g} Nm",
            _number(hybrid.hold_push_Nm, "Nm") if measured else "not measured, the rig has no handle torque",
            _between(hybrid.hold_push_Nm, push, float("inf")) if measured else None,
        ),
        *(_same_friction(results[SAME]) for _ in (SAME,) if SAME in results),
    )


def _same_friction(result: RunResult) -> Criterion:
    counts = result.hold_counts_p2p
    return Criterion(
        f"hybrid hold at the active display's friction: within {HYBRID_COUNTS} counts",
        "none" if counts is None else f"{counts} counts",
        counts is not None and counts <= HYBRID_COUNTS,
    )


def run_demo(rig: Rig, directory: Path, *, seed: int = 0, progress: Callable[[str, float], None] | None = None) -> Demo:
    """Run the `displays` through the rig's schedule.

    Write recordings and ``demo.json`` under `directory`, replacing earlier ones.
    """
    directory.mkdir(parents=True, exist_ok=True)
    results = {}
    for name, run in displays(rig, seed).items():

        def report(t_s: float, name: str = name) -> None:
            if progress is not None:
                progress(name, t_s)

        outputs = Outputs(record=directory / f"{name}.pcapng", force=True)
        results[name] = virtual_run(replace(run, outputs=outputs), progress=report)
    demo = Demo(judge(rig, results), results)
    (directory / "demo.json").write_text(json.dumps(demo.as_dict(), indent=2) + "\n")
    return demo
