"""Folders of recording segments: ``DIR/000007-20261122T200412Z/000001.pcapng``, or ``000001.pcapng.zst``."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["INDEX", "PACKED", "RUN", "SEGMENT", "files_of", "present", "runs", "segments", "segments_of"]

RUN = re.compile(r"\d{6}-\d{8}T\d{6}Z")
"""The name of a run's folder: its number and start time."""
INDEX = "index.jsonl"
"""The name of a run's index."""
PACKED = ".zst"
"""What the name of a compressed segment has behind that of the plain one."""
SEGMENT = re.compile(rf"(\d{{6}}\.pcapng)(?:{re.escape(PACKED)})?")


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
    """Return the segments of a run in order; of a segment that is there twice, the compressed file."""
    numbered = {path.name.removesuffix(PACKED): path for path in files_of(run)}  # sorted: the compressed one is later
    return list(numbered.values())


def files_of(run: Path) -> list[Path]:
    """Return all files of a run's segments in order, plain and compressed ones."""
    try:
        return sorted(path for path in run.iterdir() if SEGMENT.fullmatch(path.name))
    except OSError:
        return []


def present(segment: Path) -> Path:
    """Return the segment's present file: a plain one may have been compressed since it was listed."""
    packed = segment.with_name(segment.name + PACKED)
    return packed if not segment.exists() and packed.exists() else segment
