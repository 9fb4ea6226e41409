"""Names of objects of CiA 301 and 402, for nodes without an EDS file."""

from __future__ import annotations

from coulombus.eds.sdo_frames import where
from coulombus.explain.bus import Bus

__all__ = ["object_text"]

NAMES = {
    0x1000: "device type", 0x1001: "error register", 0x1003: "error history", 0x1005: "COB-ID SYNC",
    0x1006: "communication cycle period", 0x1010: "store parameters", 0x1011: "restore parameters",
    0x1014: "COB-ID EMCY", 0x1016: "consumer heartbeat time", 0x1017: "producer heartbeat time",
    0x1018: "identity", 0x1029: "error behaviour", 0x603F: "error code", 0x6040: "controlword",
    0x6041: "statusword", 0x6060: "modes of operation", 0x6061: "modes of operation display",
    0x6064: "position actual value", 0x6071: "target torque", 0x6072: "max torque", 0x607A: "target position",
    0x60FF: "target velocity", 0x6502: "supported drive modes",
    **{index: f"RPDO{index - 0x13FF} parameters" for index in range(0x1400, 0x1408)},
    **{index: f"RPDO{index - 0x15FF} map" for index in range(0x1600, 0x1608)},
    **{index: f"TPDO{index - 0x17FF} parameters" for index in range(0x1800, 0x1808)},
    **{index: f"TPDO{index - 0x19FF} map" for index in range(0x1A00, 0x1A08)},
}  # fmt: skip


def object_text(bus: Bus, number: int, index: int, subindex: int) -> str:
    """Return an object of a node as ``6041h:00 (statusword)``."""
    description = bus.describe(number)
    name = ""
    if description is not None and description.has(index, subindex):
        name = f" ({description.variable(index, subindex).name})"
    elif index in NAMES:
        name = f" ({NAMES[index]})"
    return where(index, subindex) + name
