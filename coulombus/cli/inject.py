"""``coulombus inject``: break a simulated bus or device while it runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS
from coulombus.cli.options import JsonOption, argument, option, with_options
from coulombus.cli.rig_options import FaultBusOption, bus_of_faults, mark_host
from coulombus.cli.tables import echo
from coulombus.system.exit import verdict

__all__ = ["inject"]


class Duration(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """Seconds, with or without a unit: 2, 2s, 500ms."""

    name = "T"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the seconds."""
        if not isinstance(value, str):
            return float(value)
        for unit, scale in (("ms", 1e-3), ("s", 1.0)):
            if value.endswith(unit):
                return float(SECONDS.convert(value.removesuffix(unit), param, ctx)) * scale
        return float(SECONDS.convert(value, param, ctx))


@click.command(epilog=EXIT_STATUS)
@with_options
def inject(
    fault: Annotated[str | None, argument(required=False)],
    where: Annotated[str | None, option("--on", "A node by its name or node id, or bus.", metavar="NODE|bus")],
    for_s: Annotated[
        float | None, option("--for", "Until then, as 2s or 500ms.  [default: until clear]", type=Duration())
    ],
    values: Annotated[
        tuple[str, ...], option("--set", "A key of the fault as in a fault file, such as rate=1e-4.", metavar="KEY=V")
    ],
    lists: Annotated[bool, option("--list", "List all faults; with a bus that runs, its nodes and what acts now.")],
    bus_name: FaultBusOption,
    as_json: JsonOption,
) -> None:
    """Break the bus or a device of a running `emulate` or `node`, until `coulombus clear`.

    The faults are those of fault files and scripts (docs/bus.md). Only the user of that process may
    do it. A recording has a marker. Ends with 2 for an unknown fault, or one that cannot act there,
    with 4 where no such bus runs, with 5 if the bus has no such node.

    \b
    Examples:
      coulombus inject --list
      coulombus inject over_current --on motor
      coulombus inject noise --on bus --for 2s --set rate=1e-4
      coulombus inject cut --on brake --bus coulombus:bench
    """
    with errors():
        if lists:
            _list(bus_name, as_json)
            return
        if fault is None:
            raise click.UsageError("a FAULT is missing; coulombus inject --list has all")
        from coulombus.sim_bus.faults.fault_kinds import KINDS
        from coulombus.sim_bus.faults.live_faults import BUS, kind_of

        kind = kind_of(fault)
        pairs = dict(_pair(text) for text in values)
        if where is None and not KINDS[kind].wire:
            raise click.UsageError(f"{kind} is a fault of one node: give --on NODE")
        bus = bus_of_faults(bus_name)
        text = bus.inject(kind, where or BUS, for_s, pairs)
        mark_host(bus.address, [text])
        with verdict(0):
            if as_json:
                print_json({"bus": str(bus.address), "done": [text], "acting": bus.state()["acting"]})
            else:
                echo(f"{bus.address}: {text}" + ("" if for_s is not None else "; coulombus clear ends it"))


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise click.BadParameter(f"'{text}': expected KEY=V, as in rate=1e-4", param_hint="--set")
    return key, value


def _list(bus_name: str | None, as_json: bool) -> None:
    """Print all faults, and the state of the bus that is named or runs."""
    from coulombus.sim_bus.faults.live_faults import catalogue
    from coulombus.sim_bus.server.fault_socket import fault_buses

    rows = catalogue()
    state = bus_of_faults(bus_name).state() if bus_name is not None or len(fault_buses()) == 1 else None
    with verdict(0):
        if as_json:
            print_json({"faults": rows, **(state or {})})
            return
        width = max(len(row["fault"]) for row in rows)
        for row in rows:
            echo(f"{row['fault']:<{width}}  {row['on']:<13}  {row['effect']}")
        for line in [] if state is None else _state_lines(state):
            echo(line)


def _state_lines(state: Mapping[str, Any]) -> Sequence[str]:
    lines = ["", f"bus {state['bus']}"]
    for node in state["nodes"]:
        lines.append(f"  {node['name']}, node {node['node_id']}: {', '.join(node['faults'])}")
    lines += [f"  bus: {', '.join(state['wire'])}"] if state["wire"] else []
    acting = [f"  {row['fault']} on {row['on']}, since {row['since_s']:.1f} s" for row in state["acting"]]
    return [*lines, "acts now:", *(acting or ["  nothing"])]
