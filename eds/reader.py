"""A tolerant reader of EDS and DCF files (CiA 306-1), with a diagnosis for everything that it had to assume."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from eds.cia301 import ARRAY, DATA_TYPES, DOMAIN, RECORD, VAR

__all__ = ["Description", "Diagnosis", "EdsError", "Object", "Value", "Variable", "read_eds"]

Value = int | float | str | bytes | None


class EdsError(Exception):
    """An EDS file is refused; the text is ``file:line: what; what is expected or what to do``."""


@dataclass(frozen=True)
class Diagnosis:
    """One defect of a file, and what the reader assumed instead."""

    path: str
    line: int
    severity: Literal["error", "warning"]
    text: str
    assumed: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.severity}: {self.text}; {self.assumed}"


@dataclass(frozen=True)
class Variable:
    """One sub-index of the object dictionary.

    `default` is None where the file gives none, and where it gives one that cannot be read: `unreadable` then says why.
    With `node_relative` the default is the constant that the node id is added to. `data_type` 0 means not known.
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
    """What an EDS file says of a device."""

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


@dataclass
class _Section:
    name: str
    line: int
    entries: dict[str, tuple[str, int]] = field(default_factory=dict)
    spelled: dict[str, str] = field(default_factory=dict)
    conflicts: set[str] = field(default_factory=set)

    def get(self, key: str) -> str:
        return self.entries.get(key, ("", 0))[0]

    def at(self, key: str) -> int:
        return self.entries.get(key, ("", self.line))[1]


_HEADER = re.compile(r"\[([^\]]*)\]?(.*)")
_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{1,4})(?:sub(?:index)?([0-9a-f]{1,2}))?")
_COMMENT = re.compile(r"\s*[;#].*$")
_HEX = re.compile(r"0x([0-9a-f]+)|([0-9][0-9a-f]*)h")


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = str(path)
        self.diagnoses: list[Diagnosis] = []
        try:
            raw = path.read_bytes()
        except OSError as error:
            raise EdsError(f"{path}: cannot be read ({error.strerror}); name an existing EDS file") from error
        self.text = self.decode(raw)
        self.sections: dict[str, _Section] = {}
        self.split()

    def say(self, line: int, text: str, assumed: str, severity: Literal["error", "warning"] = "warning") -> None:
        self.diagnoses.append(Diagnosis(self.path, line, severity, text, assumed))

    def decode(self, raw: bytes) -> str:
        if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
            self.say(1, "the file is UTF-16, CiA 306 wants ASCII", "decoded as UTF-16")
            return raw.decode("utf-16", "replace")
        try:
            return raw.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = raw[: error.start].count(b"\n") + 1
            self.say(line, "the file is not ASCII nor UTF-8", "decoded as Windows-1252")
            return raw.decode("cp1252", "replace")

    def split(self) -> None:
        section: _Section | None = None
        for number, raw in enumerate(self.text.splitlines(), 1):
            line = raw.strip().strip("\x00\x1a")
            if not line or line[0] in ";#":
                continue
            if line[0] == "[":
                section = self.open_section(line, number)
            elif section is None or "=" not in line:
                where = "is no 'key=value'" if section else "stands before the first section"
                self.say(number, f"the line '{line[:40]}' {where}", "ignored")
            else:
                key, _, value = line.partition("=")
                self.enter(section, key.strip(), value.strip(), number)

    def open_section(self, line: str, number: int) -> _Section:
        match = _HEADER.match(line)
        name, rest = (match[1].strip(), match[2].strip()) if match else (line, "")
        if "]" not in line:
            self.say(number, f"the section head '{line}' has no ']'", f"read as [{name}]")
        elif rest and rest[0] not in ";#":
            self.say(number, f"'{rest}' stands behind the section head [{name}]", "ignored")
        known = self.sections.get(name.lower())
        if known is not None:
            self.say(number, f"the section [{name}] stands in line {known.line} already", "the two are read as one")
            return known
        return self.sections.setdefault(name.lower(), _Section(name, number))

    def enter(self, section: _Section, spelled: str, value: str, number: int) -> None:
        key = spelled.lower()
        if key not in section.entries:
            section.entries[key] = (value, number)
            section.spelled[key] = spelled
            return
        first, line = section.entries[key]
        if first.lower() != value.lower():
            section.conflicts.add(key)
            text = f"[{section.name}] {spelled}={value}, but line {line} says {spelled}={first}"
            self.say(number, text, "the first one counts", "error")
        else:
            self.say(number, f"[{section.name}] {spelled} stands in line {line} already", "ignored")

    # numbers

    def integer(self, section: _Section, key: str, assumed: int | None, *, wanted: bool = False) -> int | None:
        """Return a key's number; `assumed` where it is empty, absent (said when `wanted`) or no number."""
        text = section.get(key)
        name = section.spelled.get(key, key)
        if not text:
            if wanted or key in section.entries:
                said = "is empty" if key in section.entries else "is missing"
                if wanted:
                    self.say(section.at(key), f"[{section.name}] {name} {said}", f"{assumed} assumed")
            return assumed
        number = self.number(text, section.at(key), f"[{section.name}] {name}")
        if number is None:
            self.say(section.at(key), f"[{section.name}] {name}={text} is no number", f"{assumed} assumed", "error")
            return assumed
        return number

    def number(self, text: str, line: int, what: str) -> int | None:
        """Read hexadecimal, decimal or zero-padded text, sign allowed; None where it is no number."""
        bare = _COMMENT.sub("", text).strip()
        if bare != text.strip():
            self.say(line, f"{what}={text} has a comment behind the value", f"{bare} read")
        low = bare.lower().replace(" ", "").replace("_", "")
        sign, low = (-1, low[1:]) if low[:1] == "-" else (1, low.removeprefix("+"))
        match = _HEX.fullmatch(low)
        if match:
            if match[2]:
                self.say(line, f"{what}={text} is not how CiA 306 writes a hexadecimal number", f"0x{match[2]} read")
            return sign * int(match[1] or match[2], 16)
        if re.fullmatch(r"[0-9]+", low):
            if len(low) > 1 and low[0] == "0":
                self.say(line, f"{what}={text} is zero-padded (octal by CiA 306)", f"decimal {int(low)} read")
            return sign * int(low)
        if re.fullmatch(r"[0-9a-f]+", low):
            self.say(line, f"{what}={text} has hexadecimal digits without 0x", f"0x{low} read")
            return sign * int(low, 16)
        return None

    # objects

    def build(self) -> Description:
        heads: dict[int, _Section] = {}
        subs: dict[int, dict[int, _Section]] = {}
        for section in self.sections.values():
            match = _OBJECT.fullmatch(section.name.lower().replace(" ", ""))
            if not match:
                continue
            index = int(match[1], 16)
            if match[2] is None:
                heads[index] = section
            else:
                subs.setdefault(index, {})[int(match[2], 16)] = section
        objects: dict[int, Object] = {}
        for index in sorted(heads.keys() | subs.keys()):
            objects[index] = self.object(index, heads.get(index), subs.get(index, {}))
        if not objects:
            raise EdsError(f"{self.path}:1: no object is described; expected sections such as [1000], is it an EDS?")
        device = self.sections.get("deviceinfo", _Section("DeviceInfo", 1))
        info = {device.spelled[key]: value for key, (value, _) in device.entries.items()}
        dummy = self.sections.get("dummyusage", _Section("DummyUsage", 1))
        used = (code for code in range(1, 8) if self.integer(dummy, f"dummy{code:04x}", 0))
        return Description(
            self.path,
            self.text,
            MappingProxyType(objects),
            tuple(sorted(self.diagnoses, key=lambda d: d.line)),
            MappingProxyType(info),
            frozenset(used),
        )

    def object(self, index: int, head: _Section | None, subs: dict[int, _Section]) -> Object:
        if head is None:
            first = next(iter(subs.values()))
            head = _Section(f"{index:04X}", first.line)
            self.say(first.line, f"[{first.name}] has no section [{index:04X}]", "RECORD assumed", "error")
            head.entries["objecttype"] = ("9", first.line)
        name = head.get("parametername") or f"{index:04X}"
        if not head.get("parametername") and head.entries:
            self.say(head.line, f"[{head.name}] has no ParameterName", f"'{name}' assumed")
        compact = self.integer(head, "compactsubobj", 0) or 0
        kind = self.object_type(head, subs, compact)
        if kind in (VAR, DOMAIN) and not subs:
            return Object(index, name, kind, MappingProxyType({0: self.variable(index, 0, head, name, kind)}))
        variables = dict(self.compact(index, head, name, compact)) if compact else {}
        for subindex in sorted(subs):
            section = subs[subindex]
            own = section.get("parametername")
            if not own:
                own = f"{name} {subindex}"
                self.say(section.line, f"[{section.name}] has no ParameterName", f"'{own}' assumed")
            variables[subindex] = self.variable(index, subindex, section, own, kind)
        return Object(index, name, kind, MappingProxyType(dict(sorted(variables.items()))))

    def object_type(self, head: _Section, subs: dict[int, _Section], compact: int) -> int:
        text = _COMMENT.sub("", head.get("objecttype")).strip().upper()
        names = {"VAR": VAR, "ARRAY": ARRAY, "RECORD": RECORD, "DOMAIN": DOMAIN}
        guess = RECORD if subs else ARRAY if compact else VAR
        if text in names:
            self.say(head.at("objecttype"), f"[{head.name}] ObjectType={text} is no number", f"0x{names[text]:X} read")
            return names[text]
        kind = self.integer(head, "objecttype", guess) or guess
        if kind in (VAR, DOMAIN) and subs:
            self.say(head.line, f"[{head.name}] is ObjectType {kind} but has sub-indices", f"{guess} assumed")
            return guess
        return kind

    def compact(self, index: int, head: _Section, name: str, count: int) -> Iterator[tuple[int, Variable]]:
        yield 0, Variable(index, 0, "Highest sub-index supported", 5, "ro", count, False, None, None, False, head.line)
        names = self.sections.get(f"{head.name.lower()}name", _Section("", head.line))
        for subindex in range(1, count + 1):
            own = names.get(str(subindex)) or f"{name}{subindex}"
            yield subindex, self.variable(index, subindex, head, own, ARRAY)

    def variable(self, index: int, subindex: int, section: _Section, name: str, kind: int) -> Variable:
        guess = 0x000F if kind == DOMAIN else 0x0005 if subindex == 0 and kind in (ARRAY, RECORD) else 0
        code = self.integer(section, "datatype", guess, wanted=kind != DOMAIN) or guess
        access = section.get("accesstype").lower() or "rw"
        mappable = bool(self.integer(section, "pdomapping", 0))
        default, relative, unreadable = self.value(section, "defaultvalue", code)
        low, _, _ = self.value(section, "lowlimit", code)
        high, _, _ = self.value(section, "highlimit", code)
        return Variable(
            index,
            subindex,
            name,
            code,
            access,
            default,
            relative,
            low if isinstance(low, int | float) else None,
            high if isinstance(high, int | float) else None,
            mappable,
            section.line,
            unreadable,
        )

    def value(self, section: _Section, key: str, code: int) -> tuple[Value, bool, str]:
        text = section.get(key)
        data_type = DATA_TYPES.get(code)
        kind = data_type.kind if data_type else "int"
        line, what = section.at(key), f"[{section.name}] {section.spelled.get(key, key)}"
        if kind in ("text", "unicode"):
            return (text if key in section.entries else None), False, ""
        if not text or kind in ("domain", "record"):
            return None, False, ""
        if kind == "bytes":
            try:
                return bytes.fromhex(text.removeprefix("0x")), False, ""
            except ValueError:
                return text.encode("latin-1", "replace"), False, ""
        if kind == "real":
            try:
                return float(_COMMENT.sub("", text)), False, ""
            except ValueError:
                pass
        terms = [term.strip() for term in _COMMENT.sub("", text).strip("() ").split("+")]
        relative = any(term.upper() == "$NODEID" for term in terms)
        numbers = [self.number(term, line, what) for term in terms if term.upper() != "$NODEID"]
        if any(number is None for number in numbers):
            unreadable = f"{what}={text} is no number"
            self.say(line, unreadable, "no value assumed", "error")
            return None, False, unreadable
        number = sum(n for n in numbers if n is not None)
        if kind == "real" and data_type:
            raw = number.to_bytes(data_type.bits // 8, "little")
            return struct.unpack("<f" if data_type.bits == 32 else "<d", raw)[0], False, ""
        if data_type and data_type.bits and data_type.signed and number >= 1 << (data_type.bits - 1):
            number -= 1 << data_type.bits
        return number, relative, ""


def read_eds(path: str | Path) -> Description:
    """Read an EDS or DCF file; see `Description.diagnoses` for what was wrong with it."""
    return _Reader(Path(path)).build()
