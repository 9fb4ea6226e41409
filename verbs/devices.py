"""What the verbs for devices have in common: their bus, who else is on it, one line of progress."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coulombus.verbs.common import say

if TYPE_CHECKING:
    from coulombus.wire.bus_link import BusLink

__all__ = ["LiveLine", "beside_option", "devices_bus_option", "eds_folder_option", "open_link"]

devices_bus_option = click.option(
    "--bus", "bus_name", required=True, metavar="B", help="coulombus:NAME or socketcan:IF."
)
beside_option = click.option(
    "--beside-host", "beside", is_flag=True, help="Also while a host is at work on the bus, at your own risk."
)
eds_folder_option = click.option(
    "--eds",
    "eds_folder",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER",
    help="EDS and DCF files, in which those of the devices are looked for by 1018h.",
)


@contextmanager
def open_link(bus_name: str, *, beside: bool = False) -> Iterator[BusLink]:
    """Open a bus for a service: alone on it, or beside a host, which is said then."""
    from coulombus.host.devices.guard import FILTERS, check_alone
    from coulombus.wire.address import parse_address
    from coulombus.wire.bus_link import BusLink

    address = parse_address(bus_name)
    with BusLink(address, FILTERS) as link:
        found = check_alone(link, address, beside=beside)
        if found:
            say(f"coulombus: a host is on bus {address}: {found}; its display may be disturbed")
        yield link


class LiveLine:
    """One line on a terminal's stderr that tells how far a service is; nothing elsewhere."""

    def __init__(self) -> None:
        from rich.console import Console

        self._console = Console(stderr=True)
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
            self._console.file.write(f"\r\x1b[2K{text[: self._console.width - 1]}")
            self._console.file.flush()
