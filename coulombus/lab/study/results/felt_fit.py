r"""The psychometric function of a subject in the torque that its hand felt.

A display of level :math:`x` is felt as a torque :math:`F` (`felt_torque`), which is the law's only as
far as rig and hand let it be. Each trial enters with the difference of what was felt in its two
displays. So the point of subjective equality and the just noticeable difference are in Nm at the
hand, whatever the unit of the level is. What the hand felt follows the level as

.. math:: F = F_{ref} + g\,(x - x_{ref}) + e,

by least squares, with the torque :math:`F_{ref}` at the reference, the gain :math:`g` and what is left,
:math:`e`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.lab.study.results.fit import Fit, fit_answers

__all__ = ["FeltFit", "fit_felt"]


@dataclass(frozen=True)
class FeltFit:
    """A psychometric function of the felt torque.

    Attributes
    ----------
    fit : in Nm. Hardly two trials feel alike, so its deviance says little: that of the levels does
    reference_Nm : torque that was felt at the reference, of the line through all displays
    gain : felt torque for each unit of the level [Nm]
    spread_Nm : standard deviation of what was felt about the line
    """

    fit: Fit
    reference_Nm: float
    gain: float
    spread_Nm: float

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return asdict(self)


def fit_felt(
    levels: npt.ArrayLike, felt_Nm: npt.ArrayLike, larger: Sequence[bool], reference: float, second: Sequence[bool]
) -> FeltFit:
    """Return the psychometric function of comparisons with a reference in the torque that was felt.

    Parameters
    ----------
    levels : of each trial, shape (n,)
    felt_Nm : torque that was felt of the level and of the reference, shape (n, 2)
    larger : whether the level was judged larger than the reference, shape (n,)
    reference : in units of the level
    second : whether the level was the second display, shape (n,)

    Raises
    ------
    ValueError
        there is no trial, or no level differs from the reference
    """
    x, felt = np.asarray(levels, float), np.asarray(felt_Nm, float).reshape(-1, 2)
    if not np.any(x != reference):
        raise ValueError("no level differs from the reference; expected trials with levels that do")
    distance = np.concatenate([x - reference, np.zeros_like(x)])
    design = np.stack([np.ones_like(distance), distance], axis=1)
    shown = felt.T.ravel()
    line = np.linalg.lstsq(design, shown, rcond=None)[0]
    left = shown - design @ line
    felt_reference = float(line[0])
    fit, _ = fit_answers(list(felt_reference + felt[:, 0] - felt[:, 1]), larger, felt_reference, second)
    one_sided = bool(x.min() >= reference or x.max() <= reference)
    spread = float(np.sqrt(np.sum(left**2) / max(len(left) - 2, 1)))
    return FeltFit(replace(fit, one_sided=one_sided), felt_reference, float(line[1]), spread)
