"""Run a rig in virtual time: `simulate` makes a `Run` of its arguments, `repeat` of a recording, `virtual_run` displays it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from coulombus.host.run.buses import merged
from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Code, NamedText, Outputs, Run, recorded_run
from coulombus.host.setup.bringup import check_plan
from coulombus.host.setup.law_demand import check_demand
from coulombus.lab.virtual_course import TruthError, VirtualCourse
from coulombus.lab.virtual_world import WorldFunction, with_world
from coulombus.recording.output_file import check as check_output
from coulombus.rigs.arguments import path_text, texts
from coulombus.rigs.rig import Rig, load_rig
from coulombus.sim_bus.faults.fault_file import FaultError, FaultPlan
from coulombus.sim_bus.network.script import ScriptError
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.plant import truth_columns
from coulombus.system.errors import CoulombusError

__all__ = ["TruthError", "repeat", "simulate", "virtual_run"]

TRUTH_BYTES = 8e9
SCRIPT, WORLD = (
    "simulate(script=lambda world: world.at(5_000_000, look))",
    "simulate(world=lambda state: Wall(0.0, 2.0))",
)
"""Correct calls, for messages."""


def simulate(
    rig: Rig | str | os.PathLike[str] = "bench",
    mode: str = "hybrid",
    seconds: float = 13.0,
    *,
    record: str | os.PathLike[str] | None = None,
    seed: int = 0,
    truth: str | os.PathLike[str] | None = None,
    overrides: tuple[str, ...] = (),
    script: Callable[[VirtualRig], None] | str | os.PathLike[str] | None = None,
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
    script : a script file (docs/bus.md), or a function that is called before power-on and plans
        faults with ``world.at(t_ns, action)``
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
    coulombus.sim_bus.faults.fault_file.FaultError, coulombus.sim_bus.network.script.ScriptError
        the fault file or the script is wrong
    coulombus.rigs.arguments.WrongCall
        an argument has the wrong type
    """
    outputs = Outputs(
        record=_path(record, "record", "run.pcapng"),
        truth=_path(truth, "truth", "run.npz"),
        measured=measured,
        force=force,
    )
    plan = NamedText(name=faults.path, text=faults.text) if isinstance(faults, FaultPlan) else faults
    overrides = texts(overrides, "overrides", "mode.active.F_s_Nm=1.0")
    run = Run(
        rig.variant(*overrides) if isinstance(rig, Rig) else load_rig(rig, overrides),
        mode,
        seconds,
        seed,
        simulated,
        faults=_text(plan, "faults", "fault file", FaultError),
        script=Code.from_function(script, "script", SCRIPT)
        if callable(script)
        else _text(script, "script", "script", ScriptError),
        world=None if world is None else Code.from_function(world, "world", WORLD),
        world_every=world_every,
        outputs=outputs,
    )
    return virtual_run(run, progress=progress)


def _path(value: Any, name: str, example: str) -> Path | None:
    return None if value is None else Path(path_text(value, name, f'simulate({name}="{example}")'))


def _text(value: Any, name: str, kind: str, error: type[CoulombusError]) -> NamedText | None:
    """Return the text of a file that the argument `name` names."""
    if value is None or isinstance(value, NamedText):
        return value
    path = Path(path_text(value, name, f'simulate({name}="{name}.toml")'))
    return NamedText.read(path, kind, error)


def repeat(
    recording: str | os.PathLike[str],
    *,
    record: str | os.PathLike[str] | None = None,
    truth: str | os.PathLike[str] | None = None,
    law: str | None = None,
    script: Callable[[VirtualRig], None] | None = None,
    world: WorldFunction | None = None,
    progress: Callable[[float], None] | None = None,
    force: bool = False,
) -> RunResult:
    """Repeat the run of a recording in virtual time; a run of `simulate` gives the same bytes again.

    Parameters
    ----------
    recording : a recording with a run (docs/simulation.md)
    law : ``FILE.py:FUNCTION`` of a law that is not built in; its checksum must be the recorded one
    script, world : the run's functions, if it had any; so must theirs
    record, truth, progress, force : as of `simulate`

    Raises
    ------
    coulombus.host.run.run.NotRepeatable
        the recording has no run, its code is not named or differs, or an output file is the recording itself
    """
    path = path_text(recording, "recording", 'repeat("run.pcapng")')
    outputs = Outputs(record=_path(record, "record", "run.pcapng"), truth=_path(truth, "truth", "run.npz"), force=force)
    run = recorded_run(path, law=law, script=script, world=world, outputs=outputs)
    return virtual_run(run, progress=progress)


def virtual_run(
    run: Run,
    *,
    progress: Callable[[float], None] | None = None,
    on_world: Callable[[VirtualRig], None] | None = None,
) -> RunResult:
    """Carry out a run in virtual time and return the result; parameters and errors as of `simulate`.

    Parameters
    ----------
    on_world : called with the world of each bus before power-on; it only looks on
    """
    if run.world is not None:
        run = replace(run, rig=with_world(run.rig))
    _check(run)
    if run.rig.one_cycle:
        return VirtualCourse(run, None, progress, on_world).run(run.seconds)

    def on_bus(channel: str, run: Run, stop_ns: int | None = None) -> RunResult:
        return VirtualCourse(run, channel, progress, on_world, stop_ns).run(run.seconds)

    results = {
        channel: on_bus(channel, run) for channel in run.rig.channels
    }  # the buses share nothing: in turn is exact
    trips = {result.trip_ns: channel for channel, result in results.items() if result.trip_ns}
    if trips:  # the other buses again, stopped at that instant; their files are those of the first run
        first = min(trips)
        again = replace(run, outputs=replace(run.outputs, force=True))
        results = {c: r if c == trips[first] else on_bus(c, again, first) for c, r in results.items()}
    parts = {channel: result.as_dict() for channel, result in results.items()}
    return RunResult(**merged(parts, {channel: result.exit_status for channel, result in results.items()}))


def _check(run: Run) -> None:
    """Refuse a run that cannot be displayed or recorded, before a file is created."""
    rig, record, truth = run.rig, run.outputs.record, run.outputs.truth
    if record is not None or truth is not None or not rig.one_cycle:
        check_plan(rig)  # bring-up refuses it, too
    check_demand(rig, run.mode)
    for path in run.files:
        check_output(path, force=run.outputs.force)  # known before the first bus is run
    if truth is not None and run.seconds is not None:
        plants = [axis.simulation.plant for axis in (run.simulated or rig).axes]
        size = sum(run.seconds / plant.step_s * 8 * len(truth_columns(plant)) for plant in plants)
        if size > TRUTH_BYTES:
            raise TruthError(
                f"{truth}: {size / 1e9:.0f} GB of truth; show less than {run.seconds:g} s, or raise plant.step_s"
            )
