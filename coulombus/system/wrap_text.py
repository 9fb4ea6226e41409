"""Wrap text to the terminal without breaking commands and options."""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import TextIO

__all__ = ["columns_of", "folded", "hanging"]

_GLUE = "\0"
"""Placeholder for a space at which a line is not broken."""
_OPTION = r"(?:--[a-z][\w-]*(?: (?!--)[^\s,;:()]+)? ?)"
_FILE = r"(?:(?:-[a-z] )?[^\s,;:()]*[/.][^\s,;:()]*[^\s,;:().] ?)"
_COPIED = re.compile(rf"`[^`\n]*`|\bcoulombus [a-z]+ (?:{_OPTION}|{_FILE})*|{_OPTION}+")


def hanging(text: str, width: int, indent: int) -> str:
    """Wrap a line at spaces; continuation lines are indented to the column `indent`.

    A word, a command in backquotes and a row of options stay in one piece, even if they are wider than
    `width`: the terminal itself breaks them, and they are copied whole.
    """
    glued = _COPIED.sub(lambda match: match[0].rstrip().replace(" ", _GLUE) + " " * match[0].endswith(" "), text)
    lines = textwrap.fill(glued, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)
    return lines.replace(_GLUE, " ")


def columns_of(stream: TextIO) -> int | None:
    """Return the width of a stream's terminal; None for a file or a pipe."""
    try:
        return shutil.get_terminal_size().columns if stream.isatty() else None
    except ValueError:  # the stream is closed
        return None


def folded(text: str, stream: TextIO, indent: int = 2) -> str:
    """Return lines wrapped by `hanging` for a terminal, unchanged for a file or a pipe; lines that begin
    with a space (a traceback's) stay as they are.
    """
    columns = columns_of(stream)
    if columns is None:
        return text
    return "\n".join(
        line if len(line) <= columns or line[:1].isspace() else hanging(line, columns, indent)
        for line in text.split("\n")
    )
