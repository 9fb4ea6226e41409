r"""Sine of an angle that moves a little in each step.

:math:`\sin(\varphi_0 + \delta) = \sin\varphi_0\cos\delta + \cos\varphi_0\sin\delta`, with the
series of the small angle :math:`\delta` up to :math:`\delta^7`: accurate to :math:`\delta^8/8!`,
which is 2.5e-13 where :math:`\varphi_0` is recomputed (`FAR_rad`). The series costs less than a
sine.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.rig.records import WaveRecord

__all__ = ["wave"]

FAR_rad = 0.1


@kernel
def wave(state: WaveRecord, angle: float) -> float:
    """Return the sine of `angle` [rad]; `state` is a record of `WaveRecord`."""
    small = angle - state.at
    if abs(small) > FAR_rad or state.cosine == state.sine:
        state.at, state.sine, state.cosine = angle, math.sin(angle), math.cos(angle)
        return float(state.sine)
    square = small * small
    odd = small * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0))))
    even = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)))
    return float(state.sine * even + state.cosine * odd)
