"""Models in a recording, and in the ring of an axis: the same numbers in both.

An axis numbers its models from 1. In the trace (`recording.trace`) a model is named by its key, which
has the axis in its last four bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from coulombus.host.world.model_check import why_not
from coulombus.host.world.records import MODEL, OFFERS

__all__ = ["ROW", "key_of", "models_of", "place", "row_of"]

ROW = np.dtype([("number", "<i8"), ("model", MODEL)])
"""A model in a recording: its number on its axis, and the record."""
AXIS_BITS = 4
KEY_MASK = (1 << 31) - 1
LONGEST_LIFE_NS = 60_000_000_000


def key_of(number: int, axis: int) -> int:
    """Return a model's key in the trace."""
    return (number << AXIS_BITS | axis) & KEY_MASK


def place(worlds: Any, model: Any, number: int) -> None:
    """Write model `number` into the ring of its axis, and publish it to the next cycle.

    Parameters
    ----------
    worlds : `LocalModelRecord` of each axis
    """
    axis = int(model["axis"])
    worlds["offered"][axis, number % OFFERS] = model
    worlds["wanted"][axis] = number


def row_of(model: Any, number: int) -> bytes:
    """Return a model as it stands in a recording."""
    row = np.zeros(1, ROW)
    row["number"], row["model"] = number, model
    return row.tobytes()


def models_of(rows: bytes, axes: int, *, arm: bool = False) -> dict[int, Any]:
    """Return the rows of a recording by their keys; rows that no host would have accepted are omitted.

    `arm`: the axes are the joints of an arm.
    """
    table = np.frombuffer(rows, ROW, len(rows) // ROW.itemsize)
    accepted = (
        row for row in table if row["number"] > 0 and why_not(row["model"], axes, LONGEST_LIFE_NS, arm=arm) is None
    )
    return {key_of(int(row["number"]), int(row["model"]["axis"])): row for row in accepted}
