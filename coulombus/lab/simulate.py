"""Run the rig in virtual time: bring-up, arming, display, safe end - over real PDOs, recorded like a real run."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.host.cycle.records import Trip
from coulombus.host.laws.law_source import law_attachments
from coulombus.host.run.buses import merged, path_on
from coulombus.host.run.result import RunResult
from coulombus.host.run.run_sequence import Course, Figures
from coulombus.host.setup.bringup import check_plan, release, shut_down
from coulombus.host.setup.law_demand import check_demand
from coulombus.lab.plane_figures import plane_figures
from coulombus.lab.set_up import give_back, ready_world, set_up
from coulombus.lab.virtual_bringup import switch_on
from coulombus.lab.virtual_world import VirtualWorld, WorldFunction, with_world
from coulombus.recording.measures import Measures, measure
from coulombus.recording.memory_recording import MeasuredFrames
from coulombus.recording.output_file import check as check_output
from coulombus.recording.output_file import open_new
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.recording.recorder import About, Recorder
from coulombus.rigs.arguments import a_number, path_text, texts
from coulombus.rigs.errors import nearest
from coulombus.rigs.rig import Rig, load_rig
from coulombus.sim_bus.faults.fault_file import FaultPlan, read_faults
from coulombus.sim_bus.faults.injection import Injection, controllers_of
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.plant import truth_columns
from coulombus.system.errors import CoulombusError
from coulombus.wire.clock import bus_ns
from coulombus.wire.frame import Records

__all__ = ["TruthError", "simulate"]

PROGRESS_NS = 250_000_000
LOOK_NS = 1_000_000_000
"""Longest step of a run without progress display or output files."""
TRUTH_BYTES = 8e9


class TruthError(CoulombusError):
    """The plant's true course cannot be saved."""

    exit_status = 2


class _VirtualRun(Course):
    """The course of a run in virtual time; times are the world's."""

    def __init__(self, order: _Order) -> None:
        rig, mode, seed = order.rig, order.mode, order.seed
        on_frames = None if order.record is None and not order.measured else self._write
        ready = ready_world(rig, mode, seed) if order.only_figures and order.simulated is rig else None
        self.is_ready = ready is not None
        """Whether the world has completed its set-up."""
        self.world, losses = ready or (
            VirtualRig(
                order.simulated,
                mode,
                believed=rig,
                seed=seed,
                truth=order.truth is not None,
                tip=order.measured or order.record is not None,
            ),
            (),
        )
        self.world.on_frames = on_frames
        super().__init__(self.world.controllers, order.record, order.progress)
        self.losses = losses
        plants = [axis.simulation.plant for axis in order.simulated.axes]
        warms = any(plant.heat is not None or plant.coil_thermal_K_W > 0 for plant in plants)
        shows = order.progress is not None or order.record is not None
        self._look_ns = PROGRESS_NS if shows or warms else LOOK_NS  # heat flows in the steps of a recorded run
        self.only_figures = order.only_figures
        self.measured = MeasuredFrames(rig) if order.measured else None
        if order.record is not None:
            about = About(law=law_attachments(rig), law_state=self.world.controller.law_state)
            self.recorder = Recorder(order.record, rig, mode, seed, about=about, force=order.force)
            self.world.on_host = self._write_host
            self.world.keep_told()
        self.world.on_change = lambda change: self.mark(self.world.t_ns, change.marker)
        self.outside = order.outside
        self.injection: Injection | None = None
        self.ended_ns = 0
        """Time of the host's end, after its safe state."""

    def _write(self, frames: Records) -> None:
        if self.measured is not None:
            self.measured.write(frames)
        messages = self.world.take_told()
        frames = frames.view(np.ndarray)  # a recarray looks each field up in Python
        if len(messages):  # at equal times, bus frames first
            frames = np.concatenate((frames, messages))
            frames = frames.take(np.argsort(frames["t_ns"], kind="stable"))
        self.record(lambda recorder: recorder.write(frames))

    def _write_host(self, had: Records, events: Records, sent: Records) -> None:
        models = self.world.models.take_rows()
        self.record(lambda recorder: recorder.keep_models(models))
        self.record(lambda recorder: recorder.trace(~had, events, sent))

    @property
    def now_ns(self) -> int:
        """The world's time."""
        return self.world.t_ns

    @property
    def starts_ns(self) -> tuple[int | None, ...]:
        """Time at which each axis' drive entered Operation Enabled; the host learns of it slightly later."""
        return self.world.starts_ns

    @property
    def safe_ns(self) -> int | None:
        """Time at which the first axis entered its safe state, by the world's clock, not the host's."""
        safe_ns = self.k.safe_ns
        return None if safe_ns is None else int(bus_ns(self.world.host_clock, safe_ns))

    def look(self, until_ns: int, done: Callable[[], bool]) -> bool:
        """Run in steps short enough to show progress and to write the recording."""
        world = self.world
        world.run_until(min(until_ns, world.t_ns + self._look_ns), done)
        waiting = self.k.host["waiting"] != 0
        if self.k.done and waiting.any():  # the run ends with a whole cycle of all axes
            window_ns = int(self.k.host["next_ns"][waiting].max())
            world.run_until(int(bus_ns(world.host_clock, window_ns)) + 1)
        self.mark_course(world.t_ns + (world.t_ns < until_ns))  # an event at the display's end is excluded
        world.flush()
        if self.recorder is None:
            world.models.take_rows()  # nobody keeps them
        enabled = self.enabled_ns
        if self.progress is not None and enabled is not None:
            self.progress((world.t_ns - enabled) * 1e-9)
        return not self.k.ending

    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Ask the host for the safe state."""
        self.world.ask_to_stop(trip)

    def course(self, seconds: float) -> None:
        """Power on, bring up, arm, display for `seconds` from Operation Enabled, and end safely."""
        world, k = self.world, self.k
        if not self.is_ready:
            self.losses = (set_up if self.only_figures else switch_on)(world)
        self.mark(world.t_ns, f"run {k.mode}")
        world.start_host()
        if self.outside is not None:
            self.outside.begin(world)
        self.display(seconds)
        self.make_safe()
        world.stop_host()
        self.ended_ns = world.t_ns
        if not self.only_figures:
            release(k, world)  # a few milliseconds: the nodes have not missed its heartbeat yet
            shut_down(world)

    def mark(self, t_ns: int, text: str) -> None:
        """Add a marker to the recording or measurement at `t_ns`."""
        if self.measured is not None:
            self.measured.mark(t_ns, text)
        super().mark(t_ns, text)

    def figures(self) -> Figures:
        """Return the display's figures, from the frames in memory if they were kept."""
        if self.measured is None:
            return super().figures()
        if self.enabled_ns is None:
            return Figures([Measures() for _ in self.k], None)
        return Figures([measure(recording) for recording in self.measured.recordings()], None)

    def close(self) -> None:
        """Write the rest and close the recording."""
        self.mark_trip()
        self.world.flush()
        if self.recorder is not None:
            try:
                self.recorder.close()
            except RecordingError as error:
                self.failure = self.failure or str(error)

    def result(self) -> RunResult:
        """Return the result of the run."""
        k, enabled, trip = self.k, self.enabled_ns, self.trip
        return self.result_of(
            self.figures(),
            missed_deadlines=int(k.host[0]["late_cycles"]),
            simulated_s=0.0 if enabled is None else (self.ended_ns - enabled) * 1e-9,
            counters=k.counters(),
            exit_status=7 if trip else 0,
            opened=list(self.world.opened) or None,
            trip_ns=int(bus_ns(self.world.host_clock, k.trip_ns)) if k.trip_ns else None,
            faults=None if self.injection is None else self.injection.results(),
            controllers=None if self.injection is None else controllers_of(self.world),
            plane=self._plane(),
        )

    def _plane(self) -> dict[str, Any] | None:
        """Return the figures of an arm in the plane."""
        model, enabled = self.k.plane_model, self.enabled_ns
        figures = self.k.plane_figures()
        if model is None or figures is None or enabled is None or not (self.measured or self.recorder):
            return figures
        return figures | plane_figures(self.world.rig, model.law, self.world.tip_course(), enabled * 1e-9)


def simulate(
    rig: Rig | str | os.PathLike[str] = "bench",
    mode: str = "hybrid",
    seconds: float = 13.0,
    *,
    record: str | os.PathLike[str] | None = None,
    seed: int = 0,
    truth: str | os.PathLike[str] | None = None,
    overrides: tuple[str, ...] = (),
    script: Callable[[VirtualRig], None] | None = None,
    faults: FaultPlan | str | os.PathLike[str] | None = None,
    progress: Callable[[float], None] | None = None,
    force: bool = False,
    simulated: Rig | None = None,
    measured: bool | None = None,
    world: WorldFunction | None = None,
    world_every: int = 1,
) -> RunResult:
    """Run the rig in virtual time and return the result.

    Parameters
    ----------
    rig : a rig, the name of a packaged one, or a path
    mode : ``active``, ``passive`` or ``hybrid``
    seconds : length of the display, from Operation Enabled
    record : write a pcapng recording there, and compute the display's figures from it
    seed : random seed; same seed, same bytes
    truth : save the plant's true course there (npz, the arrays of
        `sim_bus.rig.plant.TRUTH_COLUMNS`)
    overrides : ``SECTION.KEY=VALUE`` of the rig file
    script : called before power-on; plans faults with ``world.at(t_ns, action)``
    faults : a fault file (docs/bus.md): bus faults and their times
    progress : called with the display's time in s every 0.25 s of it
    force : overwrite existing `record` and `truth`
    simulated : the true rig if it differs from the host's `rig`: it has plant, hand and devices; same buses, same nodes
    measured : compute the display's figures from the frames in memory, 48 bytes per cycle of an
        axis; a recorded file then has no checksum (`RunResult.recording_sha256`). None: only if
        nothing is recorded. False without a recording: no figures
    world : called with the `coulombus.host.world.state.State` of each axis between two cycles of
        the display; returns what the handle meets from the next cycle on (docs/worlds.md), or None
    world_every : number of cycles between two calls of `world`

    Raises
    ------
    coulombus.host.errors.HostError
        a node is missing, refuses a value or differs from the rig file; nothing was armed
    coulombus.rigs.rig.RigError, coulombus.host.laws.laws.LawError,
    coulombus.recording.pcapng_blocks.RecordingError
        the rig file, the law or the recording's path is wrong, or a limit would cut the law off
    FileExistsError
        `record` or `truth` exists, and `force` was not given; nothing was run
    coulombus.sim_bus.faults.fault_file.FaultError
        the fault file is wrong
    coulombus.rigs.arguments.WrongCall
        an argument has the wrong type
    """
    outside = None if world is None else VirtualWorld(world, world_every)
    for name, given in (("record", record), ("truth", truth)):
        if given is not None:
            path_text(given, name, f'simulate({name}="run.{"npz" if name == "truth" else "pcapng"}")')
    wrong = faults if faults is None or isinstance(faults, FaultPlan) else read_faults(_fault_file(faults))
    overrides = texts(overrides, "overrides", "mode.active.F_s_Nm=1.0")
    chosen = rig.variant(*overrides) if isinstance(rig, Rig) else load_rig(rig, overrides)
    if outside is not None:
        chosen = with_world(chosen)
    if mode not in chosen.modes:
        raise ValueError(f"mode {mode!r}: the rig has {', '.join(chosen.modes)}{nearest(mode, chosen.modes)}")
    a_number(seconds, "seconds", "13.0")
    a_number(seed, "seed", "7", whole=True)
    if not (math.isfinite(seconds) and seconds > 0):
        raise ValueError(f"seconds {seconds!r}: expected a number above 0")
    if record is not None or truth is not None or not chosen.one_cycle:
        check_plan(chosen)  # before a file is created; bring-up refuses it, too
    check_demand(chosen, mode)
    for path in (Path(given) for given in (record, truth) if given is not None):
        for file in [path] if chosen.one_cycle else [path_on(path, channel) for channel in chosen.channels]:
            check_output(file, force=force)  # known before the first bus is run
    if truth is not None:
        axes = (simulated or chosen).axes
        size = sum(
            seconds / axis.simulation.plant.step_s * 8 * len(truth_columns(axis.simulation.plant)) for axis in axes
        )
        if size > TRUTH_BYTES:
            raise TruthError(
                f"{truth}: {size / 1e9:.0f} GB of truth; show less than {seconds:g} s, or raise plant.step_s"
            )
    if wrong is not None and chosen.one_cycle:
        wrong = wrong.on_one(chosen.channels)
    order = _Order(
        rig=chosen,
        simulated=simulated or chosen,
        mode=mode,
        seconds=seconds,
        record=None if record is None else Path(record),
        seed=seed,
        truth=None if truth is None else Path(truth),
        script=script,
        faults=wrong,
        progress=progress,
        force=force,
        measured=record is None if measured is None else measured,
        only_figures=bool(measured) and all(option is None for option in (record, truth, script, faults, world)),
        outside=outside,
    )
    return _simulate_bus(order) if chosen.one_cycle else _simulate_buses(order)


def _fault_file(faults: str | os.PathLike[str]) -> Path:
    return Path(path_text(faults, "faults", 'simulate(faults="faults.csv")'))


@dataclass(frozen=True)
class _Order:
    """The checked arguments of `simulate`."""

    rig: Rig
    simulated: Rig
    mode: str
    seconds: float
    record: Path | None
    seed: int
    truth: Path | None
    script: Callable[[VirtualRig], None] | None
    faults: FaultPlan | None
    progress: Callable[[float], None] | None
    force: bool
    measured: bool
    outside: VirtualWorld | None
    only_figures: bool
    """Whether only the run's figures are needed: then the set-up may be an earlier run's, and the
    part after the host's end is skipped.
    """

    def on(self, channel: str, stop_ns: int | None) -> _Order:
        """Return the order for one bus, whose host is stopped at `stop_ns`.

        It has separate files.
        """

        def script(world: VirtualRig) -> None:
            if self.script is not None:
                self.script(world)
            if stop_ns is not None:
                world.at(stop_ns, lambda _: world.ask_to_stop(Trip.OTHER_AXIS))

        record = None if self.record is None else path_on(self.record, channel)
        truth = None if self.truth is None else path_on(self.truth, channel)
        faults = None if self.faults is None else self.faults.on(channel, self.rig.channels)
        rig = self.rig.on(channel)
        return replace(
            self,
            rig=rig,
            simulated=rig if self.simulated is self.rig else self.simulated.on(channel),
            record=record,
            truth=truth,
            script=None if self.script is None and stop_ns is None else script,
            faults=faults,
        )


def _simulate_buses(order: _Order) -> RunResult:
    """Run each bus of the rig.

    If one trips, the others are run again and stopped at that instant.

    The buses share nothing else, so sequential runs are exact.
    """
    orders = {channel: order.on(channel, None) for channel in order.rig.channels}
    results = {channel: _simulate_bus(bus_order) for channel, bus_order in orders.items()}
    trips = {result.trip_ns: channel for channel, result in results.items() if result.trip_ns}
    if trips:
        first, again = min(trips), replace(order, force=True)  # its files are those of the first run
        results = {c: r if c == trips[first] else _simulate_bus(again.on(c, first)) for c, r in results.items()}
    parts = {channel: result.as_dict() for channel, result in results.items()}
    return RunResult(**merged(parts, {channel: result.exit_status for channel, result in results.items()}))


def _simulate_bus(order: _Order) -> RunResult:
    """Run the axes of one bus."""
    if order.truth is not None:  # check before the run that it can be written
        _create(order.truth, force=order.force)
    run = _VirtualRun(order)
    try:
        if order.faults is not None:
            run.injection = Injection(
                run.world, order.faults, order.seed, run.mark if run.recorder or run.measured else None
            )
        if order.script is not None:
            order.script(run.world)
        run.course(order.seconds)
    except BaseException:  # refused, or interrupted: the recording stays readable
        run.close()
        raise
    run.close()
    if order.truth is not None:
        _save(order.truth, run.world.truth())
    result = run.result()
    if order.only_figures:
        give_back(run.world)
    return result


def _create(path: Path, *, force: bool) -> None:
    try:
        os.close(open_new(path, force=force))
    except OSError as error:
        raise _no_truth(path, error) from error


def _save(path: Path, arrays: Mapping[str, Any]) -> None:
    try:
        with path.open("wb") as file:  # given a name, numpy would append .npz to it
            np.savez(file, **arrays)
    except OSError as error:
        raise _no_truth(path, error) from error


def _no_truth(path: Path, error: OSError) -> TruthError:
    reason = error.strerror or error
    return TruthError(f"{path}: the truth cannot be written ({reason}); name a file with room for it")
