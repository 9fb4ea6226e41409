"""Texts for error codes of drives (CiA 402-2, EMCY and 603Fh), and remedies for SDO abort codes."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from coulombus.eds.cia301 import Abort, emcy_text

__all__ = ["ABORT_CHECKS", "error_check", "error_text"]

DRIVE_TEXT: Mapping[int, str] = MappingProxyType(
    {
        0x2310: "continuous over-current", 0x2320: "short circuit or earth leakage", 0x2330: "earth leakage",
        0x2340: "short circuit", 0x3110: "mains over-voltage", 0x3120: "mains under-voltage", 0x3130: "phase failure",
        0x3210: "DC link over-voltage", 0x3220: "DC link under-voltage", 0x3331: "field circuit interrupted",
        0x4110: "ambient temperature too high", 0x4210: "device temperature too high",
        0x4310: "drive temperature too high", 0x5112: "24 V supply low", 0x5430: "input stages",
        0x5530: "non-volatile memory", 0x6010: "software reset (watchdog)", 0x6320: "parameter error",
        0x7110: "brake chopper", 0x7121: "motor blocked", 0x7122: "motor error or commutation",
        0x7303: "resolver 1", 0x7305: "incremental sensor 1", 0x7306: "incremental sensor 2", 0x7310: "speed",
        0x7320: "position", 0x7500: "communication", 0x8311: "excess torque", 0x8331: "torque",
        0x8400: "velocity speed controller", 0x8500: "position controller", 0x8611: "following error",
        0x8612: "reference limit", 0xFF01: "the maker's own",
    }
)  # fmt: skip

ABORT_CHECKS: Mapping[int, str] = MappingProxyType(
    {
        Abort.NO_OBJECT: "Compare with the device's EDS file: it has no object of this index.",
        Abort.NO_SUBINDEX: "Compare with the device's EDS file: the object has no such sub-index.",
        Abort.READ_ONLY: "Leave the write out: the object can only be read.",
        Abort.WRITE_ONLY: "Leave the read out: the object can only be written.",
        Abort.VALUE: "Look up which values the object takes.",
        Abort.VALUE_HIGH: "Write a smaller value: look up the object's limit.",
        Abort.VALUE_LOW: "Write a larger value: look up the object's limit.",
        Abort.LENGTH: "Write it in the size of its data type, as the EDS file has it.",
        Abort.TOO_LONG: "Write fewer bytes: its data type is shorter.",
        Abort.TOO_SHORT: "Write more bytes: its data type is longer.",
        Abort.DEVICE_STATE: "Write it in another state: PRE-OPERATIONAL, or with the drive not enabled.",
        Abort.LOCAL_CONTROL: "Switch the device from local to remote control.",
        Abort.NOT_MAPPABLE: "Map another object: the EDS file says which can be mapped.",
        Abort.PDO_LENGTH: "Map fewer objects: a PDO has eight bytes.",
    }
)
"""First check by a node's error code."""


CODE_CHECKS: Mapping[int, str] = MappingProxyType(
    {
        0x8130: "Look why it missed the heartbeat or guarding: did the sender stop, or is its time (1016h) too short?",
        0x8210: "Compare the length of the PDO with its map (1600h).",
        0x8250: "Look whether its set-points still come: the event timer of the RPDO (1400h:05) has run out.",
        0x87: "Look whether SYNC still comes, at the period of 1006h.",
        0x81: "Look at cable, termination and bus load.",
        0x82: "Compare lengths and maps of its PDOs with what is sent to it.",
        0x71: "Check the motor and its cable; turn the axis by hand, supply off.",
        0x73: "Check the sensor and its cable.",
        0x2: "Turn the axis by hand, supply off: does it move freely? Then check cable and winding.",
        0x3: "Measure the supply at the device while it works.",
        0x4: "Let it cool, and check load, fan and ambient temperature.",
        0x5: "Switch it off and on: an error that comes again is one of the device.",
        0x6: "Compare its firmware and parameters with those that worked.",
        0x8: "Compare load and set-points with the limits of the drive.",
        0x9: "Look at the external input that reports it.",
    }
)
"""First check by code, by its first two digits, and by its first digit."""


def error_check(code: int) -> str:
    """Return the first check for a code that a standard explains; "" for the maker's own codes."""
    if code not in DRIVE_TEXT and emcy_text(code).endswith("unknown emergency code"):
        return ""
    return next((CODE_CHECKS[key] for key in (code, code >> 8, code >> 12) if key in CODE_CHECKS), "")


def error_text(code: int) -> str:
    """Return ``0x7121: motor blocked`` for an EMCY or 603Fh code of a drive; else CiA 301's text."""
    text = DRIVE_TEXT.get(code)
    return emcy_text(code) if text is None else f"0x{code:04X}: {text}"
