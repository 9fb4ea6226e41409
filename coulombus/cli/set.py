"""``coulombus set``: change the parameters of a running host."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import BusOption, ChannelOption, JsonOption, RigOption, argument, option, with_options
from coulombus.cli.rig_options import host_addresses
from coulombus.cli.tables import echo, print_table, table_console
from coulombus.system.exit import verdict

__all__ = ["set_command"]

SECONDS = {"": 1.0, "s": 1.0, "ms": 1e-3}


def _values(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> dict[str, float]:
    """Return NAME=VALUE as numbers by name."""
    from coulombus.rigs.errors import number_hint

    numbers: dict[str, float] = {}
    for text in texts:
        name, equals, number = (part.strip() for part in text.partition("="))
        reason = f"{name} is given twice" if name in numbers else ""
        try:
            value = float(number)
        except ValueError:
            hint = number_hint(number, "") or "; expected NAME=VALUE, as in F_s=2.0"
            value, reason = float("nan"), f"'{number}' is not a number{hint}"
        if not equals or not name:
            reason = "expected NAME=VALUE, as in F_s=2.0"
        if reason:
            raise click.BadParameter(f"{text!r}: {reason}")
        numbers[name] = value
    return numbers


def _seconds(ctx: click.Context, param: click.Parameter, text: str | None) -> float | None:
    if text is None:
        return None
    match = re.fullmatch(r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*(ms|s|)\s*", text)
    try:
        return float(match[1]) * SECONDS[match[2]]  # type: ignore[index]  # None: TypeError
    except (TypeError, ValueError):
        raise click.BadParameter(f"{text!r}: expected a time, as in 0.5s or 500ms") from None


@dataclass(frozen=True)
class Manner:
    """Axis, ramp time and permission of a change, from the options."""

    axis: Annotated[str, option("Axis of a rig with several.", default="", metavar="NAME")]
    over_s: Annotated[
        float | None,
        option(
            "--over", "Ramp to the new values within this time.  [default: 0.5s]", callback=_seconds, metavar="TIME"
        ),
    ]
    undo: Annotated[bool, option("Take the last change back; again: the one before it.")]
    key: Annotated[
        str, option("The arm key that `coulombus run` has printed, on a real rig.", default="", metavar="KEY")
    ]

    def request(self, values: dict[str, float]) -> dict[str, Any]:
        """Return the request to the host."""
        request: dict[str, Any] = {"values": values, "axis": self.axis, "undo": self.undo, "key": self.key}
        return request if self.over_s is None else {**request, "over_s": self.over_s}


@click.command("set", epilog=EXIT_STATUS)
@with_options
def set_command(
    values: Annotated[dict[str, float], argument(nargs=-1, metavar="[NAME=VALUE]...", callback=_values)],
    manner: Manner,
    rig_name: RigOption,
    bus_name: BusOption,
    channel: ChannelOption,
    as_json: JsonOption,
) -> None:
    """Change parameters of the law while the host on a bus displays it; without any, list them.

    The host ramps to the new values within --over. A value out of its bounds is refused (2), and then
    nothing changes. Each change is a marker of the recording, `set ...`, from which a replay repeats
    it. A name may lack its unit. Ends with 4 where no host runs.

    \b
    Examples:
      coulombus set --bus coulombus:bench
      coulombus set F_s=2.0 F_d=1.5 --over 0.5s
      coulombus set --undo
    """
    with errors():
        from coulombus.host.run.control_socket import ask_change

        if manner.undo and values:
            raise click.UsageError("--undo takes the last change back: leave the values out")
        address, *others = host_addresses(rig_name, [bus_name] if bus_name else [], channel)
        if others:
            names = ", ".join(map(str, (address, *others)))
            raise click.UsageError(f"the rig has the buses {names}; name one with --channel or --bus")
        reply = ask_change(address, manner.request(values))
        with verdict(0):
            if as_json:
                print_json(reply)
            elif "marker" in reply:
                echo(str(reply["marker"]).partition(" [")[0])
            else:
                _list(reply)


def _list(reply: dict[str, Any]) -> None:
    """Print the parameters as text."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("parameter", no_wrap=True)
    for name in ("value", "from", "to"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit")
    for name, row in _rows(reply):
        low = f"above {row['low']:g}" if row["above_low"] else f"{row['low']:g}"
        table.add_row(name, f"{row['value']:g}", low, f"{row['high']:g}", row["unit"])
    console = table_console(80)
    print_table(console, table)
    if reply.get("arm_key"):
        echo("a change needs the arm key that coulombus run has printed: --key")


def _rows(reply: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return each parameter with its name, prefixed by its axis."""
    return [
        (f"{row['axis']}.{row['name']}" if row.get("axis") else row["name"], row)
        for rows in reply["parameters"]
        for row in rows
    ]
