"""``coulombus sdo``: read and write a device's objects."""

from __future__ import annotations

import difflib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.device_options import (
    BesideOption,
    DeviceOptions,
    DevicesBusOption,
    LiveLine,
    NodeArgument,
    TimeoutOption,
    open_link,
)
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS, UNCHECKED_PATH, OutputFile
from coulombus.cli.options import JsonOption, OverwriteOption, argument, option, with_options
from coulombus.cli.tables import echo, table_console
from coulombus.system.exit import say, verdict
from coulombus.system.foreign_text import printable

if TYPE_CHECKING:
    from coulombus.host.devices.configuration import ObjectDifference
    from coulombus.host.devices.device import KnownDevice

__all__ = ["sdo"]

WIDTH = 80
CHECK_FAILED, ABORTED = 1, 6
STATE_BEHIND_COMMAND = (0x1010, 0x1011, 0x1023, 0x1024, 0x1F50, 0x1F51)
"""Objects whose write is a command (CiA 301, 7.5.2.13); a read returns a state, not the written value."""

ObjectArgument = Annotated[str, argument(metavar="OBJECT")]
TypeOption = Annotated[str, option("--type", "Data type without an EDS file, as UNSIGNED16.", default="", metavar="T")]
PartOption = Annotated[
    int, option("--part", "1: all; 2: communication; 3: application.", type=click.IntRange(1, 127), default=1)
]
StoringOption = Annotated[float, option("--timeout", "Time limit.", type=SECONDS, default=10.0, metavar="S")]


class SdoGroup(click.Group):
    """The verbs; a node instead of a verb opens the shell."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Insert the word `shell` before a node."""
        if args and not args[0].startswith("-") and not difflib.get_close_matches(args[0], self.commands):
            args = ["shell", *args]
        return super().parse_args(ctx, args)


@click.group(cls=SdoGroup, epilog=EXIT_STATUS)
def sdo() -> None:
    """Read and write the objects of a device by SDO; `coulombus sdo NODE` opens a shell.

    NODE is a node id, or a name of the rig in --rig or COULOMBUS_RIG (sdo get motor 1008h). Objects
    are named by number (6041h, 0x6041, 1018h:01; sub-indices are hexadecimal, too) or by
    their name in the EDS file. Values are typed and have units. Long ones go by block transfer.

    \b
    Examples:
      coulombus sdo get 5 1008h --bus socketcan:can0
      coulombus sdo set 5 Producer_heartbeat_time 100 --eds drive.eds --bus socketcan:can0
      coulombus sdo dump 5 drive.dcf --eds drive.eds --bus socketcan:can0
      coulombus sdo restore 5 drive.dcf --bus socketcan:can0
      coulombus sdo 5 --eds drive.eds --bus socketcan:can0
    """


@sdo.command(epilog=EXIT_STATUS)
@with_options
def get(
    node_id: NodeArgument,
    name: ObjectArgument,
    reached: DeviceOptions,
    output: Annotated[
        Path | None,
        option(
            "-o",
            "--out",
            "--output",
            "Write the object's bytes there; for long objects.",
            type=OutputFile(),
            metavar="F",
        ),
    ],
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Read an object: its value, its unit, and the raw number.

    \b
    Examples:
      coulombus sdo get 1 6041h --bus coulombus:bench
      coulombus sdo get motor 1008h --rig bench --bus coulombus:bench
      coulombus sdo get 2 7130h:01 --bus coulombus:bench --json
      coulombus sdo get 1 1021h --bus coulombus:bench -o device.eds
    """
    with errors():
        from coulombus.recording.output_file import new_file

        with reached.open(node_id) as (_, device), LiveLine() as show:
            variable = device.find(name)
            reading = device.read(variable, lambda done, total: show(f"{done} of {total or '?'} bytes"))
        if output is not None:
            with new_file(output, force=overwrite) as path:
                path.write_bytes(reading.data)
        with verdict(0):
            if as_json:
                print_json(reading.as_dict(node_id))
            elif output is None:
                echo(reading)
            else:
                say(f"{len(reading.data)} bytes are in {output}")
            if reading.remark:
                say(f"coulombus: {reading.remark}")


@sdo.command("set", epilog=EXIT_STATUS)
@with_options
def set_command(
    node_id: NodeArgument,
    name: ObjectArgument,
    value: Annotated[str, argument(metavar="VALUE")],
    reached: DeviceOptions,
    type_name: TypeOption,
    as_json: JsonOption,
) -> None:
    """Write an object, and read it back.

    The value is checked against type, limits and access of the EDS file before it is sent. A number
    is raw; with the object's unit behind it ("0.5 Nm") it is converted. Bytes are hexadecimal or a
    file's (@FILE). Ends with 1 when the device holds another value afterwards. Refused while a host
    is at work on the bus.

    \b
    Examples:
      coulombus sdo set 1 1017h 100 --bus coulombus:bench
      coulombus sdo set 2 7300h:01 "0.5 Nm" --bus coulombus:bench
      coulombus sdo set 5 2000h:03 7 --type UNSIGNED8 --bus socketcan:can0
    """
    with errors():
        with reached.open(node_id, to_write=True) as (_, device), LiveLine() as show:
            variable = device.find(name)
            data = device.parse(variable, value, type_name=type_name)
            back = device.write(variable, data, lambda done, total: show(f"{done} of {total} bytes"))
        commands = variable.index in STATE_BEHIND_COMMAND and back is not None
        equal = commands or back is None or back.data.rstrip(b"\0") == data.rstrip(b"\0")
        with verdict(0 if equal else CHECK_FAILED):
            if as_json:
                print_json(None if back is None else back.as_dict(node_id))
            else:
                echo("written; it can only be written" if back is None else str(back))
                if commands:
                    say(f"coulombus: {data.hex(' ')} was taken; a write of this object is a command")
            if not equal:
                say(f"coulombus: {data.hex(' ')} was written, and the device holds another value")


@sdo.command(epilog=EXIT_STATUS)
@with_options
def dump(
    node_id: NodeArgument,
    output: Annotated[Path, argument(type=OutputFile(".dcf"), metavar="F.dcf")],
    reached: DeviceOptions,
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Write the configuration of a device to a DCF file (CiA 306).

    All objects that can be read and written, but those that act when they are written: set-points,
    controlwords, what the RPDOs carry, commands.

    \b
    Examples:
      coulombus sdo dump 1 motor.dcf --bus coulombus:bench
      coulombus sdo dump 5 drive.dcf --eds drive.eds --bus socketcan:can0
    """
    with errors():
        from coulombus.eds.dcf_text import with_values
        from coulombus.eds.sdo_frames import where
        from coulombus.host.devices.configuration import dump as read_all
        from coulombus.recording.output_file import new_file

        with (
            reached.open(node_id) as (link, device),
            LiveLine() as show,
        ):
            description = _described(device)
            dumped = read_all(device, lambda done, total: show(f"{done} of {total} objects"))
            rate = link.bitrate_bit_s
        with new_file(output, force=overwrite) as path:
            path.write_text(with_values(description, dumped.values, node_id, rate), encoding="utf-8", newline="")
        with verdict(0):
            left_out = [where(*place) for place in dumped.left_out]
            if as_json:
                print_json({"values": len(dumped.values), "left_out": left_out, "aborted": list(dumped.aborted)})
            else:
                echo(f"{len(dumped.values)} values are in {output}")
                for text in dumped.aborted:
                    say(f"coulombus: not in it: {text}")
                if left_out:
                    say(f"coulombus: not in it, for they act when they are written: {', '.join(left_out)}")


def _described(device: KnownDevice) -> Any:
    """Return the EDS file of a device, which a DCF needs."""
    from coulombus.host.errors import DeviceMismatch

    if device.description is None:
        raise DeviceMismatch(
            f"node {device.node_id} is not a device of this project: name its EDS file by --eds, or --eds device, if it keeps one"
        )
    return device.description


@sdo.command(epilog=EXIT_STATUS)
@with_options
def restore(
    node_id: NodeArgument,
    dcf: Annotated[Path, argument(type=UNCHECKED_PATH, metavar="F.dcf")],
    bus_name: DevicesBusOption,
    timeout_s: TimeoutOption,
    beside: BesideOption,
    yes: Annotated[bool, option("Write without asking.")],
    as_json: JsonOption,
) -> None:
    """Write the values of a DCF file to a device: what differs is shown first, and only that is
    written.

    Every value is read back. PDOs are made invalid while their mapping changes; a device may want
    to be pre-operational for that (coulombus nmt preop NODE). A file of another device is refused
    (3). Nothing is stored in the device: that is `coulombus sdo store`. Ends with 6 when the device
    refused a value; all others are written.

    \b
    Examples:
      coulombus sdo restore 1 motor.dcf --bus coulombus:bench
      coulombus sdo restore 1 motor.dcf --bus coulombus:bench --yes --json
    """
    with errors():
        from coulombus.eds.reader import read_eds
        from coulombus.host.devices.configuration import Restored, check_file, differences
        from coulombus.host.devices.configuration import restore as write_all
        from coulombus.host.devices.device import KnownDevice
        from coulombus.host.sdo.sdo_client import LATE_S, SdoClient

        description = read_eds(dcf)
        restored = Restored()
        with open_link(bus_name, beside=beside) as link:
            device = KnownDevice(SdoClient(link, node_id, timeout_s, late_s=LATE_S), description)
            with LiveLine() as show:
                values = check_file(device, description)
                differing = differences(
                    device, description, values, lambda done, total: show(f"{done} of {total} objects")
                )
            if not as_json:
                _print_differences(differing)
            question = f"write {len(differing)} of {len(values)} values to node {node_id}?"
            if differing and not yes and not _agreed(question):
                with verdict(CHECK_FAILED):
                    say("coulombus: nothing was written")
            try:
                with LiveLine() as show:
                    write_all(
                        device, values, differing, lambda done, total: show(f"{done} of {total} written"), restored
                    )
            except BaseException:
                say(f"coulombus: {len(restored.written)} of {len(differing)} values were written before the end")
                raise
        with verdict(ABORTED if restored.failed else 0):
            if as_json:
                rows = [difference.as_dict() for difference in differing]
                print_json({"differences": rows, "written": len(restored.written), "failed": restored.failed})
            else:
                done = f"{len(restored.written)} of {len(differing)} values written; " if differing else ""
                echo(f"{done}{len(values) - len(differing)} were right already")
                for text in restored.failed:
                    say(f"coulombus: {text}")


def _agreed(question: str) -> bool:
    """Ask on the terminal; without a terminal nothing is written."""
    if not sys.stdin.isatty():
        raise click.UsageError("no terminal to ask on: give --yes")
    return click.confirm(printable(question), err=True)


def _print_differences(differences: list[ObjectDifference]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from coulombus.eds.sdo_frames import where

    if not differences:
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    for head, options in (("object", {"no_wrap": True}), ("name", {"overflow": "fold"}), ("device", {}), ("file", {})):
        table.add_column(head, **options)
    for difference in differences:
        in_device, in_file = (
            "-" if v is None else v.hex(" ") if isinstance(v, bytes) else str(v)
            for v in (difference.held, difference.wanted)
        )
        table.add_row(
            where(*difference.place), *(escape(text) for text in (difference.variable.name, in_device, in_file))
        )
    table_console(WIDTH).print(table)


@sdo.command(epilog=EXIT_STATUS)
@with_options
def store(
    node_id: NodeArgument,
    bus_name: DevicesBusOption,
    part: PartOption,
    timeout_s: StoringOption,
    beside: BesideOption,
) -> None:
    """Let a device keep its parameters when it is switched off (1010h, "save").

    \b
    Example:
      coulombus sdo store 1 --bus coulombus:bench
    """
    with errors():
        from coulombus.host.sdo.sdo_client import store_parameters

        with open_link(bus_name, beside=beside) as link:
            store_parameters(link, node_id, part, timeout_s)
        with verdict(0):
            echo(f"node {node_id} has stored its parameters (1010h:{part:02X})")


@sdo.command("restore-defaults", epilog=EXIT_STATUS)
@with_options
def restore_defaults(
    node_id: NodeArgument,
    bus_name: DevicesBusOption,
    part: PartOption,
    timeout_s: StoringOption,
    beside: BesideOption,
) -> None:
    """Give a device its maker's parameters back, from its next reset on (1011h, "load").

    \b
    Example:
      coulombus sdo restore-defaults 1 --bus coulombus:bench
    """
    with errors():
        from coulombus.host.sdo.sdo_client import load_defaults

        with open_link(bus_name, beside=beside) as link:
            load_defaults(link, node_id, part, timeout_s)
        with verdict(0):
            echo(f"node {node_id} has its defaults after: coulombus nmt reset {node_id} --bus {bus_name}")


@sdo.command(epilog=EXIT_STATUS)
@with_options
def shell(
    node_id: NodeArgument,
    reached: DeviceOptions,
) -> None:
    """Read and write objects one after the other, with completion of names (Tab) and a history.

    From a pipe the first line that fails ends it, with that line's exit status.

    \b
    Examples:
      coulombus sdo 1 --bus coulombus:bench
      echo "get 1008h" | coulombus sdo 1 --bus coulombus:bench
    """
    with errors():
        from coulombus.cli.sdo_shell import Shell, run

        with reached.open(node_id) as (link, device):
            run(Shell(link, device, beside=reached.beside))
