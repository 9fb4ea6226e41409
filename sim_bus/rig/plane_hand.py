r"""The operator's muscle force on the tip in the plane: the schedule of a rig file as a function of time.

The hand's stiffness and damping belong to the plant (`sim_bus.rig.arm_plant`); this module gives its muscle
force. A hand whose target is :math:`x_d(t)` drives its own impedance, measured from the tip's start
:math:`x_0`, with

.. math:: f = K_o\,(x_d - x_0) + B_o\,\dot x_d,

and pushes, taps and tremor are added as forces. Everything else is as on one axis
(`sim_bus.rig.operator`).
"""

from __future__ import annotations

import numpy as np

from coulombus.rigs.kinematics.kinematics_section import PlanePlant
from coulombus.rigs.plant import Phase
from coulombus.rigs.rig import Rig
from coulombus.sim_bus.rig.operator import Floats, scheduled, subject_draws

__all__ = ["PlaneHand", "drawn_hand"]

PARTS = 4
"""Quantities of a hand that a population spreads: mass, damping, stiffness, tremor."""


def drawn_hand(hand: PlanePlant, seed: int) -> PlanePlant:
    r"""Return the hand of the subject `seed` out of the population around `hand`.

    Mass, damping, stiffness and tremor are each multiplied by :math:`e^{\sigma n}`, n normal, with
    :math:`\sigma` = ``hand_population``; both directions alike.
    """
    if hand.hand_population == 0.0:
        return hand
    mass, damping, stiffness, tremor = np.exp(hand.hand_population * subject_draws(seed).standard_normal(PARTS))
    return hand.model_copy(
        update={
            "hand_mass_kg": hand.hand_mass_kg * float(mass),
            "hand_damping_Ns_m": tuple(float(damping) * value for value in hand.hand_damping_Ns_m),
            "hand_stiffness_N_m": tuple(float(stiffness) * value for value in hand.hand_stiffness_N_m),
            "hand_tremor_N": hand.hand_tremor_N * float(tremor),
        }
    )


class PlaneHand:
    """Muscle force of the operator of a rig in the plane along one direction.

    Parameters
    ----------
    rig : with [plane]
    static_N : the law's static friction; the size of a push is a share of it
    direction : 0: along x, 1: along y
    seed : the subject of a population
    """

    def __init__(self, rig: Rig, static_N: float, direction: int, seed: int = 0) -> None:
        assert rig.in_plane is not None
        assert rig.in_plane.plane is not None
        self._hand = drawn_hand(rig.in_plane.plane, seed)
        self._push, self._tremor_rad = 1.0, 0.5 * np.pi * direction
        if self._hand.hand_population > 0:
            self._push = float(np.exp(self._hand.hand_population * subject_draws(seed, 2).standard_normal()))
            self._tremor_rad += 2 * np.pi * subject_draws(seed, 1).random()
        self._phases, self._static_N, self._direction = rig.axes[0].phases, static_N, direction
        self.starts_s = np.array(rig.axes[0].phase_starts_s)

    def torque_Nm(self, t: Floats, start_s: float | None, end_s: float | None = None) -> Floats:
        """Return the force [N] at the absolute times `t` [s], like `sim_bus.rig.operator.Operator.torque_Nm`."""
        tremor: Floats = self._hand.hand_tremor_N * np.sin(2 * np.pi * self._hand.hand_tremor_Hz * t + self._tremor_rad)
        return tremor if start_s is None else tremor + scheduled(self.schedule_N, t, start_s, end_s)

    def schedule_N(self, t: Floats) -> Floats:
        """Return the schedule's force [N] at the rising times `t` [s] since its start; before it 0, and after
        it that of the last target.
        """
        force = np.zeros_like(t)
        d = self._direction
        stiffness, damping = self._hand.hand_stiffness_N_m[d], self._hand.hand_damping_Ns_m[d]
        target = 0.0  # at the start of a phase, from the tip's start [m]
        for phase, begin in zip(self._phases, self.starts_s[:-1], strict=True):
            first, after = np.searchsorted(t, (begin, begin + phase.duration_s))
            s = t[first:after] - begin
            if phase.kind == "tip_hold":
                force[first:after] = stiffness * target + self._pushed(phase, s)
            else:
                way, speed = _way(phase, s, d)
                force[first:after] = stiffness * (target + way) + damping * speed
                target += float(_way(phase, np.array([phase.duration_s]), d)[0][0])
        force[t >= self.starts_s[-1]] = stiffness * target
        return force

    def _pushed(self, phase: Phase, s: Floats) -> Floats:
        """Return push and taps of a hold along the hand's direction [N]."""
        assert phase.kind == "tip_hold"
        push: Floats = self._push * phase.push_F_s * self._static_N * np.sin(2 * np.pi * phase.frequency_Hz * s)
        for at in phase.taps_s:
            push = push + phase.tap_N * ((s >= at) & (s < at + phase.tap_s))
        return push * _share(phase.direction_rad, self._direction)


def _share(angle_rad: float, direction: int) -> float:
    """Return the part of a unit vector along x (0) or y (1)."""
    return float(np.cos(angle_rad) if direction == 0 else np.sin(angle_rad))


def _way(phase: Phase, s: Floats, direction: int) -> tuple[Floats, Floats]:
    """Return a phase's target from its start [m] and its speed [m/s] along a direction, at the times `s` [s]."""
    if phase.kind == "tip_line":
        share = _share(phase.direction_rad, direction)
        w = 2 * np.pi * phase.frequency_Hz
        return share * 0.5 * phase.length_m * (1 - np.cos(w * s)), share * 0.5 * phase.length_m * w * np.sin(w * s)
    if phase.kind == "tip_eight":
        w = 2 * np.pi * phase.frequency_Hz
        if direction == 0:
            return 0.5 * phase.width_m * np.sin(w * s), 0.5 * phase.width_m * w * np.cos(w * s)
        return 0.5 * phase.height_m * np.sin(2 * w * s), phase.height_m * w * np.cos(2 * w * s)
    if phase.kind == "tip_circle":
        out = np.clip(s / phase.approach_s, 0.0, 1.0)
        radius: Floats = phase.radius_m * out**2 * (3 - 2 * out)
        turning = 2 * np.pi * phase.frequency_Hz * (s >= phase.approach_s)
        angle = phase.direction_rad - (0.5 * np.pi if direction == 1 else 0.0) + turning * (s - phase.approach_s)
        growing = 6 * phase.radius_m / phase.approach_s * out * (1 - out)
        return radius * np.cos(angle), growing * np.cos(angle) - radius * turning * np.sin(angle)
    return np.zeros_like(s), np.zeros_like(s)
