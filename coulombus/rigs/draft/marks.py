"""Marks in a rig file: unverified guesses (``# CHECK:``)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from coulombus.rigs.draft.draft_text import CHECK
from coulombus.rigs.toml_lines import read_toml

__all__ = ["Guess", "guesses"]

MARK = re.compile(rf"^\s*#\s*{CHECK}:\s*(?P<text>.*)$")
COMMENT = re.compile(r"^\s*#\s?(?P<text>.*)$")
MOVES = re.compile(
    r"(?:^|\.)(?:motor\.(?:rated_torque_Nm|encoder_counts_rev|mode|sdo)"
    r"|mechanics\.(?:ratio|motor_polarity|encoder_polarity)"
    r"|role\.(?:torque_setpoint|position)(?:\.\w+)?)$"
)
"""Keys that decide how strongly, in which direction and how far the motor moves the hand."""


class Guess(NamedTuple):
    """A mark: the line of its key, the key, and the reason.

    Attributes
    ----------
    line : of the key or section below the mark
    key : "" if nothing stands below it
    """

    line: int
    key: str
    text: str

    @property
    def moves_hand(self) -> bool:
        """Whether a wrong guess makes the hand move differently from the host's model."""
        return MOVES.search(self.key) is not None

    def __str__(self) -> str:
        return f"{self.key or 'the file'}: {self.text}"


def guesses(text: str) -> tuple[Guess, ...]:
    """Return the marked guesses of a rig file, in its order."""
    return tuple(_guesses(text))


def _guesses(text: str) -> Iterator[Guess]:
    keys: dict[int, str] = {}
    for key, place in read_toml(text).lines.items():
        keys.setdefault(place, ".".join(str(part) for part in key if isinstance(part, str)))
    waiting: list[str] = []
    for number, line in enumerate((*text.splitlines(), ""), 1):
        mark, comment = MARK.match(line), COMMENT.match(line)
        if mark:
            waiting.append(mark["text"])
        elif comment and waiting:
            waiting[-1] += f" {comment['text']}"
        elif not comment and waiting:
            yield from (Guess(number, keys.get(number, ""), reason) for reason in waiting)
            waiting = []
