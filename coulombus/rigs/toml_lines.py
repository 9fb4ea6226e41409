"""Read TOML with the line of every key, and continue after a line that cannot be read.

`tomllib` gives the values, but it stops at the first error and has no line numbers. A light scan finds the line of each
key, and a statement that `tomllib` refuses is blanked, so that one pass reports every error.
`of_another_kind` detects a document of another kind: a rig, faults, a script, a sweep or a study.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from coulombus.eds.regular_file import read_regular

__all__ = [
    "MOST_CHARACTERS",
    "Document",
    "Key",
    "Table",
    "of_another_kind",
    "read_text",
    "read_toml",
    "split_key",
    "value_at",
]


Key: TypeAlias = tuple[str | int, ...]
"""Path of a value: ("mode", "active", "F_s_Nm"), or ("phase", 1, "kind") in an array of tables."""

Table: TypeAlias = Mapping[str, Any]
"""A table of a TOML file."""

MOST_ERRORS = 50
MOST_CHARACTERS, MOST_LINES = 1 << 24, 10_000
MOST_LETTERS, MOST_PARTS, MOST_NESTED = 500, 16, 32

_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_DOTTED = rf"{_PART}(?:\s*\.\s*{_PART})*"
_KEY = re.compile(rf"\s*({_DOTTED})\s*=(.*)")
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_DOTTED})\s*\]\]?\s*(?:#.*)?$")
_AT_LINE = re.compile(r"\s*\(at line (\d+), column (\d+)\)$|\s*\(at end of document\)$")

_TOKENS = re.compile(
    r'''"""(?:[^\\]|\\.)*?"""|'{3}.*?'{3}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|\#[^\n]*'''
    rf"|(?P<dotted>(?:[A-Za-z0-9_-]{{1,99}}[ \t]?\.[ \t]?){{{MOST_PARTS}}})"
    rf"|(?P<word>[A-Za-z0-9_+-]{{{MOST_LETTERS}}})|[A-Za-z0-9_+-]+|(?P<opening>[\[{{])|(?P<closing>[\]}}])",
    re.DOTALL,
)
"""Texts and comments, words, and brackets."""

_HINTS = (
    (r"$|#", "a value behind the ="),
    (r"[+-]?\d+,\d", "a decimal point instead of the comma"),
    (r"(?i:true|false|yes|no|on|off)\b", "true or false, in small letters"),
    (r"[+-]?\.\d|[+-]?\d+\.(\D|$)", "digits on both sides of the decimal point"),
    (r"[+-]?0\d", "a number without leading zeros"),
    (r"[+-]?[\d._]+(e[+-]?\d+)?\s*[A-Za-z%°µ]", "a number alone: leave the unit off, which stands in the key's name"),
    (r"[A-Za-z_./~]", "a text in double quotes"),
    (r"\[", "a list of values with commas between them and a closing ]"),
    (r"\"|'", "a text with a closing quote"),
)


@dataclass
class Document:
    """A TOML file's values, the lines of its keys, and the errors.

    `lines` holds the keys and the sections' headers; `broken` the keys and sections with an unreadable statement (they
    are not missing); `problems` are (line, text) in the file's order.
    """

    values: dict[str, Any] = field(default_factory=dict)
    lines: dict[Key, int] = field(default_factory=dict)
    broken: set[Key] = field(default_factory=set)
    problems: list[tuple[int, str]] = field(default_factory=list)

    def line(self, key: Key) -> int:
        """Return the line of the key, else of the first key in it, else of its nearest parent, else 1."""
        for length in range(len(key), 0, -1):
            part = key[:length]
            inside = [line for place, line in self.lines.items() if place[:length] == part]
            if inside:
                return self.lines.get(part, min(inside))
        return 1

    def is_broken(self, key: Key) -> bool:
        """Return whether the key, or a parent section, is in an unreadable statement."""
        return any(key[:length] in self.broken for length in range(len(key) + 1))


@dataclass(frozen=True)
class _Statement:
    first: int  # 0-based index of its first line
    last: int
    key: Key
    header: bool
    text: str
    closed: bool = True


def split_key(dotted: str) -> list[str] | None:
    """Split "a.b.'c d'" into its parts; None if it is not a TOML key."""
    if not re.fullmatch(rf"\s*{_DOTTED}\s*", dotted):
        return None
    return [part[1:-1] if part[0] in "\"'" else part for part in re.findall(_PART, dotted)]


def value_at(values: Mapping[str, Any], key: Iterable[str | int]) -> Any:
    """Return the value of a key within tables; None if absent."""
    value: Any = values
    for part in key:
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _excess(text: str) -> tuple[int, str] | None:
    """Return line and text of the first construct that no valid file has and that would take minutes to parse."""
    if len(text) > MOST_CHARACTERS:
        return 1, f"{len(text)} characters; expected at most {MOST_CHARACTERS}"
    if text.count("\n") > MOST_LINES:
        return MOST_LINES + 1, f"{text.count(chr(10))} lines; expected at most {MOST_LINES}"
    depth = 0
    for token in _TOKENS.finditer(text):
        what = token.lastgroup
        if what is None:  # a string or a comment
            continue
        depth += (what == "opening") - (what == "closing" and depth > 0)
        if what in ("word", "dotted") or depth > MOST_NESTED:
            line = text.count("\n", 0, token.start()) + 1
            reasons = {
                "word": f"a number or a name of more than {MOST_LETTERS} characters; expected a shorter one",
                "dotted": f"a key of more than {MOST_PARTS} parts; expected SECTION.KEY",
            }
            nested = f"more than {MOST_NESTED} brackets within each other; expected a list of values"
            return line, f"'{_short(token[0])}' begins {reasons[what]}" if what in reasons else nested
    return None


def read_text(path: Path, kind: str, error: type[Exception]) -> str:
    """Return the text of the file `path`, a `kind`; raise `error` with the reason if it cannot be read."""
    try:
        raw = read_regular(path, MOST_CHARACTERS)
    except OSError as reason:
        raise error(f"{path}: the {kind} cannot be read ({reason.strerror or reason})") from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        line = raw.count(b"\n", 0, reason.start) + 1
        raise error(f"{path}:{line}: byte {raw[reason.start]:02X}h is not UTF-8; save the file as UTF-8") from None


def read_toml(text: str) -> Document:
    """Read `text`; nothing is raised, see `Document.problems`.

    Parsing is cached, because each run needs a rig's text several times. The caller gets its own copy of the document.
    """
    parsed = _parsed(text)
    return Document(_copied(parsed.values), {**parsed.lines}, {*parsed.broken}, [*parsed.problems])


def _copied(value: Any) -> Any:
    """Return a copy of TOML's tables and lists; the leaves are immutable."""
    if isinstance(value, dict):
        return {key: _copied(entry) for key, entry in value.items()}
    return [_copied(entry) for entry in value] if isinstance(value, list) else value


@lru_cache(maxsize=4)
def _parsed(text: str) -> Document:
    excess = _excess(text)
    if excess is not None:
        return Document(broken={()}, problems=[excess])
    lines = text.replace("\r\n", "\n").split("\n")
    document = Document()
    for _ in range(max(3, min(MOST_ERRORS, 50_000 // len(lines)))):
        try:
            document.values = tomllib.loads("\n".join(lines))
            break
        except (ValueError, RecursionError) as error:  # a number of 5,000 digits is a plain ValueError
            before = list(lines)
            _blame(document, lines, str(error))
            if lines == before:
                document.broken.add(())
                break
    else:
        document.broken.add(())
    document.problems.sort()
    for statement in _statements(lines):
        document.lines.setdefault(statement.key, statement.first + 1)
    return document


def _blame(document: Document, lines: list[str], message: str) -> None:
    """Report the statement of tomllib's `message`, and blank it."""
    place = _AT_LINE.search(message)
    number = int(place[1]) - 1 if place and place[1] else len(lines) - 1
    reason = _AT_LINE.sub("", message).lower()
    statements = _statements(lines)
    holding = [s for s in statements if s.first <= number and (s.first <= number <= s.last or not s.closed)]
    guilty = next((s for s in holding if not s.closed), holding[-1] if holding else None)
    if guilty is None or guilty.header:
        _blame_line(document, lines, number, reason, guilty, statements)
        return
    last = guilty.first  # an unclosed list spans valid keys
    while last < number and not (_KEY.match(lines[last + 1]) or _HEADER.match(lines[last + 1])):
        last += 1
    name = ".".join(map(str, guilty.key))
    earlier = next((s for s in statements if s.key == guilty.key and s.first < guilty.first), None)
    if earlier:
        text = f"{name}: is in line {earlier.first + 1} already; expected each key once"
    else:
        document.broken.add(guilty.key)
        hint = next((hint for pattern, hint in _HINTS if re.match(pattern, guilty.text)), "a TOML value")
        text = f"{name}: '{_short(guilty.text)}' cannot be read ({reason}); expected {hint}"
    document.problems.append((guilty.first + 1, text))
    _blank(lines, guilty.first, last)


def _blame_line(
    document: Document,
    lines: list[str],
    number: int,
    reason: str,
    header: _Statement | None,
    statements: list[_Statement],
) -> None:
    """Report a header, with its section, or a line that is not a statement."""
    if not lines[number].strip():  # tomllib reports an unclosed quote at the file's end
        covered = {n for s in statements for n in range(s.first, s.last + 1)}
        junk = (n for n, line in enumerate(lines) if n not in covered and line.strip() and line.lstrip()[0] != "#")
        number = next(junk, number)
    text = lines[number].strip()
    names = tuple(re.findall(r"[\w-]+", text))
    if not (text.startswith("[") or re.match(r"[\w.-]+\]", text)):
        expected = "key = value, [section] or a comment after #"
        document.problems.append((number + 1, f"'{_short(text)}' cannot be read; expected {expected}"))
        document.broken.add((*_section(statements, number), *names[:1]))
        _blank(lines, number, number)
        return
    last = min((s.first for s in statements if s.header and s.first > number), default=len(lines)) - 1
    earlier = next((s for s in statements if header and s.key == header.key and s.first < number), None)
    if earlier:
        document.problems.append((number + 1, f"{text}: is in line {earlier.first + 1} already; expected it once"))
        document.broken.update(s.key for s in statements if number < s.first <= last)
    else:
        why = f" ({reason})" if header else ""
        document.problems.append((number + 1, f"'{_short(text)}' cannot be read{why}; expected [section]"))
        document.broken.add(header.key if header else names)
    _blank(lines, number, last)


def _section(statements: list[_Statement], number: int) -> Key:
    return next((s.key for s in reversed(statements) if s.header and s.first < number), ())


def _blank(lines: list[str], first: int, last: int) -> None:
    lines[first : last + 1] = [""] * (last + 1 - first)


def _without_comment(text: str) -> str:
    """Return the value on a line; a # within quotes is part of it."""
    quote = ""
    for i, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == "#":
            return text[:i].strip()
    return text.strip()


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def _statements(lines: list[str]) -> list[_Statement]:
    """Find keys and headers; a value ends on the line that closes its brackets and quotes."""
    statements: list[_Statement] = []
    section: Key = ()
    tables: dict[Key, int] = {}  # arrays of tables and the index of their last one
    number = 0
    while number < len(lines):
        header, key = _HEADER.match(lines[number]), _KEY.match(lines[number])
        first = number
        if header:
            section = ()
            parts = split_key(header[2]) or []
            for i, part in enumerate(parts):
                section = (*section, part)
                if header[1] == "[[" and i == len(parts) - 1:
                    tables[section] = tables.get(section, -1) + 1
                if section in tables:
                    section = (*section, tables[section])
            statements.append(_Statement(first, first, section, True, lines[first].strip()))
        elif key:
            depth, quote = _scan(key[2], 0, "")
            while (depth > 0 or quote) and number + 1 < len(lines):
                number += 1
                depth, quote = _scan(lines[number], depth, quote)
            path = (*section, *(split_key(key[1]) or []))
            closed = depth <= 0 and not quote
            statements.append(
                _Statement(first, number if closed else first, path, False, _without_comment(key[2]), closed)
            )
            if not closed:  # do not hide later keys
                number = first
        number += 1
    return statements


def _scan(text: str, depth: int, quote: str) -> tuple[int, str]:
    """Track brackets and quotes through one line.

    Return the depth and the open multi-line quote.
    """
    i = 0
    while i < len(text):
        if quote:
            if quote[0] == '"' and text[i] == "\\":
                i += 2
            elif text.startswith(quote, i):
                i += len(quote)
                quote = ""
            else:
                i += 1
        elif text[i] == "#":
            break
        elif text[i] in "\"'":
            quote = text[i] * (3 if text.startswith(text[i] * 3, i) else 1)
            i += len(quote)
        else:
            depth += (text[i] in "[{") - (text[i] in "]}")
            i += 1
    return depth, quote if len(quote) == 3 else ""


class FileKind(NamedTuple):
    """Name of a kind of file, how it is passed, and keys of which it has at least one."""

    name: str
    given_by: str
    keys: frozenset[str]


KINDS: Mapping[str, FileKind] = MappingProxyType(
    {
        "rig": FileKind("a rig file", "--rig FILE", frozenset({"mechanics", "motor", "brake", "axis"})),
        "faults": FileKind("a fault file", "--faults FILE", frozenset({"fault", "controller", "noise"})),
        "script": FileKind("a script", "--script FILE", frozenset({"at"})),
        "sweep": FileKind("a sweep", "coulombus sweep FILE", frozenset({"vary", "design"})),
        "study": FileKind("a study", "coulombus experiment FILE", frozenset({"method", "question", "condition"})),
    }
)


def of_another_kind(values: Mapping[str, Any], kind: str) -> str | None:
    """Return the kind of a document that is not of `kind`, and how to pass it; None if it may be of `kind`."""
    if KINDS[kind].keys & values.keys():
        return None
    other = next((candidate for candidate in KINDS.values() if candidate.keys & values.keys()), None)
    if other is None:
        return None
    return f"this is {other.name} ({other.given_by}); expected {KINDS[kind].name} ({KINDS[kind].given_by})"
