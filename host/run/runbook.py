"""Where the runbook tells what to do about a trip."""

from __future__ import annotations

import re

from coulombus.host.cycle.records import Trip

__all__ = ["RUNBOOK", "anchor"]

RUNBOOK = "docs/runbook.md"
_WORD = re.compile(r"[A-Z][A-Z0-9_]{2,}")


def anchor(trip: str) -> str | None:
    """Return the page and heading for a trip's words, as in ``docs/runbook.md#speed``; None where
    they name no trip.

    What another axis, or another bus, did comes second: the cause is of more use.
    """
    names = [word for word in _WORD.findall(trip) if word in Trip.__members__ and word != Trip.NONE.name]
    name = next((word for word in names if word != Trip.OTHER_AXIS.name), next(iter(names), None))
    return None if name is None else f"{RUNBOOK}#{name.lower()}"
