"""What a staircase came to: where it turned, and the share of right answers there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["staircase", "staircases"]


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


def staircases(levels: Sequence[float], larger: Sequence[bool], reference: float) -> dict[str, Any] | None:
    """Return where one staircase turned, or one above the reference and its mirror image together.

    Of two staircases each two trials have one of each (`methods.Mirrored`); the higher level is of the
    staircase above. Their threshold is the reference plus the mean distance of both: a shift of the
    point of subjective equality cancels out of it. None where either turned less than four times.
    """
    if min(levels) >= reference:
        return staircase(levels, larger)
    above: list[int] = []
    below: list[int] = []
    for k in range(0, len(levels), 2):
        pair = sorted(range(k, min(k + 2, len(levels))), key=lambda trial: levels[trial])
        if len(pair) == 2:
            below.append(pair[0])
        if len(pair) == 2 or levels[pair[0]] >= reference:
            above.append(pair[-1])
        else:
            below.append(pair[0])
    up = staircase([levels[k] for k in above], [larger[k] for k in above])
    down = staircase([2 * reference - levels[k] for k in below], [not larger[k] for k in below])
    if up is None or down is None:
        return None
    return {
        "turns": up["turns"] + down["turns"],
        "threshold": (up["threshold"] + down["threshold"]) / 2,
        "threshold_sd": float(np.hypot(up["threshold_sd"], down["threshold_sd"]) / np.sqrt(2)),
        "right": (up["right"] + down["right"]) / 2,
    }
