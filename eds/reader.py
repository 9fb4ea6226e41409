"""Tolerant reader of EDS and DCF files (CiA 306-1), with a diagnosis for every assumption.

Real files are written by hand and by a dozen tools: Windows code pages, missing keys, doubled
sections, zero-padded numbers. The reader accepts all of that, and reports each defect with its line
and the assumed value. It never assumes the meaning of a PDO parameter (1400h to 1BFFh). If the file
is ambiguous there, the variable has no default, `Variable.unreadable` says why, and `eds.pdo`
refuses the map.

The file is read in two steps: lines to sections (`eds.sections`), sections to objects
(here; values by `eds.values`, a DCF's by `eds.values`, the file's other parts by `eds.file_info`).
XDD and XDC files (CiA 311) are recognised by their content; `eds.xdd` converts their XML to sections.
"""

from __future__ import annotations

import gc
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from coulombus.eds.cia301 import ARRAY, DATA_TYPES, DEFSTRUCT, DEFTYPE, DOMAIN, RECORD, VAR
from coulombus.eds.description import Description, Diagnosis, EdsError, Object, Severity, Value, Variable
from coulombus.eds.file_info import FileReader
from coulombus.eds.regular_file import NoRegularFile, read_regular
from coulombus.eds.sections import PDO_PARAMETERS, EdsSection, alike, number_of
from coulombus.eds.xdd import XddReader, is_xml

__all__ = [
    "Description",
    "Diagnosis",
    "EdsError",
    "Object",
    "Value",
    "Variable",
    "parse_eds",
    "parse_sections",
    "read_eds",
]

TYPE_NAMES = {data_type.name: code for code, data_type in DATA_TYPES.items()}
OBJECT_TYPES = (DOMAIN, DEFTYPE, DEFSTRUCT, VAR, ARRAY, RECORD)
ACCESS_TYPES = ("ro", "wo", "rw", "rwr", "rww", "const")
ACCESS_WORDS = {
    "r": "ro",
    "w": "wo",
    "wr": "rw",
    "read": "ro",
    "write": "wo",
    "readonly": "ro",
    "writeonly": "wo",
    "readwrite": "rw",
}
"""Variants of the keys in some files."""

MOST_SUBINDICES = 0xFE
MOST_BYTES = 1 << 26
"""Largest size of a device description; a larger file may be endless, such as a device file."""


def read_eds(path: str | Path) -> Description:
    """Read an EDS, DCF, XDD or XDC file; `Description.diagnoses` lists its defects.

    Raises
    ------
    EdsError
        The path is no regular file (a FIFO, a device: refused at once), cannot be opened, is too
        large, or describes no object at all.
    """
    return parse_eds(_bytes_of(path), str(path))


def parse_sections(raw: bytes, path: str) -> tuple[Description, FileReader]:
    """Parse as `parse_eds`; return the sections, too, with the reader of their values."""
    reader = (_XmlReader if is_xml(raw) else _DescriptionReader)(path, raw)
    return reader.build(), reader


def _bytes_of(path: str | Path) -> bytes:
    try:
        return read_regular(path, MOST_BYTES)
    except OSError as error:
        why = error.strerror or type(error).__name__
        what = why if isinstance(error, NoRegularFile) else f"cannot be read ({why})"
        raise EdsError(f"{path}: {what}; expected an EDS or DCF file, or an XDD or XDC") from error


@lru_cache(maxsize=16)
def parse_eds(raw: bytes, path: str) -> Description:
    """Parse the bytes of an EDS, DCF, XDD or XDC file; `path` names it in diagnoses. The same bytes
    are parsed only once.

    Raises
    ------
    EdsError
        The file describes no object at all, or is XML but no XDD.
    """
    with _collector_at_rest():
        return parse_sections(raw, path)[0]


@contextmanager
def _collector_at_rest() -> Iterator[None]:
    """Pause Python's garbage collector during the construction of many objects: they have no cycles."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _DescriptionReader(FileReader):
    def build(self) -> Description:
        self.node_id, bit_rate = self.commissioning()
        heads: dict[int, EdsSection] = {}
        subs: dict[int, dict[int, EdsSection]] = {}
        for section in self.sections.values():
            if section.index >= 0 > section.subindex:
                heads[section.index] = section
            elif section.index >= 0:
                subs.setdefault(section.index, {})[section.subindex] = section
        for index, sections in subs.items():
            subs[index] = self.in_decimal(sections)
        numbers = sorted(heads.keys() | subs.keys())
        objects = {index: self.object(index, heads.get(index), subs.get(index, {})) for index in numbers}
        if not objects:
            raise EdsError(f"{self.path}:1: describes no object; expected sections such as [1000], is it an EDS file?")
        self.check_lists(objects, heads)
        objects |= self.implied_pdos(objects)
        info = self.device_info(objects)
        dummies = self.dummies()
        self.check_rest(objects)
        return Description(
            self.path,
            self.text,
            MappingProxyType(objects),
            tuple(sorted(alike(self.diagnoses), key=lambda diagnosis: diagnosis.line)),
            MappingProxyType(info),
            dummies,
            self.node_id,
            bit_rate,
        )

    def in_decimal(self, subs: dict[int, EdsSection]) -> dict[int, EdsSection]:
        """Return the sub-indices by their numbers.

        They are decimal if sub-index 0 proves that [2000sub10] means the tenth.
        """
        if not ({9, 0x10} <= subs.keys() and 0 in subs) or any(sub in subs for sub in range(0xA, 0x10)):
            return subs
        if not all(f"{sub:x}".isdecimal() for sub in subs):
            return subs
        counted = {int(f"{sub:x}"): section for sub, section in subs.items()}
        highest = number_of(subs[0].get("defaultvalue"))
        if highest is None or highest.value != max(counted) or sorted(counted) != list(range(highest.value + 1)):
            return subs
        text = f"[{subs[0x10].name}] and the others count in decimal: sub-index 0 says {highest.value}"
        self.say(subs[0x10].line, text, "decimal numbers")
        return counted

    def object(self, index: int, head: EdsSection | None, subs: dict[int, EdsSection]) -> Object:
        if head is None:
            first = min(subs.values(), key=lambda section: section.line)
            head = EdsSection(f"{index:04X}", first.line, {"objecttype": (str(RECORD), first.line)})
            self.say(first.line, f"[{first.name}] has no section [{index:04X}]", "a RECORD", "error")
        name = head.get("parametername") or f"Object {index:04X}h"
        if head.entries.keys() != {"objecttype"} and not head.get("parametername"):
            self.say(head.line, f"[{head.name}] has no ParameterName", f"'{name}'")
        count = self.integer(head, "compactsubobj", 0)
        if not 0 <= count <= MOST_SUBINDICES:
            assumed = MOST_SUBINDICES if count == MOST_SUBINDICES + 1 else 0
            text = f"[{head.name}] CompactSubObj={count} is not 0 to {MOST_SUBINDICES}"
            self.say(head.at("compactsubobj"), text, str(assumed), "warning" if assumed else "error")
            count = assumed
        kind = self.object_type(head, subs, count)
        if (subs or count) and head.get("parametervalue"):
            text = f"{head.what('parametervalue')} belongs to no sub-index"
            self.say(head.at("parametervalue"), text, "a comment")
            del head.entries["parametervalue"]
        if kind not in (ARRAY, RECORD) and not subs:
            return Object(index, name, kind, MappingProxyType({0: self.variable(index, 0, head, name, kind)}))
        variables = self.compact(index, head, name, count) if count else {}
        for subindex in sorted(subs):
            section = subs[subindex]
            sub_name = section.get("parametername") or f"{name} {subindex}"
            if not section.get("parametername"):
                self.say(section.line, f"[{section.name}] has no ParameterName", f"'{sub_name}'")
            variables[subindex] = self.variable(index, subindex, section, sub_name, kind)
        if not variables:
            self.say(head.line, f"[{head.name}] is an array or record without sub-indices", "an empty object", "error")
        self.configure(index, variables)
        self.check_subs(index, head, subs, variables, count)
        return Object(index, name, kind, MappingProxyType(dict(sorted(variables.items()))))

    def check_subs(
        self,
        index: int,
        head: EdsSection,
        subs: Mapping[int, EdsSection],
        variables: Mapping[int, Variable],
        compact: int,
    ) -> None:
        """Check SubNumber and the default of sub-index 0 against the described sub-indices."""
        stated = self.integer(head, "subnumber", 0)
        if subs and not compact and stated != len(subs):
            number = f"SubNumber={stated}" if head.get("subnumber") else "SubNumber is missing"
            self.say(head.at("subnumber"), f"[{head.name}] {number}, {len(subs)} are described", str(len(subs)))
        if compact and stated not in (0, compact, compact + 1):
            text = f"[{head.name}] SubNumber={stated}, but CompactSubObj={compact}"
            self.say(head.at("subnumber"), text, f"{compact} entries")
        if 9 in subs and 0x10 in subs and not any(subindex in subs for subindex in range(0xA, 0x10)):
            line = subs[0x10].line
            self.say(
                line, f"[{head.name}] has sub9 and sub10, but no subA: decimal numbers?", "hexadecimal ones", "error"
            )
        if not variables or index < 0x1000:
            return
        highest = variables.get(0)
        last = max((subindex for subindex in variables if subindex != 0xFF), default=0)
        if highest is None:
            self.say(head.line, f"[{head.name}] has no sub-index 0", "that a client cannot read it")
        elif highest.access in ("ro", "const") and highest.default not in (None, last) and index != 0x1003:
            text = f"[{head.name}] has sub-indices up to {last}, but sub-index 0 says {highest.default!r}"
            self.say(highest.line, text, "what is described")

    def object_type(self, head: EdsSection, subs: dict[int, EdsSection], compact: int) -> int:
        text = self.bare(head, "objecttype").upper()
        names = {"VAR": VAR, "ARRAY": ARRAY, "RECORD": RECORD, "DOMAIN": DOMAIN}
        guess = RECORD if subs else ARRAY if compact else VAR
        if text in names:
            self.say(head.at("objecttype"), f"[{head.name}] ObjectType={text} is not a number", f"0x{names[text]:X}")
            return names[text]
        kind = self.integer(head, "objecttype", guess)
        if kind not in OBJECT_TYPES:
            text = f"[{head.name}] ObjectType=0x{kind:X} is not defined in CiA 301"
            self.say(head.at("objecttype"), text, f"0x{guess:X}", "error")
            return guess
        if (subs or compact) and not text:
            self.say(head.line, f"[{head.name}] has sub-indices, but no ObjectType", f"0x{guess:X}")
        if kind in (ARRAY, RECORD) and not (subs or compact) and head.get("datatype"):
            self.say(head.line, f"[{head.name}] is ObjectType 0x{kind:X} but has no sub-indices", f"0x{VAR:X}")
            return VAR
        if kind in (VAR, DOMAIN) and (subs or compact):
            self.say(head.line, f"[{head.name}] is ObjectType 0x{kind:X} but has sub-indices", f"0x{guess:X}")
            return guess
        return kind

    def compact(self, index: int, head: EdsSection, name: str, count: int) -> dict[int, Variable]:
        """Expand CompactSubObj: sub-index 0 is implied, the others share the head's type, access and default."""
        number = Variable(index, 0, "Highest sub-index", 5, "ro", count, False, None, None, False, head.line)
        section = self.sections.get(f"{index:04x}name", EdsSection("", head.line))
        names = {subindex: section.get(key) for subindex, key in section.numbered().items()}
        first = self.variable(index, 1, head, names.get(1) or f"{name} 1", ARRAY)
        variables = {0: number, 1: first}
        for subindex in range(2, count + 1):
            sub_name = names.get(subindex) or f"{name} {subindex}"
            variables[subindex] = Variable(**{**vars(first), "subindex": subindex, "name": sub_name})
        return variables

    def variable(self, index: int, subindex: int, section: EdsSection, name: str, kind: int) -> Variable:
        code = self.data_type(index, subindex, section, kind)
        access = self.bare(section, "accesstype").lower().replace("/", "")
        if access not in ACCESS_TYPES:
            access_text = f"AccessType={section.shown('accesstype')} is unknown" if access else "AccessType is missing"
            usual = "const" if subindex == 0 and kind in (ARRAY, RECORD) else "rw"
            assumed = ACCESS_WORDS.get(re.sub(r"\W", "", access), usual)
            self.say(section.at("accesstype"), f"[{section.name}] {access_text}", assumed)
            access = assumed
        default, relative, unreadable = self.value(section, "defaultvalue", code)
        if twice := self.ambiguous(section, "defaultvalue"):
            default, unreadable = None, twice
        low, high = self.limits(section, code)
        mappable = bool(self.integer(section, "pdomapping", 0))
        variable = Variable(
            *(index, subindex, name, code, access, default, relative, low, high, mappable, section.line, unreadable),
            unit=section.get("unit") if section.get("factor") in ("", "1", "1.0") else "",
        )
        if isinstance(default, int | float) and not (relative or variable.admits(default)):
            text = f"{section.what('defaultvalue')}={section.shown('defaultvalue')} is outside its limits"
            self.say(section.at("defaultvalue"), text, str(default))
        return self.configured(variable, section, "parametervalue")

    def data_type(self, index: int, subindex: int, section: EdsSection, kind: int) -> int:
        number = number_of(self.bare(section, "datatype"))
        plain = number is not None and not (number.complaint or section.conflicts)
        if number and plain and number.value in DATA_TYPES and f"{number.value:04x}sub1" not in self.sections:
            return number.value  # the usual case
        guess = 0
        if kind == DOMAIN:
            guess = 0x000F
        elif subindex == 0 and kind in (ARRAY, RECORD):
            guess = 0x0005
        elif index in PDO_PARAMETERS:
            guess = 0x0007 if index & 0x0200 else {1: 7, 2: 5, 3: 6, 5: 6, 6: 5}.get(subindex, 0)
        named = TYPE_NAMES.get(self.bare(section, "datatype").upper())
        if named is not None:
            self.say(
                section.at("datatype"),
                f"{section.what('datatype')}={section.shown('datatype')} is not a number",
                f"0x{named:04X}",
            )
            return named
        code = self.integer(section, "datatype", guess)
        number = number_of(section.get("datatype"))
        if "datatype" in section.conflicts or (number is not None and number.doubtful):
            text = f"[{section.name}] DataType={section.shown('datatype')} can be read in two ways"
            self.say(section.at("datatype"), text, "a type of unknown width", "error")
            return 0
        if not section.get("datatype") and kind != DOMAIN:
            assumed = DATA_TYPES[guess].name if guess else "a type of unknown width"
            severity: Severity = "warning" if guess else "error"
            self.say(section.at("datatype"), f"[{section.name}] DataType is missing", assumed, severity)
        elif f"{code:04x}sub1" in self.sections:  # CanFestival's editor: [A0] holds the type and its limits
            actual = self.integer(self.sections[f"{code:04x}sub1"], "defaultvalue", 0)
            text = f"[{section.name}] DataType=0x{code:04X} is described in [{code:X}]"
            self.say(section.at("datatype"), text, DATA_TYPES[actual].name if actual in DATA_TYPES else "nothing of it")
            return actual if actual in DATA_TYPES else 0
        elif code not in DATA_TYPES:
            text = f"[{section.name}] DataType=0x{code:04X} is not defined in CiA 301"
            self.say(section.at("datatype"), text, "a type of unknown width")
        return code


class _XmlReader(XddReader, _DescriptionReader):
    """Sections of an XDD, and the objects built from any sections."""
