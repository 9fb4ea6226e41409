"""Simulated observers through the whole chain: each display is shown, felt, and judged as it was felt.

Each observer goes through a session on the simulated rig in virtual time. Every display is brought up,
armed, shown through PDOs, safely ended and recorded. The observer has a hand of its own, and moves it in
each display at another speed. It judges the torque that the hand felt, out of the recordings, and is
otherwise one of "all at random" of `benchmarks.observers`; JND, shift and bias are in Nm at the hand. Its
folder is then analysed as `coulombus analyse study --felt` does.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.observers import REFERENCE, SEED, Show, share, study_file, truth_of, within, write_table
from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Run
from coulombus.lab.study.displays import VirtualDisplays
from coulombus.lab.study.felt_torque import felt_of
from coulombus.lab.study.observer import Observer
from coulombus.lab.study.results.report import report
from coulombus.lab.study.session import People, SubjectSession, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import SubjectFolder

__all__ = ["METHODS", "displayed", "observer_displays"]

METHODS = {
    "constant stimuli, 48 trials": 'kind = "constant"\nlevels = [1.6, 1.8, 1.9, 2.1, 2.2, 2.4]\nrepeats = 8\n',
    "staircases 1 up 2 down, 48 trials": 'kind = "staircase"\nstart = 2.6\nlow = 2.0\nhigh = 3.0\n'
    "steps = [0.2, 0.1, 0.05]\ntrials = 48\n",
    "weighted staircases 3 : 1, 48 trials": 'kind = "staircase"\nstart = 2.6\nlow = 2.0\nhigh = 3.0\n'
    "steps = [0.1, 0.05]\ndown = 1\nup_ratio = 3.0\ntrials = 48\n",
    "QUEST+, 40 trials": 'kind = "quest"\nlow = 2.0\nhigh = 3.0\ntrials = 40\n',
}
"""Name of a method -> its table of the study file; a person takes some minutes for each."""
HANDS, SPEEDS_RAD_S = 0.15, (3.0, 5.0)
"""Standard deviation of the logarithm of a hand's impedance; desired speeds of a stroke."""
SUBJECT = "S01"


@dataclass(frozen=True)
class Chain:
    """An observer's truth in Nm at the hand, and what the analysis makes of its session."""

    jnd: float
    shift: float
    fit: dict[str, Any]
    felt: dict[str, Any]

    def held(self, name: str, felt: bool) -> bool:
        """Tell whether the interval of JND or PSE holds the truth, as felt or as commanded."""
        fit, reference = (self.felt["fit"], self.felt["reference_Nm"]) if felt else (self.fit, REFERENCE)
        return within(fit[f"{name}_95"], self.jnd if name == "jnd" else reference + self.shift)


class HandDisplays(VirtualDisplays):
    """Shows in virtual time, to the hand of an observer, which moves each time at another speed."""

    def __init__(self, subject: int) -> None:
        factors = np.exp(HANDS * np.random.default_rng([SEED, 1, subject]).standard_normal(3))
        names = ("inertia_kg_m2", "damping_Nms_rad", "stiffness_Nm_rad")
        self._factors = dict(zip(names, factors, strict=True))

    def __call__(self, display: Run) -> RunResult:
        """Show it, and return what came of it."""
        random = np.random.default_rng([SEED, 2, display.seed])
        speed = random.uniform(*SPEEDS_RAD_S) * random.choice((-1, 1))
        hand = display.rig.one_axis().simulation.operator
        changes = [f"operator.{name}={getattr(hand, name) * factor}" for name, factor in self._factors.items()]
        stroke = f'kind="stroke",duration_s=0.4,speed_rad_s={speed},move_s=0.4,dwell_s=0.1'
        changes.append(f'phase=[{{kind="rest",duration_s=0.8}},{{{stroke}}}]')
        return super().__call__(replace(display, rig=display.rig.variant(*changes)))


def displayed(method: str, subject: int) -> Chain:
    """Show all trials of a method to observer number `subject`, and analyse its folder."""
    jnd, faults = truth_of("all at random", subject)
    folder = Path(tempfile.mkdtemp(prefix="observer-"))
    try:
        file = study_file(folder, "displays", 1.2, SEED + subject, METHODS[method])
        with SubjectFolder(read_study(file), folder / "kept", SUBJECT, {"bus": "virtual time"}) as subject_folder:
            observer = Observer(jnd, SEED + subject, subject_folder.number, partial(felt_of, subject_folder), faults)
            session = SubjectSession(subject_folder, HandDisplays(subject))
            shown = run_session(session, People.simulated(observer.answer))
            if not shown.complete:
                raise RuntimeError(f"{method}, observer {subject}: {shown.ended_by}")
        condition = report(folder / "kept", felt=True)["subjects"][SUBJECT]["hybrid"]
    finally:
        shutil.rmtree(folder)  # 0.8 MB a display
    return Chain(jnd, faults.shift, condition["fit"], condition["felt"])


HEAD = (
    "method",
    "JND held, felt",
    "PSE held, felt",
    "JND held, commanded",
    "PSE held, commanded",
    "JND, median error, felt",
    "felt at 2 Nm [Nm]",
    "felt for each Nm",
    "spread [Nm]",
)


def _row(method: str, results: Sequence[Chain]) -> tuple[str, ...]:
    held = [share(each.held(name, felt) for each in results) for felt in (True, False) for name in ("jnd", "pse")]
    error = float(np.median([each.felt["fit"]["jnd"] / each.jnd for each in results])) - 1
    felt = [np.array([each.felt[name] for each in results]) for name in ("reference_Nm", "gain", "spread_Nm")]
    reference, gain = (f"{values.mean():.3f} ± {values.std():.3f}" for values in felt[:2])
    return (method, *held, f"{error:+.1%}", reference, gain, f"{felt[2].mean():.3f}")


def observer_displays(show: Show, count: int, document: Path | None = None, processes: int = 2) -> None:
    """Show the coverage of each method with `count` observers; write it into `document`."""
    rows, all_results = [], []
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        sessions = {method: [pool.submit(displayed, method, k) for k in range(count)] for method in METHODS}
        for method, waiting in sessions.items():
            results = [session.result() for session in waiting]
            all_results += results
            rows.append(_row(method, results))
            _show_row(show, rows[-1])
    rows.append(_row("all methods", all_results))
    _show_row(show, rows[-1])
    if document is not None:
        caption = f"{count} observers of each method, seed {SEED}:"
        write_table(document, "displays", caption, [HEAD, *rows])


def _show_row(show: Show, row: Sequence[str]) -> None:
    show(f"{row[0]}, as felt: JND held, PSE held, median error", ", ".join((*row[1:3], row[5])), "90 to 99 %")
    show("... as commanded: JND held, PSE held", ", ".join(row[3:5]))
    show("... felt at the reference, for each Nm, spread [Nm]", ", ".join(row[6:]))
