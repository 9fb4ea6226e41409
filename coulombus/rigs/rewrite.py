"""Change single values of a rig file in place: every other line, comment and blank stays.

The new value replaces the old one. The comment at the line's end stays, in its column if possible, and a line above it
states the value's source. A new key is inserted below the header of its section; a missing section is appended to the
file. A `# CHECK:` above a key marks an unverified guess (`rigs.draft.draft_text`): a measured value removes it.
"""

from __future__ import annotations

import re
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coulombus.eds.regular_file import read_regular
from coulombus.rigs.draft.draft_text import CHECK
from coulombus.rigs.errors import RigError, dotted, toml_value
from coulombus.rigs.toml_lines import MOST_CHARACTERS, Document, Key, read_toml
from coulombus.system.unfinished_file import write_whole

__all__ = ["NewValue", "replace_file", "rewritten"]

_ASSIGNMENT = re.compile(r"(?P<head>\s*[^=#]*=\s*)(?P<rest>.*)")
_TEXT_OR_COMMENT = re.compile(r""""(?:[^"\\]|\\.)*"|'[^']*'|(?P<comment>\s*\#.*)""")
_GUESS = re.compile(rf"\s*#\s*{CHECK}:")
LONGEST = 200
"""Maximum lines of a statement."""
MOST_COPIES = 999


@dataclass(frozen=True)
class NewValue:
    """A value for a key, and the comment above it."""

    value: Any
    comment: str


def rewritten(text: str, values: Mapping[Key, NewValue], mark: str, path: str) -> str:
    """Return the text of a rig file with other values.

    Parameters
    ----------
    mark : beginning of these comments; an older one of the same key is replaced

    Raises
    ------
    RigError
        a key cannot be changed alone, as in an inline table
    """
    ending = "\r\n" if "\r\n" in text else "\n"
    lines = text.replace("\r\n", "\n").split("\n")
    for key, new in values.items():
        document = read_toml("\n".join(lines))
        at = document.lines.get(key)
        if at is not None:
            _replace(lines, at - 1, new, mark)
        else:
            _insert(lines, document, key, new, mark)
        _check("\n".join(lines), key, new.value, path)
    return ending.join(lines)


def _replace(lines: list[str], at: int, new: NewValue, mark: str) -> None:
    """Put the new value into the statement that begins in a line."""
    match = _ASSIGNMENT.fullmatch(lines[at])
    if match is None:
        return  # `_check` reports it
    indent = lines[at][: len(lines[at]) - len(lines[at].lstrip())]
    last = _last_line(lines, at)
    old = match["rest"] if last == at else lines[last]
    comment = _comment(old)
    value = toml_value(new.value)
    if comment and last == at:
        comment = _in_its_column(comment, len(value) - (len(old) - len(comment)))
    lines[at : last + 1] = [f"{match['head']}{value}{comment}"]
    first = at
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    comments = [line for line in lines[first:at] if not line.lstrip("# \t").startswith(mark) and not _GUESS.match(line)]
    lines[first:at] = [*comments, f"{indent}# {mark} {new.comment}"]


def _in_its_column(comment: str, longer: int) -> str:
    """Return a comment after a value that grew by so many characters: in its column if two blanks remain."""
    text = comment.lstrip()
    blanks = len(comment) - len(text)
    return " " * max(blanks - longer, min(blanks, 2)) + text


def _comment(text: str) -> str:
    """Return the comment at the end of a line, with the blanks before it."""
    return next((match["comment"] for match in _TEXT_OR_COMMENT.finditer(text) if match["comment"]), "")


def _last_line(lines: list[str], at: int) -> int:
    """Return the last line of the statement that begins in a line: the first at which it parses."""
    for last in range(at, min(at + LONGEST, len(lines))):
        document = read_toml("\n".join(lines[at : last + 1]))
        if not document.problems:
            return last
    return at


def _insert(lines: list[str], document: Document, key: Key, new: NewValue, mark: str) -> None:
    """Insert a key: below the header of its section, before the first header if the section has dotted keys only, or
    below a new header at the file's end if there is no section.
    """
    headers = {n for n, line in enumerate(lines, 1) if line.lstrip().startswith("[")}
    new_lines = [f"# {mark} {new.comment}", f"{key[-1]} = {toml_value(new.value)}"]
    at = document.lines.get(key[:-1])
    if at is not None and at in headers:
        lines[at:at] = new_lines
    elif _has(document, key[:-1]):
        length = max((n for n in range(1, len(key)) if document.lines.get(key[:n]) in headers), default=0)
        at = document.lines[key[:length]] if length else 0
        lines[at:at] = [new_lines[0], f"{dotted(key[length:])} = {toml_value(new.value)}"]
    else:
        while lines and not lines[-1].strip():
            lines.pop()
        lines += ["", f"[{dotted(key[:-1])}]", *new_lines, ""]


def _has(document: Document, key: Key) -> bool:
    """Return whether the file has something of this name."""
    here: Any = document.values
    for part in key:
        if not isinstance(here, Mapping) or part not in here:
            return False
        here = here[part]
    return True


def _check(text: str, key: Key, value: Any, path: str) -> None:
    """Refuse a text in which the key does not have the new value."""
    document = read_toml(text)
    here: Any = document.values
    for part in key:
        here = here.get(part) if isinstance(here, Mapping) else None
    expected = [list(row) if isinstance(row, tuple) else row for row in value] if isinstance(value, tuple) else value
    if document.problems or here != expected:
        name = dotted(key)
        raise RigError([f"{path}: {name} cannot be changed alone as it stands; write it by hand: {name} = {value}"])


def replace_file(path: Path, before: str, after: str, copy: Path | None = None) -> Path:
    """Replace a rig file as a whole, and return the backup of the old one.

    Parameters
    ----------
    before : its text as read; if it has changed since, it is kept
    copy : name of the backup, numbered if it exists; by default the file's own with ``.bak``

    Raises
    ------
    RigError
        the file has changed, or there are too many backups
    OSError
        as on a full disk; the file is unchanged
    """
    path = path.resolve()  # follow a symbolic link
    raw = read_regular(path, MOST_CHARACTERS)
    bom = b"\xef\xbb\xbf" if raw.startswith(b"\xef\xbb\xbf") else b""
    if raw[len(bom) :] != before.encode():
        raise RigError([f"{path}: the file was changed meanwhile; nothing is written, measure again"])
    backup = _keep(copy or path.with_name(f"{path.name}.bak"), raw)
    write_whole(path, bom + after.encode(), stat.S_IMODE(path.stat().st_mode))
    return backup


def _keep(path: Path, content: bytes) -> Path:
    """Write a backup under a free name."""
    for number in range(1, MOST_COPIES + 1):
        copy = path.with_name(f"{path.name}{number if number > 1 else ''}")
        with suppress(FileExistsError):
            write_whole(copy, content, 0o644, new=True)
            return copy
    raise RigError([f"{path}: there are {MOST_COPIES} copies of this name already; take some away"])
