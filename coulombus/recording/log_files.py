"""Logs of other tools: recognise the format and read the frames.

The content decides, not the file's name. Text formats are rows of `recording.logs.formats.FORMATS`,
.blf is read by `recording.logs.blf`, .mf4 with asammdf, .db by python-can. Each may be compressed
with gzip or zstd.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from coulombus.eds.regular_file import require_regular
from coulombus.kernels.records import Records
from coulombus.recording.logs import blf, mf4, python_can
from coulombus.recording.logs.content import Content
from coulombus.recording.logs.formats import FORMATS
from coulombus.recording.logs.line_reader import FormatMatch, LineReader, read_rows, recognise, refusal
from coulombus.recording.logs.log import DIFFERENCES, Log, are_differences, time_remarks
from coulombus.recording.pcapng_blocks import other_format
from coulombus.system.errors import CoulombusError

__all__ = ["EXPECTED", "LogContent", "LogError", "is_log", "is_pcapng", "read_log"]

EXPECTED = f"a pcapng file, or another tool's log: {', '.join(row.name for row in FORMATS)}, .blf, .mf4, .db"
BINARY = {blf.MAGIC: ".blf", **dict.fromkeys(mf4.MAGICS, ".mf4"), b"SQLite format 3\0": ".db"}
"""First bytes -> format."""
SNIFFED = 1 << 14


class LogError(CoulombusError):
    """The file cannot be read; the text has the place and the reason."""

    exit_status = 2


@dataclass(frozen=True)
class LogContent:
    """Content of a log: frames, whose `source` is an index into `buses`; the names of the buses in
    the order of their first frames; and sentences on omitted rows.
    """

    frames: Records
    buses: tuple[str, ...]
    remarks: tuple[str, ...]


def is_pcapng(path: str | Path) -> bool:
    """Return whether a file, unpacked, begins like pcapng; raise OSError for a pipe or a device."""
    require_regular(path)
    with Content(path) as content:
        return content.read(4) == b"\x0a\x0d\x0d\x0a"


def is_log(path: str | Path) -> bool:
    """Return whether a file is for `read_log`, which may refuse it: by its content, or as a text; and not pcapng."""
    return not Path(path).is_dir() and not is_pcapng(path) and _kind(path) is not None


def read_log(path: str | Path) -> LogContent:
    """Return the frames of another tool's log.

    Frames, and the rows (objects, bytes) counted in the remarks, add up to the whole file.

    Raises
    ------
    LogError
        The file is empty or of another kind.
    """
    if Path(path).stat().st_size == 0:
        raise LogError(f"{path}: the file is empty: nothing was recorded; take another file")
    kind = _kind(path)
    try:
        if isinstance(kind, FormatMatch):
            return _read_text(path, kind)
        log, broken = _read_binary(path, kind)
    except (ValueError, ImportError, NotImplementedError) as error:
        raise LogError(f"{path}: it cannot be read: {error}; expected {EXPECTED}") from error
    return _content(path, log, broken)


def _read_text(path: str | Path, match: FormatMatch) -> LogContent:
    if not match.fits and (match.misfits or match.format.suffix != _suffix(path)):
        raise LogError(f"{refusal(str(path), match)}; expected {EXPECTED}")
    rows = LineReader(match.format)
    log, broken = _read_lines(path, rows, match.end)
    if rows.may_differ and are_differences(log.frames()["t_ns"]):
        rows = LineReader(match.format)
        rows.relative = True
        log, broken = _read_lines(path, rows, match.end)
        log.remarks.append(DIFFERENCES)
    if rows.without_time:
        log.remarks.append(
            f"{rows.without_time} frames have no time stamp and got the time 0: log with time stamps (candump -L)"
        )
    return _content(path, log, broken, is_timed=not rows.without_time)


def _read_lines(path: str | Path, rows: LineReader, end: bytes) -> tuple[Log, str]:
    with Content(path) as content:
        return read_rows(content.lines(end), rows), content.broken


def _read_binary(path: str | Path, kind: str | None) -> tuple[Log, str]:
    with Content(path) as content:
        if kind == ".blf":
            log = blf.read(content)
            return log, content.broken
        packed = bool(content.packing)
    if kind == ".mf4" and not packed:
        return mf4.read(path), ""
    log = Log()
    error = python_can.read_log(path, log, "" if packed else kind or "")
    if error and not log.rows:
        raise ValueError(error)
    if error:
        log.remarks.append(f"what stands behind frame {len(log.rows)} was left out: it cannot be read ({error})")
    return log, ""


def _content(path: str | Path, log: Log, broken: str, is_timed: bool = True) -> LogContent:
    frames = log.frames()
    if is_timed:
        log.remarks += time_remarks(frames["t_ns"])
    remarks = log.all_remarks(str(path))
    if broken:
        remarks.append(f"{path}: {broken}: what stood behind is not known")
    return LogContent(frames, tuple(log.buses), tuple(remarks))


def _kind(path: str | Path) -> FormatMatch | str | None:
    """Return how well a text fits its format, the ending of a binary format, or None for an unknown file."""
    with Content(path) as content:
        start = content.read(SNIFFED)
    binary = next((kind for magic, kind in BINARY.items() if start.startswith(magic)), None)
    if binary:
        return binary
    suffix = _suffix(path)
    match = recognise(start, suffix)
    if match.fits:
        return match
    if suffix in BINARY.values():
        return suffix
    is_other = suffix == ".pcapng" or b"\0" in start or other_format(start, str(path)) is not None
    return None if is_other else match


def _suffix(path: str | Path) -> str:
    return Path(Path(path).name.lower().removesuffix(".gz").removesuffix(".zst")).suffix
