"""Parquet: a table as `text_table` has it, with empty cells as nulls.

Units are metadata of the columns (``unit``); markers and the recording's description are metadata of the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.recording.extras import library
from coulombus.recording.sample_groups import Group, Stretch

__all__ = ["ParquetWriter"]

ROW_GROUP = 1 << 18


class ParquetWriter:
    """Writes the rows of `groups`."""

    def __init__(self, path: Path, groups: tuple[Group, ...], about: Mapping[str, str]) -> None:
        self._pa, parquet = library("pyarrow", "parquet"), library("pyarrow.parquet", "parquet")
        pa = self._pa
        self._groups = groups
        fields = [pa.field("t_s", pa.float64(), nullable=False, metadata={"unit": "s"})]
        fields += [
            pa.field(c.name, pa.int64() if c.word else pa.float64(), metadata={"unit": c.unit})
            for group in groups
            for c in group.columns
        ]
        self._schema = pa.schema(fields, metadata=dict(about))
        self._file = path.open("wb")
        self._writer = parquet.ParquetWriter(self._file, self._schema, compression="zstd")
        self._markers: list[tuple[float, str]] = []
        self._waiting: list[Any] = []

    def add(self, stretch: Stretch) -> None:
        """Add a stretch, and write a row group when there are enough rows."""
        pa = self._pa
        self._markers += [(t_s, text) for _, t_s, text in stretch.markers]
        places = np.concatenate([rows.order for rows in stretch.rows])
        order = np.argsort(places, kind="stable")
        columns = [pa.array(np.concatenate([rows.t_s for rows in stretch.rows])[order])]
        begin = 0
        for group, rows in zip(self._groups, stretch.rows, strict=True):
            indices = np.full(len(order), -1)
            indices[begin : begin + len(rows.order)] = np.arange(len(rows.order))
            indices, begin = indices[order], begin + len(rows.order)
            for column, values in zip(group.columns, rows.values, strict=True):
                padded = np.append(values, values.dtype.type(0))[indices]
                absent = (indices < 0) | np.isnan(padded) if padded.dtype.kind == "f" else indices < 0
                if column.word:
                    padded = np.where(absent, 0, padded).astype(np.int64)
                columns.append(pa.array(padded, mask=absent))
        self._waiting.append(pa.table(columns, schema=self._schema))
        if sum(table.num_rows for table in self._waiting) >= ROW_GROUP:
            self._flush()

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, []
        self._writer.write_table(self._pa.concat_tables(waiting), row_group_size=ROW_GROUP)

    def close(self) -> None:
        """Write the rest, the markers and the file's end."""
        if self._waiting:
            self._flush()
        self._writer.add_key_value_metadata({"markers": json.dumps(self._markers)})
        self._writer.close()
        self._file.close()

    def abandon(self) -> None:
        """Abandon an incomplete file."""
        for thing in (self._writer, self._file):
            with suppress(OSError, self._pa.ArrowException):
                thing.close()
