"""Foreign text (an EDS file's names, a rig's name, a device's strings) made safe for people and programs.

A terminal obeys the control characters of C0 and C1: with OSC 52 a file could write to the
clipboard. The bidirectional controls of Unicode show a text in another order than it has. This
module makes them visible; `\\t` and `\\n` stay.
"""

from __future__ import annotations

import re

__all__ = ["first_control", "one_line", "printable"]

_BIDI = "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"
_CONTROL = re.compile(f"[\x00-\x08\x0b-\x1f\x7f-\x9f{_BIDI}\u2028\u2029\ud800-\udfff]")
"""Includes line and paragraph separators, and the surrogates that replace undecodable bytes of a path."""


def printable(text: str) -> str:
    """Return a text whose control characters are written as ``\\x1b`` or ``\\u202e``."""
    return _CONTROL.sub(_escaped, text)


def one_line(text: str) -> str:
    """Return a `printable` text in which each run of white space, line ends included, is a single space."""
    return printable(re.sub(r"[ \t\r\n]+", " ", text))


def first_control(text: str) -> str:
    """Return the first control character, tab or line end of a text, escaped as in `printable`; "" if there is none."""
    match = re.search(rf"[\t\n]|{_CONTROL.pattern}", text)
    return "" if match is None else _escaped(match)


def _escaped(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
