"""Which test covers which line of the product: a plugin of pytest that writes it, and its reader.

    PYTHONPATH=scripts .venv/bin/python -m pytest -p mutant_map

The kernels are plain Python, in which a whole run takes minutes: a test is ended after `LIMIT_S` of
processor time. It covers what it reached, but is chosen for no mutant.
"""

from __future__ import annotations

import json
import os
import signal
import time
import warnings
from collections.abc import Generator, Iterable
from pathlib import Path
from types import FrameType

import coverage
import pytest

__all__ = ["FOLDER", "TOPS", "Map"]

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "out" / "mutant-map"
TOPS = ("coulombus", "node", "host", "eds", "sim_bus")
"""The folders of the product."""
LIMIT_S = 4.0


class _TooLongError(BaseException):
    """No test and no part of the product catches it."""


def _end(signum: int, frame: FrameType | None) -> None:
    raise _TooLongError


class _Recorder:
    """Writes what each test function covers, how long it takes, and whether it passes."""

    def __init__(self, worker: str) -> None:
        FOLDER.mkdir(parents=True, exist_ok=True)
        data, self.tests = FOLDER / f"{worker}.sqlite", (FOLDER / f"{worker}.jsonl").open("w", encoding="utf-8")
        include = [f"{ROOT / top}/*" for top in TOPS]
        data.unlink(missing_ok=True)
        self.covered = coverage.Coverage(data_file=str(data), include=include, config_file=False)
        self.covered.start()
        self.passed = True

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        name = item.nodeid.partition("[")[0]
        self.covered.switch_context(name)
        self.passed = True
        signal.signal(signal.SIGPROF, _end)
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S, 1.0)
        began = time.process_time()
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            row = {"test": name, "s": round(time.process_time() - began, 4), "passed": self.passed}
            self.tests.write(json.dumps(row) + "\n")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.passed &= not report.failed

    def pytest_sessionfinish(self) -> None:
        self.covered.stop()
        self.covered.save()
        self.tests.close()


def pytest_configure(config: pytest.Config) -> None:
    """Record in each worker; who gives them work runs no test."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker or not config.getoption("numprocesses", None):
        config.pluginmanager.register(_Recorder(worker or "all"))


class Map:
    """What the plugin wrote."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self.data = []
        for path in sorted(folder.glob("*.sqlite")):
            self.data.append(coverage.CoverageData(str(path)))
            self.data[-1].read()
        texts = (path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.jsonl")))
        rows = [json.loads(line) for text in texts for line in text.splitlines()]
        self.seconds: dict[str, float] = {}
        for row in rows:
            self.seconds[row["test"]] = self.seconds.get(row["test"], 0.0) + row["s"]
        self.failed = {row["test"] for row in rows if not row["passed"]}

    def tests(self, path: Path, lines: Iterable[int]) -> list[str]:
        """Return the test functions that cover one of these lines and pass, the shortest first."""
        numbers, names = set(lines), set[str]()
        with warnings.catch_warnings(action="ignore"):  # that no test covers the module
            for data in self.data:
                by_line = data.contexts_by_lineno(str(path))
                names.update(test for line in numbers & by_line.keys() for test in by_line[line])
        return sorted(names & self.seconds.keys() - self.failed, key=lambda test: self.seconds[test])
