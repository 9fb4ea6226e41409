"""ASAM's .mf4, read by python-can with asammdf; its rows are checked against the resulting frames.

The verbs suppress `asammdf` when they import python-can, because it takes most of a second
(`coulombus.cli`). `ready` loads it for a log that needs it.
"""

from __future__ import annotations

import gc
import importlib
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from coulombus.recording.logs import python_can
from coulombus.recording.logs.log import Log

__all__ = ["MAGICS", "read", "ready"]

MAGICS = (b"MDF ", b"UnFinMF ")
BUS_EVENT = 2
"""Flag of a channel group whose rows are events of a bus (`asammdf`'s FLAG_CG_BUS_EVENT)."""


def read(path: str | Path) -> Log:
    """Read an .mf4 file.

    Raises
    ------
    ValueError
        It is not an .mf4 file.
    ImportError
        asammdf is not installed.
    """
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        start = file.read(8)
    if not any(start.startswith(magic[: len(start)]) for magic in MAGICS):
        raise ValueError("it does not begin as an .mf4 file does")
    log = Log()
    with _quiet():
        rows = _rows(path)
    if rows is None:
        raise ValueError("it holds signals, and no frames of a bus")
    if isinstance(rows, str):
        log.remarks.append(f"{size} bytes were left out: asammdf cannot read the file ({rows})")
        return log
    error_text = python_can.read_log(path, log, ".mf4")
    missing = rows - len(log.rows) - sum(count for count, _ in log.losses.values())
    if missing > 0:
        log.lose(f"python-can's reader passes over them{error_text and f' ({error_text})'}", count=missing)
    return log


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence asammdf on stderr: its log, and errors from closing a file that it could not open."""
    logger = logging.getLogger("asammdf")
    level, hook = logger.level, sys.unraisablehook
    logger.setLevel(logging.CRITICAL)
    sys.unraisablehook = lambda _: None
    try:
        yield
        gc.collect()  # destroys the object of a file that it could not open
    finally:
        sys.unraisablehook = hook
        logger.setLevel(level)


def _rows(path: str | Path) -> int | str | None:
    """Return the number of bus events of a file, the error of a truncated file, or None if it has only signals."""
    ready()
    import asammdf

    try:
        with asammdf.MDF(path) as mdf:
            groups: list[Any] = [group.channel_group for group in mdf.groups]
            events = [int(group.cycles_nr) for group in groups if group.flags & BUS_EVENT]
            return sum(events) if events or not groups else None
    except Exception as error:  # asammdf raises any exception of its parsing
        return f"{type(error).__name__}: {error}"


def ready() -> None:
    """Load the library of python-can's reader, if installed."""
    import can.io.mf4 as reader

    if vars(reader)["asammdf"] is None:
        importlib.reload(reader)  # in its own namespace, which existing classes use
