r"""The operator's muscle torque :math:`f_h(t)`: the schedule of a rig file as a function of time.

The hand's impedance belongs to the plant; this module gives its muscle torque. A hand whose target is
:math:`\theta_d(t)` drives its own impedance with

.. math:: f_h = K_o\,\theta_d + B_o\,\dot\theta_d,

and pushes, taps and tremor are added as torques. Time counts from the start of the schedule, the
instant at which the drive enters Operation Enabled; before it, and after the last phase, the hand
is at rest and only trembles. If the display ends in the middle of the schedule, the hand does not
fling the freed handle: its last torque fades within `LET_GO_S`.

The plant receives the torque at knots `KNOT_S` apart and interpolates linearly between them: the
torque is continuous, and deviates from a 9 Hz tremor by less than 0.05 % of its amplitude.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.rigs.axis import Axis
from coulombus.rigs.plant import Operator as Hand

__all__ = ["KNOT_S", "LET_GO_S", "Floats", "Operator", "drawn", "paper_force_N", "scheduled", "subject_draws"]

KNOT_S = 1e-3
LET_GO_S = 2.0
LATE_S = 0.1
"""Delay of a tap, for a population of 1: the normal spread."""
MOST_TAPS = 1000
SUBJECT = 0x68616E64
"""Separates the draws of a subject from other draws with the same seed."""

Floats: TypeAlias = npt.NDArray[np.float64]


def paper_force_N(t: Floats) -> Floats:
    """Return the paper's operator force f_h(t) [N] of section 4, `t` in s."""
    pi = np.pi
    force: Floats = 40 * np.sin(pi**2 / 4 * t) + np.sin(pi / 8 * t) + 2 * (1 - np.cos(pi / 2 * t))
    return force


def drawn(hand: Hand, seed: int) -> Hand:
    r"""Return the hand of the subject `seed` out of the population around `hand`.

    Inertia, damping, stiffness and tremor are each multiplied by :math:`e^{\sigma n}`, n normal, with
    :math:`\sigma` = ``population``: the rig file's hand is the median, and none is negative.
    Without a population every seed gives the rig file's hand.
    """
    if hand.population == 0.0:
        return hand
    names = ("inertia_kg_m2", "damping_Nms_rad", "stiffness_Nm_rad", "tremor_Nm")
    factors = np.exp(hand.population * subject_draws(seed).standard_normal(len(names)))
    return hand.model_copy(
        update={name: getattr(hand, name) * float(k) for name, k in zip(names, factors, strict=True)}
    )


def subject_draws(seed: int, what: int = 0) -> np.random.Generator:
    """Return a subject's random generator; `what` separates its draws."""
    return np.random.default_rng((SUBJECT, what, seed & 0xFFFFFFFFFFFFFFFF))


def scheduled(schedule: Callable[[Floats], Floats], t: Floats, start_s: float, end_s: float | None) -> Floats:
    """Return a schedule that began at `start_s` at the absolute times `t` [s]; ended early at `end_s`, its last
    value fades within `LET_GO_S`.
    """
    if end_s is None:
        return schedule(t - start_s)
    last = schedule(np.array([end_s - start_s]))
    fading: Floats = last * 0.5 * (1 + np.cos(np.pi * np.clip((t - end_s) / LET_GO_S, 0, 1)))
    return fading


class Operator:
    """Muscle torque of the operator of `axis`, as the subject `seed`; the mode `mode` sets the size of
    a push (share of F_s).

    In a population the tremor begins at a random phase, the strength of pushes and taps depends on
    the subject, and taps have a small delay.
    """

    def __init__(self, axis: Axis, mode: str, seed: int = 0) -> None:
        self._hand = drawn(axis.simulation.operator, seed)
        self._tremor_rad, self._push, self._tap = 0.0, 1.0, 1.0
        spread = self._hand.population
        self._late_s = np.zeros(MOST_TAPS)
        if spread > 0:
            self._late_s = LATE_S * spread * np.abs(subject_draws(seed, 3).standard_normal(MOST_TAPS))
            self._tremor_rad = 2 * np.pi * subject_draws(seed, 1).random()
            self._push, self._tap = np.exp(spread * subject_draws(seed, 2).standard_normal(2))
        self._phases = axis.phases
        self._F_s = axis.mode[mode].F_s_Nm
        self.starts_s = np.array(axis.phase_starts_s)

    def torque_Nm(self, t: Floats, start_s: float | None, end_s: float | None = None) -> Floats:
        r"""Return f_h [Nm] at the absolute times `t` [s] for a schedule that began at `start_s` (None:
        it has not), and ended early at `end_s`.

        .. math:: f_h(t) = f_h(t_e)\,\tfrac{1}{2}\left(1 + \cos\frac{\pi (t - t_e)}{T}\right), \quad t_e < t < t_e + T
        """
        return (
            self.tremor_Nm(t) if start_s is None else self.tremor_Nm(t) + scheduled(self.schedule_Nm, t, start_s, end_s)
        )

    def tremor_Nm(self, t: Floats) -> Floats:
        """Return the tremor [Nm] at the absolute times `t` [s]."""
        tremor: Floats = self._hand.tremor_Nm * np.sin(2 * np.pi * self._hand.tremor_Hz * t + self._tremor_rad)
        return tremor

    def schedule_Nm(self, t: Floats) -> Floats:
        """Return the schedule's torque [Nm] at the rising times `t` [s] since its start; 0 outside of it."""
        torque = np.zeros_like(t)
        hand = self._hand
        target = 0.0  # target of the hand at the start of a phase
        for phase, begin in zip(self._phases, self.starts_s[:-1], strict=True):
            rest = hand.stiffness_Nm_rad * target
            if phase.kind == "stroke":
                end, _ = _stroke(np.array([phase.duration_s]), phase.speed_rad_s, phase.move_s, phase.dwell_s)
                target += float(end[0])
            elif phase.kind == "motion":
                target += float(np.interp(phase.duration_s, phase.t_s, phase.x_rad))
            first, after = np.searchsorted(t, (begin, begin + phase.duration_s))
            if first == after:
                continue
            inside = slice(first, after)
            s = t[inside] - begin
            if phase.kind == "hold":
                push = self._push * phase.push_F_s * self._F_s * np.sin(2 * np.pi * phase.frequency_Hz * s)
                for k, at in enumerate(phase.taps_s):
                    tap = at + self._late_s[k]
                    push = push + self._tap * phase.tap_Nm * ((s >= tap) & (s < tap + phase.tap_s))
                torque[inside] = rest + push
            elif phase.kind == "stroke":
                angle, speed = _stroke(s, phase.speed_rad_s, phase.move_s, phase.dwell_s)
                torque[inside] = rest + hand.stiffness_Nm_rad * angle + hand.damping_Nms_rad * speed
            elif phase.kind == "paper":
                torque[inside] = rest + paper_force_N(s)
            elif phase.kind == "file":
                torque[inside] = rest + np.interp(s, phase.t_s, phase.torque_Nm)
            elif phase.kind == "motion":
                angle = np.interp(s, phase.t_s, phase.x_rad)
                moves = (s >= phase.t_s[0]) & (s < phase.t_s[-1])
                leg = np.clip(np.searchsorted(phase.t_s, s, "right") - 1, 0, len(phase.t_s) - 2)
                speed = moves * (np.diff(phase.x_rad) / np.diff(phase.t_s))[leg]
                torque[inside] = rest + hand.stiffness_Nm_rad * angle + hand.damping_Nms_rad * speed
            else:
                torque[inside] = rest
        return torque


def _stroke(s: Floats, speed: float, move_s: float, dwell_s: float) -> tuple[Floats, Floats]:
    """Return angle [rad] and speed [rad/s] of a stroke: forward, dwell, back, dwell, repeated."""
    period = move_s + dwell_s
    leg = np.floor(s / period)
    forward = leg % 2 == 0
    within = s - leg * period
    moved = np.minimum(within, move_s)
    start = np.where(forward, 0.0, move_s)
    sign = np.where(forward, 1.0, -1.0)
    return speed * (start + sign * moved), np.where(within < move_s, sign * speed, 0.0)
