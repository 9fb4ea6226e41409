"""`coulombus analyse`: the whole paper, the results of a study, and the verbs for the parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from coulombus.cli.analyse_options import figures_option, loop_options, parameters_of, rig_of
from coulombus.cli.analyse_output import steps, tell, tell_paths
from coulombus.cli.analyse_plane import plane
from coulombus.cli.analyse_rig import felt, hold, map_command, z_width
from coulombus.cli.analyse_theory import chatter_command, fig10, laws_command, limit_cycle, nyquist, stuck
from coulombus.cli.common import json_option, printed, rig_option, say, seed_option, set_option
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.tables import echo

__all__ = ["analyse"]


@click.group(
    "analyse",
    invoke_without_command=True,
    epilog=EXIT_STATUS,
)
@loop_options
@rig_option
@set_option
@seed_option
@figures_option
@json_option
@click.pass_context
def analyse(ctx: click.Context, /, **options: Any) -> None:
    """Compute the paper, equation by equation and figure by figure, and past it.

    Without a verb all of it, with the paper's parameters as defaults; each part is also a verb. The
    rig is the one whose friction is identified and compensated; the limit cycle through the bus is
    that of the rig "paper".

    \b
    Examples:
      coulombus analyse --figures out/figures
      coulombus analyse --json > analysis.json
      coulombus analyse nyquist --delay 1e-3
      coulombus analyse limit-cycle --operator 0.05 2 178
      coulombus analyse fig10 --encoder 1e-5 --json
    """
    if ctx.invoked_subcommand is not None:
        given = [n for n in options if ctx.get_parameter_source(n) is click.core.ParameterSource.COMMANDLINE]
        if given:
            raise click.UsageError(f"put --{given[0].replace('_', '-')} after the verb {ctx.invoked_subcommand!r}")
        return
    with errors():
        _all(options)


def _all(options: dict[str, Any]) -> None:
    from coulombus.analysis.figures.report import as_json, lines, study

    parameters, rig = parameters_of(options), rig_of(options)
    with steps(9) as step:
        result = study(parameters, rig, seed=options["seed"], step=step)
    tell(options["as_json"], lambda: as_json(result), lambda: lines(result))
    if options["figures"]:
        from coulombus.analysis.figures.all import write_all

        tell_paths(write_all(options["figures"], result))


@analyse.command(epilog=EXIT_STATUS)
@click.argument("folder", type=click.Path(readable=False, path_type=Path, file_okay=False))
@figures_option
@click.option("--exploration", is_flag=True, help="How the hands moved, from the recordings.")
@click.option("--felt", is_flag=True, help="Thresholds in the torque that the hand felt, too, from the recordings.")
@json_option
def study(folder: Path, figures: Path | None, exploration: bool, felt: bool, as_json: bool) -> None:
    """Thresholds of a study that `coulombus experiment` has kept in FOLDER.

    Points of subjective equality, just noticeable differences, lapses and interval biases with
    intervals of 95 %, goodness of fit, Weber fractions, exponents of magnitudes; groups by geometric
    mean and hierarchical fit, and a mixed model where statsmodels is installed.
    How the hands explored is told where nothing was asked, or with --exploration. With --figures the
    report is written there with its pictures, as report.md.

    \b
    Examples:
      coulombus analyse study out/study
      coulombus analyse study out/study --figures out/figures --json
    """
    with errors():
        from coulombus.lab.study.results.pictures import write_figures
        from coulombus.lab.study.results.report import report
        from coulombus.lab.study.results.report_text import lines

        result = report(folder, exploration=exploration, felt=felt)
        if figures is not None:
            tell_paths(write_figures(result, figures))
        if result["no_mixed_model"] is not None and len(result["subjects"]) > 1:
            say(f"coulombus: {result['no_mixed_model']}")
        with printed():
            if as_json:
                print_json(result)
            else:
                echo("\n".join(lines(result)))


for verb in (
    nyquist,
    limit_cycle,
    stuck,
    fig10,
    laws_command,
    hold,
    felt,
    z_width,
    map_command,
    chatter_command,
    plane,
):
    analyse.add_command(verb)
