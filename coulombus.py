"""The command line: a thin dispatcher that imports a verb's package only when the verb runs.

As a module it offers the two functions that a script needs::

    from coulombus import read, simulate
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from analysis.command import analyse_group

if TYPE_CHECKING:
    from eds.rig import Rig
    from lab.demo import Demo
    from lab.simulate import RunResult, simulate
    from scope.recording import read

__all__ = ["main", "read", "simulate"]

EXIT_STATUS = """\b
Exit status:
  0  ok
  1  a check failed
  2  usage: a wrong option or argument
  3  configuration: rig file, EDS, law, or a device that is not what they say
  4  bus unavailable
  5  a node is missing
  6  a node aborted an SDO transfer
  7  safety: arming refused, or a trip led to the safe state
  8  deadlines or frames lost beyond the limit
130  interrupted (143: terminated)
"""

MODES = ("active", "passive", "hybrid")


def __getattr__(name: str) -> Any:
    if name == "simulate":
        from lab.simulate import simulate

        return simulate
    if name == "read":
        from scope.recording import read

        return read
    raise AttributeError(f"module 'coulombus' has no attribute {name!r}")


def _fail(text: str, status: int) -> None:
    click.echo(f"coulombus: {text}", err=True)
    sys.exit(status)


@contextmanager
def _errors() -> Iterator[None]:
    """Turn every error that a user can cause into its text and its exit status."""
    from eds.reader import EdsError
    from eds.rig import RigError

    try:
        yield
    except (RigError, EdsError) as error:
        _fail(str(error), 3)
    except BrokenPipeError:  # the reader of a pipe went away, as `head` does
        sys.stderr.close()
        sys.exit(0)
    except KeyboardInterrupt:
        _fail("interrupted", 130)
    except Exception as error:
        status = getattr(error, "exit_status", None)
        if status is None and isinstance(error, OSError):  # a file that cannot be read or written
            status = 2
        if status is None:
            raise
        _fail(str(error), status)


def _load(rig_name: str, overrides: tuple[str, ...]) -> Rig:
    """Load a rig and say on stderr what is allowed in it and yet may not be meant."""
    from eds.rig import load_rig

    rig = load_rig(rig_name, overrides)
    for warning in rig.warnings:
        click.echo(f"warning: {warning}", err=True)
    return rig


def _json(value: Any) -> None:
    click.echo(json.dumps(value, indent=2, allow_nan=False))


class _Seconds(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A length of time in s: a number above 0, at most a year."""

    name = "seconds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            seconds = float(value)
        except ValueError:
            seconds = float("nan")
        if not 0 < seconds <= YEAR_S:
            self.fail(f"{value!r}: expected a number above 0, at most {YEAR_S} (a year), in s", param, ctx)
        return seconds


YEAR_S = 31_557_600
SECONDS = _Seconds()

mode_option = click.option(
    "--mode", type=click.Choice(MODES), default="hybrid", show_default=True, help="Who displays the friction."
)
seconds_option = click.option(
    "--seconds",
    type=SECONDS,
    default=None,
    help="Length of the display.  [default: the rig's schedule]",
)
record_option = click.option(
    "--record", type=click.Path(dir_okay=False, path_type=Path), metavar="F.pcapng", help="Record every frame there."
)
rig_option = click.option(
    "--rig",
    "rig_name",
    default="bench",
    show_default=True,
    metavar="R",
    help="A packaged rig (bench, paper) or the path of a rig file.",
)
set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="SECTION.KEY=V",
    help="Set any key of the rig file, as in --set plant.inertia_kg_m2=3e-3. May be given several times.",
)
seed_option = click.option("--seed", default=0, show_default=True, help="Start of everything random.")
bus_option = click.option(
    "--bus", "bus_name", metavar="B", help="coulombus:NAME or socketcan:IF.  [default: coulombus:RIG]"
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON to stdout.")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EXIT_STATUS)
@click.version_option(package_name="coulombus", prog_name="coulombus")
def main() -> None:
    """Friction you can feel, over a CAN bus.

    A DC motor drive and an MR brake as CANopen nodes, a host that runs a friction law at 1 kHz through PDOs, and a bit-exact virtual
    bus with a simulated rig that stands in for the hardware.

    \b
    Examples:
      coulombus demo
      coulombus sim & coulombus run --mode hybrid --seconds 13
      coulombus simulate --mode hybrid --seconds 13 --record run.pcapng
      coulombus decode run.pcapng | less
      coulombus check --rig my-rig.toml
    """


@contextmanager
def _progress(enabled: bool) -> Iterator[Callable[[str, float, float], None]]:
    """Show live bars on stderr: call what is yielded with a label, the time reached and the whole time."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not enabled or not console.is_terminal:
        yield lambda label, t, total: None
        return
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(40),
        TextColumn("{task.completed:5.1f} of {task.total:.0f} s displayed"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def report(label: str, t: float, total: float) -> None:
            if label not in tasks:
                tasks[label] = bars.add_task(label, total=total)
            bars.update(tasks[label], completed=min(t, total))

        yield report


@main.command("simulate", epilog=EXIT_STATUS)
@rig_option
@mode_option
@seconds_option
@record_option
@seed_option
@set_option
@click.option(
    "--truth",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="F.npz",
    help="Save the plant's true course there, at its own step: time, angle, speed, torques, works.",
)
@json_option
def simulate_command(
    rig_name: str,
    mode: str,
    seconds: float | None,
    record: Path | None,
    seed: int,
    overrides: tuple[str, ...],
    truth: Path | None,
    as_json: bool,
) -> None:
    """Run the rig in virtual time: bring-up, arming, display, safe end - over real PDOs.

    The run lasts from the drive's Operation Enabled, where the operator's schedule begins. The display's figures are computed from the
    recording, so without --record they are null.

    \b
    Examples:
      coulombus simulate --mode active --seconds 13 --record active.pcapng
      coulombus simulate --rig paper --mode active --seconds 11 --json
      coulombus simulate --set operator.inertia_kg_m2=0.1 --set mode.active.F_s_Nm=0.8 --mode active
      coulombus simulate --truth truth.npz --record run.pcapng --seed 7
    """
    with _errors():
        from lab.demo import schedule_s
        from lab.simulate import simulate

        rig = _load(rig_name, overrides)
        if mode not in rig.mode:
            raise click.BadParameter(f"{mode!r}: rig {rig_name!r} has {', '.join(rig.mode)}", param_hint="--mode")
        total = schedule_s(rig) if seconds is None else seconds
        for path in (record, truth):
            if path is not None and not path.absolute().parent.is_dir():
                raise click.BadParameter(
                    f"{path}: there is no directory {path.absolute().parent}", param_hint="--record / --truth"
                )
        with _progress(not as_json) as report:
            result = simulate(
                rig, mode, total, record=record, seed=seed, truth=truth, progress=lambda t: report(mode, t, total)
            )
        if as_json:
            _json(result.as_dict())
        else:
            _print_runs({mode: result})
        sys.exit(result.exit_status)


REAL_TIME_ROWS = ("stopped_by", "wakeup_us", "sync_to_rpdo_us", "cpu_us_per_cycle", "deadman")


def _print_runs(results: dict[str, RunResult]) -> None:
    from rich.console import Console
    from rich.table import Table

    rows: tuple[tuple[str, str, str], ...] = (
        ("cycles displayed", "cycles", ""),
        ("lost PDOs", "lost_pdos", ""),
        ("missed deadlines", "missed_deadlines", ""),
        ("hold: velocity RMS", "hold_velocity_rms_rad_s", "rad/s"),
        ("hold: encoder peak to peak", "hold_counts_p2p", "counts"),
        ("hold: torque flips", "torque_flips_per_s", "/s"),
        ("hold: spectral peak", "hold_peak_Hz", "Hz"),
        ("hold: largest push", "hold_push_Nm", "Nm"),
        ("dwells: velocity RMS", "stick_velocity_rms_rad_s", "rad/s"),
        ("sign check", "sign_check", ""),
        ("recording", "recording", ""),
        ("stopped by", "stopped_by", ""),
        ("trip", "trip", ""),
        ("wake-up p50 / p99 / max", "wakeup_us", "us"),
        ("SYNC to RPDO p50 / p99 / max", "sync_to_rpdo_us", "us"),
        ("CPU a cycle", "cpu_us_per_cycle", "us"),
        ("dead man's switch", "deadman", ""),
    )
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for mode in results:
        table.add_column(mode, justify="right", overflow="fold")
    for label, field, unit in rows:
        cells = []
        for result in results.values():
            value = getattr(result, field)
            if isinstance(value, dict):
                value = " / ".join(f"{part:.0f}" for part in value.values())
            text = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
            cells.append(f"{text} {unit}".strip() if value is not None else text)
        if field not in REAL_TIME_ROWS or any(cell != "-" for cell in cells):
            table.add_row(label, *cells)
    Console().print(table)


@main.command("run", epilog=EXIT_STATUS)
@rig_option
@bus_option
@mode_option
@seconds_option
@record_option
@click.option(
    "--histogram",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="F.png",
    help="Draw wake-up and SYNC-to-RPDO times there.",
)
@set_option
@click.option("--cpu", type=int, default=None, help="CPU for the cycle's process.  [default: the last one]")
@json_option
def run_command(
    rig_name: str,
    bus_name: str | None,
    mode: str,
    seconds: float | None,
    record: Path | None,
    histogram: Path | None,
    overrides: tuple[str, ...],
    cpu: int | None,
    as_json: bool,
) -> None:
    """Run the host alone, in real time, on a bus where the nodes are: simulated ones (`coulombus sim`) or a rig.

    Ends safely when the time is over, on Ctrl-C (exit status 130), SIGTERM (143), `coulombus stop` (0), or a trip (7). After a trip nothing
    re-arms by itself. Real-time rights are asked for; what is refused is told with the command that grants it.

    \b
    Examples:
      coulombus sim &
      coulombus run --mode hybrid --seconds 13 --record run.pcapng
      coulombus run --bus socketcan:can0 --rig my-rig.toml --mode active --json
    """
    with _errors():
        from lab.demo import schedule_s
        from lab.real_run import Signals, real_run
        from wire.address import default_address, parse_address

        rig = _load(rig_name, overrides)
        if mode not in rig.mode:
            raise click.BadParameter(f"{mode!r}: rig {rig_name!r} has {', '.join(rig.mode)}", param_hint="--mode")
        total = schedule_s(rig) if seconds is None else seconds
        for path in (record, histogram):
            if path is not None and not path.absolute().parent.is_dir():
                raise click.BadParameter(
                    f"{path}: there is no directory {path.absolute().parent}", param_hint="--record / --histogram"
                )
        address = default_address(rig.rig.name) if bus_name is None else parse_address(bus_name)
        with Signals() as signals, _progress(not as_json) as report:
            result = real_run(
                rig,
                mode,
                total,
                bus=address,
                record=record,
                histogram=histogram,
                signals=signals,
                progress=lambda t: report(mode, t, total),
                cpu=cpu,
            )
        if as_json:
            _json(result.as_dict())
        else:
            _print_runs({mode: result})
        sys.exit(result.exit_status)


@main.command(epilog=EXIT_STATUS)
@rig_option
@bus_option
def stop(rig_name: str, bus_name: str | None) -> None:
    """Stop the host that runs on a bus safely: motor torque 0, brake ramped off, drive disabled. Waits for its end.

    \b
    Examples:
      coulombus stop
      coulombus stop --bus socketcan:can0
    """
    with _errors():
        from eds.rig import load_rig
        from host.control_socket import stop_host
        from wire.address import default_address, parse_address

        address = default_address(load_rig(rig_name).rig.name) if bus_name is None else parse_address(bus_name)
        result = stop_host(address)
        if not result:
            click.echo(f"the host on {address} ended without a word")
        elif result["trip"]:
            click.echo(f"the host on {address} had tripped: {result['trip']}")
        else:
            click.echo(f"the host on {address} stopped safely after {result['cycles']} cycles in mode {result['mode']}")


@main.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@seed_option
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    help="Directory for the results.",
)
@click.option("--virtual", is_flag=True, help="In virtual time: some seconds instead of half a minute, same bytes.")
@json_option
def demo(rig_name: str, overrides: tuple[str, ...], seed: int, out: Path, virtual: bool, as_json: bool) -> None:
    """Show the paper's experiment: active force feedback chatters, hybrid force feedback holds still.

    Runs both modes through the rig's schedule, each with the hold and the stroke, in real time: the simulated rig in one process, the host in
    others, PDOs at 1 kHz between them. Writes active.pcapng, hybrid.pcapng, demo.json and the figure demo.png. Exits with 1 unless
    active oscillates and hybrid holds still.

    \b
    Examples:
      coulombus demo
      coulombus demo --virtual
      coulombus demo --seed 3 --out out/third
    """
    with _errors():
        from lab.demo import DEMO_MODES, as_dict, run_demo, schedule_s
        from lab.figures import figure_14
        from scope.recording import read

        rig = _load(rig_name, overrides)
        missing = [mode for mode in DEMO_MODES if mode not in rig.mode]
        if missing:
            raise click.BadParameter(f"rig {rig_name!r} has no mode {missing[0]!r}", param_hint="--rig")
        total = schedule_s(rig)
        if virtual:
            with _progress(not as_json) as report:
                result = run_demo(rig, out, seed=seed, progress=lambda mode, t: report(mode, t, total))
        else:
            result = _real_demo(rig_name, overrides, seed, out, total, as_json)
        figure_14({mode: read(out / f"{mode}.pcapng") for mode in DEMO_MODES}, out / "demo.png")
        if as_json:
            _json(as_dict(result))
        else:
            _print_runs(result.results)
            click.echo()
            for criterion in result.criteria:
                mark = click.style("ok  ", fg="green") if criterion.holds else click.style("FAIL", fg="red")
                click.echo(f"{mark} {criterion.text}: {criterion.found}")
            click.echo(f"\nfigure and recordings: {out}/ (demo.png, active.pcapng, hybrid.pcapng, demo.json)")
        sys.exit(0 if result.passed else 1)


def _real_demo(rig_name: str, overrides: tuple[str, ...], seed: int, out: Path, total: float, as_json: bool) -> Demo:
    from eds.rig import load_rig
    from lab.real_demo import SHARED_MACHINE, run_real_demo
    from lab.real_run import Signals

    both = (*SHARED_MACHINE, *overrides)
    click.echo("for a machine shared with others: " + " ".join(f"--set {text}" for text in SHARED_MACHINE), err=True)
    with Signals() as signals, _progress(not as_json) as report:
        return run_real_demo(
            load_rig(rig_name, both),
            rig_name,
            out,
            seed=seed,
            overrides=both,
            signals=signals,
            progress=lambda mode, t: report(mode, t, total),
        )


@main.command(epilog=EXIT_STATUS)
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--rig", "rig_name", metavar="R", help="Decode with this rig instead of the attached one.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line to stdout.")
def decode(file: Path, rig_name: str | None, as_json: bool) -> None:
    """Print a recording frame by frame, PDOs by name in SI units.

    \b
    Examples:
      coulombus decode out/demo/hybrid.pcapng | less
      coulombus decode run.pcapng --json | jq 'select(.node == "motor")'
    """
    with _errors():
        from eds.rig import load_rig
        from scope.decode import as_text, rows
        from scope.recording import read

        recording = read(file, rig=None if rig_name is None else load_rig(rig_name))
        out = sys.stdout
        for row in rows(recording):
            out.write((json.dumps(row) if as_json else as_text(row)) + "\n")
        out.flush()


@main.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@json_option
def check(rig_name: str, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check a rig file, its EDS files, its PDO layout and whether a cycle fits on the bus; nothing is run.

    \b
    Examples:
      coulombus check --rig my-rig.toml
      coulombus check --rig bench --set bus.bitrate_bit_s=500000
    """
    with _errors():
        from host.controller import Controller
        from wire.load import cycle_load

        rig = _load(rig_name, overrides)
        diagnoses = [str(d) for node in ("motor", "brake") for d in rig.description(node).diagnoses]
        load = cycle_load(rig)
        limits = {
            mode: Controller(rig, mode).motor_limit_pm(float(_scale(rig, "motor.target_torque_Nm")))
            for mode in rig.mode
        }
        if as_json:
            _json(
                {
                    "rig": rig.rig.name,
                    "diagnoses": diagnoses,
                    "bitrate_bit_s": load.bitrate_bit_s,
                    "period_s": load.period_s,
                    "busy_s": load.busy_s,
                    "utilisation": load.utilisation,
                    "fits": load.fits,
                    "motor_limit_per_mille": limits,
                    "frames": [
                        {"name": f.name, "can_id": f.can_id, "bytes": f.length, "bits": f.bits} for f in load.frames
                    ],
                }
            )
        else:
            for text in diagnoses:
                click.echo(text)
            for pdo in rig.pdos():
                click.echo(
                    f"\n{pdo.node} {pdo.layout.direction.upper()}{pdo.layout.number}, COB-ID {pdo.layout.cob_id:03X}h, "
                    f"transmission type {pdo.layout.transmission}"
                )
                click.echo(pdo.layout.diagram())
                for signal in pdo.signals:
                    click.echo(
                        f"  {signal.name:<28} = raw x {signal.scale:.9g}" + (f" {signal.unit}" if signal.unit else "")
                    )
            click.echo(f"\nworst case on the wire at {load.bitrate_bit_s / 1e6:g} Mbit/s:")
            for frame in load.frames:
                click.echo(f"  {frame.can_id:03X}h  {frame.name:<14} {frame.length} bytes  {frame.bits:>4} bits")
            click.echo(
                f"  together {load.busy_s * 1e6:.0f} us of each {load.period_s * 1e6:.0f} us: {load.utilisation:.1%}"
            )
            for mode, limit in limits.items():
                click.echo(f"mode {mode}: drive torque limit 6072h = {limit} per mille")
            click.echo(
                "ok"
                if load.fits
                else "FAIL: the cycle does not fit on the bus; raise bus.bitrate_bit_s or bus.period_s"
            )
        sys.exit(0 if load.fits else 1)


@main.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@click.option("--bus", "bus_name", metavar="B", help="coulombus:NAME or socketcan:IF.  [default: coulombus:RIG]")
@click.option("--seconds", type=SECONDS, default=None, help="End after this time.")
@click.option(
    "--interval",
    type=click.FloatRange(0.02),
    default=None,
    help="Seconds between two looks.  [default: 0.1 in a terminal, else 1]",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line to stdout.")
def watch(
    rig_name: str,
    overrides: tuple[str, ...],
    bus_name: str | None,
    seconds: float | None,
    interval: float | None,
    as_json: bool,
) -> None:
    """Show a bus live: PDOs by name in SI units with rate and age, states of the nodes, emergencies, losses.

    Nothing is sent. A live table in a terminal, else lines. Ends with 0 on Ctrl-C or SIGTERM, with 4 when the bus goes away.

    \b
    Examples:
      coulombus watch --bus coulombus:bench
      coulombus watch --bus socketcan:can0 --rig my-rig.toml
      coulombus watch --json --seconds 5 | jq .signals
    """
    with _errors():
        from scope.watch import watch as run
        from wire.address import default_address, parse_address

        rig = _load(rig_name, overrides)
        address = default_address(rig.rig.name) if bus_name is None else parse_address(bus_name)
        run(rig, address, seconds=seconds, as_json=as_json, interval_s=interval)


@main.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@click.option(
    "-o",
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="F.dbc",
    help="Write the file there.  [default: stdout]",
)
def dbc(rig_name: str, overrides: tuple[str, ...], out: Path | None) -> None:
    """Write a DBC file of the rig's PDOs and services, for cantools, SavvyCAN, PlotJuggler.

    \b
    Examples:
      coulombus dbc --rig bench -o bench.dbc
      cantools monitor -i coulombus -c bench bench.dbc
      candump -L can0 | cantools decode bench.dbc
    """
    with _errors():
        from eds.rig import load_rig
        from scope.dbc import dbc_text

        text = dbc_text(load_rig(rig_name, overrides))
        if out is None:
            sys.stdout.write(text)
            sys.stdout.flush()
            return
        try:
            out.write_text(text, encoding="cp1252", errors="replace")  # what readers of DBC files expect
        except OSError as error:
            raise click.BadParameter(f"{out}: {error.strerror}", param_hint="-o / --out") from None


def _scale(rig: Any, name: str) -> float:
    return next(float(signal.scale) for pdo in rig.pdos() for signal in pdo.signals if signal.name == name)


@main.command(epilog=EXIT_STATUS)
@rig_option
@click.option(
    "--bus", metavar="B", help="coulombus:NAME (built in) or socketcan:IF.  [default: coulombus:<rig's name>]"
)
@click.option(
    "--mode", type=click.Choice(MODES), default=None, help="Whose F_s sizes the operator's pushes.  [default: the last]"
)
@click.option("--seconds", type=SECONDS, default=None, help="End after so long.  [default: never]")
@click.option(
    "--script",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="F.toml",
    help="Switch nodes off, on, or reset them at given times (docs: lab/sim_script.py).",
)
@click.option("--unpaced", is_flag=True, help="Frames take no time: for measurements.")
@click.option("--priority", type=click.IntRange(0, 99), default=79, show_default=True, help="SCHED_FIFO; 0: ordinary.")
@click.option("--cpu", type=click.IntRange(0), default=None, help="Keep the bus on this CPU.")
@set_option
@seed_option
@json_option
def sim(
    rig_name: str,
    bus: str | None,
    mode: str | None,
    seconds: float | None,
    script: Path | None,
    unpaced: bool,
    priority: int,
    cpu: int | None,
    overrides: tuple[str, ...],
    seed: int,
    as_json: bool,
) -> None:
    """Serve a bus with the simulated nodes and the rig on it, in real time.

    One process is bus, motor drive, MR brake, mechanics and the operator's hand. Clients attach with --bus (coulombus run, watch), as
    python-can interface "coulombus" (can_logger -i coulombus -c bench), or on the SocketCAN interface. Prints one line when the bus is
    ready; ends with 0 on SIGINT and SIGTERM.

    \b
    Examples:
      coulombus sim
      coulombus sim --rig my-rig.toml --bus socketcan:vcan0
      coulombus sim --bus coulombus:test --seconds 60 --script faults.toml --json
    """
    with _errors():
        from eds.rig import load_rig
        from lab.sim_command import run_sim
        from lab.sim_script import read_script
        from lab.sim_server import SimServer
        from wire.address import default_address, parse_address

        rig = load_rig(rig_name, overrides)
        address = default_address(rig.rig.name) if bus is None else parse_address(bus)
        entries = () if script is None else read_script(script)
        chosen = mode or list(rig.mode)[-1]

        def make() -> SimServer:
            return SimServer(rig, address, mode=chosen, seed=seed, script=entries, unpaced=unpaced)

        sys.exit(run_sim(make, seconds, priority=priority or None, cpu=cpu, as_json=as_json))


@main.command("identify", epilog=EXIT_STATUS)
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--rig", "rig_name", metavar="R", help="Decode with this rig instead of the attached one.")
@click.option(
    "--figure", type=click.Path(dir_okay=False, path_type=Path), metavar="F", help="Write the plot there (.png, .svg)."
)
@json_option
def identify_command(file: Path, rig_name: str | None, figure: Path | None, as_json: bool) -> None:
    """Identify friction from a recording by least squares: Coulomb, viscous, and Stribeck where the data carry it.

    What is felt at the handle comes first, the device's own friction (the motor's torque added) second, each with its 95 % confidence
    interval. The recording needs strokes, to and fro, best at several speeds and with the coil off.

    \b
    Examples:
      coulombus simulate --mode active --record active.pcapng && coulombus identify active.pcapng
      coulombus identify strokes.pcapng --json
      coulombus identify strokes.pcapng --figure friction.png
    """
    with _errors():
        from analysis.identify import identify, lines
        from eds.rig import load_rig
        from scope.recording import read

        found = identify(read(file, rig=None if rig_name is None else load_rig(rig_name)))
        if figure is not None:
            from analysis.figures_rig import write_identification

            write_identification(figure, found)
        if as_json:
            _json(found.as_dict())
        else:
            click.echo("\n".join(lines(found)))


main.add_command(analyse_group(_errors, EXIT_STATUS))

if __name__ == "__main__":
    main()
