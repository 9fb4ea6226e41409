"""HDF5: a group for each signal, with the datasets ``t_s`` and ``values``.

``values`` has the attribute ``unit``. Signals of one PDO share their ``t_s``. ``/markers`` has ``t_s`` and ``text``.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.recording.extras import library
from coulombus.recording.sample_groups import GRID, Group, Stretch

__all__ = ["Hdf5Writer"]

CHUNK = 1 << 14


class _Place(io.RawIOBase):
    """A file that stores its write error and hides it from HDF5.

    HDF5 reads back its own data without checks, and missing bytes of a full disk crash the process.
    After an error the data are therefore kept in memory; they are few, because `check` ends the
    export soon.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
        self._at = self._end = 0
        self._kept: list[tuple[int, bytes]] = []
        self.failure: OSError | None = None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the file position and return it."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._end}[whence]
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read back written data, from disk or memory."""
        view = memoryview(buffer).cast("B")
        view = view[: max(self._end - self._at, 0)]
        content = os.pread(self._fd, len(view), self._at)
        view[:] = content + bytes(len(view) - len(content))
        for at, data in self._kept:
            begin, end = max(at, self._at), min(at + len(data), self._at + len(view))
            if begin < end:
                view[begin - self._at : end - self._at] = data[begin - at : end - at]
        self._at += len(view)
        return len(view)

    def write(self, data: Any) -> int:
        """Write all of it."""
        rest = memoryview(data).cast("B")
        length = len(rest)
        try:
            while self.failure is None and rest:
                written = os.pwrite(self._fd, rest, self._at)
                self._at, rest = self._at + written, rest[written:]
        except OSError as error:
            self.failure = error
        if rest:
            self._kept.append((self._at, bytes(rest)))
            self._at += len(rest)
        self._end = max(self._end, self._at)
        return length

    def truncate(self, size: int | None = None) -> int:
        """Change the file's length."""
        self._end = self._at if size is None else size
        try:
            os.ftruncate(self._fd, self._end)
        except OSError as error:
            self.failure = self.failure or error
        return self._end

    def close(self) -> None:
        """Close the file."""
        if not self.closed:
            os.close(self._fd)
        super().close()

    def check(self) -> None:
        """Raise the stored error."""
        if self.failure is not None:
            raise self.failure


class Hdf5Writer:
    """Writes the rows of `groups`."""

    def __init__(self, path: Path, groups: tuple[Group, ...], about: Mapping[str, str]) -> None:
        h5py = library("h5py", "hdf5")
        self._h5py = h5py
        self._place = _Place(path)
        self._file = h5py.File(self._place, "w")
        self._file.attrs.update(dict(about))
        self._times, self._values = [], []
        self._markers: list[tuple[float, str]] = []
        for group in groups:
            children = [self._file.create_group(column.name) for column in group.columns]
            times = self._dataset(children[0], "t_s", "f8", "s")
            for child in children[1:]:
                child["t_s"] = times
            word = "f8" if len(groups) == 1 and group.name == GRID else "i8"
            self._times.append(times)
            self._values.append(
                [
                    self._dataset(child, "values", word if column.word else "f8", column.unit)
                    for child, column in zip(children, group.columns, strict=True)
                ]
            )

    @staticmethod
    def _dataset(group: Any, name: str, kind: str, unit: str) -> Any:
        dataset = group.create_dataset(name, (0,), kind, maxshape=(None,), chunks=(CHUNK,), compression=1, shuffle=True)
        dataset.attrs["unit"] = unit
        return dataset

    def add(self, stretch: Stretch) -> None:
        """Append a stretch."""
        self._markers += [(t_s, text) for _, t_s, text in stretch.markers]
        for times, values, rows in zip(self._times, self._values, stretch.rows, strict=True):
            for dataset, part in zip((times, *values), (rows.t_s, *rows.values), strict=True):
                end = dataset.shape[0]
                dataset.resize((end + len(part),))
                dataset[end:] = part
                self._place.check()

    def close(self) -> None:
        """Write the markers and the file's end."""
        group = self._file.create_group("markers")
        group["t_s"] = np.array([t_s for t_s, _ in self._markers], float)
        group.create_dataset("text", data=[text for _, text in self._markers], dtype=self._h5py.string_dtype())
        self._file.close()
        self._place.close()
        self._place.check()

    def abandon(self) -> None:
        """Abandon an incomplete file."""
        with suppress(OSError, RuntimeError, ValueError):
            self._file.close()
        self._place.close()
