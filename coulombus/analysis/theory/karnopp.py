r"""Fig. 12: Karnopp's model in the host, compared with eq. (20) as printed.

In stick the paper prints max(F_s, F_a). It must be a saturation, sgn(F_a) min(|F_a|, F_s): friction
balances the applied load up to F_s. The literal maximum is never below F_s, so F_s pushes an
unloaded handle at rest: it is accelerated, slips, stops and is accelerated again, an oscillation
from rest that drifts away. `karnopp_study` shows both on a free handle, sampled and held, through
`host.laws.laws.karnopp` itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.host.laws import laws

__all__ = ["KarnoppStudy", "karnopp_study", "literal_karnopp"]

Floats: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True)
class KarnoppStudy:
    """The model's two branches, and the effect of both readings of eq. (20) on a handle at rest."""

    F_s_Nm: float
    F_d_Nm: float
    band_rad_s: float
    v_rad_s: Floats
    slip_Nm: Floats
    """Friction at v; NaN within the band, where it depends on the load."""
    load_Nm: Floats
    corrected_Nm: Floats
    printed_Nm: Floats
    """Friction in stick at the load."""
    t_s: Floats
    corrected_rad: Floats
    printed_rad: Floats
    """Angle of a handle initially at rest."""


def literal_karnopp(motion: Any, law: Any, state: Any) -> float:
    """Return eq. (20) as printed: in stick max(F_s, F_a), a number that is never below F_s; F_a =
    K_p (x - x_stuck).
    """
    if abs(motion.v_counts) > law.velocity_band_counts:
        state.stuck = 0
        return float(law.F_d if motion.v_counts > 0.0 else -law.F_d)
    if state.stuck == 0:
        state.stuck = 1
        state.x_stuck = motion.x_rad
    return float(max(law.F_s, law.K_p * (motion.x_rad - state.x_stuck)))


def _from_rest(
    law_function: Any, law: Any, count: float, period: float, inertia: float, viscous: float, cycles: int
) -> Floats:
    """Return the angle at each sample of a handle at rest: J v' + b v = -psi, held over a period
    and solved exactly.
    """
    motion, state = (np.zeros(1, dtype).view(np.recarray)[0] for dtype in (laws.MOTION, laws.LAW_STATE))
    state.stuck = 1
    x = v = 0.0
    before = 0
    decay = math.exp(-viscous / inertia * period)
    angle = np.zeros(cycles)
    for k in range(cycles):
        angle[k] = x
        counts = math.floor(x / count + 0.5)
        motion.x_rad, motion.v_counts = counts * count, counts - before
        before = counts
        psi = law_function(motion, law, state)
        state.psi_Nm = psi
        end = -psi / viscous
        x += end * period + (v - end) * inertia / viscous * (1 - decay)
        v = end + (v - end) * decay
    return angle


def karnopp_study(
    *,
    F_s_Nm: float = 1.2,
    F_d_Nm: float = 1.0,
    K_p_Nm_rad: float = 100.0,
    band_counts: int = 2,
    count_rad: float = 2 * math.pi / (8192 * 9.587),
    period_s: float = 1e-3,
    inertia_kg_m2: float = 3e-3,
    viscous_Nms_rad: float = 0.105,
) -> KarnoppStudy:
    """Compute Fig. 12.

    Defaults are the paper's active display on the bench rig's handle with its hand.
    """
    law = np.zeros(1, laws.LAW).view(np.recarray)[0]
    law.K_p, law.F_s, law.F_d, law.velocity_band_counts = K_p_Nm_rad, F_s_Nm, F_d_Nm, band_counts
    motion, state = (np.zeros(1, dtype).view(np.recarray)[0] for dtype in (laws.MOTION, laws.LAW_STATE))
    v_counts = np.arange(-12.0, 12.25, 0.25)
    slip = np.full(len(v_counts), np.nan)
    for i, value in enumerate(v_counts):
        motion.v_counts = value
        if abs(value) > band_counts:
            slip[i] = laws.karnopp(motion, law, state)
    motion.v_counts = 0.0
    load = np.linspace(-2 * F_s_Nm, 2 * F_s_Nm, 161)
    corrected, printed = np.zeros(len(load)), np.zeros(len(load))
    for i, value in enumerate(load):
        motion.x_rad = value / K_p_Nm_rad
        for function, out in ((laws.karnopp, corrected), (literal_karnopp, printed)):
            state.stuck, state.x_stuck = 1, 0.0
            out[i] = function(motion, law, state)
    cycles = 300
    rest = (count_rad, period_s, inertia_kg_m2, viscous_Nms_rad, cycles)
    return KarnoppStudy(
        F_s_Nm=F_s_Nm,
        F_d_Nm=F_d_Nm,
        band_rad_s=band_counts * count_rad / period_s,
        v_rad_s=v_counts * count_rad / period_s,
        slip_Nm=slip,
        load_Nm=load,
        corrected_Nm=corrected,
        printed_Nm=printed,
        t_s=np.arange(cycles, dtype=np.float64) * period_s,
        corrected_rad=_from_rest(laws.karnopp, law, *rest),
        printed_rad=_from_rest(literal_karnopp, law, *rest),
    )
