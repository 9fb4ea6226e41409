"""Tables of CiA 301 (application layer): data types, NMT, SDO abort codes, EMCY codes, default identifiers.

The device, the host and the tools share them. Section numbers are those of CiA 301 version 4.2.0.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

__all__ = [
    "ABORT_TEXT",
    "ARRAY",
    "DATA_TYPES",
    "DEFSTRUCT",
    "DEFTYPE",
    "DOMAIN",
    "DUMMY_TYPES",
    "EMCY_TEXT",
    "MAX_FIELDS",
    "PDO_NAMES",
    "RECORD",
    "TPDOS",
    "VAR",
    "Abort",
    "CobId",
    "DataType",
    "Emcy",
    "NmtCommand",
    "NmtState",
    "abort_text",
    "emcy_text",
    "predefined",
    "restricted",
]

Kind = Literal["bool", "int", "real", "text", "bytes", "unicode", "time", "domain", "record"]

DOMAIN, DEFTYPE, DEFSTRUCT, VAR, ARRAY, RECORD = 0x02, 0x05, 0x06, 0x07, 0x08, 0x09
"""Object codes, table 42; DEFTYPE and DEFSTRUCT describe types, not data."""


@dataclass(frozen=True)
class DataType:
    """A row of CiA 301 table 44; `bits` is 0 if the length is not fixed."""

    code: int
    name: str
    bits: int
    signed: bool
    kind: Kind


def _types() -> dict[int, DataType]:
    rows: list[tuple[int, str, int, bool, Kind]] = [
        (0x0001, "BOOLEAN", 1, False, "bool"),
        (0x0008, "REAL32", 32, True, "real"),
        (0x0009, "VISIBLE_STRING", 0, False, "text"),
        (0x000A, "OCTET_STRING", 0, False, "bytes"),
        (0x000B, "UNICODE_STRING", 0, False, "unicode"),
        (0x000C, "TIME_OF_DAY", 48, False, "time"),
        (0x000D, "TIME_DIFFERENCE", 48, False, "time"),
        (0x000F, "DOMAIN", 0, False, "domain"),
        (0x0011, "REAL64", 64, True, "real"),
        (0x0020, "PDO_COMMUNICATION_PARAMETER", 0, False, "record"),
        (0x0021, "PDO_MAPPING", 0, False, "record"),
        (0x0022, "SDO_PARAMETER", 0, False, "record"),
        (0x0023, "IDENTITY", 0, False, "record"),
        (0x0024, "OS_DEBUG", 0, False, "record"),
        (0x0025, "OS_COMMAND", 0, False, "record"),
    ]
    integers = {8: 0x0002, 16: 0x0003, 32: 0x0004, 24: 0x0010, 40: 0x0012, 48: 0x0013, 56: 0x0014, 64: 0x0015}
    unsigned = {8: 0x0005, 16: 0x0006, 32: 0x0007, 24: 0x0016, 40: 0x0018, 48: 0x0019, 56: 0x001A, 64: 0x001B}
    rows += [(code, f"INTEGER{bits}", bits, True, "int") for bits, code in integers.items()]
    rows += [(code, f"UNSIGNED{bits}", bits, False, "int") for bits, code in unsigned.items()]
    return {row[0]: DataType(*row) for row in sorted(rows)}


DATA_TYPES = _types()
"""Data types by code."""

MAX_FIELDS = 64
"""Largest number of fields in a PDO: 64 bits (section 7.5.2.36)."""

DUMMY_TYPES = range(0x0001, 0x0008)
"""Static data types that may be mapped into an RPDO as a gap (section 7.4.8.1, and [DummyUsage] of
CiA 306).
"""


class NmtState(IntEnum):
    """NMT states, with the values that a heartbeat carries (section 7.2.8.3.2.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifiers of an NMT frame (section 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class CobId(IntEnum):
    """Function codes of the pre-defined connection set (section 7.3.5); from EMCY on the node id is
    added.
    """

    NMT = 0x000
    SYNC = 0x080
    TIME = 0x100
    EMCY = 0x080  # an alias of SYNC: the node id distinguishes them
    TPDO1 = 0x180
    RPDO1 = 0x200
    TPDO2 = 0x280
    RPDO2 = 0x300
    TPDO3 = 0x380
    RPDO3 = 0x400
    TPDO4 = 0x480
    RPDO4 = 0x500
    SDO_TX = 0x580
    SDO_RX = 0x600
    HEARTBEAT = 0x700
    LSS_TX = 0x7E4
    LSS_RX = 0x7E5


PDO_NAMES = {int(code): code.name for code in CobId if code.name.startswith(("TPDO", "RPDO"))}
"""Names of the PDOs of the pre-defined connection set by their function codes."""
TPDOS = tuple(code for code, name in PDO_NAMES.items() if name.startswith("TPDO"))
"""Function codes of those that a node sends."""

_RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def restricted(can_id: int) -> bool:
    """Tell whether an identifier is reserved and cannot be configured (table 41)."""
    return any(first <= can_id <= last for first, last in _RESTRICTED)


_PREDEFINED_PDOS = 4
_INVALID = 1 << 31


def predefined(index: int, subindex: int, node_id: int) -> int | None:
    """Return CiA 301's default for a communication object of the node; None if the device chooses it.

    Identifiers are those of the pre-defined connection set (section 7.3.5), with four PDOs of each
    direction; further PDOs are not valid. A PDO's transmission type is 255. By the default of 1F80h
    (CiA 302-2) an NMT master starts the device, as if 1F80h were absent.
    """
    fixed = {
        (0x1F80, 0): 0x04,
        (0x1005, 0): CobId.SYNC,
        (0x1012, 0): CobId.TIME,
        (0x1014, 0): CobId.EMCY + node_id,
        (0x1200, 1): CobId.SDO_RX + node_id,
        (0x1200, 2): CobId.SDO_TX + node_id,
    }
    for first, identifier in ((0x1400, CobId.RPDO1), (0x1800, CobId.TPDO1)):
        if 0 <= index - first < 0x200 and subindex == 1:
            is_predefined = index - first < _PREDEFINED_PDOS
            return identifier + 0x100 * (index - first) + node_id if is_predefined else _INVALID
        if 0 <= index - first < 0x200 and subindex == 2:
            return 255
    return fixed.get((index, subindex))


class Abort(IntEnum):
    """SDO abort codes (table 22)."""

    TOGGLE = 0x05030000
    TIMEOUT = 0x05040000
    COMMAND = 0x05040001
    BLOCK_SIZE = 0x05040002
    SEQUENCE = 0x05040003
    CRC = 0x05040004
    MEMORY = 0x05040005
    ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    PARAMETER_INCOMPATIBLE = 0x06040043
    INTERNAL_INCOMPATIBLE = 0x06040047
    HARDWARE = 0x06060000
    LENGTH = 0x06070010
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    VALUE = 0x06090030
    VALUE_HIGH = 0x06090031
    VALUE_LOW = 0x06090032
    MAX_BELOW_MIN = 0x06090036
    NO_RESOURCE = 0x060A0023
    GENERAL = 0x08000000
    CANNOT_STORE = 0x08000020
    LOCAL_CONTROL = 0x08000021
    DEVICE_STATE = 0x08000022
    NO_DICTIONARY = 0x08000023
    NO_DATA = 0x08000024


ABORT_TEXT: dict[int, str] = {
    Abort.TOGGLE: "toggle bit not alternated",
    Abort.TIMEOUT: "SDO protocol timed out",
    Abort.COMMAND: "client/server command specifier not valid or unknown",
    Abort.BLOCK_SIZE: "invalid block size",
    Abort.SEQUENCE: "invalid sequence number",
    Abort.CRC: "CRC error",
    Abort.MEMORY: "out of memory",
    Abort.ACCESS: "unsupported access to an object",
    Abort.WRITE_ONLY: "attempt to read a write-only object",
    Abort.READ_ONLY: "attempt to write a read-only object",
    Abort.NO_OBJECT: "object does not exist in the object dictionary",
    Abort.NOT_MAPPABLE: "object cannot be mapped to the PDO",
    Abort.PDO_LENGTH: "number and length of the objects to be mapped would exceed the PDO length",
    Abort.PARAMETER_INCOMPATIBLE: "general parameter incompatibility",
    Abort.INTERNAL_INCOMPATIBLE: "general internal incompatibility in the device",
    Abort.HARDWARE: "access failed due to a hardware error",
    Abort.LENGTH: "data type does not match, length of service parameter does not match",
    Abort.TOO_LONG: "data type does not match, length of service parameter too high",
    Abort.TOO_SHORT: "data type does not match, length of service parameter too low",
    Abort.NO_SUBINDEX: "sub-index does not exist",
    Abort.VALUE: "invalid value for parameter",
    Abort.VALUE_HIGH: "value of parameter written too high",
    Abort.VALUE_LOW: "value of parameter written too low",
    Abort.MAX_BELOW_MIN: "maximum value is less than minimum value",
    Abort.NO_RESOURCE: "resource not available: SDO connection",
    Abort.GENERAL: "general error",
    Abort.CANNOT_STORE: "data cannot be transferred or stored to the application",
    Abort.LOCAL_CONTROL: "data cannot be transferred or stored because of local control",
    Abort.DEVICE_STATE: "data cannot be transferred or stored because of the present device state",
    Abort.NO_DICTIONARY: "object dictionary not present or its dynamic generation failed",
    Abort.NO_DATA: "no data available",
}


def abort_text(code: int) -> str:
    """Return ``0x06020000: object does not exist ...`` for an SDO abort code, known or not."""
    return f"0x{code:08X}: {ABORT_TEXT.get(code, 'unknown abort code')}"


class Emcy(IntEnum):
    """Emergency error codes that this project sends (table 26; 0x2310, 0x3220, 0x8700: CiA 402)."""

    NO_ERROR = 0x0000
    GENERIC = 0x1000
    CURRENT = 0x2000
    OVER_CURRENT = 0x2310
    VOLTAGE = 0x3000
    UNDER_VOLTAGE = 0x3220
    TEMPERATURE = 0x4000
    DEVICE_TEMPERATURE = 0x4200
    CAN_OVERRUN = 0x8110
    ERROR_PASSIVE = 0x8120
    HEARTBEAT = 0x8130
    BUS_OFF_RECOVERED = 0x8140
    COB_ID_COLLISION = 0x8150
    PDO_LENGTH = 0x8210
    PDO_LENGTH_EXCEEDED = 0x8220
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250
    SYNC_TIMEOUT = 0x8700


EMCY_TEXT: dict[int, str] = {
    Emcy.NO_ERROR: "error reset or no error",
    Emcy.GENERIC: "generic error",
    Emcy.CURRENT: "current",
    Emcy.OVER_CURRENT: "continuous over-current at the output",
    Emcy.VOLTAGE: "voltage",
    Emcy.UNDER_VOLTAGE: "DC link under-voltage",
    Emcy.TEMPERATURE: "temperature",
    Emcy.DEVICE_TEMPERATURE: "device temperature",
    Emcy.CAN_OVERRUN: "CAN overrun, objects lost",
    Emcy.ERROR_PASSIVE: "CAN in error passive mode",
    Emcy.HEARTBEAT: "life guard or heartbeat error",
    Emcy.BUS_OFF_RECOVERED: "recovered from bus off",
    Emcy.COB_ID_COLLISION: "CAN identifier collision",
    Emcy.PDO_LENGTH: "PDO not processed due to length error",
    Emcy.PDO_LENGTH_EXCEEDED: "PDO length exceeded",
    Emcy.SYNC_LENGTH: "unexpected SYNC data length",
    Emcy.RPDO_TIMEOUT: "RPDO time-out",
    Emcy.SYNC_TIMEOUT: "SYNC time-out (synchronisation lost)",
}
_EMCY_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current, device input side",
    0x22: "current inside the device",
    0x23: "current, device output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}


def emcy_text(code: int) -> str:
    """Return ``0x8250: RPDO time-out`` for an EMCY code; an unlisted code gets the name of its class
    (table 25).
    """
    text = EMCY_TEXT.get(code) or _EMCY_CLASSES.get(code >> 8) or "unknown emergency code"
    return f"0x{code:04X}: {text}"
