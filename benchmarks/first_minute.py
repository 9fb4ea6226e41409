"""The first minute, and each start after it: what compiling and starting cost, as multiples of a
piece of work that is timed beside them.

Compiling is held against numba compiling one reference kernel, a start against `import numba`, each
in a fresh process. All of it is processor time of that process and its children: other users of the
machine stretch the wall clock. One cold start is enough, it is most of a minute.
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping

from benchmarks.size import size

__all__ = ["first_minute"]

REPEATS = size(5, 1)

REFERENCE = """
import numba, numpy as np

@numba.njit(error_model="numpy", nogil=True)
def reference(a, n):
    best, at = 0.0, 0
    for i in range(n):
        x = a[i % a.shape[0]]
        if x > best:
            best, at = x, i
        elif x < -best:
            best, at = -x, -i
        a[i % a.shape[0]] = np.sin(x) + np.floor(best * 3.0) / (1.0 + at * at)
    return best, at
"""
COMPILED = REFERENCE + "reference(np.zeros(8), 100)"

STARTS = (
    ("coulombus simulate --seconds 1", ("simulate", "--seconds", "1")),
    ("coulombus check", ("check",)),
    ("coulombus eds check motor.eds", ("eds", "check", "eds/motor.eds")),
    ("coulombus --help", ("--help",)),
)


def processor_s(command: tuple[str, ...], environment: Mapping[str, str]) -> float:
    """Processor time of a process with its children, in s."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = spent()
    subprocess.run((sys.executable, *command), check=True, env=dict(environment), stdout=subprocess.DEVNULL)
    return spent() - before


def first_minute(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    with tempfile.TemporaryDirectory() as directory:
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "NUMBA_CACHE_DIR": directory}
        environment["PYTHONPYCACHEPREFIX"] = directory
        environment.pop("PYTHONDONTWRITEBYTECODE", None)

        def took(*command: str) -> float:
            return processor_s(command, environment)

        imports, reference = ("-c", REFERENCE), ("-c", COMPILED)
        took(*imports)  # bytecode
        references = [took(*reference) - took(*imports) for _ in range(REPEATS)]
        cold = took("-m", "coulombus", "simulate", "--seconds", "1")
        references += [took(*reference) - took(*imports) for _ in range(REPEATS)]
        one = statistics.median(references)
        show("first `coulombus simulate`, everything compiled: processor time", f"{cold:.1f} s")
        show("... as a multiple of numba compiling one reference kernel", f"{cold / one:.0f} x", "at most 50 x")
        times: dict[str, list[float]] = {what: [] for what, _ in STARTS}
        plain = []
        for _ in range(REPEATS):
            plain.append(took(*imports))
            for what, words in STARTS:
                times[what].append(took("-m", "coulombus", *words))
        targets = ("at most 1.2 s", "at most 0.35 s", "at most 0.08 s", "at most 0.05 s")
        for (what, _), target in zip(STARTS, targets, strict=True):
            spent = statistics.median(times[what])
            show(f"{what}, warm: processor time", f"{spent:.2f} s", target, times[what])
            show("... as a multiple of importing numba", f"{spent / statistics.median(plain):.2f} x")
