"""Recognises the format of a text log by its content; words the refusal of other texts."""

from __future__ import annotations

import codecs
import difflib
import re
from dataclasses import dataclass

from coulombus.recording.logs.formats import FORMATS, Format
from coulombus.recording.logs.line_reader import LineReader
from coulombus.recording.logs.log import MALFORMED

__all__ = ["FormatMatch", "recognise", "refusal"]

MOST_LINES = 100
"""Lines of the file's beginning by which its format is recognised."""
SHOWN = 60
"""Characters of a line in a message."""


@dataclass(frozen=True)
class FormatMatch:
    """How well the first lines fit a format: numbers of frames, of other lines that fit, and of lines that do not fit;
    the first of these (else the first line) with its number, counted from 1; and the text's line end.
    """

    format: Format
    end: bytes
    frames: int = 0
    others: int = 0
    misfits: int = 0
    line: int = 0
    text: str = ""

    @property
    def fits(self) -> bool:
        """Whether the text is a log of this format."""
        return self.frames + self.others > 0 and self.frames + self.others >= self.misfits


def recognise(start: bytes, suffix: str) -> FormatMatch:
    """Return the format that a text's beginning fits best: by frames, then by other lines, then by the name's ending.

    A last line without its line end, which may be truncated, is no misfit.
    """
    end = b"\r" if b"\r" in start and b"\n" not in start else b"\n"  # serial adapters end lines with the former
    lines = [line.decode("utf-8", "replace") for line in start.removeprefix(codecs.BOM_UTF8).split(end)]
    matches = []
    for log_format in FORMATS:
        match = _judge(log_format, lines, end)
        if match.frames and not match.misfits:
            return match
        matches.append(match)
    return max(matches, key=lambda match: _rank(match, suffix))


def _judge(log_format: Format, lines: list[str], end: bytes) -> FormatMatch:
    reader = LineReader(log_format)
    frames = others = misfits = first = 0
    for number, text in enumerate(lines[:MOST_LINES], 1):
        if not text.strip():
            continue
        ended = number < len(lines)
        try:
            outcome = reader.row(text.rstrip("\r"), ended)
        except (ValueError, IndexError):
            outcome = MALFORMED
        if isinstance(outcome, tuple):
            frames += 1
        elif outcome == MALFORMED:
            misfits += ended
            first = first or number * ended
        elif outcome is not None:
            others += ended
    first = first or next((number for number, text in enumerate(lines, 1) if text.strip()), 1)
    return FormatMatch(log_format, end, frames, others + reader.heads, misfits, first, lines[first - 1].strip())


def _rank(match: FormatMatch, suffix: str) -> tuple[int, int, bool, float]:
    alike = difflib.SequenceMatcher(None, _shape(match.text), _shape(match.format.example)).ratio()
    return match.frames, match.others, suffix == match.format.suffix, alike


def _shape(text: str) -> str:
    """Return a text with one character for all digits and letters: what makes lines of a format alike."""
    return re.sub(r"[0-9A-Za-z]+", "0", text[:SHOWN])


def refusal(path: str, match: FormatMatch) -> str:
    """Return the error's text for a file that fits no format; `match` is that of the nearest."""
    text = match.text if len(match.text) <= SHOWN else f"{match.text[:SHOWN]}..."
    return (
        f"{path}:{match.line}: {text!r} is no line of a log format that is known; the nearest is {match.format.name}, "
        f"with lines as {match.format.example.strip()!r}"
    )
