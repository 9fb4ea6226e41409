"""How often the hierarchical fit of a group holds the median and the spread that its JNDs are drawn from.

The observers of a group answer as those of `benchmarks.observers` do, "ideal" and "all at random".
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.observers import JND, METHODS, SEED, SPREAD, Show, answers_of, share, within, write_table
from coulombus.lab.study.results.hierarchy import GroupFit, hierarchical
from coulombus.lab.study.results.posterior import counted, posterior

__all__ = ["group_fit", "observer_groups"]

SIZE = 24
CASES = ("ideal", "all at random")
HEAD = ("method", "observers", "median JND held", "spread held", "median JND, mean error", "spread, median")


def group_fit(method: str, case: str, number: int) -> GroupFit:
    """Return the hierarchical fit of group `number`."""
    subjects = range(number * SIZE, (number + 1) * SIZE)
    fit = hierarchical({str(k): posterior(counted(*answers_of(method, case, k)[1])) for k in subjects})
    assert fit is not None
    return fit


def _row(method: str, case: str, fits: Sequence[GroupFit]) -> tuple[str, ...]:
    return (
        method,
        case,
        share(within(fit.jnd_95, JND) for fit in fits),
        share(within(fit.spread_95, SPREAD) for fit in fits),
        f"{np.exp(np.mean([np.log(fit.jnd / JND) for fit in fits])) - 1:+.1%}",
        f"{np.median([fit.spread for fit in fits]):.3f}",
    )


def observer_groups(show: Show, count: int, document: Path | None = None, processes: int = 2) -> None:
    """Show the coverage of the hierarchical fit with `count` groups; write it into `document`."""
    rows = []
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for method in METHODS:
            for case in CASES:
                rows.append(_row(method, case, list(pool.map(partial(group_fit, method, case), range(count)))))
                show(f"{method}, {case}: median JND held, spread held", ", ".join(rows[-1][2:4]), "90 to 99 %")
    if document is not None:
        said = f"{count} groups of {SIZE} in each row, seed {SEED}, spread of log JND {SPREAD}:"
        write_table(document, "groups", said, [HEAD, *rows])
