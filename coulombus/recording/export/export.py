"""``coulombus export``: write a recording for other programs.

A recording is read once, some seconds at a time, so the memory is bounded.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from coulombus.eds.eds_folder import EdsFiles
from coulombus.recording.bus_match import BusMatch, Channel, channel_texts
from coulombus.recording.export.arrow import ParquetWriter
from coulombus.recording.export.errors import ExportError
from coulombus.recording.export.hdf import Hdf5Writer
from coulombus.recording.export.logs import AscWriter, BlfWriter, CandumpWriter
from coulombus.recording.export.matlab import MatWriter
from coulombus.recording.export.mcap import McapWriter
from coulombus.recording.export.mdf import Mf4Writer
from coulombus.recording.export.text_table import CsvWriter
from coulombus.recording.file_content import remarks_on
from coulombus.recording.output_file import new_file
from coulombus.recording.reading import blocks, captures
from coulombus.recording.sample_groups import groups_of, stretches
from coulombus.recording.wall_clock import CLOCK, META, attached_object
from coulombus.rigs.arguments import path_text
from coulombus.rigs.rig import Rig

__all__ = ["FRAMES", "KINDS", "SIGNALS", "Exported", "export"]


SIGNALS: Mapping[str, tuple[str, Any]] = MappingProxyType(
    {
        "csv": (".csv", CsvWriter),
        "parquet": (".parquet", ParquetWriter),
        "mf4": (".mf4", Mf4Writer),
        "mcap": (".mcap", McapWriter),
        "hdf5": (".h5", Hdf5Writer),
        "mat": (".mat", MatWriter),
    }
)
"""Kinds that hold signals -> the file's ending, the writer."""
FRAMES: Mapping[str, tuple[str, Any]] = MappingProxyType(
    {"candump": (".log", CandumpWriter), "asc": (".asc", AscWriter), "blf": (".blf", BlfWriter)}
)
"""Kinds that hold whole frames."""
KINDS: Mapping[str, str] = MappingProxyType({kind: suffix for kind, (suffix, _) in {**SIGNALS, **FRAMES}.items()})
"""All kinds -> the file's ending."""


@dataclass(frozen=True)
class Exported:
    """The result of an export."""

    path: Path
    kind: str
    until_s: float
    """Time of the last frame [s]."""
    rows: int
    """Rows of all groups; frames for kinds of whole frames."""
    signals: tuple[str, ...]
    remarks: tuple[str, ...]
    """Sentences on omitted data."""


def export(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    kind: str,
    *,
    signals: Sequence[str] | None = None,
    grid_ns: int | None = None,
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
    eds: Iterable[str] | EdsFiles = (),
    force: bool = False,
    progress: Callable[[float], None] = lambda t_s: None,
) -> Exported:
    """Write a recording as `kind`, whole or not at all.

    Parameters
    ----------
    path
        The recording, as `coulombus.recording.reading.read` takes it.
    out
        The file to write.
    kind
        One of `KINDS`.
    signals
        Only these signals; None: all.
    grid_ns
        A row at each multiple of this time, with the last value received by then. None: a row for each frame of a PDO.
    rig
        Decode with this rig instead of the attached one.
    channel
        Which of the file's buses, as `read` takes it; None: of whole frames those of all buses.
    eds
        EDS files, as `read` takes them.
    force
        Replace `out` if it exists.
    progress
        Called with the time reached [s].

    Raises
    ------
    ExportError
        There is no frame, a library is not installed, `kind` holds whole frames but `signals` or a
        grid is given, or `out` is the recording itself or has another kind's suffix.
    coulombus.recording.signals.UnknownSignal
        A signal that the recording does not have.
    OSError
        The file cannot be written.
    coulombus.rigs.arguments.WrongCall
        An argument has the wrong type.
    """
    call = 'export("run.pcapng", "run.csv", "csv")'
    path, out = path_text(path, "path", call), path_text(out, "out", call)
    if kind not in KINDS:
        raise ExportError(f"{kind!r}: expected one of {', '.join(KINDS)}")
    _check_place(Path(path), Path(out), kind)
    if kind in FRAMES:
        if signals is not None or grid_ns is not None:
            raise ExportError(f"{kind} holds whole frames: leave the signals and the grid out")
        return _frames(Path(path), Path(out), kind, channel_texts(channel), force=force, progress=progress)
    source = blocks(path, rig, channel, eds=eds)
    groups = groups_of(source, signals, grid_ns)
    about = _about(path)
    if not any(group.columns for group in groups):
        remedy = f"decode it with a rig (--rig) or EDS files (--eds), or export whole frames: {', '.join(FRAMES)}"
        raise ExportError(f"{path}: it has no signals, for no PDO map of it is known; {remedy}")
    if grid_ns is not None:
        about["grid"] = f"{grid_ns / 1e9:g} s, values held"
    until, rows = 0.0, 0
    with new_file(Path(out), force=force) as place, _whole(SIGNALS[kind][1](place, groups, about)) as writer:
        for stretch in stretches(source, groups, grid_ns):
            writer.add(stretch)
            rows += sum(len(part.order) for part in stretch.rows)
            until = max(until, stretch.until_s)
            progress(until)
    names = tuple(column.name for group in groups for column in group.columns)
    return Exported(Path(out), kind, until, rows, names, source.remarks)


def _check_place(path: Path, out: Path, kind: str) -> None:
    """Refuse to overwrite the recording itself, and a suffix of another kind."""
    whole = out.exists() and path.exists()
    if whole and (out.samefile(path) or (path.is_dir() and path.resolve() in out.resolve().parents)):
        raise ExportError(f"{out}: that is the recording itself; nothing is written over it; choose another name")
    others = {suffix: name for name, suffix in KINDS.items() if suffix != KINDS[kind]} | dict.fromkeys(
        (".pcapng", ".gz", ".zst"), ""
    )
    suffix = out.suffix.lower()
    if suffix in others:
        other = others[suffix]
        remedy = f", or --to {other}" if other else ""
        expected = out.with_suffix(KINDS[kind]).name
        raise ExportError(f"{out}: {suffix} is the ending of {other or 'a recording'}; expected {expected}{remedy}")


@contextmanager
def _whole(writer: Any) -> Iterator[Any]:
    """Close a writer at the end, or abandon it on an exception."""
    try:
        yield writer
        writer.close()
    except BaseException:
        getattr(writer, "abandon", lambda: None)()
        raise


def _about(path: str | Path) -> dict[str, str]:
    """Return the recording's description; raise `ExportError` if it has no frame."""
    attachments: dict[str, bytes] = {}
    for capture in captures(path):
        attachments |= capture.attachments
        if len(capture.frames):
            break
    else:
        raise ExportError(f"{path}: it has no frame, so nothing can be exported")
    about = {"recording": Path(path).name}
    if "mode" in attachments:
        about["mode"] = attachments["mode"].decode(errors="replace")
    clock = attached_object(attachments.get(CLOCK))
    about |= {key: str(clock[key]) for key in ("start_utc", "start_ns") if key in clock}
    about |= {f"meta {key}": str(value) for key, value in attached_object(attachments.get(META)).items()}
    return {key: " ".join(text.splitlines()) for key, text in about.items()}


def _frames(
    path: Path, out: Path, kind: str, buses: tuple[str, ...], *, force: bool, progress: Callable[[float], None]
) -> Exported:
    """Write whole frames, each with the name of its bus; stamps are wall-clock times if the recording has them."""
    about = _about(path)
    start_ns, count, until, first = int(about.get("start_ns", 0)), 0, 0.0, 0
    torn = skipped = 0
    warnings: list[str] = []
    match = BusMatch(str(path), ("",), buses)
    with new_file(out, force=force) as place, _whole(FRAMES[kind][1](place, start_ns)) as writer:
        for capture in captures(path):
            torn, skipped, warnings = torn + capture.torn, skipped + capture.skipped, [*warnings, *capture.warnings]
            capture = match.select(capture) if buses else capture
            if not len(capture.frames):
                continue
            first = first if count else int(capture.frames["t_ns"][0])
            try:
                writer.add(capture.frames, capture.buses)
            except ExportError as error:
                raise ExportError(f"{path}: {error}") from error
            count += len(capture.frames)
            until = max(until, (int(capture.frames["t_ns"].max()) - first) / 1e9)
            progress(until)
    remarks = remarks_on(str(path), [*warnings, *match.remarks()], Counter({"torn": torn, "skipped": skipped}))
    return Exported(out, kind, until, count, (), remarks)
