"""The runbook's entry for a trip."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from coulombus.host.cycle.records import Trip

__all__ = ["RUNBOOK", "anchor", "entry"]

RUNBOOK = "docs/runbook.md"
_WORD = re.compile(r"[A-Z][A-Z0-9_]{2,}")


def anchor(trip: str) -> str | None:
    """Return the page and heading for a trip's text, as in ``docs/runbook.md#speed``; None if it names no
    trip.

    A cause takes precedence over the trip of another axis or bus (OTHER_AXIS).
    """
    names = [word for word in _WORD.findall(trip) if word in Trip.__members__ and word != Trip.NONE.name]
    name = next((word for word in names if word != Trip.OTHER_AXIS.name), next(iter(names), None))
    return None if name is None else f"{RUNBOOK}#{name.lower()}"


def entry(trip: str) -> str | None:
    """Return the runbook's paragraph for a trip's text, as plain text.

    None: the text names no trip, or the documents are not installed with the program.
    """
    place = anchor(trip)
    return None if place is None else _entries().get(place.rpartition("#")[2])


@cache
def _entries() -> dict[str, str]:
    """Return the paragraphs of the runbook by their headings."""
    path = Path(__file__).resolve().parents[__name__.count(".") - 1] / RUNBOOK
    try:
        pages = path.read_text(encoding="utf-8")
    except OSError:
        return {}
    sections = re.split(r"^#{2,3} ", pages, flags=re.MULTILINE)[1:]
    parts = (section.partition("\n") for section in sections)
    return {head.strip().lower(): _plain(text) for head, _, text in parts}


def _plain(text: str) -> str:
    """Return a paragraph without Markdown markup."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(re.sub(r"[*`]", "", text).split())
