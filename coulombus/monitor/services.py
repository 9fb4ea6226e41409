"""Decode services other than PDO and SDO: NMT, SYNC, TIME, EMCY, heartbeat, LSS (CiA 301, CiA 305).

Each decoder turns eight bytes into the keys of a row; a frame too short for its service has the key
"malformed". SDO is stateful: see `eds.sdo_channel`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any, TypeAlias

from coulombus.eds.cia301 import NmtCommand, NmtState, emcy_text
from coulombus.eds.cia305 import BIT_RATES, LSS_RESULTS, LssService, LssState, lss_result

__all__ = ["Row", "emcy", "heartbeat", "lss", "nmt", "sync", "time_stamp"]

Row: TypeAlias = dict[str, Any]

TIME_ORIGIN = datetime(1984, 1, 1)  # TIME has no time zone
COMMANDS = {command.value: command.name.lower().replace("_", " ") for command in NmtCommand}
COMMANDS[NmtCommand.ENTER_PRE_OPERATIONAL.value] = "enter pre-operational"
STATES = {state.value: state.name.lower().replace("_", "-") for state in NmtState} | {0: "boot-up"}


def nmt(data: bytes, node_name: Callable[[int], str]) -> Row:
    """NMT command and its node (node id 0: all)."""
    if len(data) != 2:
        return {"malformed": f"{len(data)} bytes, expected 2"}
    command = COMMANDS.get(data[0], f"unknown command {data[0]}")
    return {"node": node_name(data[1]) if data[1] else "all", "command": command}


def sync(data: bytes) -> Row:
    """SYNC, with its counter if any."""
    if len(data) > 1:
        return {"malformed": f"{len(data)} bytes, expected 0 or 1"}
    return {"counter": data[0]} if data else {}


def time_stamp(data: bytes) -> Row:
    """TIME: milliseconds since midnight (28 bits), and days since 1984-01-01 (CiA 301, 7.1.6.6)."""
    if len(data) != 6:
        return {"malformed": f"{len(data)} bytes, expected 6"}
    ms, days = int.from_bytes(data[:4], "little") & 0x0FFFFFFF, int.from_bytes(data[4:], "little")
    when = TIME_ORIGIN + timedelta(days=days, milliseconds=ms)
    return {"time": when.isoformat(timespec="milliseconds")}


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


LSS_WORDS = (
    *(LssService.SWITCH_VENDOR, LssService.SWITCH_PRODUCT, LssService.SWITCH_REVISION, LssService.SWITCH_SERIAL),
    *(LssService.IDENTIFY_VENDOR, LssService.IDENTIFY_PRODUCT, LssService.IDENTIFY_REVISION_LOW),
    *(LssService.IDENTIFY_REVISION_HIGH, LssService.IDENTIFY_SERIAL_LOW, LssService.IDENTIFY_SERIAL_HIGH),
)
LSS_ANSWERED_WORDS = (
    *(LssService.INQUIRE_VENDOR, LssService.INQUIRE_PRODUCT, LssService.INQUIRE_REVISION, LssService.INQUIRE_SERIAL),
)


def lss(data: bytes, from_device: bool) -> Row:
    """LSS (CiA 305): the service and its content; for a response, its result as text."""
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
            return row | {"result": lss_result(service, data[1], data[2])}
        if service in LSS_ANSWERED_WORDS:
            return row | {"value": word}
        return row | ({"node_id": data[1]} if service == LssService.INQUIRE_NODE_ID else {})
    if service == LssService.SWITCH_STATE_GLOBAL:
        states = {state.value: state.name.lower() for state in LssState}
        return row | {"state": states.get(data[1], f"unknown state {data[1]}")}
    if service == LssService.CONFIGURE_NODE_ID:
        return row | {"node_id": data[1]}
    if service == LssService.CONFIGURE_BIT_TIMING:
        bitrate_bit_s = BIT_RATES.get(data[2]) if data[1] == 0 else None
        return row | (
            {"table": data[1], "entry": data[2]} if bitrate_bit_s is None else {"bitrate_bit_s": bitrate_bit_s}
        )
    if service == LssService.ACTIVATE_BIT_TIMING:
        return row | {"delay_ms": struct.unpack_from("<H", data, 1)[0]}
    if service == LssService.FASTSCAN:
        return row | {"value": word, "bit": data[5], "sub": data[6], "next": data[7]}
    return row | ({"value": word} if service in LSS_WORDS else {})
