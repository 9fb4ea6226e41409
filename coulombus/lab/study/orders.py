"""In which order a subject meets the conditions."""

from __future__ import annotations

__all__ = ["williams"]


def williams(count: int) -> list[list[int]]:
    """Return the rows of a Williams design [Williams 1949]: in each row every condition once, over all rows
    each in every place as often, and behind each other one as often. An odd `count` takes twice as many rows.
    """
    first = [0] + [(k + 1) // 2 if k % 2 else count - k // 2 for k in range(1, count)]
    rows = [[(place + shift) % count for place in first] for shift in range(count)]
    return rows if count % 2 == 0 else rows + [row[::-1] for row in rows]
