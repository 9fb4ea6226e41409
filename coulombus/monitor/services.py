"""What a frame says that is no PDO: NMT, SYNC, EMCY, TIME, SDO, heartbeat, LSS (CiA 301, CiA 305).

Each decoder turns eight bytes into the keys of a row; a frame too short for its service says so
under "malformed". SDO block transfers are known by their first frames only.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any, TypeAlias

from coulombus.eds.cia301 import DATA_TYPES, NmtCommand, NmtState, abort_text, emcy_text
from coulombus.eds.cia305 import BIT_RATES, LssService, LssState
from coulombus.eds.reader import Description

__all__ = ["Row", "Sdo", "emcy", "heartbeat", "lss", "nmt", "sync"]

Row: TypeAlias = dict[str, Any]

COMMANDS = {command.value: command.name.lower().replace("_", " ") for command in NmtCommand}
COMMANDS[NmtCommand.ENTER_PRE_OPERATIONAL.value] = "enter pre-operational"
STATES = {state.value: state.name.lower().replace("_", "-") for state in NmtState} | {0: "boot-up"}


def nmt(data: bytes, node_name: Callable[[int], str]) -> Row:
    """NMT command: what, to whom (node id 0: to all)."""
    if len(data) != 2:
        return {"malformed": f"{len(data)} bytes, expected 2"}
    command = COMMANDS.get(data[0], f"unknown command {data[0]}")
    return {"node": node_name(data[1]) if data[1] else "all", "command": command}


def sync(data: bytes) -> Row:
    """SYNC, with its counter where there is one."""
    if len(data) > 1:
        return {"malformed": f"{len(data)} bytes, expected 0 or 1"}
    return {"counter": data[0]} if data else {}


def heartbeat(data: bytes) -> Row:
    """Heartbeat, boot-up message, or answer to node guarding (bit 7 toggles)."""
    if len(data) != 1:
        return {"malformed": f"{len(data)} bytes, expected 1"}
    return {"state": STATES.get(data[0] & 0x7F, f"unknown state {data[0] & 0x7F}")}


def emcy(data: bytes) -> Row:
    """Emergency: code with its text, error register 1001h, five manufacturer's bytes.

    A frame of another length is malformed; the fields that it has are decoded.
    """
    row: Row = {} if len(data) == 8 else {"malformed": f"{len(data)} bytes, expected 8"}
    if len(data) >= 2:
        code = int.from_bytes(data[:2], "little")
        row |= {"code": code, "text": emcy_text(code)}
    if len(data) >= 3:
        row |= {"register": data[2], "manufacturer": data[3:].hex()}
    return row


LSS_RESULTS = {
    LssService.CONFIGURE_NODE_ID: {1: "node id out of range"},
    LssService.CONFIGURE_BIT_TIMING: {1: "bit rate not supported"},
    LssService.STORE_CONFIGURATION: {1: "storing not supported", 2: "storage medium: access error"},
}
LSS_WORDS = (
    *(LssService.SWITCH_VENDOR, LssService.SWITCH_PRODUCT, LssService.SWITCH_REVISION, LssService.SWITCH_SERIAL),
    *(LssService.IDENTIFY_VENDOR, LssService.IDENTIFY_PRODUCT, LssService.IDENTIFY_REVISION_LOW),
    *(LssService.IDENTIFY_REVISION_HIGH, LssService.IDENTIFY_SERIAL_LOW, LssService.IDENTIFY_SERIAL_HIGH),
)
LSS_ANSWERED_WORDS = (
    *(LssService.INQUIRE_VENDOR, LssService.INQUIRE_PRODUCT, LssService.INQUIRE_REVISION, LssService.INQUIRE_SERIAL),
)


def lss(data: bytes, from_device: bool) -> Row:
    """LSS (CiA 305): the service and what it carries; of an answer, how it ended in words."""
    if len(data) != 8:
        return {"malformed": f"{len(data)} bytes, expected 8"}
    try:
        service = LssService(data[0])
    except ValueError:
        return {"command": f"unknown service {data[0]:#04x}"}
    row: Row = {"command": service.name.lower().replace("_", " ")}
    (word,) = struct.unpack_from("<I", data, 1)
    if from_device:
        if service in LSS_RESULTS:
            why = LSS_RESULTS[service].get(data[1], f"error {data[1]}, specific {data[2]}")
            return row | {"result": "ok" if data[1] == 0 else why}
        if service in LSS_ANSWERED_WORDS:
            return row | {"value": word}
        return row | ({"node_id": data[1]} if service == LssService.INQUIRE_NODE_ID else {})
    if service == LssService.SWITCH_STATE_GLOBAL:
        states = {state.value: state.name.lower() for state in LssState}
        return row | {"state": states.get(data[1], f"unknown state {data[1]}")}
    if service == LssService.CONFIGURE_NODE_ID:
        return row | {"node_id": data[1]}
    if service == LssService.CONFIGURE_BIT_TIMING:
        known = BIT_RATES.get(data[2]) if data[1] == 0 else None
        return row | ({"table": data[1], "entry": data[2]} if known is None else {"bitrate_bit_s": known})
    if service == LssService.ACTIVATE_BIT_TIMING:
        return row | {"delay_ms": struct.unpack_from("<H", data, 1)[0]}
    if service == LssService.FASTSCAN:
        return row | {"value": word, "bit": data[5], "sub": data[6], "next": data[7]}
    return row | ({"value": word} if service in LSS_WORDS else {})


class Sdo:
    """The SDO traffic of one server.

    It remembers which object the segments of a transfer belong to.

    Parameters
    ----------
    description
        The server's EDS file, for names and types; None where it is not known.
    """

    def __init__(self, description: Description | None) -> None:
        self._description = description
        self._object: tuple[int, int] | None = None

    def row(self, data: bytes, from_server: bool) -> Row:
        """Decode one frame from the server or to it (CiA 301, section 7.2.4.3)."""
        if len(data) != 8:
            return {"malformed": f"{len(data)} bytes, expected 8"}
        specifier = data[0] >> 5
        if specifier == 4:
            return {"sdo": "abort", **self._multiplexer(data), **_abort(data)}
        if specifier == (0 if from_server else 3):
            row: Row = {"sdo": "upload segment" if from_server else "upload segment request"}
        elif specifier == (1 if from_server else 0):
            row = {"sdo": "download segment response" if from_server else "download segment"}
        elif specifier in (2, 3) if from_server else specifier in (1, 2):
            upload = specifier == 2
            row = {"sdo": f"{'upload' if upload else 'download'} {'response' if from_server else 'request'}"}
            row |= self._multiplexer(data)
            if upload == from_server:
                row |= self._content(data)
            return row
        elif specifier in (5, 6):
            upload = specifier == (6 if from_server else 5)
            row = {"sdo": f"block {'upload' if upload else 'download'}"}
            initiates = data[0] & (3 if specifier == 5 else 1) == 0
            return row | (self._multiplexer(data) if initiates else {})
        else:
            return {"sdo": f"unknown command {data[0]:#04x}"}
        row |= self._known_object()
        if row["sdo"] in ("upload segment", "download segment"):
            size = 7 - (data[0] >> 1 & 7)
            row |= {"segment": data[1 : 1 + size].hex(), "last": bool(data[0] & 1)}
        return row

    def _multiplexer(self, data: bytes) -> Row:
        index, subindex = struct.unpack_from("<HB", data, 1)
        self._object = index, subindex
        return self._known_object()

    def _known_object(self) -> Row:
        if self._object is None:
            return {}
        index, subindex = self._object
        row: Row = {"index": index, "subindex": subindex}
        if self._description is not None and self._description.has(index, subindex):
            row["name"] = self._description.variable(index, subindex).name
        return row

    def _content(self, data: bytes) -> Row:
        sized = bool(data[0] & 1)
        if not data[0] & 2:  # segmented: the size stands where the data would
            return {"size": struct.unpack_from("<I", data, 4)[0]} if sized else {}
        raw = data[4 : 8 - (data[0] >> 2 & 3)] if sized else data[4:]
        return {"value": self._value(raw)}

    def _value(self, raw: bytes) -> int | float | str:
        kind, signed = "int", False
        if self._description is not None and self._object is not None and self._description.has(*self._object):
            data_type = DATA_TYPES.get(self._description.variable(*self._object).data_type)
            kind, signed = (data_type.kind, data_type.signed) if data_type else (kind, signed)
        if kind == "real" and len(raw) == 4:
            number: float = struct.unpack("<f", raw)[0]
            return number if math.isfinite(number) else str(number)  # JSON knows no infinity
        if kind == "text":
            return raw.rstrip(b"\0").decode("latin-1")
        return int.from_bytes(raw, "little", signed=signed and kind == "int")


def _abort(data: bytes) -> Row:
    code = struct.unpack_from("<I", data, 4)[0]
    return {"code": code, "text": abort_text(code)}
