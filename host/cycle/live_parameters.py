r"""Live parameters, compiled: values of a law and of the compensation that change while it runs.

A change is an order: a whole record of values, and the number of cycles in which the axis goes
there. Whoever asks writes it into the buffer that the step does not use, and then its number into
``wanted``. The step looks at that number when a cycle begins, so an order takes effect between two
cycles, whole. From the values :math:`p_0` of that moment each goes on a straight line,

.. math:: p(k) = p_0 + (p_1 - p_0)\, k / n, \qquad k = 1 \dots n,

and the last cycle has :math:`p_1` itself. A run that never gets an order computes nothing here.
"""

from __future__ import annotations

from typing import Any

from coulombus.host.cycle.records import SLOTS, AxisRecord, LiveRecord, Phase, Slot
from coulombus.kernels.decorator import kernel

__all__ = ["follow", "offer"]


def offer(live: LiveRecord, number: int, values: Any, cycles: int) -> None:
    """Write order `number` into its buffer; it counts when `number` is in ``wanted``."""
    order = live.offered[number & 1]
    order.value[:] = values
    order.cycles = cycles


@kernel
def _take(axis: AxisRecord) -> None:
    """Begin to follow the order that is wanted, from the values of now on."""
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
    """Return a value on its way."""
    if live.cycle >= live.cycles:
        return float(live.last[slot])
    return float(live.first[slot] + (live.last[slot] - live.first[slot]) * (live.cycle / live.cycles))


@kernel
def follow(axis: AxisRecord) -> None:
    """Go on by a cycle towards the order that is wanted.

    While the handle is stuck, another K_p keeps the force: :math:`x_{stuck}` moves with it.
    """
    live, law, state = axis.live, axis.law, axis.state
    if live.wanted != live.taken:
        _take(axis)
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
