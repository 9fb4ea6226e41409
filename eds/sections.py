"""First step of reading an EDS file: bytes to text, text to sections with the line of every key.

Every tolerated defect (code pages, doubled sections and keys, comments after values, heads without
a bracket) is reported.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

from coulombus.eds.description import Diagnosis, Severity

__all__ = ["OBJECT_SECTION", "PDO_PARAMETERS", "EdsSection", "Number", "SectionReader", "alike", "cut", "number_of"]

PDO_PARAMETERS = range(0x1400, 0x1C00)
MOST_QUOTED = 60
"""Largest number of characters that a diagnosis quotes from the file."""
MOST_ALIKE = 20
"""Largest number of diagnoses of one kind that are listed one by one.

More of them become one line with their number.
"""
MOST_DIGITS = 40
"""A longer digit string is not a number: no data type is so wide."""


@dataclass(frozen=True)
class Number:
    """A number as written: its value, a complaint about the notation, and whether another reading is
    possible.
    """

    value: int
    complaint: str = ""
    doubtful: bool = False
    hexadecimal: bool = False


def cut(text: str) -> str:
    """Return a text of the file as quoted in a diagnosis: its beginning if it is long."""
    return text if len(text) <= MOST_QUOTED else f"{text[: MOST_QUOTED - 3]}..."


@lru_cache(maxsize=4096)
def number_of(text: str) -> Number | None:
    """Read ``0x1F``, ``31``, ``-31``; also ``1Fh``, ``1F``, ``031``. None if it is not a number."""
    if len(text) > MOST_DIGITS:
        return None
    low = text.lower()
    sign, low = (-1, low[1:]) if low[:1] == "-" else (1, low.removeprefix("+"))
    if re.fullmatch(r"0x[0-9a-f]+", low):
        return Number(sign * int(low, 16), hexadecimal=True)
    if re.fullmatch(r"[0-9]+", low):
        value = sign * int(low)
        if len(low) == 1 or low[0] != "0":
            return Number(value)
        octal = re.fullmatch(r"[0-7]+", low) and sign * int(low, 8) != value
        return Number(value, "is zero-padded, which may mean octal" if octal else "is zero-padded", bool(octal))
    if re.fullmatch(r"[0-9][0-9a-f]*h", low):
        return Number(sign * int(low[:-1], 16), "has an 'h' instead of 0x", hexadecimal=True)
    if re.fullmatch(r"[0-9a-f]+", low):
        otherwise = re.fullmatch(r"[0-9]+e[0-9]+|0b[01]+", low)  # a power of ten, a binary number
        complaint = "has hexadecimal digits without 0x" + (", which may mean another number" if otherwise else "")
        return Number(sign * int(low, 16), complaint, bool(otherwise), hexadecimal=True)
    return None


def _same(first: str, second: str) -> bool:
    a, b = number_of(_without_comment(first)), number_of(_without_comment(second))
    return a.value == b.value if a and b else first.lower() == second.lower()


@dataclass
class EdsSection:
    """Keys in lower case with value and line; `conflicts` are keys that occur twice with different values."""

    name: str
    line: int
    entries: dict[str, tuple[str, int]] = field(default_factory=dict)
    spelled: dict[str, str] = field(default_factory=dict)
    conflicts: set[str] = field(default_factory=set)
    reopened: bool = False
    index: int = -1
    """Object of an object's section; -1 for any other section."""
    subindex: int = -1
    """Sub-index of the section; -1 for the object's main section."""

    def get(self, key: str) -> str:
        """Return the key's value as written; empty if absent."""
        return self.entries.get(key, ("", 0))[0]

    def shown(self, key: str) -> str:
        """Return the key's value as quoted in a diagnosis."""
        return cut(self.get(key))

    def at(self, key: str) -> int:
        """Return the key's line, or the section's."""
        return self.entries.get(key, ("", self.line))[1]

    def what(self, key: str) -> str:
        """Return the key's name in a diagnosis."""
        return f"[{self.name}] {cut(self.spelled.get(key, key))}"

    def numbered(self) -> dict[int, str]:
        """Return the numeric keys by number: sub-indices of [1003Name], entries of a list."""
        return {int(key): key for key in reversed(self.entries) if key.isdecimal() and len(key) <= MOST_DIGITS}

    @property
    def pdo_parameter(self) -> bool:
        """Whether the section is one of 1400h to 1BFFh, where nothing may be assumed."""
        if self.index >= 0:
            return self.index in PDO_PARAMETERS
        match = OBJECT_SECTION.fullmatch(re.sub("(?i)value$", "", self.name))
        return match is not None and int(match[1], 16) in PDO_PARAMETERS


OBJECT_SECTION = re.compile(
    r"(?:0x)?0*([0-9a-f]{1,4})(?:[\s_]*sub(?:index)?[\s_]*(?:0x)?0*([0-9a-f]{1,2}))?", re.IGNORECASE
)
_STRICT = re.compile(r"([0-9a-f]{1,4})(?:sub([0-9a-f]{1,2}))?")
"""Pattern of an object's section name in lower case."""
_REST = "\x00\x1a\ufeff"
"""Characters that editors and copies leave at the ends of lines and files."""
_LINE_END = re.compile(r"\r*\n|\r")


def _without_comment(text: str) -> str:
    if ";" not in text and "#" not in text:
        return text
    comment = re.search(r";|(?<!\S)#", text)
    return text[: comment.start()].rstrip() if comment else text


def alike(diagnoses: Iterable[Diagnosis]) -> Iterator[Diagnosis]:
    """Yield diagnoses by their lines.

    Many diagnoses of one kind, which differ in names and numbers only, become one with their number.
    """
    kinds: dict[tuple[str, str], list[Diagnosis]] = {}
    for diagnosis in diagnoses:
        kinds.setdefault((diagnosis.severity, _DETAILS.sub("", diagnosis.text)), []).append(diagnosis)
    for kind in kinds.values():
        first, last = min(kind, key=_line), max(kind, key=_line)
        if len(kind) <= MOST_ALIKE:
            yield from kind
        else:
            yield replace(first, text=f"{first.text} (and {len(kind) - 1} more like this, up to line {last.line})")


def _line(diagnosis: Diagnosis) -> int:
    return diagnosis.line


_DETAILS = re.compile(r"\[[^\]]*\]|'[^']*'|=\S*|\b(?:0x)?[0-9A-Fa-f]*\d[0-9A-Fa-f]*h?\b")
"""Parts that differ between diagnoses of one kind: sections, quotations, values, numbers."""


class SectionReader:
    """Sections of a file's bytes `raw`; `path` names it in diagnoses."""

    def __init__(self, path: str, raw: bytes) -> None:
        self.path = path
        self.diagnoses: list[Diagnosis] = []
        self.sections: dict[str, EdsSection] = {}
        self.text = self.decode(raw)
        self.split()

    def say(self, line: int, text: str, assumed: str, severity: Severity = "warning") -> None:
        """Record a defect, and the value assumed instead."""
        self.diagnoses.append(Diagnosis(self.path, line, severity, text, assumed))

    def decode(self, raw: bytes) -> str:
        """Return the text: UTF-8, UTF-16 by its byte order mark or its zeros, else Windows-1252."""
        wide = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}.get(raw[:2], "")
        if not wide and any(raw[:2]) and 3 * raw.count(0) > len(raw):  # ASCII with two bytes per character
            wide = "utf-16-be" if raw[0] == 0 else "utf-16-le"
        if wide:
            self.say(1, "the file is UTF-16, not ASCII", "UTF-16")
            return self.replaced(raw, wide)
        try:
            return raw.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = len(_LINE_END.findall(raw[: error.start].decode("latin-1"))) + 1
            self.say(line, "the file is neither ASCII nor UTF-8", "Windows-1252")
            return self.replaced(raw, "cp1252")

    def replaced(self, raw: bytes, encoding: str) -> str:
        """Decode; replace invalid bytes by U+FFFD, and report them."""
        text = raw.decode(encoding, "replace")
        if "\ufffd" in text:
            line = len(_LINE_END.findall(text[: text.index("\ufffd")])) + 1
            self.say(line, "invalid bytes for this encoding", "the character U+FFFD")
        return text

    # Lines to sections.

    def split(self) -> None:
        """Split the text into sections; a line that is neither head nor key is a comment."""
        section: EdsSection | None = None
        lowered: dict[str, str] = {}  # the same few keys occur again and again
        for number, raw in enumerate(_LINE_END.split(self.text), 1):
            line = raw.strip()
            if not line:
                continue
            if line[0] in _REST or line[-1] in _REST:
                line = line.strip(_REST)
                if not line:
                    continue
            first = line[0]
            if first in ";#":
                continue
            if first == "[":
                section = self.open_section(line, number)
                continue
            spelled, equals, value = line.partition("=")
            spelled = spelled.strip()
            if section is None:
                self.say(number, f"'{line[:40]}' comes before the first section", "a comment")
            elif not equals or not spelled:
                self.say(number, f"'{line[:40]}' is not key=value", "a comment")
            else:
                key = lowered.get(spelled)
                if key is None:
                    key = lowered[spelled] = spelled.lower()
                if key in section.entries:
                    self.enter_again(section, key, spelled, value.strip(), number)
                else:
                    section.entries[key] = (value.strip(), number)
                    section.spelled[key] = spelled

    def open_section(self, line: str, number: int) -> EdsSection:
        """Return the section of a head; a second head with the same name continues the first section."""
        name, bracket, rest = line[1:].partition("]")
        name = name.strip()
        if not bracket:
            name = _without_comment(name)
            self.say(number, f"the section head '{line[:40]}' has no ']'", f"[{cut(name)}]")
        elif rest.strip() and rest.strip()[0] not in ";#":
            self.say(number, f"'{rest.strip()[:40]}' follows the section head [{cut(name)}]", "a comment")
        index = subindex = -1
        key = name.lower()
        strict = _STRICT.fullmatch(key)
        match = strict or OBJECT_SECTION.fullmatch(name)
        if match:  # one key for [1018sub1], [1018Sub01] and [0x1018sub1]
            index, subindex = int(match[1], 16), int(match[2], 16) if match[2] else -1
            key = f"{index:04x}" if subindex < 0 else f"{index:04x}sub{subindex:x}"
        if match and not strict:
            usual = f"{index:04X}" if subindex < 0 else f"{index:04X}sub{subindex:X}"
            self.say(number, f"the section head [{cut(name)}] does not follow CiA 306", f"[{usual}]")
        earlier = self.sections.get(key)
        if earlier is not None:
            self.say(
                number, f"the section [{cut(name)}] is in line {earlier.line} already", "one section, first values"
            )
            earlier.reopened = True
            return earlier
        return self.sections.setdefault(key, EdsSection(cut(name), number, index=index, subindex=subindex))

    def enter_again(self, section: EdsSection, key: str, spelled: str, value: str, number: int) -> None:
        """Handle a repeated key: the first value counts, and a conflict is recorded."""
        first, line = section.entries[key]
        if _same(first, value):
            if not section.reopened:
                self.say(number, f"[{section.name}] {cut(spelled)} is in line {line} already", "the same")
            return
        if key != "parametername":
            section.conflicts.add(key)
        severity: Severity = "error" if key in ("defaultvalue", "parametervalue") else "warning"
        text = f"[{section.name}] {cut(spelled)}={cut(value)}, but line {line} says {cut(first) or 'nothing'}"
        self.say(number, text, f"the first, {cut(first) or 'nothing'}", severity)

    def bare(self, section: EdsSection, key: str) -> str:
        """Return a value without the comment after it."""
        entry = section.entries.get(key)
        if entry is None or entry[0].isalnum():  # the usual case
            return "" if entry is None else entry[0]
        text = entry[0]
        if not text:
            return text
        bare = _without_comment(text)
        if bare != text:
            self.say(
                section.at(key),
                f"{section.what(key)}={cut(text)} has a comment after the value",
                cut(bare) or "no value",
            )
            section.entries[key] = (bare, section.at(key))
        if len(bare) > 1 and bare[0] == bare[-1] == '"':
            self.say(
                section.at(key),
                f"{section.what(key)}={cut(bare)} is in quotes",
                cut(bare[1:-1].strip()) or "no value",
            )
            bare = bare[1:-1].strip()
            section.entries[key] = (bare, section.at(key))
        return bare

    def integer(self, section: EdsSection, key: str, assumed: int) -> int:
        """Return a key's number; `assumed` if it is absent or empty (not reported) or no number (reported)."""
        text = self.bare(section, key)
        if not text:
            return assumed
        number = number_of(text)
        if number is None:
            self.say(section.at(key), f"{section.what(key)}={cut(text)} is not a number", str(assumed), "error")
            return assumed
        if number.complaint:
            self.say(section.at(key), f"{section.what(key)}={cut(text)} {number.complaint}", str(number.value))
        return number.value

    # Sections to objects.
