"""Figures of a display in the plane: the true force on the hand against the law's, along the true motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.host.laws.plane.plane_laws import PlaneLaw
from coulombus.rigs.rig import Rig

__all__ = ["LEAST_M_S", "TipSamples", "plane_figures", "tip_samples"]

LEAST_M_S = 0.05
"""Speed above which the displayed force is compared with the law's."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TipSamples:
    """Samples of a tip's true course, shape (n, 2) without the times.

    Attributes
    ----------
    t_s : from the start of the schedule
    x_m, v_m_s : position and velocity of the tip
    shown_N : force of motors, brakes and joints' friction on the hand
    wanted_N : the law's force on the hand along the true motion
    hand_N : force of the hand
    felt_N : force on the hand: displayed, and the inertia of the arm that the hand moves
    compared : shape (n,), whether displayed and desired force are compared: the schedule moves the tip along a line,
        a circle (without its approach) or a figure of eight, faster than `LEAST_M_S`
    """

    t_s: Floats
    x_m: Floats
    v_m_s: Floats
    shown_N: Floats
    wanted_N: Floats
    hand_N: Floats
    felt_N: Floats
    compared: npt.NDArray[np.bool_]

    @property
    def off_deg(self) -> Floats:
        """Return the angle between displayed and desired force of each sample [deg]."""
        return _angle_deg(self.shown_N, self.wanted_N)

    def errors(self, force_N: Floats) -> dict[str, Any]:
        """Return how a force differs from the desired one in the samples that are compared."""
        if not self.compared.any():
            return {"angle_error_deg": {"median": None, "p95": None}, "force_ratio": None, "force_ratio_p95": None}
        force_N, wanted_N = force_N[self.compared], self.wanted_N[self.compared]
        off_deg = _angle_deg(force_N, wanted_N)
        ratio = np.hypot(*force_N.T) / np.maximum(np.hypot(*wanted_N.T), np.finfo(float).tiny)
        return {
            "angle_error_deg": {"median": float(np.median(off_deg)), "p95": float(np.percentile(off_deg, 95))},
            "force_ratio": float(np.median(ratio)),
            "force_ratio_p95": float(np.percentile(np.abs(ratio - 1.0), 95)),
        }


def tip_samples(rig: Rig, law: PlaneLaw, course: Mapping[str, Any], begin_s: float) -> TipSamples:
    """Return the samples of a tip's true course, with the law's force along it.

    Parameters
    ----------
    course : the tip's true course (`sim_bus.network.virtual_rig.VirtualRig.tip_course`)
    begin_s : start of the schedule, in the time of the course
    """
    t_s = np.asarray(course["t_s"], np.float64) - begin_s
    names = ("tip_{}_m", "tip_v{}_m_s", "shown_{}_N", "hand_{}_N")
    x_m, v_m_s, shown_N, hand_N = (_pair(course, name) for name in names)
    compared = (np.hypot(*v_m_s.T) > LEAST_M_S) & _moving(rig, t_s)
    wanted_N = -law.along(t_s, x_m, v_m_s) if len(t_s) > 1 else np.zeros_like(x_m)
    assert rig.in_plane is not None
    assert rig.in_plane.plane is not None
    moving_N = rig.in_plane.plane.hand_mass_kg * np.gradient(v_m_s, t_s, axis=0) if len(t_s) > 1 else np.zeros_like(x_m)
    return TipSamples(t_s, x_m, v_m_s, shown_N, wanted_N, hand_N, moving_N - hand_N, compared)


def plane_figures(rig: Rig, law: PlaneLaw, course: Mapping[str, Any], begin_s: float) -> dict[str, Any]:
    """Return how the displayed force differs from the law's while the schedule moves the tip.

    The law is evaluated along the true motion of the tip, and the samples of `TipSamples.compared` count.

    Parameters
    ----------
    course : the tip's true course (`sim_bus.network.virtual_rig.VirtualRig.tip_course`)
    begin_s : start of the schedule, in the time of the course

    Returns
    -------
    dict
        ``angle_error_deg`` (``median``, ``p95``), ``force_ratio`` (median of displayed over wanted) and
        ``force_ratio_p95`` (95th percentile of its deviation from 1); None without such samples. ``felt`` has
        the same of the force on the hand, which also moves the arm's inertia
    """
    samples = tip_samples(rig, law, course, begin_s)
    return samples.errors(samples.shown_N) | {"felt": samples.errors(samples.felt_N)}


def _angle_deg(force_N: Floats, other_N: Floats) -> Floats:
    """Return the angles between two forces, shape (n,)."""
    cross = force_N[:, 0] * other_N[:, 1] - force_N[:, 1] * other_N[:, 0]
    return np.asarray(np.degrees(np.arctan2(np.abs(cross), (force_N * other_N).sum(axis=1))), np.float64)


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
