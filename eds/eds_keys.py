"""The content of a device description as keys of CiA 306, for writers of other forms.

A file is read as always, its assumptions included, into rows of keys (`content_of`). A number keeps
its notation where that is clear; else it is written anew. What cannot be read stays as it is, so
that a PDO which is refused stays refused.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from coulombus.eds.cia301 import ARRAY, DATA_TYPES, RECORD, VAR
from coulombus.eds.description import Description, Object, Value, Variable
from coulombus.eds.file_info import OBJECT_LISTS, FileReader
from coulombus.eds.reader import parse_sections
from coulombus.eds.sections import EdsSection, number_of
from coulombus.eds.values import COMMISSIONING
from coulombus.eds.xdd import is_xml

__all__ = ["COMMISSIONED", "HEADS", "OF_DCF", "FileContent", "Keys", "Row", "content_of", "spelled"]

Keys: TypeAlias = dict[str, str]
HEADS = ("FileInfo", "DeviceInfo", "DummyUsage", "Comments")
OF_COMPACT = re.compile(r"[0-9a-f]{4}(name|value|denotation)", re.IGNORECASE)
"""Sections of CompactSubObj."""
COMMISSIONED = "DeviceComissioning"
TEXTS = ("text", "unicode")
VALUE_KEYS = (("LowLimit", "low"), ("HighLimit", "high"), ("DefaultValue", "default"))
OF_DCF = ("ParameterValue", "Denotation", "UploadFile", "DownloadFile")
SPELLED = {
    "unit": "Unit",
    "factor": "Factor",
    "description": "Description",
    "nodeid": "NodeID",
    "baudrate": "Baudrate",
}
"""Keys that an XDD spells otherwise; the first three are some tools', and a parameter's elements."""
COMMON = frozenset(
    (
        *("parametername", "objecttype", "subnumber", "datatype", "accesstype", "pdomapping", "objflags"),
        *("lowlimit", "highlimit", "defaultvalue", "compactsubobj", "uniqueidref"),
        *(key.lower() for key in OF_DCF),
    )
)
XML_ONLY = {
    "property": "properties of a tool",
    "moduleManagement": "modules",
    "LEDList": "lists of LEDs",
    "DeviceFunction": "device functions",
    "functionTypeList": "function types",
    "struct": "structured data types",
}
"""Elements of an XDD without a place in an EDS."""


@dataclass(frozen=True)
class Row:
    """The keys of an object (`subindex` -1) or of a sub-index."""

    index: int
    subindex: int
    keys: Keys

    @property
    def name(self) -> str:
        """Its section's name, as "1018sub1"."""
        return f"{self.index:04X}" + ("" if self.subindex < 0 else f"sub{self.subindex:X}")


@dataclass
class FileContent:
    """A device description as keys of CiA 306: sections by name, objects as rows in their order.

    `left_out` counts what the file has and no row has; `revision` is that of 1018h:03, "" if unknown.
    """

    rows: list[Row]
    sections: dict[str, Keys] = field(default_factory=dict)
    left_out: Counter[str] = field(default_factory=Counter)
    revision: str = ""


def content_of(description: Description) -> FileContent:
    """Return the content of a description that has been read."""
    description, reader = parse_sections(description.text.encode(), description.path)
    content = FileContent([], revision=_revision_of(description))
    lines = {} if is_xml(description.text) else {s.line: s for s in reader.sections.values() if s.index >= 0}
    for index in sorted(description.objects):
        content.rows += _rows_of(reader, description.objects[index], lines)
    for section in reader.sections.values():
        if section.index < 0:
            _enter_section(content, section)
    if is_xml(description.text):
        device = content.sections.setdefault("DeviceInfo", {})
        # imported here: the import takes 0.1 s, and no EDS needs it
        from coulombus.eds.xml_elements import read_elements

        if content.revision and "RevisionNumber" not in device:
            device["RevisionNumber"] = content.revision
        root = read_elements(description.path, description.text)
        counts = {what: sum(1 for _ in root.all(name)) for name, what in XML_ONLY.items()}
        lists = [
            element
            for element in root.all("allowedValues")
            if element.children_named("value") or len(element.children) > 1
        ]
        counts["lists of allowed values"] = len(lists)
        counts["PDOmapping default, or optional of a read-only object: an EDS says only that it may be mapped"] = sum(
            _says_more_than_mappable(element.attributes)
            for kind in ("CANopenObject", "CANopenSubObject")
            for element in root.all(kind)
        )
        counts["names in further languages"] = sum(
            len(parameter.children_named("label")) > 1 for parameter in root.all("parameter")
        )
        content.left_out.update({what: count for what, count in counts.items() if count})
    return content


def _says_more_than_mappable(attributes: Mapping[str, str]) -> bool:
    mapping, access = (attributes.get(name, "").strip().lower() for name in ("PDOmapping", "accessType"))
    return mapping == "default" or (mapping == "optional" and access in ("ro", "const"))


def _revision_of(description: Description) -> str:
    """Return the revision number that 1018h:03 tells, for which an XDD has no other place; "" if it has none."""
    value = description.default(0x1018, 3, 0) if description.has(0x1018, 3) else None
    return f"0x{value:08X}" if isinstance(value, int) else ""


def _enter_section(content: FileContent, section: EdsSection) -> None:
    name = next((head for head in HEADS if head.lower() == section.name.lower()), "")
    if section.name.lower() in COMMISSIONING:
        name = COMMISSIONED
    if section.name.lower() in map(str.lower, OBJECT_LISTS) or OF_COMPACT.fullmatch(section.name):
        return  # made anew of the rows
    content.sections.setdefault(name or section.name, {}).update(
        {SPELLED.get(key, section.spelled.get(key, key)): text for key, (text, _) in section.entries.items()}
    )


def _rows_of(reader: FileReader, entry: Object, lines: Mapping[int, EdsSection]) -> Iterator[Row]:
    index = entry.index
    head = reader.sections.get(f"{index:04x}", EdsSection("", 0))
    sections = {sub: _section_of(reader, variable, head, lines) for sub, variable in entry.variables.items()}
    is_plain = entry.object_type not in (ARRAY, RECORD) and sections.get(0, head) is head and len(sections) == 1
    top: Keys = {"ParameterName": entry.name, "ObjectType": f"0x{entry.object_type:X}"}
    if is_plain:
        yield Row(index, -1, top | _keys_of(reader, entry.variables[0], head))
        return
    top["SubNumber"] = f"0x{len(entry.variables):X}"
    top |= {key: text for key, text in _others(head).items() if key not in OF_DCF or key == "Denotation"}
    yield Row(index, -1, top)
    values, denotations = (_numbered(reader, f"{index:04x}{what}") for what in ("value", "denotation"))
    for sub, variable in entry.variables.items():
        section = sections[sub]
        kind = number_of(section.get("objecttype")) if section is not None and section is not head else None
        keys = {"ParameterName": variable.name, "ObjectType": f"0x{VAR if kind is None else kind.value:X}"}
        keys |= _keys_of(reader, variable, section)
        keys |= {"ParameterValue": values[sub]} if sub in values else {}
        keys |= {"Denotation": denotations[sub]} if sub in denotations else {}
        yield Row(index, sub, keys)


def _numbered(reader: FileReader, name: str) -> dict[int, str]:
    section = reader.sections.get(name, EdsSection("", 0))
    return {sub: section.get(key) for sub, key in section.numbered().items() if section.get(key)}


def _section_of(
    reader: FileReader, variable: Variable, head: EdsSection, lines: Mapping[int, EdsSection]
) -> EdsSection | None:
    """Return the section of a sub-index, that of its object (a VAR, or CompactSubObj), or None if it is implied."""
    section = lines.get(variable.line)
    if not lines:
        section = reader.sections.get(f"{variable.index:04x}sub{variable.subindex:x}")
    if section is not None and section.subindex >= 0 and section.index == variable.index:
        return section
    if head.get("compactsubobj"):
        return head if variable.subindex else None
    return head if head.line == variable.line and variable.subindex == 0 and head.name else None


def _keys_of(reader: FileReader, variable: Variable, section: EdsSection | None) -> Keys:
    keys: Keys = {}
    if variable.data_type:
        keys["DataType"] = f"0x{variable.data_type:04X}"
    elif section is not None and section.get("datatype"):
        keys["DataType"] = section.get("datatype")
    keys["AccessType"] = variable.access
    for key, name in VALUE_KEYS:
        if section is None:
            text = spelled(variable, getattr(variable, name), relative=variable.node_relative and name == "default")
        else:
            text = _text_of(reader, variable, section, key)
        if text or (text is not None and _is_kind(variable, *TEXTS, "bytes", "domain")):
            keys[key] = text
    keys["PDOMapping"] = str(int(variable.pdo_mappable))
    if section is not None:
        if variable.unreadable and "defaultvalue" in section.conflicts:
            keys["DefaultValue"] += " (given twice)"  # no number: the PDO stays refused
        keys |= _others(section)
        if (text := _text_of(reader, variable, section, "ParameterValue")) is not None and text:
            keys["ParameterValue"] = text
    return keys


def _others(section: EdsSection) -> Keys:
    keys = {key: section.get(key.lower()) for key in ("ObjFlags", *OF_DCF) if section.get(key.lower())}
    for key, (text, _) in section.entries.items():
        if text and key not in COMMON:
            keys[SPELLED.get(key, section.spelled.get(key, key))] = text
    flags = number_of(keys.get("ObjFlags", ""))
    if flags is not None:
        keys["ObjFlags"] = f"0x{flags.value:X}"
    return keys


def _is_kind(variable: Variable, *kinds: str) -> bool:
    kind = DATA_TYPES.get(variable.data_type)
    return kind is not None and kind.kind in kinds


def _text_of(reader: FileReader, variable: Variable, section: EdsSection, key: str) -> str | None:
    """Return a value as its section has it if all readers read it alike, else as this reader reads it."""
    low = key.lower()
    if low not in section.entries:
        return None
    if _is_kind(variable, *TEXTS) and key in ("DefaultValue", "ParameterValue"):
        return section.get(low)
    raw = reader.bare(section, low)
    value, relative, why = reader.value(section, low, variable.data_type) if raw else (None, False, "")
    if why or value is None:
        return raw
    kind = DATA_TYPES.get(variable.data_type)
    if kind is not None and kind.kind == "real":
        try:
            float(raw)
        except ValueError:
            return spelled(variable, value)
        return raw
    number = number_of(raw)
    if isinstance(value, int) and (relative or number is None or number.complaint):
        return spelled(variable, value, relative=relative)
    return raw


def spelled(variable: Variable, value: Value, *, relative: bool = False) -> str | None:
    """Return a value in CiA 306's notation."""
    if value is None:
        return None
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    if isinstance(value, int):
        whole = variable.whole
        is_signed = value < 0 or whole is None or whole[0] < 0 or whole[1] == 1
        return f"$NODEID+0x{value:X}" if relative else str(value) if is_signed else f"0x{value:X}"
    return repr(value) if isinstance(value, float) else value
