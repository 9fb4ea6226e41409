"""Draw a signal's envelope in a terminal: two columns and four rows of dots per character.

Unicode's braille patterns: U+2800 and a bit for each of the eight dots.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

__all__ = ["drawn"]

BLANK = 0x2800
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""The bit of each dot, by its row from above and its column."""

Floats = npt.NDArray[np.float64]


def drawn(low: Floats, high: Floats, width: int, height: int) -> tuple[list[str], float, float]:
    """Draw minima and maxima over time; return lines, and the values at the lower and upper edge.

    Each column of dots is filled from its least to its greatest value, the newest at the right. NaN is blank.

    Parameters
    ----------
    low, high : n values each, in any unit
    width, height : of the picture, in characters
    """
    columns, rows = min(2 * width, len(low)), 4 * height
    seen = np.isfinite(low) & np.isfinite(high)
    if not columns or not seen.any():
        return [" " * width] * height, 0.0, 0.0
    least, greatest = float(low[seen].min()), float(high[seen].max())
    span = (greatest - least) or 1.0
    edges = np.linspace(0, len(low), columns + 1).astype(int)
    cells = np.zeros((height, width), np.int64)
    for column, (begin, end) in enumerate(pairwise(edges), 2 * width - columns):
        right = seen[begin:end]
        if not right.any():
            continue
        bottom, top = (
            min(rows - 1, int((value - least) / span * rows))
            for value in (low[begin:end][right].min(), high[begin:end][right].max())
        )
        for dot in range(bottom, top + 1):
            row = rows - 1 - dot
            cells[row // 4, column // 2] |= DOTS[row % 4][column % 2]
    return ["".join(chr(BLANK + cell) if cell else " " for cell in line) for line in cells], least, greatest
