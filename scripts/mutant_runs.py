"""Run mutants against tests: pytest collects once, then each mutant is a forked child that stops at
the first failure.

The kernels are plain Python (NUMBA_DISABLE_JIT=1), so a child exchanges the code of one function in
memory and runs the tests that cover the edited lines, the shortest first. The checkout is never
edited.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import select
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import coverage
import pytest
from mutants import Mutant, Source

__all__ = ["NOT_COVERED", "Tests", "Verdict", "run"]

NOT_COVERED = "no test covers it"
NOT_MADE = "cannot be exchanged: "
SHORTEST_LIMIT_S = 2.0
SHORTEST_WAIT_S = 20.0  # of wall clock: a mutant that waits for ever takes no processor time
HEADROOM = 3 << 30  # bytes that a mutant may allocate beyond what the tests have; LLVM reserves much of it


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant: killed, timeout (killed by its time), survived (or no test covers
    it), not made (its code cannot be exchanged).
    """

    status: str
    by: str
    cpu_s: float


@dataclass(frozen=True)
class Tests:
    """Files of tests; the marks of those that are left out, as pytest's -m has them.

    With `budget_s` only those tests are used that pass, one after the other, in this wall clock, each in half of it.
    """

    files: tuple[str, ...]
    marks: str = ""
    budget_s: float | None = None


@dataclass
class _Child:
    number: int
    pid: int
    pipe: int
    until: float  # [s, time.monotonic] it is ended then
    said: bytes = b""
    hangs: bool = False

    def end(self) -> None:
        """End it, and what it has started."""
        for kill in (os.killpg, os.kill):  # it may not have its group yet; only we reap it, so the number is its own
            with suppress(ProcessLookupError):
                kill(self.pid, signal.SIGKILL)


@dataclass(frozen=True)
class _Base:
    """What each test takes without a mutant, and the lines that it covers."""

    seconds: list[float]  # of processor time
    waits: list[float]  # of wall clock
    lines: list[set[int]]


class _Failure:
    """The first failure of a child."""

    def __init__(self) -> None:
        self.nodeid = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and not self.nodeid:
            self.nodeid = report.nodeid


class _Runner:
    """A plugin of pytest that runs mutants in place of the tests."""

    def __init__(
        self, source: Source, mutants: list[Mutant], jobs: int, factor: float, budget_s: float | None = None
    ) -> None:
        self.source, self.mutants, self.jobs, self.factor, self.budget_s = source, mutants, jobs, factor, budget_s
        self.tell: Callable[[int, Verdict], None] = lambda number, verdict: None
        self.error, self.left_out = "", set[int]()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run every mutant."""
        session.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
        self.module = importlib.import_module(
            "coulombus." + self.source.path.removesuffix(".py").removeprefix("coulombus/").replace("/", ".")
        )
        self.items = session.items
        pipe, pid = self._fork(self._baseline)
        answer = _read_all(pipe)
        os.waitpid(pid, 0)
        base = json.loads(answer or b'{"failed": "the base run died"}')
        if self.budget_s is not None and not base.get("failed"):
            self.items = [item for item in self.items if item.nodeid in base["passed"]]
        self.error = base.get("failed", "")
        if not self.error:
            gc.freeze()  # the children share these pages
            self.space = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + HEADROOM
            measured = _Base(base["seconds"], base["waits"], [set(lines) for lines in base["lines"]])
            used = set(range(len(self.items)))
            if self.budget_s is not None:
                used = {k for mutant in self.mutants for k in self._chosen(mutant, measured)}
            self._control(used)
        if not self.error:
            self._run_all(measured)
        return True

    def _control(self, used: set[int]) -> None:
        """Run tests as for a mutant, but without one: a child that fails for another reason kills
        nothing.

        With a budget a test that fails so is left out.
        """
        while used:
            pipe, pid = self._fork(self._mutant_run(None, [self.items[k] for k in sorted(used)], 3600.0))
            self.error = _read_all(pipe).decode().partition(" ")[2]
            if os.waitpid(pid, 0)[1] and not self.error:
                self.error = "the process"
            failing = {k for k in used if self.items[k].nodeid == self.error}
            if self.budget_s is None or not failing:
                return
            used -= failing
            self.left_out |= failing
            self.error = ""

    def _fork(self, work: Callable[[int], None]) -> tuple[int, int]:
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            status = 1
            try:
                os.close(reading)
                work(writing)
                status = 0
            finally:
                os._exit(status)
        os.close(writing)
        return reading, pid

    def _run_items(
        self,
        items: list[pytest.Item],
        before: Callable[[pytest.Item], None] = lambda item: None,
        ends: Callable[[pytest.Item, str], bool] = lambda item, failed: bool(failed),
    ) -> str:
        """Run `items` until one fails, or until `ends` says so of one; return which failed."""
        failure = _Failure()
        manager = items[0].config.pluginmanager
        manager.register(failure)
        for item, following in zip(items, [*items[1:], None], strict=True):
            before(item)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if ends(item, failure.nodeid):
                break
            failure.nodeid = ""
        return failure.nodeid

    def _baseline(self, pipe: int) -> None:
        """Measure what each test covers and how long it takes."""
        source = os.path.realpath(self.module.__file__ or "")  # the name of the import is a link
        measured = coverage.Coverage(data_file=None, include=[source], config_file=False)
        starts: list[float] = []
        clock: list[float] = []

        failed, passed = "", list[str]()

        def begin(item: pytest.Item) -> None:
            starts.append(time.process_time())
            clock.append(time.monotonic())
            measured.switch_context(item.nodeid)
            if self.budget_s is not None:
                signal.setitimer(signal.ITIMER_REAL, self.budget_s / 2)

        measured.start()
        if self.budget_s is None:
            failed = self._run_items(self.items, begin)
            passed = [item.nodeid for item in self.items]
        else:
            signal.signal(signal.SIGALRM, _too_long)
            until = time.monotonic() + self.budget_s

            def ends(item: pytest.Item, failed: str) -> bool:
                if failed:
                    del starts[-1], clock[-1]
                else:
                    passed.append(item.nodeid)
                return time.monotonic() > until

            self._run_items(self.items, begin, ends)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        starts.append(time.process_time())
        clock.append(time.monotonic())
        measured.stop()
        answer: dict[str, Any] = {"failed": failed, "passed": passed}
        if not failed:
            with warnings.catch_warnings(action="ignore"):  # that no test covers it
                by_line = measured.get_data().contexts_by_lineno(source)
            covered: dict[str, set[int]] = {nodeid: set() for nodeid in passed}
            for line, contexts in by_line.items():
                for context in contexts:
                    if context in covered:
                        covered[context].add(line)
            answer["lines"] = [sorted(covered[nodeid]) for nodeid in passed]
            answer["seconds"] = [b - a for a, b in pairwise(starts)]
            answer["waits"] = [b - a for a, b in pairwise(clock)]
        _write_all(pipe, json.dumps(answer).encode())

    def _chosen(self, mutant: Mutant, base: _Base) -> list[int]:
        lines = set(mutant.lines) if mutant.unit else set()
        here = [k for k in range(len(self.items)) if k not in self.left_out]
        reaching = [k for k in here if not lines or lines & base.lines[k]]
        return sorted(reaching, key=lambda k: base.waits[k])

    def _run_all(self, base: _Base) -> None:
        running: dict[int, _Child] = {}
        try:
            self._run_each(base, running)
        finally:
            for child in running.values():
                child.end()

    def _run_each(self, base: _Base, running: dict[int, _Child]) -> None:
        waiting = iter(enumerate(self.mutants))
        done = False
        while running or not done:
            while not done and len(running) < self.jobs:
                number, mutant = next(waiting, (-1, None))
                if mutant is None:
                    done = True
                    break
                tests = self._chosen(mutant, base)
                if not tests:
                    self.tell(number, Verdict("survived", NOT_COVERED, 0.0))
                    continue
                limit = max(SHORTEST_LIMIT_S, self.factor * sum(base.seconds[k] for k in tests))
                wait = max(SHORTEST_WAIT_S, self.factor * sum(base.waits[k] for k in tests))
                pipe, pid = self._fork(self._mutant_run(mutant, [self.items[k] for k in tests], limit))
                running[pipe] = _Child(number, pid, pipe, time.monotonic() + wait)
            if running:
                self._collect(running)

    def _mutant_run(self, mutant: Mutant | None, items: list[pytest.Item], limit_s: float) -> Callable[[int], None]:
        def work(pipe: int) -> None:
            os.setpgid(0, 0)  # what it starts ends with it
            signal.setitimer(signal.ITIMER_PROF, limit_s)
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_AS, (self.space, self.space))
            try:
                if mutant is not None:
                    mutant.apply()
                    self.source.install(self.module, mutant.unit)
            except Exception as error:  # a module that cannot be loaded with its constant fails every test
                failed = NOT_MADE if mutant is None or mutant.unit else "cannot be loaded: "
                _write_all(pipe, f"0 {failed}{error!r}".encode())
                return
            failed = self._run_items(items)
            _write_all(pipe, f"{time.process_time():.3f} {failed}".encode())

        return work

    def _collect(self, running: dict[int, _Child]) -> None:
        first = min(child.until for child in running.values())
        readable = select.select(list(running), [], [], min(max(first - time.monotonic(), 0.0), 1.0))[0]
        for child in running.values():
            if child.pipe not in readable and child.until <= time.monotonic():
                child.hangs = True
                child.until = float("inf")
                child.end()
        for pipe in readable:
            child = running[pipe]
            part = os.read(pipe, 65536)
            if part:
                child.said += part
                continue
            os.close(pipe)
            del running[pipe]
            _, status, usage = os.wait4(child.pid, 0)
            cpu_s = round(usage.ru_utime + usage.ru_stime, 3)
            if child.said:
                failed = child.said.decode().partition(" ")[2]
                status = "not made" if failed.startswith(NOT_MADE) else "killed" if failed else "survived"
                self.tell(child.number, Verdict(status, failed, cpu_s))
            elif child.hangs or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF):
                self.tell(child.number, Verdict("timeout", "", cpu_s))
            else:  # it could not even be loaded, or ended the process
                self.tell(child.number, Verdict("killed", "the process ended", cpu_s))


def _too_long(*_: object) -> None:
    raise TimeoutError("it takes more than half of the budget")


def _read_all(pipe: int) -> bytes:
    with os.fdopen(pipe, "rb") as file:
        return file.read()


def _write_all(pipe: int, data: bytes) -> None:
    with os.fdopen(pipe, "wb") as file:
        file.write(data)


def run(
    source: Source,
    mutants: list[Mutant],
    tests: Tests,
    jobs: int,
    factor: float,
    tell: Callable[[int, Verdict], None],
) -> str:
    """Run `mutants` of `source` against `tests`; `tell` gets each one's number and verdict.

    Return what went wrong, or "".
    """
    runner = _Runner(source, mutants, jobs, factor, tests.budget_s)
    runner.tell = tell
    arguments = [
        "-q",
        "-p",
        "no:cacheprovider",
        "-o",
        "faulthandler_timeout=0",
        "-p",
        "no:xdist",
        "--tb=no",
        "--assert=plain",
        "-s",
        *(["-m", f"not ({tests.marks})"] if tests.marks else []),
        *tests.files,
    ]
    with _silence():
        status = pytest.main(arguments, plugins=[runner])
    if runner.error:
        return f"{runner.error} fails without a mutant"
    return "" if status == pytest.ExitCode.OK else f"pytest ends with {status!r}: are the tests' names right?"


class _silence:  # noqa: N801  (a context, as contextlib's)
    """Nothing of what pytest and the children say is shown; `sys.stderr` is kept."""

    def __enter__(self) -> None:
        sys.stdout.flush()
        self.kept = os.dup(1)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)

    def __exit__(self, *_: object) -> None:
        sys.stdout.flush()
        os.dup2(self.kept, 1)
        os.close(self.kept)
