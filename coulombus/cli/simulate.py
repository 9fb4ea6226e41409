"""``coulombus simulate``: a rig in virtual time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coulombus.cli.bundle import bundle
from coulombus.cli.common import (
    check_mode,
    display_s,
    faults_option,
    force_option,
    json_option,
    mode_option,
    record_option,
    script_option,
    seconds_option,
    seed_option,
    verdict,
)
from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import OutputFile
from coulombus.cli.rig_options import RigOptions, rig_options
from coulombus.cli.run_table import print_runs
from coulombus.cli.tables import echo, progress

if TYPE_CHECKING:
    from coulombus.rigs.rig import Rig
    from coulombus.sim_bus.network.script import Entry

__all__ = ["simulate_command"]


@dataclass(frozen=True)
class Files:
    """Output files of ``simulate``, from the options."""

    record: Path | None
    truth: Path | None
    overwrite: bool


@dataclass(frozen=True)
class Events:
    """Events of the run besides the rig's schedule, from the options."""

    faults: Path | None
    script: Path | None

    def entries(self, rig: Rig) -> tuple[Entry, ...]:
        """Return the script file's entries for the nodes of `rig`."""
        from coulombus.sim_bus.network.script import read_script

        return () if self.script is None else read_script(self.script, [node.name for node in rig.nodes])


files_options = bundle(
    "files",
    Files,
    record_option,
    force_option,
    click.option(
        "--truth",
        type=OutputFile(),
        metavar="F.npz",
        help="Save the plant's true states there, at its own step: time, angle, speed, torques, works.",
    ),
)
events_options = bundle("events", Events, faults_option, script_option)


@click.command("simulate", epilog=EXIT_STATUS)
@rig_options
@mode_option
@seconds_option
@files_options
@seed_option
@events_options
@click.option("--law", metavar="NAME", help="Display this law: one of `coulombus law`, or FILE.py:FUNCTION.")
@json_option
def simulate_command(
    chosen: RigOptions,
    mode: str,
    seconds: float | None,
    files: Files,
    seed: int,
    events: Events,
    law: str | None,
    as_json: bool,
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
    """
    with errors():
        from coulombus.lab.simulate import simulate
        from coulombus.sim_bus.faults.lines import injected_lines

        rig = chosen.load()
        if law is not None:
            rig = rig.with_law(law)
        check_mode(rig, chosen.rig_name, mode)
        total = display_s(rig, seconds)
        entries = events.entries(rig)
        with progress(not as_json) as report:
            result = simulate(
                rig,
                mode,
                total,
                record=files.record,
                seed=seed,
                truth=files.truth,
                script=lambda world: world.plan(entries),
                faults=events.faults,
                progress=lambda t: report(mode, t, total),
                force=files.overwrite,
            )
        remark((*(result.opened or ()), *(result.losses or ())))
        with verdict(result.exit_status):
            if as_json:
                print_json(result.as_dict())
            else:
                print_runs({mode: result})
                for line in injected_lines(result.faults, result.controllers):
                    echo(line)
