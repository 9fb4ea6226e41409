"""MATLAB's files (version 5): a struct for each signal, with ``t_s``, ``values`` and ``unit``.

MATLAB's names cannot contain a dot: ``motor.position_rad`` becomes ``motor_position_rad``. A struct
is contiguous in the file, so the samples are spooled to disk until all are there.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from coulombus.recording.export.errors import ExportError
from coulombus.recording.sample_groups import Group, Stretch

__all__ = ["MatWriter"]

MOST_BYTES = 1 << 31


class MatWriter:
    """Writes the rows of `groups`."""

    def __init__(self, path: Path, groups: tuple[Group, ...], about: Mapping[str, str]) -> None:
        self._path, self._groups, self._about = path, groups, about
        self._spools: list[list[BinaryIO]] = [
            [tempfile.TemporaryFile(dir=path.parent) for _ in range(1 + len(group.columns))]  # noqa: SIM115
            for group in groups
        ]
        self._markers: list[tuple[float, str]] = []

    def add(self, stretch: Stretch) -> None:
        """Spool a stretch."""
        self._markers += [(t_s, text) for _, t_s, text in stretch.markers]
        for spools, rows in zip(self._spools, stretch.rows, strict=True):
            for spool, part in zip(spools, (rows.t_s, *rows.values), strict=True):
                spool.write(np.ascontiguousarray(part, np.float64).tobytes())

    def close(self) -> None:
        """Write the file, a signal at a time."""
        from scipy.io import savemat

        with self._path.open("wb") as file:
            for group, spools in zip(self._groups, self._spools, strict=True):
                t_s, *values = map(self._array, spools)
                for column, samples in zip(group.columns, values, strict=True):
                    structure = {"t_s": t_s, "values": samples, "unit": column.unit}
                    savemat(file, {column.name.replace(".", "_"): structure}, oned_as="column", long_field_names=True)
            times = np.array([t_s for t_s, _ in self._markers])
            texts = np.array([text for _, text in self._markers], object)
            rest = {"markers": {"t_s": times, "text": texts}, "about": dict(self._about)}
            savemat(file, rest, oned_as="column", long_field_names=True)
        self.abandon()

    def _array(self, spool: BinaryIO) -> Any:
        spool.flush()
        size = spool.seek(0, 2)
        if 2 * size >= MOST_BYTES:
            raise ExportError(
                f"{self._path}: a signal of {size} bytes is too long for a file of MATLAB 5; export to hdf5"
            )
        return np.memmap(spool, np.float64, "r") if size else np.zeros(0)

    def abandon(self) -> None:
        """Remove the spools."""
        for spools in self._spools:
            for spool in spools:
                with suppress(OSError):
                    spool.close()
