"""The runbook's entries: what a trip or an EMCY means, what to do, and what not to do."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from coulombus.eds.cia301 import emcy_text
from coulombus.host.cycle.records import Trip
from coulombus.system.wrap_text import hanging

__all__ = ["TRIP_NAMES", "advice", "entry", "explained"]

_WORD = re.compile(r"[A-Z][A-Z0-9_]{2,}")
_CODE = re.compile(r"(?:0x)?([0-9a-f]{4})h?", re.IGNORECASE)
_ROW = re.compile(r"^\| ([0-9A-F]{4})h(?: and above)? \| ([^|]*) \| ([^|]*) \|$", re.MULTILINE)
_STEP = re.compile(r"\d\. ")
TRIP_NAMES = tuple(trip.name for trip in Trip if trip is not Trip.NONE)
MANUFACTURER = 0xFF00
WIDTH = 80
EMCY_STEPS = """1. {remedy}
2. Read the node's error history, 1003h (coulombus sdo get).
3. Start again when the cause is gone: bring-up resets the fault.

Do not reset a fault again and again without its cause."""


def _named_trip(text: str) -> str | None:
    """Return the name of the trip in a trip's text; None if it names none.

    A cause takes precedence over the trip of another axis or bus (OTHER_AXIS).
    """
    names = [word for word in _WORD.findall(text) if word in TRIP_NAMES]
    return next((word for word in names if word != Trip.OTHER_AXIS.name), next(iter(names), None))


def advice(text: str) -> str | None:
    """Return the command that explains the trip in a trip's text, as ``coulombus help SPEED``; None if it names none."""
    name = _named_trip(text)
    return None if name is None else f"coulombus help {name}"


def entry(text: str) -> str | None:
    """Return the runbook's section for a trip's text, a paragraph or a step in a line; None if it names no trip."""
    name = _named_trip(text)
    return None if name is None else _sections()[name.lower()]


def explained(name: str) -> str | None:
    """Return a screen of text on a trip, in any case of letters, or an EMCY code, as 8250h, 0x8250 or 8250.

    None: it is neither.
    """
    code = _CODE.fullmatch(name)
    if name.upper() in TRIP_NAMES:
        title, text = f"{name.upper()}: a trip", _sections()[name.lower()]
    elif code:
        title, text = _emcy(int(code[1], 16))
    else:
        return None
    lines = [hanging(line, WIDTH, 3 if _STEP.match(line) else 0) for line in text.split("\n")]
    return "\n".join([title, "", *lines])


def _emcy(code: int) -> tuple[str, str]:
    """Return title and text on an EMCY code; an unlisted one has the text of its class."""
    rows = {int(at, 16): (meaning, remedy) for at, meaning, remedy in _ROW.findall(_sections()["emcy codes"])}
    meaning, remedy = rows.get(MANUFACTURER if code >= MANUFACTURER else code, (emcy_text(code).partition(": ")[2], ""))
    title = f"{code:04X}h: an EMCY code"
    if not code:
        return title, f"{_sentence(meaning)} {_sentence(remedy)}"
    steps = EMCY_STEPS.format(remedy=_sentence(remedy or "the device's manual"))
    return (
        title,
        f"{_sentence(meaning)} A node that sends it trips the host: EMCY_MOTOR, EMCY_BRAKE or EMCY_SENSOR.\n\n{steps}",
    )


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


@cache
def _sections() -> dict[str, str]:
    """Return the sections of the runbook by their headings, a paragraph or a step in a line, without markup."""
    pages = Path(__file__).with_name("runbook.md").read_text(encoding="utf-8")
    sections = re.split(r"^#{2,3} ", pages, flags=re.MULTILINE)[1:]
    parts = (section.partition("\n") for section in sections)
    return {head.strip().lower(): _plain(text) for head, _, text in parts}


def _plain(text: str) -> str:
    """Return Markdown text without markup, and each paragraph, step and row in one line."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text.strip())
    return re.sub(r"(?<!\n)\n(?!\n|\d\. |\|)\s*", " ", re.sub(r"[*`]", "", text))
