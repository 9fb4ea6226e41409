"""Records, as kernels take them: what they are to mypy, and how they are made."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["Floats", "Integers", "Record", "Records", "new_records"]

Records: TypeAlias = npt.NDArray[Any]
"""An array of records (a structured dtype)."""
Record: TypeAlias = np.record
"""One record: an element of such an array, a view of it."""
Integers: TypeAlias = npt.NDArray[np.integer[Any]]
Floats: TypeAlias = npt.NDArray[np.float64]


def new_records(dtype: np.dtype[Any], count: int = 1) -> Records:
    """Return `count` records of `dtype`, all zero, whose fields are
    attributes in compiled and in plain Python.
    """
    return np.zeros(count, dtype).view(np.recarray)
