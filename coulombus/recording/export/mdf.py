"""ASAM MDF 4: a channel group for each PDO with the master channel ``t_s`` [s], or one group on a grid.

The channels have the signals' units.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.recording.extras import library
from coulombus.recording.sample_groups import Group, Stretch

__all__ = ["Mf4Writer"]


class Mf4Writer:
    """Writes the rows of `groups`."""

    def __init__(self, path: Path, groups: tuple[Group, ...], about: Mapping[str, str]) -> None:
        self._asammdf = library("asammdf", "mf4")
        self._path, self._groups = path, groups
        self._mdf = self._asammdf.MDF(version="4.10")
        start = about.get("start_utc")
        self._mdf.header.start_time = datetime.fromisoformat(start) if start else datetime.fromtimestamp(0, UTC)
        self._mdf.header.description = "; ".join(f"{key}: {text}" for key, text in about.items())
        self._began: set[int] = set()
        self._markers: list[tuple[float, str]] = []

    def add(self, stretch: Stretch) -> None:
        """Add a stretch to a temporary file."""
        self._markers += [(t_s, text) for _, t_s, text in stretch.markers]
        for number, (group, rows) in enumerate(zip(self._groups, stretch.rows, strict=True)):
            # of a file's groups, a signal's type is the same from its first sample on
            values = [v if v.dtype.kind == "f" else v.astype(np.int64) for v in rows.values]
            if number in self._began:
                if len(rows.order):
                    self._mdf.extend(number, [(rows.t_s, None), *((v, None) for v in values)])
                continue
            self._began.add(number)
            signals = [
                self._signal(column.name, column.unit, rows.t_s, v)
                for column, v in zip(group.columns, values, strict=True)
            ]
            self._mdf.append(signals, acq_name=group.name, comment=group.name, common_timebase=True)

    def _signal(self, name: str, unit: str, t_s: Any, values: Any, encoding: str | None = None) -> Any:
        signal = self._asammdf.Signal(samples=values, timestamps=t_s, name=name, unit=unit, encoding=encoding)
        signal.master_metadata = ("t_s", 1)
        return signal

    def close(self) -> None:
        """Write the file."""
        if self._markers:
            times = np.array([t_s for t_s, _ in self._markers])
            texts = np.array([text.encode() for _, text in self._markers])
            self._mdf.append(
                [self._signal("markers", "", times, texts, "utf-8")], acq_name="markers", common_timebase=True
            )
        self._mdf.save(self._path, overwrite=True)
        self._mdf.close()

    def abandon(self) -> None:
        """Remove the temporary file."""
        with suppress(Exception):
            self._mdf.close()
