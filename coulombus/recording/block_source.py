"""A recording as a stream of blocks: each iteration reads its file, some seconds at a time."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from coulombus.recording.bus_match import BusMatch, Channel, channel_texts, one_bus
from coulombus.recording.file_content import Capture
from coulombus.recording.host_telemetry import of_axis
from coulombus.recording.log_files import LogError, is_log, read_log
from coulombus.recording.maps.log_maps import LogMaps
from coulombus.recording.pcapng_reader import iter_pcapng
from coulombus.recording.remarks import remarks_on
from coulombus.recording.signals import Recording, Source, decode, epoch_of, left_out_of, markers_of
from coulombus.recording.time_search import ALL, Window
from coulombus.recording.unwrap import POSITION, Turns
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo

__all__ = ["HOST", "WHOLE", "Blocks", "Span", "bus_match", "captures", "captures_of_bus", "first_rows", "remaps"]

Span: TypeAlias = tuple[float | None, float | None]
WHOLE: Span = (None, None)
LONG_COUNTER = 32
"""Bits of a counter that is taken not to overflow."""
LATEST_NS = 1 << 62
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

    span: Span = WHOLE
    """Begin and end [s], None: open."""

    origin: Blocks | None = None
    """The recording of which this is a view: it gets the remarks, too."""

    def __post_init__(self) -> None:
        self._whole = self.known_rig
        if self.axis and self._whole is not None:
            self.known_rig = self._whole.alone(self.axis)
        self.bare = () if self.maps is None else self.maps.pdos()

    def __iter__(self) -> Iterator[Recording]:
        epoch_ns, left_out, warnings, turns = None, Counter[str](), list[str](), dict[str, Turns]()
        window, is_searched = self._window(), self._is_searched()
        match = self._match()
        row = 0
        for stretch in captures(self.path, window if is_searched else ALL):
            if epoch_ns is None and len(stretch.frames):  # of any bus: all buses of a file have one time 0
                epoch_ns = epoch_of(stretch.frames)
            capture = match.take(stretch)
            for part, begin, is_wanted in _parts(capture, window):
                if is_searched and not is_wanted:
                    continue
                begins = first_rows(self.maps, self.bare, row + begin)
                block = decode(part, self.known_rig, epoch_ns, turns, self.inside, self.bare, begins)
                turns |= block.turns
                if is_wanted:
                    if self.axis and self._whole is not None:
                        block = replace(block, markers=markers_of(self.axis, self._whole, block.markers))
                    left_out.update(left_out_of(block))
                    yield block
            row += len(capture.frames)
            warnings += capture.warnings
        warnings += [*match.remarks(), *remaps(self.path, self.maps, self.bare)]
        self.remarks = remarks_on(self.path, warnings, left_out)
        if self.origin is not None:
            self.origin.remarks = tuple(dict.fromkeys((*self.origin.remarks, *self.remarks)))

    def _match(self) -> BusMatch:
        return bus_match(self.path, self._whole, self.channel, self.recorded)

    def _window(self) -> Window:
        """Return the span in stamps."""
        if self.span == WHOLE:
            return ALL
        stamps = (capture.frames for capture in captures(self.path) if len(capture.frames))
        epoch_ns = next(map(epoch_of, stamps), 0)
        begin, end = self.span
        return Window(
            None if begin is None else epoch_ns + math.floor(begin * 1e9),
            None if end is None else epoch_ns + math.ceil(end * 1e9),
        )

    def _is_searched(self) -> bool:
        """Return whether frames before the span may be left out: no map is learned from them, and no
        counter overflows in them.
        """
        if self.known_rig is None:
            return False
        fields = ((e, s) for pdo in self.known_rig.pdos() for e, s in zip(pdo.layout.entries, pdo.signals, strict=True))
        return all(entry.bits >= LONG_COUNTER for entry, signal in fields if signal.key == POSITION)

    def within(self, begin_s: float, end_s: float) -> Blocks:
        """Return the blocks of a stretch of time; frames before it are not read where that is possible."""
        return replace(self, known_rig=self._whole, span=(begin_s, end_s), origin=self)

    def extent(self) -> tuple[float, float] | None:
        """Return the times of the first and the last frame [s]; None without a frame.

        Of a recording of this project only its two ends are read, or decoded where it is compressed.
        """
        if self.span != WHOLE or self.axis:
            return super().extent()
        firsts = (capture for capture in captures(self.path) if len(capture.frames))
        first = next(firsts, None)
        if first is None:
            return None
        epoch_ns, times = epoch_of(first.frames), list[int]()
        mine = (capture for capture in map(self._match().take, captures(self.path)) if len(capture.frames))
        ends = map(self._match().take, captures(self.path, Window(begin_ns=LATEST_NS)))
        for part in (*itertools.islice(mine, 1), *ends):
            if len(part.frames):
                times += part.frames["t_ns"][[0, -1]].tolist()
                times = [min(times), max(times)]
        return ((times[0] - epoch_ns) / 1e9, (times[1] - epoch_ns) / 1e9) if times else None

    def seen_by(self, axis: str) -> Blocks:
        """Return the view of the axis of this name, with the signals' plain names.

        Markers of other axes are left out.
        """
        if not axis:
            return self
        inside = of_axis(self.inside, axis)
        return Blocks(self.path, self.rig, axis, inside, self.channel, self.recorded, span=self.span)


def _parts(capture: Capture, window: Window) -> Iterator[tuple[Capture, int, bool]]:
    """Yield the part of a stretch before the window, and that in it, each with its first row, and whether it is in it."""
    if window == ALL:
        yield capture, 0, True
        return
    empty = replace(capture, comments=[], attachments={}, torn=0, skipped=0, warnings=(), late=())
    rows, inside = window.places(capture.frames["t_ns"]), window.places(capture.inside["t_ns"])
    if (rows < 0).any() or (inside < 0).any():
        yield empty.part(rows < 0, inside < 0), 0, False
    late = tuple(marker for marker in capture.late if not window.places(np.array([marker[0]]))[0])
    if capture.attachments or capture.warnings or late or (rows == 0).any() or (inside == 0).any():
        first = int(np.argmax(rows == 0)) if len(rows) else 0
        yield replace(capture.part(rows == 0, inside == 0), late=late), first, True


def captures(path: str | Path, window: Window = ALL) -> Iterator[Capture]:
    """Yield a pcapng file's stretches; another tool's log is a single stretch.

    With a `window` those outside of it may be left out (`iter_pcapng`).
    """
    if is_log(path):
        log = read_log(path)
        return iter(
            [
                Capture(
                    str(path), log.frames, comments=[], attachments={}, warnings=log.remarks, buses=log.buses or ("",)
                )
            ]
        )
    return iter_pcapng(path) if window == ALL else iter_pcapng(path, window)


def captures_of_bus(path: str | Path, channel: Channel, remarks: list[str]) -> Iterator[Capture]:
    """Yield the stretches of one bus of a log, for readers without a rig; then add what was left out to `remarks`.

    Raises
    ------
    coulombus.recording.bus_match.ChannelError
        The file has several buses, and `channel` names none of them.
    coulombus.recording.log_files.LogError
        It has no frame; raised at its end.
    """
    texts, warnings, of_bus, left_out, frames = (
        channel_texts(channel),
        list[str](),
        tuple[str, ...](),
        Counter[str](),
        0,
    )
    origin_ns: int | None = None
    for stretch in captures(path):
        capture, of_bus = one_bus(stretch, texts)
        if origin_ns is None and len(stretch.frames):
            origin_ns = epoch_of(stretch.frames)
        capture = replace(capture, origin_ns=origin_ns)
        frames += len(capture.frames)
        warnings += capture.warnings
        left_out.update(torn=capture.torn, skipped=capture.skipped)
        yield capture
    found = remarks_on(str(path), (*warnings, *of_bus), left_out)
    if not frames:
        raise LogError("; ".join((f"{path}: it has no frame", *(text.removeprefix(f"{path}: ") for text in found))))
    remarks += found


def bus_match(path: str, rig: Rig | None, channel: tuple[str, ...], recorded: str) -> BusMatch:
    """Return the match of a recording's buses with the rig's, or with one bus."""
    return BusMatch.without_rig(path, channel) if rig is None else BusMatch(path, rig.channels, channel, recorded)


def first_rows(maps: LogMaps | None, pdos: Iterable[RigPdo], row: int) -> dict[int, int]:
    """Return the first row of each PDO's map in a stretch that begins at `row`."""
    return {} if maps is None else {pdo.layout.cob_id: maps.begin(pdo.layout.cob_id) - row for pdo in pdos}


def remaps(path: str, maps: LogMaps | None, pdos: Iterable[RigPdo]) -> Iterator[str]:
    """Return sentences on PDOs with an earlier map, whose frames are in no signal."""
    begins = first_rows(maps, pdos, 0)
    for pdo in pdos:
        begin = begins.get(pdo.layout.cob_id, 0)
        if begin:
            yield f"{path}: {pdo.node}.{pdo.name} got another map at frame {begin}: its signals begin there"
