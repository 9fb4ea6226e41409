r"""A law along a given motion: sample by sample, with the compiled function that the cycle uses.

Between two samples the angle is a straight line. So the speed of a sample is the slope of the
interval that ends there, as in the cycle,

.. math:: v_k = \frac{x_k - x_{k-1}}{t_k - t_{k-1}}, \quad v_0 = 0

and the torque of a sample is :math:`\psi` at the end of that interval: positive against a positive
speed. A law with a state begins relaxed, stuck at the start of the motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.law import Declaration, LawFunction, LawRecord, LawStateRecord, MotionRecord, Parameters
from coulombus.host.laws.laws import BUILTIN_LAWS, LawError, load_declared
from coulombus.host.laws.parameters import set_parameters
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Record, RecordArray, Records, new_records

__all__ = ["COUNT_RAD", "Driven", "GivenLaw", "drive", "given_law"]

Floats = npt.NDArray[np.float64]

OF_MODE = "karnopp"
"""The law whose parameters, those of [mode.*], also apply to a law without named parameters."""

COUNT_RAD = 2 * math.pi / 8192 / 9.587
"""Angle of an encoder count at the handle of the rig ``bench`` [rad]."""


class Sample(Record):
    """Input and output of a law for one sample."""

    t_s: float
    x_rad: float
    v_rad_s: float
    torque_Nm: float
    brake_Nm: float  # the law's set-point for the brake


class Asked(Record):
    """Input, parameters and state of a law."""

    motion: MotionRecord
    law: LawRecord
    state: LawStateRecord
    count_rad: float


@kernel
def _drive(inputs: Asked, law_function: LawFunction, samples: RecordArray[Sample]) -> int:
    """Evaluate the law at each of `samples`; return the first sample with a torque that is not finite, or
    -1.
    """
    motion, state = inputs.motion, inputs.state
    state.stuck = 1
    state.x_stuck = samples[0].x_rad
    for k in range(len(samples)):
        sample = samples[k]
        before = samples[k - 1] if k > 0 else sample
        motion.dt_s = sample.t_s - before.t_s if k > 0 else samples[1].t_s - sample.t_s
        motion.x_rad = sample.x_rad
        motion.v_rad_s = (sample.x_rad - before.x_rad) / motion.dt_s
        motion.v_counts = (sample.x_rad - before.x_rad) / inputs.count_rad
        psi_Nm = law_function(motion, inputs.law, state)
        sample.v_rad_s = motion.v_rad_s
        sample.torque_Nm = psi_Nm
        sample.brake_Nm = state.brake_Nm
        if not math.isfinite(psi_Nm) or not math.isfinite(state.brake_Nm):
            return k
        state.psi_Nm = psi_Nm
    return -1


@dataclass(frozen=True)
class Driven:
    """Output of a law along a motion.

    samples : array of `Sample`
    """

    samples: RecordArray[Sample]

    @property
    def peak_Nm(self) -> float:
        """The largest torque, of either sign."""
        return float(np.abs(self.samples["torque_Nm"]).max())

    @property
    def work_J(self) -> Floats:
        r"""The work absorbed by the law up to each sample, :math:`\int \psi\,dx` by the trapezium rule; negative
        if the law has returned more than it absorbed.
        """
        torque, x = self.samples["torque_Nm"], self.samples["x_rad"]
        steps = 0.5 * (torque[1:] + torque[:-1]) * np.diff(x)
        return np.concatenate(([0.0], np.cumsum(steps)))


@dataclass(frozen=True)
class GivenLaw:
    """A compiled law with its parameters."""

    name: str
    pointer: LawFunction
    declaration: Declaration | None
    """None: the law has no named parameters."""
    parameters: Parameters

    @property
    def parameter_texts(self) -> list[str]:
        """Each parameter as "KEY = VALUE"."""
        return [
            f"{key} = {value:g}" if isinstance(value, float) else f"{key} = {value}" for key, value in self.parameters
        ]

    def along(self, t_s: npt.NDArray[Any], x_rad: npt.NDArray[Any], count_rad: float = COUNT_RAD) -> Driven:
        """Evaluate the law along a motion, from its relaxed state.

        Parameters
        ----------
        t_s : ascending times [s], two or more
        x_rad : angles at these times [rad]
        count_rad : angle of an encoder count [rad], for laws that compare counts

        Raises
        ------
        coulombus.host.laws.laws.LawError
            the law returned a number that is not finite
        """
        inputs, samples = new_records(Asked), new_records(Sample, len(t_s))
        samples["t_s"], samples["x_rad"] = t_s, x_rad
        inputs[0]["count_rad"] = count_rad
        (self.declaration or BUILTIN_LAWS[OF_MODE]).fill(inputs[0]["law"], self.parameters)
        return _driven(self.name, self.pointer, inputs, samples)


def drive(
    name: str, pointer: LawFunction, law: Records, t_s: npt.NDArray[Any], x_rad: npt.NDArray[Any], count_rad: float
) -> Driven:
    """Evaluate a law with parameters in a record of `LawRecord` along a motion, as `GivenLaw.along` does."""
    inputs, samples = new_records(Asked), new_records(Sample, len(t_s))
    samples["t_s"], samples["x_rad"] = t_s, x_rad
    inputs[0]["count_rad"], inputs[0]["law"] = count_rad, law[0]
    return _driven(name, pointer, inputs, samples)


def _driven(name: str, pointer: LawFunction, inputs: Records, samples: RecordArray[Sample]) -> Driven:
    failed = _drive(inputs[0], pointer, samples)
    if failed >= 0:
        sample = samples[failed]
        raise LawError(
            f"law {name!r} returned {sample['torque_Nm']:g} Nm and {sample['brake_Nm']:g} Nm for the brake at "
            f"t_s={sample['t_s']:g}, x_rad={sample['x_rad']:g}; expected finite numbers: on a rig this trips (LAW)"
        )
    return Driven(samples)


def given_law(name: str, overrides: Sequence[str] = (), directory: Path | None = None) -> GivenLaw:
    """Return a law by its name, with its default parameters except for "KEY=VALUE".

    A law without named parameters gets those of [mode.*], with the defaults of `karnopp`.

    Raises
    ------
    coulombus.host.laws.laws.LawError
        there is no such law
    coulombus.rigs.rig.RigError
        the law does not have a parameter, or its value is refused
    """
    loaded = load_declared(name, directory)
    parameters = set_parameters(loaded.declaration or BUILTIN_LAWS[OF_MODE], overrides)
    return GivenLaw(name, loaded.pointer, loaded.declaration, parameters)
