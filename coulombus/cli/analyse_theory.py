"""The verbs of `coulombus analyse` that need no rig: the sampled loop, Fig. 10, the friction laws."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import click

from coulombus.cli.analyse_options import figures_option, loop_options, parameters_of
from coulombus.cli.analyse_output import bar, steps, tell, tell_paths
from coulombus.cli.common import json_option, seed_option, verdict
from coulombus.cli.errors import EXIT_STATUS, errors

__all__ = ["chatter_command", "fig10", "laws_command", "limit_cycle", "nyquist", "stuck"]


@click.command(epilog=EXIT_STATUS)
@loop_options
@figures_option
@json_option
def nyquist(**options: Any) -> None:
    """Describing function, disks of the passive set, absolute stability (Figs. 2, 6, 7)."""
    with errors():
        from coulombus.analysis.figures.report import disk_of, nyquist_json, nyquist_lines, weights_at
        from coulombus.analysis.theory.absolute import absolute_stability
        from coulombus.analysis.theory.crossings import crossings

        parameters = parameters_of(options)
        prediction, absolute = crossings(parameters), absolute_stability(parameters)
        disk = disk_of(parameters)
        weights = [weights_at(crossing.frequency_Hz, parameters) for crossing in prediction.found]
        tell(
            options["as_json"],
            lambda: {**nyquist_json(prediction, disk, absolute), "alias_weights": weights},
            lambda: nyquist_lines(prediction, absolute),
        )
        if options["figures"]:
            from coulombus.analysis.figures.frequency import write_frequency_figures

            tell_paths(write_frequency_figures(options["figures"], parameters, prediction, absolute))


@click.command("limit-cycle", epilog=EXIT_STATUS)
@loop_options
@seed_option
@click.option("--starts", type=click.IntRange(0), default=200, show_default=True, help="Random starts, for the shares.")
@click.option("--longest", type=click.IntRange(1, 20), default=16, show_default=True, help="Longest period in samples.")
@click.option("--no-table", is_flag=True, help="Without the table over rates and delays.")
@click.option(
    "--zero",
    type=click.Choice(("zero", "plus", "hold")),
    default="zero",
    show_default=True,
    help="With --encoder: what sgn(0) is. 0, +1, or the sign before.",
)
@figures_option
@json_option
def limit_cycle(**options: Any) -> None:
    """Exact periodic motions of the sampled loop, and the limit cycle over rate and delay."""
    with errors():
        from coulombus.analysis.figures.report import delay_lines, orbits_json, plain
        from coulombus.analysis.theory.crossings import crossings
        from coulombus.analysis.theory.delay import delay_table
        from coulombus.analysis.theory.linear import sample
        from coulombus.analysis.theory.orbits import orbits
        from coulombus.analysis.theory.peak import l1_bound
        from coulombus.analysis.theory.three_valued import three_valued_orbits

        parameters = parameters_of(options)
        prediction = crossings(parameters)
        motions = orbits(parameters, longest=options["longest"], starts=options["starts"], seed=options["seed"])
        rows = () if options["no_table"] else delay_table(parameters, seed=options["seed"])
        seen = three_valued_orbits(parameters, options["zero"]) if parameters.resolution_m > 0 else ()
        most = l1_bound(parameters) if sample(parameters).spectral_radius < 1 - 1e-12 else None

        def text() -> Iterator[str]:
            yield f"describing function   {prediction.text}"
            for orbit in motions.found:
                share = "" if orbit.share is None else f"  {orbit.share:4.0%} of the starts"
                yield (
                    f"{orbit.pattern:<17} {orbit.frequency_Hz:8.4g} Hz  peak {orbit.velocity_peak_m_s:.4g} m/s  "
                    f"margin {orbit.margin_m_s:.3g} m/s  {'stable' if orbit.stable else 'unstable'}{share}"
                )
                yield f"{'':<17} between the samples the handle reaches {orbit.true_peak_m_s:.4g} m/s"
            if not motions.found:
                yield motions.text
            if motions.elsewhere:
                yield f"{motions.elsewhere:.0%} of the starts ended in none of these: a longer period, or none"
            if most is not None:
                yield f"no motion that the display sustains has more than {most:.4g} m/s (l1 norm)"
            yield from (
                f"{orbit.pattern:<17} {orbit.frequency_Hz:8.4g} Hz  peak {orbit.velocity_peak_m_s:.4g} m/s  "
                f"at {orbit.share:.0%} of the encoder's places"
                for orbit in seen
            )
            if rows:
                yield ""
                yield from delay_lines(rows)

        tell(
            options["as_json"],
            lambda: {
                "crossings": plain(prediction.found),
                **orbits_json(motions),
                "l1_bound_m_s": most,
                "with_encoder": plain(seen),
                "delay_table": plain(rows),
            },
            text,
        )
        if options["figures"]:
            from coulombus.analysis.figures.time import write_delay_figure, write_orbit_figure

            paths = write_orbit_figure(options["figures"], parameters, motions)
            tell_paths(paths + (write_delay_figure(options["figures"], rows) if rows else []))


@click.command(epilog=EXIT_STATUS, short_help="The spring of the stick phase: rho and K_max.")
@loop_options
@click.option(
    "--stiffness",
    type=click.FloatRange(0, 1e12),
    default=1e4,
    show_default=True,
    metavar="N/M",
    help="Stiffness K_p of the spring.",
)
@json_option
def stuck(**options: Any) -> None:
    """How fast the spring that sticks settles in the sampled loop, and how stiff it may be.

    rho is the spectral radius of a sample's step; K_max is the stiffness from which on it does not
    settle. The hand's own impedance counts.

    \b
    Examples:
      coulombus analyse stuck --stiffness 20000
      coulombus analyse stuck --delay 1e-3 --operator 0.05 2 178 --json
    """
    with errors():
        from coulombus.analysis.theory.stuck_spring import stuck_spring

        spring = stuck_spring(parameters_of(options), options["stiffness"])

        def text() -> Iterator[str]:
            word = "settles" if spring.stable else "does not settle"
            yield f"K = {spring.stiffness_N_m:g} N/m: {word}, rho = {spring.radius:.9g}"
            yield f"K_max = {spring.largest_N_m:.6g} N/m"

        tell(options["as_json"], lambda: {"stuck": spring, "stable": spring.stable}, text)


@click.command(epilog=EXIT_STATUS, short_help="Figure 10: active and passive friction under the paper's force.")
@loop_options
@figures_option
@json_option
def fig10(**options: Any) -> None:
    """Fig. 10: the paper's force on active and passive friction, exact between samples and to the
    event.
    """
    with errors():
        from coulombus.analysis.figures.report import fig10_json, fig10_lines
        from coulombus.analysis.theory.fig10 import figure_10

        runs = figure_10(parameters_of(options))

        def text() -> Iterator[str]:
            yield from fig10_lines(runs)
            for begin, end in runs.passive.stick_intervals_s:
                yield f"passive, stuck        {begin:9.5f} ... {end:9.5f} s"

        tell(options["as_json"], lambda: fig10_json(runs), text)
        if options["figures"]:
            from coulombus.analysis.figures.time import write_fig10

            tell_paths(write_fig10(options["figures"], runs))


@click.command("laws", epilog=EXIT_STATUS, short_help="The friction laws compared with the literature.")
@figures_option
@json_option
def laws_command(figures: Path | None, as_json: bool) -> None:
    """Compute the published benchmarks of the friction laws, their describing functions (v = 1 rad/s,
    1 Hz) and what they give back; then the curves of the literature beside their own.

    Ends with 1 when a law does not give what the literature says.

    \b
    Examples:
      coulombus analyse laws --figures out/laws
    """
    with errors():
        from coulombus.analysis.theory import published_curves
        from coulombus.analysis.theory.law_benchmarks import benchmarks, lines, plain, sweep

        with steps(3) as step:
            step("benchmarks")
            results = benchmarks()
            step("describing functions")
            swept = sweep()
            step("curves of the literature")
            curves = published_curves.literature_curves()
        if figures is not None:
            from coulombus.analysis.figures.law import write_literature_figures

            tell_paths(write_literature_figures(figures, curves))
        with verdict(0 if all(result.ok for result in results) else 1):
            tell(
                as_json,
                lambda: {**plain(results, swept), "curves": published_curves.plain(curves)},
                lambda: chain(lines(results, swept), [""], published_curves.lines(curves)),
            )


@click.command("chatter", epilog=EXIT_STATUS, short_help="The most friction that a motor alone displays quietly.")
@click.option("--inertia", type=float, required=True, metavar="KG_M2", help="Inertia of the device at the handle.")
@click.option("--rate", type=float, required=True, metavar="HZ", help="Samples a second.")
@click.option(
    "--counts", type=float, required=True, metavar="N", help="Encoder's counts a turn of the handle, all edges."
)
@click.option("--delay", default=0.0, show_default=True, metavar="S", help="From sampling to actuation.")
@click.option("--damping", default=0.0, show_default=True, metavar="NMS/RAD", help="The device's own viscous damping.")
@click.option("--friction", default=0.0, show_default=True, metavar="NM", help="The device's own Coulomb friction.")
@click.option("--lag", default=0.0, show_default=True, metavar="S", help="The motor's lag.")
@click.option("--limit", type=float, default=None, metavar="NM", help="The motor's torque limit.  [default: none]")
@click.option("--brake", default=0.0, metavar="NM", help="Torque of a brake beside the motor.  [default: no brake]")
@click.option(
    "--hand",
    nargs=3,
    type=float,
    default=(0.0, 0.0, 0.0),
    metavar="KG_M2 NMS/RAD NM/RAD",
    help="Inertia, damping and stiffness of the hand that holds it.  [default: none]",
)
@figures_option
@json_option
def chatter_command(**options: Any) -> None:
    """Find the most friction, and the stiffest wall, that a motor alone may display on a device before it
    rattles, and what each remedy buys.

    For wheels, knobs and handles that chatter. Every level is a simulation of the sampled loop after taps; the
    friction is c sgn(v) of the encoder's difference.

    \b
    Examples:
      coulombus analyse chatter --inertia 2.5e-3 --rate 1000 --counts 78537 --delay 1e-3 --damping 0.005 --friction 0.14
      coulombus analyse chatter --inertia 4e-6 --rate 1000 --counts 16384 --damping 1e-5 --friction 2e-3 --json
    """
    with errors():
        from coulombus.analysis.rig.chatter import chatter, device

        o = options
        try:
            loop = device(
                o["inertia"],
                o["rate"],
                o["counts"],
                o["delay"],
                damping_Nms_rad=o["damping"],
                friction_Nm=o["friction"],
                lag_s=o["lag"],
                limit_Nm=math.inf if o["limit"] is None else o["limit"],
                hand=o["hand"],
            )
            with bar("chatter") as report:
                found = chatter(loop, brake_Nm=o["brake"], curves=o["figures"] is not None, progress=report)
        except ValueError as error:
            raise click.UsageError(str(error)) from error
        tell(o["as_json"], found.as_dict, found.lines)
        if o["figures"]:
            from coulombus.analysis.figures.rig import write_chatter

            tell_paths(write_chatter(o["figures"], found))
