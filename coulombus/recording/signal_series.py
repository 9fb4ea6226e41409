"""One signal over time, and the signals of PDOs by name, decoded when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.pdo_columns import PdoTable

__all__ = ["Series", "SignalsOfTables"]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """One signal: times [s], values in `unit`.

    Bit fields (unit "") are integers, the rest is float64.
    """

    t_s: Floats
    values: Array
    unit: str

    def __len__(self) -> int:
        return len(self.t_s)

    def held(self, t_s: Floats, before: float) -> Floats:
        """Return the last value at or before each of the times `t_s` [s]; `before` if there is none."""
        last = np.searchsorted(self.t_s, t_s, "right") - 1
        return np.append(self.values.astype(np.float64), before)[last]  # -1: the appended value


class SignalsOfTables(Mapping[str, Series]):
    """The signals of PDOs by name, each decoded when it is asked for."""

    def __init__(self, tables: Sequence[PdoTable], epoch_ns: int) -> None:
        self._places = {signal.name: (table, signal) for table in tables for signal in table.pdo.signals}
        self._epoch_ns = epoch_ns
        self._times: dict[str, Floats] = {}
        self._series: dict[str, Series] = {}

    def __getitem__(self, name: str) -> Series:
        if name not in self._series:
            table, signal = self._places[name]
            if table.name not in self._times:
                self._times[table.name] = (table.t_ns - self._epoch_ns) / 1e9
            self._series[name] = Series(self._times[table.name], table.column(signal), signal.unit)
        return self._series[name]

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
