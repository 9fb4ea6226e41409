"""``coulombus replay``: its options, and the output of its results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, remark
from coulombus.cli.options import (
    FileChannelOption,
    IdsOption,
    JsonOption,
    RecordingArgument,
    option,
    with_options,
)
from coulombus.cli.tables import echo, progress
from coulombus.system.errors import CoulombusError
from coulombus.system.exit import printed, verdict

if TYPE_CHECKING:
    from coulombus.lab.replay.host_replay import HostReplay
    from coulombus.lab.replay.player import Tape
    from coulombus.lab.replay.virtual_replay import VirtualReplay
    from coulombus.rigs.rig import Rig

__all__ = ["replay"]


class NotToTheRig(CoulombusError):
    """Frames that would move a rig are not sent without an explicit option."""

    exit_status = 7


@dataclass(frozen=True)
class Choice:
    """The frames of a recording to play, from the options."""

    from_s: Annotated[float | None, option("Begin there, in the time that `coulombus decode` shows.", type=float)]
    to_s: Annotated[float | None, option("End there.", type=float)]
    ids_text: IdsOption
    nodes: Annotated[tuple[int, ...], option("--node", "Only what this node sent.", type=click.IntRange(1, 127))]
    only_host: Annotated[bool, option("Only what the host sent: SYNC, NMT, RPDOs, SDO requests.")]
    channels: FileChannelOption

    def select(self, tape: Tape, rig_name: str | None) -> Tape:
        """Return the selected frames."""
        import numpy as np

        from coulombus.recording.frame_sender import HOST, rig_of, senders
        from coulombus.wire.identifiers import among, parse_identifiers

        selected = np.ones(len(tape.frames), bool)
        if self.from_s is not None:
            selected &= tape.t_ns >= round(self.from_s * 1e9)
        if self.to_s is not None:
            selected &= tape.t_ns <= round(self.to_s * 1e9)
        if self.ids_text is not None:
            selected &= among(tape.frames["can_id"], parse_identifiers(self.ids_text))
        if self.nodes or self.only_host:
            nodes = (*self.nodes, HOST) if self.only_host else self.nodes
            rig = rig_of(tape.path, rig_name)
            if rig is not None and len(rig.channels) > 1:
                rig = self._on_bus(rig)
            selected &= np.isin(senders(tape.frames["can_id"], rig), nodes)
        return tape.select(selected)

    def _on_bus(self, rig: Rig) -> Rig:
        """Return the rig's part on the played bus, if --channel names it."""
        names = {name for text in self.channels for name in text.split("=")}
        return next((rig.on(channel) for channel in rig.channels if channel in names), rig)


@dataclass(frozen=True)
class Playing:
    """Settings of playing a recording, from the options."""

    speed: Annotated[float, option("2: twice as fast.", type=click.FloatRange(1e-3, 1e3), default=1.0)]
    loops: Annotated[int, option("--loop", "Number of times; 0: without end.", type=click.IntRange(0), default=1)]
    to_rig: Annotated[bool, option("Also send the host's frames to a real interface: they move the motor.")]
    priority: Annotated[int, option("SCHED_FIFO priority; 0: none.", type=click.IntRange(0, 99), default=70)]


@dataclass(frozen=True)
class Otherwise:
    """Differences from the recording's own rig, from the options."""

    rig_name: Annotated[str | None, option("--rig", "This rig instead of the attached one.", metavar="R")]
    law: Annotated[
        str | None,
        option(
            "With --host: what this law would have commanded. Your own law runs only if it is named here.",
            metavar="M:F",
        ),
    ]
    overrides: Annotated[tuple[str, ...], option("--set", "With --host: other values.", metavar="SECTION.KEY=V")]

    def rig(self, file: Path) -> Rig | None:
        """Return the named rig's part on the recorded bus; None: the recording's own rig."""
        from coulombus.recording.bus_match import recorded_channel
        from coulombus.recording.reading import captures
        from coulombus.rigs.rig import load_rig

        if self.rig_name is None:
            return None
        rig = load_rig(self.rig_name)
        recorded = recorded_channel(next(captures(file)).attachments)
        return rig.on(recorded) if recorded in rig.channels else rig

    def all_overrides(self) -> tuple[str, ...]:
        """Return the overrides of the rig, including the law."""
        if self.law is None:
            return self.overrides
        path, colon, function = self.law.rpartition(":")
        place = str(Path(path).absolute()) if path.endswith(".py") else path
        return (*self.overrides, f"law.function={place}{colon}{function}")


@click.command("replay", epilog=EXIT_STATUS)
@with_options
def replay(
    file: RecordingArgument,
    bus_name: Annotated[str | None, option("--bus", "Play it there: coulombus:NAME or socketcan:IF.", metavar="B")],
    as_host: Annotated[bool, option("--host", "Feed the host with it, and compare its outputs.")],
    virtual: Annotated[bool, option("Feed a virtual bus with it, and compare the frames.")],
    playing: Playing,
    choice: Choice,
    otherwise: Otherwise,
    as_json: JsonOption,
) -> None:
    """Play a recording onto a bus, or check the host (--host) or the bus model (--virtual) against
    it.

    Plays pcapng and other tools' logs (docs/recording.md lists their formats); of a file
    with several buses the one that --channel names. A torn file plays to its last whole block. With --host and --virtual it ends with 1 when an
    output differs, and shows the first difference.

    \b
    Examples:
      coulombus replay run.pcapng --bus coulombus:bench
      coulombus replay run.pcapng --bus socketcan:vcan0 --speed 0.5 --from-s 3 --to-s 5
      coulombus replay run.pcapng --host
      coulombus replay run.pcapng --host --law my_law.py:law
      coulombus replay run.pcapng --virtual
    """
    with errors():
        if (bus_name is not None) + as_host + virtual != 1:
            raise click.UsageError("give one of --bus B (play it there), --host and --virtual (check it)")
        if (otherwise.overrides or otherwise.law) and not as_host:
            raise click.UsageError("--law and --set go with --host")
        if choice.channels and bus_name is None:
            raise click.UsageError("--channel goes with --bus")
        if bus_name is not None:
            _play(file, bus_name, otherwise.rig_name, playing, choice, as_json)
        else:
            _check(file, otherwise, as_host, as_json)


def _check(file: Path, otherwise: Otherwise, as_host: bool, as_json: bool) -> None:
    """Compare the host, or the bus model, with a recording."""
    rig = otherwise.rig(file)
    if as_host:
        from coulombus.lab.replay.host_replay import host_replay

        checked = host_replay(file, otherwise.all_overrides(), rig)
        result: HostReplay | VirtualReplay = checked
        lines = _host_lines(checked)
    else:
        from coulombus.lab.replay.virtual_replay import virtual_replay

        result = virtual_replay(file, rig)
        lines = result.lines()
    remark(result.remarks)
    with verdict(result.exit_status):
        echo(json.dumps(result.as_dict(), indent=2, allow_nan=False) if as_json else "\n".join(lines))


def _host_lines(result: HostReplay) -> list[str]:
    counts = ", ".join(f"{n} {name}" for name, n in result.frames.items())
    lines = [f"mode {result.mode}: {result.cycles} cycles, {result.inputs} frames in"]
    difference = result.difference
    if difference is None:
        lines.append(f"identical: {counts}")
    elif result.judged:
        lines.append(
            f"FAIL at {difference.t_s:.6f} s, cycle {difference.cycle}: {difference.name} (before that the same: {counts})"
        )
    else:
        lines.append(f"the first difference is at {difference.t_s:.6f} s, cycle {difference.cycle}: {difference.name}")
    if difference is not None:
        lines.append(f"  {'':<28} {'recorded':>18} {'computed':>18}")
        lines.append(f"  {'data':<28} {_or_none(difference.recorded):>18} {_or_none(difference.computed):>18}")
        for name, (recorded, computed) in difference.signals.items():
            mark = "" if recorded == computed else "  <"
            lines.append(f"  {name:<28} {_number(recorded):>18} {_number(computed):>18}{mark}")
    if result.rms is not None:
        lines += [f"  RMS difference of {name}: {value:.6g}" for name, value in result.rms.items()]
    if result.computed_trip != result.recorded_trip:
        trips = (("recorded", result.recorded_trip), ("computed", result.computed_trip))
        lines += [f"trip {name}: {trip or 'none'}" for name, trip in trips]
    if result.refused:
        lines.append(f"{result.refused} frames that the bus had not taken are in no recording")
    if result.unchecked:
        lines.append(f"{result.unchecked} frames behind the trace's end were not checked: was the recording killed?")
    return lines


def _or_none(text: str | None) -> str:
    return "no frame" if text is None else text or "no data"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.9g}"


def _play(file: Path, bus_name: str, rig_name: str | None, playing: Playing, choice: Choice, as_json: bool) -> None:
    """Play a recording onto a bus."""
    from coulombus.lab.replay.player import NOTHING, load_tape, play
    from coulombus.system.realtime import ask_for_real_time
    from coulombus.system.stop_signals import Stopped, StopSignals
    from coulombus.wire.address import parse_address
    from coulombus.wire.client import Client
    from coulombus.wire.handshake import Hello
    from coulombus.wire.socketcan import is_virtual

    address = parse_address(bus_name)
    tape = choice.select(load_tape(file, choice.channels), rig_name)
    remark(tape.remarks)
    if not len(tape.frames):
        raise click.UsageError(f"{file}: no frame is left to be played")
    if address.moves_hardware and not playing.to_rig and _moves(tape) and not is_virtual(address.name):
        raise NotToTheRig(
            f"{file} has frames of a host (NMT, SYNC, RPDOs): on {address} they would move a motor, and no host would watch it. "
            "Leave them out (--node N, --ids), or give --to-rig if that is what you want"
        )
    total = float(tape.t_ns[-1] - tape.t_ns[0]) / 1e9 / playing.speed * max(playing.loops, 1)
    with (
        Client(address, Hello(filters=NOTHING)) as client,
        StopSignals() as stop,
        progress(not as_json, "played") as report,
    ):
        ask_for_real_time(playing.priority or None)
        played = play(
            tape,
            client,
            stop,
            speed=playing.speed,
            loops=playing.loops,
            progress=lambda t_s: report("replay", t_s, total),
        )
        number = stop.number
    late = played.late_us
    cut_short = not played.complete and number and playing.loops
    with printed(1 if cut_short else 0):
        if as_json:
            echo(
                json.dumps(
                    {
                        "file": str(file),
                        "bus": str(address),
                        "frames": played.frames,
                        "loops": played.loops,
                        "seconds": played.seconds,
                        "late_us": late,
                        "full": played.full,
                        "complete": played.complete,
                    },
                    indent=2,
                )
            )
        else:
            times = (
                ""
                if late is None
                else f", late by {late['p50']:.0f} / {late['p99']:.0f} / {late['max']:.0f} us (p50 / p99 / max)"
            )
            full = f", {played.full} of them waited for a full bus" if played.full else ""
            echo(f"{played.frames} frames onto {address} in {played.seconds:.3f} s{times}{full}")
    if cut_short:
        raise Stopped(number, f"after {played.frames} frames")


def _moves(tape: Tape) -> bool:
    """Return whether the frames include a host's."""
    import numpy as np

    from coulombus.recording.frame_sender import HOST, rig_of, senders

    return bool(np.any(senders(tape.frames["can_id"], rig_of(tape.path, None)) == HOST))
