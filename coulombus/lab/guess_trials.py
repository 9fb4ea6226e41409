"""Test the alternatives of guesses about a drive: the host uses its rig file, the simulated drive the alternative.

A rehearsal alone cannot reveal a wrong guess, because its plant is a copy of the host's model. Here
the plant differs by one alternative; the result is the check that detects it, and the handle's
motion until then. Combinations of alternatives are not tested.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from coulombus.lab.simulate import simulate
from coulombus.rigs.axis import Axis
from coulombus.rigs.draft.marks import guesses
from coulombus.rigs.rig import Rig
from coulombus.system.errors import CoulombusError

__all__ = ["NOBODY", "GuessTrial", "OtherReading", "readings", "tried"]

SECONDS = 2.0
NOBODY = "nothing"
"""Value of `noticed_by` if an alternative passes undetected."""


class OtherReading(NamedTuple):
    """An alternative of a guess: its key, its text, and the resulting keys of the plant."""

    key: str
    meaning: str
    overrides: tuple[str, ...]


class GuessTrial(NamedTuple):
    """The result for an alternative.

    Attributes
    ----------
    noticed_by : the trip that ended the run, or the reason for not arming; `NOBODY` if undetected
    angle_rad, speed_rad_s, motor_Nm : the largest at the handle until then
    """

    reading: OtherReading
    noticed_by: str
    angle_rad: float
    speed_rad_s: float
    motor_Nm: float


def readings(axis: Axis, text: str) -> Iterator[OtherReading]:
    """Yield the alternatives of a rig file's marked guesses.

    Parameters
    ----------
    text : the rig file's
    """
    marked = {guess.key for guess in guesses(text)}
    plant = axis.simulation.plant
    if "motor.rated_torque_Nm" in marked:
        rated = plant.motor_rated_torque_Nm
        for factor, meaning in (
            (1000.0, "in mNm, where the rig file has uNm"),
            (1e-3, "in uNm, where the rig file has mNm"),
            (3.0, "per mille of a rated current with three times the torque"),
            (1 / 3, "per mille of a rated current with a third of the torque"),
        ):
            largest = 1e4
            if factor * rated <= largest:
                yield OtherReading(
                    "motor.rated_torque_Nm", meaning, (f"plant.motor_rated_torque_Nm={factor * rated!r}",)
                )
    if "motor.encoder_counts_rev" in marked:
        believed = axis.motor.encoder_counts_rev
        for counts, meaning in (
            (4 * believed, "lines, where the rig file has counts"),
            (believed // 4, "counts, where the rig file has lines"),
            (360, "degrees"),
            (3_600, "tenths of a degree"),
            (360_000, "thousandths of a degree"),
        ):
            if counts >= 1 and counts != believed:
                yield OtherReading("motor.encoder_counts_rev", meaning, (f"plant.encoder_counts_rev={counts}",))
    for key in ("motor_polarity", "encoder_polarity"):
        if {f"mechanics.{key}", "mechanics.ratio"} & marked:
            other = -getattr(plant, key)
            yield OtherReading(f"mechanics.{key}", "the other sense", (f"plant.{key}={other}",))


def tried(rig: Rig, text: str) -> tuple[GuessTrial, ...]:
    """Return the results for each alternative of the guesses in a rehearsal's rig file.

    Parameters
    ----------
    text : the rig file's, with its marks
    """
    axis = rig.one_axis()
    mode = "active" if "active" in axis.mode else rig.modes[-1]
    trials = []
    with TemporaryDirectory() as folder:
        for number, reading in enumerate(readings(axis, text)):
            trials.append(_tried(rig, mode, reading, Path(folder) / f"{number}.npz"))
    return tuple(trials)


def _tried(rig: Rig, mode: str, reading: OtherReading, path: Path) -> GuessTrial:
    try:
        true = rig.variant(*reading.overrides)
        ended = simulate(rig, mode, SECONDS, truth=path, simulated=true)
    except CoulombusError as refused:
        return GuessTrial(reading, f"before arming: {str(refused).partition(';')[0]}", 0.0, 0.0, 0.0)
    noticed = (ended.trip or NOBODY).partition(":")[0]
    if not path.exists():
        return GuessTrial(reading, noticed, 0.0, 0.0, 0.0)
    with np.load(path) as truth:
        largest = [float(np.abs(truth[name]).max(initial=0.0)) for name in ("angle_rad", "speed_rad_s", "motor_Nm")]
    return GuessTrial(reading, noticed, *largest)
