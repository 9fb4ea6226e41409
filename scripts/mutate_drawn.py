#!/usr/bin/env python3
"""Mutation test of the whole product: mutants drawn at random, and the tests nearest to each.

    .venv/bin/python scripts/mutate_drawn.py 100 --seed 202648
    .venv/bin/python scripts/mutate_drawn.py 100 --seed 202648 --list

A module is drawn by its number of lines, then one of its mutants, so that each mutant of the
product is about as likely. It is run against the nearest tests: those of the files that name the
module, then those that name a module which names it (`tests_of`). What survives these is run
against more of them, and for longer (`ROUNDS`). Exit status: 0; a survivor is no error.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import sys
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from mutant_runs import NOT_COVERED, Tests, Verdict, run  # noqa: E402
from mutants import Source  # noqa: E402

TOPS = ("coulombus", "node", "host", "eds", "sim_bus")
NAMED = re.compile(r"coulombus(?:\.\w+)+")
TIMEOUT = 3.0  # processor time of a mutant, in multiples of its tests' own


class Round(NamedTuple):
    """How many files of tests a mutant is run against, and for how long they run without one [s]."""

    files: int
    budget_s: float


ROUNDS = (Round(8, 15.0), Round(24, 60.0))
"""What survives the first is run again in the second."""


@dataclass(frozen=True)
class Drawn:
    """A drawn mutant: its module and number there (of `Source.edits`), where it is, its edit, and what became of it."""

    name: str
    number: int
    where: str
    status: str
    by: str

    @property
    def lives(self) -> bool:
        """Whether nothing killed it."""
        return self.status not in ("killed", "timeout")


def _names(path: Path, modules: Mapping[str, Path]) -> set[str]:
    """Return the modules that a file names: in an import, or in a text, as the commands are loaded."""
    named = set()
    for match in NAMED.findall(path.read_text(encoding="utf-8")):
        name = match
        while name and name not in modules:
            name = name.rpartition(".")[0]
        named.add(name)
    return named - {"", "coulombus"}


def product() -> dict[str, Path]:
    """Return the product's modules by the names of their import, without the examples."""
    paths = (path for top in TOPS for path in sorted((ROOT / top).rglob("*.py")) if "examples" not in path.parts)
    modules = {}
    for path in paths:
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts if parts[0] == "coulombus" else ("coulombus", *parts))
        modules[name.removesuffix(".__init__")] = path
    return modules


def tests_of(name: str, named_by: Mapping[str, set[str]], tests: Mapping[str, set[str]], most: int) -> tuple[str, ...]:
    """Return at most so many of the nearest files of tests: of those as near, those first that are called like the
    module, and that name the fewest modules.
    """
    nearest: list[str] = []
    ring, seen = {name}, {name}
    while ring and len(nearest) < most:
        here = [test for test, named in tests.items() if named & ring and test not in nearest]
        stem = name.rpartition(".")[2]
        nearest += sorted(here, key=lambda test: (stem not in test, len(tests[test])))
        packages = {module.rpartition(".")[0] for module in ring} - {"coulombus", ""}
        ring = (packages | {user for module in ring for user in named_by.get(module, ())}) - seen
        seen |= ring
    return tuple(nearest[:most])


def run_drawn(name: str, numbers: tuple[int, ...], tests: tuple[str, ...], budget_s: float) -> list[Drawn]:
    """Run some mutants of a module, in a process of its own."""
    path = product()[name]
    text = path.read_text(encoding="utf-8")
    compiled = "coulombus.kernels" not in text  # its kernels, if it has any, are not mutated as machine code
    os.environ["NUMBA_DISABLE_JIT"] = "0" if compiled else "1"
    source = Source(str(path.relative_to(ROOT)), text)
    edits = source.edits()
    mutants = [edits[k] for k in numbers]
    verdicts: dict[int, Verdict] = {}
    marks = "real_time" if compiled else "real_time or slow"
    error = run(source, mutants, Tests(tests, marks=marks, budget_s=budget_s), 1, TIMEOUT, verdicts.__setitem__)
    lost = Verdict("not run", error, 0.0)
    return [
        Drawn(name, number, f"{source.path}:{m.line}: {m.operator}: {m.change}", v.status, v.by)
        for number, m, v in ((numbers[k], m, verdicts.get(k, lost)) for k, m in enumerate(mutants))
    ]


def drawn(count: int, seed: int) -> dict[str, tuple[int, ...]]:
    """Draw mutants of the product: their numbers among the edits of each module."""
    modules = product()
    names, lines = list(modules), [path.read_text(encoding="utf-8").count("\n") for path in modules.values()]
    random_ = random.Random(f"draw {seed}")
    numbers: dict[str, set[int]] = {}
    while sum(map(len, numbers.values())) < count:
        (name,) = random_.choices(names, lines)
        source = Source(name, modules[name].read_text(encoding="utf-8"))
        edits = source.edits()
        k = random_.randrange(len(edits)) if edits else -1
        if k >= 0 and source.changes(edits[k]):
            numbers.setdefault(name, set()).add(k)
    return {name: tuple(sorted(some)) for name, some in numbers.items()}


def run_all(numbers: Mapping[str, tuple[int, ...]], jobs: int) -> list[Drawn]:
    """Run drawn mutants round by round; return them all."""
    modules = product()
    named_by: dict[str, set[str]] = {}
    for user, path in modules.items():
        for name in _names(path, modules):
            named_by.setdefault(name, set()).add(user)
    tests = {str(path.relative_to(ROOT)): _names(path, modules) for path in sorted((ROOT / "tests").rglob("test_*.py"))}
    ended: dict[tuple[str, int], Drawn] = {}
    living = dict(numbers)
    for round_ in ROUNDS:
        with ProcessPoolExecutor(jobs, get_context("spawn"), max_tasks_per_child=1) as pool:
            runs = [
                pool.submit(run_drawn, name, edits, tests_of(name, named_by, tests, round_.files), round_.budget_s)
                for name, edits in living.items()
            ]
            for k, done in enumerate(as_completed(runs), 1):
                ended |= {(mutant.name, mutant.number): mutant for mutant in done.result()}
                alive = sum(mutant.lives for mutant in ended.values())
                print(f"\r{round_.files} files: {k} of {len(runs)} modules, {alive} live ", end="", file=sys.stderr)
        print(file=sys.stderr)
        living = {name: tuple(k for k in edits if ended[name, k].lives) for name, edits in living.items()}
        living = {name: edits for name, edits in living.items() if edits}
    return list(ended.values())


def main() -> int:
    """Draw mutants, run them, print the survivors and their share."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("count", type=int, help="so many mutants")
    add("--seed", type=int, default=0)
    add("--jobs", type=int, default=os.cpu_count() or 1, help="modules at the same time")
    add("--list", action="store_true", help="list the mutants and run none")
    options = parser.parse_args()
    os.chdir(ROOT)
    numbers = drawn(options.count, options.seed)
    if options.list:
        print(*(f"{name} {number}" for name, some in sorted(numbers.items()) for number in some), sep="\n")
        return 0
    mutants = run_all(numbers, options.jobs)
    for mutant in mutants:
        if mutant.lives:
            print(f"{mutant.status.upper()} {mutant.where}" + (f" ({mutant.by})" if mutant.by else ""))
    counts = Counter(mutant.status for mutant in mutants)
    ran = sum(counts[status] for status in ("killed", "timeout", "survived"))
    bare = sum(mutant.by == NOT_COVERED for mutant in mutants)
    print(
        f"{ran} mutants of {len(numbers)} modules, seed {options.seed}: {counts['survived']} survived, "
        f"{100 * counts['survived'] / max(ran, 1):.1f} %; no test of {ROUNDS[-1].files} files reached {bare} of these "
        f"in {ROUNDS[-1].budget_s:g} s; {counts['not made'] + counts['not run']} not run"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
