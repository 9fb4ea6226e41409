"""What a kind of device does when the communication side calls it, compiled: one place that knows the kinds."""

from __future__ import annotations

from typing import Any

from coulombus.compiled.decorator import kernel
from coulombus.node import brake404, coil404, emcy, states402
from coulombus.node.record import KIND_BRAKE, KIND_DRIVE

__all__ = [
    "CARRIES_CONTROLWORD",
    "CARRIES_SETPOINT",
    "CARRIES_SPEED",
    "alarm",
    "apply",
    "connection_lost",
    "inputs",
    "next_deadline",
    "react",
    "sample",
    "step",
]

CARRIES_CONTROLWORD, CARRIES_SETPOINT, CARRIES_SPEED = 1, 2, 4
"""Bits of the record's `rpdo_carries`, and of what was written over SDO."""

_INPUT_CAUSES = emcy.DEVICE_MASK | 1 << emcy.SUPPLY


@kernel
def sample(n: Any) -> None:
    """Bring what the device measures, and its statusword, to the slots."""
    if n.kind == KIND_DRIVE:
        states402.sample(n)
    elif n.kind == KIND_BRAKE:
        brake404.sample(n)


@kernel
def step(n: Any, t_ns: int) -> None:
    """Compute the output that acts at `t_ns`."""
    if n.kind == KIND_DRIVE:
        states402.step(n, t_ns)
    elif n.kind == KIND_BRAKE:
        brake404.step(n, t_ns)
        if n.demag_A > 0.0:
            coil404.demagnetise(n, t_ns)
    if n.ramping == 1:
        n.next_ns = min(n.next_ns, t_ns + RAMP_STEP_NS)


@kernel
def apply(n: Any, t_ns: int, received_ns: int, carries: int, out: Any) -> None:
    """Act on the controlword or the set-point that now stand in their slots; it was received at `received_ns`."""
    if n.kind == KIND_DRIVE:
        if carries & CARRIES_SETPOINT:
            states402.new_setpoint(n, received_ns, False)
        if carries & CARRIES_SPEED:
            states402.new_setpoint(n, received_ns, True)
        if carries & CARRIES_CONTROLWORD:
            states402.new_controlword(n, t_ns, out)
    elif n.kind == KIND_BRAKE and carries & CARRIES_SETPOINT:
        brake404.new_setpoint(n, received_ns)


RAMP_STEP_NS = 1_000_000
"""How often a ramp is computed when nothing else calls."""

BY_COMMAND, BY_RESET, BY_ITSELF = 0, 1, 2
"""Why NMT left OPERATIONAL: a command, a reset (safe output whatever the option codes say), 1029h."""


@kernel
def connection_lost(n: Any, t_ns: int, why: int, out: Any) -> None:
    """NMT left OPERATIONAL: safe output."""
    forced = 1 if why == BY_RESET else 0
    if n.kind == KIND_DRIVE:
        if states402.connection_lost(n, t_ns, forced):
            alarm(n, t_ns, emcy.CONNECTION, 0, out)
            n.causes &= ~(1 << emcy.CONNECTION)  # an event, not a condition
    elif n.kind == KIND_BRAKE:
        if why == BY_ITSELF:
            brake404.host_lost(n, t_ns)
        else:
            brake404.connection_lost(n, t_ns, forced)


@kernel
def alarm(n: Any, t_ns: int, cause: int, info: int, out: Any) -> None:
    """Tell of a cause by EMCY, and react: a drive's fault gives torque 0, a brake's own fault the ramp."""
    emcy.come(n, t_ns, cause, info, out)
    react(n, t_ns, cause)


@kernel
def react(n: Any, t_ns: int, cause: int) -> None:
    """Make the output safe where a cause asks for it."""
    if n.kind == KIND_DRIVE and emcy.FAULT_MASK >> cause & 1:
        states402.fault(n, t_ns, bool(emcy.AT_ONCE_MASK >> cause & 1))
    elif n.kind == KIND_BRAKE and emcy.DEVICE_MASK >> cause & 1:
        if cause == emcy.COIL_SHORT:
            brake404.cut(n)
        else:
            brake404.connection_lost(n, t_ns, 1)


@kernel
def inputs(n: Any, t_ns: int, out: Any) -> None:
    """Look at the supply and at the device's own faults; almost always there is nothing new."""
    if n.kind == KIND_BRAKE:
        coil404.watch(n, t_ns)
    present = (n.in_faults | n.detected) << emcy.FIRST_DEVICE_CAUSE
    if present != n.causes & _INPUT_CAUSES or n.in_supply_ok == 0:
        _new_inputs(n, t_ns, present, out)


@kernel
def _new_inputs(n: Any, t_ns: int, present: int, out: Any) -> None:
    supply_lost = n.kind == KIND_DRIVE and n.in_supply_ok == 0
    if supply_lost:
        if states402.needs_supply(n):
            alarm(n, t_ns, emcy.SUPPLY, 0, out)
    elif n.causes >> emcy.SUPPLY & 1:
        emcy.gone(n, t_ns, emcy.SUPPLY, out)
    for cause in range(emcy.FIRST_DEVICE_CAUSE, emcy.DEVICE_CAUSES_END):
        before, now = n.causes >> cause & 1, present >> cause & 1
        if now and not before:
            alarm(n, t_ns, cause, 0, out)
        elif before and not now:
            emcy.gone(n, t_ns, cause, out)


@kernel
def next_deadline(n: Any, t_ns: int, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the device's own next deadline."""
    if n.ramping == 1:
        next_ns = min(next_ns, t_ns + RAMP_STEP_NS)
    if n.kind == KIND_DRIVE:
        return states402.next_deadline(n, next_ns)
    if n.kind == KIND_BRAKE:
        return brake404.next_deadline(n, t_ns, next_ns)
    return next_ns
