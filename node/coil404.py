"""Compiled supervision of the brake's coil: current limit, temperature, open and short circuit, remanence.

All checks use what the driver measures (current, temperature) and what it commands.

- The current is limited to 2010h:01; between the warning temperature 2011h:01 and the limit
  2011h:02 the remaining share falls linearly to 2011h:04. The brake's torque is proportional to
  its current, so `limit_Nm` bounds the torque.
- Above 2011h:02: over-temperature, until the coil has cooled by 2011h:03.
- Less than a quarter of the commanded current for 2010h:04, if the command
  is above 2010h:03: the coil is open.
- More current than 2010h:02: the coil has a short circuit.

An open coil can be detected only during a command, so both coil faults stay until a set-point of 0
arrives while the output is 0.

The demagnetisation pulse removes the iron's remanence: 2012h:03 after the output has reached 0, a
current 2012h:01 of the opposite sign flows for 2012h:02. A new set-point ends the pulse, a device
fault prevents it.

In the kernels: `n` the node's record (`node.record`).
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.node import emcy, slots404
from coulombus.node.record import NodeRecord

__all__ = ["demagnetise", "detect", "next_deadline", "start"]

_OPEN_SHARE = 0.25
_TEMPERATURE = 1 << emcy.OVER_TEMPERATURE - emcy.FIRST_DEVICE_CAUSE
_OPEN = 1 << emcy.COIL_OPEN - emcy.FIRST_DEVICE_CAUSE
_SHORT = 1 << emcy.COIL_SHORT - emcy.FIRST_DEVICE_CAUSE
_LOOK_NS = 10_000_000  # interval of the checks without a SYNC


@kernel
def start(n: NodeRecord) -> None:
    """Reset: no fault detected."""
    n.detected = 0
    n.open_since_ns = -1
    n.pulse_due = 0
    n.out_reverse_A = 0.0


@kernel
def detect(n: NodeRecord, t_ns: int) -> None:
    """Update `detected` and `limit_Nm` from the measurements.

    Almost always nothing changes.
    """
    measured = abs(n.in_coil_A)
    expected = n.out_brake_Nm * n.coil_A_Nm
    missing = expected > n.least_A and measured < _OPEN_SHARE * expected
    if (
        missing
        or measured > n.short_A
        or n.in_coil_degC > n.warm_degC
        or n.detected
        or n.derated
        or n.open_since_ns >= 0
    ):
        _judge_temperature(n)
        _judge_current(n, t_ns, missing, measured)


@kernel
def _judge_temperature(n: NodeRecord) -> None:
    temperature = n.in_coil_degC
    if temperature > n.hot_degC:
        n.detected |= _TEMPERATURE
    elif temperature < n.cooled_degC:
        n.detected &= ~_TEMPERATURE
    n.derated = 1 if temperature > n.warm_degC else 0
    share = 1.0
    if n.derated:
        way = (min(temperature, n.hot_degC) - n.warm_degC) / max(n.hot_degC - n.warm_degC, 0.1)
        share = 1.0 - (1.0 - n.share_left) * way
    limit_Nm = share * n.max_A / n.coil_A_Nm if n.coil_A_Nm > 0.0 else math.inf
    n.limit_Nm = min(limit_Nm, n.board_Nm) if n.board_Nm > 0.0 else limit_Nm


@kernel
def _judge_current(n: NodeRecord, t_ns: int, missing: bool, measured: float) -> None:
    if n.detected & (_OPEN | _SHORT):
        if n.ramping != 0 and n.out_brake_Nm == 0.0 and n.values[slots404.SETPOINT] <= 0:
            n.detected &= ~(_OPEN | _SHORT)
            n.open_since_ns = -1
        return
    if measured > n.short_A:
        n.detected |= _SHORT
    if not missing:
        n.open_since_ns = -1
    elif n.open_since_ns < 0:
        n.open_since_ns = t_ns
    elif t_ns - n.open_since_ns >= n.open_ns:
        n.detected |= _OPEN


@kernel
def demagnetise(n: NodeRecord, t_ns: int) -> None:
    """Set the current of the demagnetisation pulse when it is due."""
    n.out_reverse_A = 0.0
    if n.out_brake_Nm > 0.0:
        n.pulse_due = 1
        n.pulse_ns = t_ns + n.demag_delay_ns
        return
    if n.pulse_due == 0 or n.causes & emcy.DEVICE_MASK:
        return
    end_ns = n.pulse_ns + n.demag_ns
    if t_ns >= end_ns:
        n.pulse_due = 0
        return
    if t_ns >= n.pulse_ns:
        n.out_reverse_A = n.demag_A
    n.next_ns = min(n.next_ns, end_ns if t_ns >= n.pulse_ns else n.pulse_ns)


@kernel
def next_deadline(n: NodeRecord, t_ns: int, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the coil's next deadline: an edge of the pulse, or a check without
    a SYNC.
    """
    if n.demag_A > 0.0 and n.pulse_due and n.out_brake_Nm == 0.0 and n.causes & emcy.DEVICE_MASK == 0:
        edge = n.pulse_ns if t_ns < n.pulse_ns else n.pulse_ns + n.demag_ns
        next_ns = min(next_ns, max(edge, t_ns + 1))  # the pulse is over after the step at its end
    if n.open_since_ns >= 0 and n.detected & _OPEN == 0:
        end_ns = n.open_since_ns + n.open_ns
        next_ns = min(next_ns, end_ns if end_ns > t_ns else t_ns + _LOOK_NS)
    if n.coil_A_Nm > 0.0 and n.sync_armed == 0 and (n.out_brake_Nm > 0.0 or n.detected):
        next_ns = min(next_ns, t_ns + _LOOK_NS)
    return next_ns
