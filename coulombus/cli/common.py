"""Shared parts of the verbs: options, and loading of the rig."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coulombus.cli.option_types import SECONDS, InputPath, OutputFile
from coulombus.system.exit import printed, say, verdict

if TYPE_CHECKING:
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = [
    "BUS_VARIABLE",
    "MODES",
    "adapter_option",
    "any_bus_option",
    "bus_option",
    "buses_option",
    "channel_option",
    "check_mode",
    "check_shared_machine",
    "display_s",
    "faults_option",
    "file_channel_option",
    "force_option",
    "json_option",
    "listed",
    "load",
    "load_with_law",
    "log_eds_option",
    "mode_option",
    "printed",
    "record_option",
    "recording_argument",
    "rig_option",
    "say",
    "script_option",
    "seconds_option",
    "seed_option",
    "set_option",
    "shared_machine_option",
    "signals_option",
    "verdict",
    "with_adapter_options",
]
MODES = ("active", "passive", "hybrid")
RIG_VARIABLE, BUS_VARIABLE = "COULOMBUS_RIG", "COULOMBUS_BUS"
"""Environment variables that are the defaults of --rig and --bus."""
ADAPTER_OPTIONS = f"{__name__}.adapter_options"
"""Key of a context: the values of --bus-option."""


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


mode_option = click.option(
    "--mode",
    type=click.Choice(MODES),
    default="hybrid",
    show_default=True,
    help="The device that displays the friction.",
)
seconds_option = click.option(
    "--seconds",
    type=SECONDS,
    default=None,
    help="Duration of the display.  [default: the rig's schedule]",
)
record_option = click.option(
    "--record", type=OutputFile(".pcapng"), metavar="F.pcapng", help="Record every frame there, in a new file."
)
recording_argument = click.argument("file", type=InputPath())
signals_option = click.option(
    "--signals",
    "signals",
    multiple=True,
    callback=lambda ctx, param, texts: listed(texts),
    metavar="A,B",
    help="Only these signals, by their names.  [default: all]",
)
force_option = click.option(
    "--overwrite", "--force", "overwrite", is_flag=True, is_eager=True, help="Overwrite existing files."
)
rig_option = click.option(
    "--rig",
    "rig_name",
    default="bench",
    show_default=True,
    envvar=RIG_VARIABLE,
    metavar="R",
    help="A packaged rig (bench, paper, plane, two_axes) or the path of a rig file.",
)
set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="SECTION.KEY=V",
    help="Set any key of the rig file, as in --set plant.inertia_kg_m2=3e-3. May be given several times.",
)
shared_machine_option = click.option(
    "--shared-machine", is_flag=True, help="Relaxed time limits, for simulated nodes on a busy machine."
)
faults_option = click.option(
    "--faults",
    type=click.Path(readable=False, path_type=Path),
    metavar="F.toml",
    help="A fault file: what goes wrong on the bus, and when.",
)
seed_option = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Random seed.")
bus_option = click.option(
    "--bus",
    "bus_name",
    envvar=BUS_VARIABLE,
    metavar="B",
    help="coulombus:NAME or socketcan:IF.  [default: coulombus:RIG]",
)


def _keep_options(context: click.Context, param: click.Parameter, pairs: tuple[str, ...]) -> None:
    from coulombus.wire.address import AddressError, option_of

    for pair in pairs:
        try:
            option_of(pair)
        except AddressError as error:
            raise click.BadParameter(str(error), context, param) from None
    context.meta[ADAPTER_OPTIONS] = pairs


def with_adapter_options(context: click.Context, param: click.Parameter, bus_name: str | None) -> str | None:
    """Return the bus of --bus with the options of --bus-option: ``can:INTERFACE:CHANNEL?K=V&K=V``.

    Raises
    ------
    click.UsageError
        there are options, and no adapter
    """
    pairs = context.meta.get(ADAPTER_OPTIONS, ())
    if not pairs:
        return bus_name
    if bus_name is None or not bus_name.startswith("can:"):
        raise click.UsageError(
            f"--bus-option {pairs[0]} is of an adapter of python-can: give --bus can:INTERFACE:CHANNEL, or leave it out"
        )
    return f"{bus_name}{'&' if '?' in bus_name else '?'}{'&'.join(pairs)}"


adapter_option = click.option(
    "--bus-option",
    multiple=True,
    is_eager=True,
    expose_value=False,
    callback=_keep_options,
    metavar="K=V",
    help="Option of an adapter, as python-can names it: bitrate=500000. May be given several times.",
)
any_bus_option = click.option(
    "--bus",
    "bus_name",
    envvar=BUS_VARIABLE,
    metavar="B",
    callback=with_adapter_options,
    help="coulombus:NAME, socketcan:IF or can:INTERFACE:CHANNEL.  [default: coulombus:RIG]",
)
buses_option = click.option(
    "--bus",
    "bus_names",
    multiple=True,
    envvar=BUS_VARIABLE,
    metavar="B",
    help="coulombus:NAME or socketcan:IF; CHANNEL=B for each bus of a rig with several.  [default: coulombus:RIG]",
)
channel_option = click.option(
    "--channel",
    metavar="C",
    help="Only the axes on this bus, of a rig with several.  [default: all, one process each]",
)
script_option = click.option(
    "--script",
    type=click.Path(readable=False, path_type=Path),
    metavar="F.toml",
    help="Switch nodes off and on, reset them, let device faults come and go at given times.",
)
file_channel_option = click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="NAME",
    help="Bus of a file with several; RIG_BUS=NAME for a rig with several.",
)
log_eds_option = click.option(
    "--eds",
    "eds",
    multiple=True,
    metavar="N=FILE",
    help="EDS file of node N, as 5=drive.eds; or a folder of them. May be given several times.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON to stdout.")


def listed(texts: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the names of one or several options, or None."""
    return tuple(name.strip() for text in texts for name in text.split(",") if name.strip()) or None
