"""What a verb knows of a bus, as bundled options: a rig and its buses, or EDS files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import click
from click.core import ParameterSource

from coulombus.cli.bundle import bundle
from coulombus.cli.common import (
    adapter_option,
    any_bus_option,
    bus_option,
    buses_option,
    channel_option,
    file_channel_option,
    load_with_law,
    log_eds_option,
    rig_option,
    set_option,
)
from coulombus.cli.errors import remark

if TYPE_CHECKING:
    from pathlib import Path

    from coulombus.eds.eds_folder import EdsFiles
    from coulombus.recording.maps.known_bus import KnownBus
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = [
    "BusesOptions",
    "KnownBusOptions",
    "LogOptions",
    "OneBusOptions",
    "RigOptions",
    "WatchedBusOptions",
    "buses_options",
    "eds_files_of",
    "known_bus_options",
    "log_options",
    "one_bus_options",
    "one_channel_option",
    "rig_options",
    "watched_bus_options",
]


def eds_files_of(texts: tuple[str, ...], *, with_rig: bool = False) -> EdsFiles:
    """Return the files of --eds; print those of a folder that cannot be read.

    Parameters
    ----------
    with_rig : --rig is given, too

    Raises
    ------
    click.UsageError
        Both are given.
    """
    from coulombus.eds.eds_folder import eds_files

    if texts and with_rig:
        raise click.UsageError("--rig and --eds: the rig has EDS files; leave one of them out")
    files = eds_files(texts)
    remark(files.refused)
    return files


def _source_of(name: str) -> ParameterSource | None:
    return click.get_current_context().get_parameter_source(name)


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

    def found(self) -> tuple[Rig, BusAddress]:
        """Return the rig of the bus, and the bus' address."""
        from coulombus.rigs.buses import one_bus

        return one_bus(self.load(), self.bus_name, self.channel)


@dataclass(frozen=True)
class KnownBusOptions(RigOptions):
    """A rig, and its bus of a channel, or EDS files."""

    channel: str | None
    eds: tuple[str, ...]
    finds_nodes: ClassVar[bool] = False
    """Whether the bus shows which node a file of a folder is for."""

    @property
    def names_rig(self) -> bool:
        """Whether the rig is given, and not the default."""
        return _source_of("rig_name") is not ParameterSource.DEFAULT

    def files(self) -> EdsFiles:
        """Return the EDS files; see `eds_files_of`."""
        files = eds_files_of(self.eds, with_rig=_source_of("rig_name") is ParameterSource.COMMANDLINE)
        if self.eds and self.overrides:
            raise click.UsageError("--set changes a rig: leave it or --eds out")
        return files

    def known(self, bus_name: str | None = None) -> tuple[KnownBus, BusAddress]:
        """Return what EDS files, else the rig, tell of a bus, and its address; print what is left out."""
        from coulombus.recording.maps.known_bus import KnownBus
        from coulombus.rigs.buses import one_bus
        from coulombus.wire.address import WITH_ADAPTERS, default_address, parse_address

        files = self.files()
        if not self.eds:
            rig, address = one_bus(self.load(), bus_name, self.channel, WITH_ADAPTERS)
            return KnownBus(rig), address
        known = KnownBus(eds=files)
        remark(known.remarks)
        if not (known.nodes or self.finds_nodes):
            reason = "an EDS file has no node id, and nothing here shows it"
            raise click.UsageError(f"--eds: {reason}; name the node of each file, as in --eds 5=drive.eds")
        address = default_address(self.rig_name) if bus_name is None else parse_address(bus_name, WITH_ADAPTERS)
        return known, address

    def of_file(self, file: Path) -> KnownBus:
        """Return what is known of a recording's bus: by rig or EDS files, given or attached, and by its SDO."""
        from coulombus.recording.maps.known_bus import KnownBus
        from coulombus.recording.reading import blocks

        is_given = bool(self.overrides) or (self.names_rig and not self.eds)
        source = blocks(file, self.load() if is_given else None, self.channel, eds=self.files())
        return KnownBus(source.known_rig, learned=source.pdos)

    def of_node(self, bus_name: str | None, node_id: int) -> tuple[KnownBus, BusAddress]:
        """Ask a node for its PDOs; return them, and the bus' address."""
        from coulombus.cli.device_options import open_link
        from coulombus.host.devices.dictionary_scan import pdo_objects
        from coulombus.host.sdo.sdo_client import SdoClient
        from coulombus.recording.maps.known_bus import KnownBus
        from coulombus.wire.address import WITH_ADAPTERS, parse_address

        if bus_name is None:
            raise click.UsageError("--node is a device on a bus: name it with --bus")
        if _source_of("rig_name") is ParameterSource.COMMANDLINE or self.overrides:
            raise click.UsageError("--node asks the device: leave --rig and --set out")
        files = self.files()
        with open_link(bus_name, beside=True) as link:
            objects = pdo_objects(SdoClient(link, node_id))
        return KnownBus.of_device(node_id, objects, files), parse_address(bus_name, WITH_ADAPTERS)


@dataclass(frozen=True)
class WatchedBusOptions(KnownBusOptions):
    """A rig and one of its buses, or the EDS files of a bus without a rig."""

    bus_name: str | None
    finds_nodes: ClassVar[bool] = True


@dataclass(frozen=True)
class LogOptions:
    """What is known of a recording's bus: a rig, else EDS files, else the recording itself."""

    rig_name: str | None
    eds: tuple[str, ...]
    channels: tuple[str, ...]

    def files(self) -> EdsFiles:
        """Return the EDS files; see `eds_files_of`."""
        return eds_files_of(self.eds, with_rig=self.rig_name is not None)


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
watched_bus_options = bundle(
    "chosen",
    WatchedBusOptions,
    *(rig_option, set_option, any_bus_option, adapter_option, one_channel_option, log_eds_option),
)
known_bus_options = bundle("chosen", KnownBusOptions, rig_option, set_option, one_channel_option, log_eds_option)
log_options = bundle(
    "log",
    LogOptions,
    click.option("--rig", "rig_name", metavar="R", help="Decode with this rig instead of the attached one."),
    log_eds_option,
    file_channel_option,
)
buses_options = bundle("chosen", BusesOptions, rig_option, set_option, buses_option, channel_option)
