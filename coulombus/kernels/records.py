"""Records for kernels, declared once as a class with typed fields.

mypy checks the class; `dtype_of` converts it to the dtype for NumPy and Numba::

    class Frame(Record):
        t_ns: int  # end of frame
        words: Annotated[IntegerField, 8]

    FRAME = dtype_of(Frame)
    frame = new_records(Frame)[0]

A field is ``int`` (int64), ``float`` (float64), another record, or an array of such, with its
length: ``Annotated[IntegerField, 8]``, ``Annotated[FloatField, (2, 3)]``,
``Annotated[RecordArray[Frame], 4]``. Another number type follows the length:
``Annotated[IntegerField, 8, np.int16]``. The fields of a base class come first. The comment after a
field is its description.
"""

from __future__ import annotations

from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Generic,
    Self,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import overload

__all__ = [
    "FloatField",
    "Floats",
    "IntegerField",
    "Integers",
    "Record",
    "RecordArray",
    "Records",
    "copied",
    "dtype_of",
    "new_records",
    "overwrite",
]

Records: TypeAlias = npt.NDArray[Any]
"""An array of records (a structured dtype) of any type."""
Integers: TypeAlias = npt.NDArray[np.integer[Any]]
Floats: TypeAlias = npt.NDArray[np.float64]


class Record:
    """One record: an element of an array of records, a view of it. Only NumPy creates it."""

    if TYPE_CHECKING:

        def __getitem__(self, name: str) -> Any: ...
        def __setitem__(self, name: str, value: Any) -> None: ...
        def copy(self) -> Self: ...  # noqa: D102
        @property
        def dtype(self) -> np.dtype[Any]: ...  # noqa: D102


R = TypeVar("R", bound=Record)
A = TypeVar("A", bound=Records)

if TYPE_CHECKING:

    class RecordArray(npt.NDArray[Any], Generic[R]):
        """An array of records of one class: one axis, whose elements are records."""

        @overload  # type: ignore[override]
        def __getitem__(self, key: int) -> R: ...
        @overload
        def __getitem__(self, key: slice | Integers) -> RecordArray[R]: ...
        @overload
        def __getitem__(self, key: str | list[str]) -> npt.NDArray[Any]: ...
        def __getitem__(self, key: Any) -> Any: ...
        def __iter__(self) -> Iterator[R]: ...  # type: ignore[override]

    class IntegerField(npt.NDArray[np.int64]):
        """An array of integers within a record."""

        @overload  # type: ignore[override]
        def __getitem__(self, key: int) -> int: ...
        @overload
        def __getitem__(self, key: tuple[int, int]) -> int: ...
        @overload
        def __getitem__(self, key: slice | Integers | list[int] | None) -> Integers: ...
        def __getitem__(self, key: Any) -> Any: ...
        @overload  # type: ignore[override]
        def __setitem__(self, key: int | tuple[int, int], value: int) -> None: ...
        @overload
        def __setitem__(self, key: slice | Integers | list[int], value: Any) -> None: ...
        def __setitem__(self, key: Any, value: Any) -> None: ...

    class FloatField(npt.NDArray[np.float64]):
        """An array of numbers within a record."""

        @overload  # type: ignore[override]
        def __getitem__(self, key: int) -> float: ...
        @overload
        def __getitem__(self, key: tuple[int, int]) -> float: ...
        @overload
        def __getitem__(self, key: slice | Integers | list[int] | None) -> Floats: ...
        def __getitem__(self, key: Any) -> Any: ...
        @overload  # type: ignore[override]
        def __setitem__(self, key: int | tuple[int, int], value: float) -> None: ...
        @overload
        def __setitem__(self, key: slice | Integers | list[int], value: Any) -> None: ...
        def __setitem__(self, key: Any, value: Any) -> None: ...
else:
    IntegerField, FloatField = Integers, Floats

    class RecordArray(Generic[R]):
        """An array of records of one class: one axis, whose elements are records."""


_DTYPES: dict[type[Record], np.dtype[Any]] = {}


def dtype_of(record: type[Record]) -> np.dtype[Any]:
    """Return the structured dtype of the records that `record` declares, aligned as in C."""
    if record not in _DTYPES:
        hints = get_type_hints(record, include_extras=True)
        if taken := set(hints) & set(dir(np.record)):
            raise TypeError(f"{record.__name__}: NumPy's records have {', '.join(sorted(taken))} of their own")
        _DTYPES[record] = np.dtype([(name, *_format(hint)) for name, hint in hints.items()], align=True)
    return _DTYPES[record]


def _format(hint: Any) -> tuple[Any, ...]:
    """Return the type, and for an array the shape, of a field that is declared as `hint`."""
    if get_origin(hint) is not Annotated:
        return (_scalar(hint),)
    kind, shape, *others = get_args(hint)
    if kind is int or kind is float:  # Annotated[int, np.int16]
        return (shape,)
    element = get_args(kind)[0] if get_origin(kind) is RecordArray else (int if kind == IntegerField else float)
    return (others[0] if others else _scalar(element), shape if isinstance(shape, tuple) else (int(shape),))


def _scalar(hint: Any) -> Any:
    if isinstance(hint, type) and issubclass(hint, Record):
        return dtype_of(hint)
    return {int: np.int64, float: np.float64}[hint]


def new_records(record: type[R], count: int = 1) -> RecordArray[R]:
    """Return `count` records, all zero, whose fields are attributes in compiled and in plain Python."""
    records: Any = np.zeros(count, dtype_of(record)).view(np.recarray)
    return cast("RecordArray[R]", records)


def _opaque(records: Records) -> Records:
    """Return the same records as opaque bytes: numpy would copy named fields one by one."""
    return records.view(np.ndarray).view(np.dtype((np.void, records.dtype.itemsize)))


def copied(records: A) -> A:
    """Return a copy of an array of records, of the same class."""
    return cast("A", _opaque(records).copy().view(records.dtype).view(type(records)))


def overwrite(records: Records, others: Records) -> None:
    """Overwrite an array of records with the values of another array of the same type and length."""
    _opaque(records)[:] = _opaque(others)
