"""The demo in the plane: one hand holds the tip of an arm and draws a circle, in each mode of the rig.

The demo passes if motors alone oscillate at rest, brakes alone miss the direction of the friction, and the
hybrid one does neither.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Outputs, Run
from coulombus.lab.demo.demo import Criterion, JudgedDemo
from coulombus.lab.plane_figures import TipSamples, tip_samples
from coulombus.lab.simulate import virtual_run
from coulombus.recording.measures import HOLD_LEAD_S, HOLD_TAIL_S
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["ARM_MODES", "PlaneDemo", "TipRun", "directional_force", "run_plane_demo"]

ARM_MODES = ("active", "passive", "hybrid")
"""The order of the demo."""

OSCILLATES_COUNTS = 50
STILL_COUNTS = 2
HOLD_PUSH_SHARE = 0.5  # of F_s
MEDIAN_DEG, P95_DEG = 2.0, 12.0
BRAKES_P95_DEG = 20.0
SIZE_SHARE = 0.02
DIRECTIONS = 72


@dataclass(frozen=True)
class TipRun:
    """A run of the demo: its result and the tip's true course."""

    result: RunResult
    samples: TipSamples
    hold_s: tuple[float, float]
    """Begin and end of the hold, from the start of the schedule."""

    @property
    def hold_counts(self) -> dict[str, int | None]:
        """Return the encoders' peak to peak in the hold, by joint."""
        return {name: axis["hold_counts_p2p"] for name, axis in (self.result.axes or {}).items()}

    @property
    def in_hold(self) -> npt.NDArray[np.bool_]:
        """Return which samples belong to the window of the hold's figures (`recording.measures`)."""
        begin, end = self.hold_s
        t_s = self.samples.t_s
        return (t_s >= begin + HOLD_LEAD_S) & (t_s < end - HOLD_TAIL_S)

    @property
    def hold_rms_m_s(self) -> float:
        """Return the RMS of the tip's speed in the hold [m/s]."""
        v = self.samples.v_m_s[self.in_hold]
        return float(np.sqrt((v**2).sum(axis=1).mean())) if len(v) else 0.0

    @property
    def hold_push_N(self) -> float:
        """Return the largest force of the hand in the hold [N]."""
        force = np.hypot(*self.samples.hand_N[self.in_hold].T)
        return float(force.max()) if len(force) else 0.0


@dataclass(frozen=True)
class PlaneDemo(JudgedDemo):
    """The runs by mode, and the verdict on them."""

    rig: Rig
    runs: dict[str, TipRun]

    def as_dict(self) -> dict[str, Any]:
        """Return the demo as plain values for JSON."""
        runs: dict[str, Any] = {
            mode: run.result.as_dict() | {"hold_tip_rms_m_s": run.hold_rms_m_s, "hold_tip_push_N": run.hold_push_N}
            for mode, run in self.runs.items()
        }
        return runs | super().as_dict()


def directional_force(samples: TipSamples, count: int = DIRECTIONS) -> npt.NDArray[np.float64]:
    """Return the mean displayed force in `count` equal sectors of the direction of motion [N], shape (count, 2).

    Only the compared samples count; a sector without one has NaN.
    """
    is_compared = samples.compared
    angle = np.arctan2(samples.v_m_s[is_compared, 1], samples.v_m_s[is_compared, 0]) % (2 * np.pi)
    sector = np.minimum((angle * count / (2 * np.pi)).astype(int), count - 1)
    number = np.bincount(sector, minlength=count)
    sums = [np.bincount(sector, weights=samples.shown_N[is_compared, k], minlength=count) for k in range(2)]
    with np.errstate(invalid="ignore"):
        return np.stack([total / number for total in sums], axis=1)


def _judge(rig: Rig, runs: Mapping[str, TipRun], static_N: float | None) -> tuple[Criterion, ...]:
    """Judge an active and a hybrid run of an arm, and a passive run if there is one."""
    active, hybrid = runs["active"], runs["hybrid"]
    names = rig.axis_names
    criteria = [
        Criterion(f"{mode}: no trip", run.result.trip or "none", run.result.trip is None) for mode, run in runs.items()
    ]
    swing = [active.hold_counts.get(name) for name in names]
    criteria.append(
        Criterion(
            f"active hold oscillates: a joint by at least {OSCILLATES_COUNTS} counts",
            _counts(active),
            any(count is not None and count >= OSCILLATES_COUNTS for count in swing),
        )
    )
    rest = [hybrid.hold_counts.get(name) for name in names]
    criteria.append(
        Criterion(
            f"hybrid hold is still: each joint within {STILL_COUNTS} counts",
            _counts(hybrid),
            all(count is not None and count <= STILL_COUNTS for count in rest),
        )
    )
    if static_N is not None:
        least = HOLD_PUSH_SHARE * static_N
        push = hybrid.hold_push_N
        criteria.append(
            Criterion(f"hybrid hold: pushed with at least {least:.3g} N", f"{push:.3g} N", push >= least),
        )
    plane = hybrid.result.plane or {}
    off, ratio = plane.get("angle_error_deg", {}), plane.get("force_ratio")
    measured = ratio is not None
    criteria.append(
        Criterion(
            f"hybrid motion: force within {MEDIAN_DEG:g} deg of the law's (95 %: {P95_DEG:g} deg)",
            f"{off['median']:.2g} deg ({off['p95']:.3g} deg)" if measured else "no motion in the schedule",
            off["median"] <= MEDIAN_DEG and off["p95"] <= P95_DEG if measured else None,
        )
    )
    criteria.append(
        Criterion(
            f"hybrid motion: size within {100 * SIZE_SHARE:g} % of the law's",
            f"{ratio:.3f} of it" if ratio is not None else "no motion in the schedule",
            abs(ratio - 1.0) <= SIZE_SHARE if ratio is not None else None,
        )
    )
    if "passive" in runs:
        alone = (runs["passive"].result.plane or {}).get("angle_error_deg", {}).get("p95")
        criteria.append(
            Criterion(
                f"passive motion: more than {BRAKES_P95_DEG:g} deg off the law's direction (95 %)",
                "no motion in the schedule" if alone is None else f"{alone:.3g} deg",
                None if alone is None else alone > BRAKES_P95_DEG,
            )
        )
    return tuple(criteria)


def _counts(run: TipRun) -> str:
    return ", ".join(f"{name} {'none' if count is None else count}" for name, count in run.hold_counts.items())


def run_plane_demo(
    rig: Rig, directory: Path, *, seed: int = 0, progress: Callable[[str, float], None] | None = None
) -> PlaneDemo:
    """Run the rig's schedule in each of its modes, in virtual time.

    Write recordings and ``demo.json`` under `directory`, replacing earlier ones.

    Raises
    ------
    coulombus.rigs.errors.RigError
        the rig has no [kinematics], no hold of the tip in its schedule, or lacks the mode active or hybrid
    """
    missing = [mode for mode in ("active", "hybrid") if mode not in rig.modes]
    if rig.in_plane is None:
        raise RigError([f"{rig.path}: the rig {rig.name} has no [kinematics]; expected a rig in the plane, as plane"])
    if missing:
        raise RigError([f"{rig.path}: the rig {rig.name} has no mode {missing[0]!r}; the demo in the plane needs it"])
    hold_s, runs = _hold_s(rig), {}
    directory.mkdir(parents=True, exist_ok=True)
    static_N: float | None = None
    for mode in (mode for mode in ARM_MODES if mode in rig.modes):

        def report(t_s: float, mode: str = mode) -> None:
            if progress is not None:
                progress(mode, t_s)

        worlds: list[VirtualRig] = []
        outputs = Outputs(record=directory / f"{mode}.pcapng", force=True)
        run = Run(rig, mode, rig.schedule_s, seed, outputs=outputs)
        result = virtual_run(run, progress=report, on_world=worlds.append)
        (world,) = worlds
        model, enabled_ns = world.controllers.plane_model, world.enabled_ns
        assert model is not None
        begin_s = 0.0 if enabled_ns is None else enabled_ns * 1e-9
        runs[mode] = TipRun(result, tip_samples(rig, model.law, world.tip_course(), begin_s), hold_s)
        static_N = getattr(model.law.parameters, "F_s_N", None)
    demo = PlaneDemo(_judge(rig, runs, static_N), rig, runs)
    (directory / "demo.json").write_text(json.dumps(demo.as_dict(), indent=2) + "\n")
    return demo


def _hold_s(rig: Rig) -> tuple[float, float]:
    """Return begin and end of the first hold of the tip in the schedule."""
    axis = rig.axes[0]
    starts = axis.phase_starts_s
    for phase, begin, end in zip(axis.phases, starts, starts[1:], strict=False):
        if phase.kind == "tip_hold":
            return begin, end
    raise RigError([f"{rig.path}: the schedule has no [[phase]] of kind 'tip_hold'; the demo in the plane needs it"])
