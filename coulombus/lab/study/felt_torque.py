r"""The friction that a hand felt in a display, from its recording.

What the hand gave to the handle went into friction, as far as the handle is at the end as fast as
at the beginning:

.. math:: F = \frac{\sum \tau\, \Delta\theta}{\sum |\Delta\theta|}

with the angle :math:`\theta` of the motor's encoder and the torque :math:`\tau` of the handle's
transducer, over the last phase of the display. The device's own friction is in it, too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coulombus.lab.study.study_folder import SubjectFolder
from coulombus.lab.study.trials import Trial
from coulombus.recording.reading import read
from coulombus.system.errors import CoulombusError

__all__ = ["FeltError", "felt_Nm", "felt_of"]

LEAST_RAD = 0.05
"""Who turned the handle less has felt nothing to judge by."""


class FeltError(CoulombusError):
    """A recording does not tell what a hand felt; the text says why, and what to do."""

    exit_status = 2


def felt_of(folder: SubjectFolder, trial: Trial) -> list[float]:
    """Return the mean friction [Nm] that the hand felt in each display of a trial; errors as `felt_Nm`."""
    return [felt_Nm(folder.recording(trial, number)) for number in range(1, len(trial.levels) + 1)]


def felt_Nm(path: Path) -> float:
    """Return the mean friction [Nm] that the hand felt in the display recorded at `path`.

    Raises
    ------
    FeltError
        the rig has no transducer or several axes, or the handle did not turn
    coulombus.recording.pcapng_blocks.RecordingError
        it is no recording
    """
    recording = read(path)
    for name in ("motor.position_rad", "brake.handle_torque_Nm"):
        if name not in recording.signals:
            raise FeltError(f"{path}: has no signal {name}; take --felt out, or choose a rig of one axis that has it")
    angle, torque = recording["motor.position_rad"], recording["brake.handle_torque_Nm"]
    ends = [t_s for t_s, text in recording.markers if text == "phase end"]
    begins = [t_s for t_s, text in recording.markers if text.startswith("phase ") and text != "phase end"]
    inside = (angle.t_s >= max(begins, default=-np.inf)) & (angle.t_s <= min(ends, default=np.inf))
    t_s, theta = angle.t_s[inside], angle.values[inside]
    turned = np.diff(theta)
    path_rad = float(np.abs(turned).sum())
    if path_rad < LEAST_RAD or not len(torque.t_s):
        raise FeltError(
            f"{path}: the handle turned by {path_rad:.3g} rad in the last phase, where a hand feels nothing to judge "
            "by; take --felt out, or let the simulated hand move (operator, phase)"
        )
    push = np.interp(t_s, torque.t_s, torque.values)
    return float(np.sum((push[1:] + push[:-1]) / 2 * turned)) / path_rad
