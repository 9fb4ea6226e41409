"""What a DCF adds to an EDS (CiA 306-1): configured values, ParameterValue and [1003Value], and [DeviceComissioning]."""

from __future__ import annotations

import re
from dataclasses import replace

from eds.description import Value, Variable
from eds.eds_sections import Section
from eds.eds_values import ValueReader

__all__ = ["COMMISSIONING", "DcfReader"]

COMMISSIONING = ("devicecomissioning", "devicecommissioning")
"""The first spelling is CiA's."""
BIT_RATES = (10, 20, 50, 100, 125, 250, 500, 800, 1000)
"""Of CiA 301 [kbit/s], and 100, which is in use."""


class DcfReader(ValueReader):
    """Puts configured values in the place of defaults; `node_id` is that of [DeviceComissioning], 0 where there is none."""

    node_id = 0

    def commissioning(self) -> tuple[int, int]:
        """Return node id and bit rate [bit/s] of a DCF's [DeviceComissioning] (CiA's spelling); 0 where there is none."""
        known = [self.sections[name] for name in COMMISSIONING if name in self.sections]
        if not known:
            return 0, 0
        section = known[0]
        if section.name.lower() != COMMISSIONING[0]:
            text = f"the section head [{section.name}] is not spelled as CiA 306 has it"
            self.say(section.line, text, "[DeviceComissioning]")
        node_id, rate = (self.integer(section, key, 0) for key in ("nodeid", "baudrate"))
        if section.get("nodeid") and not 1 <= node_id <= 127:
            self.say(section.at("nodeid"), f"{section.what('nodeid')}={node_id} is not 1 to 127", "none")
            node_id = 0
        if rate not in (0, *BIT_RATES):
            text = f"{section.what('baudrate')}={rate} is no bit rate of CiA 301 in kbit/s"
            self.say(section.at("baudrate"), text, "none")
            rate = 0
        return node_id, 1000 * rate

    def ambiguous(self, section: Section, key: str) -> str:
        """Return why a PDO parameter's value can be read in two ways, if it can."""
        twice = section.conflicts & {key, "datatype"} if section.pdo_parameter else ()
        return f"{section.what(min(twice))} stands twice with different values" if twice else ""

    def configure(self, index: int, variables: dict[int, Variable]) -> None:
        """Give an object's variables what a DCF's [1003Value] says, sub-index by sub-index."""
        section = self.sections.get(f"{index:04x}value", Section("", 0))
        for subindex, key in section.numbered().items():
            if subindex in variables:
                variables[subindex] = self.configured(variables[subindex], section, key)

    def configured(self, variable: Variable, section: Section, key: str) -> Variable:
        """Return the variable with a DCF's value, held against type and limits as an SDO would be, for its default.

        What cannot be taken leaves the default as it is, and a PDO parameter unreadable.
        """
        if not section.get(key) or (variable.unreadable and not variable.data_type):
            return variable
        value, relative, why = self.value(section, key, variable.data_type, "the default")
        if not why and isinstance(value, int | float) and not (relative or variable.admits(value)):
            why = f"{section.what(key)}={section.get(key)} is outside the object's limits"
            self.say(section.at(key), why, "the default", "error")
        why = self.ambiguous(section, key) or why
        if why:
            return replace(variable, default=None, unreadable=why) if section.pdo_parameter else variable
        if value is None or self.follows(variable, section, key, value, relative):
            return variable
        return replace(variable, default=value, node_relative=relative, unreadable="")

    def follows(self, variable: Variable, section: Section, key: str, value: Value, relative: bool) -> bool:
        """Tell whether a value goes with the node id: the default for the DCF's own one, or what no client can write."""
        if not variable.node_relative or relative or not isinstance(variable.default, int):
            return False
        usual = self.node_id > 0 and value == variable.default + self.node_id
        if variable.access in ("ro", "const") and not usual:
            text = f"{section.what(key)}={section.get(key)} cannot be written"
            self.say(section.at(key), text, f"$NODEID+0x{variable.default:X}")
            return True
        return usual

    def check_values(self) -> None:
        """Say that the file is a DCF, and which of its values stand in other files."""
        values = []
        for name, section in self.sections.items():
            compact = re.fullmatch(r"[0-9a-f]{4}value", name) is not None
            for key, (value, line) in section.entries.items():
                if value and (key == "parametervalue" or (compact and key.isdecimal())):
                    values.append(line)
                elif value and key in ("uploadfile", "downloadfile"):
                    self.say(line, f"{section.what(key)}={value} is another file", "no value")
        if values:
            text = f"the file is a DCF, with {len(values)} configured value{'s' * (len(values) > 1)}"
            self.say(min(values), text, "that the device starts with them")
