"""How often the intervals of a study hold the truth: simulated observers, whose truth is known.

Each observer answers all trials of a study of its method. Its JND is drawn around 0.15 Nm (log normal,
0.2). It is ideal, or its point of subjective equality is a third of a JND off, or its interval bias is
half a sigma, or all is drawn at random: the point of subjective equality up to half a JND off, a bias up
to half a sigma, lapses up to 4 %. Levels, orders and answers come from the classes that a session
uses; no display is shown (`benchmarks.observer_displays` shows them).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy.special import ndtri

from coulombus.lab.study.observer import Faults, Observer
from coulombus.lab.study.results.fit import Fit, fit_comparisons
from coulombus.lab.study.study import Study, read_study
from coulombus.lab.study.trials import Trials

__all__ = [
    "METHODS",
    "answered",
    "answers_of",
    "faults_of",
    "observers",
    "share",
    "study_file",
    "truth_of",
    "within",
    "write_table",
]

Show: TypeAlias = Callable[..., None]

SEED, REFERENCE, JND, SPREAD = 20, 2.0, 0.15, 0.2
SIGMAS_A_JND = 1 / float(ndtri(0.75))
METHODS = {
    "constant stimuli, 180 trials": 'kind = "constant"\nlevels = [1.6, 1.8, 1.9, 2.1, 2.2, 2.4]\nrepeats = 30\n',
    "staircases 1 up 2 down, 120 trials": 'kind = "staircase"\nstart = 2.8\nlow = 2.0\nhigh = 3.2\n'
    "steps = [0.2, 0.1, 0.05]\ntrials = 120\n",
    "weighted staircases 3 : 1, 120 trials": 'kind = "staircase"\nstart = 2.8\nlow = 2.0\nhigh = 3.2\n'
    "steps = [0.1, 0.05]\ndown = 1\nup_ratio = 3.0\ntrials = 120\n",
    "QUEST+, 80 trials": 'kind = "quest"\nlow = 2.0\nhigh = 3.2\ntrials = 80\n',
}
"""Name of a method -> its table of the study file."""
CASES = ("ideal", "PSE off by JND/3", "bias of sigma/2", "all at random")
STUDY = """name = "{name}"
seconds = {seconds}
seed = {seed}
reference = {reference}
question = "Which one had more friction?"
[level]
"mode.{{mode}}.F_s_Nm" = 1.0
"mode.{{mode}}.F_d_Nm" = 1.0
[method]
{method}
[[condition]]
name = "hybrid"
"""


@dataclass(frozen=True)
class Result:
    """An observer's truth, and what the analysis makes of its answers."""

    jnd: float
    pse: float
    fit: Fit


def study_file(folder: Path, name: str, seconds: float, seed: int, method: str) -> Path:
    """Write a study with one condition and this table of its method, and return its path."""
    path = folder / "study.toml"
    path.write_text(STUDY.format(name=name, seconds=seconds, seed=seed, reference=REFERENCE, method=method))
    return path


@lru_cache
def _study(method: str) -> Study:
    with tempfile.TemporaryDirectory() as folder:
        return read_study(study_file(Path(folder), "observers", 0.1, SEED, METHODS[method]))


def faults_of(case: str, jnd: float, random: np.random.Generator) -> Faults:
    """Return what an observer of a case does other than an ideal one."""
    sigma = jnd * SIGMAS_A_JND
    if case == "PSE off by JND/3":
        return Faults(shift=jnd / 3)
    if case == "bias of sigma/2":
        return Faults(bias=sigma / 2)
    if case == "all at random":
        shift, bias, lapse = random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), random.uniform(0, 0.04)
        return Faults(shift=shift * jnd, bias=bias * sigma, lapse=lapse)
    return Faults()


Truth: TypeAlias = tuple[float, Faults]
Answered: TypeAlias = tuple[list[float], list[bool], float, list[bool]]
"""Levels, whether each was judged larger, the reference, whether the level was the second display."""


def truth_of(case: str, subject: int) -> Truth:
    """Draw JND and faults of observer number `subject` of a case."""
    random = np.random.default_rng([SEED, subject])
    jnd = JND * float(np.exp(random.normal(0.0, SPREAD)))
    return jnd, faults_of(case, jnd, random)


def answers_of(method: str, case: str, subject: int) -> tuple[Truth, Answered]:
    """Let observer number `subject` answer all trials of a method; return its JND and faults, too."""
    jnd, faults = truth_of(case, subject)
    observer, trials = Observer(jnd, SEED, subject, faults=faults), Trials(_study(method), subject)
    levels, larger, second = [], [], []
    while (trial := trials.next()) is not None:
        answer = observer.answer(trial)
        levels.append(trial.level)
        larger.append(trial.right(answer))
        second.append(trial.first == 2)
        trials.answer(answer)
    return (jnd, faults), (levels, larger, REFERENCE, second)


def answered(method: str, case: str, subject: int) -> Result:
    """Let observer number `subject` answer all trials of a method, and fit its answers."""
    (jnd, faults), answers = answers_of(method, case, subject)
    return Result(jnd, REFERENCE + faults.shift, fit_comparisons(*answers))


def share(held: Iterable[bool]) -> str:
    """Return how often something held, as text."""
    return f"{np.mean(list(held)):.1%}"


def within(bounds: Sequence[float | None], truth: float) -> bool:
    """Tell whether an interval holds the truth; None: it has no end there."""
    low, high = bounds
    return (low is None or low <= truth) and (high is None or truth <= high)


def _row(method: str, case: str, results: list[Result]) -> tuple[str, ...]:
    ratio = [each.fit.jnd / each.jnd for each in results]
    return (
        method,
        case,
        share(within(each.fit.jnd_95, each.jnd) for each in results),
        share(within(each.fit.pse_95, each.pse) for each in results),
        f"{np.median(ratio) - 1:+.1%}",
        f"{np.exp(np.mean(np.log(ratio))) - 1:+.1%}",
        share(each.fit.probability < 0.05 for each in results),
    )


HEAD = (
    "method",
    "observers",
    "JND held",
    "PSE held",
    "JND, median error",
    "JND, mean log error",
    "p < 0.05",
)


def observers(show: Show, count: int, document: Path | None = None, processes: int = 2) -> None:
    """Show the coverage of each method with `count` observers of each kind; write it into `document`."""
    rows = []
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for method in METHODS:
            for case in CASES:
                results = list(pool.map(partial(answered, method, case), range(count), chunksize=4))
                rows.append(_row(method, case, results))
                held, pse, error = rows[-1][2], rows[-1][3], rows[-1][4]
                show(f"{method}, {case}: JND held, PSE held, median error", f"{held}, {pse}, {error}", "90 to 99 %")
    if document is not None:
        write_table(document, "observers", f"{count} observers in each row, seed {SEED}:", [HEAD, *rows])


def write_table(document: Path, name: str, caption: str, rows: Sequence[Sequence[str]]) -> None:
    """Replace what stands between the marks `name` of a document by a text and a table with its head."""
    begin, end = (f"<!-- {name}: {mark} -->" for mark in ("begin", "end"))
    table = "\n".join(f"| {' | '.join(line)} |" for line in (rows[0], ["---"] * len(rows[0]), *rows[1:]))
    before, _, rest = document.read_text().partition(begin)
    document.write_text(f"{before}{begin}\n{caption}\n\n{table}\n{end}{rest.partition(end)[2]}")
