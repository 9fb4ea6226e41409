"""Comma-separated values: a row for each frame of a PDO, or for each instant of a grid.

Comment lines begin with ``#``: the recording's description, the signals' units, and the markers,
each before the row that it marks. Numbers have enough digits to round-trip.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.recording.export.text_rows import TextRows, texts_of, times_of
from coulombus.recording.sample_groups import Array, Column, Group, Stretch

__all__ = ["CsvWriter"]

ABSENT = {"nan": ""}


class CsvWriter:
    """Writes the rows of `groups`; `about` goes into the comments."""

    def __init__(self, path: Path, groups: tuple[Group, ...], about: Mapping[str, str]) -> None:
        self._file = path.open("wb")
        self._groups = groups
        columns = [column for group in groups for column in group.columns]
        self._templates = [_template(group, columns) for group in groups]
        head = [f"# {key}: {text}" for key, text in about.items()]
        head += [f"# unit of {column.name}: {column.unit or '1, a word of bits'}" for column in columns]
        lines = [*head, ",".join(["t_s", *(column.name for column in columns)]), ""]
        self._file.write("\n".join(lines).encode())

    def add(self, stretch: Stretch) -> None:
        """Write a stretch."""
        lines = TextRows()
        places: list[Array] = [rows.order for rows in stretch.rows]
        for group, template, rows in zip(self._groups, self._templates, stretch.rows, strict=True):
            values = [texts_of(v, c.word, ABSENT) for c, v in zip(group.columns, rows.values, strict=True)]
            lines.add(template, [times_of(rows.t_ns), *values])
        if stretch.markers:
            remarks = [f"# {t_s!r} {text}\n" for _, t_s, text in stretch.markers]
            lines.add("%s", [(remarks, np.arange(len(remarks)))])
            places.append(np.array([row for row, _, _ in stretch.markers]) - 0.5)
        self._file.write(lines.joined(np.concatenate(places))[0])

    def close(self) -> None:
        """Close the complete file."""
        self._file.close()

    def abandon(self) -> None:
        """Abandon an incomplete file."""
        _close_anyhow(self._file)


def _close_anyhow(file: Any) -> None:
    """Close a file even if the disk is full."""
    with suppress(OSError):
        file.close()


def _template(group: Group, columns: list[Column]) -> str:
    return ",".join(["%s", *("%s" if column in group.columns else "" for column in columns)]) + "\n"
