"""One run of the rig in virtual time: bring-up, arming, display, safe end - over real PDOs, recorded like a real one."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eds.rig import Rig, load_rig
from host.bringup import shut_down
from host.records import Phase, Trip
from lab.measures import Measures, measure
from lab.recorder import Recorder
from lab.world import VirtualRig
from scope.recording import read
from sim_bus.plant import TRUTH_COLUMNS
from wire.frame import Records
from wire.pcapng import RecordingError

__all__ = ["RunResult", "TruthError", "simulate"]

PROGRESS_NS = 250_000_000
SAFE_TIMEOUT_NS = 5_000_000_000
TRUTH_BYTES = 8e9


@dataclass(frozen=True)
class RunResult:
    """What a run came to. Figures of the display are None when nothing was recorded, or without the phase they belong to."""

    mode: str
    cycles: int
    """Cycles from Operation Enabled to the end of the display."""
    period_ns: int
    missed_deadlines: int
    lost_pdos: int
    wakeup_us: dict[str, float] | None
    cpu_us_per_cycle: float | None
    recording: str | None
    recording_sha256: str | None
    trip: str | None
    hold_velocity_rms_rad_s: float | None
    hold_counts_p2p: int | None
    stick_velocity_rms_rad_s: float | None
    torque_flips_per_s: float | None
    hold_peak_Hz: float | None
    hold_push_Nm: float | None
    sign_check: str
    simulated_s: float
    counters: dict[str, int]
    exit_status: int
    bus: str | None = None
    """Where the run was; None in virtual time, and with it everything that follows."""
    sync_to_rpdo_us: dict[str, float] | None = None
    real_time: list[dict[str, Any]] | None = None
    """Each real-time right that the data plane asked for: name, granted, detail, remedy."""
    deadman: str | None = None
    stopped_by: str | None = None
    """Who ended the run before its time without a trip: SIGINT, SIGTERM, "coulombus stop"."""

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return asdict(self)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, read in blocks."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class TruthError(Exception):
    """The plant's true course cannot be saved."""

    exit_status = 2


class _Run:
    """The course of one run; `finish` makes its result."""

    def __init__(
        self, rig: Rig, mode: str, seed: int, record: Path | None, truth: bool, progress: Callable[[float], None] | None
    ) -> None:
        self.recorder = Recorder(record, rig, mode, seed) if record is not None else None
        self.record = record
        self.progress = progress
        self.failure: str | None = None
        self.world = VirtualRig(rig, mode, seed=seed, truth=truth, on_frames=self._write if self.recorder else None)
        self.k = self.world.controller

    def _write(self, frames: Records) -> None:
        if self.recorder is None or self.failure is not None:
            return
        try:
            self.recorder.write(frames)
        except RecordingError as error:
            self.failure = str(error)
            self.k.stop(Trip.RECORDING)

    def mark(self, t_ns: int, text: str) -> None:
        if self.recorder is not None:
            self.recorder.mark(t_ns, text)

    def _until(self, t_ns: int, done: Callable[[], bool]) -> None:
        """Run to `t_ns` in steps short enough to show progress and to write what was recorded."""
        world = self.world
        while world.t_ns < t_ns and not done():
            world.run_until(min(t_ns, world.t_ns + PROGRESS_NS), done)
            world.flush()
            if self.progress is not None and world.enabled_ns is not None:
                self.progress((world.t_ns - world.enabled_ns) * 1e-9)

    def course(self, seconds: float) -> None:
        """Power on, bring up, arm, display for `seconds` from Operation Enabled on, and end safely."""
        world, k, rig = self.world, self.k, self.world.rig
        world.bring_up()
        self.mark(world.t_ns, f"run {k.mode}")
        world.start_host()
        arming_ns = round(2e9 * (rig.limits.still_timeout_s + 1))
        self._until(world.t_ns + arming_ns, lambda: world.enabled_ns is not None or k.phase >= Phase.SAFE)
        if world.enabled_ns is not None:
            self._mark_phases(world.enabled_ns, seconds)
            end = world.enabled_ns + round(seconds * 1e9)
            self._until(end, lambda: k.phase >= Phase.SAFE)
        k.stop()
        self._until(world.t_ns + SAFE_TIMEOUT_NS, lambda: k.phase >= Phase.SAFE)
        trip = int(k.host["trip_ns"][0]), k.trip
        self.mark(*((trip[0], f"trip {trip[1]}") if trip[1] else (world.t_ns, "safe")))
        self._until(world.t_ns + SAFE_TIMEOUT_NS, lambda: k.phase is Phase.DONE)
        world.stop_host()
        shut_down(world)

    def _mark_phases(self, start_ns: int, seconds: float) -> None:
        starts = self.world.operator.starts_s
        names = [phase.kind for phase in self.world.rig.phases] + ["end"]
        for begin, name in zip(starts, names, strict=True):
            if begin < seconds:
                self.mark(start_ns + round(begin * 1e9), f"phase {name}")
        if starts[-1] >= seconds:
            self.mark(start_ns + round(seconds * 1e9), "phase end")

    def close(self) -> None:
        """Write what is left and close the recording."""
        self.world.flush()
        if self.recorder is not None:
            try:
                self.recorder.close()
            except RecordingError as error:
                self.failure = self.failure or str(error)

    def result(self) -> RunResult:
        k, h = self.k, self.k.host[0]
        trip = k.trip
        if self.failure is not None:
            trip = f"RECORDING: {self.failure}"
        figures = Measures()
        regular = self.record is not None and self.record.is_file()
        if regular and self.record is not None and self.failure is None:
            figures = measure(read(self.record))
        enabled = self.world.enabled_ns
        return RunResult(
            mode=k.mode,
            cycles=int(h["display_cycles"]),
            period_ns=int(k.control["period_ns"][0]),
            missed_deadlines=int(h["missed_deadlines"]),
            lost_pdos=int(h["lost_pdos"]),
            wakeup_us=None,
            cpu_us_per_cycle=None,
            recording=str(self.record) if self.record is not None else None,
            recording_sha256=file_sha256(self.record) if regular and self.record is not None else None,
            trip=trip,
            **asdict(figures),
            sign_check=k.sign_result.name.lower(),
            simulated_s=0.0 if enabled is None else (self.world.t_ns - enabled) * 1e-9,
            counters=k.counters(),
            exit_status=7 if trip else 0,
        )


def simulate(
    rig: Rig | str = "bench",
    mode: str = "hybrid",
    seconds: float = 13.0,
    *,
    record: str | os.PathLike[str] | None = None,
    seed: int = 0,
    truth: str | os.PathLike[str] | None = None,
    overrides: tuple[str, ...] = (),
    script: Callable[[VirtualRig], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> RunResult:
    """Run the rig in virtual time and return what came of it.

    Parameters
    ----------
    rig : a rig, the name of a packaged one, or a path
    mode : ``active``, ``passive`` or ``hybrid``
    seconds : length of the display, from Operation Enabled on
    record : write a pcapng recording there; the display's figures are computed from it
    seed : of everything random; same seed, same bytes
    truth : save the plant's true course there (npz, the arrays of `sim_bus.plant.TRUTH_COLUMNS`)
    overrides : ``SECTION.KEY=VALUE`` of the rig file
    script : called before power-on; plans faults with ``world.at(t_ns, action)``
    progress : called with the display's time in s every 0.25 s of it

    Raises
    ------
    host.errors.HostError
        a node is missing, refuses a value or is not what the rig file says; nothing was armed
    eds.rig.RigError, host.laws.LawError, wire.pcapng.RecordingError
        the rig file, the law or the recording's path is wrong
    """
    chosen = rig.variant(*overrides) if isinstance(rig, Rig) else load_rig(rig, overrides)
    if mode not in chosen.mode:
        raise ValueError(f"mode {mode!r}: the rig has {', '.join(chosen.mode)}")
    if not (math.isfinite(seconds) and seconds > 0):
        raise ValueError(f"seconds {seconds!r}: expected a number above 0")
    if truth is not None:
        size = seconds / chosen.plant.step_s * 8 * len(TRUTH_COLUMNS)
        if size > TRUTH_BYTES:
            raise TruthError(
                f"{truth}: {size / 1e9:.0f} GB of truth; show less than {seconds:g} s, or raise plant.step_s"
            )
        _save(Path(truth))  # whether it can be written is better known before the run
    run = _Run(chosen, mode, seed, Path(record) if record is not None else None, truth is not None, progress)
    try:
        if script is not None:
            script(run.world)
        run.course(seconds)
    except BaseException:  # refused, or interrupted: what was recorded stays readable
        run.close()
        raise
    run.close()
    if truth is not None:
        _save(Path(truth), run.world.truth())
    return run.result()


def _save(path: Path, arrays: Mapping[str, Any] | None = None) -> None:
    try:
        with path.open("ab" if arrays is None else "wb") as file:  # given a name, numpy would append .npz to it
            if arrays is not None:
                np.savez(file, **arrays)
    except OSError as error:
        raise TruthError(
            f"{path}: the truth cannot be written ({error.strerror or error}); name a file with room for it"
        ) from error
