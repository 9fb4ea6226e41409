"""Shared parts of the device verbs: their bus, a host on it, one line of progress."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import errors
from coulombus.cli.option_types import SECONDS, UNCHECKED_PATH, InputPath
from coulombus.cli.options import ADAPTER, BUS_VARIABLE, RIG_VARIABLE, argument, option, with_adapter_options
from coulombus.system.exit import say
from coulombus.system.foreign_text import printable

if TYPE_CHECKING:
    from coulombus.host.devices.device import KnownDevice
    from coulombus.wire.bus_link import BusLink

__all__ = [
    "BesideOption",
    "DeviceOptions",
    "DevicesBusOption",
    "EdsFolderOption",
    "LiveLine",
    "NodeArgument",
    "NodeType",
    "NodesRigOption",
    "TimeoutOption",
    "open_link",
]


def _living_bus(context: click.Context, param: click.Parameter, bus_name: str | None) -> str | None:
    """Return the named bus, else the one virtual bus that is served, which is printed.

    Raises
    ------
    click.MissingParameter
        none is served, or several are; a CAN interface is never chosen unasked
    """
    bus_name = with_adapter_options(context, param, bus_name)
    if bus_name is not None or context.resilient_parsing:
        return bus_name
    from coulombus.wire.address import live_bus_names

    names = live_bus_names()
    if len(names) != 1:
        raise click.MissingParameter(ctx=context, param=param)
    say(f"coulombus: on the bus coulombus:{names[0]}")
    return f"coulombus:{names[0]}"


DevicesBusOption = Annotated[
    str,
    option(
        "--bus",
        "coulombus:NAME, socketcan:IF or can:INTERFACE:CHANNEL.  [default: the one virtual bus that is served]",
        metavar="B",
        envvar=BUS_VARIABLE,
        callback=_living_bus,
    ),
    ADAPTER,
]
BesideOption = Annotated[bool, option("--beside-host", "Also while a host runs on the bus, at your own risk.")]
EdsFolderOption = Annotated[
    Path | None,
    option(
        "--eds",
        "Folder of EDS and DCF files; each device's file is found there by its identity (1018h).",
        type=InputPath(file_okay=False),
        metavar="FOLDER",
    ),
]
NodesRigOption = Annotated[
    str | None,
    option("--rig", "A rig that has the node: its name, its EDS file, its SI units.", metavar="R", is_eager=True),
]


class NodeType(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A node id, or the name of a node in the rig of --rig or COULOMBUS_RIG."""

    name = "node"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the node id."""
        text = str(value)
        if text.isdecimal() and 1 <= int(text) <= 127:
            return int(text)
        text_of_rig = None if ctx is None else ctx.params.get("rig_name")
        rig_name = text_of_rig if isinstance(text_of_rig, str) else os.environ.get(RIG_VARIABLE)
        if text.lstrip("+-").isdecimal() or rig_name is None:
            self.fail(
                f"{text!r}: expected a node id, 1 to 127, or a node's name and its rig, as --rig bench (or COULOMBUS_RIG)",
                param,
                ctx,
            )
        with errors():
            from coulombus.cli.rig_options import load

            ids = {node.name: node.node_id for node in load(rig_name, ()).nodes}
        if text not in ids:
            self.fail(f"{text!r}: the rig {rig_name} has the nodes {', '.join(ids)}", param, ctx)
        return ids[text]

    def get_missing_message(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Return how a node is named."""
        return "It is a node id, 1 to 127; or a node's name and its rig, as motor --rig bench"


NodeArgument = Annotated[int, argument(type=NodeType(), metavar="NODE")]
TimeoutOption = Annotated[
    float,
    option(
        "--timeout",
        "Time limit for an answer; after a write of 1010h or 1011h, 10 s at least.",
        type=SECONDS,
        default=1.0,
        metavar="S",
    ),
]


@contextmanager
def open_link(bus_name: str, *, beside: bool = False) -> Iterator[BusLink]:
    """Open a bus for a service, alone or together with a host, which is then reported."""
    from coulombus.host.devices.running_host import FILTERS, check_alone
    from coulombus.wire.address import WITH_ADAPTERS, parse_address
    from coulombus.wire.bus_link import BusLink

    address = parse_address(bus_name, WITH_ADAPTERS)
    with BusLink(address, FILTERS) as link:
        host = check_alone(link, address, beside=beside)
        if host:
            say(f"coulombus: a host is on bus {address}: {host}; its display may be disturbed")
        yield link


class LiveLine:
    """A progress line of a service on stderr, if that is a terminal."""

    def __init__(self) -> None:
        from coulombus.system.printable_console import PrintableConsole

        self._console = PrintableConsole(stderr=True)
        self._last_s, self._shown = 0.0, False

    def __enter__(self) -> LiveLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            self._write("")

    def __call__(self, text: str) -> None:
        """Show a text, at most ten times a second."""
        if time.monotonic() - self._last_s > 0.1:
            self._last_s, self._shown = time.monotonic(), True
            self._write(text)

    def _write(self, text: str) -> None:
        if self._console.is_terminal:
            self._console.file.write(f"\r\x1b[2K{printable(text)[: self._console.width - 1]}")
            self._console.file.flush()


@dataclass(frozen=True)
class DeviceOptions:
    """Connection and description of a device, from the options."""

    bus_name: DevicesBusOption
    eds: Annotated[
        Path | None,
        option(
            "Its EDS, DCF, XDD or XDC file; a folder, in which it is found by 1018h; or `device`: what the device keeps (1021h).",
            type=UNCHECKED_PATH,
            metavar="E",
        ),
    ]
    rig_name: NodesRigOption
    timeout_s: TimeoutOption
    beside: BesideOption

    @contextmanager
    def open(self, node_id: int, *, to_write: bool = False) -> Iterator[tuple[BusLink, KnownDevice]]:
        """Open the bus and a node on it, with its EDS file if there is one.

        Parameters
        ----------
        to_write : refuse if a host runs on the bus, unless the options allow it
        """
        from coulombus.host.devices.device import KnownDevice, describe
        from coulombus.host.sdo.sdo_client import LATE_S, SdoClient

        if self.eds is not None and self.rig_name is not None:
            raise click.UsageError("the EDS file is that of --eds, or that of --rig; give one of them")
        with open_link(self.bus_name, beside=self.beside or not to_write) as link:
            client = SdoClient(link, node_id, self.timeout_s, late_s=LATE_S)
            if self.rig_name is not None:
                description, units = _of_rig(self.rig_name, node_id)
                yield link, KnownDevice(client, description, units)
                client.settle()
                return
            with LiveLine() as show:
                source = "device" if self.eds is not None and str(self.eds) == "device" else self.eds
                description = describe(client, source, lambda done, total: show(f"EDS file: {done} of {total} bytes"))
            yield link, KnownDevice(client, description)
            client.settle()


def _of_rig(rig_name: str, node_id: int) -> tuple[Any, dict[tuple[int, int], Any]]:
    """Return the EDS file of a node of a rig, and the units of its signals."""
    from coulombus.cli.rig_options import load
    from coulombus.eds.units import Unit
    from coulombus.host.errors import DeviceMismatch

    rig = load(rig_name, ())
    units = {
        (signal.index, signal.subindex): Unit(signal.scale, signal.unit, signal.offset)
        for pdo in rig.pdos()
        if pdo.node_id == node_id
        for signal in pdo.signals
        if signal.unit
    }
    for axis in rig.axes:
        for name in axis.devices:
            if axis.part(name).node_id == node_id:
                return axis.description(name), units
    raise DeviceMismatch(f"the rig {rig_name} has no node {node_id}")
