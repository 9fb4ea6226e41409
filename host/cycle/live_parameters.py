r"""Live parameters, compiled: values of the law and of the compensation that change during a run.

A change is an order: a full record of target values, and the duration of the transition in cycles. The
writer fills the idle buffer, then publishes the order's number in ``wanted``. The step reads that number
at the beginning of a cycle, so an order takes effect between two cycles, as a whole. From the present
values :math:`p_0` each parameter follows a straight line,

.. math:: p(k) = p_0 + (p_1 - p_0)\, k / n, \qquad k = 1 \dots n,

and is exactly :math:`p_1` in the last cycle. Without an order nothing is computed here.
"""

from __future__ import annotations

from typing import Any

from coulombus.host.cycle.records import SLOTS, AxisRecord, LiveRecord, Phase, Slot
from coulombus.kernels.decorator import kernel

__all__ = ["follow", "offer"]


def offer(live: LiveRecord, number: int, values: Any, cycles: int) -> None:
    """Write order `number` into its buffer; it takes effect when `number` is in ``wanted``."""
    order = live.offered[number & 1]
    order.value[:] = values
    order.cycles = cycles


@kernel
def _begin_transition(axis: AxisRecord) -> None:
    """Begin the transition from the present values to the newest order."""
    live, law = axis.live, axis.law
    order = live.offered[live.wanted & 1]
    live.first[Slot.K_P] = law.K_p
    live.first[Slot.F_S] = law.F_s
    live.first[Slot.F_D] = law.F_d
    live.first[Slot.COMPENSATION] = axis.control.compensation_Nm
    for k in range(SLOTS - Slot.USER):
        live.first[Slot.USER + k] = law.user[k]
    for k in range(SLOTS):
        live.last[k] = order.value[k]
    live.cycle = 0
    live.cycles = max(order.cycles, 1)
    live.taken = live.wanted


@kernel
def _at(live: LiveRecord, slot: int) -> float:
    """Return a parameter's value in the present cycle of the transition."""
    if live.cycle >= live.cycles:
        return float(live.last[slot])
    return float(live.first[slot] + (live.last[slot] - live.first[slot]) * (live.cycle / live.cycles))


@kernel
def follow(axis: AxisRecord) -> None:
    """Advance the transition to the newest order by one cycle.

    While the handle is stuck, a change of K_p keeps the force: :math:`x_{stuck}` is shifted.
    """
    live, law, state = axis.live, axis.law, axis.state
    if live.wanted != live.taken:
        _begin_transition(axis)
    if live.cycle >= live.cycles:
        return
    live.cycle += 1
    K_p = _at(live, Slot.K_P)
    if K_p != law.K_p:
        if state.stuck != 0 and axis.host.phase == Phase.RUN:
            x = axis.motion.x_rad
            state.x_stuck = x - (x - state.x_stuck) * (law.K_p / K_p)
        law.K_p = K_p
    law.F_s = _at(live, Slot.F_S)
    law.F_d = _at(live, Slot.F_D)
    axis.control.compensation_Nm = _at(live, Slot.COMPENSATION)
    for k in range(SLOTS - Slot.USER):
        law.user[k] = _at(live, Slot.USER + k)
