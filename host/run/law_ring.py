"""The force of a law in the plane at a steady speed, over the directions of motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.plane.plane_laws import PlaneLaw
from coulombus.host.plane.plane_host import load_plane
from coulombus.host.run.law_curve import Line
from coulombus.rigs.rig import Rig

__all__ = ["DIRECTIONS", "law_ring"]

DIRECTIONS = 72
SPEED_M_S, FASTER_M_S = 0.05, 0.2
SECONDS, STEP_S = 0.4, 2e-3
AWAY_M = (0.37, -0.23)
"""Another place of the plane: a law that differs there depends on the position."""
SAME = 0.02
"""Largest variation of a law with a ring, as a share of its largest force."""


def law_ring(rig: Rig, mode: str, live: Mapping[str, float]) -> Line | None:
    """Return the force on the hand at steady motion in `DIRECTIONS` directions, x and y [N].

    None for a law whose force depends on the speed or the position, and for a rig of independent axes.

    Parameters
    ----------
    live : values of live parameters by name; others have the rig file's values

    Raises
    ------
    coulombus.rigs.rig.RigError, coulombus.host.laws.laws.LawError
        the law cannot be loaded, or returned a number that is not finite
    """
    model = load_plane(rig, mode)
    if model is None:
        return None
    law = _changed(model.law, live)
    angles = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    slow = np.array([_steady(law, angle, SPEED_M_S) for angle in angles])
    negligible_N = SAME * float(np.abs(slow).max())
    for k in range(0, DIRECTIONS, DIRECTIONS // 8):
        faster = _steady(law, angles[k], FASTER_M_S)
        away = _steady(law, angles[k], SPEED_M_S, AWAY_M)
        if max(np.abs(faster - slow[k]).max(), np.abs(away - slow[k]).max()) > negligible_N:
            return None
    x, y = (-slow).T.tolist()
    return tuple(x), tuple(y)


def _changed(law: PlaneLaw, live: Mapping[str, float]) -> PlaneLaw:
    """Return the law with the present values of its live parameters."""
    if law.parameters is None:
        return law
    update = {name: value for name, value in live.items() if name in type(law.parameters).model_fields}
    return replace(law, parameters=law.parameters.model_copy(update=update))


def _steady(
    law: PlaneLaw, angle: float, speed_m_s: float, from_m: tuple[float, float] = (0.0, 0.0)
) -> npt.NDArray[np.float64]:
    """Return the friction at the end of a steady motion [N], positive against it."""
    t_s = np.arange(round(SECONDS / STEP_S) + 1) * STEP_S
    way = np.outer(speed_m_s * t_s, (math.cos(angle), math.sin(angle)))
    force: npt.NDArray[np.float64] = law.along(t_s, np.array(from_m) + way)[-1]
    return force
