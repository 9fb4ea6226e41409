"""Devices of other makers for logs whose truth is known: small EDS files, written here."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from coulombus.eds.description import Description
from coulombus.eds.reader import read_eds
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC
from coulombus.node.profile import Profile

__all__ = ["DEVICES", "Kind"]

UNSIGNED8, UNSIGNED16, UNSIGNED32, INTEGER16, INTEGER32 = 5, 6, 7, 3, 4


@dataclass(frozen=True)
class Kind:
    """A kind of device: its EDS file, what acts behind it, and the maps that a master gives it.

    The RPDO has two values of 16 bits, so that one master commands all kinds.
    """

    name: str
    profile: Profile
    rpdo: tuple[int, int]
    tpdo: tuple[int, ...]
    device_type: int = 0

    @property
    def description(self) -> Description:
        """Its EDS file."""
        return read_eds(f"eds/{self.name}.eds") if self.name == "motor" else _written(self)


def _entry(index: int, subindex: int | None, name: str, data_type: int, access: str, default: str, mapped: int) -> str:
    head = f"[{index:04X}]" if subindex is None else f"[{index:04X}sub{subindex:X}]"
    keys = {"ParameterName": name, "ObjectType": "0x7", "DataType": f"0x{data_type:04X}", "AccessType": access}
    keys |= {"DefaultValue": default, "PDOMapping": str(mapped)}
    return "\n".join([head, *(f"{key}={value}" for key, value in keys.items())]) + "\n"


def _record(index: int, name: str, subs: list[tuple[int, int, str, str]]) -> str:
    """Return an object with sub-indexes: (sub-index, data type, access, default)."""
    number = (0, UNSIGNED8, "rw" if index & 0xFE00 in (0x1600, 0x1A00) else "ro", str(max(sub for sub, *_ in subs)))
    if index & 0xFE00 in (0x1600, 0x1A00):
        number = (*number[:3], str(len(subs)))
    lines = f"[{index:04X}]\nParameterName={name}\nObjectType=0x9\nSubNumber={len(subs) + 1}\n"
    return lines + "".join(
        _entry(index, sub, f"{name} {sub}", data_type, access, default, 0)
        for sub, data_type, access, default in (number, *subs)
    )


@cache
def _written(kind: Kind) -> Description:
    mandatory, optional = (0x1000, 0x1001, 0x1018), (0x1005, 0x1014, 0x1016, 0x1017, 0x1400, 0x1600, 0x1800, 0x1A00)
    places = [(word >> 16, word >> 8 & 0xFF, word & 0xFF) for word in (*kind.rpdo, *kind.tpdo)]
    mapped = sorted({index for index, _, _ in places})
    text = f"[FileInfo]\nFileName={kind.name}.eds\nEDSVersion=4.0\n[DeviceInfo]\nVendorName=Elsewhere\n"
    text += f"VendorNumber=0x2F1\nProductName={kind.name}\nProductNumber={len(kind.name)}\nRevisionNumber=1\n"
    text += "BaudRate_1000=1\nSimpleBootUpSlave=1\nGranularity=8\nNrOfRXPDO=1\nNrOfTXPDO=1\nLSS_Supported=0\n"
    lists = {
        "MandatoryObjects": mandatory,
        "OptionalObjects": (*optional, *(index for index in mapped if index >= 0x6000)),
        "ManufacturerObjects": tuple(index for index in mapped if index < 0x6000),
    }
    for name, indexes in lists.items():
        text += f"[{name}]\nSupportedObjects={len(indexes)}\n"
        text += "".join(f"{place}=0x{index:04X}\n" for place, index in enumerate(indexes, 1))
    text += _entry(0x1000, None, "Device type", UNSIGNED32, "ro", f"0x{kind.device_type:08X}", 0)
    text += _entry(0x1001, None, "Error register", UNSIGNED8, "ro", "0", 0)
    text += _entry(0x1005, None, "COB-ID SYNC", UNSIGNED32, "rw", "0x80", 0)
    text += _entry(0x1014, None, "COB-ID EMCY", UNSIGNED32, "rw", "$NODEID+0x80", 0)
    text += _record(0x1016, "Consumer heartbeat time", [(1, UNSIGNED32, "rw", "0")])
    text += _entry(0x1017, None, "Producer heartbeat time", UNSIGNED16, "rw", "0", 0)
    text += _record(0x1018, "Identity", [(1, UNSIGNED32, "ro", "0x2F1"), (2, UNSIGNED32, "ro", str(len(kind.name)))])
    for communication, mapping, base, words in ((0x1400, 0x1600, 0x200, kind.rpdo), (0x1800, 0x1A00, 0x180, kind.tpdo)):
        subs = [(1, UNSIGNED32, "rw", f"$NODEID+0x{base:X}"), (2, UNSIGNED8, "rw", "1"), (3, UNSIGNED16, "rw", "0")]
        text += _record(communication, "PDO", [*subs, (5, UNSIGNED16, "rw", "0")])
        text += _record(mapping, "PDO map", [(k, UNSIGNED32, "rw", f"0x{word:08X}") for k, word in enumerate(words, 1)])
    types = {8: UNSIGNED8, 16: INTEGER16, 32: INTEGER32}
    for index in mapped:
        subs = sorted({(sub, bits) for at, sub, bits in places if at == index})
        if subs[0][0] == 0:
            text += _entry(index, None, f"Value {index:X}", types[subs[0][1]], "rw", "0", 1)
            continue
        text += f"[{index:04X}]\nParameterName=Values {index:X}\nObjectType=0x8\nSubNumber={len(subs) + 1}\n"
        text += _entry(index, 0, "Highest sub-index", UNSIGNED8, "ro", str(subs[-1][0]), 0)
        text += "".join(_entry(index, sub, f"Value {sub}", types[bits], "rw", "0", 1) for sub, bits in subs)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{kind.name}.eds"
        path.write_text(text)
        return read_eds(path)


MOTOR_RPDO, MOTOR_TPDO = (0x60400010, 0x60710010), (0x60410010, 0x60640020, 0x60770010)
DEVICES = (
    Kind("motor", DRIVE402, MOTOR_RPDO, MOTOR_TPDO),
    Kind("motor", GENERIC, MOTOR_RPDO, MOTOR_TPDO),
    Kind("transmitter", GENERIC, (0x73000110, 0x73000210), (0x91300120, 0x61500108), 0x00020194),
    Kind("knob", GENERIC, (0x22000010, 0x22010010), (0x21000110, 0x21000210, 0x21010020)),
)
"""A drive; the drive's file with nothing behind it; a transmitter of CiA 404; a maker's own device."""
