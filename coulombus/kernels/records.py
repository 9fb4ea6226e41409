"""Records, as kernels take them: what they are to mypy, and how they are made."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["Floats", "Integers", "Record", "Records", "copied", "new_records", "overwrite"]

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


def _opaque(records: Records) -> Records:
    """Return the same records without their fields: numpy copies those field by field, in up to ten
    times as long.
    """
    return records.view(np.ndarray).view(np.dtype((np.void, records.dtype.itemsize)))


def copied(records: Records) -> Records:
    """Return a copy of an array of records, which is of the same class."""
    return _opaque(records).copy().view(records.dtype).view(type(records))


def overwrite(records: Records, others: Records) -> None:
    """Let an array of records have the values of another one of the same type and length."""
    _opaque(records)[:] = _opaque(others)
