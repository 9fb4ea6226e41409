"""The first step of reading an EDS file: bytes to text, text to sections with the line of every key.

Whatever is tolerated here - code pages, doubled sections and keys, comments behind values, heads without a bracket - is said.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from eds.description import Diagnosis, Severity

__all__ = ["OBJECT_SECTION", "PDO_PARAMETERS", "Number", "Section", "SectionReader", "number_of"]

PDO_PARAMETERS = range(0x1400, 0x1C00)


@dataclass(frozen=True)
class Number:
    """A number as written: its value, a complaint about the notation, and whether it could mean another value."""

    value: int
    complaint: str = ""
    doubtful: bool = False
    hexadecimal: bool = False


def number_of(text: str) -> Number | None:
    """Read ``0x1F``, ``31``, ``-31``; also ``1Fh``, ``1F``, ``031``. None where it is no number."""
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
        return Number(sign * int(low, 16), "has hexadecimal digits without 0x", hexadecimal=True)
    return None


def _same(first: str, second: str) -> bool:
    a, b = number_of(_COMMENT.sub("", first)), number_of(_COMMENT.sub("", second))
    return a.value == b.value if a and b else first.lower() == second.lower()


@dataclass
class Section:
    """Keys in lower case with value and line; `conflicts` are keys that stand twice with different values."""

    name: str
    line: int
    entries: dict[str, tuple[str, int]] = field(default_factory=dict)
    spelled: dict[str, str] = field(default_factory=dict)
    conflicts: set[str] = field(default_factory=set)
    reopened: bool = False

    def get(self, key: str) -> str:
        """Return the key's value as written; empty when it is absent."""
        return self.entries.get(key, ("", 0))[0]

    def at(self, key: str) -> int:
        """Return the key's line, or the section's."""
        return self.entries.get(key, ("", self.line))[1]

    def what(self, key: str) -> str:
        """Return the key as a diagnosis names it."""
        return f"[{self.name}] {self.spelled.get(key, key)}"

    @property
    def pdo_parameter(self) -> bool:
        """True for the sections of 1400h to 1BFFh, where nothing may be assumed."""
        match = OBJECT_SECTION.fullmatch(self.name)
        return match is not None and int(match[1], 16) in PDO_PARAMETERS


OBJECT_SECTION = re.compile(r"(?:0x)?([0-9a-f]{1,4})(?:\s*sub(?:index)?\s*([0-9a-f]{1,2}))?", re.IGNORECASE)
_COMMENT = re.compile(r"\s*[;#].*$")


class SectionReader:
    """Sections of a file's bytes `raw`; `path` names it in diagnoses."""

    def __init__(self, path: str, raw: bytes) -> None:
        self.path = path
        self.diagnoses: list[Diagnosis] = []
        self.sections: dict[str, Section] = {}
        self.text = self.decode(raw)
        self.split()

    def say(self, line: int, text: str, assumed: str, severity: Severity = "warning") -> None:
        """Note a defect, and what is assumed instead."""
        self.diagnoses.append(Diagnosis(self.path, line, severity, text, assumed))

    def decode(self, raw: bytes) -> str:
        """Return the text: UTF-8, UTF-16 by its mark, or else Windows-1252."""
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
        """Split the text into sections; what is neither head nor key is a comment."""
        section: Section | None = None
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

    def open_section(self, line: str, number: int) -> Section:
        """Return the section that a head names; a second head of one name goes on with the first."""
        name, bracket, rest = line[1:].partition("]")
        name = name.strip()
        if not bracket:
            name = _COMMENT.sub("", name)
            self.say(number, f"the section head '{line[:40]}' has no ']'", f"[{name}]")
        elif rest.strip() and rest.strip()[0] not in ";#":
            self.say(number, f"'{rest.strip()[:40]}' stands behind the section head [{name}]", "a comment")
        match = OBJECT_SECTION.fullmatch(name)
        key = name.lower()
        if match:  # one key for [1018sub1], [1018Sub01] and [0x1018sub1]
            key = f"{int(match[1], 16):04x}" + (f"sub{int(match[2], 16):x}" if match[2] else "")
        known = self.sections.get(key)
        if known is not None:
            self.say(number, f"the section [{name}] stands in line {known.line} already", "one section, first values")
            known.reopened = True
            return known
        return self.sections.setdefault(key, Section(name, number))

    def enter(self, section: Section, spelled: str, value: str, number: int) -> None:
        """Enter a key; of doubled keys the first value counts, and a conflict is kept in mind."""
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

    def bare(self, section: Section, key: str) -> str:
        """Return a value without the comment behind it."""
        text = section.get(key)
        bare = _COMMENT.sub("", text).strip()
        if bare != text:
            self.say(section.at(key), f"{section.what(key)}={text} has a comment behind the value", bare or "no value")
            section.entries[key] = (bare, section.at(key))
        return bare

    def integer(self, section: Section, key: str, assumed: int) -> int:
        """Return a key's number; `assumed` where it is absent or empty (not said) or no number (said)."""
        text = self.bare(section, key)
        if not text:
            return assumed
        number = number_of(text)
        if number is None:
            self.say(section.at(key), f"{section.what(key)}={text} is no number", str(assumed), "error")
            return assumed
        if number.complaint:
            self.say(section.at(key), f"{section.what(key)}={text} {number.complaint}", str(number.value))
        return number.value

    # Sections to objects.
