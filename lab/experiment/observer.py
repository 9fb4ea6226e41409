r"""A simulated observer, whose threshold is known.

Of two displays it takes the one as larger for which :math:`x + n` is, with :math:`n` normal:

.. math:: P(x > x_{ref}) = \Phi\left(\frac{x - x_{ref}}{\sigma}\right), \qquad JND = 0.6745\, \sigma.

Its answer to a trial depends on the seed, the subject and the trial's number alone.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from coulombus.lab.experiment.trials import Trial

__all__ = ["Observer"]


class Observer:
    """Answers as a person of this just noticeable difference would."""

    def __init__(self, jnd: float, seed: int, subject: int) -> None:
        self._sigma, self._seed = jnd / float(ndtri(0.75)), (seed, subject)

    def answer(self, trial: Trial) -> str:
        """Return the answer to a trial: 1 or 2 of two displays, a magnitude of one."""
        noise = float(np.random.default_rng([*self._seed, trial.number, 1]).normal()) * self._sigma
        felt = trial.level + noise
        if trial.reference is None:
            return f"{max(10.0 * felt, 0.0):.1f}"
        larger = felt > trial.reference
        return str(trial.first if larger else 3 - trial.first)
