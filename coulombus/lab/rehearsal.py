"""Rehearse commissioning in virtual time.

The host uses its rig file, the simulated rig its true values, and a simulated hand follows the steps' instructions.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from coulombus.host.commission.session import Runner
from coulombus.host.commission.step import Exercise
from coulombus.host.run.result import RunResult
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import Rig

__all__ = ["rehearsed"]


def rehearsed(truth: Rig | None, *, seed: int = 0, progress: Callable[[float], None] | None = None) -> Runner:
    """Return a function that runs the exercises of commissioning in virtual time.

    Parameters
    ----------
    truth : the true rig; None: the rig file of each exercise
    seed : random seed
    """

    def run(exercise: Exercise, path: Path) -> RunResult:
        mode = exercise.rig.one_axis().mode[exercise.mode]
        same = (f"mode.{exercise.mode}.{key}={value!r}" for key, value in mode.model_dump().items())
        true = (truth or exercise.rig).variant(*exercise.hand, *same)  # the true rig may lack the mode
        return simulate(
            exercise.rig,
            exercise.mode,
            exercise.seconds,
            record=path,
            seed=seed,
            force=True,
            simulated=true,
            progress=progress,
        )

    return run
