"""Decode a recording row by row: each frame as a dict for ``coulombus decode --json``, or as a text line.

Every row has `t_s`, `can_id`, `node` (a name of the rig, a node id's number as text, or None) and
`pdo` ("TPDO1" or None). A PDO of the rig adds its signals by name in SI units; any other frame adds
`service`, `data` (hexadecimal) and the decoded service; a comment adds `marker`, a rig with several
buses `bus`. A marker that no frame follows is a separate row, whose `can_id` is None. `text_lines`
prints the PDOs of a block as whole columns, without a dict for each.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.eds.cia301 import PDO_NAMES, CobId
from coulombus.eds.sdo_channel import SdoChannel
from coulombus.eds.sdo_frames import where
from coulombus.kernels.records import Records
from coulombus.monitor.services import Row, emcy, heartbeat, lss, nmt, sync, time_stamp
from coulombus.recording.block import Block, Source
from coulombus.recording.bus_match import Channel
from coulombus.recording.captures import captures_of_bus
from coulombus.recording.file_content import Capture
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.maps.log_maps import LEARNED, LogMaps
from coulombus.recording.pdo_columns import PdoTable
from coulombus.rigs.signals import RigPdo
from coulombus.system.foreign_text import printable
from coulombus.wire.error_frames import error_frame
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, data_bytes

__all__ = ["BareDecoder", "Row", "as_json", "as_text", "bare_rows", "fitted", "rows", "text_lines"]

NODE_ID = 0x7F
FUNCTION = 0x780

COMMON = ("t_s", "can_id", "node", "pdo", "extended", "remote", "service", "data", "marker", "code")
HEXADECIMAL = {"register": "02X", "controlword": "04X", "statusword": "04X", "6040h:00": "04X", "6041h:00": "04X"}
WIDTH = 11
SDO_COLUMN = 57
TEXT_SHOWN = 64
"""Shown characters of an object's text; JSON has all of it."""
INDENT = 26
"""Column of continuation lines: under the node's name."""
MOST_KEPT = 4096
"""Texts of frames that are kept, because most services come again."""
BETWEEN_ITEMS = re.compile(r"(?<=\S)  (?=\w+=)")


def rows(recording: Source) -> Iterator[Row]:
    """Yield one dict for each frame, in the file's order.

    The PDOs of a block are decoded beforehand, as whole columns.
    """
    rig = recording.rig
    services = {channel: _Services(KnownBus(rig.on(channel))) for channel in rig.channels}
    for block in recording:
        yield from _block_rows(block, services)


def _block_rows(block: Block, services: Mapping[str, _Services]) -> Iterator[Row]:
    frames, channels = block.frames, block.capture.channels or ()
    first, of_source = _of_sources(block, services)
    table_of = np.full(len(frames), -1, np.int64)
    tables = [table for table in block.tables if not table.inside]
    for number, table in enumerate(tables):
        table_of[table.rows] = number
    pdos = [_pdo_rows(table) for table in tables]
    comments = _comments(block)
    columns = (block.t_s, frames["can_id"], frames["length"], frames["word"], frames["source"], table_of)
    for i, (t_s, can_id, length, word, source, number) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
        if number >= 0:
            row_of_frame: Row = {"t_s": t_s, "can_id": can_id}
            row_of_frame.update(next(pdos[number]))
        else:
            services_there = of_source[source] if of_source else first
            row_of_frame = services_there.row(t_s, can_id, length, word)
        if channels:
            row_of_frame["bus"] = channels[source]
        if i in comments:
            row_of_frame["marker"] = comments[i]
        yield row_of_frame
    yield from _late_rows(block.capture, block.epoch_ns)


def _late_rows(capture: Capture, epoch_ns: int) -> Iterator[Row]:
    """Yield a row for each marker that no frame follows."""
    for t_ns, text in capture.late:
        common: Row = {"t_s": (t_ns - epoch_ns) / 1e9, "can_id": None, "node": None, "pdo": None}
        yield common | {"service": "marker", "marker": text}


def _of_sources(block: Block, services: Mapping[str, _Services]) -> tuple[_Services, list[_Services]]:
    """Return the services of the first bus, and those of each source of a rig with several buses."""
    first, *_ = services.values()
    return first, [services.get(channel, first) for channel in block.capture.channels or ()]


def _comments(block: Block) -> dict[int, str]:
    """Return the comment of each row that has any, in one line."""
    comments: dict[int, str] = {}
    for row, text in block.capture.comments:
        text = text.replace("\n", "; ")
        comments[row] = f"{comments[row]}; {text}" if row in comments else text
    return comments


def _pdo_rows(table: PdoTable) -> Iterator[Iterator[tuple[str, Any]]]:
    """Yield the items of each frame of one PDO, from node on."""
    names = ("node", "pdo", *(signal.name for signal in table.pdo.signals))
    head = (table.pdo.node, table.pdo.name)
    for values in zip(*(column.tolist() for column in table.columns), strict=True):
        yield zip(names, head + values, strict=True)


def text_lines(recording: Source) -> Iterator[list[str]]:
    """Yield the `printable` lines of each block: `as_text` of each of its `rows`."""
    rig = recording.rig
    services = {channel: _Services(KnownBus(rig.on(channel))) for channel in rig.channels}
    texts: dict[tuple[int, int, int, int], str] = {}
    for block in recording:
        if len(block.frames):
            yield _block_lines(block, services, texts)
        if block.capture.late:
            yield [printable(as_text(row)) for row in _late_rows(block.capture, block.epoch_ns)]


def _block_lines(
    block: Block, services: Mapping[str, _Services], texts: dict[tuple[int, int, int, int], str]
) -> list[str]:
    frames, channels = block.frames, block.capture.channels or ()
    first, of_source = _of_sources(block, services)
    times = block.t_s
    lines: list[str] = [""] * len(frames)
    is_pdo = np.zeros(len(frames), bool)
    for table in block.tables:
        if table.inside or not len(table.rows):
            continue
        is_pdo[table.rows] = True
        row: Row = {"t_s": 0.0, "can_id": table.pdo.layout.cob_id, "node": table.pdo.node, "pdo": table.pdo.name}
        bus = f"  bus={channels[frames['source'][table.rows[0]]]}" if channels else ""
        template = printable(_row_template(row, table) + bus.replace("%", "%%")).rstrip()
        columns = (times[table.rows].tolist(), *(column.tolist() for column in table.columns))
        for i, values in zip(table.rows.tolist(), zip(*columns, strict=True), strict=True):
            lines[i] = template % values
    others = np.flatnonzero(~is_pdo)
    names = ("can_id", "length", "word", "source")
    keys = zip(*(frames[name][others].tolist() for name in names), strict=True)
    for i, t_s, key in zip(others.tolist(), times[others].tolist(), keys, strict=True):
        text = texts.get(key)
        if text is None:
            can_id, length, word, source = key
            row = (of_source[source] if of_source else first).row(t_s, can_id, length, word)
            if channels:
                row["bus"] = channels[source]
            text = printable(as_text(row))[len(_time_text(t_s)) :]
            if "phase" not in row and row.get("service") != "SDO":  # an SDO frame depends on those before it
                if len(texts) >= MOST_KEPT:
                    texts.clear()
                texts[key] = text
        lines[i] = _time_text(t_s) + text
    for i, text in _comments(block).items():
        lines[i] = printable(f"{lines[i]}  # {text}").rstrip()
    return lines


def _row_template(row: Row, table: PdoTable) -> str:
    """Return the ``%`` template of the lines of one PDO: its time, and its values."""
    items = []
    for signal, column in zip(table.pdo.signals, table.columns, strict=True):
        name = signal.name.rpartition(".")[2].replace("%", "%%")
        is_float = column.dtype.kind == "f"
        value = f"%+{WIDTH}.5f" if is_float else f"0x%{HEXADECIMAL[name]}" if name in HEXADECIMAL else "%d"
        items.append(f"{name}={value}")
    return "%14.6f" + _head(row)[len(_time_text(0.0)) :].replace("%", "%%") + " " + "  ".join(items)


def bare_rows(path: Path, channel: Channel, bus: KnownBus, remarks: list[str]) -> Iterator[Row]:
    """Yield one dict for each frame of a log without a rig, in the file's order; then add what was left out to `remarks`.

    Nodes are numbers. A PDO has its mapped objects by index where the log or an EDS file shows its
    map (`recording.maps.log_maps`); a map of CiA 402's defaults is called assumed.

    Raises
    ------
    coulombus.recording.bus_match.ChannelError
        The file has several buses, and `channel` names none of them.
    coulombus.recording.log_files.LogError
        It has no frame.
    """
    decoder, epoch_ns = BareDecoder(bus), None
    for capture in captures_of_bus(path, channel, remarks):
        comments = dict(capture.comments)
        epoch_ns = capture.origin_ns if epoch_ns is None else epoch_ns
        for i, row in enumerate(decoder.rows(capture.frames, epoch_ns or 0)):
            if i in comments:
                row["marker"] = comments[i].replace("\n", "; ")
            yield row
        yield from _late_rows(capture, epoch_ns or 0)


class BareDecoder:
    """Decodes frames without a rig, as they come: an SDO transfer and a PDO's map depend on those before."""

    def __init__(self, bus: KnownBus) -> None:
        self._services, self._maps, self._pdos = _Services(bus), LogMaps(bus.eds), dict[int, RigPdo]()

    def rows(self, frames: Records, epoch_ns: int = 0) -> Iterator[Row]:
        """Yield one dict for each frame; `epoch_ns` is the time 0 of `t_s`."""
        maps, pdos = self._maps, self._pdos
        for start in range(0, len(frames), LEARNED):
            part = frames[start : start + LEARNED]
            if maps.add_frames(part):
                pdos.clear()
            columns = ((part["t_ns"] - epoch_ns) / 1e9, part["can_id"], part["length"], part["word"])
            for t_s, can_id, length, word in zip(*(c.tolist() for c in columns), strict=True):
                row = self._services.row(t_s, can_id, length, word)
                pdo_map = maps.pdo(can_id)
                if pdo_map is not None:
                    row |= {"node": str(pdo_map.node), "pdo": pdo_map.name, "service": "pdo"}
                    if can_id not in pdos:
                        pdos[can_id] = maps.rig_pdo(pdo_map)
                    row |= _objects(pdos[can_id], word, length)
                    row |= {"map": "assumed"} if pdo_map.source == "assumed" else {}
                yield row


def _objects(pdo: RigPdo, word: int, length: int) -> Row:
    """Return the raw values of a frame's mapped objects."""
    values = {}
    for signal, entry, start in pdo.fields():
        if start + entry.bits <= 8 * length:
            values[signal.name.rpartition(".")[2]] = entry.number(word, start)
    return values


class _Services:
    """Decodes frames other than the rig's PDOs; without a rig, every frame, with the names of EDS files."""

    def __init__(self, bus: KnownBus) -> None:
        nodes = () if bus.rig is None else bus.rig.nodes
        self._names = bus.names
        self._descriptions = {node.node_id: node.description for node in nodes} | bus.eds.of_nodes
        self._emergencies = {node.emcy_id: node.name for node in nodes}
        self._pdos = {pdo.layout.cob_id: pdo for pdo in (() if bus.rig is None else bus.pdos)}
        self._servers: dict[int, SdoChannel] = {}

    def row(self, t_s: float, can_id: int, length: int, word: int) -> Row:
        """Return the row of one frame."""
        data = b"" if can_id & CAN_RTR_FLAG else data_bytes(word, length)
        row: Row = {"t_s": t_s, "can_id": can_id & 0x1FFFFFFF, "node": None, "pdo": None}
        if can_id & CAN_ERR_FLAG:
            return row | {"service": "error", "data": data.hex(), **error_frame(can_id, data)}
        if can_id & CAN_EFF_FLAG:
            row |= {"extended": True, "service": "unknown", "data": data.hex()}
        else:
            row |= self._base(can_id & 0x7FF, data, remote=bool(can_id & CAN_RTR_FLAG))
        if can_id & CAN_RTR_FLAG:
            row |= {"remote": True, "length": length}
        return row

    def _name(self, node_id: int) -> str:
        return self._names.get(node_id, str(node_id))

    def _base(self, can_id: int, data: bytes, remote: bool) -> Row:
        """Return the service of an 11-bit identifier; a remote frame has no content."""
        function, node_id = can_id & FUNCTION, can_id & NODE_ID
        row: Row = {"service": "unknown", "data": data.hex()}
        if can_id in self._pdos:
            pdo = self._pdos[can_id]
            row |= {"node": pdo.node, "pdo": pdo.name, "service": "pdo"}
            malformed = {"malformed": f"{len(data)} bytes, expected {pdo.layout.length}"}
            return row if remote else row | malformed
        decoder: Callable[[bytes], Row] | None = None
        if can_id == CobId.NMT:
            row["service"], decoder = "nmt", lambda content: nmt(content, self._name)
        elif can_id == CobId.SYNC:
            row["service"], decoder = "sync", sync
        elif can_id == CobId.TIME:
            row["service"], decoder = "time", time_stamp
        elif can_id in (CobId.LSS_TX, CobId.LSS_RX):
            row["service"], decoder = "lss", lambda content: lss(content, can_id == CobId.LSS_TX)
        elif can_id in self._emergencies:
            row |= {"service": "emcy", "node": self._emergencies[can_id]}
            decoder = emcy
        elif node_id:
            row["node"] = self._name(node_id)
            if function == CobId.EMCY:
                row["service"], decoder = "emcy", emcy
            elif function == CobId.HEARTBEAT:
                row["service"], decoder = "heartbeat", heartbeat
            elif function in (CobId.SDO_TX, CobId.SDO_RX):
                row["service"], decoder = "SDO", lambda content: self._sdo(node_id, content, function == CobId.SDO_TX)
            elif function in PDO_NAMES:
                row |= {"service": "pdo", "pdo": PDO_NAMES[function]}
            else:
                row["node"] = None
        return row if remote or decoder is None else row | decoder(data)

    def _sdo(self, node_id: int, data: bytes, from_server: bool) -> Row:
        if node_id not in self._servers:
            self._servers[node_id] = SdoChannel(self._descriptions.get(node_id))
        return self._servers[node_id].row(data, from_server)


def as_json(row: Row) -> str:
    """Return a row as one line of JSON; NaN and infinity of a REAL object as text, because JSON lacks them."""
    try:
        return json.dumps(row, allow_nan=False)
    except ValueError:
        numbers = {key: value for key, value in row.items() if isinstance(value, float) and not math.isfinite(value)}
        return json.dumps(row | {key: repr(value) for key, value in numbers.items()})


def as_text(row: Row) -> str:
    """Return a row as one line, columns aligned: time [s], identifier, node, PDO or service,
    content, marker.

    ::

            1.004321  181  motor  TPDO1      statusword=0x0237      position_rad=   +0.12345  torque_Nm=   -0.00173
    """
    line = _head(row)
    if row.get("remote"):
        line += f" remote request, {row['length']} bytes"
    elif row.get("service") == "error":
        line += " " + row["text"]
    elif "phase" in row:
        line = f"{line:<{SDO_COLUMN}} {_sdo_text(row)}"
    else:
        content = [_item(key, value) for key, value in row.items() if key not in COMMON]
        if row.get("data") and (not content or "malformed" in row):
            content.append(row["data"])
        line += " " + "  ".join(content)
    if "marker" in row:
        line = f"{line.rstrip()}  # {row['marker']}"
    return line.rstrip()


def _time_text(t_s: float) -> str:
    return f"{t_s:14.6f}"


def _head(row: Row) -> str:
    """Return the columns before the content."""
    number = row["can_id"]
    can_id = "-" if number is None else f"{number:08X}" if row.get("extended") else f"{number:03X}"
    what = row["pdo"] or row["service"]
    return f"{_time_text(row['t_s'])}  {can_id:>8}  {row['node'] or '-':<6} {what:<10}"


def fitted(line: str, width: int) -> str:
    """Return a line of `as_text` wrapped between its items at `width`; a longer item is not broken."""
    first, *items = BETWEEN_ITEMS.split(line)
    lines = [first]
    for item in items:
        if len(lines[-1]) + 2 + len(item) <= width:
            lines[-1] += "  " + item
        else:
            lines.append(" " * INDENT + item)
    return "\n".join(
        textwrap.fill(line, width, subsequent_indent=" " * INDENT, break_long_words=False, break_on_hyphens=False)
        if len(line) > width > 2 * INDENT
        else line
        for line in lines
    )


def _item(key: str, value: Any) -> str:
    name = key.rpartition(".")[2]
    if name == "text":
        return str(value)
    if isinstance(value, float):
        return f"{name}={value:+{WIDTH}.5f}"
    if name in HEXADECIMAL:
        return f"{name}=0x{value:{HEXADECIMAL[name]}}"
    return f"{name}={value}"


def _sdo_text(row: Row) -> str:
    line = f"{row['phase']:<32}"
    if "index" in row:
        line += f" {where(row['index'], row['subindex'])}"
    if "name" in row:
        line += f" {row['name']}"
    if "value" in row:
        value = row["value"]
        text = str(value) if len(str(value)) <= TEXT_SHOWN else str(value)[:TEXT_SHOWN] + "..."
        line += f" = {text}" + (f" (0x{value:X})" if isinstance(value, int) and value > 9 else "")
    if "number" in row:
        line += f" {'up to ' if 'segment' not in row else ''}segment {row['number']}"
    if "segment" in row:
        line += f" {row['segment']}" + (" (last)" if row["last"] else "")
    if "size" in row:
        line += f" ({row['size']} bytes follow)" if "bytes" not in row else ""
    if "bytes" in row:
        line += f" ({row['bytes']} bytes" + (", complete)" if "content" in row else " so far)")
    if "text" in row:
        line += f" {row['text']}"
    return f"{line.rstrip()}: {row['remark']}" if "remark" in row else line
