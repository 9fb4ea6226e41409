"""The course of a run in virtual time: bring-up, arming, display, safe end - over real PDOs, recorded like a real run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.host.cycle.records import Trip
from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Code, Run
from coulombus.host.run.run_recording import begin_recording
from coulombus.host.run.run_sequence import Course, Figures
from coulombus.host.setup.bringup import release, shut_down
from coulombus.kernels.records import Records
from coulombus.lab.plane_figures import plane_figures
from coulombus.lab.set_up import ready_world, return_world, set_up
from coulombus.lab.virtual_world import VirtualWorld
from coulombus.recording.measures import Measures, measure
from coulombus.recording.memory_recording import MeasuredFrames
from coulombus.recording.output_file import open_new
from coulombus.recording.pcapng_blocks import RecordingError
from coulombus.sim_bus.faults.fault_file import FaultPlan, faults_of
from coulombus.sim_bus.faults.injection import Injection, controllers_of
from coulombus.sim_bus.network.script import script_of
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.system.errors import CoulombusError
from coulombus.wire.clock import bus_ns

__all__ = ["TruthError", "VirtualCourse"]

PROGRESS_NS = 250_000_000
LOOK_NS = 1_000_000_000
"""Longest step of a run without progress display or output files."""


class TruthError(CoulombusError):
    """The plant's true course cannot be saved."""

    exit_status = 2


class VirtualCourse(Course):
    """The course of a run in virtual time, on one bus of its rig; times are the world's.

    Parameters
    ----------
    channel : the bus; None: all, which one host serves
    progress : called with the display's time in s
    on_world : called with the world before power-on; it only looks on
    stop_ns : stop the host then, for a trip on another bus
    """

    def __init__(
        self,
        run: Run,
        channel: str | None = None,
        progress: Callable[[float], None] | None = None,
        on_world: Callable[[VirtualRig], None] | None = None,
        stop_ns: int | None = None,
    ) -> None:
        self._faults, self._script = _faults(run, channel), _script(run)
        self._on_world, self._stop_ns = on_world, stop_ns
        rig, simulated, outputs = run.rig, run.simulated or run.rig, run.outputs
        if channel is not None:
            rig, outputs = rig.on(channel), outputs.on(channel)
            simulated = rig if run.simulated is None else simulated.on(channel)
        self._run = replace(run, outputs=outputs)
        measured = outputs.record is None if outputs.measured is None else outputs.measured
        self.only_figures = bool(outputs.measured) and not any(
            (outputs.record, outputs.truth, run.script, run.faults, run.world)
        )
        """Whether only the run's figures are needed: then the set-up may be an earlier run's, and the
        part after the host's end is skipped.
        """
        ready = ready_world(rig, run.mode, run.seed) if self.only_figures and simulated is rig else None
        self._ready_losses: tuple[str, ...] | None
        """The losses of a world that has completed its set-up in an earlier run."""
        self.world, self._ready_losses = ready or (
            VirtualRig(
                simulated,
                run.mode,
                believed=rig,
                seed=run.seed,
                truth=outputs.truth is not None,
                tip=measured or outputs.record is not None,
            ),
            None,
        )
        self.world.on_frames = self._write if measured or outputs.record is not None else None
        super().__init__(self.world.controllers, outputs.record, progress)
        plants = [axis.simulation.plant for axis in simulated.axes]
        warms = any(plant.heat is not None or plant.coil_thermal_K_W > 0 for plant in plants)
        shows = progress is not None or outputs.record is not None
        self._look_ns = PROGRESS_NS if shows or warms else LOOK_NS  # heat flows in the steps of a recorded run
        self.measured = MeasuredFrames(rig) if measured else None
        self.world.on_change = lambda change: self.mark(self.world.t_ns, change.marker)
        self.outside = None if run.world is None else VirtualWorld(run.world.function, run.world_every)
        self.injection: Injection | None = None
        self.ended_ns = 0
        """Time of the host's end, after its safe state."""

    def _write(self, frames: Records) -> None:
        if self.measured is not None:
            self.measured.write(frames)
        messages = self.world.recorded_messages()
        frames = frames.view(np.ndarray)  # a recarray looks each field up in Python
        if len(messages):  # at equal times, bus frames first
            frames = np.concatenate((frames, messages))
            frames = frames.take(np.argsort(frames["t_ns"], kind="stable"))
        self.record(lambda recorder: recorder.write(frames))

    def _write_host(self, received: Records, events: Records, requests: Records) -> None:
        models = self.world.models.take_rows()
        self.record(lambda recorder: recorder.keep_models(models))
        self.record(lambda recorder: recorder.trace(~received, events, requests))

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
        safe_ns = self.controllers.safe_ns
        return None if safe_ns is None else int(bus_ns(self.world.host_clock, safe_ns))

    def advance(self, until_ns: int, done: Callable[[], bool]) -> bool:
        """Run in steps short enough to show progress and to write the recording."""
        world = self.world
        world.run_until(min(until_ns, world.t_ns + self._look_ns), done)
        waiting = self.controllers.host["waiting"] != 0
        if self.controllers.done and waiting.any():  # the run ends with a whole cycle of all axes
            window_ns = int(self.controllers.host["next_ns"][waiting].max())
            world.run_until(int(bus_ns(world.host_clock, window_ns)) + 1)
        self.mark_course(world.t_ns + (world.t_ns < until_ns))  # an event at the display's end is excluded
        world.flush()
        if self.recorder is None:
            world.models.take_rows()  # nobody keeps them
        enabled = self.enabled_ns
        if self.progress is not None and enabled is not None:
            self.progress((world.t_ns - enabled) * 1e-9)
        return not self.controllers.ending

    def stop(self, trip: Trip = Trip.NONE) -> None:
        """Ask the host for the safe state."""
        self.world.ask_to_stop(trip)

    def set_up(self) -> tuple[str, ...]:
        """Plan faults and script, create the files, switch the nodes on and bring them up; return the losses.

        An old file is overwritten only after all that may be refused before power-on.
        """
        world, truth = self.world, self._run.outputs.truth
        if self._faults is not None:
            mark = self.mark if self._run.outputs.record is not None or self.measured else None
            self.injection = Injection(world, self._faults, self._run.seed, mark)
        for begin in (self._on_world, self._script):
            if begin is not None:
                begin(world)
        if self._stop_ns is not None:
            world.at(self._stop_ns, lambda _: self.stop(Trip.OTHER_AXIS))
        if truth is not None:
            with _truth_errors(truth):
                os.close(open_new(truth, force=self._run.outputs.force))
        self.recorder = begin_recording(self._run, self.controllers)
        if self.recorder is not None:
            world.on_host = self._write_host
            world.record_messages()
        losses = self._ready_losses
        if losses is None:
            losses = set_up(world, cached=self.only_figures)
        self.mark(world.t_ns, f"run {self.controllers.mode}")
        return losses

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Begin the cycle, and end it safely; after an error the rig is left as it is: no hand is on it."""
        world = self.world
        world.start_host()
        if self.outside is not None:
            self.outside.begin(world)
        yield
        self.make_safe()
        world.stop_host()
        self.ended_ns = world.t_ns
        if not self.only_figures:
            release(self.controllers, world)  # a few milliseconds: the nodes have not missed its heartbeat yet
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
            return Figures([Measures() for _ in self.controllers], None)
        return Figures([measure(recording) for recording in self.measured.recordings()], None)

    def end(self) -> None:
        """Write the rest and close the recording."""
        self.mark_trip()
        self.world.flush()
        if self.recorder is not None:
            try:
                self.recorder.close()
            except RecordingError as error:
                self.failure = self.failure or str(error)

    def result(self) -> RunResult:
        """Save the truth; return the result of the run."""
        truth = self._run.outputs.truth
        if truth is not None:
            with _truth_errors(truth), truth.open("wb") as file:  # given a name, numpy would append .npz to it
                np.savez(file, **self.world.truth())
        k, enabled, trip = self.controllers, self.enabled_ns, self.trip
        result = self.result_of(
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
        if self.only_figures:
            return_world(self.world)
        return result

    def _plane(self) -> dict[str, Any] | None:
        """Return the figures of an arm in the plane."""
        model, enabled = self.controllers.plane_model, self.enabled_ns
        figures = self.controllers.plane_figures()
        if model is None or figures is None or enabled is None or not (self.measured or self.recorder):
            return figures
        return figures | plane_figures(self.world.rig, model.law, self.world.tip_course(), enabled * 1e-9)


def _faults(run: Run, channel: str | None) -> FaultPlan | None:
    """Return the faults of one bus; None: of the only host."""
    if run.faults is None:
        return None
    plan, channels = faults_of(run.faults.text, run.faults.name), run.rig.channels
    return plan.on_one(channels) if channel is None else plan.on(channel, channels)


def _script(run: Run) -> Callable[[VirtualRig], None] | None:
    """Return the function that plans the script's actions in a world."""
    if isinstance(run.script, Code):
        function: Callable[[VirtualRig], None] = run.script.function
        return function
    if run.script is None:
        return None
    entries = script_of(run.script.text, run.script.name, [node.name for node in run.rig.nodes])
    return lambda world: world.plan(entries)


@contextmanager
def _truth_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise TruthError(f"{path}: the truth cannot be written ({reason}); name a file with room for it") from error
