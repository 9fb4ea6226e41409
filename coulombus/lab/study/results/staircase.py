"""What a staircase came to: where it turned, and the share of right answers there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["staircase"]


def staircase(levels: Sequence[float], right: Sequence[bool]) -> dict[str, Any] | None:
    """Return the levels at which a staircase turned; None where it turned less than four times.

    The threshold is the mean of an even number of the last turns, the first two left out (Levitt
    1971, doi:10.1121/1.1912375): the level of the share of right answers at which the staircase comes
    to rest. `right` is the share from the third turn on.
    """
    turns: list[int] = []
    going = 0
    for k in range(1, len(levels)):
        step = (levels[k] > levels[k - 1]) - (levels[k] < levels[k - 1])
        if step and step == -going:
            turns.append(k - 1)
        going = step or going
    if len(turns) < 4:
        return None
    counted = turns[2:] if len(turns) % 2 == 0 else turns[3:]
    shown = [levels[k] for k in counted]
    return {
        "turns": len(turns),
        "threshold": float(np.mean(shown)),
        "threshold_sd": float(np.std(shown, ddof=1)),
        "right": float(np.mean(right[turns[2] :])),
    }
