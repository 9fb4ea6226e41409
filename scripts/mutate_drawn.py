#!/usr/bin/env python3
"""Mutation test of the whole product: mutants drawn at random, and the tests that cover each.

    .venv/bin/python scripts/mutate_drawn.py 100 --seed 202648
    .venv/bin/python scripts/mutate_drawn.py 100 --seed 202648 --list

A module is drawn by its number of lines, then one of its mutants, so that each mutant of the
product is about as likely. `mutant_map.py` says which tests cover its lines: one run of the tests
in virtual time, once (`--map`: anew). The shortest of them are run against it (`BUDGET_S`), or if
there is none, the files of tests that name its module. Exit status: 0; a survivor is no error.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support"), str(ROOT / "scripts")]

from mutant_map import FOLDER, TOPS, Map  # noqa: E402
from mutant_runs import NOT_COVERED, Tests, Verdict, run  # noqa: E402
from mutants import Mutant, Source  # noqa: E402

BUDGET_S = 20.0
"""Of processor time, without a mutant: the tests that are run against one."""

FILES = 12
"""From so many files at most: pytest reads each of them first."""

VIRTUAL = "not real_time and not slow and not long"
TIMEOUT = 3.0  # processor time of a mutant, in multiples of its tests' own


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


def product() -> dict[str, Path]:
    """Return the product's modules by the names of their import, without the examples."""
    paths = (path for top in TOPS for path in sorted((ROOT / top).rglob("*.py")) if "examples" not in path.parts)
    modules = {}
    for path in paths:
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts if parts[0] == "coulombus" else ("coulombus", *parts))
        modules[name.removesuffix(".__init__")] = path
    return modules


def make_map() -> None:
    """Run the tests in virtual time, as plain Python, and write which lines each covers."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    side_by_side = ("-n", str(min(os.cpu_count() or 1, 4)), "--dist", "loadfile", "--tb=no")
    subprocess.run(  # those that take too long are ended, and fail
        (sys.executable, "-m", "pytest", "-q", "-p", "mutant_map", *side_by_side, "-m", VIRTUAL),
        env=os.environ | {"PYTHONPATH": str(ROOT / "scripts"), "NUMBA_DISABLE_JIT": "1", "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )


def tests_of(path: Path, mutant: Mutant, covering: Map) -> set[str]:
    """Return the tests to run against a mutant: the shortest that cover a line of it."""
    selected, files, total_s = set[str](), set[str](), 0.0
    for test in covering.tests(path, mutant.lines) if mutant.unit else ():
        file = test.partition("::")[0]
        if len(files | {file}) <= FILES and total_s < BUDGET_S:
            selected.add(test)
            files.add(file)
            total_s += covering.seconds[test]
    return selected


def files_of(path: Path) -> set[str]:
    """Return the files of tests that name a module most often: for what the map does not have, such as a constant."""
    counts = Counter[str]()
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        counts[str(test.relative_to(ROOT))] = len(re.findall(rf"\b{path.stem}\b", test.read_text(encoding="utf-8")))
    return {file for file, count in counts.most_common(FILES) if count}


def run_drawn(name: str, numbers: tuple[int, ...], by_map: bool) -> list[Drawn]:
    """Run some mutants of a module in a process of its own: as plain Python against the tests of the map, or as
    compiled code against the files that name the module.
    """
    path = product()[name]
    os.environ["NUMBA_DISABLE_JIT"] = "1" if by_map else "0"
    source = Source(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    edits = source.edits()
    mutants = [edits[k] for k in numbers]
    if by_map:
        covering = Map()
        tests = set[str]().union(*(tests_of(path, mutant, covering) for mutant in mutants))
    else:
        tests = files_of(path)
    verdicts: dict[int, Verdict] = {}
    error = ""
    if tests:
        suite = Tests(tuple(sorted(tests)), marks="real_time", budget_s=2 * BUDGET_S * len(mutants))
        error = run(source, mutants, suite, 1, TIMEOUT, verdicts.__setitem__)
    lost = Verdict("not run", error, 0.0) if tests else Verdict("survived", NOT_COVERED, 0.0)
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
    """Run drawn mutants, module by module; then again those that no test of the map covers. Return them all."""
    ended: dict[tuple[str, int], Drawn] = {}
    for by_map in (True, False):
        with ProcessPoolExecutor(jobs, get_context("spawn"), max_tasks_per_child=1) as pool:
            runs = [pool.submit(run_drawn, name, edits, by_map) for name, edits in numbers.items()]
            for k, done in enumerate(as_completed(runs), 1):
                ended |= {(mutant.name, mutant.number): mutant for mutant in done.result()}
                alive = sum(mutant.lives for mutant in ended.values())
                print(f"\r{k} of {len(runs)} modules, {alive} live ", end="", file=sys.stderr)
        print(file=sys.stderr)
        bare = {key for key, mutant in ended.items() if mutant.by == NOT_COVERED}
        numbers = {name: tuple(k for k in edits if (name, k) in bare) for name, edits in numbers.items()}
        numbers = {name: edits for name, edits in numbers.items() if edits}
    return list(ended.values())


def main() -> int:
    """Draw mutants, run them, print the survivors and their share."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("count", type=int, help="so many mutants")
    add("--seed", type=int, default=0)
    add("--jobs", type=int, default=os.cpu_count() or 1, help="modules at the same time")
    add("--list", action="store_true", help="list the mutants and run none")
    add("--map", action="store_true", help="see anew which test covers which line")
    options = parser.parse_args()
    os.chdir(ROOT)
    numbers = drawn(options.count, options.seed)
    if options.list:
        print(*(f"{name} {number}" for name, some in sorted(numbers.items()) for number in some), sep="\n")
        return 0
    if options.map or not FOLDER.exists():
        make_map()
    mutants = run_all(numbers, options.jobs)
    for mutant in mutants:
        if mutant.lives:
            print(f"{mutant.status.upper()} {mutant.where}" + (f" ({mutant.by})" if mutant.by else ""))
    counts = Counter(mutant.status for mutant in mutants)
    ran = sum(counts[status] for status in ("killed", "timeout", "survived"))
    bare = sum(mutant.by == NOT_COVERED for mutant in mutants)
    print(
        f"{ran} mutants of {len(numbers)} modules, seed {options.seed}: {counts['survived']} survived, "
        f"{100 * counts['survived'] / max(ran, 1):.1f} %; no test covers {bare} of these; "
        f"{counts['not made'] + counts['not run']} not run"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
