"""Content of an EDS file: objects, variables, and the defects found while reading; an object by the user's notation."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.system.errors import CoulombusError

__all__ = ["Description", "Diagnosis", "EdsError", "Object", "Severity", "Value", "Variable", "object_key"]

Value = int | float | str | bytes | None
Severity = Literal["error", "warning"]


class EdsError(CoulombusError):
    """A refused EDS file; the text is ``file:line: what; what is expected or what to do``."""

    exit_status = 3


@dataclass(frozen=True)
class Diagnosis:
    """A defect of a file, and the value that the reader assumed instead.

    A "warning" has one sensible reading; after an "error" information is missing that a user should
    look up.
    """

    path: str
    line: int
    severity: Severity
    text: str
    assumed: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.severity}: {self.text}; assumed {self.assumed}"


@dataclass(frozen=True)
class Variable:
    """One sub-index of the object dictionary.

    `default` is the value at the device's start: the ParameterValue of a DCF, else the
    DefaultValue. It is None if the file gives none, or an unreadable value: `unreadable` then says
    why. With `node_relative` the node id is added to the default. `data_type` 0 means unknown.
    Numbers are Python numbers: a hexadecimal default of a signed type is read as two's complement.
    """

    index: int
    subindex: int
    name: str
    data_type: int
    access: str
    default: Value
    node_relative: bool
    low: int | float | None
    high: int | float | None
    pdo_mappable: bool
    line: int
    unreadable: str = ""
    unit: str = ""
    """Unit of the raw number, if the file has one."""

    def admits(self, value: float) -> bool:
        """Tell whether a number is within the limits."""
        return (self.low is None or self.low <= value) and value <= self.largest

    @property
    def whole(self) -> tuple[int, int] | None:
        """Smallest and largest number of the data type; None if it is no integer type, or unknown."""
        data_type = DATA_TYPES.get(self.data_type)
        if data_type is None or data_type.kind not in ("int", "bool"):
            return None
        half = 1 << data_type.bits - 1
        return (-half, half - 1) if data_type.signed else (0, 2 * half - 1)

    @property
    def largest(self) -> float:
        """Largest number that the object admits, by its type and its HighLimit; infinite if neither sets a limit.

        A HighLimit of 0 without a LowLimit below 0 counts as not set: editors of EDS files write it.
        """
        limit = math.inf if self.whole is None else max(self.whole)
        if self.high is None or (self.high == 0 and (self.low is None or self.low >= 0)):
            return limit
        return min(limit, self.high)

    @property
    def bits(self) -> int:
        """Width of the data type; 0 if it is not fixed or unknown."""
        data_type = DATA_TYPES.get(self.data_type)
        return data_type.bits if data_type else 0


@dataclass(frozen=True)
class Object:
    """One index of the object dictionary; a VAR or DOMAIN has only the variable 0."""

    index: int
    name: str
    object_type: int
    variables: Mapping[int, Variable]


@dataclass(frozen=True)
class Description:
    """Description of a device by an EDS file; `info` is [DeviceInfo], `dummies` the types that may fill a
    PDO's gaps.

    `node_id` and `bit_rate` [bit/s] are those of a DCF's [DeviceComissioning], 0 if absent.
    """

    path: str
    text: str
    objects: Mapping[int, Object]
    diagnoses: tuple[Diagnosis, ...]
    info: Mapping[str, str]
    dummies: frozenset[int] = frozenset()
    node_id: int = 0
    bit_rate: int = 0

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """Cache for results that depend on this description alone; each user has its own key.

        The description does not change, so a second device of the same description reuses them.
        """
        return {}

    def has(self, index: int, subindex: int | None = None) -> bool:
        """Tell whether the description has the object, or its sub-index."""
        entry = self.objects.get(index)
        return entry is not None and (subindex is None or subindex in entry.variables)

    def variable(self, index: int, subindex: int) -> Variable:
        """Return a variable; KeyError names the file and the missing object."""
        entry = self.objects.get(index)
        if entry is None:
            raise KeyError(f"{self.path} describes no object {index:04X}h")
        if subindex not in entry.variables:
            raise KeyError(f"{self.path}: object {index:04X}h ({entry.name}) has no sub-index {subindex}")
        return entry.variables[subindex]

    def default(self, index: int, subindex: int, node_id: int) -> Value:
        """Return the variable's default with ``$NODEID`` resolved."""
        variable = self.variable(index, subindex)
        if variable.node_relative and isinstance(variable.default, int):
            return variable.default + node_id
        return variable.default


_NUMBERS = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})h?(?::(?:0x)?([0-9A-Fa-f]{1,2})h?)?")


def object_key(text: str, description: Description) -> tuple[int, int] | str:
    """Return index and sub-index of an object, given as "7300:01" or by its name in the EDS; if there is no
    such object, return the text of the expectation instead.
    """
    numbers = _NUMBERS.fullmatch(text.strip())
    if numbers:
        key = int(numbers[1], 16), int(numbers[2] or "0", 16)
        if description.has(*key):
            return key
        entry = description.objects.get(key[0])
        subs = ", ".join(f"{key[0]:04X}:{sub:02X}" for sub in entry.variables) if entry else ""
        return f"an object of {description.path}" + (f"; it has {subs}" if subs else "")
    names: dict[str, list[tuple[int, int]]] = {}
    for index, entry in description.objects.items():
        for subindex, variable in entry.variables.items():
            names.setdefault(variable.name, []).append((index, subindex))
    places = names.get(text.strip(), [])
    if len(places) == 1:
        return places[0]
    if places:
        keys = " or ".join(f"{index:04X}:{subindex:02X}" for index, subindex in places[:4])
        return f"one object; this is the name of {len(places)}: {keys}"
    return f"INDEX:SUB as 7300:01, or a name in {description.path}{_nearest(text, names)}"


def _nearest(text: str, names: Iterable[str]) -> str:
    matches = difflib.get_close_matches(text, names, 1, 0.6)
    return f"; did you mean '{matches[0]}'?" if matches else ""
