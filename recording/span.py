"""A part of a recording, as a person says it: ``3:5``, ``2.5:``, ``:10``."""

from __future__ import annotations

__all__ = ["SpanError", "parse_span"]


class SpanError(Exception):
    """There is nothing to show of a recording; the text says why, and what to do."""

    exit_status = 2


def parse_span(text: str) -> tuple[float | None, float | None]:
    """Return begin and end [s] of ``A:B``, None where one is left out.

    Raises
    ------
    ValueError
        It is none, or ends before it begins.
    """
    begin, colon, end = text.partition(":")
    try:
        found = float(begin) if begin else None, float(end) if end else None
        right = bool(colon) and (found[0] is None or found[1] is None or found[0] < found[1])
    except ValueError:
        right = False
    if not right:
        raise ValueError(f"{text!r}: expected A:B in s, as in 3:5, 2.5: or :10, and B behind A")
    return found
