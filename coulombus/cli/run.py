"""``coulombus run``: the host on one bus or on several."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coulombus.cli.bundle import repeated
from coulombus.cli.common import (
    check_mode,
    check_shared_machine,
    json_option,
    mode_option,
    say,
    shared_machine_option,
    verdict,
)
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import CPU, SECONDS, SECONDS_OR_NONE
from coulombus.cli.outputs import OutputOptions, outputs_options
from coulombus.cli.page_options import PageOptions, page_options
from coulombus.cli.rig_options import BusesOptions, buses_options
from coulombus.cli.run_table import print_runs
from coulombus.cli.tables import progress
from coulombus.system.foreign_text import printable

if TYPE_CHECKING:
    from coulombus.wire.address import BusAddress

__all__ = ["run_command"]

PAGE_AFTER_TRIP_S = 60.0


@click.command("run", epilog=EXIT_STATUS)
@buses_options
@mode_option
@click.option("--seconds", type=SECONDS, default=None, help="Duration of the display.  [default: until it is stopped]")
@outputs_options
@shared_machine_option
@click.option(
    "--cpu",
    type=CPU,
    default=None,
    help="CPU for the cycle's process.  [default: the last isolated one, else the last]",
)
@click.option("--world", is_flag=True, help="Let another program say what the hand meets (docs/worlds.md).")
@page_options
@click.option(
    "--web-after",
    type=SECONDS_OR_NONE,
    default=None,
    metavar="S",
    help=f"Keep the page after the host's end.  [default: {PAGE_AFTER_TRIP_S:g} after a trip, else 0]",
)
@json_option
def run_command(
    chosen: BusesOptions,
    mode: str,
    seconds: float | None,
    outputs: OutputOptions,
    shared_machine: bool,
    cpu: int | None,
    world: bool,
    page: PageOptions,
    web_after: float | None,
    as_json: bool,
) -> None:
    """Run the host alone, in real time, on a bus where the nodes are: simulated ones
    (`coulombus emulate`) or a rig.

    Ends safely when the time is over, by q or Escape in its terminal (exit status 0), on Ctrl-C
    (130), SIGTERM (143), when the terminal is closed (129), on Ctrl-Backslash (131), `coulombus stop`
    (0), or a trip (7). After a trip nothing re-arms by itself. Real-time rights are asked for; what is
    refused is told with the command that grants it.

    \b
    Examples:
      coulombus emulate                     # in a terminal of its own; then:
      coulombus run --mode hybrid --seconds 13 --record run.pcapng
      coulombus run --bus socketcan:can0 --rig my-rig.toml --mode active --json
      coulombus run --record runs --rotate 1h --keep 20GB --meta subject=S01
    """
    if web_after is not None and not page.web:
        raise click.UsageError("--web-after is of the page: give --web, too")
    with errors():
        from coulombus.host.run.buses import path_on
        from coulombus.host.run.real_run import real_run
        from coulombus.host.run.run import OUTSIDE, Run
        from coulombus.host.run.runbook import advice  # before the run: at its end files can no longer be opened
        from coulombus.recording.output_file import check as check_output
        from coulombus.rigs.overrides import shared_machine as wider
        from coulombus.rigs.rig import load_rig
        from coulombus.system.keyboard import in_foreground
        from coulombus.system.stop_signals import Signals

        rig = chosen.load(*(wider(load_rig(chosen.rig_name, chosen.overrides)) if shared_machine else ()))
        addresses = chosen.addresses(rig)
        if shared_machine:
            check_shared_machine(addresses.values())
        check_mode(rig, chosen.rig_name, mode)
        out = outputs.outputs(rig)
        if chosen.channel is not None:
            if rig.one_cycle and len(rig.channels) > 1:
                raise click.UsageError(
                    f"--channel {chosen.channel}: one host serves both joints of an arm, on all its buses"
                )
            rig = rig.on(chosen.channel)
        if len(rig.channels) > 1:
            page.refuse_several()
        if not rig.one_cycle:
            words = ["run", "--rig", chosen.rig_name, "--mode", mode, "--json"]
            words += [] if seconds is None else ["--seconds", str(seconds)]
            words += repeated("--set", chosen.overrides)
            words += ["--shared-machine"] if shared_machine else []
            words += [] if cpu is None else ["--cpu", str(cpu)]
            words += ["--world"] if world else []
            for path in (path_on(path, channel) for path in outputs.refusable() for channel in addresses):
                check_output(path, force=outputs.overwrite)  # for all buses before the first one starts
            _run_buses([*words, *outputs.words()], addresses, outputs.files, mode, as_json)
        address = next(iter(addresses.values()))
        if not as_json and in_foreground():
            say("q or Escape stops safely; 1 to 9 mark the recording")
        with page.beside(chosen, address) as stay:
            with Signals() as signals, progress(not as_json, width=10) as report:
                result = real_run(
                    Run(rig, mode, seconds, world=OUTSIDE if world else None, outputs=out, virtual=False),
                    bus=tuple(addresses.values()),
                    signals=signals,
                    progress=lambda t, axes: report(mode, t, seconds, _state(axes)),
                    cpu=cpu,
                )
            with verdict(result.exit_status, f"trip: {printable(result.trip)}" if result.trip else ""):
                _say_what_to_do(result.trip, advice, shared_machine)
                if as_json:
                    print_json(result.as_dict())
                else:
                    print_runs({mode: result})
                sys.stdout.flush()
                stay(PAGE_AFTER_TRIP_S * bool(result.trip) if web_after is None else web_after)


def _state(axes: list[dict[str, Any]]) -> str:
    """Return the present display as text, at most 80 columns wide."""
    shown = ", ".join(
        f"{axis['axis']} {axis['phase']}: brake {axis['brake_torque_Nm']:.2f}, handle {axis['handle_torque_Nm']:.2f} Nm".lstrip()
        for axis in axes
    )
    return f"{shown}, lost {sum(axis['lost_pdos'] for axis in axes)}"


def _say_what_to_do(trip: str | None, advice: Callable[[str], str | None], shared_machine: bool) -> None:
    """After a trip, print the command that explains it (`advice`); for missing TPDOs, suggest --shared-machine first."""
    if trip is None:
        return
    if "TPDO_LOST" in trip and not shared_machine:
        text = "a busy machine may have stalled for that long: --shared-machine widens the limits"
        say(f"coulombus: {text} (docs/realtime.md)")
    if command := advice(trip):
        say(f"coulombus: likely causes, and what to do: {command}")


def _run_buses(
    words: list[str], addresses: dict[str, BusAddress], files: dict[str, Path], mode: str, as_json: bool
) -> None:
    """Run the host on several buses, a process each, and exit with their combined status."""
    from coulombus.host.run.buses import merged, path_on, supervise
    from coulombus.host.run.result import RunResult
    from coulombus.host.run.runbook import advice

    def arguments(channel: str) -> list[str]:
        there = ((option, path_on(path, channel)) for option, path in files.items())
        own = [word for option, path in there for word in (option, str(path))]
        return [*words, *own, "--channel", channel, "--bus", f"{channel}={addresses[channel]}"]

    buses = supervise(list(addresses), arguments)
    whole = merged({b.channel: b.result for b in buses}, {b.channel: b.status for b in buses})
    with verdict(whole["exit_status"]):
        _say_what_to_do(whole.get("trip"), advice, "--shared-machine" in words)
        if as_json:
            print_json(whole)
        elif "mode" in whole:
            print_runs({mode: RunResult(**whole)})
