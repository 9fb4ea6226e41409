"""``coulombus demo``: the paper's experiment, and suggestions for next steps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import OutputDirectory
from coulombus.cli.options import JsonOption, SeedOption, option, with_options
from coulombus.cli.rig_options import RigOptions, display_s, load
from coulombus.cli.run_table import print_arms, print_runs, print_verdict
from coulombus.cli.tables import echo, progress
from coulombus.system.exit import say, verdict
from coulombus.system.quoting import shell

if TYPE_CHECKING:
    from coulombus.lab.demo.demo import Demo
    from coulombus.recording.signals import Source

__all__ = ["demo", "next_steps"]


@dataclass(frozen=True)
class DemoOptions(RigOptions):
    """The rig of the demo, its world, its time, and the folder of its results."""

    seed: SeedOption
    out: Annotated[Path, option("Directory for the results.", type=OutputDirectory(), default=Path("out/demo"))]
    virtual: Annotated[bool, option("In virtual time: the whole schedule, and the same bytes every time.")]
    plane: Annotated[bool, option("Friction in the plane, on an arm (the rig plane, or --rig), in virtual time.")]


@click.command(epilog=EXIT_STATUS)
@with_options
def demo(options: DemoOptions, as_json: JsonOption) -> None:
    """Show the paper's experiment: active force feedback chatters, hybrid force feedback holds
    still.

    Runs both modes in real time, each through the hold and one stroke there and back of the rig's
    schedule: the simulated rig in one process, the host in others, PDOs at 1 kHz between them. Writes
    active.pcapng, hybrid.pcapng, demo.json and the figure demo.png. Exits with 1 unless active
    oscillates and hybrid holds still. --virtual adds hybrid at the active display's friction, and
    the brake alone. --plane shows a hand that holds the tip of an arm and draws a circle, with
    motors, brakes, and both.

    \b
    Examples:
      coulombus demo
      coulombus demo --virtual
      coulombus demo --plane
      coulombus demo --seed 3 --out out/third
    """
    if options.plane:
        _plane(options, as_json)
        return
    rig_name, out = options.rig_name, options.out
    with errors():
        from coulombus.lab.demo.demo import DEMO_MODES, TITLES, displays, run_demo
        from coulombus.lab.demo.traces import figure_14
        from coulombus.recording.reading import blocks

        rig = load(rig_name, options.overrides).alone()
        missing = [mode for mode in DEMO_MODES if mode not in rig.modes]
        if missing:
            raise click.BadParameter(f"rig {rig_name!r} has no mode {missing[0]!r}", param_hint="--rig")
        total = display_s(rig, None)
        if options.virtual:
            with progress(not as_json) as report:
                result = run_demo(rig, out, seed=options.seed, progress=lambda mode, t: report(mode, t, total))
        else:
            result = _real_demo(options, as_json)
        shown = {name: run for name, run in displays(rig).items() if name in result.results}
        columns = {TITLES[name]: (run.mode, blocks(out / f"{name}.pcapng")) for name, run in shown.items()}
        figure_14(columns, out / "demo.png")
        with verdict(0 if result.passed else 1):
            if as_json:
                print_json(result.as_dict())
            else:
                print_runs(result.results)
                echo()
                for criterion in result.criteria:
                    print_verdict(criterion.holds, f"{criterion.text}: {criterion.found}")
                echo(
                    f"\nfigure and recordings: {out}/ (demo.png, demo.json, {', '.join(f'{name}.pcapng' for name in shown)})"
                )
                echo("\ntry next:")
                for command, why in next_steps(rig_name, out, span_of_interest(blocks(out / "active.pcapng"))):
                    echo(f"  {command}\n      {why}")


def _plane(options: DemoOptions, as_json: bool) -> None:
    """Run the demo in the plane."""
    rig_name, out = options.rig_name if options.names_rig else "plane", options.out
    with errors():
        from coulombus.analysis.figures.plane_runs import draw_plane_demo
        from coulombus.lab.demo.plane_demo import run_plane_demo
        from coulombus.recording.pictures.plot import save_picture

        rig = load(rig_name, options.overrides)
        total = display_s(rig, None)
        with progress(not as_json) as report:
            result = run_plane_demo(rig, out, seed=options.seed, progress=lambda mode, t: report(mode, t, total))
        save_picture(draw_plane_demo(result), out / "demo.png")
        with verdict(0 if result.passed else 1):
            if as_json:
                print_json(result.as_dict())
                return
            print_arms(result.runs)
            echo()
            for criterion in result.criteria:
                print_verdict(criterion.holds, f"{criterion.text}: {criterion.found}")
            files = ", ".join(f"{mode}.pcapng" for mode in result.runs)
            echo(f"\nfigure and recordings: {out}/ (demo.png, demo.json, {files})")
            echo("\ntry next:")
            for command, reason in plane_steps(rig_name):
                echo(f"  {command}\n      {reason}")


def plane_steps(rig_name: str) -> tuple[tuple[str, str], ...]:
    """Return the commands suggested at the end of the demo in the plane, each with its purpose."""
    rig = f"--rig {shell(rig_name)}"
    return (
        (f"coulombus analyse plane {rig}", "what the rig can display in each place"),
        (f"coulombus simulate {rig} --law plane_viscous --record viscous.pcapng", "another law in the plane"),
        (
            f"coulombus emulate {rig} --web",
            f"the arm in a browser; then, in another terminal, `coulombus run {rig} --shared-machine`",
        ),
    )


def span_of_interest(recording: Source) -> str:
    """Return a fifth of a second in the recording's hold, or of its first phase, as an option of
    `plot`. A real-time recording begins some seconds earlier.
    """
    from coulombus.recording.measures import phases

    spans = phases(recording)
    shown = next((span for span in spans if span.kind == "hold"), spans[0] if spans else None)
    return "" if shown is None else f" --span {shown.begin_s + 1.0:.1f}:{shown.begin_s + 1.2:.1f}"


def next_steps(rig_name: str, out: Path, span: str = "") -> tuple[tuple[str, str], ...]:
    """Return the three commands suggested at the end of the demo, each with its purpose."""
    rig = "" if rig_name == "bench" else f"--rig {shell(rig_name)} "
    active = shell(str(out / "active.pcapng"))
    return (
        (f"coulombus plot {active}{span}", "the motor's oscillation, sample by sample"),
        (f"coulombus simulate {rig}--law lugre --record lugre.pcapng", "another friction, in seconds: `coulombus law`"),
        (
            f"coulombus emulate {rig}--web",
            "the rig in a browser; then, in another terminal, `coulombus run --shared-machine`",
        ),
    )


def _real_demo(options: DemoOptions, as_json: bool) -> Demo:
    from coulombus.lab.demo.real_demo import run_real_demo, shown_s
    from coulombus.rigs.overrides import SHARED_MACHINE
    from coulombus.rigs.rig import load_rig
    from coulombus.system.stop_signals import Signals

    both = (*SHARED_MACHINE, *options.overrides)
    say("for a machine shared with others:\n" + "\n".join(f"  --set {text}" for text in SHARED_MACHINE))
    rig = load_rig(options.rig_name, both).alone()
    total = shown_s(rig)
    with Signals() as signals, progress(not as_json) as report:
        return run_real_demo(
            rig,
            options.rig_name,
            options.out,
            seed=options.seed,
            overrides=both,
            signals=signals,
            progress=lambda mode, t: report(mode, t, total),
        )
