"""Signals of a recording as tables: stretch by stretch for the writers of files, or whole in pandas and xarray.

Signals of one PDO share their times: they are one `Group`. Without a grid each frame of a PDO is
one row with this PDO's signals. On a grid there is one group with a row per instant, in which every
signal has the last value received by then.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.block import Block, Source
from coulombus.recording.extras import library
from coulombus.rigs.arguments import WrongCall, texts
from coulombus.rigs.signals import Signal

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = [
    "EXAMPLE",
    "GRID",
    "Column",
    "Group",
    "Rows",
    "Stretch",
    "groups_of",
    "stretches",
    "to_pandas",
    "to_xarray",
]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]

GRID = "signals"
"""The name of a grid's only group."""
EXAMPLE = "motor.position_rad"
"""Example of a signal for messages."""
MOST_ROWS = 1 << 16
"""Maximum rows of a grid at a time."""


@dataclass(frozen=True)
class Column:
    """A signal: its name as in `read`, its unit, and whether it is a bit field."""

    name: str
    unit: str
    word: bool


@dataclass(frozen=True)
class Group:
    """Signals that share their times; `name` is "motor.TPDO1", or `GRID`."""

    name: str
    columns: tuple[Column, ...]


@dataclass(frozen=True)
class Rows:
    """Rows of a group: their places in the file's order, times from the recording's time 0, and an
    array of values for each column.

    On a grid values are float64, and NaN before the signal's first one.
    """

    order: Integers
    t_ns: Integers
    values: tuple[Array, ...]

    @property
    def t_s(self) -> Floats:
        """Times [s]."""
        return self.t_ns / 1e9


@dataclass(frozen=True)
class Stretch:
    """Some seconds: rows for each group, and markers as (place in the order, time [s], text)."""

    rows: tuple[Rows, ...]
    markers: tuple[tuple[int, float, str], ...]
    until_s: float


def groups_of(source: Source, names: Sequence[str] | None, grid_ns: int | None) -> tuple[Group, ...]:
    """Return the groups of the signals `names` (None: all), in the order of the rig's PDOs; on a
    grid a single group, in the order of `names`.

    Raises
    ------
    coulombus.recording.signals.UnknownSignal
        The recording's rig has no such signal.
    coulombus.rigs.arguments.WrongCall
        `names` is not a list of strings.
    """
    names = None if names is None else texts(names, "signals", EXAMPLE)
    for name in names or ():
        source.signal(name)
    signals_of = {
        f"{pdo.node}.{pdo.name}": [signal for signal in pdo.signals if names is None or signal.name in names]
        for pdo in source.pdos
    }
    if grid_ns is None:
        return tuple(Group(name, tuple(map(_column, signals))) for name, signals in signals_of.items() if signals)
    columns = {signal.name: _column(signal) for signals in signals_of.values() for signal in signals}
    return (Group(GRID, tuple(columns[name] for name in dict.fromkeys(names or columns))),)


def _column(signal: Signal) -> Column:
    return Column(signal.name, signal.unit, not signal.unit and (signal.scale, signal.offset) == (1.0, 0.0))


def stretches(source: Source, groups: tuple[Group, ...], grid_ns: int | None) -> Iterator[Stretch]:
    """Yield the stretches in one pass through the recording."""
    if grid_ns is None:
        for block in source:
            yield _as_it_came(block, groups)
    else:
        yield from _on_grid(source, groups[0], grid_ns)


def _as_it_came(block: Block, groups: tuple[Group, ...]) -> Stretch:
    tables = {table.name: table for table in block.tables}
    rows = []
    for group in groups:
        table = tables[group.name]
        signals = {signal.name: signal for signal in table.pdo.signals}
        columns = tuple(table.column(signals[column.name]) for column in group.columns)
        rows.append(Rows(table.order, table.t_ns - block.epoch_ns, columns))
    placed = tuple(
        (2 * row, (int(block.frames["t_ns"][row]) - block.epoch_ns) / 1e9, line)
        for row, text in block.capture.comments
        for line in text.splitlines()
    )
    placed += tuple((2 * len(block.frames), (t_ns - block.epoch_ns) / 1e9, text) for t_ns, text in block.capture.late)
    return Stretch(tuple(rows), placed, float(block.t_s[-1]) if len(block.frames) else 0.0)


class _Held:
    """Samples of a signal, from the value valid at the last instant."""

    def __init__(self) -> None:
        self.t_ns = np.zeros(0, np.int64)
        self.values: Array = np.zeros(0)

    def add(self, t_ns: Integers, values: Array) -> None:
        """Add the samples of a block."""
        self.t_ns = np.maximum.accumulate(np.append(self.t_ns, t_ns))
        self.values = np.append(self.values, values.astype(np.float64))

    def at(self, instants: Integers) -> Floats:
        """Return the last value at each instant (NaN if none), and drop samples that no later instant needs."""
        last = np.searchsorted(self.t_ns, instants, "right") - 1
        values = np.append(self.values, np.nan)[last]
        if len(last) and last[-1] > 0:
            self.t_ns, self.values = self.t_ns[last[-1] :], self.values[last[-1] :]
        return values


def _on_grid(source: Source, group: Group, grid_ns: int) -> Iterator[Stretch]:
    held = {column.name: _Held() for column in group.columns}
    following, seen, until = None, 0, 0

    def rows(end_ns: int, markers: list[tuple[float, str]]) -> Iterator[Stretch]:
        """Yield the remaining instants before `end_ns`, in bounded batches."""
        nonlocal following, seen
        while True:
            first = following or 0
            count = min(-(-end_ns // grid_ns) - first, MOST_ROWS)
            if count <= 0 and not markers:
                return
            instants = (first + np.arange(max(count, 0), dtype=np.int64)) * grid_ns
            values = tuple(held[column.name].at(instants) for column in group.columns)
            places = np.arange(seen, seen + len(instants), dtype=np.int64)
            at = np.searchsorted(instants, [round(t * 1e9) for t, _ in markers])
            placed = tuple((seen + int(k), t, text) for k, (t, text) in zip(at, markers, strict=True))
            markers = []
            following, seen = first + len(instants), seen + len(instants)
            yield Stretch((Rows(places, instants, values),), placed, end_ns / 1e9)

    for block in source:
        if not len(block.frames):
            yield from rows(until, block.markers)
            continue
        t_ns = block.frames["t_ns"] - block.epoch_ns
        for table in block.tables:
            for signal in table.pdo.signals:
                if signal.name in held:
                    held[signal.name].add(table.t_ns - block.epoch_ns, table.column(signal))
        if following is None:
            following = -(-int(t_ns[0]) // grid_ns)
        until = max(until, int(t_ns.max()))
        yield from rows(until, block.markers)
    yield from rows(until + 1, [])


def _columns_of(
    source: Source, signals: Sequence[str] | None, grid_s: float | None
) -> list[tuple[Group, Array, Array, list[Array]]]:
    """Return the places, times [s] and values of each group's rows."""
    if grid_s is not None and (not isinstance(grid_s, Real) or isinstance(grid_s, bool)):
        raise WrongCall(f"grid_s is {grid_s!r}: expected a number of seconds, as in grid_s=0.001")
    grid_ns = None if grid_s is None else round(grid_s * 1e9)
    if grid_ns is not None and grid_ns < 1000:
        raise ValueError(f"grid_s is {grid_s}: expected at least 1e-6 s, as in grid_s=0.001")
    groups = groups_of(source, signals, grid_ns)
    parts = [stretch.rows for stretch in stretches(source, groups, grid_ns)]
    tables = []
    for k, group in enumerate(groups):
        places = np.concatenate([np.zeros(0, np.int64), *(rows[k].order for rows in parts)])
        t_s = np.concatenate([np.zeros(0), *(rows[k].t_s for rows in parts)])
        values = [np.concatenate([rows[k].values[c] for rows in parts]) for c in range(len(group.columns))]
        tables.append((group, places, t_s, values))
    return tables


def to_pandas(source: Source, signals: Sequence[str] | None = None, grid_s: float | None = None) -> pandas.DataFrame:
    """Return the signals as columns over the times ``t_s`` [s]; see `Recording.to_pandas`."""
    pandas = library("pandas", "to_pandas()")
    parts = _columns_of(source, signals, grid_s)
    order = np.argsort(np.concatenate([places for _, places, _, _ in parts]), kind="stable")
    index = pandas.Index(np.concatenate([t_s for _, _, t_s, _ in parts])[order], name="t_s")
    columns, begin = {}, 0
    for group, places, _, values in parts:
        for column, samples in zip(group.columns, values, strict=True):
            if len(parts) > 1:
                whole = np.full(len(order), np.nan)
                whole[begin : begin + len(places)] = samples
                samples = whole[order]
            columns[column.name] = samples
        begin += len(places)
    table = pandas.DataFrame(columns, index=index)
    table.attrs["units"] = {column.name: column.unit for group, _, _, _ in parts for column in group.columns}
    return table


def to_xarray(source: Source, signals: Sequence[str] | None = None, grid_s: float | None = None) -> xarray.Dataset:
    """Return the signals with a dimension for each PDO; see `Recording.to_xarray`."""
    xarray = library("xarray", "to_xarray()")
    variables, times = {}, {}
    for group, _, t_s, values in _columns_of(source, signals, grid_s):
        name = "t_s" if grid_s is not None else f"t_s.{group.name}"
        times[name] = xarray.Variable(name, t_s, {"units": "s"})
        for column, samples in zip(group.columns, values, strict=True):
            variables[column.name] = xarray.Variable(name, samples, {"units": column.unit})
    return xarray.Dataset(variables, coords=times)
