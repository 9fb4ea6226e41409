"""How much a benchmark does: enough for its figure, or as little as shows that it runs (`--smallest`)."""

from __future__ import annotations

import os
from typing import TypeVar

__all__ = ["SMALLEST", "size"]

T = TypeVar("T", int, float)

SMALLEST = "COULOMBUS_BENCHMARKS_SMALLEST"
"""The variable that says so, also to the processes that a benchmark starts."""


def size(usual: T, smallest: T) -> T:
    """Return how much there is to do."""
    return smallest if os.environ.get(SMALLEST) else usual
