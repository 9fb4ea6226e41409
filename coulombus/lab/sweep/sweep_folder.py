"""The folder of a sweep: consistent after a power cut, and resumable.

::

    DIR/sweep.toml          a copy of the sweep file
    DIR/sweep.json          fingerprint of the runs, and their times
    DIR/parts/000007.parquet    finished rows, until all are done
    DIR/runs.parquet        all rows, in their order
    DIR/recordings/000012.pcapng    recordings of --keep-recordings
    DIR/worst-NAME.toml, map-NAME.png   worst cases and maps

Each file is written completely under another name, synced, and renamed.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from coulombus.lab.sweep.figures import known_figures
from coulombus.lab.sweep.sweep_file import Sweep
from coulombus.recording.extras import library
from coulombus.rigs.errors import toml_value
from coulombus.system.errors import CoulombusError
from coulombus.system.file_lock import lock_file
from coulombus.system.unfinished_file import write_whole

__all__ = ["Folder", "RunTimes", "SweepFolderError"]

FORMAT = 1
OWN = re.compile(
    r"sweep\.json|runs\.parquet|summary\.json|(worst|map)-[\w.-]+\.(toml|png|eds)|\..*|"
    r"parts/\.?[\w-]+\.parquet|recordings/\.?[\w-]+\.pcapng"
)
"""Files that a sweep writes, and that another sweep removes first."""
PART_RUNS = 64
ROW_GROUP = 1024
PART_S = 800.0
"""Maximum rows and display time [s] of a part: the loss by a power cut."""
LEAST_PART_S = 100.0
"""Display time [s] that a part has if its rows allow it: to sync a part takes as long as 13 s of display."""


class SweepFolderError(CoulombusError):
    """The folder cannot be used; the text has the reason and the remedy."""

    exit_status = 2


@dataclass
class RunTimes:
    """Times of the runs: displayed and on one core [s]."""

    simulated_s: float = 0.0
    cpu_s: float = 0.0


@dataclass
class Folder:
    """The folder of a sweep, locked by this process (`open_folder`)."""

    path: Path
    sweep: Sweep
    rows_of_part: int
    times: RunTimes = field(default_factory=RunTimes)
    worst: dict[str, Any] = field(default_factory=dict)
    """Results of the worst cases, kept for a later call."""
    _parts: dict[int, dict[int, dict[str, Any]]] = field(default_factory=dict)
    _complete: set[int] = field(default_factory=set)
    finished: bool = False

    @classmethod
    @contextmanager
    def open(cls, path: Path, sweep: Sweep, *, force: bool = False) -> Iterator[Folder]:
        """Yield the locked folder for a sweep, with its finished runs.

        Raises
        ------
        SweepFolderError
            it holds another sweep, and `force` was not given; or another process works in it
        OSError
        coulombus.recording.extras.MissingExtra
            pyarrow is not installed
        """
        library("pyarrow.parquet", "a table of runs")
        seconds = sweep.seconds or sweep.rig.schedule_s
        least = max(math.ceil(sweep.runs / PART_RUNS), int(LEAST_PART_S / seconds))
        rows = max(1, min(PART_RUNS, least, int(PART_S / seconds)))
        with _held(path):
            folder = cls(path, sweep, rows)
            folder._begin(force=force)
            yield folder

    # reading

    def _begin(self, *, force: bool) -> None:
        fingerprint = self._fingerprint
        state = self._state()
        if state is None and (self.path / "runs.parquet").exists() and not force:
            raise SweepFolderError(f"{self.path}: runs.parquet is there, and not of a sweep that can go on; {_REMEDY}")
        if state is not None and state.get("fingerprint") != fingerprint and not force:
            raise SweepFolderError(
                f"{self.path}: there are runs of another sweep: {self.sweep.path}, its rig or coulombus has changed; {_REMEDY}"
            )
        if force or state is None:
            self._clear()
            state = None
        if state is not None:
            self.times = RunTimes(float(state.get("simulated_s", 0.0)), float(state.get("cpu_s", 0.0)))
            self.worst = dict(state.get("worst", {}))
        copy = self.path / "sweep.toml"
        if not (copy.exists() and copy.samefile(self.sweep.path)):
            self.write(copy, self.sweep.text.encode())
        (self.path / "parts").mkdir(exist_ok=True)
        for torn in (*self.path.glob(".*"), *self.path.glob("parts/.*"), *self.path.glob("recordings/.*")):
            if torn.is_file() and torn.name != LOCK:
                torn.unlink()
        self.finished = (self.path / "runs.parquet").exists()
        if self.finished:
            self._remove_parts()
        else:
            self._read_parts()
        self._write_state()

    def _state(self) -> dict[str, Any] | None:
        try:
            state = json.loads((self.path / "sweep.json").read_text())
        except (FileNotFoundError, ValueError):
            return None
        return state if isinstance(state, dict) and state.get("format") == FORMAT else None

    def _write_state(self) -> None:
        state = {"format": FORMAT, "fingerprint": self._fingerprint, "runs": self.sweep.runs}
        state |= {"simulated_s": self.times.simulated_s, "cpu_s": self.times.cpu_s, "worst": self.worst}
        self.write(self.path / "sweep.json", (json.dumps(state, indent=2) + "\n").encode())

    def keep_worst(self, label: str, finding: Mapping[str, Any], files: Mapping[str, str]) -> None:
        """Write the files of a worst case, and keep the result."""
        for name, text in files.items():
            self.write(self.path / name, text.encode())
        self.worst[label] = dict(finding)
        self._write_state()

    def _clear(self) -> None:
        for place in (
            *self.path.glob("*"),
            *self.path.glob(".*"),
            *self.path.glob("parts/*"),
            *self.path.glob("recordings/*"),
        ):
            name = str(place.relative_to(self.path))
            if place.is_file() and OWN.fullmatch(name) and name != LOCK:
                place.unlink()

    def _read_parts(self) -> None:
        parquet = library("pyarrow.parquet", "a table of runs")
        for place in sorted((self.path / "parts").glob("[0-9]*.parquet")):
            rows = {row["run"]: row for row in parquet.read_table(place).to_pylist()}
            number = int(place.stem)
            if not rows.keys() <= set(self._runs_of(number)):
                place.unlink()  # of parts of another size: its runs are repeated
            elif len(rows) == len(self._runs_of(number)):
                self._complete.add(number)
            else:
                self._parts[number] = rows

    def _runs_of(self, number: int) -> range:
        first = number * self.rows_of_part
        return range(first, min(first + self.rows_of_part, self.sweep.runs))

    @property
    def left(self) -> list[int]:
        """The remaining runs."""
        if self.finished:
            return []
        return [
            run
            for number in range(math.ceil(self.sweep.runs / self.rows_of_part))
            if number not in self._complete
            for run in self._runs_of(number)
            if run not in self._parts.get(number, ())
        ]

    # adding results

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row; a completed part is written to disk."""
        number = row["run"] // self.rows_of_part
        part = self._parts.setdefault(number, {})
        part[row["run"]] = self._plain(row)
        if len(part) == len(self._runs_of(number)):
            self._write_part(number)
            del self._parts[number]
            self._complete.add(number)
            self._write_state()

    def flush(self) -> None:
        """Also write incomplete parts, and the times of the runs."""
        for number in self._parts:
            self._write_part(number)
        self._write_state()

    def keep_recording(self, run: int, content: bytes) -> str:
        """Write a recording, and return its path in the folder."""
        folder = self.path / "recordings"
        folder.mkdir(exist_ok=True)
        self.write(folder / f"{run:06}.pcapng", content)
        return f"recordings/{run:06}.pcapng"

    def finish(self) -> None:
        """Merge the parts into runs.parquet."""
        self.flush()
        pa, parquet = library("pyarrow", "a table of runs"), library("pyarrow.parquet", "a table of runs")
        place, beside = self.path / "runs.parquet", self.path / ".runs.parquet"
        with self._write_errors(place):
            with beside.open("wb") as file:
                with parquet.ParquetWriter(file, self._schema(), compression="zstd") as writer:
                    waiting: list[Any] = []
                    for number in sorted(self._complete):
                        waiting.append(parquet.read_table(self._part(number)).cast(self._schema()))
                        if sum(table.num_rows for table in waiting) >= ROW_GROUP:
                            writer.write_table(pa.concat_tables(waiting))
                            waiting = []
                    if waiting:
                        writer.write_table(pa.concat_tables(waiting))
                file.flush()
                os.fsync(file.fileno())
            os.replace(beside, place)
        self.finished = True
        self._remove_parts()

    def _remove_parts(self) -> None:
        for place in (self.path / "parts").glob("*.parquet"):
            place.unlink()
        with suppress(OSError):
            (self.path / "parts").rmdir()

    def rows(self, *columns: str) -> list[dict[str, Any]]:
        """Return these columns of all rows of a finished sweep."""
        parquet = library("pyarrow.parquet", "a table of runs")
        rows: list[dict[str, Any]] = parquet.read_table(self.path / "runs.parquet", columns=list(columns)).to_pylist()
        return rows

    # writing

    def _part(self, number: int) -> Path:
        return self.path / "parts" / f"{number:06}.parquet"

    def _write_part(self, number: int) -> None:
        pa, parquet = library("pyarrow", "a table of runs"), library("pyarrow.parquet", "a table of runs")
        rows = [row for _, row in sorted(self._parts[number].items())]
        sink = pa.BufferOutputStream()
        parquet.write_table(pa.Table.from_pylist(rows, schema=self._schema()), sink, compression="zstd")
        self.write(self._part(number), sink.getvalue().to_pybytes())

    def write(self, path: Path, content: bytes) -> None:
        """Write a file of the folder atomically."""
        with self._write_errors(path):
            write_whole(path, content)

    @contextmanager
    def _write_errors(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            done = self.sweep.runs - len(self.left)
            raise SweepFolderError(
                f"{path}: cannot be written ({error.strerror or error}); runs that are done are kept ({done} of "
                f"{self.sweep.runs}, some of them perhaps not on the disk): make room, and give the same command to continue"
            ) from error

    def _schema(self) -> Any:
        pa = library("pyarrow", "a table of runs")
        words = {float: pa.float64(), int: pa.int64(), str: pa.string(), bool: pa.bool_()}
        fields = [("run", int), ("point", int), ("mode", str), ("seed", int)]
        fields += zip((variation.key for variation in self.sweep.vary), self._kinds, strict=True)
        fields += [("error", str), *known_figures(self.sweep.rig).items()]
        fields += [(f"rates.{name}", bool) for name in self.sweep.rates]
        fields += [("rig", str), ("recording", str)]
        return pa.schema([pa.field(name, words[kind]) for name, kind in fields])

    @cached_property
    def _fingerprint(self) -> str:
        return self.sweep.fingerprint()

    @cached_property
    def _kinds(self) -> tuple[type, ...]:
        """The types of the varied keys' columns; other values are stored as TOML."""
        types = []
        for k in range(len(self.sweep.vary)):
            kinds = {type(point[k]) for point in self.sweep.points}
            plain = len(kinds) == 1 and kinds <= {int, float, bool, str}
            types.append(float if kinds == {int, float} else kinds.pop() if plain else str)
        return tuple(types)

    def _plain(self, row: Mapping[str, Any]) -> dict[str, Any]:
        values = dict(row)
        for variation, kind in zip(self.sweep.vary, self._kinds, strict=True):
            if kind is str and not isinstance(values[variation.key], str):
                values[variation.key] = toml_value(values[variation.key])
        return values


LOCK = ".lock"
_REMEDY = "name another folder, or replace what is there with --overwrite"


@contextmanager
def _held(path: Path) -> Iterator[None]:
    """Lock a folder for this process; create it if missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        file = (path / LOCK).open("w")
    except OSError as error:
        raise SweepFolderError(f"{path}: cannot be written ({error.strerror}); name another folder") from error
    with file:
        try:
            lock_file(file)
        except OSError:
            raise SweepFolderError(
                f"{path}: another sweep is at work there; wait for it, or name another folder"
            ) from None
        yield
