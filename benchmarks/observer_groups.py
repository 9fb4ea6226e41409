"""How often the hierarchical fit of a group holds the median and the spread of those whom it stands for.

The observers answer as those of `benchmarks.observers` do, "ideal" and "all at random". Each group is
drawn at random from a pool of them, whose median and spread are the truth: no observer is twice in a
group, but most are in several groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.observers import METHODS, SEED, Show, answers_of, share, within, write_table
from coulombus.lab.study.results.hierarchy import GroupFit, hierarchical
from coulombus.lab.study.results.posterior import Posterior, counted, posterior

__all__ = ["group_fit", "observer_groups", "pooled"]

SIZE, POOL = 24, 240
CASES = ("ideal", "all at random")
HEAD = ("method", "observers", "median JND held", "spread held", "median JND, mean error", "spread, median error")


def pooled(method: str, case: str, subject: int) -> tuple[float, Posterior]:
    """Return JND and posterior of an observer, without the grid, of which a group needs sigma alone."""
    (jnd, _), answers = answers_of(method, case, subject)
    return jnd, replace(posterior(counted(*answers)), weight=np.zeros(0))


def group_fit(pool: Sequence[tuple[float, Posterior]], number: int) -> GroupFit:
    """Return the hierarchical fit of group `number` out of a pool of observers."""
    members = np.random.default_rng([SEED, 3, number]).choice(len(pool), SIZE, replace=False)
    fit = hierarchical({str(k): pool[k][1] for k in members})
    assert fit is not None
    return fit


def _row(method: str, case: str, pool: Sequence[tuple[float, Posterior]], count: int) -> tuple[str, ...]:
    logs = np.log([jnd for jnd, _ in pool])
    median, spread = float(np.exp(logs.mean())), float(logs.std())
    fits = [group_fit(pool, number) for number in range(count)]
    return (
        method,
        case,
        share(within(fit.jnd_95, median) for fit in fits),
        share(within(fit.spread_95, spread) for fit in fits),
        f"{np.exp(np.mean([np.log(fit.jnd / median) for fit in fits])) - 1:+.1%}",
        f"{np.median([fit.spread for fit in fits]) / spread - 1:+.1%}",
    )


def observer_groups(show: Show, count: int, document: Path | None = None, processes: int = 2) -> None:
    """Show the coverage of the hierarchical fit with `count` groups; write it into `document`."""
    rows = []
    with ProcessPoolExecutor(processes, get_context("spawn")) as executor:
        for method in METHODS:
            for case in CASES:
                pool = list(executor.map(partial(pooled, method, case), range(min(POOL, count * SIZE)), chunksize=8))
                rows.append(_row(method, case, pool, count))
                show(f"{method}, {case}: median JND held, spread held", ", ".join(rows[-1][2:4]), "90 to 99 %")
    if document is not None:
        caption = f"{count} groups of {SIZE} in each row, drawn from {POOL} observers, seed {SEED}:"
        write_table(document, "groups", caption, [HEAD, *rows])
