"""Folders of recording segments: ``DIR/000007-20261122T200412Z/000001.pcapng``."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["RUN", "SEGMENT", "runs", "segments", "segments_of"]

RUN = re.compile(r"\d{6}-\d{8}T\d{6}Z")
"""The name of a run's folder: its number and start time."""
SEGMENT = re.compile(r"\d{6}\.pcapng")


def runs(folder: Path) -> list[Path]:
    """Return the folders of the runs in a folder, the oldest first."""
    try:
        return sorted(path for path in folder.iterdir() if RUN.fullmatch(path.name) and path.is_dir())
    except OSError:
        return []


def segments(folder: Path) -> list[Path]:
    """Return the segments of a run, or of the newest run with segments in a folder, in order; empty if there are none."""
    for run in (folder, *reversed(runs(folder))):
        paths = segments_of(run)
        if paths:
            return paths
    return []


def segments_of(run: Path) -> list[Path]:
    """Return the segments of a run in order."""
    try:
        return sorted(path for path in run.iterdir() if SEGMENT.fullmatch(path.name))
    except OSError:
        return []
