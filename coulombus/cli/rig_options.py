"""The rig, bus, host or EDS files that a verb means: options as values, and their loading."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import click
from click.core import ParameterSource

from coulombus.cli.errors import remark
from coulombus.cli.options import (
    BUS_VARIABLE,
    AnyBusOption,
    BusesOption,
    BusOption,
    ChannelOption,
    FileChannelOption,
    LogEdsOption,
    OneChannelOption,
    RigOption,
    SetOption,
    option,
)
from coulombus.system.exit import say

if TYPE_CHECKING:
    from pathlib import Path

    from coulombus.eds.eds_folder import EdsFiles
    from coulombus.recording.maps.known_bus import KnownBus
    from coulombus.rigs.rig import Rig
    from coulombus.sim_bus.server.fault_socket import BusFaults
    from coulombus.wire.address import BusAddress

__all__ = [
    "BusesOptions",
    "FaultBusOption",
    "KnownBusOptions",
    "LogOptions",
    "OneBusOptions",
    "RigOptions",
    "WatchedBusOptions",
    "bus_of_faults",
    "check_mode",
    "check_shared_machine",
    "display_s",
    "eds_files_of",
    "host_addresses",
    "load",
    "load_with_law",
    "mark_host",
]


def load(rig_name: str, overrides: tuple[str, ...]) -> Rig:
    """Load a rig and print its warnings to stderr."""
    from coulombus.rigs.rig import load_rig

    rig = load_rig(rig_name, overrides)
    for warning in rig.warnings:
        say(f"warning: {warning}")
    return rig


def load_with_law(rig_name: str, overrides: tuple[str, ...]) -> Rig:
    """Load a rig with its law, and print the warnings of both to stderr."""
    from coulombus.host.setup.law_demand import remarks

    rig = load(rig_name, overrides)
    for warning in remarks(rig):
        say(f"warning: {warning}")
    return rig


def check_shared_machine(addresses: Iterable[BusAddress]) -> None:
    """Refuse --shared-machine on a bus that is not built in."""
    real = [str(address) for address in addresses if address.moves_hardware]
    if real:
        text = (
            f"for simulated nodes only: on {real[0]} a motor could push unwatched for 50 ms; choose each limit by --set"
        )
        raise click.BadParameter(text, param_hint="--shared-machine")


def check_mode(rig: Rig, rig_name: str, mode: str) -> None:
    """Refuse a mode that the rig does not have."""
    if mode not in rig.modes:
        raise click.BadParameter(f"{mode!r}: rig {rig_name!r} has {', '.join(rig.modes)}", param_hint="--mode")


def display_s(rig: Rig, seconds: float | None) -> float:
    """Return the duration of the display: the given seconds, or the rig's schedule."""
    total = rig.schedule_s if seconds is None else seconds
    if not total > 0:
        raise click.UsageError(
            f"the rig {rig.name} has no schedule ([[phase]]) that would tell how long to display: give --seconds"
        )
    return total


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

    rig_name: RigOption
    overrides: SetOption

    @property
    def names_rig(self) -> bool:
        """Whether the rig is given, and not the default."""
        return _source_of("rig_name") is not ParameterSource.DEFAULT

    @property
    def rig_on_command_line(self) -> bool:
        """Whether the rig is given on the command line, and not by the environment."""
        return _source_of("rig_name") is ParameterSource.COMMANDLINE

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

    bus_name: BusOption
    channel: OneChannelOption

    def resolve(self) -> tuple[Rig, BusAddress]:
        """Return the rig of the bus, and the bus' address."""
        from coulombus.rigs.buses import one_bus

        return one_bus(self.load(), self.bus_name, self.channel)


@dataclass(frozen=True, kw_only=True)
class KnownBusOptions(RigOptions):
    """A rig, and its bus of a channel, or EDS files."""

    bus_name: str | None = None  # declared where a bus stands between rig and channel
    channel: OneChannelOption
    eds: LogEdsOption
    finds_nodes: ClassVar[bool] = False
    """Whether the bus shows which node a file of a folder is for."""

    def files(self) -> EdsFiles:
        """Return the EDS files; see `eds_files_of`."""
        files = eds_files_of(self.eds, with_rig=self.rig_on_command_line)
        if self.eds and self.overrides:
            raise click.UsageError("--set changes a rig: leave it or --eds out")
        return files

    def known_bus(self, bus_name: str | None = None) -> tuple[KnownBus, BusAddress]:
        """Return what EDS files, else the rig, tell of a bus, and its address; print what is left out."""
        from coulombus.recording.maps.known_bus import KnownBus
        from coulombus.rigs.buses import one_bus
        from coulombus.wire.address import WITH_ADAPTERS, default_address, parse_address

        files = self.files()
        if not self.eds:
            rig, address = one_bus(self.load(), bus_name, self.channel, WITH_ADAPTERS)
            return KnownBus(rig), address
        bus = KnownBus(eds=files)
        remark(bus.remarks)
        if not (bus.nodes or self.finds_nodes):
            reason = "an EDS file has no node id, and nothing here shows it"
            raise click.UsageError(f"--eds: {reason}; name the node of each file, as in --eds 5=drive.eds")
        address = default_address(self.rig_name) if bus_name is None else parse_address(bus_name, WITH_ADAPTERS)
        return bus, address

    def of_file(self, file: Path) -> KnownBus:
        """Return what is known of a recording's bus: by rig or EDS files, given or attached, and by its SDO."""
        from coulombus.recording.maps.known_bus import KnownBus
        from coulombus.recording.reading import blocks

        is_given = bool(self.overrides) or (self.names_rig and not self.eds)
        source = blocks(file, self.load() if is_given else None, self.channel, eds=self.files())
        return KnownBus(source.known_rig, learned=source.pdos)


@dataclass(frozen=True)
class WatchedBusOptions(KnownBusOptions):
    """A rig and one of its buses, or the EDS files of a bus without a rig."""

    bus_name: AnyBusOption
    finds_nodes: ClassVar[bool] = True


@dataclass(frozen=True)
class LogOptions:
    """What is known of a recording's bus: a rig, else EDS files, else the recording itself."""

    rig_name: Annotated[str | None, option("--rig", "Decode with this rig instead of the attached one.", metavar="R")]
    eds: LogEdsOption
    channels: FileChannelOption

    def files(self) -> EdsFiles:
        """Return the EDS files; see `eds_files_of`."""
        return eds_files_of(self.eds, with_rig=self.rig_name is not None)


@dataclass(frozen=True)
class BusesOptions(RigOptions):
    """A rig and its buses: all of them, or that of one channel."""

    bus_names: BusesOption
    channel: ChannelOption

    def addresses(self, rig: Rig) -> dict[str, BusAddress]:
        """Return the address of each bus by its channel."""
        from coulombus.rigs.buses import bus_addresses

        return bus_addresses(rig, self.bus_names, self.channel)


FaultBusOption = Annotated[
    str | None,
    option(
        "--bus",
        "coulombus:NAME.  [default: the one on which `emulate` or `node` runs]",
        envvar=BUS_VARIABLE,
        metavar="B",
    ),
]


def host_addresses(
    rig_name: str,
    bus_names: Sequence[str] = (),
    channel: str | None = None,
    *,
    every: bool | None = None,
    ended: bool = False,
) -> list[BusAddress]:
    """Return the buses of the selected hosts.

    They are those of ``--bus``, else those of a named rig, else that of the running host on this
    machine. If none runs, they are the buses of the default rig.

    Parameters
    ----------
    every : the option ``--all``; None: the verb has no such option
    ended : if none runs, the bus of the host that ended last counts before those of the default rig

    Raises
    ------
    click.UsageError
        several hosts run, none was named, and `every` was not given
    """
    from coulombus.host.run.control_socket import hosts_here
    from coulombus.host.run.last_word import newest_word
    from coulombus.rigs.buses import bus_addresses
    from coulombus.rigs.rig import load_rig
    from coulombus.wire.address import parse_address

    rig = load_rig(rig_name)
    if bus_names:
        return [parse_address(text.rpartition("=")[2]) for text in bus_names]
    default = click.get_current_context().get_parameter_source("rig_name") is ParameterSource.DEFAULT
    running = hosts_here() if default and channel is None else []
    if len(running) > 1 and not every:
        names = ", ".join(map(str, running))
        others = "" if every is None else ", or stop them with --all"
        raise click.UsageError(f"{len(running)} hosts run on this machine: {names}; name one with --bus{others}")
    if ended and default and channel is None and not running and (last := newest_word()):
        return [last[0]]
    return running or list(bus_addresses(rig, (), channel).values())


def bus_of_faults(bus_name: str | None) -> BusFaults:
    """Return the faults of the bus of ``--bus``, else of the only one with simulated nodes.

    Raises
    ------
    click.UsageError
        there are several, and none was named
    coulombus.wire.address.BusUnavailable
        there is none
    """
    from coulombus.sim_bus.server.fault_socket import BusFaults, fault_buses
    from coulombus.wire.address import BusUnavailable, parse_address

    if bus_name is not None:
        return BusFaults(parse_address(bus_name))
    buses = fault_buses()
    if len(buses) > 1:
        raise click.UsageError(
            f"{len(buses)} buses have simulated nodes: {', '.join(map(str, buses))}; name one with --bus"
        )
    if not buses:
        raise BusUnavailable("no bus with simulated nodes: start one in another terminal with `coulombus emulate`")
    return BusFaults(buses[0])


def mark_host(address: BusAddress, texts: list[str]) -> None:
    """Mark the recording of the host on a bus, if one runs there and records."""
    from coulombus.host.errors import HostError
    from coulombus.host.run.control_socket import ask_mark, host_runs

    if host_runs(address):
        for text in texts:
            with suppress(HostError):
                ask_mark(address, text)
