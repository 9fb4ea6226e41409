"""`coulombus plan`: check whether a rig's messages fit on its bus, with remedies."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import BIT_RATE, PICTURE
from coulombus.cli.options import JsonOption, OverwriteOption, option, with_options
from coulombus.cli.rig_options import RigOptions
from coulombus.cli.tables import echo, print_fitting, table_console
from coulombus.system.exit import say, verdict
from coulombus.system.wrap_text import hanging

if TYPE_CHECKING:
    from coulombus.rigs.plan.response_times import Errors, ResponseTime
    from coulombus.rigs.plan.rig_plan import Assumptions, RigPlan
    from coulombus.rigs.plan.role_costs import Remedy
    from coulombus.rigs.rig import Rig
else:
    Errors = Any  # of a field, whose annotation is read for --help: without importing the module

__all__ = ["as_dict", "message_rows", "plan_command", "role_rows"]

WATCHES = "motor and brake: sync_timeout_s, setpoint_fault_s"
WIDTH = 110
"""Maximum width of the table in a file or a pipe."""
PROSE = 80
HEADINGS = ("COB-ID", "message", "bits", "every", "cycle", "due", "block", "jitter", "worst", "limit", "")
LEFT = 2
"""Number of left-aligned columns."""


def as_dict(plan: RigPlan, rig: Rig) -> dict[str, Any]:
    """Return the plan for --json; times in us, the highest priority first."""
    from coulombus.rigs.plan.rig_plan import bitrates_that_fit, largest_axes, shortest_period_ns
    from coulombus.rigs.plan.role_costs import longer_period, without_roles

    shortest = shortest_period_ns(rig, plan)
    bus_errors = plan.assumptions.errors
    return {
        "rig": rig.name,
        "bus": rig.channels[0],
        "bitrate": plan.timing.bitrate_bit_s,
        "period_us": plan.timing.period_ns / 1e3,
        "axes": plan.axes,
        "utilisation": plan.utilisation,
        "fits": plan.fits,
        "reasons": list(plan.reasons),
        "cycle": {
            "fits": plan.cycle.fits,
            "busy_us": plan.busy_ns / 1e3,
            "latest_tpdo_us": plan.cycle.latest_ns("tpdo") / 1e3,
            "window_us": plan.timing.window_ns / 1e3,
            "latest_rpdo_us": plan.latest_rpdo_ns / 1e3,
            "slack_us": (plan.timing.period_ns - plan.latest_rpdo_ns) / 1e3,
            "latest_rpdo_with_us": {name: value / 1e3 for name, value in plan.interference_ns.items()},
        },
        "assumed": {
            "node_us": plan.timing.node_ns / 1e3,
            "host_us": plan.timing.host_ns / 1e3,
            "errors": bus_errors.count,
            "errors_interval_us": bus_errors.interval_ns / 1e3 if bus_errors.count else None,
        },
        "would_fit": {
            "bitrates": list(bitrates_that_fit(rig, plan)),
            "shortest_period_us": None if shortest is None else shortest / 1e3,
            "axes": largest_axes(rig, plan),
            "period": None if plan.fits else _change(longer_period(rig, plan, shortest)),
            "without": None if plan.fits else _change(without_roles(rig, plan)),
        },
        "roles": role_rows(plan, rig),
        "messages": message_rows(plan),
    }


def _change(change: Remedy | None) -> dict[str, Any] | None:
    if change is None:
        return None
    return {
        "period_us": change.period_ns / 1e3,
        "set": list(change.overrides),
        "roles": list(change.roles),
        "lost": list(change.lost),
    }


def role_rows(plan: RigPlan, rig: Rig) -> list[dict[str, Any]]:
    """Return a row for each entry of the rig's PDOs: its role and its time per cycle [us]."""
    from coulombus.rigs.plan.role_costs import role_costs

    return [
        {
            "role": cost.role,
            "node": cost.node,
            "object": cost.place,
            "pdo": cost.pdo,
            "bits": cost.bits,
            "wire_us": cost.wire_ns / 1e3,
            "saved_us": None if cost.saved_ns is None else cost.saved_ns / 1e3,
        }
        for cost in role_costs(rig, plan.timing.bitrate_bit_s)
    ]


def message_rows(plan: RigPlan) -> list[dict[str, Any]]:
    """Return a row for each message; times in us, the highest priority first."""
    cycle = {frame.message.name: frame for frame in plan.cycle.frames}

    def row(response: ResponseTime) -> dict[str, Any]:
        message, frame = response.message, cycle.get(response.message.name)
        return {
            "name": message.name,
            "can_id": message.can_id,
            "bits": message.bits,
            "response_us": response.response_ns / 1e3,
            "deadline_us": message.deadline_ns / 1e3,
            "period_us": message.period_ns / 1e3,
            "jitter_us": response.jitter_ns / 1e3,
            "blocking_us": response.blocking_ns / 1e3,
            "bounded": response.bounded,
            "fits": response.fits,
            "cycle_end_us": None if frame is None else frame.end_ns / 1e3,
            "cycle_deadline_us": None if frame is None else frame.deadline_ns / 1e3,
        }

    return [row(response) for response in plan.responses]


def _print(document: dict[str, Any]) -> None:
    from rich.table import Table

    rows = []
    for row in document["messages"]:
        cells = [f"{row['can_id']:03X}h", row["name"], str(row["bits"]), f"{row['period_us']:g}"]
        cells += ["" if row[key] is None else f"{row[key]:.0f}" for key in ("cycle_end_us", "cycle_deadline_us")]
        cells += [f"{row['blocking_us']:.0f}", f"{row['jitter_us']:.0f}" if row["bounded"] else ""]
        cells += [f"{row['response_us']:.0f}" if row["bounded"] else "no bound", f"{row['deadline_us']:.0f}"]
        rows.append((*cells, "[green]ok[/]" if row["fits"] else "[red]LATE[/]"))

    def build(left: Collection[str]) -> Table:
        table = Table(box=None, pad_edge=False, header_style="bold")
        columns = [place for place, heading in enumerate(HEADINGS) if heading not in left]
        for place in columns:
            table.add_column(HEADINGS[place], justify="left" if place < LEFT else "right", no_wrap=True)
        for cells in rows:
            table.add_row(*(cells[place] for place in columns))
        return table

    print_fitting(table_console(WIDTH), build, ("block", "jitter", "bits", "due"))
    _print_roles(document["roles"])
    cycle, would = document["cycle"], document["would_fit"]
    more = cycle["latest_rpdo_with_us"]
    rates = ", ".join(f"{rate // 1000}" for rate in would["bitrates"]) or "none of CiA 301's"
    period = would["shortest_period_us"]
    lines = (
        f"times in us, at {document['bitrate'] / 1e3:g} kbit/s; axes: {document['axes']}; all messages take {document['utilisation']:.1%} of the bus",
        f"TPDOs      all through {cycle['latest_tpdo_us']:.0f} after SYNC's release; the host waits for {cycle['window_us']:g}",
        f"RPDOs      the latest is through at {cycle['latest_rpdo_us']:.0f} of {document['period_us']:g}: slack {cycle['slack_us']:.0f}",
        f"           SYNC and PDOs alone {more['cycle']:.0f}, with heartbeats {more['heartbeats']:.0f}, with SDO {more['sdo']:.0f}, "
        f"with EMCY and NMT {more['emcy_nmt']:.0f}",
        f"would fit  at {rates} kbit/s with this period; with a period of {'-' if period is None else f'{period:g}'} or more at this bit rate; "
        f"at most {would['axes']} of such axes",
    )
    if document["bus"]:
        echo(f"\nbus {document['bus']}")
    echo("\n" + "\n".join(hanging(line, PROSE, 11) for line in lines))
    for reason in document["reasons"]:
        echo(hanging(f"  {reason}", PROSE, 4))
    if not document["fits"]:
        _print_changes(would)
    echo("ok: the plan fits" if document["fits"] else "FAIL: the plan does not fit")


def _print_roles(rows: list[dict[str, Any]]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for heading in ("role", "node", "object", "PDO"):
        table.add_column(heading, no_wrap=True)
    for heading in ("bits", "wire", "saved"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        saved = "needed" if row["saved_us"] is None else f"{row['saved_us']:.1f}"
        name = row["role"] or "(not used)"
        cells = (name, row["node"], row["object"], row["pdo"], str(row["bits"]), f"{row['wire_us']:.1f}")
        table.add_row(*cells, saved if row["role"] else "")
    echo()
    table_console(WIDTH).print(table)


def _print_changes(would: dict[str, Any]) -> None:
    """Print changes that make the plan fit: the period, or the roles."""
    period, without = would["period"], would["without"]
    if period is not None:
        echo(f"a period of {period['period_us']:g} us fits:")
        echo(f"  --set {' --set '.join(period['set'])}")
    elif would["shortest_period_us"] is not None:
        condition = f"{would['shortest_period_us']:g} us fits only with longer watches of SYNC and PDOs"
        echo(f"a period of {condition} ({WATCHES})")
    if without is None:
        echo("without the optional roles, too, this period does not fit")
        return
    echo(f"this period fits without {', '.join(without['roles'])}:")
    for text in without["set"]:
        echo(f"  --set '{text}'")
    for text in without["lost"]:
        echo(f"  lost: {text}")


def _draw(path: Path, plans: dict[str, RigPlan], *, force: bool) -> None:
    """Plot each bus, into separate files if there are several."""
    from coulombus.recording.output_file import new_file
    from coulombus.rigs.plan.gantt import write_gantt

    for channel, plan in plans.items():
        each = path.with_stem(f"{path.stem}-{channel}") if len(plans) > 1 else path
        with new_file(each, force=force) as beside:
            write_gantt(beside, plan)
        say(f"figure: {each}")


def _errors_option(ctx: click.Context, param: click.Parameter, value: str) -> Errors:
    from coulombus.rigs.plan.response_times import Errors

    try:
        return Errors.parse(value)
    except ValueError as error:
        raise click.BadParameter(str(error), ctx=ctx, param=param) from None


@dataclass(frozen=True)
class Traffic:
    """Differences of the planned traffic from the rig, from the options."""

    bitrate: Annotated[
        int | None, option("Bit rate, such as 500k.  [default: the rig's]", type=BIT_RATE, metavar="BIT/S")
    ]
    period_us: Annotated[
        float | None,
        option(
            "SYNC period; the TPDO window and the watches keep their share of it.  [default: the rig's]",
            type=click.FloatRange(100, 1e6),
        ),
    ]
    axes: Annotated[int | None, option("Number of axes.  [default: the rig's]", type=click.IntRange(1, 16))]

    def options(self) -> dict[str, Any]:
        """Return the arguments for `rigs.plan.rig_plan.plans`."""
        period_ns = None if self.period_us is None else round(self.period_us * 1e3)
        return {"bitrate_bit_s": self.bitrate, "period_ns": period_ns, "axes": self.axes}


@dataclass(frozen=True)
class Times:
    """Assumptions on devices, host and bus, from the options."""

    bus_errors: Annotated[
        Errors,
        option(
            "--errors",
            "At most N bus errors in any INTERVAL, perhaps at once: 1/10ms, 3/ms, 20/s.",
            default="0",
            metavar="N/INTERVAL",
            callback=_errors_option,
        ),
    ]
    node_us: Annotated[
        float | None,
        option(
            "Longest time from SYNC to a TPDO's queue.  [default: each device's response_us in the rig]",
            type=click.FloatRange(0, 1e6),
        ),
    ]
    host_us: Annotated[
        float | None,
        option(
            "Longest computing time of the host.  [default: the rig's host.compute_s]", type=click.FloatRange(0, 1e6)
        ),
    ]
    sporadic_ms: Annotated[
        float | None,
        option(
            "Shortest interval of EMCYs, SDO transfers, NMT.  [default: 10 periods]", type=click.FloatRange(0.1, 1e6)
        ),
    ]

    def assumptions(self) -> Assumptions:
        """Return them in ns, for the planner."""
        from coulombus.rigs.plan.rig_plan import Assumptions

        node, host = (None if us is None else round(us * 1e3) for us in (self.node_us, self.host_us))
        sporadic = None if self.sporadic_ms is None else round(self.sporadic_ms * 1e6)
        return Assumptions(node, host, sporadic, self.bus_errors)


@click.command("plan", epilog=EXIT_STATUS)
@with_options
def plan_command(
    options: RigOptions,
    as_json: JsonOption,
    traffic: Traffic,
    times: Times,
    gantt: Annotated[
        Path | None, option("Draw the worst cycle there (.png, .svg, .pdf).", type=PICTURE, metavar="F.png")
    ],
    overwrite: OverwriteOption,
) -> None:
    """Compute whether a rig's messages fit on its bus: worst-case response times, SYNC window,
    latest RPDO, slack; what each role costs on the wire. Where they do not fit, the period that
    would is named, and the roles without which they would.

    Exit status 0 when the plan fits, 1 when it does not; the late frames are named. docs/planner.md
    has the equations and how to read the table.

    \b
    Examples:
      coulombus plan
      coulombus plan --rig my-rig.toml --bitrate 500000 --period-us 2000
      coulombus plan --axes 2 --period-us 2000 --errors 1/10ms --gantt plan.png
      coulombus plan --json | jq .messages
    """
    with errors():
        from coulombus.rigs.plan.rig_plan import plans

        rig = options.load()
        try:
            by_channel = plans(rig, **traffic.options(), assumptions=times.assumptions())
        except ValueError as error:
            raise click.BadParameter(str(error), param_hint="--axes") from None
        if gantt is not None:
            _draw(gantt, by_channel, force=overwrite)
        documents = [as_dict(plan, rig.on(channel)) for channel, plan in by_channel.items()]
        worst = min(documents, key=lambda document: (document["fits"], -document["utilisation"]))
        with verdict(0 if worst["fits"] else 1):
            if as_json:
                several = {"buses": documents} if len(documents) > 1 else {}
                print_json({**worst, **several})
            else:
                for document in documents:
                    _print(document)
