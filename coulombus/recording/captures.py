"""The content of a recording's file, a stretch at a time: pcapng, segments, or another tool's log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from coulombus.recording.block import epoch_of
from coulombus.recording.bus_match import BusMatch, Channel, channel_texts
from coulombus.recording.file_content import Capture, remarks_on
from coulombus.recording.log_files import LogError, is_log, read_log
from coulombus.recording.pcapng_reader import iter_pcapng
from coulombus.recording.time_search import ALL, Window

__all__ = ["captures", "captures_of_bus", "parts_of"]


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
    match = BusMatch.without_rig(str(path), channel_texts(channel))
    warnings, left_out, frames = list[str](), Counter[str](), 0
    origin_ns: int | None = None
    for stretch in captures(path):
        capture = match.select(stretch)
        if origin_ns is None and len(stretch.frames):
            origin_ns = epoch_of(stretch.frames)
        capture = replace(capture, origin_ns=origin_ns)
        frames += len(capture.frames)
        warnings += capture.warnings
        left_out.update(torn=capture.torn, skipped=capture.skipped)
        yield capture
    sentences = remarks_on(str(path), (*warnings, *match.remarks()), left_out)
    if not frames:
        raise LogError("; ".join((f"{path}: it has no frame", *(text.removeprefix(f"{path}: ") for text in sentences))))
    remarks += sentences


def parts_of(capture: Capture, window: Window) -> Iterator[tuple[Capture, int, bool]]:
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
