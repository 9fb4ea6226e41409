"""Tables of angle and torque from any source: CSV, Parquet or MAT files.

A column's name has its unit in any of these forms: ``angle_deg``, ``angle [deg]``, ``angle (deg)``;
without a unit it is SI. Columns are recognised by name (`NAMES`), or given by ``--column
angle=PHI``. The torque drives the angle: positive torque in the positive sense.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.eds.regular_file import read_regular
from coulombus.recording.extras import library
from coulombus.system.errors import CoulombusError

__all__ = ["SUFFIXES", "TableError", "TorqueTable", "is_table", "read_table"]

Floats: TypeAlias = npt.NDArray[np.float64]

SUFFIXES = (".csv", ".parquet", ".mat")
NAMES: Mapping[str, tuple[str, ...]] = {
    "t": ("t", "time"),
    "angle": ("angle", "x", "position", "pos", "theta", "phi", "q"),
    "torque": ("torque", "tau", "moment", "friction"),
    "brake": ("brake", "current", "setpoint"),
    "load": ("load",),
}
"""Accepted column names by quantity."""
OPTIONAL = ("brake", "load")
_TORQUES = {"Nm": 1.0, "N m": 1.0, "N*m": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "kNm": 1e3}
UNITS: Mapping[str, Mapping[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi, "turn": 2 * math.pi},
    "torque": _TORQUES,
    "brake": {"Nm": 1.0, "mNm": 1e-3, "A": 1.0, "mA": 1e-3, "V": 1.0},
    "load": _TORQUES,
}
LEAST_ROWS = 100


class TableError(CoulombusError, ValueError):
    """The file is not a table of angle and torque; the text names the lack."""

    exit_status = 3


@dataclass(frozen=True)
class TorqueTable:
    """A recording as three to five columns.

    Attributes
    ----------
    t_s, angle_rad, torque_Nm : of each row
    brake : the brake's command, in any unit, or None
    load_Nm : torque of a load that drives the angle, too, or None
    """

    path: str
    t_s: Floats
    angle_rad: Floats
    torque_Nm: Floats
    brake: Floats | None = None
    load_Nm: Floats | None = None


def is_table(path: Path) -> bool:
    """Return whether a file is a table, by its name; a CSV file of frames has an ``arbitration_id``."""
    if path.suffix.lower() not in SUFFIXES:
        return False
    if path.suffix.lower() != ".csv":
        return True
    with path.open("rb") as file:
        return b"arbitration_id" not in file.read(1000)


def read_table(path: str | os.PathLike[str], columns: Sequence[str] = (), units: Sequence[str] = ()) -> TorqueTable:
    """Read a table.

    Parameters
    ----------
    columns : ``angle=NAME``: column of the angle (`NAMES`)
    units : ``angle=deg``: its unit, whatever its name says

    Raises
    ------
    TableError
        a column is missing, not numeric, or of another length; the times do not increase
    """
    path = Path(path)
    column_names, unit_names = _pairs(path, "--column", columns), _pairs(path, "--unit", units)
    try:
        raw = {".csv": _csv, ".parquet": _parquet, ".mat": _mat}[path.suffix.lower()](path)
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror or error})") from error
    values: dict[str, Floats] = {}
    for what in NAMES:
        name = column_names.get(what) or next((name for name in raw if _split(name)[0].lower() in NAMES[what]), None)
        if name is None and what in OPTIONAL:
            continue
        if name is None or name not in raw:
            has = ", ".join(raw) or "nothing"
            raise TableError(
                f"{path}: no column for {what} ({name or '/'.join(NAMES[what])}); it has {has}; give --column {what}=NAME"
            )
        values[what] = np.ravel(np.asarray(raw[name], np.float64)) * _factor(
            path, what, unit_names.get(what) or _split(name)[1]
        )
    return _checked(path, values)


def _checked(path: Path, values: dict[str, Floats]) -> TorqueTable:
    lengths = {what: len(column) for what, column in values.items()}
    if len(set(lengths.values())) > 1:
        raise TableError(f"{path}: the columns have different lengths: {lengths}")
    t = values["t"]
    if len(t) < LEAST_ROWS:
        raise TableError(f"{path}: {len(t)} rows; expected at least {LEAST_ROWS}")
    whole = np.all([np.isfinite(column) for column in values.values()], axis=0)
    values = {what: column[whole] for what, column in values.items()}
    if not np.all(np.diff(values["t"]) > 0.0):
        row = int(np.argmax(np.diff(values["t"]) <= 0.0)) + 2
        raise TableError(f"{path}: the time does not grow at row {row}; sort the rows by time")
    return TorqueTable(
        str(path), values["t"], values["angle"], values["torque"], values.get("brake"), values.get("load")
    )


def _pairs(path: Path, option: str, texts: Sequence[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        what, equals, value = text.partition("=")
        if not equals or what not in NAMES:
            raise TableError(f"{path}: {option} {text}: expected one of {', '.join(NAMES)}, '=' and a value")
        pairs[what] = value
    return pairs


def _split(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, and the unit or None."""
    match = re.fullmatch(r"\s*(.*?)\s*[\[(]\s*(.*?)\s*[\])]\s*", name)
    if match:
        return match[1].rstrip("_ "), match[2]
    stem, _, unit = name.strip().rpartition("_")
    units = {unit for kinds in UNITS.values() for unit in kinds}
    return (stem, unit) if stem and unit in units else (name.strip(), None)


def _factor(path: Path, what: str, unit: str | None) -> float:
    """Return the factor from the unit to SI."""
    if unit is None:
        return 1.0
    if unit not in UNITS[what]:
        raise TableError(
            f"{path}: unit {unit!r} of {what}: expected one of {', '.join(UNITS[what])}; give --unit {what}=UNIT"
        )
    return UNITS[what][unit]


def _csv(path: Path) -> dict[str, Any]:
    try:
        text = read_regular(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TableError(f"{path}: no UTF-8") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("#", "%"))]
    if not lines:
        raise TableError(f"{path}: the file is empty")
    delimiter = max(",;\t", key=lines[0].count)
    rows = list(csv.reader(lines, delimiter=delimiter))
    names = [name.strip() for name in rows[0]]
    try:
        numbers = np.array(
            [[float(cell) if cell.strip() else math.nan for cell in row] for row in rows[1:]], np.float64
        )
    except ValueError as error:
        raise TableError(f"{path}: {error}; expected a row of names, then numbers") from error
    if numbers.ndim != 2 or numbers.shape[1] != len(names):
        raise TableError(f"{path}: expected {len(names)} numbers in each row below the names")
    return {name: numbers[:, k] for k, name in enumerate(names)}


def _parquet(path: Path) -> dict[str, Any]:
    parquet = library("pyarrow.parquet", "a Parquet file")
    try:
        table = parquet.read_table(path)
        return {name: table[name].to_numpy() for name in table.column_names}
    except (ValueError, OSError) as error:  # pyarrow's own errors are ValueErrors
        raise TableError(f"{path}: no Parquet file ({error})") from error


def _mat(path: Path) -> dict[str, Any]:
    """Return the vectors of a MAT file (up to version 7), and those of its structures."""
    from scipy.io import loadmat

    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=True)
    except (ValueError, NotImplementedError, TypeError, IndexError) as error:
        raise TableError(f"{path}: no MAT file that can be read ({error}); save it with -v7") from error
    vectors: dict[str, Any] = {}
    for name, raw in content.items():
        if name.startswith("__"):
            continue
        value = np.asarray(raw)
        if value.dtype.names:
            vectors |= {field: np.ravel(value[field].item()) for field in value.dtype.names if value.size == 1}
        elif value.dtype.kind in "fiu" and value.ndim == 1:
            vectors[name] = value
    return vectors
