"""Change single numbers of a rig file as a person would: every other line, comment and blank stays.

A new value takes the old one's place, and a comment above it says where it comes from. A key that
is not there yet is put below its section's header. A `# CHECK:` above a key is a guess that nobody
has proved (`rigs.draft.text`): with a measured value it is gone.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from coulombus.eds.regular_file import read_regular
from coulombus.rigs.draft.text import CHECK
from coulombus.rigs.mistakes import RigError
from coulombus.rigs.toml_lines import MOST_CHARACTERS, Document, Key, read_toml

__all__ = ["NewNumber", "replace_file", "with_numbers"]

_VALUE = re.compile(r"(?P<head>[^=]*=\s*)(?P<value>[-+0-9._eE]+|true|false|\"[^\"]*\")(?P<tail>\s*(?:#.*)?)")
_GUESS = re.compile(rf"\s*#\s*{CHECK}:")
_MEASURED = "measured by coulombus measure"
MOST_BACKUPS = 999


@dataclass(frozen=True)
class NewNumber:
    """A number for a key, and what its comment says behind the words "measured by coulombus
    measure".
    """

    value: float
    note: str


def with_numbers(text: str, numbers: Mapping[Key, NewNumber], path: str) -> str:
    """Return the text of a rig file with other numbers.

    Raises
    ------
    RigError
        a key stands where it cannot be changed alone, as in an inline table
    """
    ending = "\r\n" if "\r\n" in text else "\n"
    lines = text.replace("\r\n", "\n").split("\n")
    for key, number in numbers.items():
        document = read_toml("\n".join(lines))
        if key in document.lines:
            _replace(lines, document.lines[key] - 1, number)
        else:
            _insert(lines, document, key, number)
        _check("\n".join(lines), key, number.value, path)
    return ending.join(lines)


def _comment(number: NewNumber) -> str:
    return f"# {_MEASURED}{number.note}"


def _replace(lines: list[str], at: int, number: NewNumber) -> None:
    found = _VALUE.fullmatch(lines[at])
    if found is None:
        return  # `_check` tells
    indent = lines[at][: len(lines[at]) - len(lines[at].lstrip())]
    old, new = found["value"], repr(number.value)
    tail = found["tail"]
    if tail.strip() and len(new) < len(old):  # the comments of a section stand in one column
        tail = " " * (len(old) - len(new)) + tail
    elif tail.strip():
        gap = len(tail) - len(tail.lstrip())
        tail = tail[min(len(new) - len(old), max(gap - 2, 0)) :]
    lines[at] = f"{found['head']}{new}{tail}"
    first = at
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    kept = _without_marks(lines[first:at])
    lines[first:at] = [*kept, indent + _comment(number)]


def _without_marks(comments: Sequence[str]) -> list[str]:
    """Return the comments above a key without the guess and without an older measurement."""
    return [line for line in comments if not _GUESS.match(line) and _MEASURED not in line]


def _insert(lines: list[str], document: Document, key: Key, number: NewNumber) -> None:
    """Put a key below the header of the longest section that holds it; before the first header,
    where the file has dotted keys only.
    """
    headers = {n for n, line in enumerate(lines, 1) if line.lstrip().startswith("[")}
    length = max((n for n in range(1, len(key)) if document.lines.get(key[:n]) in headers), default=0)
    at = document.lines[key[:length]] if length else 0
    lines[at:at] = [_comment(number), f"{'.'.join(map(str, key[length:]))} = {number.value!r}"]


def _check(text: str, key: Key, value: float, path: str) -> None:
    document = read_toml(text)
    here: object = document.values
    for part in key:
        here = here.get(part) if isinstance(here, Mapping) else None
    if document.problems or here != value:
        name = ".".join(map(str, key))
        raise RigError([f"{path}: {name} cannot be changed alone as it stands; write {name} = {value!r} by hand"])


def replace_file(path: Path, before: str, after: str) -> Path:
    """Replace a rig file as a whole, and return the copy of the old one that is kept beside it.

    Parameters
    ----------
    before : what was read from it; when somebody has changed it meanwhile, it stays

    Raises
    ------
    RigError
        the file is another one meanwhile, or no backup can be made
    OSError
    """
    path = path.resolve()  # what a link stands for
    raw = read_regular(path, MOST_CHARACTERS)
    mark = b"\xef\xbb\xbf" if raw.startswith(b"\xef\xbb\xbf") else b""
    if raw[len(mark) :] != before.encode():
        raise RigError([f"{path}: the file was changed meanwhile; nothing is written, measure again"])
    backup = _backup(path, raw)
    beside = path.with_name(f".{path.stem}-{os.getpid()}-{os.urandom(4).hex()}{path.suffix}")
    try:
        with beside.open("xb") as file:
            os.fchmod(file.fileno(), stat.S_IMODE(path.stat().st_mode))
            file.write(mark + after.encode())
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        with suppress(OSError):
            beside.unlink()
    return backup


def _backup(path: Path, raw: bytes) -> Path:
    for number in range(1, MOST_BACKUPS + 1):
        backup = path.with_name(f"{path.name}.bak{number if number > 1 else ''}")
        with suppress(FileExistsError), backup.open("xb") as file:
            file.write(raw)
            file.flush()
            os.fsync(file.fileno())
            return backup
    raise RigError([f"{path}: there are {MOST_BACKUPS} copies {path.name}.bak already; take some away"])
