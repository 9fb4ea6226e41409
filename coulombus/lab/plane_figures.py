"""Figures of a display in the plane: the true force on the hand against the law's, along the true motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.plane.plane_laws import PlaneLaw
from coulombus.rigs.rig import Rig

__all__ = ["LEAST_M_S", "plane_figures"]

LEAST_M_S = 0.05
"""Speed above which the displayed force is compared with the law's."""

Floats = npt.NDArray[np.float64]


def plane_figures(rig: Rig, law: PlaneLaw, course: Mapping[str, Any], begin_s: float) -> dict[str, Any]:
    """Return how the displayed force differs from the law's while the schedule moves the tip.

    The law is evaluated along the true motion of the tip. Compared are the samples of lines, circles and
    figures of eight, without a circle's approach, where the tip is faster than `LEAST_M_S`.

    Parameters
    ----------
    course : the tip's true course (`sim_bus.network.virtual_rig.VirtualRig.tip_course`)
    begin_s : start of the schedule, in the time of the course

    Returns
    -------
    dict
        ``angle_error_deg`` (``median``, ``p95``), ``force_ratio`` (median of displayed over wanted) and
        ``force_ratio_p95`` (95th percentile of its deviation from 1); None without such samples
    """
    t_s = np.asarray(course["t_s"]) - begin_s
    x_m, v_m_s, shown_N = (_pair(course, name) for name in ("tip_{}_m", "tip_v{}_m_s", "shown_{}_N"))
    kept = np.hypot(*v_m_s.T) > LEAST_M_S
    kept &= _moving(rig, t_s)
    if not kept.any():
        return {
            "angle_error_deg": {"median": None, "p95": None},
            "force_ratio": None,
            "force_ratio_p95": None,
        }
    wanted_N = -law.along(t_s, x_m, v_m_s)[kept]
    shown_N = shown_N[kept]
    cross = shown_N[:, 0] * wanted_N[:, 1] - shown_N[:, 1] * wanted_N[:, 0]
    off_deg = np.degrees(np.arctan2(np.abs(cross), (shown_N * wanted_N).sum(axis=1)))
    ratio = np.hypot(*shown_N.T) / np.maximum(np.hypot(*wanted_N.T), np.finfo(float).tiny)
    return {
        "angle_error_deg": {"median": float(np.median(off_deg)), "p95": float(np.percentile(off_deg, 95))},
        "force_ratio": float(np.median(ratio)),
        "force_ratio_p95": float(np.percentile(np.abs(ratio - 1.0), 95)),
    }


def _pair(course: Mapping[str, Any], name: str) -> Floats:
    """Return two columns of the course as vectors, shape (n, 2)."""
    return np.stack([np.asarray(course[name.format(axis)], np.float64) for axis in "xy"], axis=1)


def _moving(rig: Rig, t_s: Floats) -> npt.NDArray[np.bool_]:
    """Return which times of the schedule belong to a motion of the tip."""
    axis = rig.axes[0]
    moving = np.zeros(len(t_s), bool)
    for phase, begin, end in zip(axis.phases, axis.phase_starts_s, axis.phase_starts_s[1:], strict=False):
        if phase.kind in ("tip_line", "tip_eight"):
            moving |= (t_s >= begin) & (t_s < end)
        elif phase.kind == "tip_circle":
            moving |= (t_s >= begin + phase.approach_s) & (t_s < end)
    return moving
