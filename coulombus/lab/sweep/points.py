"""The points of a sweep: the values of the varied keys in each point.

Every design is a table of numbers from 0 to 1, a row per point, determined by the seed:

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
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.lab.sweep.ranges import Vary

__all__ = ["points", "seed_of"]

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
