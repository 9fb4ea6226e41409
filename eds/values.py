"""Values of an EDS file by CiA 301's data types: two's complement, REAL, strings, limits.

Values that do not fit are reported.
"""

from __future__ import annotations

import math
import re
import struct

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.description import Value
from coulombus.eds.sections import EdsSection, SectionReader, cut, number_of

__all__ = ["ValueReader"]

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
