"""``coulombus run`` and ``coulombus stop``: the host on one bus or on several."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coulombus.verbs.common import (
    CPU,
    EXIT_STATUS,
    PICTURE,
    SECONDS,
    RecordingPlace,
    buses_option,
    channel_option,
    check_mode,
    check_shared_machine,
    errors,
    force_option,
    json_option,
    load,
    mode_option,
    print_json,
    progress,
    rig_option,
    say,
    set_option,
    shared_machine_option,
    verdict,
)
from coulombus.verbs.run_table import print_runs
from coulombus.verbs.web import page_beside, page_words, web_options

if TYPE_CHECKING:
    from coulombus.recording.segments import Rotation
    from coulombus.wire.address import BusAddress

__all__ = ["run_command", "stop"]

GIVEN = f"{__name__}.given"
"""What a context keeps: the words of --rotate and --keep."""


@click.command("run", epilog=EXIT_STATUS)
@rig_option
@buses_option
@channel_option
@mode_option
@click.option("--seconds", type=SECONDS, default=None, help="Length of the display.  [default: until it is stopped]")
@click.option(
    "--record",
    type=RecordingPlace(),
    metavar="PLACE",
    help="Record every frame there: in a new file F.pcapng, or in segments in a folder.",
)
@click.option(
    "--rotate",
    is_eager=True,
    callback=lambda ctx, param, text: None if text is None else _checked(text, "parse_rotation"),
    metavar="SIZE|TIME",
    help="--record is a folder; a new segment after so much or so long: 100MB, 1h.  [default of a folder: 100MB]",
)
@click.option(
    "--keep",
    callback=lambda ctx, param, text: None if text is None else _checked(text, "parse_size"),
    metavar="SIZE",
    help="Keep so much in that folder, and remove the oldest segments: 20GB.  [default: all]",
)
@click.option(
    "--status",
    "status",
    type=click.Path(path_type=Path),
    metavar="SOCKET",
    help="Make a socket there that tells the state, a JSON line each 100 ms, to all who read it.",
)
@click.option("--meta", "meta", multiple=True, metavar="KEY=VALUE", help="Say something of the recording: subject=S01.")
@force_option
@click.option(
    "--histogram",
    type=PICTURE,
    metavar="F.png",
    help="Draw wake-up and SYNC-to-RPDO times there.",
)
@set_option
@shared_machine_option
@click.option(
    "--cpu",
    type=CPU,
    default=None,
    help="CPU for the cycle's process.  [default: the last isolated one, else the last]",
)
@web_options
@json_option
def run_command(
    rig_name: str,
    bus_names: tuple[str, ...],
    channel: str | None,
    mode: str,
    seconds: float | None,
    record: Path | None,
    rotate: Rotation | None,
    keep: int | None,
    status: Path | None,
    meta: tuple[str, ...],
    overwrite: bool,
    histogram: Path | None,
    overrides: tuple[str, ...],
    shared_machine: bool,
    cpu: int | None,
    web: bool,
    web_port: int,
    web_host: str,
    as_json: bool,
) -> None:
    """Run the host alone, in real time, on a bus where the nodes are: simulated ones
    (`coulombus sim`) or a rig.

    Ends safely when the time is over, on Ctrl-C (exit status 130), SIGTERM (143), when the terminal
    is closed (129), on Ctrl-Backslash (131), `coulombus stop` (0), or a trip (7). After a trip
    nothing re-arms by itself. Real-time rights are asked for; what is refused is told with the
    command that grants it.

    \b
    Examples:
      coulombus sim &
      coulombus run --mode hybrid --seconds 13 --record run.pcapng
      coulombus run --bus socketcan:can0 --rig my-rig.toml --mode active --json
      coulombus run --record runs --rotate 1h --keep 20GB --meta subject=S01
    """
    with errors():
        from coulombus.host.run.buses import path_on
        from coulombus.host.run.real_run import real_run
        from coulombus.recording.output_file import check as check_output
        from coulombus.rigs.buses import bus_addresses
        from coulombus.rigs.overrides import SHARED_MACHINE
        from coulombus.wire.stopping import Signals

        rig = load(rig_name, (*SHARED_MACHINE, *overrides) if shared_machine else overrides)
        addresses = bus_addresses(rig, bus_names, channel)
        if shared_machine:
            check_shared_machine(addresses.values())
        check_mode(rig, rig_name, mode)
        rotation, said = _rotation(record, rotate, keep), _said(record, meta)
        if channel is not None:
            rig = rig.on(channel)
        if len(rig.channels) > 1:
            if web:
                raise click.UsageError(
                    "--web is of one bus: serve each bus' page with `coulombus watch --web --channel C`"
                )
            words = ["run", "--rig", rig_name, "--mode", mode, "--json"]
            words += [] if seconds is None else ["--seconds", str(seconds)]
            words += [word for text in overrides for word in ("--set", text)]
            words += ["--shared-machine"] if shared_machine else []
            words += ["--force"] if overwrite else []
            words += [] if cpu is None else ["--cpu", str(cpu)]
            given = {"--rotate": "100MB"} if rotation else {}
            given |= click.get_current_context().meta.get(GIVEN, {})
            words += [word for option, text in given.items() for word in (option, text)]
            words += [word for text in meta for word in ("--meta", text)]
            files = {"--record": record, "--histogram": histogram, "--status": status}
            wanted = [path for path in files.values() if path and path != status and not (rotation and path == record)]
            for path in (path_on(path, channel) for path in wanted for channel in addresses):
                check_output(path, force=overwrite)  # of all buses before the first one starts
            _run_buses(words, addresses, files, mode, as_json)
        (address,) = addresses.values()
        page = page_words(rig_name, address, channel, overrides, web_host, web_port) if web else None
        with page_beside(page), Signals() as signals, progress(not as_json) as report:
            result = real_run(
                rig,
                mode,
                seconds,
                bus=address,
                record=record,
                histogram=histogram,
                signals=signals,
                progress=lambda t: report(mode, t, seconds),
                cpu=cpu,
                force=overwrite,
                rotation=rotation,
                meta=said,
                status=status,
            )
        with verdict(result.exit_status):
            _say_what_to_do(result.trip, shared_machine)
            if as_json:
                print_json(result.as_dict())
            else:
                print_runs({mode: result})


def _checked(text: str, name: str) -> Any:
    """Return what a word of --rotate or --keep says, and keep the word for the processes of several
    buses.
    """
    from coulombus.recording import segments

    try:
        found = getattr(segments, name)(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None
    context = click.get_current_context()
    context.meta.setdefault(GIVEN, {})["--rotate" if name == "parse_rotation" else "--keep"] = text
    return found


def _rotation(record: Path | None, rotate: Rotation | None, keep: int | None) -> Rotation | None:
    """Return when a segment ends, None where the recording is one file or none."""
    from dataclasses import replace

    from coulombus.recording.segments import Rotation

    folder = record is not None and record.is_dir()
    if not folder and (rotate is not None or keep is not None):
        raise click.UsageError(
            "--rotate and --keep are of a folder: give one with --record, as in --record runs --rotate 1h"
        )
    if not folder:
        return None
    found = replace(rotate or Rotation(), keep_bytes=keep)
    if keep is not None and keep < 2 * (found.most_bytes or 0):
        raise click.UsageError(f"--keep {keep} bytes: expected at least two segments of {found.most_bytes} bytes")
    return found


def _said(record: Path | None, meta: tuple[str, ...]) -> dict[str, str]:
    """Return the pairs of --meta."""
    if meta and record is None:
        raise click.UsageError("--meta is of a recording: give --record, too")
    found: dict[str, str] = {}
    for text in meta:
        key, equals, value = text.partition("=")
        if not equals or not key.strip() or key in found:
            reason = "twice" if key in found else "expected KEY=VALUE, as in subject=S01"
            raise click.BadParameter(f"{text!r}: {reason}", param_hint="--meta")
        found[key] = value
    return found


def _say_what_to_do(trip: str | None, shared_machine: bool) -> None:
    """After a trip: where its causes stand; for want of TPDOs on a machine of one's own, what else
    it may be.
    """
    from coulombus.host.run.runbook import anchor

    if trip is None:
        return
    if "TPDO_LOST" in trip and not shared_machine:
        text = "if this machine does other work, too, it may have stood still for so long: --shared-machine widens the limits"
        say(f"coulombus: {text} (docs/realtime.md)")
    if place := anchor(trip):
        say(f"coulombus: likely causes, and what to do: {place}")


def _run_buses(
    words: list[str], addresses: dict[str, BusAddress], files: dict[str, Path | None], mode: str, as_json: bool
) -> None:
    """Run the host on several buses, a process each, and end with the status that they come to."""
    from coulombus.host.run.buses import merged, path_on, supervise
    from coulombus.host.run.result import RunResult

    def arguments(channel: str) -> list[str]:
        there = ((option, path_on(path, channel)) for option, path in files.items() if path is not None)
        own = [word for option, path in there for word in (option, str(path))]
        return [*words, *own, "--channel", channel, "--bus", f"{channel}={addresses[channel]}"]

    buses = supervise(list(addresses), arguments)
    whole = merged({b.channel: b.result for b in buses}, {b.channel: b.status for b in buses})
    with verdict(whole["exit_status"]):
        _say_what_to_do(whole.get("trip"), "--shared-machine" in words)
        if as_json:
            print_json(whole)
        elif "mode" in whole:
            print_runs({mode: RunResult(**whole)})


@click.command(epilog=EXIT_STATUS)
@rig_option
@buses_option
def stop(rig_name: str, bus_names: tuple[str, ...]) -> None:
    """Stop the host that runs on a bus safely: motor torque 0, brake ramped off, drive disabled.

    Waits for its end.

    Ends with 0 when each host that was asked has taken the request and has ended, tripped or not.
    Else with 4: none runs there, it cannot be reached, it does not take the request, or it does not
    end in time. Then the rig may be armed still.

    \b
    Examples:
      coulombus stop
      coulombus stop --bus socketcan:can0
    """
    with errors():
        from coulombus.host.run.control_socket import NoHost, StopRequest
        from coulombus.rigs.buses import bus_addresses
        from coulombus.rigs.rig import load_rig
        from coulombus.wire.address import parse_address

        rig = load_rig(rig_name)
        addresses = [parse_address(t.rpartition("=")[2]) for t in bus_names] or list(bus_addresses(rig).values())
        requests = [StopRequest(address) for address in addresses]  # all are asked before one is waited for
        failures, told = [], []
        for request in requests:
            try:
                told.append(_what_came(request.address, request.result()))
            except NoHost as failure:
                failures.append(str(failure))
        for text in told if failures else ():
            say(text)
        if failures:
            raise NoHost("; ".join(failures))
        with verdict(0):
            for text in told:
                click.echo(text)


def _what_came(address: BusAddress, result: Mapping[str, Any]) -> str:
    """Return what a host said to a stop, as a sentence."""
    if not result:
        return f"the host on {address} took the request and ended without a word"
    if result["trip"]:
        return f"the host on {address} had tripped: {result['trip']}"
    return f"the host on {address} stopped safely after {result['cycles']} cycles in mode {result['mode']}"
