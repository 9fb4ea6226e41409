"""A sweep from its file to its rates: the runs, the table, the worst cases, the maps."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coulombus.lab.sweep.cluster import on_cluster
from coulombus.lab.sweep.one_run import Job, Keep, RunRequest, run_request
from coulombus.lab.sweep.picture import MapPoint, map_of
from coulombus.lab.sweep.rates import Rate
from coulombus.lab.sweep.sweep_file import Sweep
from coulombus.lab.sweep.sweep_folder import Folder, SweepFolderError
from coulombus.lab.sweep.workers import on_processes
from coulombus.lab.sweep.worst import nearest_failing, rig_files, shrunk
from coulombus.system.realtime import usable_cpus

__all__ = ["SweepResult", "run_sweep"]

FIGURE = "hold_counts_p2p"
"""Figure drawn for a sweep without rates."""

Progress = Callable[[str, int, int, int], None]
"""Called with the present step, the number done, the total (0: unknown), and the number of failed runs."""


@dataclass(frozen=True)
class SweepResult:
    """The result of a sweep.

    Attributes
    ----------
    runs, failed : number of runs, and of runs with an error
    rates : by name; for several modes ``MODE.NAME``
    simulated_s_per_core_s : displayed time per second of one core, including set-up; None without runs
    worst : rate -> its mildest failing rig, with the file's path
    maps : rate -> image
    """

    runs: int
    failed: int
    rates: Mapping[str, Rate]
    simulated_s_per_core_s: float | None
    table: Path
    worst: Mapping[str, Mapping[str, Any]]
    maps: Mapping[str, Path]

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return {
            "runs": self.runs,
            "failed": self.failed,
            "rates": {name: rate.as_dict() for name, rate in self.rates.items()},
            "simulated_s_per_core_s": self.simulated_s_per_core_s,
            "table": str(self.table),
            "worst": {name: dict(finding) for name, finding in self.worst.items()},
            "maps": {name: str(path) for name, path in self.maps.items()},
        }


def run_sweep(
    sweep: Sweep,
    folder: str | os.PathLike[str],
    *,
    processes: int | None = None,
    dask: str | None = None,
    keep: Keep = "none",
    force: bool = False,
    progress: Progress = lambda what, done, of, failed: None,
) -> SweepResult:
    """Execute the remaining runs of a sweep in `folder`, and return the result of all runs.

    Parameters
    ----------
    processes : local ones; default one per CPU available to this process
    dask : address of a dask.distributed scheduler whose workers are used instead
    keep : recordings to keep of the remaining runs
    force : overwrite another sweep's results

    Raises
    ------
    coulombus.lab.sweep.sweep_folder.SweepFolderError
        the folder holds another sweep, or cannot be written
    coulombus.lab.sweep.cluster.ClusterError
        no cluster is reachable, or a worker has other versions
    """
    job = Job.from_sweep(sweep, keep)
    with Folder.open(Path(folder), sweep, force=force) as results:
        left = results.left
        if left:
            _carry_out(results, job, left, processes or len(usable_cpus()), dask, progress)
        if not results.finished:
            results.finish()
        return _summary(results, job, progress)


def _carry_out(
    results: Folder, job: Job, left: list[int], processes: int, dask: str | None, progress: Progress
) -> None:
    sweep = results.sweep
    done, failed = sweep.runs - len(left), 0
    progress("runs", done, sweep.runs, failed)
    requests = (run_request(sweep, run) for run in left)
    source = on_cluster(job, requests, dask) if dask else on_processes(job, requests, processes)
    try:
        with closing(source):  # type: ignore[type-var]
            for finished in source:
                results.times.simulated_s += finished.simulated_s
                results.times.cpu_s += finished.cpu_s
                row = dict(finished.row)
                if finished.recording is not None:
                    row["recording"] = results.keep_recording(row["run"], finished.recording)
                results.add(row)
                done, failed = done + 1, failed + (row["error"] is not None)
                progress("runs", done, sweep.runs, failed)
    except SweepFolderError:
        raise
    except BaseException:  # interrupted: finished runs are kept
        results.flush()
        progress("runs", sweep.runs - len(results.left), sweep.runs, failed)
        raise


def _summary(results: Folder, job: Job, progress: Progress) -> SweepResult:
    sweep = results.sweep
    conditions = [f"rates.{name}" for name in sweep.rates]
    rows = results.rows("run", "mode", "error", "cycles", FIGURE, *conditions)
    rates: dict[str, Rate] = {}
    maps: dict[str, Path] = {}
    for mode in sweep.modes:
        of_mode = [row for row in rows if row["mode"] == mode]
        for name in sweep.rates or ((FIGURE,) if sweep.vary else ()):
            label = name if len(sweep.modes) == 1 else f"{mode}.{name}"
            shown: Rate | str = name
            if name in sweep.rates:
                rates[label] = shown = Rate(label, sum(row[f"rates.{name}"] for row in of_mode), len(of_mode))
                failing = [run_request(sweep, row["run"]) for row in of_mode if _fails(row, name)]
                _find_worst(results, job, name, label, failing, progress)
            if sweep.vary:
                points = [_point(sweep, row, name) for row in of_mode]
                maps[label] = results.path / f"map-{label}.png"
                results.write(maps[label], map_of(sweep.vary, points, shown))
    times = results.times
    return SweepResult(
        runs=len(rows),
        failed=sum(row["error"] is not None for row in rows),
        rates=rates,
        simulated_s_per_core_s=times.simulated_s / times.cpu_s if times.cpu_s > 0 and times.simulated_s > 0 else None,
        table=results.path / "runs.parquet",
        worst={name: _placed(results.worst[name], results.path) for name in rates if name in results.worst},
        maps=maps,
    )


def _placed(finding: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    return {**finding, "file": str(folder / finding["file"])}


def _fails(row: Mapping[str, Any], rate: str) -> bool:
    """Return whether the condition fails for a simulated rig."""
    return row["cycles"] is not None and not row[f"rates.{rate}"]


def _point(sweep: Sweep, row: Mapping[str, Any], rate: str) -> MapPoint:
    holds = None if row["cycles"] is None else row.get(f"rates.{rate}")
    return MapPoint(sweep.points[row["run"] // len(sweep.modes)], holds, row[FIGURE])


def _find_worst(
    results: Folder, job: Job, rate: str, label: str, failing: list[RunRequest], progress: Progress
) -> None:
    start = nearest_failing(job.vary, failing)
    if start is None or label in results.worst:
        return
    worst = shrunk(job, rate, start, lambda tried: progress(f"worst case of {label}", tried, 0, 0))
    rig = job.rig.variant(
        *(variation.override(value) for variation, value in zip(job.vary, worst.order.values, strict=True))
    )
    files = rig_files(rig, results.path, f"worst-{label}.toml")
    results.keep_worst(label, {**worst.as_dict(), "rate": label, "file": f"worst-{label}.toml"}, files)
