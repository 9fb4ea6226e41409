"""The rig of a verb, and its buses, as bundled options."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from coulombus.cli.bundle import bundle
from coulombus.cli.common import (
    adapter_option,
    any_bus_option,
    bus_option,
    buses_option,
    channel_option,
    load_with_law,
    rig_option,
    set_option,
)

if TYPE_CHECKING:
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress, Kind

__all__ = [
    "BusesOptions",
    "OneBusOptions",
    "RigOptions",
    "any_bus_options",
    "buses_options",
    "one_bus_options",
    "one_channel_option",
    "rig_options",
]


@dataclass(frozen=True)
class RigOptions:
    """A rig and its overrides, from the options."""

    rig_name: str
    overrides: tuple[str, ...]

    def load(self, *before: str) -> Rig:
        """Load the rig, and print its warnings to stderr.

        Parameters
        ----------
        before : SECTION.KEY=V, applied before the options' overrides
        """
        return load_with_law(self.rig_name, (*before, *self.overrides))


@dataclass(frozen=True)
class OneBusOptions(RigOptions):
    """A rig and one of its buses."""

    bus_name: str | None
    channel: str | None

    def found(self, also: Collection[Kind] = ()) -> tuple[Rig, BusAddress]:
        """Return the rig of the bus, and the bus' address; `also` as in `parse_address`."""
        from coulombus.rigs.buses import one_bus

        return one_bus(self.load(), self.bus_name, self.channel, also)


@dataclass(frozen=True)
class BusesOptions(RigOptions):
    """A rig and its buses: all of them, or that of one channel."""

    bus_names: tuple[str, ...]
    channel: str | None

    def addresses(self, rig: Rig) -> dict[str, BusAddress]:
        """Return the address of each bus by its channel."""
        from coulombus.rigs.buses import bus_addresses

        return bus_addresses(rig, self.bus_names, self.channel)


one_channel_option = click.option("--channel", metavar="C", help="Bus of a rig, or of a file, with several.")

rig_options = bundle("chosen", RigOptions, rig_option, set_option)
one_bus_options = bundle("chosen", OneBusOptions, rig_option, set_option, bus_option, one_channel_option)
any_bus_options = bundle(
    "chosen", OneBusOptions, rig_option, set_option, any_bus_option, adapter_option, one_channel_option
)
buses_options = bundle("chosen", BusesOptions, rig_option, set_option, buses_option, channel_option)
