"""The verbs of `coulombus analyse` that need no rig: the sampled loop, Fig. 10, the friction laws."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Literal

import click

from coulombus.cli.analyse_shared import FiguresOption, LoopOptions, bar, print_figures, print_result, steps
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.options import JsonOption, SeedOption, option, with_options
from coulombus.system.exit import verdict

if TYPE_CHECKING:
    from coulombus.analysis.rig.maps import LoopParameters

__all__ = ["chatter_command", "fig10", "laws_command", "limit_cycle", "nyquist", "stuck"]


@click.command(epilog=EXIT_STATUS)
@with_options
def nyquist(
    loop: LoopOptions,
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
    """Describing function, disks of the passive set, absolute stability (Figs. 2, 6, 7)."""
    with errors():
        from coulombus.analysis.figures.report import disk_of, nyquist_json, nyquist_lines, weights_at
        from coulombus.analysis.theory.absolute import absolute_stability
        from coulombus.analysis.theory.crossings import crossings

        parameters = loop.parameters()
        prediction, absolute = crossings(parameters), absolute_stability(parameters)
        disk = disk_of(parameters)
        weights = [weights_at(crossing.frequency_Hz, parameters) for crossing in prediction.found]
        print_result(
            as_json,
            lambda: {**nyquist_json(prediction, disk, absolute), "alias_weights": weights},
            lambda: nyquist_lines(prediction, absolute),
        )
        if figures:
            from coulombus.analysis.figures.frequency import write_frequency_figures

            print_figures(write_frequency_figures(figures, parameters, prediction, absolute))


@click.command("limit-cycle", epilog=EXIT_STATUS)
@with_options
def limit_cycle(
    loop: LoopOptions,
    seed: SeedOption,
    starts: Annotated[int, option("Random starts, for the shares.", type=click.IntRange(0), default=200)],
    longest: Annotated[int, option("Longest period in samples.", type=click.IntRange(1, 20), default=16)],
    no_table: Annotated[bool, option("Without the table over rates and delays.")],
    zero: Annotated[
        Literal["zero", "plus", "hold"],
        option(
            "With --encoder: what sgn(0) is. 0, +1, or the sign before.",
            type=click.Choice(("zero", "plus", "hold")),
            default="zero",
        ),
    ],
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
    """Exact periodic motions of the sampled loop, and the limit cycle over rate and delay."""
    with errors():
        from coulombus.analysis.figures.report import delay_lines, orbits_json, plain
        from coulombus.analysis.theory.crossings import crossings
        from coulombus.analysis.theory.delay import delay_table
        from coulombus.analysis.theory.linear import sample
        from coulombus.analysis.theory.orbits import orbits
        from coulombus.analysis.theory.peak import l1_bound
        from coulombus.analysis.theory.three_valued import three_valued_orbits

        parameters = loop.parameters()
        prediction = crossings(parameters)
        motions = orbits(parameters, longest=longest, starts=starts, seed=seed)
        rows = () if no_table else delay_table(parameters, seed=seed)
        seen = three_valued_orbits(parameters, zero) if parameters.resolution_m > 0 else ()
        bound_m_s = l1_bound(parameters) if sample(parameters).spectral_radius < 1 - 1e-12 else None

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
            if bound_m_s is not None:
                yield f"no motion that the display sustains has more than {bound_m_s:.4g} m/s (l1 norm)"
            yield from (
                f"{orbit.pattern:<17} {orbit.frequency_Hz:8.4g} Hz  peak {orbit.velocity_peak_m_s:.4g} m/s  "
                f"at {orbit.share:.0%} of the encoder's places"
                for orbit in seen
            )
            if rows:
                yield ""
                yield from delay_lines(rows)

        print_result(
            as_json,
            lambda: {
                "crossings": plain(prediction.found),
                **orbits_json(motions),
                "l1_bound_m_s": bound_m_s,
                "with_encoder": plain(seen),
                "delay_table": plain(rows),
            },
            text,
        )
        if figures:
            from coulombus.analysis.figures.time import write_delay_figure, write_orbit_figure

            paths = write_orbit_figure(figures, parameters, motions)
            print_figures(paths + (write_delay_figure(figures, rows) if rows else []))


@click.command(epilog=EXIT_STATUS, short_help="The spring of the stick phase: rho and K_max.")
@with_options
def stuck(
    loop: LoopOptions,
    stiffness: Annotated[
        float, option("Stiffness K_p of the spring.", type=click.FloatRange(0, 1e12), default=1e4, metavar="N/M")
    ],
    as_json: JsonOption,
) -> None:
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

        spring = stuck_spring(loop.parameters(), stiffness)

        def text() -> Iterator[str]:
            word = "settles" if spring.stable else "does not settle"
            yield f"K = {spring.stiffness_N_m:g} N/m: {word}, rho = {spring.radius:.9g}"
            yield f"K_max = {spring.largest_N_m:.6g} N/m"

        print_result(as_json, lambda: {"stuck": spring, "stable": spring.stable}, text)


@click.command(epilog=EXIT_STATUS, short_help="Figure 10: active and passive friction under the paper's force.")
@with_options
def fig10(
    loop: LoopOptions,
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
    """Fig. 10: the paper's force on active and passive friction, exact between samples and to the
    event.
    """
    with errors():
        from coulombus.analysis.figures.report import fig10_json, fig10_lines
        from coulombus.analysis.theory.fig10 import figure_10

        runs = figure_10(loop.parameters())

        def text() -> Iterator[str]:
            yield from fig10_lines(runs)
            for begin, end in runs.passive.stick_intervals_s:
                yield f"passive, stuck        {begin:9.5f} ... {end:9.5f} s"

        print_result(as_json, lambda: fig10_json(runs), text)
        if figures:
            from coulombus.analysis.figures.time import write_fig10

            print_figures(write_fig10(figures, runs))


@click.command("laws", epilog=EXIT_STATUS, short_help="The friction laws compared with the literature.")
@with_options
def laws_command(
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
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

            print_figures(write_literature_figures(figures, curves))
        with verdict(0 if all(result.ok for result in results) else 1):
            print_result(
                as_json,
                lambda: {**plain(results, swept), "curves": published_curves.plain(curves)},
                lambda: chain(lines(results, swept), [""], published_curves.lines(curves)),
            )


@dataclass(frozen=True)
class ChatteringDevice:
    """A device at the handle, its sampling, motor and brake, and the hand."""

    inertia: Annotated[
        float, option("Inertia of the device at the handle.", type=float, required=True, metavar="KG_M2")
    ]
    rate: Annotated[float, option("Samples a second.", type=float, required=True, metavar="HZ")]
    counts: Annotated[
        float, option("Encoder's counts a turn of the handle, all edges.", type=float, required=True, metavar="N")
    ]
    delay: Annotated[float, option("From sampling to actuation.", default=0.0, metavar="S")]
    damping: Annotated[float, option("The device's own viscous damping.", default=0.0, metavar="NMS/RAD")]
    friction: Annotated[float, option("The device's own Coulomb friction.", default=0.0, metavar="NM")]
    lag: Annotated[float, option("The motor's lag.", default=0.0, metavar="S")]
    limit: Annotated[float | None, option("The motor's torque limit.  [default: none]", type=float, metavar="NM")]
    brake: Annotated[
        float,
        option(
            "Torque of a brake beside the motor.  [default: no brake]", default=0.0, metavar="NM", show_default=False
        ),
    ]
    hand: Annotated[
        tuple[float, float, float],
        option(
            "Inertia, damping and stiffness of the hand that holds it.  [default: none]",
            nargs=3,
            type=float,
            default=(0.0, 0.0, 0.0),
            metavar="KG_M2 NMS/RAD NM/RAD",
            show_default=False,
        ),
    ]

    def loop(self) -> LoopParameters:
        """Return the sampled loop of the motor."""
        from coulombus.analysis.rig.chatter import device

        return device(
            *(self.inertia, self.rate, self.counts, self.delay),
            damping_Nms_rad=self.damping,
            friction_Nm=self.friction,
            lag_s=self.lag,
            limit_Nm=math.inf if self.limit is None else self.limit,
            hand=self.hand,
        )


@click.command("chatter", epilog=EXIT_STATUS, short_help="The most friction that a motor alone displays quietly.")
@with_options
def chatter_command(device: ChatteringDevice, figures: FiguresOption, as_json: JsonOption) -> None:
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
        from coulombus.analysis.rig.chatter import chatter

        try:
            loop = device.loop()
            with bar("chatter") as report:
                result = chatter(loop, brake_Nm=device.brake, curves=figures is not None, progress=report)
        except ValueError as error:
            raise click.UsageError(str(error)) from error
        print_result(as_json, result.as_dict, result.lines)
        if figures:
            from coulombus.analysis.figures.rig import write_chatter

            print_figures(write_chatter(figures, result))
