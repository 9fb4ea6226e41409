"""Motions for the evaluation of a law: a CSV file, a sine, a ramp."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.regular_file import read_regular
from coulombus.system.errors import CoulombusError

__all__ = ["MotionFileError", "MotionPath", "ramp", "read_columns", "read_motion", "sine"]

COLUMNS = ("t_s", "x_rad")
MOST_ERRORS = 10
MOST = 1e100
"""Largest number in a motion, so that all computed values stay finite."""


class MotionFileError(CoulombusError):
    """A motion file cannot be used; each line has the place, the value and the expectation."""

    exit_status = 3


class MotionPath(NamedTuple):
    """Angles over time."""

    t_s: npt.NDArray[np.float64]
    x_rad: npt.NDArray[np.float64]


def sine(amplitude_rad: float, frequency_Hz: float, seconds: float, rate_Hz: float) -> MotionPath:
    r"""Return :math:`x = A \sin(2\pi f t)`, sampled at `rate_Hz`."""
    t_s = np.arange(round(seconds * rate_Hz) + 1) / rate_Hz
    return MotionPath(t_s, amplitude_rad * np.sin(2 * math.pi * frequency_Hz * t_s))


def ramp(speed_rad_s: float, seconds: float, rate_Hz: float) -> MotionPath:
    """Return x = v t, sampled at `rate_Hz`."""
    t_s = np.arange(round(seconds * rate_Hz) + 1) / rate_Hz
    return MotionPath(t_s, speed_rad_s * t_s)


def read_motion(path: Path) -> MotionPath:
    """Read a CSV file with the columns t_s [s] and x_rad [rad].

    Further columns, empty lines and lines that begin with # are ignored.

    Raises
    ------
    MotionFileError
        the text names the first errors, each with ``file:line``
    """
    t_s, x_rad = read_columns(path, COLUMNS)
    return MotionPath(t_s, x_rad)


def read_columns(path: Path, columns: tuple[str, ...]) -> tuple[npt.NDArray[np.float64], ...]:
    """Read columns of numbers from a CSV file; the first column has ascending times.

    Raises
    ------
    MotionFileError
        the text names the first errors, each with ``file:line``
    """
    expected = f"a CSV file with the columns {','.join(columns)}"
    try:
        lines = read_regular(path).decode("utf-8-sig").splitlines()
    except OSError as error:
        raise MotionFileError(f"{path}: cannot be read ({error.strerror}); expected {expected}") from error
    except UnicodeDecodeError as error:
        raise MotionFileError(f"{path}:1: no UTF-8; expected {expected}") from error
    rows = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise MotionFileError(f"{path}:1: the file is empty; expected {expected}")
    number, head = rows[0]
    names = [cell.strip() for cell in _cells(head)]
    if any(names.count(column) != 1 for column in columns):
        hint = "; columns are parted by commas" if ";" in head or "\t" in head else ""
        raise MotionFileError(
            f"{path}:{number}: got '{head[:60].strip()}', expected a header with the columns {','.join(columns)}{hint}"
        )
    places = [names.index(column) for column in columns]
    values: list[list[float]] = []
    mistakes, before = [], -math.inf
    for number, line in rows[1:]:
        cells = _cells(line)
        row = [_number(cells[place]) for place in places] if len(cells) == len(names) else [math.nan]
        if not all(abs(cell) <= MOST for cell in row):
            mistakes.append(
                f"{path}:{number}: got '{line[:60].strip()}', expected finite numbers in {len(names)} columns, "
                f"within +-{MOST:g}"
            )
            continue
        if row[0] <= before:
            mistakes.append(f"{path}:{number}: t_s: got {row[0]:g} after {before:g}, expected times that grow")
        elif values and not abs(row[1] - values[-1][1]) <= MOST * (row[0] - before):
            mistakes.append(
                f"{path}:{number}: {columns[1]}: got {row[1]:g} after {values[-1][1]:g} in {row[0] - before:g} s, "
                f"expected a speed within +-{MOST:g} rad/s"
            )
        before = row[0]
        values.append(row)
    if len(rows) < 3:
        mistakes.append(f"{path}:{rows[-1][0]}: {len(rows) - 1} samples; expected two or more")
    if mistakes:
        more = [f"{path}: {len(mistakes) - MOST_ERRORS} further lines are wrong"] if len(mistakes) > MOST_ERRORS else []
        raise MotionFileError("\n".join(mistakes[:MOST_ERRORS] + more))
    table = np.array(values)
    return tuple(table[:, k].copy() for k in range(len(columns)))


def _cells(line: str) -> list[str]:
    """Return a line's cells; a cell may be quoted."""
    return line.split(",") if '"' not in line else next(csv.reader([line]))


def _number(cell: str) -> float:
    if "_" in cell:  # Python's digit grouping: 1_000
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return math.nan
