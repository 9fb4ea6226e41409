"""A tolerant reader of EDS and DCF files (CiA 306-1), with a diagnosis for everything that it had to assume.

Real files are written by hand and by a dozen tools: Windows code pages, missing keys, doubled sections, zero-padded
numbers. All of that is read, and each defect is told with its line and with what was assumed instead. One thing is
never assumed: what a PDO parameter (1400h to 1BFFh) means. Where the file can be read in two ways there, the variable
has no default, `Variable.unreadable` says why, and `eds.pdo` refuses the map.

The file is read in two steps: lines to sections (`_Reader.split`), sections to objects (`_Reader.build`).
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from eds.cia301 import ARRAY, DATA_TYPES, DOMAIN, DUMMY_TYPES, RECORD, VAR

__all__ = ["Description", "Diagnosis", "EdsError", "Object", "Value", "Variable", "read_eds"]

Value = int | float | str | bytes | None
Severity = Literal["error", "warning"]

ACCESS_TYPES = ("ro", "wo", "rw", "rwr", "rww", "const")
OBJECT_LISTS = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
PDO_PARAMETERS = range(0x1400, 0x1C00)


class EdsError(Exception):
    """An EDS file is refused; the text is ``file:line: what; what is expected or what to do``."""


@dataclass(frozen=True)
class Diagnosis:
    """One defect of a file, and what the reader assumed instead.

    A "warning" has one sensible reading; after an "error" something is missing that a user should look up.
    """

    path: str
    line: int
    severity: Severity
    text: str
    assumed: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.severity}: {self.text}; assumed {self.assumed}"


@dataclass(frozen=True)
class Variable:
    """One sub-index of the object dictionary.

    `default` is None where the file gives none, and where it gives one that cannot be read: `unreadable` then says why.
    With `node_relative` the default is the constant that the node id is added to. `data_type` 0 means not known.
    Numbers are Python numbers: a hexadecimal default of a signed type is read as two's complement.
    """

    index: int
    subindex: int
    name: str
    data_type: int
    access: str
    default: Value
    node_relative: bool
    low: int | float | None
    high: int | float | None
    pdo_mappable: bool
    line: int
    unreadable: str = ""

    @property
    def bits(self) -> int:
        """Width of the data type; 0 where it is not fixed or not known."""
        data_type = DATA_TYPES.get(self.data_type)
        return data_type.bits if data_type else 0


@dataclass(frozen=True)
class Object:
    """One index of the object dictionary; a VAR or DOMAIN has the one variable 0."""

    index: int
    name: str
    object_type: int
    variables: Mapping[int, Variable]


@dataclass(frozen=True)
class Description:
    """What an EDS file says of a device; `info` is [DeviceInfo], `dummies` the types that may fill a PDO's gaps."""

    path: str
    text: str
    objects: Mapping[int, Object]
    diagnoses: tuple[Diagnosis, ...]
    info: Mapping[str, str]
    dummies: frozenset[int] = frozenset()

    def has(self, index: int, subindex: int | None = None) -> bool:
        """Tell whether the object, or its sub-index, is described."""
        entry = self.objects.get(index)
        return entry is not None and (subindex is None or subindex in entry.variables)

    def variable(self, index: int, subindex: int) -> Variable:
        """Return one variable; KeyError names the file and what it lacks."""
        entry = self.objects.get(index)
        if entry is None:
            raise KeyError(f"{self.path} describes no object {index:04X}h")
        if subindex not in entry.variables:
            raise KeyError(f"{self.path}: object {index:04X}h ({entry.name}) has no sub-index {subindex}")
        return entry.variables[subindex]

    def default(self, index: int, subindex: int, node_id: int) -> Value:
        """Return the variable's default with ``$NODEID`` resolved."""
        variable = self.variable(index, subindex)
        if variable.node_relative and isinstance(variable.default, int):
            return variable.default + node_id
        return variable.default


def read_eds(path: str | Path) -> Description:
    """Read an EDS or DCF file; `Description.diagnoses` tells what was wrong with it.

    Raises
    ------
    EdsError
        The file cannot be opened, or describes no object at all.
    """
    return _Reader(Path(path)).build()


@dataclass(frozen=True)
class _Number:
    """A number as written: its value, a complaint about the notation, and whether it could mean another value."""

    value: int
    complaint: str = ""
    doubtful: bool = False
    hexadecimal: bool = False


def _number(text: str) -> _Number | None:
    """Read ``0x1F``, ``31``, ``-31``; also ``1Fh``, ``1F``, ``031``. None where it is no number."""
    low = text.lower()
    sign, low = (-1, low[1:]) if low[:1] == "-" else (1, low.removeprefix("+"))
    if re.fullmatch(r"0x[0-9a-f]+", low):
        return _Number(sign * int(low, 16), hexadecimal=True)
    if re.fullmatch(r"[0-9]+", low):
        value = sign * int(low)
        if len(low) == 1 or low[0] != "0":
            return _Number(value)
        octal = re.fullmatch(r"[0-7]+", low) and sign * int(low, 8) != value
        return _Number(value, "is zero-padded, which may mean octal" if octal else "is zero-padded", bool(octal))
    if re.fullmatch(r"[0-9][0-9a-f]*h", low):
        return _Number(sign * int(low[:-1], 16), "has an 'h' instead of 0x", hexadecimal=True)
    if re.fullmatch(r"[0-9a-f]+", low):
        return _Number(sign * int(low, 16), "has hexadecimal digits without 0x", hexadecimal=True)
    return None


def _same(first: str, second: str) -> bool:
    a, b = _number(_COMMENT.sub("", first)), _number(_COMMENT.sub("", second))
    return a.value == b.value if a and b else first.lower() == second.lower()


@dataclass
class _Section:
    """Keys in lower case with value and line; `conflicts` are keys that stand twice with different values."""

    name: str
    line: int
    entries: dict[str, tuple[str, int]] = field(default_factory=dict)
    spelled: dict[str, str] = field(default_factory=dict)
    conflicts: set[str] = field(default_factory=set)
    reopened: bool = False

    def get(self, key: str) -> str:
        return self.entries.get(key, ("", 0))[0]

    def at(self, key: str) -> int:
        return self.entries.get(key, ("", self.line))[1]

    def what(self, key: str) -> str:
        return f"[{self.name}] {self.spelled.get(key, key)}"

    @property
    def pdo_parameter(self) -> bool:
        match = _OBJECT.fullmatch(self.name)
        return match is not None and int(match[1], 16) in PDO_PARAMETERS


_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{1,4})(?:\s*sub(?:index)?\s*([0-9a-f]{1,2}))?", re.IGNORECASE)
_COMMENT = re.compile(r"\s*[;#].*$")


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = str(path)
        self.diagnoses: list[Diagnosis] = []
        self.sections: dict[str, _Section] = {}
        try:
            raw = path.read_bytes()
        except OSError as error:
            why = error.strerror or type(error).__name__
            raise EdsError(f"{path}:1: cannot be read ({why}); expected an EDS or DCF file") from error
        self.text = self.decode(raw)
        self.split()

    def say(self, line: int, text: str, assumed: str, severity: Severity = "warning") -> None:
        self.diagnoses.append(Diagnosis(self.path, line, severity, text, assumed))

    def decode(self, raw: bytes) -> str:
        if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
            self.say(1, "the file is UTF-16, not ASCII", "UTF-16")
            return raw.decode("utf-16", "replace")
        try:
            return raw.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = raw[: error.start].count(b"\n") + 1
            self.say(line, "the file is neither ASCII nor UTF-8", "Windows-1252")
            return raw.decode("cp1252", "replace")

    # Lines to sections.

    def split(self) -> None:
        section: _Section | None = None
        for number, raw in enumerate(re.split(r"\r*\n|\r", self.text), 1):
            line = raw.strip().strip("\x00\x1a\ufeff")
            if not line or line[0] in ";#":
                continue
            key, equals, value = line.partition("=")
            if line[0] == "[":
                section = self.open_section(line, number)
            elif section is None:
                self.say(number, f"'{line[:40]}' stands before the first section", "a comment")
            elif not equals or not key.strip():
                self.say(number, f"'{line[:40]}' is no key=value", "a comment")
            else:
                self.enter(section, key.strip(), value.strip(), number)

    def open_section(self, line: str, number: int) -> _Section:
        name, bracket, rest = line[1:].partition("]")
        name = name.strip()
        if not bracket:
            name = _COMMENT.sub("", name)
            self.say(number, f"the section head '{line[:40]}' has no ']'", f"[{name}]")
        elif rest.strip() and rest.strip()[0] not in ";#":
            self.say(number, f"'{rest.strip()[:40]}' stands behind the section head [{name}]", "a comment")
        match = _OBJECT.fullmatch(name)
        key = name.lower()
        if match:  # one key for [1018sub1], [1018Sub01] and [0x1018sub1]
            key = f"{int(match[1], 16):04x}" + (f"sub{int(match[2], 16):x}" if match[2] else "")
        known = self.sections.get(key)
        if known is not None:
            self.say(number, f"the section [{name}] stands in line {known.line} already", "one section, first values")
            known.reopened = True
            return known
        return self.sections.setdefault(key, _Section(name, number))

    def enter(self, section: _Section, spelled: str, value: str, number: int) -> None:
        key = spelled.lower()
        if key not in section.entries:
            section.entries[key] = (value, number)
            section.spelled[key] = spelled
            return
        first, line = section.entries[key]
        if _same(first, value):
            if not section.reopened:
                self.say(number, f"[{section.name}] {spelled} stands in line {line} already", "the same")
            return
        if key != "parametername":
            section.conflicts.add(key)
        severity: Severity = "error" if key == "defaultvalue" else "warning"
        text = f"[{section.name}] {spelled}={value}, but line {line} says {first or 'nothing'}"
        self.say(number, text, f"the first, {first or 'nothing'}", severity)

    def bare(self, section: _Section, key: str) -> str:
        """Return a value without the comment behind it."""
        text = section.get(key)
        bare = _COMMENT.sub("", text).strip()
        if bare != text:
            self.say(section.at(key), f"{section.what(key)}={text} has a comment behind the value", bare or "no value")
            section.entries[key] = (bare, section.at(key))
        return bare

    def integer(self, section: _Section, key: str, assumed: int) -> int:
        """Return a key's number; `assumed` where it is absent or empty (not said) or no number (said)."""
        text = self.bare(section, key)
        if not text:
            return assumed
        number = _number(text)
        if number is None:
            self.say(section.at(key), f"{section.what(key)}={text} is no number", str(assumed), "error")
            return assumed
        if number.complaint:
            self.say(section.at(key), f"{section.what(key)}={text} {number.complaint}", str(number.value))
        return number.value

    # Sections to objects.

    def build(self) -> Description:
        heads: dict[int, _Section] = {}
        subs: dict[int, dict[int, _Section]] = {}
        for section in self.sections.values():
            match = _OBJECT.fullmatch(section.name)
            if match and match[2] is None:
                heads[int(match[1], 16)] = section
            elif match:
                subs.setdefault(int(match[1], 16), {})[int(match[2], 16)] = section
        numbers = sorted(heads.keys() | subs.keys())
        objects = {index: self.object(index, heads.get(index), subs.get(index, {})) for index in numbers}
        if not objects:
            raise EdsError(f"{self.path}:1: describes no object; expected sections such as [1000], is it an EDS file?")
        self.check_lists(objects, heads)
        dummy = self.sections.get("dummyusage", _Section("DummyUsage", 1))
        dummies = frozenset(code for code in DUMMY_TYPES if self.integer(dummy, f"dummy{code:04x}", 0))
        info = self.device_info()
        values = [section.at("parametervalue") for section in self.sections.values() if section.get("parametervalue")]
        if values:
            text = f"{len(values)} objects have a ParameterValue (the file is a DCF)"
            self.say(min(values), text, "the device's defaults; the values are not loaded")
        return Description(
            self.path,
            self.text,
            MappingProxyType(objects),
            tuple(sorted(self.diagnoses, key=lambda diagnosis: diagnosis.line)),
            MappingProxyType(info),
            dummies,
        )

    def device_info(self) -> dict[str, str]:
        device = self.sections.get("deviceinfo")
        if device is None:
            self.say(1, "[DeviceInfo] is missing", "a device without a name")
            return {}
        for key in ("vendornumber", "productnumber", "revisionnumber"):
            self.integer(device, key, 0)
        return {device.spelled[key]: value for key, (value, _) in device.entries.items()}

    def check_lists(self, objects: Mapping[int, Object], heads: Mapping[int, _Section]) -> None:
        listed: set[int] = set()
        for name in OBJECT_LISTS:
            section = self.sections.get(name.lower())
            if section is None:
                self.say(1, f"[{name}] is missing", "an empty list")
                continue
            own = [self.integer(section, key, -1) for key in section.entries if key.isdecimal()]
            if len(own) != self.integer(section, "supportedobjects", len(own)):
                said = section.get("supportedobjects")
                self.say(section.at("supportedobjects"), f"[{name}] lists {len(own)}, not {said}", str(len(own)))
            for index in own:
                if index not in objects:
                    self.say(section.line, f"[{name}] lists {index:04X}h, which is not described", "no such object")
            listed.update(own)
        for index, head in heads.items():
            if index not in listed and index >= 0x1000:
                self.say(head.line, f"[{head.name}] stands in no list of objects", "an object like the others")

    def object(self, index: int, head: _Section | None, subs: dict[int, _Section]) -> Object:
        if head is None:
            first = min(subs.values(), key=lambda section: section.line)
            head = _Section(f"{index:04X}", first.line, {"objecttype": (str(RECORD), first.line)})
            self.say(first.line, f"[{first.name}] has no section [{index:04X}]", "a RECORD", "error")
        name = head.get("parametername") or f"Object {index:04X}h"
        if head.entries.keys() != {"objecttype"} and not head.get("parametername"):
            self.say(head.line, f"[{head.name}] has no ParameterName", f"'{name}'")
        count = self.integer(head, "compactsubobj", 0)
        if not 0 <= count <= 0xFE:
            self.say(head.at("compactsubobj"), f"[{head.name}] CompactSubObj={count} is not 0 to 254", "0", "error")
            count = 0
        kind = self.object_type(head, subs, count)
        if kind not in (ARRAY, RECORD) and not subs:
            return Object(index, name, kind, MappingProxyType({0: self.variable(index, 0, head, name, kind)}))
        variables = self.compact(index, head, name, count) if count else {}
        for subindex in sorted(subs):
            section = subs[subindex]
            own = section.get("parametername") or f"{name} {subindex}"
            if not section.get("parametername"):
                self.say(section.line, f"[{section.name}] has no ParameterName", f"'{own}'")
            variables[subindex] = self.variable(index, subindex, section, own, kind)
        if not variables:
            self.say(head.line, f"[{head.name}] is an array or record without sub-indices", "an empty object", "error")
        said = self.integer(head, "subnumber", 0)
        if said and not count and said != len(subs):
            self.say(head.at("subnumber"), f"[{head.name}] SubNumber={said}, {len(subs)} are described", str(len(subs)))
        return Object(index, name, kind, MappingProxyType(dict(sorted(variables.items()))))

    def object_type(self, head: _Section, subs: dict[int, _Section], compact: int) -> int:
        text = self.bare(head, "objecttype").upper()
        names = {"VAR": VAR, "ARRAY": ARRAY, "RECORD": RECORD, "DOMAIN": DOMAIN}
        guess = RECORD if subs else ARRAY if compact else VAR
        if text in names:
            self.say(head.at("objecttype"), f"[{head.name}] ObjectType={text} is no number", f"0x{names[text]:X}")
            return names[text]
        kind = self.integer(head, "objecttype", guess)
        if kind in (VAR, DOMAIN) and (subs or compact):
            self.say(head.line, f"[{head.name}] is ObjectType 0x{kind:X} but has sub-indices", f"0x{guess:X}")
            return guess
        return kind

    def compact(self, index: int, head: _Section, name: str, count: int) -> dict[int, Variable]:
        """Expand CompactSubObj: sub-index 0 is implied, the others share the head's type, access and default."""
        number = Variable(index, 0, "Highest sub-index", 5, "ro", count, False, None, None, False, head.line)
        names = self.sections.get(f"{index:04x}name", _Section("", head.line))
        first = self.variable(index, 1, head, names.get("1") or f"{name} 1", ARRAY)
        variables = {0: number, 1: first}
        for subindex in range(2, count + 1):
            own = names.get(str(subindex)) or f"{name} {subindex}"
            variables[subindex] = Variable(**{**vars(first), "subindex": subindex, "name": own})
        return variables

    def variable(self, index: int, subindex: int, section: _Section, name: str, kind: int) -> Variable:
        code = self.data_type(index, subindex, section, kind)
        access = self.bare(section, "accesstype").lower().replace("/", "")
        if access not in ACCESS_TYPES:
            said = f"AccessType={section.get('accesstype')} is unknown" if access else "AccessType is missing"
            assumed = "const" if subindex == 0 and kind in (ARRAY, RECORD) else "rw"
            self.say(section.at("accesstype"), f"[{section.name}] {said}", assumed)
            access = assumed
        default, relative, unreadable = self.value(section, "defaultvalue", code)
        twice = section.conflicts & {"defaultvalue", "datatype"}
        if section.pdo_parameter and twice:
            default, unreadable = None, f"{section.what(min(twice))} stands twice with different values"
        low, high = self.limits(section, code)
        number = default if isinstance(default, int | float) and not relative else None
        if number is not None and not ((low is None or low <= number) and (high is None or number <= high)):
            text = f"{section.what('defaultvalue')}={section.get('defaultvalue')} is outside its limits"
            self.say(section.at("defaultvalue"), text, str(default))
        mappable = bool(self.integer(section, "pdomapping", 0))
        return Variable(
            index, subindex, name, code, access, default, relative, low, high, mappable, section.line, unreadable
        )

    def data_type(self, index: int, subindex: int, section: _Section, kind: int) -> int:
        guess = 0
        if kind == DOMAIN:
            guess = 0x000F
        elif subindex == 0 and kind in (ARRAY, RECORD):
            guess = 0x0005
        elif index in PDO_PARAMETERS:
            guess = 0x0007 if index & 0x0200 else {1: 7, 2: 5, 3: 6, 5: 6, 6: 5}.get(subindex, 0)
        code = self.integer(section, "datatype", guess)
        number = _number(section.get("datatype"))
        if "datatype" in section.conflicts or (number is not None and number.doubtful):
            text = f"[{section.name}] DataType={section.get('datatype')} can be read in two ways"
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
            text = f"[{section.name}] DataType=0x{code:04X} is none of CiA 301"
            self.say(section.at("datatype"), text, "a type of unknown width")
        return code

    def limits(self, section: _Section, code: int) -> tuple[int | float | None, int | float | None]:
        found: list[int | float | None] = []
        for key in ("lowlimit", "highlimit"):
            value, relative, _ = self.value(section, key, code)
            if relative:
                self.say(section.at(key), f"{section.what(key)} depends on the node id", "no limit")
            found.append(value if isinstance(value, int | float) and not relative else None)
        low, high = found
        if low is not None and high is not None and low > high:
            text = f"[{section.name}] LowLimit {low} is above HighLimit {high}"
            self.say(section.at("lowlimit"), text, "no limits", "error")
            return None, None
        return low, high

    # Values by data type.

    def value(self, section: _Section, key: str, code: int) -> tuple[Value, bool, str]:
        """Return a value, whether the node id is to be added, and why it could not be read."""
        kind = DATA_TYPES[code].kind if code in DATA_TYPES else "unknown"
        if kind in ("text", "unicode"):
            return (section.get(key) if key in section.entries else None), False, ""
        if kind in ("domain", "record"):
            return None, False, ""
        text = self.bare(section, key)
        if not text:
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
            why = f"{section.what(key)}={text} {why}"
            self.say(section.at(key), why, "no value", "error")
        return value, relative, why

    def octets(self, section: _Section, key: str, text: str) -> bytes:
        try:
            return bytes.fromhex(text.removeprefix("0x").removeprefix("0X"))
        except ValueError:
            self.say(section.at(key), f"{section.what(key)}={text} is no row of hexadecimal octets", "its characters")
            return text.encode("cp1252", "replace")

    def real(self, section: _Section, key: str, text: str, code: int) -> tuple[float | None, str]:
        number = _number(text)
        if number is not None and number.hexadecimal and text[:2].lower() == "0x":
            size = DATA_TYPES[code].bits // 8
            if not 0 <= number.value < 1 << 8 * size:
                return None, f"does not fit into {DATA_TYPES[code].name}"
            self.say(section.at(key), f"{section.what(key)}={text} is hexadecimal", "an IEEE 754 pattern")
            value: float = struct.unpack("<f" if size == 4 else "<d", number.value.to_bytes(size, "little"))[0]
        else:
            if re.fullmatch(r"[-+]?\d+,\d+", text):
                self.say(section.at(key), f"{section.what(key)}={text} has a decimal comma", text.replace(",", "."))
            try:
                value = float(text.replace(",", "."))
            except ValueError:
                return None, "is no number"
        return (value, "") if math.isfinite(value) else (None, "is not finite")

    def whole(self, section: _Section, key: str, text: str, code: int) -> tuple[int | None, bool, str]:
        """Read an integer, ``$NODEID+0x180`` or ``0x180+$NODEID``."""
        where, what = section.at(key), section.what(key)
        terms = [term.strip() for term in text.strip("() ").split("+")] if "$" in text else [text]
        rest = [term for term in terms if term.upper() != "$NODEID"]
        relative = len(rest) < len(terms)
        if len(terms) - len(rest) > 1:
            return None, False, "has the node id more than once"
        if relative and terms[0].upper() != "$NODEID":
            self.say(where, f"{what}={text} has the node id in the wrong place", f"$NODEID+{'+'.join(rest)}")
        if not relative and text.lower() in ("true", "false"):
            self.say(where, f"{what}={text} is no number", str(int(text.lower() == "true")))
            rest = [str(int(text.lower() == "true"))]
        total, hexadecimal = 0, False
        for term in rest:
            number = _number(term)
            if number is None:
                return None, False, "is no number"
            if number.complaint:
                self.say(where, f"{what}={text} {number.complaint}", str(number.value))
            if number.doubtful and section.pdo_parameter:
                return None, False, number.complaint
            total += number.value
            hexadecimal |= number.hexadecimal
        value, why = self.fit(section, key, total, code, hexadecimal)
        return value, relative, why

    def fit(self, section: _Section, key: str, number: int, code: int, hexadecimal: bool) -> tuple[int | None, str]:
        """Bring a number into its type's range: two's complement, which only hexadecimal may mean without a word."""
        data_type = DATA_TYPES.get(code)
        if data_type is None or not data_type.bits:
            return number, ""
        half, full = 1 << data_type.bits - 1, 1 << data_type.bits
        if not -half <= number < full:
            return None, f"does not fit into {data_type.name}"
        value = number
        if data_type.signed and number >= half:
            value = number - full
        elif not data_type.signed and number < 0:
            value = number + full
        if value != number and not (hexadecimal and data_type.signed):
            text = f"{section.what(key)}={section.get(key)} does not fit into {data_type.name}"
            self.say(section.at(key), text, f"two's complement, {value}")
        return value, ""
