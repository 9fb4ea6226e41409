r"""A simulated observer, whose psychometric function is known.

Of two displays it judges the one as larger for which the figure with its noise :math:`n` is, with
:math:`n` normal of standard deviation :math:`\sigma`:

.. math:: P(x > x_{ref}) = \frac{\lambda}{2} + (1 - \lambda)\,
          \Phi\left(\frac{x - x_{ref} - \delta \pm \beta}{\sigma}\right), \qquad JND = 0.6745\, \sigma,

with the shift :math:`\delta` of its point of subjective equality, its interval bias :math:`\beta`
towards the second display, and the share :math:`\lambda` of its answers that it draws at random
(`results.posterior` has the sources). Its answer to a trial depends on what it judges, the seed, the
subject and the trial's number alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from coulombus.lab.study.trials import Trial

__all__ = ["Faults", "Observer", "levels"]


def levels(trial: Trial) -> Sequence[float]:
    """Return the levels of a trial's displays."""
    return trial.levels


@dataclass(frozen=True)
class Faults:
    """What makes an observer differ from an ideal one.

    Attributes
    ----------
    shift : of the point of subjective equality from the reference, in units of what is judged
    bias : interval bias in the same units; above 0 it favours the second display
    lapse : share of the answers that are drawn at random
    """

    shift: float = 0.0
    bias: float = 0.0
    lapse: float = 0.0


class Observer:
    """Answers as a person of this just noticeable difference would.

    Parameters
    ----------
    jnd : in units of what is judged
    judged : returns a figure for each display of a trial, in their order: the level, unless another
        is given, as the torque that was felt
    faults : none, unless given
    """

    def __init__(
        self,
        jnd: float,
        seed: int,
        subject: int,
        judged: Callable[[Trial], Sequence[float]] = levels,
        faults: Faults = Faults(),
    ) -> None:
        self._sigma, self._seed, self._judged = jnd / float(ndtri(0.75)), (seed, subject), judged
        self._faults = faults

    def answer(self, trial: Trial) -> str:
        """Return the answer to a trial: 1 or 2 of two displays, a magnitude of one."""
        random, faults = np.random.default_rng([*self._seed, trial.number, 1]), self._faults
        noise = float(random.normal()) * self._sigma
        judged = self._judged(trial)
        if trial.reference is None:
            return f"{max(10.0 * (judged[0] + noise), 0.0):.1f}"
        at_level, other = judged[trial.first - 1], judged[2 - trial.first]
        if random.random() < faults.lapse:
            return str(int(random.integers(1, 3)))
        towards = faults.bias if trial.first == 2 else -faults.bias
        return str(trial.first if at_level + noise + towards > other + faults.shift else 3 - trial.first)
