"""Convert a recording to a pandas DataFrame or an xarray Dataset (the extra ``export``)."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from coulombus.recording.extras import library
from coulombus.recording.protocols import Readable
from coulombus.recording.sample_groups import Array, Group, groups_of, stretches
from coulombus.rigs.arguments import WrongCall

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = ["to_pandas", "to_xarray"]


def _gathered(
    source: Readable, signals: Sequence[str] | None, grid_s: float | None
) -> list[tuple[Group, Array, Array, list[Array]]]:
    """Return the places, times [s] and values of each group's rows."""
    if grid_s is not None and (not isinstance(grid_s, Real) or isinstance(grid_s, bool)):
        raise WrongCall(f"grid_s is {grid_s!r}: expected a number of seconds, as in grid_s=0.001")
    grid_ns = None if grid_s is None else round(grid_s * 1e9)
    if grid_ns is not None and grid_ns < 1000:
        raise ValueError(f"grid_s is {grid_s}: expected at least 1e-6 s, as in grid_s=0.001")
    groups = groups_of(source, signals, grid_ns)
    parts = [stretch.rows for stretch in stretches(source, groups, grid_ns)]
    gathered = []
    for k, group in enumerate(groups):
        places = []
        for rows in parts:
            places.append(rows[k].order)
        order = np.concatenate([np.zeros(0, np.int64), *places])
        t_s = np.concatenate([np.zeros(0), *(rows[k].t_s for rows in parts)])
        values = [np.concatenate([rows[k].values[c] for rows in parts]) for c in range(len(group.columns))]
        gathered.append((group, order, t_s, values))
    return gathered


def to_pandas(source: Readable, signals: Sequence[str] | None = None, grid_s: float | None = None) -> pandas.DataFrame:
    """Return the signals as columns over the times ``t_s`` [s]; see `Recording.to_pandas`."""
    pandas = library("pandas", "to_pandas()")
    parts = _gathered(source, signals, grid_s)
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


def to_xarray(source: Readable, signals: Sequence[str] | None = None, grid_s: float | None = None) -> xarray.Dataset:
    """Return the signals with a dimension for each PDO; see `Recording.to_xarray`."""
    xarray = library("xarray", "to_xarray()")
    variables, times = {}, {}
    for group, _, t_s, values in _gathered(source, signals, grid_s):
        name = "t_s" if grid_s is not None else f"t_s.{group.name}"
        times[name] = xarray.Variable(name, t_s, {"units": "s"})
        for column, samples in zip(group.columns, values, strict=True):
            variables[column.name] = xarray.Variable(name, samples, {"units": column.unit})
    return xarray.Dataset(variables, coords=times)
