"""`coulombus analyse` and its verbs. Imports what a verb needs only when the verb runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from coulombus.cli.common import json_option, printed, rig_option, say, seed_option, set_option, verdict
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import OutputDirectory
from coulombus.cli.tables import echo, on_terminal

if TYPE_CHECKING:
    from coulombus.analysis.theory.parameters import Parameters
    from coulombus.rigs.rig import Rig

__all__ = ["analyse"]

F = TypeVar("F", bound=Callable[..., Any])

LOOP_OPTIONS = (
    click.option("--mass", default=0.1, show_default=True, metavar="KG", help="Device's mass m."),
    click.option("--damping", default=0.5, show_default=True, metavar="NS/M", help="Device's damping b."),
    click.option(
        "--operator",
        nargs=3,
        type=float,
        default=(1.287, 29.33, 178.0),
        show_default=True,
        metavar="KG NS/M N/M",
        help="Mass, damper and spring of Z_o = m_o s + b_o + k_o/s.",
    ),
    click.option(
        "--operator-rational",
        metavar="NUM/DEN",
        help="Any passive Z_o instead, as 1.287,29.33,178/1,0 (powers of s fall).",
    ),
    click.option("--friction", default=10.0, show_default=True, metavar="N", help="Coulomb friction c."),
    click.option("--sample-time", default=1e-3, show_default=True, metavar="S", help="Period T."),
    click.option("--delay", default=0.0, show_default=True, metavar="S", help="Delay from sampling to actuation."),
    click.option("--encoder", default=0.0, show_default=True, metavar="M", help="Encoder's resolution; 0: none."),
    click.option("--window", default=10.0, show_default=True, metavar="S", help="Length of the simulation of Fig. 10."),
)
LOOP_NAMES = (
    "mass",
    "damping",
    "operator",
    "operator_rational",
    "friction",
    "sample_time",
    "delay",
    "encoder",
    "window",
)

figures_option = click.option(
    "--figures",
    type=OutputDirectory(),
    metavar="DIR",
    help="Draw the figures there, as PNG and SVG.",
)


def loop_options(function: F) -> F:
    """Add the loop's parameters as options."""
    for option in reversed(LOOP_OPTIONS):
        function = option(function)
    return function


def _parameters(options: dict[str, Any]) -> Parameters:
    from coulombus.analysis.theory.parameters import Operator, Parameters

    o = {name: options.pop(name) for name in LOOP_NAMES}
    if o["operator_rational"]:
        operator = Operator.parse(o["operator_rational"])
    else:
        operator = Operator.mass_damper_spring(*o["operator"])
    return Parameters(
        o["mass"], o["damping"], operator, o["friction"], o["sample_time"], o["delay"], o["encoder"], o["window"]
    )


def _rig(options: dict[str, Any]) -> Rig:
    from coulombus.rigs.rig import load_rig

    return load_rig(options.pop("rig_name"), options.pop("overrides")).alone()


def _tell(as_json: bool, value: Callable[[], Any], lines: Callable[[], Any]) -> None:
    from coulombus.analysis.figures.report import plain

    with printed():
        if as_json:
            print_json(plain(value()))
            return
        for line in lines():
            echo(on_terminal(line, 22))


def _tell_paths(paths: list[Path]) -> None:
    for path in paths:
        say(f"figure: {path}")


@contextmanager
def _bar(title: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on stderr if it is a terminal: call what is yielded with the share that
    is done.
    """
    from rich.progress import Progress

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as bars:
        task = bars.add_task(title, total=1.0)
        yield lambda share: bars.update(task, completed=share)


@contextmanager
def _steps(count: int) -> Iterator[Callable[[str], None]]:
    """Show which step runs: call what is yielded with its name."""
    from rich.progress import Progress

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bars:
        task = bars.add_task("", total=count)
        done = iter(range(count + 1))
        yield lambda name: bars.update(task, description=name, completed=next(done, count))


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


@analyse.command(epilog=EXIT_STATUS)
@click.argument("folder", type=click.Path(readable=False, path_type=Path, file_okay=False))
@figures_option
@click.option("--exploration", is_flag=True, help="How the hands moved, from the recordings.")
@json_option
def study(folder: Path, figures: Path | None, exploration: bool, as_json: bool) -> None:
    """Thresholds of a study that `coulombus experiment` has kept in FOLDER.

    Just noticeable differences with intervals of 95 % (profile likelihood), Weber fractions,
    exponents of magnitudes, all subjects together, and a mixed model where statsmodels is installed.
    How the hands explored is told where nothing was asked, or with --exploration. With --figures the
    report is written there with its pictures, as report.md.

    \b
    Examples:
      coulombus analyse study out/study
      coulombus analyse study out/study --figures out/figures --json
    """
    with errors():
        from coulombus.lab.study.results.pictures import write_figures
        from coulombus.lab.study.results.report import lines, report

        found = report(folder, exploration=exploration)
        if figures is not None:
            _tell_paths(write_figures(found, figures))
        if found["no_mixed_model"] is not None and len(found["subjects"]) > 1:
            say(f"coulombus: {found['no_mixed_model']}")
        with printed():
            if as_json:
                print_json(found)
            else:
                echo("\n".join(lines(found)))


@analyse.command(epilog=EXIT_STATUS)
@loop_options
@figures_option
@json_option
def nyquist(**options: Any) -> None:
    """Describing function, disks of the passive set, absolute stability (Figs. 2, 6, 7)."""
    with errors():
        from coulombus.analysis.figures.report import disk_of, nyquist_json, nyquist_lines, weights_at
        from coulombus.analysis.theory.absolute import absolute_stability
        from coulombus.analysis.theory.crossings import crossings

        parameters = _parameters(options)
        found, absolute = crossings(parameters), absolute_stability(parameters)
        disk = disk_of(parameters)
        weights = [weights_at(crossing.frequency_Hz, parameters) for crossing in found.found]
        _tell(
            options["as_json"],
            lambda: {**nyquist_json(found, disk, absolute), "alias_weights": weights},
            lambda: nyquist_lines(found, absolute),
        )
        if options["figures"]:
            from coulombus.analysis.figures.frequency import write_frequency_figures

            _tell_paths(write_frequency_figures(options["figures"], parameters, found, absolute))


@analyse.command("limit-cycle", epilog=EXIT_STATUS)
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

        parameters = _parameters(options)
        found = crossings(parameters)
        motions = orbits(parameters, longest=options["longest"], starts=options["starts"], seed=options["seed"])
        rows = () if options["no_table"] else delay_table(parameters, seed=options["seed"])
        seen = three_valued_orbits(parameters, options["zero"]) if parameters.resolution_m > 0 else ()
        most = l1_bound(parameters) if sample(parameters).spectral_radius < 1 - 1e-12 else None

        def text() -> Iterator[str]:
            yield f"describing function   {found.text}"
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
                f"{one.pattern:<17} {one.frequency_Hz:8.4g} Hz  peak {one.velocity_peak_m_s:.4g} m/s  "
                f"at {one.share:.0%} of the encoder's places"
                for one in seen
            )
            if rows:
                yield ""
                yield from delay_lines(rows)

        _tell(
            options["as_json"],
            lambda: {
                "crossings": plain(found.found),
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
            _tell_paths(paths + (write_delay_figure(options["figures"], rows) if rows else []))


@analyse.command(epilog=EXIT_STATUS, short_help="The spring of the stick phase: rho and K_max.")
@loop_options
@click.option(
    "--stiffness", type=click.FloatRange(0, 1e12), default=1e4, show_default=True, metavar="N/M", help="Its K_p."
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

        found = stuck_spring(_parameters(options), options["stiffness"])

        def text() -> Iterator[str]:
            word = "settles" if found.stable else "does not settle"
            yield f"K = {found.stiffness_N_m:g} N/m: {word}, rho = {found.radius:.9g}"
            yield f"K_max = {found.largest_N_m:.6g} N/m"

        _tell(options["as_json"], lambda: {"stuck": found, "stable": found.stable}, text)


@analyse.command(epilog=EXIT_STATUS, short_help="Figure 10: active and passive friction under the paper's force.")
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

        runs = figure_10(_parameters(options))

        def text() -> Iterator[str]:
            yield from fig10_lines(runs)
            for begin, end in runs.passive.stick_intervals_s:
                yield f"passive, stuck        {begin:9.5f} ... {end:9.5f} s"

        _tell(options["as_json"], lambda: fig10_json(runs), text)
        if options["figures"]:
            from coulombus.analysis.figures.time import write_fig10

            _tell_paths(write_fig10(options["figures"], runs))


@analyse.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@figures_option
@json_option
def hold(**options: Any) -> None:
    """Hold and stroke tests for active and hybrid display on the rig (Fig. 14), and hybrid's
    dependence on stick entry.
    """
    with errors():
        _hold(_rig(options), options["figures"], options["as_json"])


@analyse.command(epilog=EXIT_STATUS, short_help="How right the display is, and what that depends on.")
@rig_option
@set_option
@seed_option
@json_option
def felt(**options: Any) -> None:
    """Measure break-away and sliding friction at the hand against F_s and F_d, with the law's level as
    the brake's set-point and with law.level = "felt", and the error budget.
    """
    with errors():
        _felt(_rig(options), options["seed"], options["as_json"])


@analyse.command("z-width", epilog=EXIT_STATUS, short_help="How stiff a virtual wall may be, active and hybrid.")
@rig_option
@set_option
@seed_option
@figures_option
@json_option
def z_width(**options: Any) -> None:
    """The stiffest stable virtual wall over its damping, predicted and through the bus: all by the
    motor (active), or stiffness by the motor and damping by the brake (hybrid).

    \b
    Examples:
      coulombus analyse z-width --figures out/figures
      coulombus analyse z-width --set bus.delay_cycles=3 --json
    """
    with errors():
        _z_width(_rig(options), options)


@analyse.command("map", epilog=EXIT_STATUS)
@rig_option
@set_option
@click.option(
    "--axis",
    "axes",
    multiple=True,
    metavar="NAME=V1,V2,...",
    help="An axis and its values; several give every combination.",
)
@click.option(
    "--dask",
    metavar="ADDRESS",
    help="Compute on a dask.distributed cluster, as tcp://127.0.0.1:8786 (extra [cluster]).",
)
@click.option("--workers", type=click.IntRange(1), default=None, help="Threads.  [default: one for each processor]")
@figures_option
@json_option
def map_command(**options: Any) -> None:
    """Map where the active display oscillates and where it is quiet, with the bounds from the
    literature beside it.

    \b
    Examples:
      coulombus analyse map
      coulombus analyse map --axis rate_Hz=500,1000,2000 --axis friction_level=0.2,0.5,1
      coulombus analyse map --dask tcp://127.0.0.1:8786 --json
    """
    with errors():
        _map(_rig(options), options)


@analyse.command("laws", epilog=EXIT_STATUS, short_help="The friction laws held against the literature.")
@json_option
def laws_command(as_json: bool) -> None:
    """Compute the published benchmarks of the friction laws, their describing functions (v = 1 rad/s,
    1 Hz) and what they give back.

    Ends with 1 when a law does not give what the literature says.
    """
    with errors():
        from coulombus.analysis.theory.law_benchmarks import benchmarks, lines, plain, sweep

        with _steps(2) as step:
            step("benchmarks")
            found = benchmarks()
            step("describing functions")
            swept = sweep()
        with verdict(0 if all(one.ok for one in found) else 1):
            _tell(as_json, lambda: plain(found, swept), lambda: lines(found, swept))


def _all(options: dict[str, Any]) -> None:
    from coulombus.analysis.figures.report import as_json, lines, study

    parameters, rig = _parameters(options), _rig(options)
    with _steps(9) as step:
        found = study(parameters, rig, seed=options["seed"], step=step)
    _tell(options["as_json"], lambda: as_json(found), lambda: lines(found))
    if options["figures"]:
        from coulombus.analysis.figures.all import write_all

        _tell_paths(write_all(options["figures"], found))


def _hold(rig: Rig, figures: Path | None, as_json: bool) -> None:
    from coulombus.analysis.figures.report import hold_lines
    from coulombus.analysis.rig.hold import hold_study

    with _bar("hold") as report:
        found = hold_study(rig, progress=report)
    _tell(as_json, lambda: found, lambda: hold_lines(found))
    if figures:
        from coulombus.analysis.figures.rig import write_fig12, write_fig14, write_stick_figure

        _tell_paths(write_fig12(figures) + write_fig14(figures, found) + write_stick_figure(figures, found))


def _felt(rig: Rig, seed: int, as_json: bool) -> None:
    from coulombus.analysis.rig.felt import felt_study

    with _bar("felt") as report:
        found = felt_study(rig, seed=seed, progress=report)
    _tell(as_json, lambda: found, found.lines)


def _z_width(rig: Rig, options: dict[str, Any]) -> None:
    from coulombus.analysis.rig.wall_plane import wall_plane

    with _bar("z-width") as report:
        found = wall_plane(rig, seed=options["seed"], progress=report)
    _tell(options["as_json"], found.as_dict, found.lines)
    if options["figures"]:
        from coulombus.analysis.figures.rig import write_wall_plane

        _tell_paths(write_wall_plane(options["figures"], found))


def _map(rig: Rig, options: dict[str, Any]) -> None:
    from coulombus.analysis.figures.report import map_lines
    from coulombus.analysis.rig.maps import oscillation_map

    axes: dict[str, Any] = {}
    for given in options["axes"]:
        name, _, values = given.partition("=")
        try:
            axes[name] = [float(value) for value in values.split(",")]
        except ValueError:
            raise click.BadParameter(f"{given!r}: expected NAME=V1,V2,...", param_hint="--axis") from None
    try:
        with _bar("map") as report:
            found = oscillation_map(
                axes or None, base=rig, dask=options["dask"], workers=options["workers"], progress=report
            )
    except (ValueError, ImportError) as error:
        raise click.UsageError(str(error)) from error

    _tell(options["as_json"], lambda: found, lambda: map_lines(found))
    if options["figures"]:
        from coulombus.analysis.figures.rig import write_map

        try:
            _tell_paths(write_map(options["figures"], found))
        except ValueError as error:
            raise click.UsageError(str(error)) from error
