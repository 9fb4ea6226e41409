"""Latency test: wake-up delay of the cycle on a loaded machine, measured in turns with cyclictest."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from shutil import which
from typing import Any

from coulombus.host.doctor.checks import CheckResult, Outcome
from coulombus.host.doctor.examination import RigDemands
from coulombus.system.errors import CoulombusError
from coulombus.system.realtime import die_with_parent

__all__ = ["Latency", "Wakeups", "bars", "judge", "measure_latency", "read_cyclictest"]

PRIORITY = 80
ROUND_S = 5.0
"""Duration of a turn of the cycle's loop or of cyclictest."""
SLACK_S = 180.0  # the very first start compiles
POLL_S = 0.1
BINS = 20_000
EDGES = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000)
BAR = 18
LATE_SHARE = 0.1
"""Limit of the 99th percentile of the wake-up delays, as a share of the period."""
_COUNT = re.compile(r"^(\d+)\s+(\d+)\s*$", re.MULTILINE)
_MOST = re.compile(r"^# Max Latencies:\s*(\d+)", re.MULTILINE)


@dataclass
class Wakeups:
    """Number of wake-ups by their delay in whole us, and the largest delay."""

    counts: Counter[int] = field(default_factory=Counter)
    latest_us: float = 0.0

    def add(self, counts: Mapping[int, int], latest_us: float) -> None:
        """Add further wake-ups."""
        self.counts.update(counts)
        self.latest_us = max(self.latest_us, latest_us)

    @property
    def total(self) -> int:
        """Number of all wake-ups."""
        return sum(self.counts.values())

    def at(self, share: float) -> float:
        """Return the delay [us] that `share` of the wake-ups did not exceed; 0 without wake-ups."""
        least, seen = share * self.total, 0
        for us in sorted(self.counts):
            seen += self.counts[us]
            if seen >= least:
                return min(us + 1.0, self.latest_us)
        return 0.0

    def beyond(self, us: float) -> int:
        """Return the number of wake-ups with a delay of `us` or more."""
        return sum(count for late, count in self.counts.items() if late >= us)

    def between(self, low: int, high: int) -> int:
        """Return the number of wake-ups with a delay from `low` to below `high`."""
        return sum(count for late, count in self.counts.items() if low <= late < high)

    def as_dict(self) -> dict[str, float]:
        """Return plain values for JSON."""
        return {"wakeups": self.total, "p50_us": self.at(0.5), "p99_us": self.at(0.99), "max_us": self.latest_us}


@dataclass
class Latency:
    """Result of the test.

    Attributes
    ----------
    own, cyclictest : the wake-ups; None if cyclictest did not run, for `reason`
    refused : the refused real-time rights
    loads : number of busy processes
    """

    own: Wakeups
    cyclictest: Wakeups | None
    reason: str
    refused: tuple[str, ...]
    loads: int


class LatencyError(CoulombusError, RuntimeError):
    """The test did not run; the text gives the reason."""

    exit_status = 1


def read_cyclictest(text: str) -> tuple[dict[int, int], float]:
    """Return counts and maximum from the output of ``cyclictest -q -h``; LatencyError for other texts."""
    maximum = _MOST.search(text)
    if maximum is None:
        raise LatencyError("cyclictest printed no histogram")
    counts = {int(us): int(count) for us, count in _COUNT.findall(text) if int(count)}
    latest = int(maximum[1])
    overflow = re.search(r"^# Histogram Overflows:\s*(\d+)", text, re.MULTILINE)
    if overflow and int(overflow[1]):
        counts[BINS - 1] = counts.get(BINS - 1, 0) + int(overflow[1])
    return counts, float(latest)


def _module(name: str, *words: str) -> list[str]:
    return [sys.executable, "-P", "-m", f"coulombus.host.doctor.{name}", *words]


def _environment() -> dict[str, str]:
    root = str(Path(__file__).parents[__name__.count(".")])
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


@contextmanager
def _loaded(count: int, folder: str) -> Iterator[None]:
    """Run `count` busy processes inside this context."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        for number in range(count):
            words = _module("load", str(os.getpid()), str(number), folder)
            started.append(
                subprocess.Popen(words, stdin=subprocess.DEVNULL, env=_environment(), start_new_session=True)
            )
        yield
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


def _ran(words: Sequence[str], seconds: float, tick: Callable[[float], None]) -> str:
    """Run a measuring program and return its output; LatencyError if it fails."""
    parent, began = os.getpid(), time.monotonic()
    with os.fdopen(os.memfd_create("out"), "w+b") as out, os.fdopen(os.memfd_create("err"), "w+b") as err:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            env=_environment(),
            start_new_session=True,  # Ctrl-C of the terminal goes to the parent only
            preexec_fn=lambda: die_with_parent(parent),
        )
        try:
            while process.poll() is None:
                spent = time.monotonic() - began
                if spent > seconds + SLACK_S:
                    raise LatencyError(f"{Path(words[0]).name} did not end within {spent:.0f} s")
                tick(min(spent, seconds))
                try:
                    process.wait(POLL_S)
                except subprocess.TimeoutExpired:
                    continue
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
        tick(seconds)
        out.seek(0)
        err.seek(0)
        text, words_of_it = out.read().decode(errors="replace"), err.read().decode(errors="replace").strip()
    if process.returncode != 0:
        reason = words_of_it.splitlines()[-1] if words_of_it else f"status {process.returncode}"
        raise LatencyError(f"{Path(words[0]).name}: {reason}")
    return text


def _folder() -> str:
    """Return the folder for the load's writes; an unusable path if there is none."""
    try:
        return tempfile.gettempdir()
    except OSError:
        return os.devnull


def measure_latency(
    seconds: float,
    demands: RigDemands,
    *,
    cpu: int | None,
    priority: int | None = PRIORITY,
    loads: int | None = None,
    progress: Callable[[float], None] = lambda t: None,
) -> Latency:
    """Measure for `seconds` in total, in turns with cyclictest if it is installed.

    Parameters
    ----------
    cpu : CPU for the loop
    priority : SCHED_FIFO priority; None requests no real-time right
    loads : number of busy processes; default is one for each CPU
    progress : called with the elapsed time [s]

    Raises
    ------
    LatencyError
        the loop did not run
    """
    program = which("cyclictest")
    contestants = 2 if program else 1
    turns = max(1, round(seconds / ROUND_S / contestants))
    turn_s = seconds / turns / contestants
    wakeups, beside = Wakeups(), Wakeups()
    reason, refused, done = "" if program else "cyclictest is not installed (rt-tests)", (), 0.0
    loads = len(os.sched_getaffinity(0)) if loads is None else loads
    settings = {
        "parent": os.getpid(),
        "period_ns": round(demands.period_s * 1e9),
        "seconds": turn_s,
        "priority": priority,
        "cpu": cpu,
    }
    with _loaded(loads, _folder()):
        for _ in range(turns):
            started = done

            def tick(t: float, since: float = started) -> None:
                progress(since + t)

            sleeper = json.loads(_ran(_module("sleeper", json.dumps(settings)), turn_s, tick))
            wakeups.add({int(us): count for us, count in sleeper["counts"].items()}, sleeper["latest_us"])
            refused = tuple(right["name"] for right in sleeper["real_time"] if not right["granted"])
            done += turn_s
            if program and not reason:
                words = [
                    program,
                    "-m",
                    "-q",
                    "-t1",
                    f"-p{priority or 0}",
                    f"-i{round(demands.period_s * 1e6)}",
                    f"-h{BINS}",
                ]
                words += [f"-l{max(1, round(turn_s / demands.period_s))}"] + ([] if cpu is None else [f"-a{cpu}"])
                try:
                    beside.add(*read_cyclictest(_ran(words, turn_s, lambda t, since=done: progress(since + t))))  # type: ignore[misc]
                except LatencyError as error:
                    reason = str(error)
                done += turn_s
    return Latency(wakeups, None if reason else beside, reason, refused, loads)


def judge(latency: Latency, demands: RigDemands) -> CheckResult:
    """Return whether the machine meets a rig's limits, with the reasons if not.

    A wake-up trips if its delay plus a period exceeds a watchdog's time. A wake-up that leaves no room for
    the TPDOs' window loses its period. The 99th percentile must be within a tenth of the period.
    """
    wakeups = latency.own
    period_us, window_us, watchdog_us = (1e6 * t for t in (demands.period_s, demands.window_s, demands.watchdog_s))
    lost = wakeups.beyond(period_us - window_us) / wakeups.total if wakeups.total else 1.0
    reasons = []
    if "SCHED_FIFO" in latency.refused:
        reasons.append("SCHED_FIFO was refused")
    if wakeups.latest_us + period_us > watchdog_us:
        reasons.append(
            f"a wake-up was {wakeups.latest_us / 1000:.2f} ms late, and a watchdog ends at {watchdog_us / 1000:g} ms"
        )
    if lost > demands.loss_limit:
        reasons.append(f"{lost:.2%} of the periods are lost, and the limit is {demands.loss_limit:.2%}")
    if wakeups.at(0.99) > LATE_SHARE * period_us:
        reasons.append(
            f"one wake-up in a hundred is {wakeups.at(0.99):.0f} us late or later, a tenth of the period is {period_us / 10:.0f} us"
        )
    text = (
        f"{wakeups.total} wake-ups beside {latency.loads} busy processes, "
        f"p50 {wakeups.at(0.5):.0f}, p99 {wakeups.at(0.99):.0f}, latest {wakeups.latest_us:.0f} us"
    )
    if latency.cyclictest is not None:
        text += f" (cyclictest {latency.cyclictest.at(0.5):.0f}, {latency.cyclictest.at(0.99):.0f}, {latency.cyclictest.latest_us:.0f})"
    outcome = Outcome(True, f"fit for {demands}: {text}")
    if reasons:
        fix = "# fix the other checks, and test again; until then: simulated nodes only"
        outcome = Outcome(False, f"not fit for {demands}: {'; '.join(reasons)}; {text}", fix)
    figures: dict[str, Any] = {
        "own": wakeups.as_dict(),
        "cyclictest": None if latency.cyclictest is None else latency.cyclictest.as_dict(),
        "refused": list(latency.refused),
        "lost_share": lost,
        "fit": outcome.ok,
    }
    return CheckResult("latency", outcome.ok, outcome.found, outcome.fix, figures)


def bars(latency: Latency) -> list[tuple[str, int, str, int | None, str]]:
    """Return the rows of the histogram: range of the delay, and for the loop and cyclictest the number and a
    bar (logarithmic).
    """

    def bar(count: int, total: int) -> str:
        return "█" * max(1, round(BAR * len(str(count)) / max(1, len(str(total))))) if count else ""

    rows: list[tuple[str, int, str, int | None, str]] = []
    for low, high in pairwise((*EDGES, 1 << 62)):
        name = f"{low} - {high} us" if high < 1 << 62 else f"over {low} us"
        count = latency.own.between(low, high)
        other = None if latency.cyclictest is None else latency.cyclictest.between(low, high)
        beside = "" if other is None or latency.cyclictest is None else bar(other, latency.cyclictest.total)
        rows.append((name, count, bar(count, latency.own.total), other, beside))
    used = [i for i, row in enumerate(rows) if row[1] or row[3]]
    return rows[: used[-1] + 1] if used else []
