"""Studies with a simulated observer of known threshold, through the whole chain: how often is it found?

Each study is a pair of staircases of its own, shown on the simulated rig: bring-up, arming, friction through
PDOs, a recording. The observer judges the torque that its hand felt, out of the recordings; its point of
subjective equality is up to half a JND off, its interval bias up to half a sigma, and it draws up to 4 % of
its answers at random. Each study is then analysed as any other. Given again, the same command goes on where it was stopped.

python examples/study_coverage.py out/coverage --studies 100 --processes 2
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import shutil
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from coulombus.lab.study.displays import VirtualDisplays
from coulombus.lab.study.felt_torque import felt_Nm
from coulombus.lab.study.observer import Faults, Observer
from coulombus.lab.study.results.report import report
from coulombus.lab.study.session import People, SubjectSession, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import SubjectFolder

JND_NM, REFERENCE_NM = 0.15, 2.0
SUBJECT = "S01"
STUDY = """name = "coverage"
seconds = 1.2
seed = {seed}
reference = {reference}
question = "Which one had more friction?"

[level]                          # a level is a friction torque
"mode.{{mode}}.F_s_Nm" = 1.0
"mode.{{mode}}.F_d_Nm" = 1.0

[method]
kind = "staircase"
start = 2.6
low = {reference}
high = 3.0
steps = [0.2, 0.1, 0.05]
trials = {trials}

[[condition]]
name = "hybrid"
set = ['''phase=[{{kind="rest",duration_s=0.8}},{{kind="stroke",duration_s=0.4,speed_rad_s=4.0,move_s=0.4,dwell_s=0.1}}]''']
"""


def faults_of(seed: int) -> Faults:
    """Return what the observer of study number `seed` does other than an ideal one."""
    random = np.random.default_rng([20, seed])
    shift, bias, lapse = random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), random.uniform(0.0, 0.04)
    return Faults(shift=shift * JND_NM, bias=bias * JND_NM / float(ndtri(0.75)), lapse=lapse)


def study(folder: Path, trials: int, seed: int) -> dict[str, Any]:
    """Carry out what is left of study number `seed`; return what its analysis tells."""
    own = folder / f"study-{seed:03d}"
    own.mkdir(parents=True, exist_ok=True)
    file = own / "study.toml"
    file.write_text(STUDY.format(seed=seed, reference=REFERENCE_NM, trials=trials))
    with SubjectFolder(read_study(file), own / "kept", SUBJECT, {"bus": "virtual time"}) as kept:
        observer = Observer(
            JND_NM,
            seed,
            kept.number,
            lambda trial: [felt_Nm(kept.recording(trial, one)) for one in range(1, len(trial.levels) + 1)],
            faults_of(seed),
        )
        people = People(tell=lambda text: None, ask=observer.answer, go_on=lambda text: True)
        came = run_session(SubjectSession(kept, VirtualDisplays()), people)
        if not came.complete:
            raise RuntimeError(f"study {seed}: {came.ended_by}")
        shutil.rmtree(kept.own / "recordings")  # 0.8 MB a display; what was felt of them is in the answers
    found: dict[str, Any] = report(own / "kept")["subjects"][SUBJECT]["hybrid"]
    return found | {"true_pse_Nm": REFERENCE_NM + faults_of(seed).shift}


def figures(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what the studies come to together."""
    fits = [one["fit"] for one in found]
    held = [(fit["jnd_95"][0] or 0.0) <= JND_NM <= (fit["jnd_95"][1] or np.inf) for fit in fits]
    pse = [one["fit"]["pse_95"][0] <= one["true_pse_Nm"] <= one["fit"]["pse_95"][1] for one in found]
    bounded = [None not in fit["jnd_95"] for fit in fits]
    stairs = [one["staircase"] for one in found if one["staircase"] is not None]
    rest = REFERENCE_NM + JND_NM / ndtri(0.75) * ndtri(np.sqrt(0.5))
    return {
        "studies": len(found),
        "interval_holds": sum(held),
        "pse_interval_holds": sum(pse),
        "interval_bounded": sum(bounded),
        "median_jnd_Nm": float(np.median([fit["jnd"] for fit in fits])),
        "true_jnd_Nm": JND_NM,
        "right_from_third_turn": float(np.mean([one["right"] for one in stairs])) if stairs else None,
        "mean_of_turns_Nm": float(np.mean([one["threshold"] for one in stairs])) if stairs else None,
        "level_of_70.7_percent_Nm": float(rest),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the studies are kept")
    parser.add_argument("--studies", type=int, default=100)
    parser.add_argument("--trials", type=int, default=40, help="of each study; two displays each")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()

    found: list[dict[str, Any]] = []
    with ProcessPoolExecutor(options.processes, multiprocessing.get_context("spawn")) as pool:
        one_study = partial(study, options.folder, options.trials)
        for done in as_completed([pool.submit(one_study, seed) for seed in range(options.studies)]):
            found.append(done.result())
            print(f"{len(found)} of {options.studies} studies", file=sys.stderr, flush=True)
    print(json.dumps(figures(found), indent=2))


if __name__ == "__main__":
    main()
