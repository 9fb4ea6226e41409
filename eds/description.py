"""What an EDS file says: objects, variables, and the defects that were found on the way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.system.errors import CoulombusError

__all__ = ["Description", "Diagnosis", "EdsError", "Object", "Severity", "Value", "Variable"]

Value = int | float | str | bytes | None
Severity = Literal["error", "warning"]


class EdsError(CoulombusError):
    """An EDS file is refused; the text is ``file:line: what; what is expected or what to do``."""

    exit_status = 3


@dataclass(frozen=True)
class Diagnosis:
    """One defect of a file, and what the reader assumed instead.

    A "warning" has one sensible reading; after an "error" something
    is missing that a user should look up.
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

    `default` is what the device starts with: the ParameterValue of a DCF, else the DefaultValue. It
    is None where the file gives none, and where it gives one that cannot be read: `unreadable` then
    says why. With `node_relative` the default is the constant that the node id is added to.
    `data_type` 0 means not known. Numbers are Python numbers: a hexadecimal default of a signed
    type is read as two's complement.
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

    def admits(self, value: float) -> bool:
        """Tell whether a number keeps to the limits."""
        return (self.low is None or self.low <= value) and value <= self.largest

    @property
    def whole(self) -> tuple[int, int] | None:
        """Least and largest number that the data type holds; None
        where it is no integer, or not known.
        """
        data_type = DATA_TYPES.get(self.data_type)
        if data_type is None or data_type.kind not in ("int", "bool"):
            return None
        half = 1 << data_type.bits - 1
        return (-half, half - 1) if data_type.signed else (0, 2 * half - 1)

    @property
    def largest(self) -> float:
        """Largest number that the object takes, by its type and its
        HighLimit; infinite where neither tells.

        A HighLimit of 0 without a LowLimit below 0 is one that nobody
        has set: editors of EDS files write it.
        """
        most = math.inf if self.whole is None else max(self.whole)
        if self.high is None or (self.high == 0 and (self.low is None or self.low >= 0)):
            return most
        return min(most, self.high)

    @property
    def bits(self) -> int:
        """Width of the data type; 0 where it is not fixed or not known."""
        data_type = DATA_TYPES.get(self.data_type)
        return data_type.bits if data_type else 0


@dataclass(frozen=True)
class Object:
    """One index of the object dictionary; a VAR or DOMAIN has the one variable 0."""

    index: int
    name: str
    object_type: int
    variables: Mapping[int, Variable]


@dataclass(frozen=True)
class Description:
    """What an EDS file says of a device; `info` is [DeviceInfo],
    `dummies` the types that may fill a PDO's gaps.

    `node_id` and `bit_rate` [bit/s] are those of a DCF's
    [DeviceComissioning], 0 where there are none.
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
        """What others have computed of this description alone, each under a key of its own.

        It does not change, so a device that is made of it again need not compute that again.
        """
        return {}

    def has(self, index: int, subindex: int | None = None) -> bool:
        """Tell whether the object, or its sub-index, is described."""
        entry = self.objects.get(index)
        return entry is not None and (subindex is None or subindex in entry.variables)

    def variable(self, index: int, subindex: int) -> Variable:
        """Return one variable; KeyError names the file and what it lacks."""
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
