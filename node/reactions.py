"""Compiled calls from a device's communication side to the kernels of its kind (`node.kinds`).

Each of these loops is unrolled: the machine code has one branch for each kind, as if the kinds were
written out here.

In the kernels: `n` the node's record (`node.record`), `out` the queue of frames to send.
"""

from __future__ import annotations

from numba import literal_unroll

from coulombus.kernels.decorator import kernel
from coulombus.node import emcy
from coulombus.node.kinds import BEHAVIOURS
from coulombus.node.profile import SUPPLY_LOST, SUPPLY_THERE
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue

__all__ = [
    "RAMP_STEP_NS",
    "actuate",
    "alarm",
    "apply",
    "connection_lost",
    "inputs",
    "measure",
    "next_deadline",
    "react",
    "sample",
]

RAMP_STEP_NS = 1_000_000
"""Interval at which a ramp is computed without other calls."""

_INPUT_CAUSES = emcy.DEVICE_MASK | 1 << emcy.SUPPLY


@kernel
def sample(n: NodeRecord) -> None:
    """Write the device's measurements, and its statusword, to the slots."""
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            kind.sample(n)


@kernel
def actuate(n: NodeRecord, t_ns: int) -> None:
    """Compute the output at `t_ns`."""
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            kind.actuate(n, t_ns)
    if n.ramping == 1:
        n.next_ns = min(n.next_ns, t_ns + RAMP_STEP_NS)


@kernel
def measure(n: NodeRecord, t_ns: int) -> None:
    """Update the values that a client reads.

    A ramp and a control loop have a cycle of their own, `RAMP_STEP_NS`, so that a reading does not change them.
    """
    if n.ramping != 1:
        actuate(n, t_ns)
    sample(n)


@kernel
def apply(n: NodeRecord, t_ns: int, received_ns: int, carries: int, out: Queue) -> None:
    """Act on the present slots as `carries` tells (`Profile.acts`); they were received at `received_ns`."""
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            kind.apply(n, t_ns, received_ns, carries, out)


@kernel
def connection_lost(n: NodeRecord, t_ns: int, why: int, out: Queue) -> None:
    """Make the output safe after NMT left OPERATIONAL (`why`: BY_... of `node.profile`)."""
    fault = 0
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            fault = kind.connection_lost(n, t_ns, why)
    if fault:
        alarm(n, t_ns, emcy.CONNECTION, emcy.NO_INFO, out)
        n.causes &= ~(1 << emcy.CONNECTION)  # an event, not a condition


@kernel
def alarm(n: NodeRecord, t_ns: int, cause: int, info: int, out: Queue) -> None:
    """Report a cause by EMCY, and react: a drive's fault gives torque 0, a brake's own fault the ramp."""
    emcy.come(n, t_ns, cause, info, out)
    react(n, t_ns, cause)


@kernel
def react(n: NodeRecord, t_ns: int, cause: int) -> None:
    """Make the output safe if a cause requires it."""
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            kind.react(n, t_ns, cause)


@kernel
def inputs(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Check the supply and the device faults; almost always nothing has changed."""
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            kind.detect(n, t_ns)
    present = (n.in_faults | n.detected) << emcy.FIRST_DEVICE_CAUSE
    if present != n.causes & _INPUT_CAUSES or n.in_supply_ok == 0:
        _new_inputs(n, t_ns, present, out)


@kernel
def _new_inputs(n: NodeRecord, t_ns: int, present: int, out: Queue) -> None:
    supply = SUPPLY_THERE
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            supply = kind.supply(n)
    if supply == SUPPLY_LOST:
        alarm(n, t_ns, emcy.SUPPLY, emcy.NO_INFO, out)
    elif supply == SUPPLY_THERE and n.causes >> emcy.SUPPLY & 1:
        emcy.gone(n, t_ns, emcy.SUPPLY, out)
    for cause in range(emcy.FIRST_DEVICE_CAUSE, emcy.DEVICE_CAUSES_END):
        before, now = n.causes >> cause & 1, present >> cause & 1
        if now and not before:
            alarm(n, t_ns, cause, emcy.NO_INFO, out)
        elif before and not now:
            emcy.gone(n, t_ns, cause, out)


@kernel
def next_deadline(n: NodeRecord, t_ns: int, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the device's own next deadline."""
    if n.ramping == 1:
        next_ns = min(next_ns, t_ns + RAMP_STEP_NS)
    for kind in literal_unroll(BEHAVIOURS):
        if n.kind == kind.number:
            next_ns = kind.next_deadline(n, t_ns, next_ns)
    return next_ns
