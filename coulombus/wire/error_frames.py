"""Text of error frames: a CAN controller's report on itself and its wire (``linux/can/error.h``).

::

    identifier   class bits | CAN_ERR_FLAG
    data[0]      bit in which the arbitration was lost (class 002h), 0: unknown
    data[1]      controller's state (class 004h)
    data[2]      kind of protocol violation (class 008h), data[3] where in the frame
    data[4]      transceiver (class 010h): CANH in the low half, CANL in the high half
    data[6], [7] TEC and REC (class 200h)
"""

from __future__ import annotations

from typing import Any, TypeAlias

__all__ = [
    "ACTIVE_AGAIN",
    "BUS_ERROR",
    "BUS_OFF",
    "CONTROLLER",
    "COUNTERS",
    "KINDS",
    "LOST_ARBITRATION",
    "NO_ACK",
    "RESTARTED",
    "RX_OVERFLOW",
    "RX_PASSIVE",
    "RX_WARNING",
    "TX_OVERFLOW",
    "TX_PASSIVE",
    "TX_WARNING",
    "VIOLATION",
    "error_frame",
]

LOST_ARBITRATION, CONTROLLER, VIOLATION, TRANSCEIVER, COUNTERS = 0x002, 0x004, 0x008, 0x010, 0x200
NO_ACK, BUS_OFF, BUS_ERROR, RESTARTED = 0x020, 0x040, 0x080, 0x100
RX_OVERFLOW, TX_OVERFLOW, RX_WARNING, TX_WARNING, RX_PASSIVE, TX_PASSIVE = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20
ACTIVE_AGAIN = 0x40
CLASSES = {
    0x001: "transmission timed out", LOST_ARBITRATION: "arbitration lost", CONTROLLER: "controller problem",
    VIOLATION: "protocol violation", TRANSCEIVER: "transceiver problem", NO_ACK: "no acknowledgement", BUS_OFF: "bus off",
    BUS_ERROR: "bus error", RESTARTED: "restarted",
}  # fmt: skip
STATES = {
    RX_OVERFLOW: "receive buffer overflow", TX_OVERFLOW: "transmit buffer overflow", RX_WARNING: "receive warning",
    TX_WARNING: "transmit warning", RX_PASSIVE: "receive error passive", TX_PASSIVE: "transmit error passive",
    ACTIVE_AGAIN: "error active again",
}  # fmt: skip
KINDS = {
    0x01: "single bit", 0x02: "form", 0x04: "bit stuffing", 0x08: "dominant bit not sent", 0x10: "recessive bit not sent",
    0x20: "overload", 0x40: "active error announced", 0x80: "while sending",
}  # fmt: skip
PLACES = {
    0x03: "start of frame", 0x02: "identifier bits 28-21", 0x06: "identifier bits 20-18", 0x04: "substitute RTR",
    0x05: "identifier extension", 0x07: "identifier bits 17-13", 0x0F: "identifier bits 12-5", 0x0E: "identifier bits 4-0",
    0x0C: "RTR", 0x0D: "reserved bit 1", 0x09: "reserved bit 0", 0x0B: "data length code", 0x0A: "data", 0x08: "CRC",
    0x18: "CRC delimiter", 0x19: "acknowledge slot", 0x1B: "acknowledge delimiter", 0x1A: "end of frame", 0x12: "intermission",
}  # fmt: skip
CANH = {4: "CANH no wire", 5: "CANH short to battery", 6: "CANH short to supply", 7: "CANH short to ground"}
CANL = {
    4: "CANL no wire", 5: "CANL short to battery", 6: "CANL short to supply", 7: "CANL short to ground", 8: "CANL short to CANH",
}  # fmt: skip


Row: TypeAlias = dict[str, Any]


def error_frame(can_id: int, data: bytes) -> Row:
    """Return the content of an error frame: `classes` and, if present, `lost_at_bit`, `controller`,
    `violation`, `place`, `transceiver`, `tec` and `rec`; `text` says all of it in words.
    """
    b = data.ljust(8, b"\0")
    row: Row = {"classes": _named(CLASSES, can_id)}
    if can_id & LOST_ARBITRATION and b[0]:
        row["lost_at_bit"] = b[0]
    if can_id & CONTROLLER and b[1]:
        row["controller"] = _named(STATES, b[1])
    if can_id & VIOLATION:
        row |= {"violation": _named(KINDS, b[2])} if b[2] else {}
        row |= {"place": PLACES.get(b[3], f"place {b[3]:02X}h")} if b[3] else {}
    if can_id & TRANSCEIVER and b[4]:
        row["transceiver"] = [table[half] for table, half in ((CANH, b[4] & 0xF), (CANL, b[4] >> 4)) if half in table]
    if can_id & COUNTERS:
        row |= {"tec": b[6], "rec": b[7]}
    return row | {"text": _text(row)}


def _named(table: dict[int, str], bits: int) -> list[str]:
    return [text for bit, text in table.items() if bits & bit]


def _text(row: dict[str, Any]) -> str:
    details = {
        "arbitration lost": f"in bit {row['lost_at_bit']}" if "lost_at_bit" in row else "",
        "controller problem": ", ".join(row.get("controller", ())),
        "protocol violation": ", ".join(
            [*row.get("violation", ()), *([f"in {row['place']}"] if "place" in row else [])]
        ),
        "transceiver problem": ", ".join(row.get("transceiver", ())),
    }
    parts = [f"{name} ({details[name]})" if details.get(name) else name for name in row["classes"]]
    if "tec" in row:
        parts.append(f"TEC {row['tec']}, REC {row['rec']}")
    return ", ".join(parts) or "class not told"
