"""MCAP, as Foxglove and PlotJuggler read it: a channel for each PDO, with JSON messages.

A message nests by the dots of the signals' names, so a path such as
``/motor/TPDO1.motor.position_rad`` has the name as `read` has it. Units are in the channel's JSON
schema and metadata. Markers have a channel of their own, ``/markers``.

This module writes the container in whole chunks, because the library ``mcap`` writes single
messages and is too slow. Specification: https://mcap.dev/spec.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from zstandard import ZstdCompressor

from coulombus.recording.export.errors import ExportError
from coulombus.recording.export.text_rows import TextRows, texts_of
from coulombus.recording.sample_groups import Array, Column, Group, Stretch

__all__ = ["McapWriter"]

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
JSON_TEXTS = {"nan": "null", "inf": "1e999", "-inf": "-1e999"}
"""JSON has no word for these numbers; every reader takes a number beyond its range for infinite."""
MESSAGE_HEAD = np.dtype(
    {
        "names": ["op", "length", "channel", "sequence", "log", "publish"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": 31,
    }
)


def _record(op: int, content: bytes) -> bytes:
    return struct.pack("<BQ", op, len(content)) + content


def _text(text: str | bytes) -> bytes:
    data = text.encode() if isinstance(text, str) else text
    return struct.pack("<I", len(data)) + data


def _map(pairs: Mapping[str, str]) -> bytes:
    return _text(b"".join(_text(key) + _text(value) for key, value in pairs.items()))


def _nested(columns: Iterable[Column], leaf: Any) -> dict[str, Any]:
    """Return ``{"motor": {"position_rad": leaf(column)}}``."""
    tree: dict[str, Any] = {}
    for column in columns:
        *path, last = column.name.split(".")
        place = tree
        for part in path:
            place = place.setdefault(part, {})
        place[last] = leaf(column)
    return tree


def _schema(tree: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON schema of a tree whose leaves are columns."""
    properties = {
        key: _schema(value)
        if isinstance(value, dict)
        else {"type": "integer" if value.word else "number", "description": f"[{value.unit or '1'}]"}
        for key, value in tree.items()
    }
    return {"type": "object", "properties": properties}


class McapWriter:
    """Writes the rows of `groups`."""

    def __init__(self, path: Path, groups: tuple[Group, ...], about: Mapping[str, str]) -> None:
        self._compress = ZstdCompressor().compress
        self._groups = groups
        self._base_ns = int(about.get("start_ns", 0))
        self._file = path.open("wb")
        self._at, self._count = 0, [0] * (len(groups) + 1)
        self._first: int | None = None
        self._last = 0
        self._chunks: list[bytes] = []
        self._templates, self._heads = [], []
        for number, group in enumerate(groups, 1):
            places: dict[str, Any] = _nested(group.columns, lambda column: "%s")
            self._templates.append(json.dumps(places).replace('"%s"', "%s"))
            schema = json.dumps(_schema(_nested(group.columns, lambda column: column)))
            units = {column.name: column.unit for column in group.columns}
            self._heads += _channel(number, group.name, f"/{group.name.replace('.', '/')}", schema, units)
        text = {"type": "object", "properties": {"text": {"type": "string"}}}
        self._heads += _channel(len(groups) + 1, "markers", "/markers", json.dumps(text), {})
        self._about = _record(METADATA, _text("recording") + _map(about))
        self._write(MAGIC + _record(HEADER, _text("") + _text("coulombus")) + b"".join(self._heads))
        self._about_at = self._at
        self._write(self._about)

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._at += len(data)

    def add(self, stretch: Stretch) -> None:
        """Write a stretch as one chunk."""
        messages = TextRows()
        places: list[Array] = [rows.order for rows in stretch.rows]
        heads: list[Array] = []
        for number, (group, template, rows) in enumerate(
            zip(self._groups, self._templates, stretch.rows, strict=True), 1
        ):
            texts = [texts_of(v, c.word, JSON_TEXTS) for c, v in zip(group.columns, rows.values, strict=True)]
            sizes = messages.add(template, texts)
            heads.append(self._head(number, rows.t_ns, sizes))
            messages.put_before(heads[-1])
        if stretch.markers:
            texts_ = [json.dumps({"text": text}) for _, _, text in stretch.markers]
            sizes = messages.add("%s", [(texts_, np.arange(len(texts_)))])
            stamps = np.array([round(t_s * 1e9) for _, t_s, _ in stretch.markers], np.int64)
            heads.append(self._head(len(self._groups) + 1, stamps, sizes))
            messages.put_before(heads[-1])
            places.append(np.array([row for row, _, _ in stretch.markers]) - 0.5)
        if sum(map(len, places)):
            self._chunk(np.concatenate(heads), *messages.joined(np.concatenate(places)))

    def _head(self, channel: int, t_ns: Any, sizes: Any) -> Any:
        head = np.zeros(len(t_ns), MESSAGE_HEAD)
        head["op"], head["channel"] = MESSAGE, channel
        head["length"] = sizes + MESSAGE_HEAD.itemsize - 9
        head["sequence"] = np.arange(self._count[channel - 1], self._count[channel - 1] + len(t_ns)) & 0xFFFFFFFF
        log_ns = t_ns + self._base_ns
        if len(log_ns) and log_ns.min() < 0:
            text = "begin the file with its earliest frame: reordercap IN OUT"
            raise ExportError(
                f"a frame is {-int(log_ns.min()) / 1e9:g} s before the first one, and mcap has no time below 0; {text}"
            )
        head["log"] = head["publish"] = log_ns
        self._count[channel - 1] += len(t_ns)
        return head

    def _chunk(self, heads: Any, content: bytes, order: Any, begins: Any) -> None:
        """Write messages in order, then the message index of each channel."""
        heads, offsets = heads.take(order), begins[order]
        begin, end = int(heads["log"].min()), int(heads["log"].max())
        packed = self._compress(content)
        chunk_at = self._at
        head = struct.pack("<QQQI", begin, end, len(content), 0) + _text("zstd") + struct.pack("<Q", len(packed))
        self._write(_record(CHUNK, head + packed))
        length, index_at, places_of = self._at - chunk_at, self._at, b""
        for channel in np.unique(heads["channel"]).tolist():
            of_channel = heads["channel"] == channel
            entries = np.stack((heads["log"][of_channel], offsets[of_channel].astype(np.uint64)), 1).astype("<u8")
            places_of += struct.pack("<HQ", channel, self._at)
            self._write(_record(INDEX, struct.pack("<H", channel) + _text(entries.tobytes())))
        index = struct.pack("<QQQQ", begin, end, chunk_at, length) + _text(places_of)
        index += struct.pack("<Q", self._at - index_at) + _text("zstd")
        self._chunks.append(_record(CHUNK_INDEX, index + struct.pack("<QQ", len(packed), len(content))))
        self._first = begin if self._first is None else min(begin, self._first)
        self._last = max(end, self._last)

    def close(self) -> None:
        """Write the summary and the file's end."""
        self._write(_record(DATA_END, struct.pack("<I", 0)))
        at = self._at
        counts = {number: n for number, n in enumerate(self._count, 1) if n}
        statistics = struct.pack("<QHIIII", sum(self._count), *[len(self._count)] * 2, 0, 1, len(self._chunks))
        statistics += struct.pack("<QQ", self._first or 0, self._last)
        statistics += _text(b"".join(struct.pack("<HQ", number, n) for number, n in counts.items()))
        parts = {
            SCHEMA: [head for head in self._heads if head[0] == SCHEMA],
            CHANNEL: [head for head in self._heads if head[0] == CHANNEL],
            STATISTICS: [_record(STATISTICS, statistics)],
            CHUNK_INDEX: self._chunks,
            METADATA_INDEX: [
                _record(METADATA_INDEX, struct.pack("<QQ", self._about_at, len(self._about)) + _text("recording"))
            ],
        }
        offsets = b""
        for op, records in parts.items():
            begin = self._at
            self._write(b"".join(records))
            offsets += _record(SUMMARY_OFFSET, struct.pack("<BQQ", op, begin, self._at - begin))
        offset_at = self._at
        self._write(offsets + _record(FOOTER, struct.pack("<QQI", at, offset_at, 0)) + MAGIC)
        self._file.close()

    def abandon(self) -> None:
        """Abandon an incomplete file."""
        with suppress(OSError):
            self._file.close()


def _channel(number: int, name: str, topic: str, schema: str, metadata: Mapping[str, str]) -> list[bytes]:
    schema_record = struct.pack("<H", number) + _text(name) + _text("jsonschema") + _text(schema)
    channel = struct.pack("<HH", number, number) + _text(topic) + _text("json") + _map(metadata)
    return [_record(SCHEMA, schema_record), _record(CHANNEL, channel)]
