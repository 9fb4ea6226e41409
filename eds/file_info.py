"""Parts of an EDS file besides its objects: [DeviceInfo], lists of objects, and sections of no object."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from coulombus.eds.cia301 import DUMMY_TYPES, RECORD, predefined
from coulombus.eds.description import Object, Variable
from coulombus.eds.sections import EdsSection
from coulombus.eds.values import COMMISSIONING, DcfReader

__all__ = ["FileReader"]

OBJECT_LISTS: Mapping[str, tuple[tuple[int, int], ...]] = {
    "MandatoryObjects": ((0x1000, 0x1001), (0x1018, 0x1018)),
    "OptionalObjects": ((0x1000, 0x1FFF), (0x6000, 0xFFFF)),
    "ManufacturerObjects": ((0x2000, 0x5FFF),),
}
"""Lists of objects and the indices that belong there (CiA 306-1)."""

OTHER_SECTIONS = frozenset(
    (
        *("fileinfo", "deviceinfo", "dummyusage", "comments", "standarddatatypes", "tools", "dynamicchannels"),
        *("mandatoryobjects", "optionalobjects", "manufacturerobjects", "supportedmodules", "connectedmodules"),
        *COMMISSIONING,
    )
)
"""Sections of CiA 306-1 that belong to no object."""

OTHER_PATTERN = re.compile(r"[0-9a-f]{4}(name|value|denotation|objectlinks)|tool\d+|m\d+\w*")
OBJECT_KEYS = frozenset(
    (
        *(
            "parametername",
            "objecttype",
            "datatype",
            "accesstype",
            "defaultvalue",
            "pdomapping",
            "lowlimit",
            "highlimit",
        ),
        *("subnumber", "objflags", "compactsubobj", "parametervalue", "denotation", "uploadfile", "downloadfile"),
        *("parameterrefd", "uniqueidref", "factor", "offset", "unit", "description", "category"),
    )
)
"""Keys of an object's section: those of CiA 306-1, and display keys of some tools."""

PDO_NUMBERS = {"nrofrxpdo": (0x1400, "RPDOs"), "nroftxpdo": (0x1800, "TPDOs")}
PDO_COUNT = 512
MOST_ENTRIES = 64
COMMUNICATION_TYPES: Mapping[int, int] = {1: 0x07, 2: 0x05, 3: 0x06, 4: 0x05, 5: 0x06, 6: 0x05}
"""Data types of a PDO's communication parameters by sub-index (CiA 301, table 66)."""


class FileReader(DcfReader):
    """Reads [DeviceInfo], [DummyUsage] and the lists, and reports everything that no other part of the
    reader reads.
    """

    def device_info(self, objects: Mapping[int, Object]) -> dict[str, str]:
        """Return [DeviceInfo] as written; its numbers are checked against the objects."""
        if "fileinfo" not in self.sections:
            self.say(1, "[FileInfo] is missing", "a file of no version")
        device = self.sections.get("deviceinfo")
        if device is None:
            self.say(1, "[DeviceInfo] is missing", "a device without a name")
            return {}
        for key in ("vendornumber", "productnumber", "revisionnumber", "granularity", "lss_supported"):
            self.integer(device, key, 0)
        for key, (first, name) in PDO_NUMBERS.items():
            described = sum(first <= index < first + PDO_COUNT for index in objects)
            stated = self.integer(device, key, described)
            if stated != described:
                text = f"{device.what(key)}={stated}, but {described} {name} are described"
                self.say(device.at(key), text, str(described))
        return {device.spelled[key]: value for key, (value, _) in device.entries.items()}

    def implied_pdos(self, objects: Mapping[int, Object]) -> dict[int, Object]:
        """Return the PDO parameters that CompactPDO implies and the file does not list (CiA 306-1).

        Each bit of CompactPDO is a sub-index of the communication parameters; bit 0 is sub-index 1.
        Mapping parameters have 64 entries, none of them mapped.
        """
        device = self.sections.get("deviceinfo", EdsSection("", 1))
        compact, implied = self.integer(device, "compactpdo", 0), dict[int, Object]()
        line = device.at("compactpdo")
        for key, (first, name) in PDO_NUMBERS.items():
            described = sum(first <= index < first + PDO_COUNT for index in objects)
            stated = self.integer(device, key, described)
            if not compact or not described < stated <= PDO_COUNT:
                continue
            text = f"{device.what('compactpdo')}={compact}: {stated} {name} are told of, {described} are described"
            self.say(line, text, f"the {stated - described} that CiA 306 implies")
            free = [index for index in range(first, first + PDO_COUNT) if index not in objects]
            for index in free[: stated - described]:
                implied[index] = _communication(index, compact, line)
                if index + 0x200 not in objects:
                    implied[index + 0x200] = _mapping(index + 0x200, line)
        return implied

    def dummies(self) -> frozenset[int]:
        """Return the types that may fill a PDO's gaps."""
        dummy = self.sections.get("dummyusage", EdsSection("DummyUsage", 1))
        return frozenset(code for code in DUMMY_TYPES if self.integer(dummy, f"dummy{code:04x}", 0))

    def check_lists(self, objects: Mapping[int, Object], heads: Mapping[int, EdsSection]) -> None:
        """Check the lists of objects against the described objects."""
        listed: dict[int, str] = {}
        for name, ranges in OBJECT_LISTS.items():
            section = self.sections.get(name.lower())
            if section is None:
                self.say(1, f"[{name}] is missing", "an empty list")
                continue
            keys = [key for key in section.entries if key.isdecimal()]
            entries = {key: self.integer(section, key, -1) for key in keys}
            if len(entries) != self.integer(section, "supportedobjects", len(entries)):
                stated = section.get("supportedobjects")
                self.say(
                    section.at("supportedobjects"), f"[{name}] lists {len(entries)}, not {stated}", str(len(entries))
                )
            numbers = sorted(int(key) for key in keys)
            if numbers and numbers != list(range(1, len(numbers) + 1)):
                gap = next(k for k, number in enumerate(numbers, 1) if number != k)
                self.say(
                    section.line, f"[{name}] has no entry {gap}, its numbers jump to {numbers[-1]}", "no such entry"
                )
            for key, index in entries.items():
                if index < 0:
                    continue
                what = f"[{name}] lists {index:04X}h"
                if index not in objects:
                    self.say(section.at(key), f"{what}, which is not described", "no such object")
                if index in listed:
                    self.say(section.at(key), f"{what}, which [{listed[index]}] lists already", "one object")
                listed.setdefault(index, name)
            misplaced = [i for i in entries.values() if i >= 0 and not any(low <= i <= high for low, high in ranges)]
            if misplaced:
                text = f"[{name}] lists {_some(misplaced)}, which belong into another list"
                self.say(section.line, text, "objects like the others")
        for index, head in heads.items():
            if index not in listed and index >= 0x1000:
                self.say(head.line, f"[{head.name}] is in no list of objects", "an object like the others")

    def check_rest(self, objects: Mapping[int, Object]) -> None:
        """Report everything besides objects: values of a DCF, modules, unknown sections and keys."""
        self.check_values()
        for name, key, what in (
            ("supportedmodules", "nrofentries", "modules"),
            ("dynamicchannels", "nrofseg", "segments"),
        ):
            section = self.sections.get(name)
            if section is not None and self.integer(section, key, 0):
                self.say(section.line, f"[{section.name}] describes {what}, whose objects depend on the device", "none")
        unknown: Counter[str] = Counter()
        first: dict[str, EdsSection] = {}
        for name, section in self.sections.items():
            if section.index >= 0:
                if section.entries.keys() <= OBJECT_KEYS:
                    continue
                for key in section.entries.keys() - OBJECT_KEYS:
                    unknown[key] += 1
                    if key not in first or section.line < first[key].line:
                        first[key] = section
            elif OTHER_PATTERN.fullmatch(name):
                self.check_attached(name, section, objects)
            elif name not in OTHER_SECTIONS:
                like = "datatype" in section.entries or "objecttype" in section.entries
                text = f"the section [{section.name}] is not defined in CiA 306"
                self.say(section.line, text, "a comment", "error" if like else "warning")
        for key, count in unknown.items():
            section = first[key]
            text = f"{section.what(key)} is not a key of CiA 306" + (f" ({count} times)" if count > 1 else "")
            self.say(section.at(key), text, "a comment")

    def check_attached(self, name: str, section: EdsSection, objects: Mapping[int, Object]) -> None:
        """Check sections like [1003Name] against the object to which they belong."""
        if not name.endswith(("name", "value", "denotation")):
            return
        index = int(name[:4], 16)
        entry = objects.get(index)
        keys = section.numbered()
        for key in section.entries.keys() - set(keys.values()) - {"nrofentries"}:
            self.say(section.at(key), f"{section.what(key)} is not a decimal sub-index", "a comment")
        if entry is None:
            self.say(section.line, f"[{section.name}] belongs to {index:04X}h, which is not described", "a comment")
        elif strange := [subindex for subindex in keys if subindex not in entry.variables]:
            text = f"[{section.name}] names the sub-index {strange[0]}, which {index:04X}h has not"
            self.say(section.at(keys[strange[0]]), text, "a comment")
        if len(keys) != self.integer(section, "nrofentries", len(keys)):
            text = f"[{section.name}] has {len(keys)} entries, not {section.shown('nrofentries')}"
            self.say(section.at("nrofentries"), text, str(len(keys)))


def _implied(index: int, subindex: int, code: int, default: int | None, line: int, relative: bool = False) -> Variable:
    access = "const" if subindex == 0 and index & 0x200 == 0 else "rw"
    name = f"PDO parameter {subindex}"
    return Variable(index, subindex, name, code, access, default, relative, None, None, False, line)


def _communication(index: int, compact: int, line: int) -> Object:
    subs = [sub for sub in COMMUNICATION_TYPES if compact >> (sub - 1) & 1]
    variables = {0: _implied(index, 0, 0x05, max(subs, default=0), line)}
    for sub in subs:
        identifier = predefined(index, 1, 0) if sub == 1 else None
        relative = identifier is not None and identifier < 0x800
        variables[sub] = _implied(index, sub, COMMUNICATION_TYPES[sub], identifier, line, relative)
    return Object(index, "PDO communication parameter", RECORD, MappingProxyType(variables))


def _mapping(index: int, line: int) -> Object:
    variables = {sub: _implied(index, sub, 0x07 if sub else 0x05, 0, line) for sub in range(MOST_ENTRIES + 1)}
    return Object(index, "PDO mapping parameter", RECORD, MappingProxyType(variables))


def _some(indices: Iterable[int], limit: int = 3) -> str:
    """Return "2000h, 2001h, 2002h and 5 more"."""
    names = [f"{index:04X}h" for index in indices]
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
