r"""Stability maps of the displayed friction over operator, rate, delay and friction level.

Each point is a full simulation of the sampled loop (`analysis.theory.sampled_loop`) after a tap. It
is *quiet* if, at the end, the encoder stays within two counts (the criterion of the hold test), or
moves on without reversal, or oscillates with decaying amplitude. Otherwise it shows a limit cycle.
The bounds of `analysis.theory.bounds` are given for comparison; they certify, or do not.

::

    found = oscillation_map({"operator_inertia_kg_m2": np.geomspace(1e-4, 0.1, 20), "delay_s": np.array([0.0, 1e-3])})
    found.share            # share of the taps after which it oscillates, an axis for each of the dictionary's entries

Points are independent and computed by the same compiled code, so threads, processes on a cluster
(`dask="tcp://..."`) and the order of the work do not matter: the numbers are the same bit for bit
(on processors for which LLVM emits the same instructions).
"""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, fields, replace
from time import perf_counter
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.analysis.theory.bounds import Bounds, bounds
from coulombus.analysis.theory.sampled_loop import LOOP, STATS, StatsRecord, run_loops
from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.laws.law import LawRecord, LawStateRecord, MotionRecord
from coulombus.kernels.decorator import Entry
from coulombus.kernels.records import new_records
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig, load_rig

__all__ = ["DEFAULT_AXES", "LoopParameters", "OscillationMap", "PointResult", "oscillation_map", "simulate_point"]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]

QUIET_COUNTS = 2
DYING_OUT = 0.9  # RMS velocity of the window's second half over the whole: a decaying swing of the hand
MOST_DELAY_CYCLES = 60
CHUNK = 96  # runs per task: enough that the task overhead is negligible

_RUN_LOOPS = Entry(run_loops)  # one of a cluster's workers compiles it, and the others wait


@dataclass(frozen=True)
class LoopParameters:
    """One loop. Defaults are the bench rig's in mode active, with its hand and one cycle of
    delay.
    """

    inertia_kg_m2: float = 2.5e-3
    viscous_Nms_rad: float = 0.005
    coulomb_Nm: float = 0.14
    operator_inertia_kg_m2: float = 5e-4
    operator_damping_Nms_rad: float = 0.1
    operator_stiffness_Nm_rad: float = 5.0
    rate_Hz: float = 1000.0
    delay_s: float = 1e-3
    """From sampling to actuation: whole cycles and a fraction."""
    motor_lag_s: float = 1e-3
    motor_limit_Nm: float = 1.5
    torque_step_Nm: float = 0.18e-3 * 9.587
    count_rad: float = 2 * math.pi / (8192 * 9.587)
    relay: bool = False
    """True: the law is c sgn(v) with c = F_d; False: Karnopp's."""
    K_p_Nm_rad: float = 100.0
    F_s_Nm: float = 1.2
    F_d_Nm: float = 1.0
    friction_level: float = 1.0
    """Scales F_s and F_d."""
    velocity_band_counts: float = 2.0
    compensation_Nm: float = 0.97 * 0.14
    tap_rad_s: float = 2.0
    """Speed right after the initial tap: that of a light hand after 0.6 Nm for 10 ms.

    Below the velocity band nothing starts.
    """
    settle_s: float = 1.5
    window_s: float = 0.75

    @classmethod
    def of_axis(cls, axis: Axis, mode: str = "active", **changes: Any) -> LoopParameters:
        """Return the loop of `axis` in `mode`: its plant, hand, law, encoder, set-point's
        resolution; next_sync's delay (`bus.delay_cycles`).
        """
        (plant, hand), settings = axis.simulation, axis.mode[mode]
        scale = {signal.name: abs(signal.scale) for pdo in axis.pdos() for signal in pdo.signals}
        values: dict[str, Any] = {
            "inertia_kg_m2": plant.inertia_kg_m2,
            "viscous_Nms_rad": plant.viscous_Nms_rad,
            "coulomb_Nm": plant.coulomb_Nm + plant.brake_off_state_Nm,
            "operator_inertia_kg_m2": hand.inertia_kg_m2,
            "operator_damping_Nms_rad": hand.damping_Nms_rad,
            "operator_stiffness_Nm_rad": hand.stiffness_Nm_rad,
            "rate_Hz": 1.0 / axis.bus.period_s,
            "delay_s": axis.bus.period_s * axis.bus.cycles_to_actuation,
            "motor_lag_s": plant.motor_lag_s,
            "motor_limit_Nm": motor_limit_Nm(axis, mode),
            "torque_step_Nm": scale["motor.target_torque_Nm"],
            "count_rad": scale["motor.position_rad"],
            "K_p_Nm_rad": settings.K_p_Nm_rad,
            "F_s_Nm": settings.F_s_Nm,
            "F_d_Nm": settings.F_d_Nm,
            "velocity_band_counts": float(axis.law.velocity_band_counts),
            "compensation_Nm": settings.compensation * axis.mechanics.friction_Nm,
        }
        return cls(**(values | changes))

    def bounds(self) -> Bounds:
        """Return the literature's bounds for the stick spring K_p on this device, for any passive hand."""
        return bounds(
            self.K_p_Nm_rad,
            self.viscous_Nms_rad,
            self.coulomb_Nm,
            1.0 / self.rate_Hz,
            self.delay_s + self.motor_lag_s,
            self.count_rad,
        )


@dataclass(frozen=True)
class PointResult:
    """Result of one run of a loop, in its window."""

    quiet: bool
    frequency_Hz: float
    velocity_rms_rad_s: float
    counts_p2p: int
    flips_per_s: float
    trace: Floats
    """x [rad], v [rad/s], set-point [Nm] at the samples."""


@dataclass(frozen=True)
class OscillationMap:
    """The numbers of a map; arrays have a dimension per axis, in the order of `axes`."""

    axes: dict[str, Floats]
    base: LoopParameters
    taps_rad_s: tuple[float, ...]
    share: Floats
    """Share of the taps with oscillation: 0: quiet after all, 1: oscillating after all."""
    velocity_rms_rad_s: Floats
    """Largest over the taps."""
    frequency_Hz: Floats
    """Frequency for the tap with the largest velocity; NaN if quiet."""
    simulated_s: float
    elapsed_s: float = field(compare=False)

    @property
    def oscillates(self) -> npt.NDArray[np.bool_]:
        """Whether at least one tap starts a limit cycle."""
        shown: npt.NDArray[np.bool_] = self.share > 0
        return shown

    @property
    def speed(self) -> float:
        """Simulated seconds per second."""
        return self.simulated_s / self.elapsed_s if self.elapsed_s > 0 else math.inf

    def as_dict(self) -> dict[str, Any]:
        """Return the map as plain values for JSON: axes, the base, and the arrays as nested lists
        (NaN is null).
        """
        frequency = np.where(np.isnan(self.frequency_Hz), None, self.frequency_Hz)  # type: ignore[call-overload]
        return {
            "axes": {name: values.tolist() for name, values in self.axes.items()},
            "base": {f.name: getattr(self.base, f.name) for f in fields(self.base)},
            "taps_rad_s": list(self.taps_rad_s),
            "share": self.share.tolist(),
            "velocity_rms_rad_s": self.velocity_rms_rad_s.tolist(),
            "frequency_Hz": frequency.tolist(),
            "simulated_s": self.simulated_s,
            "elapsed_s": self.elapsed_s,
        }


DEFAULT_AXES: dict[str, Floats] = {
    "operator_inertia_kg_m2": np.geomspace(1e-4, 0.1, 16),
    "operator_damping_Nms_rad": np.geomspace(0.01, 10.0, 16),
    "operator_stiffness_Nm_rad": np.array([5.0, 50.0]),
    "rate_Hz": np.array([500.0, 1000.0, 2000.0]),
    "delay_s": np.array([0.0, 0.5e-3, 1e-3, 2e-3]),
    "friction_level": np.array([0.3, 1.0]),
}
DEFAULT_TAPS_RAD_S = (1.0, 3.0)

LOOP_OF_PARAMETER = {  # field of LOOP -> parameter that is copied unchanged
    "friction": "coulomb_Nm",
    "compensation": "compensation_Nm",
    "lag": "motor_lag_s",
    "limit": "motor_limit_Nm",
    "torque_step": "torque_step_Nm",
    "count": "count_rad",
    "delay": "delay_s",
    "relay": "relay",
    "K_p": "K_p_Nm_rad",
    "band_counts": "velocity_band_counts",
    "settle": "settle_s",
    "window": "window_s",
}
POSITIVE = ("inertia_kg_m2", "rate_Hz", "count_rad", "K_p_Nm_rad", "window_s")
BOOLEAN_OR_SIGNED = ("relay", "tap_rad_s")


def _loops(values: Mapping[str, Any], shape: tuple[int, ...]) -> Array:
    """Return LOOP records (flat) of parameters that broadcast to `shape`.

    An invalid parameter raises with its name.
    """
    flat: dict[str, Array] = {}
    for name, value in values.items():
        column = np.broadcast_to(np.asarray(value, np.float64), shape).ravel()
        low = 0.0 if name not in BOOLEAN_OR_SIGNED else -np.inf
        invalid = ~np.isfinite(column) | (column < low) | ((column == 0) if name in POSITIVE else False)
        if np.any(invalid):
            domain = "a finite number above 0" if name in POSITIVE else "a finite number of at least 0"
            raise ValueError(f"{name} = {column[invalid][0]!r}: expected {domain}")
        flat[name] = column
    cycles = flat["delay_s"] * flat["rate_Hz"]
    if np.any(cycles > MOST_DELAY_CYCLES):
        raise ValueError(
            f"delay_s = {flat['delay_s'][np.argmax(cycles)]:g}: {np.max(cycles):.0f} cycles; expected at most {MOST_DELAY_CYCLES}"
        )
    if np.any(flat["delay_s"] >= flat["window_s"]):
        raise ValueError(
            f"delay_s = {np.max(flat['delay_s']):g} is longer than the window of {np.min(flat['window_s']):g} s"
        )
    loops = np.zeros(len(cycles), LOOP)
    for name, parameter in LOOP_OF_PARAMETER.items():
        loops[name] = flat[parameter]
    loops["inertia"] = flat["inertia_kg_m2"] + flat["operator_inertia_kg_m2"]
    loops["damping"] = flat["viscous_Nms_rad"] + flat["operator_damping_Nms_rad"]
    loops["stiffness"] = flat["operator_stiffness_Nm_rad"]
    loops["period"] = 1.0 / flat["rate_Hz"]
    loops["F_s"] = flat["F_s_Nm"] * flat["friction_level"]
    loops["F_d"] = flat["F_d_Nm"] * flat["friction_level"]
    loops["v0"] = flat["tap_rad_s"]
    return loops


def run_chunk(loops: Array) -> Array:
    """Run LOOP records and return their STATS: the task of threads and cluster workers."""
    out = new_records(StatsRecord, len(loops))
    _RUN_LOOPS(
        np.array(loops).view(np.recarray),
        new_records(MotionRecord),
        new_records(LawRecord),
        new_records(LawStateRecord),
        out,
        np.zeros((0, 3)),
    )
    return np.asarray(out)


def _quiet(stats: Array) -> npt.NDArray[np.bool_]:
    """Return where nothing oscillates: at rest, moving on without reversal, or decaying."""
    still = (stats["counts_p2p"] <= QUIET_COUNTS) | (stats["reversals"] < 2)
    quiet: npt.NDArray[np.bool_] = still | (stats["late_rms"] < DYING_OUT * stats["velocity_rms"])
    return quiet


def simulate_point(point: LoopParameters) -> PointResult:
    """Run one loop and keep its course.

    Raises
    ------
    ValueError
        a parameter is negative, not finite, or the delay is too long; the text has its name
    """
    loops = _loops({f.name: getattr(point, f.name) for f in fields(point)}, (1,))
    out = new_records(StatsRecord)
    trace = np.zeros((round((point.settle_s + point.window_s) * point.rate_Hz), 3))
    _RUN_LOOPS(
        loops.view(np.recarray),
        new_records(MotionRecord),
        new_records(LawRecord),
        new_records(LawStateRecord),
        out,
        trace,
    )
    stats = out[0]
    return PointResult(
        quiet=bool(_quiet(out)[0]),
        frequency_Hz=float(stats["frequency"]),
        velocity_rms_rad_s=float(stats["velocity_rms"]),
        counts_p2p=int(stats["counts_p2p"]),
        flips_per_s=float(stats["torque_flips"]) / point.window_s,
        trace=trace,
    )


def _in_threads(chunks: Sequence[Array], workers: int) -> Iterator[tuple[int, Array]]:
    with ThreadPoolExecutor(workers) as pool:  # the kernel releases the GIL
        tasks = {pool.submit(run_chunk, chunk): i for i, chunk in enumerate(chunks)}
        for task in as_completed(tasks):
            yield tasks[task], task.result()


def _on_cluster(chunks: Sequence[Array], address: str) -> Iterator[tuple[int, Array]]:
    try:
        cluster: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise ImportError(
            "a dask cluster needs dask and distributed: pip install -e '.[cluster]' in the clone"
        ) from error
    with cluster.Client(address, timeout=10) as client:
        tasks = {task: i for i, task in enumerate(client.map(run_chunk, chunks, pure=False))}
        for task, result in cluster.as_completed(list(tasks), with_results=True):
            yield tasks[task], result


def oscillation_map(
    axes: Mapping[str, Any] | None = None,
    *,
    base: LoopParameters | Rig | str | None = None,
    taps_rad_s: Sequence[float] = DEFAULT_TAPS_RAD_S,
    dask: str | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> OscillationMap:
    """Compute a map over `axes`.

    Parameters
    ----------
    axes
        Name of a field of `LoopParameters` -> its values; every combination is a point. Default:
        `DEFAULT_AXES`, 12,288 points.
    base
        The other parameters: a `LoopParameters`, or a rig (its mode active). Default: the bench rig.
    taps_rad_s
        Speeds after the tap that starts a run; each point runs once per speed.
    dask
        Address of a dask.distributed scheduler, as in "tcp://127.0.0.1:8786"; its workers need this
        package. Default: local threads.
    workers
        Threads; default one per processor.
    progress
        Called with the finished share of the work, 0 to 1.

    Raises
    ------
    ValueError
        an unknown axis, an invalid value, or an empty axis
    ImportError
        `dask` is given, and dask.distributed is not installed
    """
    if base is None or isinstance(base, str):
        base = load_rig(base or "bench")
    if isinstance(base, Rig):
        base = LoopParameters.of_axis(base.one_axis())
    grid = {
        name: np.atleast_1d(np.asarray(v, np.float64)) for name, v in (DEFAULT_AXES if axes is None else axes).items()
    }
    names = [f.name for f in fields(LoopParameters)]
    for name, column in grid.items():
        if name not in names or name == "tap_rad_s":
            raise ValueError(f"no axis {name!r}; there is {', '.join(n for n in names if n != 'tap_rad_s')}")
        if column.ndim != 1 or not len(column):
            raise ValueError(f"axis {name}: expected one or more values in a row")
    if not len(taps_rad_s):
        raise ValueError("taps_rad_s: expected one or more speeds; without a tap the display stays stuck")
    shape = (*(len(v) for v in grid.values()), len(taps_rad_s))
    values: dict[str, Any] = {f.name: getattr(base, f.name) for f in fields(base)}
    for axis, (name, column) in enumerate(grid.items()):
        values[name] = column.reshape([-1 if i == axis else 1 for i in range(len(shape))])
    values["tap_rad_s"] = np.asarray(taps_rad_s, np.float64)
    loops = _loops(values, shape)

    run_chunk(loops[:0])  # compile or load before timing starts
    began = perf_counter()
    chunks = [loops[i : i + CHUNK] for i in range(0, len(loops), CHUNK)]
    stats = np.zeros(len(loops), STATS)
    source = _on_cluster(chunks, dask) if dask else _in_threads(chunks, workers or os.cpu_count() or 1)
    for done, (i, chunk) in enumerate(source, 1):
        stats[i * CHUNK : i * CHUNK + len(chunk)] = chunk
        if progress is not None:
            progress(done / len(chunks))
    elapsed = perf_counter() - began

    moving = (~_quiet(stats)).reshape(shape)
    rms = stats["velocity_rms"].reshape(shape)
    loudest = np.argmax(np.where(moving, rms, -1.0), axis=-1)[..., None]
    frequency = np.where(moving, stats["frequency"].reshape(shape), np.nan)
    return OscillationMap(
        axes=dict(grid),
        base=base,
        taps_rad_s=tuple(float(t) for t in taps_rad_s),
        share=np.mean(moving, axis=-1),
        velocity_rms_rad_s=np.max(rms, axis=-1),
        frequency_Hz=np.take_along_axis(frequency, loudest, -1)[..., 0],
        simulated_s=float(np.sum(stats["samples"] * loops["period"])),
        elapsed_s=elapsed,
    )


def at(chart: OscillationMap, **values: float) -> OscillationMap:
    """Return the map's slice at the points nearest to `values` (axis=value).

    Other axes are kept.
    """
    index: list[Any] = []
    axes = {}
    changed: dict[str, Any] = {}
    for name, points in chart.axes.items():
        if name in values:
            i = int(np.argmin(np.abs(points - values[name])))
            changed[name] = float(points[i])
            index.append(i)
        else:
            axes[name] = points
            index.append(slice(None))
    key = tuple(index)
    return replace(
        chart,
        axes=axes,
        base=replace(chart.base, **changed),
        share=chart.share[key],
        velocity_rms_rad_s=chart.velocity_rms_rad_s[key],
        frequency_Hz=chart.frequency_Hz[key],
    )
