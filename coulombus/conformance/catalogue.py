"""The list of cases: ``catalogue.csv``, in execution order."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

__all__ = ["Case", "catalogue"]


@dataclass(frozen=True)
class Case:
    """One case: its number as text ("2.10" is not "2.1"), its title, the accepted abort codes, and
    the clause of the standard that demands it.

    Numbers that begin with a letter are this project's own. Without `codes` any abort code is accepted.
    """

    id: str
    name: str
    objective: str
    codes: tuple[int, ...]
    clause: str

    @property
    def is_additional(self) -> bool:
        """Return whether the case is not among the 127 of the conformance test plan."""
        return self.id[0].isalpha()


@lru_cache(maxsize=1)
def catalogue() -> tuple[Case, ...]:
    """Return all cases."""
    with files("coulombus.conformance").joinpath("catalogue.csv").open(encoding="utf-8") as file:
        return tuple(
            Case(row["id"], row["name"], row["objective"], _codes(row["abort_codes"]), row["clause"])
            for row in csv.DictReader(file)
        )


def _codes(text: str) -> tuple[int, ...]:
    return tuple(int(code, 16) for code in text.split())
