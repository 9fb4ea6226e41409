"""Change single values of a rig file as a person would: every other line, comment and blank stays.

A value takes the old one's place, the comment at its line's end stays, and a line above it says
what was found and when. A key that is not there yet is put below its section's header, with its
section at the file's end where that is missing, too.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coulombus.eds.regular_file import read_regular
from coulombus.rigs.mistakes import RigError, dotted, toml_value
from coulombus.rigs.toml_lines import MOST_CHARACTERS, Key, read_toml

__all__ = ["NewValue", "replace_file", "rewritten"]

_ASSIGNMENT = re.compile(r"(?P<head>\s*[^=#]*=\s*)(?P<rest>.*)")
_TEXT_OR_COMMENT = re.compile(r""""(?:[^"\\]|\\.)*"|'[^']*'|(?P<comment>\s*\#.*)""")
LONGEST = 200


@dataclass(frozen=True)
class NewValue:
    """A value for a key, and the comment that stands above it."""

    value: Any
    comment: str


def rewritten(text: str, values: Mapping[Key, NewValue], mark: str, path: str) -> str:
    """Return the text of a rig file with other values.

    Parameters
    ----------
    mark : how the comments of this hand begin; an older one of a key is replaced

    Raises
    ------
    RigError
        a key stands where it cannot be changed alone, as in an inline table
    """
    ending = "\r\n" if "\r\n" in text else "\n"
    lines = text.replace("\r\n", "\n").split("\n")
    for key, new in values.items():
        document = read_toml("\n".join(lines))
        at = document.lines.get(key)
        if at is not None:
            _replace(lines, at - 1, new, mark)
        else:
            _insert(lines, document.lines, key, new, mark)
        _check("\n".join(lines), key, new.value, path)
    return ending.join(lines)


def _replace(lines: list[str], at: int, new: NewValue, mark: str) -> None:
    """Put the new value into the statement that begins in a line."""
    found = _ASSIGNMENT.fullmatch(lines[at])
    if found is None:
        return  # `_check` tells
    indent = lines[at][: len(lines[at]) - len(lines[at].lstrip())]
    last = _last_line(lines, at)
    tail = _comment(lines[last] if last > at else found["rest"])
    lines[at : last + 1] = [f"{found['head']}{toml_value(new.value)}{tail}"]
    first = at
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    kept = [line for line in lines[first:at] if not line.lstrip("# \t").startswith(mark)]
    lines[first:at] = [*kept, f"{indent}# {mark} {new.comment}"]


def _comment(text: str) -> str:
    """Return the comment at the end of a line, with the blanks before it."""
    return next((found["comment"] for found in _TEXT_OR_COMMENT.finditer(text) if found["comment"]), "")


def _last_line(lines: list[str], at: int) -> int:
    """Return the last line of the statement that begins in a line: the first with which it
    reads.
    """
    for last in range(at, min(at + LONGEST, len(lines))):
        document = read_toml("\n".join(lines[at : last + 1]))
        if not document.problems:
            return last
    return at


def _insert(lines: list[str], known: Mapping[Key, int], key: Key, new: NewValue, mark: str) -> None:
    """Put a key below the header of its section, or a section at the end."""
    headers = {n for n, line in enumerate(lines, 1) if line.lstrip().startswith("[")}
    own = [f"# {mark} {new.comment}", f"{key[-1]} = {toml_value(new.value)}"]
    at = known.get(key[:-1])
    if at in headers and at is not None:
        lines[at:at] = own
        return
    while lines and not lines[-1].strip():
        lines.pop()
    lines += ["", f"[{dotted(key[:-1])}]", *own, ""]


def _check(text: str, key: Key, value: Any, path: str) -> None:
    """Refuse a text in which the key is not what it is to be."""
    document = read_toml(text)
    here: Any = document.values
    for part in key:
        here = here.get(part) if isinstance(here, Mapping) else None
    wanted = [list(row) if isinstance(row, tuple) else row for row in value] if isinstance(value, tuple) else value
    if document.problems or here != wanted:
        name = dotted(key)
        raise RigError([f"{path}: {name} cannot be changed alone as it stands; write it by hand: {name} = {value}"])


def replace_file(path: Path, before: str, after: str, backup: Path) -> None:
    """Replace a rig file as a whole; a copy of the old one is kept as `backup`.

    Parameters
    ----------
    before : what was read from it; when somebody has changed it meanwhile, it stays

    Raises
    ------
    RigError
        the file is another one meanwhile
    OSError
        as on a full disk; the file is as it was
    """
    path = path.resolve()  # what a link stands for
    raw = read_regular(path, MOST_CHARACTERS)
    bom = b"\xef\xbb\xbf" if raw.startswith(b"\xef\xbb\xbf") else b""
    if raw[len(bom) :] != before.encode():
        raise RigError([f"{path}: the file was changed meanwhile; nothing is written, do the step again"])
    _write(backup, raw, 0o644)
    _write(path, bom + after.encode(), stat.S_IMODE(path.stat().st_mode))


def _write(path: Path, content: bytes, mode: int) -> None:
    """Write a file as a whole or not at all."""
    beside = path.with_name(f".{path.stem}-{os.getpid()}-{os.urandom(4).hex()}{path.suffix}")
    try:
        with beside.open("xb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    finally:
        with suppress(OSError):
            beside.unlink()
