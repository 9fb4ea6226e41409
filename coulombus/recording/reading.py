"""Read a recording from its file: whole (`read`), or some seconds at a time (`blocks`).

The meaning of the bits comes from the rig file and the EDS files attached to the recording. For a
file without them (candump's, Wireshark's, or one rewritten by editcap) it comes from the given rig,
else from the log itself (`recording.maps`).

`read` keeps everything: 40 bytes per frame and about 8 for each of its signals. `blocks` streams
the file, a `Recording` of some seconds at a time, so figures and rows need only bounded memory.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

from coulombus.recording.bus_match import BusMatch, Channel, channel_texts, recorded_channel
from coulombus.recording.file_content import Capture
from coulombus.recording.host_telemetry import NAME as INSIDE
from coulombus.recording.host_telemetry import inside_pdos, of_axis
from coulombus.recording.log_files import LogError, is_log, read_log
from coulombus.recording.maps.eds_files import eds_files
from coulombus.recording.maps.log_maps import LEARNED, LogMaps
from coulombus.recording.pcapng_reader import iter_pcapng, read_pcapng
from coulombus.recording.remarks import remarks_on
from coulombus.recording.signals import GIVE_RIG, Recording, Source, decode, epoch_of, left_out_of, markers_of
from coulombus.recording.unwrap import Turns
from coulombus.rigs.arguments import path_text
from coulombus.rigs.rig import Rig, RigError, load_rig, load_rig_text
from coulombus.rigs.signals import RigPdo

__all__ = ["Blocks", "blocks", "captures", "has_rig", "read"]

RIG = "rig.toml"
HOST = "host."  # prefix of attachments that only the host's replay reads: many, and not text


@dataclass
class Blocks(Source):
    """A streamed recording: each iteration reads the file, a `Recording` of some seconds at a time (see `blocks`)."""

    path: str
    known_rig: Rig | None
    remarks: tuple[str, ...] = field(default=(), init=False)
    """As `Recording.remarks`, of the last completed iteration."""

    axis: str = ""
    """The axis of this view, with the signals' plain names; "": all axes.
    """

    inside: tuple[RigPdo, ...] = ()
    channel: tuple[str, ...] = ()
    """Bus of the file, as `read` takes it."""

    recorded: str = ""
    """The rig's bus that the recording names."""

    maps: LogMaps | None = None
    """Without a rig: PDO maps learned from the log."""

    def __post_init__(self) -> None:
        self._whole = self.known_rig
        if self.axis and self._whole is not None:
            self.known_rig = self._whole.alone(self.axis)
        self.bare = () if self.maps is None else self.maps.pdos()

    def __iter__(self) -> Iterator[Recording]:
        epoch_ns, left_out, warnings, turns = None, Counter[str](), list[str](), dict[str, Turns]()
        match = _match(self.path, self._whole, self.channel, self.recorded)
        row = 0
        for capture in map(match.take, captures(self.path)):
            if epoch_ns is None and len(capture.frames):
                epoch_ns = epoch_of(capture.frames)
            begins = _begins(self.maps, self.bare, row)
            block = decode(capture, self.known_rig, epoch_ns, turns, self.inside, self.bare, begins)
            row += len(capture.frames)
            turns |= block.turns
            if self.axis and self._whole is not None:
                block = replace(block, markers=markers_of(self.axis, self._whole, block.markers))
            left_out.update(left_out_of(block))
            warnings += capture.warnings
            yield block
        warnings += [*match.remarks(), *_remaps(self.path, self.maps, self.bare)]
        self.remarks = remarks_on(self.path, warnings, left_out)

    def seen_by(self, axis: str) -> Blocks:
        """Return the view of the axis of this name, with the signals' plain names.

        Markers of other axes are left out.
        """
        if not axis:
            return self
        return Blocks(self.path, self.rig, axis, of_axis(self.inside, axis), self.channel, self.recorded)


def read(
    path: str | os.PathLike[str],
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
    *,
    eds: Iterable[str] = (),
) -> Recording:
    """Read a recording whole.

    Without an attached or given rig, nodes are numbers, and a signal is named by its PDO and
    object, as ``"5.TPDO1.6064h:00"``, with raw values, if the map is known from SDO configuration
    in the log, an EDS file or a profile's defaults.

    Parameters
    ----------
    path
        A pcapng file of SocketCAN frames, a folder of segments (the newest run in it), or another
        tool's log (`recording.log_files`), which has no rig.
    rig
        Decode with this rig (a `Rig`, a packaged rig's name, or a rig file's path) instead of the attached one.
    channel
        Bus of a file with more buses than the rig: its name in the file, as ``"can0"``; for a rig
        with several buses ``"a=can0"``, or several of these (`recording.bus_match`).
    eds
        EDS files for a log without a rig: ``"5=drive.eds"``, or a folder whose files are matched by identity.

    Raises
    ------
    coulombus.rigs.rig.RigError
        The rig cannot be read.
    coulombus.recording.pcapng_blocks.PcapngError, coulombus.recording.log_files.LogError
        The file is damaged, or is of another kind.
    coulombus.recording.bus_match.ChannelError
        The file has other buses than the rig, and `channel` does not select them.
    coulombus.rigs.arguments.WrongCall
        `path` is not a file's name, or `rig` is neither a rig nor its name.
    coulombus.eds.description.EdsError
        An entry of `eds` has neither form, or its file cannot be read.
    """
    path = path_text(path, "path", 'read("run.pcapng")')
    capture = next(captures(path)) if is_log(path) else read_pcapng(path)
    known = _attached_rig((capture,)) if rig is None else _rig(rig)
    recorded = recorded_channel(capture.attachments)
    match = _match(path, known, channel_texts(channel), recorded)
    capture = match.take(capture)
    maps = _learned([capture], eds) if known is None else None
    pdos = () if maps is None else maps.pdos()
    capture = replace(capture, warnings=(*capture.warnings, *match.remarks(), *_remaps(path, maps, pdos)))
    if known is None:
        return decode(capture, None, bare=pdos, begins=_begins(maps, pdos, 0))
    return decode(capture, known, inside=_inside(known, recorded, capture.attachments.get(INSIDE)))


def blocks(
    path: str | os.PathLike[str],
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
    *,
    eds: Iterable[str] = (),
) -> Blocks:
    """Return a recording to iterate over, repeatedly, in bounded memory.

    Parameters and errors as `read`.

    The file is read anew each time: it must not change, and a pipe is refused (LogError).
    """
    path = path_text(path, "path", 'blocks("run.pcapng")')
    if Path(path).exists() and not Path(path).is_file() and not Path(path).is_dir():
        raise LogError(f"{path}: it is no file, and a recording is read more than once; save it to a file first")
    texts = channel_texts(channel)
    stretches = captures(path)
    first = next(stretches)  # the description of the telemetry is attached first
    known = _attached_rig(chain([first], stretches)) if rig is None else _rig(rig)
    recorded = recorded_channel(first.attachments)
    if known is None:
        match = _match(path, None, texts, recorded)
        return Blocks(path, None, channel=texts, recorded=recorded, maps=_learned(map(match.take, captures(path)), eds))
    inside = _inside(known, recorded, first.attachments.get(INSIDE))
    return Blocks(path, known, inside=inside, channel=texts, recorded=recorded)


def has_rig(path: str | Path) -> bool:
    """Return whether a rig is attached to a recording, before its frames."""
    for capture in () if is_log(path) else iter_pcapng(path):
        if RIG in capture.attachments or len(capture.frames):
            return RIG in capture.attachments
    return False


def captures(path: str | Path) -> Iterator[Capture]:
    """Yield a pcapng file's stretches; another tool's log is a single stretch."""
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
    """Return the telemetry PDOs of the recorded bus' host: it numbers the axes of this bus."""
    return inside_pdos(rig.on(recorded) if recorded in rig.channels else rig, attached)


def _rig(rig: Rig | str | os.PathLike[str]) -> Rig:
    return rig if isinstance(rig, Rig) else load_rig(rig)


def _match(path: str, rig: Rig | None, channel: tuple[str, ...], recorded: str) -> BusMatch:
    return BusMatch.without_rig(path, channel) if rig is None else BusMatch(path, rig.channels, channel, recorded)


def _learned(captures: Iterable[Capture], eds: Iterable[str]) -> LogMaps:
    """Return the PDO maps of a log, learned stepwise because a map may change."""
    maps = LogMaps(eds_files(eds))
    for capture in captures:
        for start in range(0, len(capture.frames), LEARNED):
            maps.take(capture.frames[start : start + LEARNED])
    return maps


def _begins(maps: LogMaps | None, pdos: Iterable[RigPdo], row: int) -> dict[int, int]:
    """Return the first row of each PDO's map in a stretch that begins at `row`."""
    return {} if maps is None else {pdo.layout.cob_id: maps.begin(pdo.layout.cob_id) - row for pdo in pdos}


def _remaps(path: str, maps: LogMaps | None, pdos: Iterable[RigPdo]) -> Iterator[str]:
    """Return sentences on PDOs with an earlier map, whose frames are in no signal."""
    begins = _begins(maps, pdos, 0)
    for pdo in pdos:
        begin = begins.get(pdo.layout.cob_id, 0)
        if begin:
            yield f"{path}: {pdo.node}.{pdo.name} got another map at frame {begin}: its signals begin there"


def _attached_rig(captures: Iterable[Capture]) -> Rig | None:
    """Return the rig attached to a recording, or None; only the beginning of the file is read."""
    texts: dict[str, str] = {}
    damage: list[str] = []
    frames = 0
    for capture in captures:
        frames += len(capture.frames)
        damage += [warning for warning in capture.warnings if RIG in warning]
        files = (name for name in capture.attachments if not name.startswith(HOST))
        texts |= {name: capture.attachments[name].decode(errors="replace") for name in files}
        if RIG in texts and len(capture.frames):  # its EDS files stand before the frames, too
            break
    if RIG not in texts:
        if capture.torn and not frames:
            damage.append(f"the file breaks off: its last block is unfinished, {capture.torn} bytes of it are there")
        if damage:
            raise RigError([f"{capture.path}: no {RIG} is attached ({'; '.join(damage)}); {GIVE_RIG}"])
        return None
    try:
        return load_rig_text(texts.pop(RIG), f"{capture.path}[{RIG}]", texts, attached=True)
    except RigError as error:
        remedy = f"{capture.path}: its attached rig cannot be read by this version; {GIVE_RIG}"
        raise RigError([*error.errors, remedy]) from error
