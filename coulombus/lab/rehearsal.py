"""Commissioning rehearsed in virtual time: the host believes its rig file, and a simulated rig is
as it truly is, with a hand that does what a step asks of the operator.
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
    """Return what runs the exercises of commissioning in virtual time.

    Parameters
    ----------
    truth : the rig as it truly is; None: as each exercise's own rig file has it
    seed : of everything random
    """

    def run(exercise: Exercise, path: Path) -> RunResult:
        mode = exercise.rig.one_axis().mode[exercise.mode]
        same = (f"mode.{exercise.mode}.{key}={value!r}" for key, value in mode.model_dump().items())
        true = (truth or exercise.rig).variant(*exercise.hand, *same)  # a mode that the true rig may not have
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
