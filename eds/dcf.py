"""Additions of a DCF to an EDS (CiA 306-1): ParameterValue, [1003Value] and [DeviceComissioning]."""

from __future__ import annotations

import re
from dataclasses import replace

from coulombus.eds.description import Variable
from coulombus.eds.sections import EdsSection, cut
from coulombus.eds.values import ValueReader

__all__ = ["COMMISSIONING", "DcfReader"]

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
