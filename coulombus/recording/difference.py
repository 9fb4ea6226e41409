"""What a comparison of two recordings comes to (`recording.comparison`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["Comparison", "Difference", "Pair"]

Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pair:
    """A signal of both recordings at the same times: those of the first recording's samples."""

    t_s: Floats
    a: Floats
    b: Floats

    @property
    def difference(self) -> Floats:
        """The first less the second; 0 where neither is a number."""
        return np.where(np.isnan(self.a) & np.isnan(self.b), 0.0, self.a - self.b)


@dataclass(frozen=True)
class Difference:
    """How far a signal of one recording is from the other's, in `unit`."""

    name: str
    unit: str
    samples: int
    max: float
    rms: float
    at_s: float | None
    """When it is largest, in the first recording's time."""
    phase: str
    """In which phase that is."""
    tolerance: float | None
    """None: it is not judged."""
    equal: bool
    """Whether it is within its tolerance; true where it is not judged."""


@dataclass(frozen=True)
class Comparison:
    """What a comparison came to."""

    a: str
    b: str
    same_bytes: bool
    equal: bool
    signals: tuple[Difference, ...]
    remarks: tuple[str, ...]
    pairs: Mapping[str, Pair]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values, without the samples."""
        values = {"a": self.a, "b": self.b, "same_bytes": self.same_bytes, "equal": self.equal}
        return {**values, "signals": [asdict(signal) for signal in self.signals], "remarks": list(self.remarks)}
