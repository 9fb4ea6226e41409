r"""Regression equations from slides: speed, acceleration and torques after one filter.

Encoder and transducer pass *one* weight :math:`F`, a window of `WINDOW_S`:

.. math:: \textstyle\sum F f = J \sum F'' x\,T + b \sum F' x\,T + c\,\mathrm{sgn}(v) + f_0

:math:`F''` is Savitzky and Golay's second derivative of a quadratic, and it is the second
difference of :math:`F`, so speed, acceleration and torque are filtered alike at every frequency
(but for :math:`(\omega T)^4/240`). The encoder's quantisation gives :math:`v` and :math:`a` errors
of known variance, :math:`\Delta^2/12` times the weight's squared norm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from coulombus.recording.friction.sliding import SPEED_SAMPLES, WINDOW_S, Floats, Slide

__all__ = ["Equations", "equations", "weights"]


@dataclass(frozen=True)
class Equations:
    """Filtered samples: each row of the arrays is an equation."""

    v: Floats
    a: Floats
    hand_Nm: Floats
    motor_Nm: Floats
    slide: npt.NDArray[np.int64]
    """Number of each equation's slide."""
    v_variance: float
    a_variance: float
    """Variances of the errors in v and a by the encoder's quantisation."""
    speeds: tuple[Floats, ...]
    """Each slide's speed, sample by sample."""
    weight: Floats
    hop: int

    first: Floats
    """Weights of a derivative after the same filter."""

    def smooth(self, samples: list[Floats]) -> Floats:
        """Return each slide's samples after the equations' filter."""
        return _filtered(samples, self.weight, self.hop)

    def rate(self, samples: list[Floats]) -> Floats:
        """Return their time derivative after the filter [1/s]."""
        return _filtered(samples, self.first, self.hop)


def _filtered(samples: list[Floats], weight: Floats, hop: int) -> Floats:
    return np.concatenate([np.correlate(values, weight, "valid")[::hop] for values in samples])


def weights(size: int, period_s: float) -> tuple[Floats, Floats, Floats]:
    """Return the weights F (of torques), F' and F'' (of positions), `size` samples each."""
    from scipy.signal import savgol_coeffs  # slow to load: imported only for a fit

    second = np.asarray(savgol_coeffs(size, 2, deriv=2, delta=period_s, use="dot"), np.float64)
    window = np.cumsum(np.cumsum(second))[:-2] * period_s**2  # its second difference is `second`
    first = np.convolve(window, [-0.5, 0.0, 0.5]) / period_s
    # a second difference is the mean of the acceleration under a triangle of +- one period: so is
    # the torque's mean (Numerov)
    return np.convolve(window, [1 / 12, 10 / 12, 1 / 12]), first, second


def equations(slides: tuple[Slide, ...], period_s: float, count_rad: float, window_s: float = WINDOW_S) -> Equations:
    """Return the equations of slides, at steps of a quarter of a window."""
    from scipy.signal import savgol_filter

    size = 2 * max(round(0.5 * (window_s / period_s - 1)), 2) + 1
    hop = max(size // 4, 1)
    weight, first, second = weights(size, period_s)
    slides = tuple(slide for slide in slides if len(slide.t_s) >= size)
    positions = [slide.x_rad - slide.x_rad[0] for slide in slides]
    short = min(SPEED_SAMPLES, size)
    return Equations(
        v=_filtered(positions, first, hop),
        a=_filtered(positions, second, hop),
        hand_Nm=_filtered([slide.hand_Nm for slide in slides], weight, hop),
        motor_Nm=_filtered([slide.motor_Nm for slide in slides], weight, hop),
        slide=np.concatenate([np.full((len(s.t_s) - size) // hop + 1, i) for i, s in enumerate(slides)]),
        v_variance=count_rad**2 / 12 * float(first @ first),
        a_variance=count_rad**2 / 12 * float(second @ second),
        speeds=tuple(savgol_filter(x, short, 2, deriv=1, delta=period_s) for x in positions),
        weight=weight,
        hop=hop,
        first=first,
    )
