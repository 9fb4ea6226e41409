"""Open a recording: to read it (`read`), or only to go through it some seconds at a time (`blocks`).

The meaning of the bits comes from the rig file and the EDS files attached to the recording. For a
file without them (candump's, Wireshark's, or one rewritten by editcap) it comes from the given rig,
else from the log itself (`recording.maps`).

`read` keeps a short recording: 40 bytes per frame and about 8 for each of its signals. Of a long one
it reads what is asked for. `blocks` keeps none, so figures and rows need only bounded memory.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

from coulombus.eds.eds_folder import EdsFiles, eds_files
from coulombus.recording.block import GIVE_RIG
from coulombus.recording.bus_match import BusMatch, Channel, channel_texts, recorded_channel
from coulombus.recording.captures import captures
from coulombus.recording.file_content import HOST, Capture
from coulombus.recording.folders import segments
from coulombus.recording.host_telemetry import NAME as INSIDE
from coulombus.recording.host_telemetry import inside_pdos
from coulombus.recording.log_files import LogError, is_log
from coulombus.recording.logs.content import Content
from coulombus.recording.maps.log_maps import LEARNED, LogMaps
from coulombus.recording.pcapng_reader import iter_pcapng, read_pcapng
from coulombus.recording.signals import Recording
from coulombus.recording.time_search import WHOLE, Span, checked_span
from coulombus.rigs.arguments import path_text
from coulombus.rigs.rig import Rig, RigError, load_rig, load_rig_text
from coulombus.rigs.signals import RigPdo

__all__ = ["HOST", "RIG", "attached_rig", "blocks", "captures", "has_rig", "read"]

KEPT_BYTES, PACKED_SHARE = 1 << 26, 16
"""Size of the longest recording that `read` keeps: three minutes of one axis; compressed bytes count as so many."""
RIG = "rig.toml"


def read(
    path: str | os.PathLike[str],
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
    *,
    eds: Iterable[str] | EdsFiles = (),
    span: Span = WHOLE,
) -> Recording:
    """Read a recording: a short one whole, of a long one what is asked for.

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
        EDS files: ``"5=drive.eds"``, or a folder whose files are matched by identity. With them an attached
        rig is not used.
    span
        Only the frames from begin to end [s], None: open. Of a recording of this project, whose stamps
        rise, the rest is not read. A counter of 32 bits is taken to begin without a wrap.

    Raises
    ------
    coulombus.rigs.rig.RigError
        The rig cannot be read.
    coulombus.recording.pcapng_blocks.PcapngError, coulombus.recording.log_files.LogError
        The file is damaged, or is of another kind.
    coulombus.recording.bus_match.ChannelError
        The file has other buses than the rig, and `channel` does not select them.
    coulombus.rigs.arguments.WrongCall
        `path` is not a file's name, `rig` is neither a rig nor its name, or `span` is no pair of times.
    coulombus.eds.description.EdsError
        An entry of `eds` has neither form, or its file cannot be read.
    """
    path, span = path_text(path, "path", 'read("run.pcapng")'), checked_span(span)
    if span != WHOLE or _is_long(path):
        recording = blocks(path, rig, channel, eds=eds, span=span)
    else:
        content = next(captures(path)) if is_log(path) else read_pcapng(path)
        recording = _opened(path, rig, channel, eds, content=content)
    recording.read_through()
    return recording


def blocks(
    path: str | os.PathLike[str],
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
    *,
    eds: Iterable[str] | EdsFiles = (),
    span: Span = WHOLE,
) -> Recording:
    """Return a recording to iterate over, repeatedly, in bounded memory.

    Parameters and errors as `read`.

    The file is read anew each time: it must not change, and a pipe is refused (LogError).
    """
    path = path_text(path, "path", 'blocks("run.pcapng")')
    if Path(path).exists() and not Path(path).is_file() and not Path(path).is_dir():
        raise LogError(f"{path}: it is no file, and a recording is read more than once; save it to a file first")
    return _opened(path, rig, channel, eds, checked_span(span))


def _opened(
    path: str,
    rig: Rig | str | os.PathLike[str] | None,
    channel: Channel,
    eds: Iterable[str] | EdsFiles,
    span: Span = WHOLE,
    content: Capture | None = None,
) -> Recording:
    """Return a recording with its rig, or with the PDO maps that are learned from it."""
    texts, files = channel_texts(channel), eds_files(eds)

    def stretches() -> Iterator[Capture]:
        return captures(path) if content is None else iter((content,))

    parts = stretches()
    first = next(parts)  # the description of the telemetry is attached first
    known_rig = _known_rig(chain([first], parts), rig, files)
    recorded = recorded_channel(first.attachments)
    recording = Recording(path, known_rig, channel=texts, recorded=recorded, span=span, content=content)
    if known_rig is None:
        maps = _learned(map(BusMatch.without_rig(path, texts).select, stretches()), files)
        bare = maps.pdos()
        first_rows = {pdo.layout.cob_id: maps.begin(pdo.layout.cob_id) for pdo in bare}
        return replace(recording, bare=bare, first_rows=first_rows)
    return replace(recording, inside=_inside(known_rig, recorded, first.attachments.get(INSIDE)))


def _is_long(path: str) -> bool:
    """Return whether a recording is too long to be kept; a log of another tool is kept."""
    paths = segments(Path(path)) if Path(path).is_dir() else [Path(path)]
    if not Path(path).is_dir() and is_log(path):
        return False
    size = 0
    for part in paths:
        with Content(part) as content:
            size += part.stat().st_size * (PACKED_SHARE if content.packing else 1)
    return size > KEPT_BYTES


def has_rig(path: str | Path) -> bool:
    """Return whether a rig is attached to a recording, before its frames."""
    for capture in () if is_log(path) else iter_pcapng(path):
        if RIG in capture.attachments or len(capture.frames):
            return RIG in capture.attachments
    return False


def _inside(rig: Rig, recorded: str, attached: bytes | None) -> tuple[RigPdo, ...]:
    """Return the telemetry PDOs of the recorded bus' host: it numbers the axes of this bus."""
    return inside_pdos(rig.on(recorded) if recorded in rig.channels else rig, attached)


def _known_rig(captures: Iterable[Capture], rig: Rig | str | os.PathLike[str] | None, eds: EdsFiles) -> Rig | None:
    """Return the given rig, else without EDS files the attached one."""
    if rig is None:
        return None if eds else attached_rig(captures)
    return rig if isinstance(rig, Rig) else load_rig(rig)


def _learned(captures: Iterable[Capture], eds: EdsFiles) -> LogMaps:
    """Return the PDO maps of a log, learned stepwise because a map may change."""
    maps = LogMaps(eds)
    for capture in captures:
        for start in range(0, len(capture.frames), LEARNED):
            maps.add_frames(capture.frames[start : start + LEARNED])
    return maps


def attached_rig(captures: Iterable[Capture]) -> Rig | None:
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
    if capture.torn and not frames:
        damage.append(f"the file breaks off: its last block is unfinished, {capture.torn} bytes of it are there")
    if RIG not in texts:
        if damage:
            raise RigError([f"{capture.path}: no {RIG} is attached ({'; '.join(damage)}); {GIVE_RIG}"])
        return None
    try:
        return load_rig_text(texts.pop(RIG), f"{capture.path}[{RIG}]", texts, attached=True)
    except RigError as error:
        if capture.torn and not frames:
            raise RigError(
                [f"{capture.path}: its attached rig is not whole ({'; '.join(damage)}); {GIVE_RIG}"]
            ) from error
        remedy = f"{capture.path}: its attached rig cannot be read by this version; {GIVE_RIG}"
        raise RigError([*error.errors, remedy]) from error
