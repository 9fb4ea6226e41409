"""What a reader of a recording is told in sentences: the file's warnings, and what was left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

__all__ = ["UNSURE", "remarks_on"]

UNSURE = "unsure "
"""Begins the names of positions with gaps in which they may have wrapped unseen."""


def remarks_on(path: str, warnings: Iterable[str], left_out: Counter[str]) -> tuple[str, ...]:
    """Return what a reader is told: the file's warnings, and what was left out of it."""
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
