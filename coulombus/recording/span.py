"""Time spans of a recording: ``3:5``, ``2.5:``, ``:10``."""

from __future__ import annotations

from contextlib import suppress
from numbers import Real
from typing import Any

from coulombus.rigs.arguments import WrongCall
from coulombus.system.errors import CoulombusError

__all__ = ["SpanError", "checked_span", "parse_span"]


class SpanError(CoulombusError):
    """There is nothing to show; the text has the reason and the remedy."""

    exit_status = 2


def parse_span(text: str) -> tuple[float | None, float | None]:
    """Return begin and end [s] of ``A:B``; None for an omitted one.

    Raises
    ------
    ValueError
        It is not a span, or ends before it begins.
    """
    begin, colon, end = text.partition(":")
    try:
        span = float(begin) if begin else None, float(end) if end else None
        right = bool(colon) and (span[0] is None or span[1] is None or span[0] < span[1])
    except ValueError:
        right = False
    if not right:
        raise ValueError(f"{text!r}: expected A:B in s, as in 3:5, 2.5: or :10, and B after A")
    return span


def checked_span(span: Any) -> tuple[float | None, float | None]:
    """Return a checked span from a script: two times [s], None for an open end.

    Raises
    ------
    coulombus.rigs.arguments.WrongCall
        It is something else.
    """
    if isinstance(span, (tuple, list)) and len(span) == 2 and all(time is None or _is_time(time) for time in span):
        begin, end = (None if time is None else float(time) for time in span)
        return begin, end
    meant: tuple[float | None, float | None] = (3.0, 5.0)
    if isinstance(span, str):
        with suppress(ValueError):
            meant = parse_span(span)
    raise WrongCall(f"span is {span!r}: expected begin and end in s, as in span={meant!r}; None leaves an end open")


def _is_time(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
