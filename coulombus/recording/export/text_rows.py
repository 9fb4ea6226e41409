"""Many rows of text, made of few distinct pieces and put together by a kernel.

A signal has few distinct values, so each is formatted once; a row is a row of piece numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import kernel
from coulombus.recording.sample_groups import Array, Integers

__all__ = ["Cells", "TextRows", "texts_of", "times_of"]

NS = 1_000_000_000
EXPONENT_NS, EXACT_NS = 100_000, 10**15
"""Python writes smaller times with an exponent; larger ones have more than the 15 digits that a float64 keeps."""
TIME_BYTES = 17
POINT, ZERO, LINE_END = b".0\n"

Cells: TypeAlias = tuple[Sequence[str], Integers]
"""A column: its distinct texts, and the number of its text in each row."""


def texts_of(values: Array, word: bool, others: Mapping[str, str]) -> Cells:
    """Return numbers as texts; `others`: texts instead of ``nan``, ``inf`` and ``-inf``."""
    distinct, numbers = np.unique(values, return_inverse=True)  # -inf is the first, inf and NaN are the last
    finite = np.isfinite(distinct)
    reals = distinct[finite]
    texts = list(map(repr, (reals.astype(np.int64) if word and reals.dtype.kind == "f" else reals).tolist()))
    odd = [others.get(text, text) for text in map(repr, distinct[~finite].tolist())]
    first = int(np.count_nonzero(distinct == -np.inf))
    return [*odd[:first], *texts, *odd[first:]], numbers


@kernel
def _write_times(t_ns: Integers, out: npt.NDArray[np.uint8]) -> int:
    """Write each time in seconds, as its digits and a line's end; return the bytes written."""
    place = 0
    for i in range(t_ns.shape[0]):
        whole, rest, unit = t_ns[i] // NS, t_ns[i] % NS, 1
        while whole // unit >= 10:
            unit *= 10
        while unit:
            out[place] = ZERO + whole // unit % 10
            place, unit = place + 1, unit // 10
        out[place] = POINT
        place, unit = place + 1, NS
        while unit == NS or rest:
            unit //= 10
            out[place] = ZERO + rest // unit
            place, rest = place + 1, rest % unit
        out[place] = LINE_END
        place += 1
    return place


def times_of(t_ns: Integers) -> Cells:
    """Return times in seconds, as Python writes the nearest number."""
    numbers = np.arange(len(t_ns))
    if len(t_ns) and (t_ns.min() < EXPONENT_NS or t_ns.max() >= EXACT_NS):
        return list(map(repr, (t_ns / NS).tolist())), numbers
    out = np.empty(len(t_ns) * TIME_BYTES, np.uint8)
    return out[: _write_times(t_ns, out)].tobytes().decode().split(), numbers


@kernel
def _put_together(
    pool: npt.NDArray[np.uint8], begins: Integers, rows: Integers, places: Integers, out: npt.NDArray[np.uint8]
) -> None:
    """Write the pieces of each row one after another, from its place on."""
    for row in range(rows.shape[0]):
        place = places[row]
        for k in range(rows.shape[1]):
            piece = rows[row, k]
            for i in range(begins[piece], begins[piece + 1]):
                out[place] = pool[i]
                place += 1


class TextRows:
    """Rows of several tables, each with columns of its own."""

    def __init__(self) -> None:
        self._pool: list[bytes] = []
        self._sizes: list[Integers] = []
        self._count = 0
        self._tables: list[Integers] = []
        """Piece numbers, a row for each row of text."""

    def _pieces(self, texts: Sequence[str]) -> int:
        """Keep pieces; return the number of the first."""
        content = "".join(texts)
        if not content.isascii():
            return self._keep(content.encode(), np.array([len(text.encode()) for text in texts]))
        return self._keep(content.encode(), np.fromiter(map(len, texts), np.int64, len(texts)))

    def _keep(self, content: bytes, sizes: Integers) -> int:
        first = self._count
        self._pool.append(content)
        self._sizes.append(sizes)
        self._count += len(sizes)
        return first

    def add(self, template: str, columns: Sequence[Cells]) -> Integers:
        """Add a table: `template` with the cells of a row in place of each ``%s``. Return the bytes of each row."""
        literals = template.split("%s")
        table = np.empty((len(columns[0][1]), len(literals) + len(columns)), np.int64)
        table[:, ::2] = self._pieces(literals) + np.arange(len(literals))
        for k, (texts, numbers) in enumerate(columns):
            table[:, 2 * k + 1] = self._pieces(texts) + numbers
        self._tables.append(table)
        sizes: Integers = np.concatenate(self._sizes)[table].sum(axis=1)
        return sizes

    def put_before(self, heads: Array) -> None:
        """Put the bytes of `heads` before the rows of the last table, one for each."""
        first = self._keep(heads.tobytes(), np.full(len(heads), heads.itemsize))
        self._tables[-1] = np.column_stack((first + np.arange(len(heads)), self._tables[-1]))

    def joined(self, places: Array) -> tuple[bytes, Integers, Integers]:
        """Return the rows of all tables in the order of `places`; which row comes when; and where each begins."""
        lengths = np.concatenate(self._sizes)
        sizes = np.concatenate([lengths[table].sum(axis=1) for table in self._tables])
        order = np.argsort(places, kind="stable")
        begins = np.empty(len(sizes), np.int64)
        begins[order] = np.cumsum(sizes[order]) - sizes[order]
        pool, pieces = np.frombuffer(b"".join(self._pool), np.uint8), np.append(0, np.cumsum(lengths))
        out = np.empty(int(sizes.sum()), np.uint8)
        done = 0
        for table in self._tables:
            _put_together(pool, pieces, table, begins[done : done + len(table)], out)
            done += len(table)
        return out.tobytes(), order, begins
