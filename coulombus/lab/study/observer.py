r"""A simulated observer, whose threshold is known.

Of two displays it takes the one as larger for which :math:`x + n` is, with :math:`n` normal:

.. math:: P(x > x_{ref}) = \Phi\left(\frac{x - x_{ref}}{\sigma}\right), \qquad JND = 0.6745\, \sigma.

Its answer to a trial depends on what it judges, the seed, the subject and the trial's number alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import ndtri

from coulombus.lab.study.trials import Trial

__all__ = ["Observer"]


def _levels(trial: Trial) -> Sequence[float]:
    return trial.levels


class Observer:
    """Answers as a person of this just noticeable difference would.

    Parameters
    ----------
    jnd : in units of what is judged
    judged : returns a figure for each display of a trial, in their order: the level, unless another
        is given, as the torque that was felt
    """

    def __init__(
        self, jnd: float, seed: int, subject: int, judged: Callable[[Trial], Sequence[float]] = _levels
    ) -> None:
        self._sigma, self._seed, self._judged = jnd / float(ndtri(0.75)), (seed, subject), judged

    def answer(self, trial: Trial) -> str:
        """Return the answer to a trial: 1 or 2 of two displays, a magnitude of one."""
        noise = float(np.random.default_rng([*self._seed, trial.number, 1]).normal()) * self._sigma
        judged = self._judged(trial)
        if trial.reference is None:
            return f"{max(10.0 * (judged[0] + noise), 0.0):.1f}"
        own, other = judged[trial.first - 1], judged[2 - trial.first]
        return str(trial.first if own + noise > other else 3 - trial.first)
