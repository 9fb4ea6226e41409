"""``coulombus scan``: find the devices on a bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.device_options import BesideOption, DevicesBusOption, EdsFolderOption, LiveLine, open_link
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS
from coulombus.cli.options import JsonOption, option, with_options
from coulombus.cli.tables import echo, table_console
from coulombus.system.exit import say, verdict

if TYPE_CHECKING:
    from coulombus.eds.reader import Description
    from coulombus.host.devices.lss import Identity
    from coulombus.host.devices.scan import NodeAnswers

__all__ = ["scan"]

WIDTH = 80
MISSING = 5


@click.command(epilog=EXIT_STATUS)
@with_options
def scan(
    bus_name: DevicesBusOption,
    eds_folder: EdsFolderOption,
    listen_s: Annotated[
        float,
        option(
            "--listen",
            "Wait this many seconds for heartbeats and boot-ups of nodes that answer no SDO; 10 finds most.",
            type=click.FloatRange(0, 3600),
            default=0.0,
            metavar="S",
            show_default=False,
        ),
    ],
    timeout_s: Annotated[
        float, option("--timeout", "Time limit for an SDO answer.", type=SECONDS, default=0.5, metavar="S")
    ],
    no_lss: Annotated[bool, option("Do not look for devices without a node id.")],
    bitrates: Annotated[
        bool,
        option(
            "SocketCAN: listen at each bit rate of CiA 305 first, and scan at the one that fits. Sets the interface up."
        ),
    ],
    beside: BesideOption,
    as_json: JsonOption,
) -> None:
    """Find the devices on a bus: what they are, their state, which EDS file is theirs.

    Every node id is asked for its type and identity by SDO, in about a second. Nodes that
    answer none are found by their heartbeat or boot-up (--listen), devices without a node id by LSS
    fastscan. Nothing is written. Ends with 5 when no device was found.

    \b
    Examples:
      coulombus scan --bus socketcan:can0
      coulombus scan --bus socketcan:can0 --eds ~/eds --listen 10
      coulombus scan --bus socketcan:can0 --bitrates
      coulombus scan --bus coulombus:bench --json | jq '.nodes[].name'
    """
    with errors():
        from coulombus.eds.eds_folder import fitting, read_folder
        from coulombus.eds.own_devices import packaged
        from coulombus.host.devices.lss import LssMaster
        from coulombus.host.devices.scan import scan as ask_all
        from coulombus.host.devices.scan import trouble
        from coulombus.host.errors import NodeMissing

        remarks: list[str] = []
        files: list[Description] = list(packaged())
        if eds_folder is not None:
            described, refused = read_folder(eds_folder)
            files = [*described, *files]
            remarks += [f"{len(refused)} files of {eds_folder} cannot be read: {refused[0]}"] if refused else []
        if bitrates:
            _choose_bit_rate(bus_name)
        without: list[Identity] = []
        with LiveLine() as show, open_link(bus_name, beside=beside) as link:
            nodes = ask_all(
                link,
                listen_s=listen_s,
                timeout_s=timeout_s,
                progress=lambda label, done, total: show(f"{label} {done:.0f} of {total:.0f}"),
            )
            if not no_lss:
                with LssMaster(link) as master:
                    try:
                        without = master.unconfigured(lambda count: show(f"fastscan: {count} without a node id"))
                    except NodeMissing as error:
                        remarks.append(str(error))
            sentence = trouble(link.error_frames, link.error_classes, bool(nodes))
        remarks += [sentence] if sentence else []
        remarks += [answers.remark for answers in nodes if answers.remark]
        rows = [
            _row(answers, fitting(files, answers.identity, answers.numbers.get((0x1018, 3), 0))) for answers in nodes
        ]
        status = 0 if rows or without else MISSING
        if not rows and not without:
            remarks.append(_nobody(bus_name, listen_s))
        with verdict(status):
            if as_json:
                unconfigured = [
                    {**identity._asdict(), "eds": _path(fitting(files, identity[:2], identity.revision))}
                    for identity in without
                ]
                print_json({"nodes": rows, "unconfigured": unconfigured, "remarks": remarks})
            else:
                _print(rows, without, files)
                for text in remarks:
                    say(f"coulombus: {text}")


def _nobody(bus_name: str, listen_s: float) -> str:
    hint = "" if listen_s else "; nodes that only send heartbeats are found by --listen 10"
    rate = "; another bit rate: --bitrates" if bus_name.startswith("socketcan:") else ""
    rate = "; another bit rate: --bus-option bitrate=250000" if bus_name.startswith("can:") else rate
    return f"no node on {bus_name} answers: power, cable, termination, bit rate?{hint}{rate}"


def _path(description: Description | None) -> str | None:
    return None if description is None else description.path


def _row(answers: NodeAnswers, description: Description | None) -> dict[str, Any]:
    """Return a node for JSON; null: unknown."""
    keys = ("vendor_id", "product_code", "revision", "serial")
    identity = {key: answers.numbers.get((0x1018, part)) for part, key in enumerate(keys, 1)}
    return {
        "node_id": answers.node_id,
        "state": None if answers.state is None else answers.state.name,
        "device_type": answers.numbers.get((0x1000, 0)),
        **identity,
        "name": answers.name or None,
        "eds": _path(description),
    }


def _print(rows: list[dict[str, Any]], without: list[Identity], files: list[Description]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from coulombus.eds.eds_folder import fitting

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("node", justify="right", no_wrap=True)
    for head, ratio in (("state", None), ("device", 3), ("vendor, product, revision, serial", None), ("EDS", 2)):
        table.add_column(head, ratio=ratio, overflow="fold")

    def hexed(value: int | None) -> str:
        return "-" if value is None else f"{value:X}h"

    for row in rows:
        kind = row["device_type"]
        what = [row["name"] or "no name", *([f"CiA {kind & 0xFFFF}"] if kind is not None else [])]
        numbers = [hexed(row[key]) for key in ("vendor_id", "product_code", "revision", "serial")]
        state = (row["state"] or "-").lower().replace("_", "-")
        eds = "-" if row["eds"] is None else Path(row["eds"]).name
        table.add_row(str(row["node_id"]), state, escape(", ".join(what)), " ".join(numbers), escape(eds))
    for identity in without:
        file = fitting(files, identity[:2], identity.revision)
        eds = "-" if file is None else Path(file.path).name
        table.add_row("none", "no node id", "waits for LSS", " ".join(map(hexed, identity)), escape(eds))
    if rows or without:
        table_console(WIDTH).print(table)
    if without:
        echo("devices without a node id: give them one with `coulombus lss --set-id N`")


def _choose_bit_rate(bus_name: str) -> None:
    from coulombus.host.devices.bitrates import choose
    from coulombus.wire.address import WITH_ADAPTERS, parse_address

    address = parse_address(bus_name, WITH_ADAPTERS)
    if not address.is_interface:
        raise click.UsageError(
            "--bitrates is for socketcan: a virtual bus has one bit rate, and its clients have it, too; an adapter of "
            "python-can is opened with its own: --bus-option bitrate=250000"
        )
    with LiveLine() as show:
        rate = choose(address.name, lambda rate: show(f"listening at {rate} bit/s"))
    say(f"coulombus: {address} has {rate} bit/s now")
