"""A recording read from its file: whole (`read`), or some seconds at a time (`blocks`).

What the bits mean comes from the rig file and the EDS files attached to the recording; of a file
without them (candump's, Wireshark's, or one that editcap has rewritten) from the rig that is given.

`read` keeps everything: 40 bytes for each frame and about 8 for each of its signals. `blocks` goes
through the file without keeping it, a `Recording` of some seconds at a time; figures and rows come
of that, in a memory that does not grow with the run.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

from coulombus.recording.bus_match import BusMatch, Channel, channel_texts, recorded_channel
from coulombus.recording.host_telemetry import NAME as INSIDE
from coulombus.recording.host_telemetry import inside_pdos, of_axis
from coulombus.recording.log_files import LogError, is_log, read_log
from coulombus.recording.pcapng_reader import Capture, iter_pcapng, read_pcapng
from coulombus.recording.remarks import remarks_on
from coulombus.recording.signals import Recording, Source, decode, epoch_of, left_out_of, markers_of
from coulombus.recording.unwrap import Turns
from coulombus.rigs.arguments import path_text
from coulombus.rigs.rig import Rig, RigError, load_rig, load_rig_text
from coulombus.rigs.signals import RigPdo

__all__ = ["Blocks", "blocks", "captures", "has_rig", "read"]

RIG = "rig.toml"
HOST = "host."  # begins the names of what only the host's replay reads: many, and no text


@dataclass
class Blocks(Source):
    """A recording that is not kept: each iteration goes through the file, a `Recording` of some
    seconds at a time (see `blocks`).
    """

    path: str
    rig: Rig
    remarks: tuple[str, ...] = field(default=(), init=False)
    """As `Recording.remarks`, of the last iteration that came to its end."""

    axis: str = ""
    """The axis of `rig` whose view this is, with the signals' plain names; "": of all that it has.
    """

    inside: tuple[RigPdo, ...] = ()
    channel: tuple[str, ...] = ()
    """Which of the file's buses, as `read` takes it."""

    recorded: str = ""
    """The rig's bus of which the recording says that it is."""

    def __post_init__(self) -> None:
        self._whole, self.rig = self.rig, self.rig.alone(self.axis) if self.axis else self.rig

    def __iter__(self) -> Iterator[Recording]:
        epoch_ns, left_out, warnings, turns = None, Counter[str](), list[str](), dict[str, Turns]()
        match = BusMatch(self.path, self._whole.channels, self.channel, self.recorded)
        for capture in map(match.take, captures(self.path)):
            if epoch_ns is None and len(capture.frames):
                epoch_ns = epoch_of(capture.frames)
            block = decode(capture, self.rig, epoch_ns, turns, self.inside)
            turns |= block.turns
            if self.axis:
                block = replace(block, markers=markers_of(self.axis, self._whole, block.markers))
            left_out.update(left_out_of(block))
            warnings += capture.warnings
            yield block
        self.remarks = remarks_on(self.path, [*warnings, *match.remarks()], left_out)

    def seen_by(self, axis: str) -> Blocks:
        """Return the recording as the axis of this name sees it, with the signals' plain names.

        Markers of other axes are left out.
        """
        if not axis:
            return self
        return Blocks(self.path, self.rig, axis, of_axis(self.inside, axis), self.channel, self.recorded)


def read(
    path: str | os.PathLike[str], rig: Rig | str | os.PathLike[str] | None = None, channel: Channel = None
) -> Recording:
    """Read a recording whole.

    Parameters
    ----------
    path
        A pcapng file of SocketCAN frames, a folder of segments (the newest run in it), or another
        tool's log (`recording.log_files`), which has no rig.
    rig
        Decode with this rig (a `Rig`, a packaged rig's name, or a rig file's path) and not with the
        attached one.
    channel
        Which bus of a file that has more of them than the rig: its name in the file, as ``"can0"``.
        Of a rig with several buses ``"a=can0"``, or several of these (`recording.bus_match`).

    Raises
    ------
    coulombus.rigs.rig.RigError
        No rig is attached and none is given, or the attached one cannot be read.
    coulombus.recording.pcapng_blocks.PcapngError, coulombus.recording.log_files.LogError
        The file is damaged, or is of another kind.
    coulombus.recording.bus_match.ChannelError
        The file has other buses than the rig, and `channel` does not say which are meant.
    coulombus.rigs.arguments.WrongCall
        `path` is no file's name, or `rig` is neither a rig nor its name.
    """
    path = path_text(path, "path", 'read("run.pcapng")')
    capture = next(captures(path)) if is_log(path) else read_pcapng(path)
    known = _attached_rig((capture,)) if rig is None else _rig(rig)
    recorded = recorded_channel(capture.attachments)
    match = BusMatch(path, known.channels, channel_texts(channel), recorded)
    capture = match.take(capture)
    capture = replace(capture, warnings=(*capture.warnings, *match.remarks()))
    return decode(capture, known, inside=_inside(known, recorded, capture.attachments.get(INSIDE)))


def blocks(
    path: str | os.PathLike[str], rig: Rig | str | os.PathLike[str] | None = None, channel: Channel = None
) -> Blocks:
    """Return a recording to go through, as often as needed, in a memory that does not grow with it.

    Parameters and errors as `read`.

    The file is read anew each time: it must stay as it is meanwhile, and a pipe is refused
    (LogError).
    """
    path = path_text(path, "path", 'blocks("run.pcapng")')
    if Path(path).exists() and not Path(path).is_file() and not Path(path).is_dir():
        raise LogError(f"{path}: it is no file, and a recording is read more than once; save it to a file first")
    texts = channel_texts(channel)
    if is_log(path):
        return Blocks(str(path), _attached_rig(captures(path)) if rig is None else _rig(rig), channel=texts)
    stretches = captures(path)
    first = next(stretches)  # what the host tells of is attached in front
    known = _attached_rig(chain([first], stretches)) if rig is None else _rig(rig)
    recorded = recorded_channel(first.attachments)
    inside = _inside(known, recorded, first.attachments.get(INSIDE))
    return Blocks(str(path), known, inside=inside, channel=texts, recorded=recorded)


def has_rig(path: str | Path) -> bool:
    """Tell whether a rig is attached to a recording, in front of its frames."""
    for capture in () if is_log(path) else iter_pcapng(path):
        if RIG in capture.attachments or len(capture.frames):
            return RIG in capture.attachments
    return False


def captures(path: str | Path) -> Iterator[Capture]:
    """Yield a pcapng file's stretches; a log of another tool is one."""
    if is_log(path):
        log = read_log(path)
        return iter(
            [
                Capture(
                    str(path), log.frames, comments=[], attachments={}, warnings=log.remarks, buses=log.buses or ("",)
                )
            ]
        )
    return iter_pcapng(path)


def _inside(rig: Rig, recorded: str, attached: bytes | None) -> tuple[RigPdo, ...]:
    """Return what the host of the recorded bus tells: it counts the axes on this bus."""
    return inside_pdos(rig.on(recorded) if recorded in rig.channels else rig, attached)


def _rig(rig: Rig | str | os.PathLike[str]) -> Rig:
    return rig if isinstance(rig, Rig) else load_rig(rig)


def _attached_rig(captures: Iterable[Capture]) -> Rig:
    """Return the rig attached to a recording, of which no more is read than its beginning."""
    give = "give one: read(path, rig=...), or --rig on the command line"
    texts: dict[str, str] = {}
    warnings: list[str] = []
    for capture in captures:
        warnings += capture.warnings
        files = (name for name in capture.attachments if not name.startswith(HOST))
        texts |= {name: capture.attachments[name].decode(errors="replace") for name in files}
        if RIG in texts and len(capture.frames):  # its EDS files stand before the frames, too
            break
    if RIG not in texts:
        if capture.torn:
            warnings.append(f"the file breaks off: its last block is unfinished, {capture.torn} bytes of it are there")
        damaged = f" ({'; '.join(warnings)})" if warnings else ""
        raise RigError([f"{capture.path}: no {RIG} is attached, so its PDOs have no meaning{damaged}; {give}"])
    try:
        return load_rig_text(texts.pop(RIG), f"{capture.path}[{RIG}]", texts, attached=True)
    except RigError as error:
        remedy = f"{capture.path}: its attached rig cannot be read by this version; {give}"
        raise RigError([*error.errors, remedy]) from error
