"""Values of an EDS file by CiA 301's data types: two's complement, REAL, strings, limits.

Values that do not fit are reported. `DcfReader` reads the additions of a DCF (CiA 306-1):
ParameterValue, [1003Value] and [DeviceComissioning].
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import replace

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.description import Value, Variable
from coulombus.eds.sections import EdsSection, SectionReader, cut, number_of

__all__ = ["COMMISSIONING", "DcfReader", "ValueReader"]

LARGEST_REAL32 = (2 - 2**-23) * 2.0**127
MOST_NODE_ID = 127


class ValueReader(SectionReader):
    """Reads a key's value as a data type."""

    def limits(self, section: EdsSection, code: int) -> tuple[int | float | None, int | float | None]:
        """Return LowLimit and HighLimit as values of the data type `code`."""
        if "lowlimit" not in section.entries and "highlimit" not in section.entries:
            return None, None
        limits: list[int | float | None] = []
        for key in ("lowlimit", "highlimit"):
            number = number_of(self.bare(section, key))
            kind = DATA_TYPES.get(code)
            if key == "lowlimit" and number and number.value < 0 and kind and kind.kind == "int" and not kind.signed:
                self.say(
                    section.at(key),
                    f"{section.what(key)}={section.shown(key)}, but no {kind.name} is below 0",
                    "no limit",
                )
                limits.append(None)
                continue
            value, relative, _ = self.value(section, key, code)
            if relative:
                self.say(section.at(key), f"{section.what(key)} depends on the node id", "no limit")
            limits.append(value if isinstance(value, int | float) and not relative else None)
        low, high = limits
        if low is not None and high is not None and low > high:
            text = f"[{section.name}] LowLimit {low} is above HighLimit {high}"
            self.say(section.at("lowlimit"), text, "no limits", "error")
            return None, None
        return low, high

    # Values by data type.

    def value(self, section: EdsSection, key: str, code: int, otherwise: str = "no value") -> tuple[Value, bool, str]:
        """Return a value, whether the node id is to be added, and why it is unreadable; `otherwise` is then
        assumed.
        """
        if key not in section.entries:
            return None, False, ""
        kind = DATA_TYPES[code].kind if code in DATA_TYPES else "unknown"
        if kind in ("text", "unicode"):
            text = section.get(key)
            if len(text) > 1 and text[0] == text[-1] == '"':
                self.say(
                    section.at(key), f"{section.what(key)}={cut(text)} is in quotes", "that they belong to the text"
                )
            return (text if key in section.entries else None), False, ""
        text = self.bare(section, key)
        if not text:
            return None, False, ""
        if kind in ("domain", "record"):
            self.say(
                section.at(key),
                f"{section.what(key)}={cut(text)}, but a {DATA_TYPES[code].name} has no value here",
                "none",
            )
            return None, False, ""
        if kind == "bytes":
            return self.octets(section, key, text), False, ""
        value: Value
        relative = False
        if kind == "real":
            value, why = self.real(section, key, text, code)
        else:
            value, relative, why = self.whole(section, key, text, code)
        if why and kind == "unknown":
            return text, False, ""
        if why:
            why = f"{section.what(key)}={cut(text)} {why}"
            self.say(section.at(key), why, otherwise, "error")
        return value, relative, why

    def octets(self, section: EdsSection, key: str, text: str) -> bytes:
        """Return the bytes of an OCTET_STRING or DOMAIN."""
        try:
            return bytes.fromhex(re.sub("(?i)0x|,", " ", text))
        except ValueError:
            self.say(
                section.at(key), f"{section.what(key)}={cut(text)} is not a row of hexadecimal octets", "its characters"
            )
            return text.encode("cp1252", "replace")

    def real(self, section: EdsSection, key: str, text: str, code: int) -> tuple[float | None, str]:
        """Return a REAL, or None and the reason."""
        number = number_of(text)
        if number is not None and number.hexadecimal and text[:2].lower() == "0x":
            size = DATA_TYPES[code].bits // 8
            if not 0 <= number.value < 1 << 8 * size:
                return None, f"does not fit into {DATA_TYPES[code].name}"
            self.say(section.at(key), f"{section.what(key)}={cut(text)} is hexadecimal", "an IEEE 754 pattern")
            value: float = struct.unpack("<f" if size == 4 else "<d", number.value.to_bytes(size, "little"))[0]
        else:
            if re.fullmatch(r"[-+]?\d+,\d+", text):
                self.say(
                    section.at(key), f"{section.what(key)}={cut(text)} has a decimal comma", cut(text.replace(",", "."))
                )
            try:
                value = float(text.replace(",", "."))
            except ValueError:
                return None, "is not a number"
        if not math.isfinite(value):
            return None, "is not finite"
        if DATA_TYPES[code].bits == 32 and abs(value) > LARGEST_REAL32:
            return None, "does not fit into REAL32"
        return value, ""

    def whole(self, section: EdsSection, key: str, text: str, code: int) -> tuple[int | None, bool, str]:
        """Read an integer, ``$NODEID+0x180`` or ``0x180+$NODEID``."""
        plain = number_of(text)
        if plain is not None and not plain.complaint:  # the usual case
            value, why = self.fit(section, key, plain.value, code, plain.hexadecimal)
            return value, False, why
        where, what = section.at(key), section.what(key)
        terms = [term.strip() for term in text.strip("() ").split("+")] if "$" in text else [text]
        rest = [term for term in terms if term.upper() != "$NODEID"]
        relative = len(rest) < len(terms)
        if len(terms) - len(rest) > 1:
            return None, False, "has the node id more than once"
        if relative and terms[0].upper() != "$NODEID":
            self.say(where, f"{what}={cut(text)} has the node id in the wrong place", f"$NODEID+{cut('+'.join(rest))}")
        if not relative and text.lower() in ("true", "false"):
            self.say(where, f"{what}={cut(text)} is not a number", str(int(text.lower() == "true")))
            rest = [str(int(text.lower() == "true"))]
        total, hexadecimal = 0, False
        for term in rest:
            number = number_of(term)
            if number is None:
                return None, False, "is not a number"
            if number.complaint:
                self.say(where, f"{what}={cut(text)} {number.complaint}", str(number.value))
            if number.doubtful and section.pdo_parameter:
                return None, False, number.complaint
            total += number.value
            hexadecimal |= number.hexadecimal
        value, why = self.fit(section, key, total, code, hexadecimal)
        bits = DATA_TYPES[code].bits if code in DATA_TYPES else 0
        if relative and value is not None and bits and (value + MOST_NODE_ID).bit_length() > bits:
            return None, False, f"does not fit into {DATA_TYPES[code].name} with every node id"
        return value, relative, why

    def fit(self, section: EdsSection, key: str, number: int, code: int, hexadecimal: bool) -> tuple[int | None, str]:
        """Bring a number into its type's range by two's complement; without a report for hexadecimal numbers
        only.
        """
        data_type = DATA_TYPES.get(code)
        if data_type is None or not data_type.bits:
            return number, ""
        half, full = 1 << data_type.bits - 1, 1 << data_type.bits
        for wider in (16, 32, 64):  # a negative number, sign-extended to the width of the tool's integers
            if hexadecimal and data_type.signed and full <= number and 0 <= number - (1 << wider) + half < half:
                value = number - (1 << wider)
                text = f"{section.what(key)}={section.shown(key)} is longer than {data_type.name}"
                self.say(section.at(key), text, f"{value}, sign-extended")
                return value, ""
        if not -half <= number < full:
            return None, f"does not fit into {data_type.name}"
        value = number
        if data_type.signed and number >= half:
            value = number - full
        elif not data_type.signed and number < 0:
            value = number + full
        if value != number and not (hexadecimal and data_type.signed):
            text = f"{section.what(key)}={section.shown(key)} does not fit into {data_type.name}"
            self.say(section.at(key), text, f"two's complement, {value}")
        return value, ""


COMMUNICATION = range(0x1000, 0x2000)
COB_ID_FLAGS = 1 << 31 | 1 << 30
"""Flags of a COB-ID: bit 31, not valid (for SYNC and TIME: produced); bit 30, no RTR."""

COMMISSIONING = ("devicecomissioning", "devicecommissioning")
"""The first is CiA's spelling."""
BIT_RATES = (10, 20, 50, 100, 125, 250, 500, 800, 1000)
"""Bit rates of CiA 301 [kbit/s], and 100, which is in use."""


class DcfReader(ValueReader):
    """Replaces defaults by configured values; `node_id` is that of [DeviceComissioning], 0 if it is absent."""

    node_id = 0
    kind = "a DCF"

    def __init__(self, path: str, raw: bytes) -> None:
        super().__init__(path, raw)
        self.going: list[int] = []
        """Lines of the values that change with the node id, as their defaults do."""

    def commissioning(self) -> tuple[int, int]:
        """Return node id and bit rate [bit/s] of a DCF's [DeviceComissioning] (CiA's spelling); 0 if absent."""
        sections = [self.sections[name] for name in COMMISSIONING if name in self.sections]
        if not sections:
            return 0, 0
        section = sections[0]
        if section.name.lower() != COMMISSIONING[0]:
            text = f"the section head [{section.name}] does not follow CiA 306"
            self.say(section.line, text, "[DeviceComissioning]")
        node_id, rate = (self.integer(section, key, 0) for key in ("nodeid", "baudrate"))
        if section.get("nodeid") and not 1 <= node_id <= 127:
            self.say(section.at("nodeid"), f"{section.what('nodeid')}={node_id} is not 1 to 127", "none")
            node_id = 0
        if rate not in (0, *BIT_RATES):
            text = f"{section.what('baudrate')}={rate} is not a bit rate of CiA 301 in kbit/s"
            self.say(section.at("baudrate"), text, "none")
            rate = 0
        return node_id, 1000 * rate

    def ambiguous(self, section: EdsSection, key: str) -> str:
        """Return why a PDO parameter's value is ambiguous; "" if it is not."""
        twice = section.conflicts & {key, "datatype"} if section.pdo_parameter else ()
        return f"{section.what(min(twice))} is given twice with different values" if twice else ""

    def configure(self, index: int, variables: dict[int, Variable]) -> None:
        """Configure an object's variables from a DCF's [1003Value], sub-index by sub-index."""
        section = self.sections.get(f"{index:04x}value", EdsSection("", 0))
        for subindex, key in section.numbered().items():
            if subindex in variables:
                variables[subindex] = self.configured(variables[subindex], section, key)

    def configured(self, variable: Variable, section: EdsSection, key: str) -> Variable:
        """Return the variable with a DCF's value as its default, checked against type and limits as in an SDO
        download.

        A bad value leaves the default unchanged, and makes a PDO parameter unreadable.
        """
        if not section.get(key) or (variable.unreadable and not variable.data_type):
            return variable
        value, relative, why = self.value(section, key, variable.data_type, "the default")
        if not why and isinstance(value, int | float) and not (relative or variable.admits(value)):
            why = f"{section.what(key)}={section.shown(key)} is outside the object's limits"
            self.say(section.at(key), why, "the default", "error")
        why = self.ambiguous(section, key) or why
        if why:
            return replace(variable, default=None, unreadable=why) if section.pdo_parameter else variable
        if value is None:
            return variable
        if variable.node_relative and not relative and isinstance(variable.default, int) and isinstance(value, int):
            return self.related(variable, section, key, value)
        return replace(variable, default=value, node_relative=relative, unreadable="")

    def related(self, variable: Variable, section: EdsSection, key: str, value: int) -> Variable:
        """Return the variable with a constant if its default depends on the node id.

        A value that equals the default for the DCF's own node id changes with another node id, too: a
        file that is used with another node id moves all its identifiers or none. Bits 30 and 31 of a
        COB-ID (no RTR, not valid) are settings and not part of the identifier.
        """
        assert isinstance(variable.default, int)
        usual, entry_text = variable.default + self.node_id, f"{section.what(key)}={section.shown(key)}"
        cob_id = variable.index in COMMUNICATION and variable.bits == 32
        goes = self.node_id > 0 and not (value ^ usual) & ~(COB_ID_FLAGS if cob_id else 0)
        if variable.access in ("ro", "const") and not (goes and value == usual):
            self.say(section.at(key), f"{entry_text} cannot be written", f"$NODEID+0x{variable.default:X}")
            return variable
        if goes:
            self.going.append(section.at(key))
            return replace(variable, default=value - self.node_id)
        text = f"{entry_text} is another identifier than the default $NODEID+0x{variable.default:X}"
        at = f" for the node id {self.node_id}" if self.node_id else ", and the file tells no node id"
        self.say(section.at(key), text + at, f"0x{value:X} with every node id")
        return replace(variable, default=value, node_relative=False, unreadable="")

    def check_values(self) -> None:
        """Report that the file is a DCF, and which of its values are in other files."""
        values = []
        for name, section in self.sections.items():
            compact = name.endswith("value") and re.fullmatch(r"[0-9a-f]{4}value", name) is not None
            for key, (value, line) in section.entries.items():
                if value and (key == "parametervalue" or (compact and key.isdecimal())):
                    values.append(line)
                elif value and key in ("uploadfile", "downloadfile"):
                    self.say(line, f"{section.what(key)}={cut(value)} is another file", "no value")
        if values:
            text = f"the file is {self.kind}, with {len(values)} configured value{'s' * (len(values) > 1)}"
            self.say(min(values), text, "that the device starts with them")
        if self.going:
            count = len(self.going)
            text = f"{count} configured value{'s are' if count > 1 else ' is'} what the default is for the node id {self.node_id}"
            self.say(
                min(self.going),
                text,
                "that with another node id they move" if count > 1 else "that with another node id it moves",
            )
