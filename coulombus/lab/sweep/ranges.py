"""Values of the varied keys of a sweep, and their combinations: the points.

A key has a list of values, or a range. Every design is a table of numbers from 0 to 1, a row per point, determined by
the seed:

- ``random``: independent and uniform; more runs add points without changing existing ones.
- ``latin_hypercube``: each key has one value in each of n equal parts of its range (McKay,
  Beckman, Conover 1979, doi:10.2307/1268522).
- ``sobol``: the low-discrepancy sequence (Joe, Kuo 2008, doi:10.1137/070709359), scrambled so that it
  stays a net (Matousek 1998, doi:10.1006/jcom.1998.0489): of 2^m points, each of 2^a by 2^b equal boxes
  of the first two keys' ranges has as many points, for each a + b up to m. A power of 2 spreads best.

A grid has every combination; its last key varies fastest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.rigs.errors import toml_value

__all__ = ["Vary", "points", "seed_of"]


@dataclass(frozen=True)
class Vary:
    """A key of the rig file, and its values in the sweep.

    Attributes
    ----------
    key : as ``--set`` takes it
    own : the rig's own value, or None
    values : the choices; empty for a range
    low, high, logarithmic, count : the range; a grid has `count` values of it
    """

    key: str
    own: Any = None
    values: tuple[Any, ...] = ()
    low: float = 0.0
    high: float = 0.0
    logarithmic: bool = False
    count: int = 0

    @property
    def whole(self) -> bool:
        """Whether the rig's value is an integer, so that a range has integers."""
        return isinstance(self.own, int) and not isinstance(self.own, bool)

    def on(self, rig_value: Any) -> Vary:
        """Return the key for a rig with the value `rig_value`: for an integer, a range of integers.

        Raises
        ------
        ValueError
            the range contains no integer
        """
        result = replace(self, own=rig_value)
        if not result.whole or self.values:
            return result
        low, high = math.ceil(self.low), math.floor(self.high)
        if low > high:
            raise ValueError(f"there is no integer from {self.low:g} to {self.high:g}, and the rig has one there")
        return replace(result, low=low, high=high)

    def at(self, u: float) -> Any:
        """Return the value at the share `u` of the range, from 0 to below 1."""
        if self.values:
            return self.values[min(int(u * len(self.values)), len(self.values) - 1)]
        if self.whole and not self.logarithmic:
            return min(int(self.low + u * (self.high - self.low + 1)), int(self.high))
        return self.between(self.low, self.high, u)

    def between(self, a: float, b: float, u: float) -> Any:
        """Return the value at the share `u` of the way from `a` to `b`, on the range's scale."""
        if u in (0.0, 1.0):
            value = b if u else a
        elif self.logarithmic and a > 0 and b > 0:
            value = math.exp(math.log(a) + u * (math.log(b) - math.log(a)))
        else:
            value = a + u * (b - a)
        value = min(max(value, min(a, b)), max(a, b))
        return round(value) if self.whole else value

    def grid(self) -> tuple[Any, ...]:
        """Return the values of a grid, the range's ends included."""
        if self.values:
            return self.values
        shares = (k / (self.count - 1) for k in range(self.count))
        return tuple(dict.fromkeys(self.between(self.low, self.high, u) for u in shares))

    def tried(self) -> tuple[Any, ...]:
        """Return test values of the key: the given ones, or the range's ends and its middle."""
        if self.values:
            return self.values[:3]
        return tuple(dict.fromkeys(self.between(self.low, self.high, u) for u in (0.0, 1.0, 0.5)))

    @property
    def numeric(self) -> bool:
        """Whether its values, and the rig's own if any, are numbers."""
        return all(_number(value) for value in (*self.values, 0.0 if self.own is None else self.own))

    def deviation(self, value: Any) -> float:
        """Return the deviation of `value` from the rig's own, relative to the range of values: 0 is equal.

        For non-numbers, and if the rig has no value, 0 or 1.
        """
        if self.own is None or value == self.own:
            return 0.0
        if not self.numeric:
            return 1.0
        low, high = (min(self.values), max(self.values)) if self.values else (self.low, self.high)
        if self.logarithmic and self.own > 0:
            value, rig_value, low, high = map(math.log, (value, self.own, low, high))
        else:
            rig_value = self.own
        width = high - low
        return float(abs(value - rig_value) / width) if width > 0 else 1.0

    def override(self, value: Any) -> str:
        """Return the value as ``--set`` takes it."""
        return f"{self.key}={toml_value(value)}"


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


Floats: TypeAlias = npt.NDArray[np.float64]


def seed_of(seed: int, point: int) -> int:
    """Return the seed of the simulations of a point."""
    return int(np.random.SeedSequence([seed, point]).generate_state(1)[0])


def points(design: str, vary: Sequence[Vary], runs: int, seed: int) -> list[tuple[Any, ...]]:
    """Return the values of the keys `vary` in each point: all points of a grid, or `runs` points of another design."""
    if design == "grid":
        return list(itertools.product(*(variation.grid() for variation in vary)))
    unit = _unit(design, runs, len(vary), seed)
    return [tuple(variation.at(float(u)) for variation, u in zip(vary, row, strict=True)) for row in unit]


def _unit(design: str, count: int, keys: int, seed: int) -> Floats:
    """Return the design as numbers from 0 to below 1, shaped (`count`, `keys`)."""
    random = np.random.default_rng(np.random.SeedSequence([seed, len(design)]))
    if design == "random" or keys == 0:
        return random.random((count, keys))
    if design == "latin_hypercube":
        columns = [(random.permutation(count) + random.random(count)) / count for _ in range(keys)]
        return np.minimum(np.stack(columns, axis=1), np.nextafter(1.0, 0.0))
    from scipy.stats import qmc  # slow to load

    sequence: Floats = qmc.Sobol(keys, scramble=True, seed=random).random_base2(max(count - 1, 0).bit_length())
    return sequence[:count]
