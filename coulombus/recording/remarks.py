"""Remarks on a recording: the file's warnings, and omitted data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

__all__ = ["UNSURE", "remarks_on"]

UNSURE = "unsure "
"""Prefix of the names of positions that may have wrapped unseen in a gap."""


def remarks_on(path: str, warnings: Iterable[str], left_out: Counter[str]) -> tuple[str, ...]:
    """Return the remarks: the file's warnings, and omitted data."""
    texts = {
        "torn": "the last block is unfinished: {} bytes were left out",
        "skipped": "{} packets are no classical CAN frames and were left out",
    }

    def text(name: str) -> str:
        if name.startswith(UNSURE):
            return (
                f"{name.removeprefix(UNSURE)} has {{}} gaps that are longer than its counter can be followed "
                "(limits.encoder_jump_counts); after them it may be wrong by whole wraps"
            )
        return texts.get(name, f"{{}} frames of {name} have a wrong length")

    return (*warnings, *(f"{path}: {text(name).format(n)}" for name, n in left_out.items() if n))
