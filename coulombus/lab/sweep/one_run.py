"""One run of a sweep: a rig with its values, simulated, as a row of the table.

`carry_out` depends only on its arguments, not on earlier runs: any worker on any machine computes
the same row (on processors for which LLVM emits the same instructions).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Outputs, Run
from coulombus.lab.simulate import virtual_run
from coulombus.lab.sweep.expressions import RunCondition
from coulombus.lab.sweep.figures import Value, figures_of, known_figures
from coulombus.lab.sweep.ranges import Vary, seed_of
from coulombus.lab.sweep.sweep_file import Sweep
from coulombus.rigs.rig import Rig
from coulombus.system.errors import CoulombusError

__all__ = ["KEEP", "FinishedRun", "Job", "Keep", "RunRequest", "carry_out", "failed_row", "run_request", "warm_up"]

Keep: TypeAlias = Literal["none", "failing", "all"]
KEEP: tuple[Keep, ...] = ("none", "failing", "all")

TRIPPED = "trip: "


@dataclass(frozen=True)
class Job:
    """Data shared by all runs of a sweep."""

    rig: Rig
    seconds: float | None
    vary: tuple[Vary, ...]
    rates: Mapping[str, RunCondition]
    keep: Keep = "none"

    @classmethod
    def from_sweep(cls, sweep: Sweep, keep: Keep = "none") -> Job:
        """Return the job of a sweep."""
        return cls(sweep.rig, sweep.seconds, sweep.vary, sweep.rates, keep)


@dataclass(frozen=True)
class RunRequest:
    """Request for one run."""

    run: int
    point: int
    mode: str
    seed: int
    values: tuple[Any, ...]


@dataclass(frozen=True)
class FinishedRun:
    """The result of a run.

    Attributes
    ----------
    row : of the table
    simulated_s, cpu_s : displayed time, and its CPU time on one core, including set-up
    recording : its bytes, if kept
    """

    row: dict[str, Any]
    simulated_s: float = 0.0
    cpu_s: float = 0.0
    recording: bytes | None = None


def run_request(sweep: Sweep, run: int) -> RunRequest:
    """Return run number `run`: all modes of the first point, of the second ..."""
    point, mode = divmod(run, len(sweep.modes))
    return RunRequest(run, point, sweep.modes[mode], seed_of(sweep.seed, point), sweep.points[point])


def carry_out(job: Job, request: RunRequest) -> FinishedRun:
    """Simulate one run and return the result.

    Any failure of the run - a refused rig, a trip, an internal error - is the row's ``error``.

    Raises
    ------
    OSError
        its recording cannot be written
    """
    began = time.thread_time()
    rig, result, error = _simulated(job, request)
    figures: Mapping[str, Value] = dict.fromkeys(known_figures(job.rig))
    if result is not None and rig is not None:
        figures = figures_of(result, rig)
        error = None if result.trip is None else TRIPPED + result.trip
    row = {
        **_head(job, request, error),
        **figures,
        **{f"rates.{name}": condition.holds(figures) for name, condition in job.rates.items()},
        "rig": None if rig is None else rig.effective(),
        "recording": None,
    }
    simulated_s = 0.0 if result is None else result.cycles * result.period_ns * 1e-9
    cpu_s = time.thread_time() - began
    failing = error is not None or not all(row[f"rates.{name}"] for name in job.rates)
    recording = None
    if rig is not None and result is not None and (job.keep == "all" or (job.keep == "failing" and failing)):
        recording = _recorded(job, rig, request)
    return FinishedRun(row, simulated_s, cpu_s, recording)


def failed_row(job: Job, request: RunRequest, error: str) -> dict[str, Any]:
    """Return the row of a failed run, with only its reason."""
    return {
        **_head(job, request, error),
        **dict.fromkeys(known_figures(job.rig)),
        **{f"rates.{name}": False for name in job.rates},
        "rig": None,
        "recording": None,
    }


def _head(job: Job, request: RunRequest, error: str | None) -> dict[str, Any]:
    values = dict(zip((variation.key for variation in job.vary), request.values, strict=True))
    return {
        "run": request.run,
        "point": request.point,
        "mode": request.mode,
        "seed": request.seed,
        **values,
        "error": error,
    }


def _simulated(job: Job, request: RunRequest) -> tuple[Rig | None, RunResult | None, str | None]:
    """Return the rig, if valid, its simulation, and the reason of a failure."""
    rig = None
    try:
        rig = job.rig.variant(
            *(variation.override(value) for variation, value in zip(job.vary, request.values, strict=True))
        )
        return rig, virtual_run(_run(job, rig, request)), None
    except Exception as error:  # must not end the other runs
        is_refusal = isinstance(error, CoulombusError)
        return rig, None, f"refused: {error}" if is_refusal else f"{type(error).__name__}: {error}"


def _run(job: Job, rig: Rig, request: RunRequest, record: Path | None = None) -> Run:
    seconds = rig.schedule_s if job.seconds is None else job.seconds
    return Run(rig, request.mode, seconds, request.seed, outputs=Outputs(record=record, measured=True))


def _recorded(job: Job, rig: Rig, request: RunRequest) -> bytes:
    """Return the recording of a run, by running it again."""
    with tempfile.TemporaryDirectory(prefix="coulombus-sweep-") as folder:
        path = Path(folder) / "run.pcapng"
        virtual_run(_run(job, rig, request, path))
        return path.read_bytes()


def warm_up(job: Job) -> None:
    """Load or compile the code of a run in advance; a refused rig is reported by its runs."""
    _simulated(
        Job(job.rig, 1e-3, (), {}),
        RunRequest(0, 0, job.rig.modes[-1], 0, ()),
    )
