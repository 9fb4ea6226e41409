"""Logs of other tools: detect the format and read the frames.

The format follows from the content, else from the file's name. candump's, .asc, .trc, .csv and .blf
are read here (`recording.logs`), .mf4 with asammdf, other formats by python-can's registry, which
includes plug-ins. Each may be compressed with gzip or zstd.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from coulombus.eds.regular_file import require_regular
from coulombus.recording.logs import blf, mf4, python_can
from coulombus.recording.logs.asc import AscRows
from coulombus.recording.logs.can_csv import HEAD, CsvRows
from coulombus.recording.logs.candump import CandumpRows
from coulombus.recording.logs.content import Content
from coulombus.recording.logs.log import MALFORMED, LineFormat, Log, read_rows
from coulombus.recording.logs.trc import TrcRows
from coulombus.system.errors import CoulombusError
from coulombus.wire.frame import Records

__all__ = ["EXPECTED", "WALL_CLOCK_NS", "LogContent", "LogError", "is_log", "is_pcapng", "read_log"]

TEXTS: dict[str, Callable[[], LineFormat]] = {".log": CandumpRows, ".asc": AscRows, ".trc": TrcRows, ".csv": CsvRows}
"""Line-based formats by file suffix."""
LOGS = (*TEXTS, ".blf", ".mf4", ".db")
EXPECTED = "a pcapng file, or another tool's log: candump's .log, .asc, .blf, .trc, .csv, .mf4, .db"
SNIFFED, SNIFFED_LINES = 1 << 13, 40
ASC_HEADS = ("date ", "base hex", "base dec")
WALL_CLOCK_NS = 10**17
"""Stamps beyond this (1973) are wall-clock times; smaller ones count from the run's start."""


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
    """Return whether a file is for `read_log`, by its content or else its name, and not pcapng."""
    return not Path(path).is_dir() and not is_pcapng(path) and bool(_kind(path))


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
        log, broken = _read(path, kind)
    except (ValueError, ImportError, NotImplementedError) as error:
        raise LogError(f"{path}: it cannot be read: {error}; expected {EXPECTED}") from error
    if not log.rows and set(log.losses) == {MALFORMED}:
        raise LogError(f"{path}: it has no frame: does its suffix match its content? Expected {EXPECTED}")
    remarks = log.all_remarks(str(path))
    if broken:
        remarks.append(f"{path}: {broken}: what stood behind is not known")
    return LogContent(log.frames(), tuple(log.buses), tuple(remarks))


def _read(path: str | Path, kind: str) -> tuple[Log, str]:
    if kind == ".mf4" and not _packed(path):
        return mf4.read(path), ""
    if kind in TEXTS or kind == ".blf":
        with Content(path) as content:
            if kind == ".blf":
                log = blf.read(content)
            else:
                rows = TEXTS[kind]()
                log = read_rows(content, rows)
                if isinstance(rows, CandumpRows) and rows.without_time:
                    log.remarks.append(
                        f"{rows.without_time} frames have no time stamp and got the time 0: log with candump -L"
                    )
            return log, content.broken
    log = Log()
    error = python_can.take(path, log)
    if error and not log.rows:
        raise ValueError(error)
    if error:
        log.remarks.append(f"what stands behind frame {len(log.rows)} was left out: it cannot be read ({error})")
    return log, ""


def _packed(path: str | Path) -> bool:
    with Content(path) as content:
        return bool(content.packing)


def _kind(path: str | Path) -> str:
    """Return a format by its suffix; "" for an unknown file."""
    with Content(path) as content:
        start = content.read(SNIFFED)
    if start.startswith(blf.MAGIC):
        return ".blf"
    if start.startswith(mf4.MAGICS):
        return ".mf4"
    lines = start.decode("utf-8", "replace").splitlines()[:SNIFFED_LINES]
    for kind, is_of in MARKS.items():
        if any(is_of(line) for line in lines):
            return kind
    name = Path(path).name.lower().removesuffix(".gz").removesuffix(".zst")
    return next((ending for ending in LOGS if name.endswith(ending)), "")


def _is_frame_of_candump(line: str) -> bool:
    try:
        return isinstance(CandumpRows().row(line, ended=True), tuple)
    except ValueError:
        return False


MARKS: dict[str, Callable[[str], bool]] = {
    ".trc": lambda line: line.startswith(
        (";$FILEVERSION", ";   Generated by PCAN", ";    Generated by python-can TRC")
    ),
    ".asc": lambda line: line.lower().startswith(ASC_HEADS),
    ".csv": lambda line: line == HEAD,
    ".log": _is_frame_of_candump,
}
"""Line-based formats -> whether one of the first lines has the format."""
