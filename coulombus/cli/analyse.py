"""`coulombus analyse`: the whole paper, the results of a study, and the verbs for the parts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import click
from click.core import ParameterSource

from coulombus.cli.analyse_rig import felt, hold, map_command, plane, z_width
from coulombus.cli.analyse_shared import (
    AnalysedRigOptions,
    FiguresOption,
    LoopOptions,
    print_figures,
    print_result,
    steps,
)
from coulombus.cli.analyse_theory import chatter_command, fig10, laws_command, limit_cycle, nyquist, stuck
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import JsonOption, SeedOption, argument, option, with_options
from coulombus.cli.tables import echo
from coulombus.system.exit import printed, say

__all__ = ["analyse"]


@click.group(
    "analyse",
    invoke_without_command=True,
    epilog=EXIT_STATUS,
)
@with_options
@click.pass_context
def analyse(
    ctx: click.Context,
    loop: LoopOptions,
    options: AnalysedRigOptions,
    seed: SeedOption,
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
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
        before = [name for name in ctx.params if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE]
        if before:
            raise click.UsageError(f"put --{before[0].replace('_', '-')} after the verb {ctx.invoked_subcommand!r}")
        return
    with errors():
        from coulombus.analysis.figures.report import as_json as json_of
        from coulombus.analysis.figures.report import lines
        from coulombus.analysis.figures.report import study as whole_study

        parameters, rig = loop.parameters(), options.axis()
        with steps(9) as step:
            result = whole_study(parameters, rig, seed=seed, step=step)
        print_result(as_json, lambda: json_of(result), lambda: lines(result))
        if figures:
            from coulombus.analysis.figures.report import write_all

            print_figures(write_all(figures, result))


@analyse.command(epilog=EXIT_STATUS)
@with_options
def study(
    folder: Annotated[Path, argument(type=click.Path(readable=False, path_type=Path, file_okay=False))],
    figures: FiguresOption,
    exploration: Annotated[bool, option("How the hands moved, from the recordings.")],
    felt: Annotated[bool, option("Thresholds in the torque that the hand felt, too, from the recordings.")],
    as_json: JsonOption,
) -> None:
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
            print_figures(write_figures(result, figures))
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
