"""Small EDS files of drives, each with one quirk of the field, and what is to become of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from eds_edit import edit, fixed, gone, mapped
from foreign_eds import I16, I32, MOTOR, U8, U32, another, dual, geared, with_record, with_variable, without

PLAIN = without(another(MOTOR), "20")
MAPS = tuple(base + k for base in (0x1600, 0x1A00) for k in range(4))
COMMUNICATION = tuple(base + k for base in (0x1400, 0x1800) for k in range(4))


@dataclass(frozen=True)
class Quirk:
    """What is done to the file of a plain drive.

    Attributes
    ----------
    edit : of the file's text
    refused : part of the reason why it is refused; "" where it arms
    counts_rev : that the draft is to have
    axis : of the drive
    """

    edit: Callable[[str], str]
    refused: str = ""
    counts_rev: int = 8192
    axis: int = 1


def _each(sections, **keys):
    def change(text):
        for section in sections:
            text = edit(text, section, **keys)
        return text

    return change


def _fixed_with_roles(text):
    text = mapped(fixed(text, *MAPS), 0x1600, 0x60400010, 0x60710010)
    return mapped(text, 0x1A00, 0x60410010, 0x60640020, 0x60770010)


def _fixed_without_torque(text):
    text = fixed(text, *MAPS)
    for number in MAPS[:4]:
        text = mapped(text, number, 0x60400010)
    return text


QUIRKS = {
    "none": Quirk(lambda text: text),
    "fixed maps": Quirk(_fixed_with_roles),
    "fixed maps without a torque": Quirk(_fixed_without_torque, "6071h:0 finds no place in an RPDO"),
    "position of 16 bits": Quirk(_each(["6064"], DataType=I16, LowLimit="", HighLimit="")),
    "torque of 32 bits": Quirk(_each(["6071", "6077"], DataType=I32, LowLimit="", HighLimit="")),
    "no 6077h": Quirk(lambda text: gone(text, "6077")),
    "types 254 and 255 only": Quirk(
        _each([f"{index:04X}sub2" for index in COMMUNICATION], LowLimit=254, HighLimit=255, DefaultValue=255)
    ),
    "6060h is write-only": Quirk(_each(["6060"], AccessType="wo")),
    "6061h is missing": Quirk(lambda text: gone(text, "6061")),
    "feed and gear": Quirk(geared, counts_rev=360),
    "position factor": Quirk(lambda text: with_record(text, "6093", 8192, 360), counts_rev=360),
    "thousandths of a degree": Quirk(
        lambda text: with_variable(text, "60A8", U32, "0xFD410000", "rw"), counts_rev=360_000
    ),
    "608Fh:01 without a default": Quirk(_each(["608Fsub1"], DefaultValue="")),
    "608Fh is missing": Quirk(lambda text: without(text, "608F")),
    "inverted by 607Eh": Quirk(lambda text: with_variable(text, "607E", U8, "0xA0", "rw")),
    "no 6072h": Quirk(lambda text: without(text, "6072")),
    "6071h up to 100 per mille": Quirk(_each(["6071"], LowLimit=-100, HighLimit=100)),
    "6072h up to 100 per mille": Quirk(_each(["6072"], LowLimit=0, HighLimit=100, DefaultValue=100)),
    "6072h from 100 per mille": Quirk(_each(["6072"], LowLimit=100)),
    "Granularity=0": Quirk(_each(["DeviceInfo"], Granularity=0)),
    "6071h cannot be mapped": Quirk(_each(["6071"], PDOMapping=0), "6071h is not mappable"),
    "6071h is missing": Quirk(lambda text: gone(text, "6071"), "6071h is not described"),
    "no torque mode": Quirk(_each(["6502"], DefaultValue="0x1"), "offers neither cyclic synchronous torque"),
    "profile torque only": Quirk(_each(["6502"], DefaultValue="0x8")),
    "6502h tells nothing": Quirk(_each(["6502"], DefaultValue="")),
    "no heartbeat": Quirk(lambda text: without(text, "1016", "1017")),
    "no 6007h": Quirk(lambda text: without(text, "6007")),
    "identifiers are read-only": Quirk(_each([f"{index:04X}sub1" for index in COMMUNICATION], AccessType="ro")),
    "no 1018h:02": Quirk(lambda text: edit(gone(text, "1018sub2"), "1018", SubNumber=4)),
    "second axis": Quirk(dual, axis=2),
    "second axis in any PDO": Quirk(lambda text: dual(text, 0), axis=2),
    "a second axis that is not there": Quirk(lambda text: text, "has no object of axis 2", axis=2),
}
"""By what the drive has that the plain one has not."""
