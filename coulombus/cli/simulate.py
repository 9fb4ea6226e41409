"""``coulombus simulate``: a rig in virtual time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
from click.core import ParameterSource

from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import InputPath, OutputFile
from coulombus.cli.options import (
    DisplaySecondsOption,
    FaultsOption,
    JsonOption,
    ModeOption,
    OverwriteOption,
    RecordOption,
    ScriptOption,
    SeedOption,
    option,
    with_options,
)
from coulombus.cli.rig_options import RigOptions, check_mode, display_s
from coulombus.cli.run_table import print_runs
from coulombus.cli.tables import echo, progress
from coulombus.system.exit import verdict

if TYPE_CHECKING:
    from coulombus.host.run.run import Outputs, Run

__all__ = ["simulate_command"]


@dataclass(frozen=True)
class Files:
    """Output files of ``simulate``, from the options."""

    record: RecordOption
    overwrite: OverwriteOption
    truth: Annotated[
        Path | None,
        option(
            "Save the plant's true states there, at its own step: time, angle, speed, torques, works.",
            type=OutputFile(),
            metavar="F.npz",
        ),
    ]


@dataclass(frozen=True)
class RunOptions(RigOptions):
    """A run in virtual time, from the options."""

    mode: ModeOption
    seconds: DisplaySecondsOption
    seed: SeedOption
    faults: FaultsOption
    script: ScriptOption
    law: Annotated[str | None, option("Display this law: one of `coulombus law`, or FILE.py:FUNCTION.", metavar="NAME")]
    like: Annotated[
        Path | None,
        option(
            "Repeat the run of this recording: a simulated one to the byte. Its own law's file is named by --law.",
            type=InputPath(),
            metavar="F.pcapng",
        ),
    ]

    def run(self, outputs: Outputs) -> Run:
        """Return the run: that of the options, or that of a recording."""
        from coulombus.host.run.run import NamedText, Run, recorded_run
        from coulombus.sim_bus.faults.fault_file import FaultError
        from coulombus.sim_bus.network.script import ScriptError

        if self.like is not None:
            _refuse_beside_like()
            return recorded_run(self.like, law=self.law, seconds=self.seconds, outputs=outputs)
        rig = self.load()
        if self.law is not None:
            rig = rig.with_law(self.law)
        check_mode(rig, self.rig_name, self.mode)
        return Run(
            rig,
            self.mode,
            display_s(rig, self.seconds),
            self.seed,
            faults=None if self.faults is None else NamedText.read(self.faults, "fault file", FaultError),
            script=None if self.script is None else NamedText.read(self.script, "script", ScriptError),
            outputs=outputs,
        )


def _refuse_beside_like() -> None:
    """Refuse options that describe a run beside --like, which names the whole run."""
    context = click.get_current_context()
    names = ("rig_name", "overrides", "mode", "seed", "faults", "script")
    for param in context.command.params:
        if param.name in names and context.get_parameter_source(param.name) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{param.opts[0]}: --like repeats the run of a recording as it was: leave it out")


@click.command("simulate", epilog=EXIT_STATUS)
@with_options
def simulate_command(
    options: RunOptions,
    files: Files,
    as_json: JsonOption,
) -> None:
    """Run the rig in virtual time: bring-up, arming, display, safe end - over real PDOs.

    The run lasts from the drive's Operation Enabled, where the operator's schedule begins.

    \b
    Examples:
      coulombus simulate --mode active --seconds 13 --record active.pcapng
      coulombus simulate --rig paper --mode active --seconds 12 --json
      coulombus simulate --set operator.inertia_kg_m2=0.1 --set mode.active.F_s_Nm=0.8 --mode active
      coulombus simulate --faults faults.toml --record run.pcapng --json
      coulombus simulate --truth truth.npz --record run.pcapng --seed 7
      coulombus simulate --script script.toml --record run.pcapng
      coulombus simulate --law lugre --set law.lugre.F_s_Nm=1.4 --mode active --record lugre.pcapng
      coulombus simulate --like run.pcapng --record again.pcapng
    """
    with errors():
        from coulombus.host.run.run import Outputs
        from coulombus.lab.simulate import virtual_run
        from coulombus.sim_bus.faults.fault_file import injected_lines

        run = options.run(Outputs(record=files.record, truth=files.truth, force=files.overwrite))
        with progress(not as_json) as report:
            result = virtual_run(run, progress=lambda t: report(run.mode, t, run.seconds))
        remark((*(result.opened or ()), *(result.losses or ())))
        with verdict(result.exit_status):
            if as_json:
                print_json(result.as_dict())
            else:
                print_runs({run.mode: result})
                for line in injected_lines(result.faults, result.controllers):
                    echo(line)
