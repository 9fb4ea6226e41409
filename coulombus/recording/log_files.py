"""Logs of other tools, as python-can reads them by their names: candump's .log, .asc, .blf, .trc,
.csv, .mf4, .db, each also .gz.
"""

from __future__ import annotations

from pathlib import Path

from coulombus.eds.regular_file import require_regular
from coulombus.recording import blf_log, mf4_log
from coulombus.system.errors import CoulombusError
from coulombus.wire.frame import Frame, Records, new_records

__all__ = ["WALL_CLOCK_NS", "LogError", "is_log", "is_pcapng", "read_log"]

LOGS = (".log", ".asc", ".blf", ".trc", ".csv", ".mf4", ".db")
LINES = (".log", ".asc", ".csv", ".trc")
WALL_CLOCK_NS = 10**17
"""Stamps beyond this (1973) are a clock's; smaller ones count from the run's start."""
LATEST_S = 2**63 / 1e9 - 1
"""Stamps beyond this are more nanoseconds than an int64 holds."""


class LogError(CoulombusError):
    """The file cannot be read; the text says where and why."""

    exit_status = 2


def is_pcapng(path: str | Path) -> bool:
    """Tell whether a file begins as a pcapng file does; OSError where it is none, but a pipe or a
    device.
    """
    require_regular(path)
    with Path(path).open("rb") as file:
        return file.read(4) == b"\x0a\x0d\x0d\x0a"


def is_log(path: str | Path) -> bool:
    """Tell whether a file is one for `read_log`, by its name, and by its content no pcapng file."""
    return Path(path).name.lower().removesuffix(".gz").endswith(LOGS) and not is_pcapng(path)


def read_log(path: str | Path) -> tuple[Records, list[str]]:
    """Return the frames of a file that python-can reads, and sentences on what was left out.

    Raises
    ------
    LogError
        The file is of another kind or damaged.
    """
    import can

    from coulombus.wire.python_can_messages import can_id_of, is_classical, word_of  # imports python-can

    name = Path(path).name.lower().removesuffix(".gz")
    if name.endswith(".mf4"):
        mf4_log.ready()
    rows: list[tuple[int, int, int, int, int]] = []
    skipped = 0
    try:
        if name.endswith(".blf"):
            blf_log.check(path)
        with can.LogReader(path) as reader:
            for message in reader:
                if not is_classical(message):
                    skipped += 1
                    continue
                rows.append((_stamp_ns(message.timestamp), can_id_of(message), message.dlc, word_of(message), 0))
    except Exception as error:  # each of python-can's readers raises what its parsing happens to raise
        where = f"after frame {len(rows) + skipped}" if rows or skipped else "at its beginning"
        raise LogError(
            f"{path}: {where}: it cannot be read ({type(error).__name__}: {error}); expected a pcapng file, or what "
            "python-can reads by its name: candump's .log, .asc, .blf, .trc, .csv, .mf4, .db"
        ) from error
    if not rows and not skipped:
        raise LogError(f"{path}: there is no frame in it: is it of the kind that its name tells?")
    frames = new_records(Frame, len(rows))
    frames[:] = rows
    remarks = [f"{path}: {skipped} CAN FD frames were left out"] if skipped else []
    if Path(path).suffix in LINES and not Path(path).read_bytes().endswith(b"\n"):
        remarks.append(f"{path}: it ends in the midst of a line: its last frame may be cut short; --to-s leaves it out")
    return frames, remarks


def _stamp_ns(timestamp: float) -> int:
    """Return python-can's stamp [s]: a clock's in whole us, which is what files have and as much as
    its float still tells.
    """
    if not abs(timestamp) < LATEST_S:
        raise ValueError(f"got the stamp {timestamp:g} s, expected one before the year 2262")
    return round(timestamp * 1e6) * 1000 if timestamp * 1e9 >= WALL_CLOCK_NS else round(timestamp * 1e9)
