#!/usr/bin/env python3
"""Mutation test of all that decides about torque, brake and arming: how well do the tests hold it?

Each mutant is one small edit of a module (`mutants.py` has the operators). The tests that are named
for the module have to fail with it. A survivor is a hole in the tests, or equivalent: then
`mutants_equivalent.toml` lists it with its proof.

    .venv/bin/python scripts/mutate.py                         # everything
    .venv/bin/python scripts/mutate.py --module host/cycle/monitors.py
    .venv/bin/python scripts/mutate.py --sample 100 --seed 3
    .venv/bin/python scripts/mutate.py --list --module host/cycle/step.py

`mutate_drawn.py` draws mutants of the whole product.

A run that was broken off goes on where it was: the results are in `out/mutants.jsonl`, and one is
used again while the module, and for a survivor the tests, are the same. Exit status: 0, all
survivors are listed; 1, one is not, or the list holds one that is none; 2, usage.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import time
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from mutant_runs import Tests, Verdict, run  # noqa: E402
from mutants import Mutant, Source  # noqa: E402

EQUIVALENTS = ROOT / "scripts" / "mutants_equivalent.toml"


@dataclass(frozen=True)
class Target:
    """A module's tests, the functions that are meant when not all are, and the mark of the tests that
    are left out.
    """

    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()
    without: str = ""


def _targets(path: Path) -> dict[str, Target]:
    entries = tomllib.loads(path.read_text(encoding="utf-8"))
    return {
        name: Target(**{key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()})
        for name, entry in entries.items()
    }


TARGETS = _targets(ROOT / "scripts" / "mutants_targets.toml")


@dataclass
class Tally:
    """What became of one module's mutants."""

    name: str
    mutants: int = 0
    killed: int = 0
    timeouts: int = 0
    equivalent: int = 0
    cpu_s: float = 0.0

    @property
    def survived(self) -> int:
        """How many are neither killed nor listed."""
        return self.mutants - self.killed - self.timeouts - self.equivalent

    @property
    def score(self) -> float:
        """Share of the mutants that are not equivalent which a test kills."""
        real = self.mutants - self.equivalent
        return (self.killed + self.timeouts) / real if real else 1.0


class Equivalents:
    """The list of equivalent mutants: `[[equivalent]]` with module, line, changes, proof.

    Where that is not enough, function and nth of it.
    """

    def __init__(self, path: Path) -> None:
        self.proofs: dict[tuple[str | int, ...], str] = {}
        entries = tomllib.loads(path.read_text(encoding="utf-8")).get("equivalent", []) if path.exists() else []
        for entry in entries:
            if not entry["proof"].strip():
                raise SystemExit(f"{path.name}: {entry['module']}: {entry['line']}: a proof is missing")
            for change in entry["changes"]:
                key = (entry["module"], entry.get("function", ""), entry["line"], change, entry.get("nth", 0))
                self.proofs[key] = entry["proof"]
        self.met: set[tuple[str | int, ...]] = set()

    def lists(self, name: str, mutant: Mutant, nth: int) -> bool:
        """Whether the mutant is listed."""
        here = [(unit, mutant.text, mutant.change, n) for unit in ("", mutant.unit) for n in (0, nth)]
        keys = {(name, *place) for place in here} & self.proofs.keys()
        self.met |= keys
        return bool(keys)

    def unmet(self, name: str) -> list[str]:
        """Return the entries of a module that no mutant fits."""
        return [f"{line}: {change}" for module, _, line, change, _ in self.proofs.keys() - self.met if module == name]


class Results:
    """The JSON lines of earlier runs, to which each verdict is appended."""

    def __init__(self, path: Path, fresh: bool) -> None:
        self.path = path
        self.known: dict[str, dict[str, Any]] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        if fresh:
            path.unlink(missing_ok=True)
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    row = json.loads(line)
                except ValueError:
                    continue  # a run was broken off in the middle of a line
                self.known[row["key"]] = row

    def verdict(self, key: str, source: str, tests: str) -> Verdict | None:
        """Return what is known of a mutant, as far as it still holds."""
        row = self.known.get(key)
        if row is None or row["source"] != source or row["status"] == "not made":
            return None
        if row["status"] == "survived" and row["tests"] != tests:
            return None
        return Verdict(row["status"], row["by"], row["cpu_s"])

    def add(self, row: dict[str, Any]) -> None:
        """Append a verdict."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def _file(test: str) -> str:
    """Return the path of the tests that are called so, with a folder where two files are."""
    paths = [str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob(f"{test}.py")]
    if len(paths) != 1:
        raise SystemExit(f"{test}: expected the name of one file of tests, there are {sorted(paths)}")
    return paths[0]


def _digest(paths: list[Path]) -> str:
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()[:12]


def _keys(name: str, mutants: list[Mutant]) -> tuple[list[str], list[int]]:
    """Return a name for each mutant that lasts while its line does, and the how many-th such one it
    is.
    """
    met: Counter[str] = Counter()
    keys, nths = [], []
    for mutant in mutants:
        key = f"{name}|{mutant.unit}|{mutant.text}|{mutant.operator}|{mutant.short}"
        met[key] += 1
        keys.append(f"{key}|{met[key]}")
        nths.append(met[key])
    return keys, nths


def mutate(name: str, options: argparse.Namespace, listed: Equivalents, results: Results) -> tuple[Tally, list[str]]:
    """Run the mutants of one module; return the tally, and what is wrong."""
    target, path = TARGETS[name], ROOT / name
    tests = [_file(test) for test in target.tests]
    source = Source(name, path.read_text(encoding="utf-8"), target.functions)
    if source.lacking:
        raise SystemExit(f"{name}: expected the names of its functions, it has no {', '.join(source.lacking)}")
    mutants = source.mutants()
    keys, nths = _keys(name, mutants)
    numbers = list(range(len(mutants)))
    if options.sample:
        numbers = sorted(random.Random(f"{options.seed} {name}").sample(numbers, min(options.sample, len(numbers))))
    if options.unit:
        numbers = [k for k in numbers if mutants[k].unit == options.unit]
    tally, failures = Tally(name, len(numbers)), []
    if options.list:
        for k in numbers:
            print(f"{name}:{mutants[k].line}: {mutants[k].operator}: {mutants[k].change}")
        return tally, []
    digests = _digest([path]), _digest([ROOT / test for test in tests])
    verdicts: dict[int, Verdict] = {}
    for k in numbers:
        recorded = results.verdict(keys[k], *digests)
        if recorded is not None:
            verdicts[k] = recorded
        elif listed.lists(name, mutants[k], nths[k]) and not options.check_equivalents:
            verdicts[k] = Verdict("survived", "listed", 0.0)
    missing = [k for k in numbers if k not in verdicts]
    began = time.monotonic()

    def tell(n: int, verdict: Verdict) -> None:
        k = missing[n]
        verdicts[k] = verdict
        mutant = mutants[k]
        row = {"key": keys[k], "module": name, "line": mutant.line, "text": mutant.text, "operator": mutant.operator}
        row |= {"change": mutant.change, "source": digests[0], "tests": digests[1]}
        results.add(row | {"status": verdict.status, "by": verdict.by, "cpu_s": verdict.cpu_s})
        if sys.stderr.isatty():
            print(
                f"\r{name}: {len(verdicts)} of {len(numbers)}, {time.monotonic() - began:.0f} s ",
                end="",
                file=sys.stderr,
            )

    if missing:
        error = run(
            source,
            [mutants[k] for k in missing],
            Tests(tuple(tests), target.without),
            options.jobs,
            options.timeout,
            tell,
        )
        if error:
            raise SystemExit(f"{name}: {error}")
    for k in numbers:
        verdict, mutant = verdicts[k], mutants[k]
        tally.cpu_s += verdict.cpu_s
        equivalent = listed.lists(name, mutant, nths[k])
        where = f"{name}:{mutant.line}: {mutant.operator}: {mutant.change}"
        if verdict.status in ("survived", "not made"):
            tally.equivalent += equivalent
            if not equivalent:
                failures.append(f"{verdict.status.upper()} {where}" + (f" ({verdict.by})" if verdict.by else ""))
        else:
            tally.killed += verdict.status == "killed"
            tally.timeouts += verdict.status == "timeout"
            if equivalent:
                failures.append(f"LISTED, BUT KILLED {where} ({verdict.by})")
    if not options.sample and not options.unit:
        failures += [f"LISTED, BUT NO MUTANT {name}: {entry}" for entry in listed.unmet(name)]
    return tally, failures


def _table(tallies: list[Tally]) -> str:
    rows = ["| module | mutants | killed | equivalent | survived | score |", "|---|---|---|---|---|---|"]
    total = Tally("all")
    for tally in tallies:
        for field in ("mutants", "killed", "timeouts", "equivalent", "cpu_s"):
            setattr(total, field, getattr(total, field) + getattr(tally, field))
    for t in [*tallies, total]:
        killed = t.killed + t.timeouts
        rows.append(f"| `{t.name}` | {t.mutants} | {killed} | {t.equivalent} | {t.survived} | {100 * t.score:.1f} % |")
    return "\n".join(
        [*rows, "", f"{total.timeouts} of the killed by their time; {total.cpu_s:.0f} s of processor time."]
    )


def main() -> int:
    """Read the options, run the modules, print what survives and the scores."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("--module", action="append", choices=sorted(TARGETS), help="only this module (may be given again)")
    add("--unit", default="", help="only this function of it")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="mutants at the same time")
    add("--sample", type=int, default=0, help="only so many mutants of each module, drawn with --seed")
    add("--seed", type=int, default=0)
    add("--timeout", type=float, default=10.0, help="processor time of a mutant, in multiples of its tests' own")
    add("--results", type=Path, default=ROOT / "out" / "mutants.jsonl", help="where the verdicts are kept")
    add("--fresh", action="store_true", help="forget the verdicts of earlier runs")
    add("--check-equivalents", action="store_true", help="run the listed mutants too")
    add("--list", action="store_true", help="list the mutants and run none")
    add("--tests", action="store_true", help="name the files of tests, and run none")
    options = parser.parse_args()
    os.chdir(ROOT)
    if options.tests:
        print(*sorted({_file(test) for target in TARGETS.values() for test in target.tests}), sep="\n")
        return 0
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # before anything imports numba
    listed, results = Equivalents(EQUIVALENTS), Results(options.results, options.fresh)
    tallies, failures = [], []
    for name in options.module or TARGETS:
        if len(options.module or TARGETS) > 1 and not options.list:
            tally, of_module = _in_child(name, options, listed, results)
        else:
            tally, of_module = mutate(name, options, listed, results)
        tallies.append(tally)
        failures += of_module
        print(*of_module, sep="\n", end="\n" if of_module else "", flush=True)
    if not options.list:
        print(_table(tallies))
    return 1 if failures else 0


def _in_child(name: str, options: argparse.Namespace, listed: Equivalents, results: Results) -> tuple[Tally, list[str]]:
    """Run one module in a process of its own: pytest is started once in a process."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        status = 2
        try:
            os.close(reading)
            tally, failures = mutate(name, options, listed, results)
            with os.fdopen(writing, "w", encoding="utf-8") as file:
                json.dump([vars(tally), failures], file)
            status = 0
        except SystemExit as error:
            print(error, file=sys.stderr)
        finally:
            os._exit(status)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as file:
        answer = file.read()
    os.waitpid(pid, 0)
    if not answer:
        raise SystemExit(2)
    tally, failures = json.loads(answer)
    return Tally(**tally), failures


if __name__ == "__main__":
    sys.exit(main())
