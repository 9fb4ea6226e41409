"""``coulombus measure``: measure the times of devices and host for the planner."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import CPU
from coulombus.cli.options import JsonOption, option, with_options
from coulombus.cli.rig_options import OneBusOptions
from coulombus.cli.tables import echo, table_console
from coulombus.system.exit import say, verdict
from coulombus.system.quoting import shell

if TYPE_CHECKING:
    from coulombus.host.run.measure import Measured
    from coulombus.rigs.rig import Rig

__all__ = ["measure"]

WIDTH = 80
MARK = "measured by coulombus measure"
"""Beginning of the comment above a written value."""


@click.command(epilog=EXIT_STATUS)
@with_options
def measure(
    bus_options: OneBusOptions,
    rounds: Annotated[int, option("SYNCs for each device.", type=click.IntRange(10, 100_000), default=500)],
    cycles: Annotated[int, option("Cycles of the host.", type=click.IntRange(100, 1_000_000), default=2000)],
    write: Annotated[bool, option("Write the values into the rig file; the old file is kept next to it.")],
    cpu: Annotated[int | None, option("CPU for the cycle's process.  [default: the last one]", type=CPU)],
    as_json: JsonOption,
) -> None:
    """Measure how long the devices take from SYNC to their TPDOs, and the host from the last TPDO
    to its RPDOs: response_us of each device and host.compute_s, which the planner counts.

    The devices are configured as for a run and made OPERATIONAL one by one. Only SYNC is sent: no
    controlword, no set-point, so that no drive is enabled. A bus on which another host cycles is
    refused. The host is measured without the bus, by the process that a run has.

    Ends with 1 when the rig's plan does not fit with the times that were measured.

    \b
    Examples:
      coulombus measure --rig my-rig.toml --bus socketcan:can0
      coulombus measure --rig my-rig.toml --bus socketcan:can0 --write
      coulombus measure --rig bench --json
    """
    with errors():
        from coulombus.host.run.measure import measure_rig
        from coulombus.rigs.buses import one_bus
        from coulombus.rigs.plan.rig_plan import plan

        rig = bus_options.load()
        if write:
            _refuse_to_write(bus_options.rig_name, rig, bus_options.overrides)
        on_bus, address = one_bus(rig, bus_options.bus_name, bus_options.channel)
        with _progress(not as_json, rounds, cycles) as report:
            measured = measure_rig(on_bus, address, rounds=rounds, cycles=cycles, cpu=cpu, progress=report)
        numbers = measured.numbers(on_bus)
        changed = on_bus.variant(*(f"{'.'.join(map(str, key))}={value!r}" for key, value in numbers.items()))
        fits = plan(changed).fits
        document = _document(measured, on_bus, str(address)) | {
            "values": {".".join(map(str, key)): value for key, value in numbers.items()},
            "fits": fits,
            "backup": None,
        }
        if write:
            try:
                document["backup"] = str(_write(rig, measured, on_bus))
            except Exception:  # keep the measured values
                say("\n".join(_lines(document)))
                raise
        with verdict(0 if fits else 1):
            if as_json:
                print_json(document)
            else:
                _print(document, bus_options.rig_name)


def _refuse_to_write(rig_name: str, rig: Rig, overrides: tuple[str, ...]) -> None:
    """Refuse --write for a packaged file, before anything is measured."""
    from coulombus.recording.output_file import reason_against
    from coulombus.rigs.rig import known_rigs

    if rig_name in known_rigs():
        text = f"the rig {rig_name} is the package's own; copy it first: cp {rig.path} my-rig.toml"
        raise click.BadParameter(text, param_hint="--write")
    if overrides:
        raise click.UsageError("--write changes the rig file, and --set is not in it: use one of them")
    path = Path(rig.path).resolve()
    for file in (path, path.with_name(f"{path.name}.bak")):
        reason = reason_against(file, force=True)
        if reason is not None:
            raise click.BadParameter(reason, param_hint="--write")


def _document(measured: Measured, rig: Rig, bus: str) -> dict[str, Any]:
    from coulombus.host.run.measure import TimeQuantiles

    before = {node.name: node.part.response_us for node in rig.nodes}
    devices = []
    for device in measured.devices:
        pdos = [
            {
                "pdo": pdo.name,
                "can_id": pdo.can_id,
                "missed": pdo.missed,
                **(_spread(TimeQuantiles.from_times(pdo.times_ns)) if pdo.times_ns else {}),
            }
            for pdo in device.pdos
        ]
        devices.append(
            {
                "node": device.plan.name,
                "node_id": device.plan.node_id,
                "tpdos": pdos,
                "why_not": device.why,
                "emergencies": list(device.emergencies),
                "response_us": measured.response_us(device),
                "before_us": before[device.plan.name],
            }
        )
    host = _spread(measured.host) | {"compute_s": measured.compute_s, "before_s": rig.host.compute_s}
    return {"rig": rig.name, "bus": bus, "devices": devices, "host": host, "real_time": list(measured.real_time)}


def _spread(spread: Any) -> dict[str, Any]:
    return {"count": spread.count, "p50_us": spread.p50, "p99_us": spread.p99, "max_us": spread.max}


def _write(rig: Rig, measured: Measured, on_bus: Rig) -> Path:
    """Write the values into the rig file, each with its source."""
    from coulombus.host.run.measure import TimeQuantiles
    from coulombus.rigs.rewrite import NewValue, replace_file, rewritten
    from coulombus.rigs.rig import load_rig_text

    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()

    def note(spread: TimeQuantiles) -> str:
        return f"{today}: p50 {spread.p50:.0f}, p99 {spread.p99:.0f}, max {spread.max:.0f} us of {spread.count}"

    times = {
        device.plan.name: [t for pdo in device.pdos for t in pdo.times_ns] for device in measured.devices if device.pdos
    }
    numbers = {}
    for key, value in measured.numbers(on_bus).items():
        name = str(key[-2]) if key[0] != "axis" else f"{key[1]}.{key[-2]}"
        spread = measured.host if key == ("host", "compute_s") else TimeQuantiles.from_times(times[name])
        numbers[key] = NewValue(value, note(spread))
    text = rewritten(rig.text, numbers, MARK, rig.path)
    load_rig_text(text, rig.path)  # check that the result is a valid rig
    return replace_file(Path(rig.path), rig.text, text)


def _lines(document: dict[str, Any]) -> list[str]:
    """Return the values as lines of a rig file."""
    return [f"{key} = {value!r}" for key, value in document["values"].items()]


def _print(document: dict[str, Any], path: str) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in ("what", "PDO"):
        table.add_column(heading, no_wrap=True)
    for heading in ("times", "p50", "p99", "max", "before", "proposed"):
        table.add_column(heading, justify="right", no_wrap=True)
    for device in document["devices"]:
        for pdo in device["tpdos"]:
            figures = [str(pdo.get("count", 0)), *(f"{pdo[key]:.0f}" for key in ("p50_us", "p99_us", "max_us"))]
            last = pdo is device["tpdos"][-1]
            ends = [f"{device['before_us']:.0f}", f"{device['response_us']:.0f}"] if last else ["", ""]
            table.add_row(device["node"], pdo["pdo"], *figures, *ends)
    host = document["host"]
    figures = [str(host["count"]), *(f"{host[key]:.0f}" for key in ("p50_us", "p99_us", "max_us"))]
    table.add_row("host", "", *figures, f"{host['before_s'] * 1e6:.0f}", f"{host['compute_s'] * 1e6:.0f}")
    table_console(WIDTH).print(table)
    echo("times in us; devices: from SYNC to their TPDOs; host: from the last TPDO to its RPDOs")
    for device in document["devices"]:
        if device["why_not"]:
            echo(f"{device['node']}: not measured, {device['why_not']}")
        for pdo in device["tpdos"]:
            if pdo["missed"]:
                echo(f"{device['node']}: {pdo['pdo']} did not come after {pdo['missed']} SYNCs")
        for code in device["emergencies"]:
            echo(f"{device['node']}: EMCY {code:04X}h while it was measured")
    for right in document["real_time"]:
        if not right["granted"]:
            echo(f"{right['name']}: refused ({right['detail']}); to have it: {right['remedy']}")
    if document["backup"] is None:
        echo("\n".join(_lines(document)))
    else:
        echo(f"written into {path}; the old file is {document['backup']}")
    if document["fits"]:
        echo("ok: the plan fits with these times")
    else:
        words = " ".join(f"--set {key}={value!r}" for key, value in document["values"].items())
        again = shell(str(path)) if document["backup"] is not None else f"{shell(str(path))} {words}"
        echo(f"FAIL: the plan does not fit with these times: coulombus plan --rig {again}")


@contextmanager
def _progress(enabled: bool, rounds: int, cycles: int) -> Iterator[Callable[[str, int], None]]:
    """Show a bar for each device and for the host, on a terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    if not enabled or not console.is_terminal:
        if enabled:
            say("coulombus: measuring, which takes some seconds a device; only SYNC is sent")
        yield lambda what, done: None
        return
    tasks: dict[str, TaskID] = {}
    with Progress(TextColumn("{task.description:<16}"), BarColumn(30), MofNCompleteColumn(), console=console) as bars:

        def report(what: str, done: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=cycles if what == "host" else rounds)
            bars.update(tasks[what], completed=done)

        yield report
