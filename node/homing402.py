"""Compiled homing of a CiA 402 drive (mode 6): the axis finds its home position by switches and index.

The axis searches an *edge* of a switch and passes it in a direction; the home position is the place
of the edge, or that of the next index in this direction (methods 1 to 14):

    method       switch            edge    passed    begins, while the switch is off
    1, 17        negative limit    right   to +      to -
    2, 18        positive limit    left    to -      to +
    3, 19        home              left    to -      to +
    4, 20        home              left    to +      to +
    5, 21        home              right   to +      to -
    6, 22        home              right   to -      to -
    7 to 10      home              left -, left +, right -, right +; to +, and turns at the positive limit switch
    11 to 14     home              right +, right -, left +, left -; to -, and turns at the negative limit switch
    33, 34       none              the next index to -, to +
    35, 37       none              the present position

23 to 30 are 7 to 14 without index. An axis that begins on the switch leaves it across the edge of
the method. It searches with 6099h:01, and with 6099h:02 after the edge, by 609Ah. It ends on the
home position, where 6064h is 607Ch. A limit switch in the way, a speed of 0, and a search of more
than a minute are errors.

In the kernels: `n` the node's record (`node.record`).
"""

from __future__ import annotations

import numpy as np

from coulombus.kernels.decorator import constant, kernel
from coulombus.node import axis402, position402, slots402, trapezoid
from coulombus.node.axis402 import HOME, NEGATIVE, POSITIVE
from coulombus.node.motion402 import HOMED
from coulombus.node.record import NodeRecord

__all__ = ["METHODS", "actuate", "new_controlword", "status_bits"]

_IDLE, _SEARCH, _ZERO, _INDEX, _APPROACH, _FAILED = 0, 1, 2, 3, 4, 6
"""Stages: before the edge, back to the edge, to the index, to the home position."""

_LEFT, _RIGHT = 1, -1
_BY_EDGE = (
    (1, NEGATIVE, _RIGHT, 1, -1, 0),
    (2, POSITIVE, _LEFT, -1, 1, 0),
    (3, HOME, _LEFT, -1, 1, 0),
    (4, HOME, _LEFT, 1, 1, 0),
    (5, HOME, _RIGHT, 1, -1, 0),
    (6, HOME, _RIGHT, -1, -1, 0),
    (7, HOME, _LEFT, -1, 1, POSITIVE),
    (8, HOME, _LEFT, 1, 1, POSITIVE),
    (9, HOME, _RIGHT, -1, 1, POSITIVE),
    (10, HOME, _RIGHT, 1, 1, POSITIVE),
    (11, HOME, _RIGHT, 1, -1, NEGATIVE),
    (12, HOME, _RIGHT, -1, -1, NEGATIVE),
    (13, HOME, _LEFT, 1, -1, NEGATIVE),
    (14, HOME, _LEFT, -1, -1, NEGATIVE),
)
"""Method, switch, edge, direction across it, initial direction, limit switch at which it turns."""
_WITHOUT_INDEX = 16  # added to a method's number
_INDEX_DOWN, _INDEX_UP, _HERE_BEFORE, _HERE = 33, 34, 35, 37

METHODS = (
    0,
    *(row[0] for row in _BY_EDGE),
    *(row[0] + _WITHOUT_INDEX for row in _BY_EDGE),
    *(_INDEX_DOWN, _INDEX_UP, _HERE_BEFORE, _HERE),
)
"""Allowed values of 6098h; 0: none, which cannot be started."""


def _table() -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    table = np.zeros((_HERE + 1, 5), np.int64)
    for method, *row in _BY_EDGE:
        table[method] = table[method + _WITHOUT_INDEX] = row
    return table


_SWITCH, _EDGE, _ACROSS, _FIRST, _TURNS = range(5)
_METHOD = _table()

_START, _HALT = 0x10, 0x100
_TARGET_REACHED, _ATTAINED, _ERROR = 0x0400, 0x1000, 0x2000
_FAR_COUNTS = 1e12
_LONGEST_NS = 60_000_000_000
_FAST, _SLOW = constant(slots402.HOMING_SPEED), constant(slots402.HOMING_ZERO_SPEED)


@kernel
def _running(n: NodeRecord) -> bool:
    return bool(_SEARCH <= n.homing <= _APPROACH)


@kernel
def _speed(n: NodeRecord, slot: int) -> float:
    return float(min(n.values[slot] * n.unit_counts_s, position402.fastest(n)))


@kernel
def _acceleration(n: NodeRecord) -> float:
    rate = n.values[slots402.HOMING_ACCELERATION]
    up, down = position402.accelerations(n, rate, rate)
    return float(min(up, down))


@kernel
def _run(n: NodeRecord, t_ns: int, direction: float, slot: int) -> None:
    """Run in a direction at the speed in `slot`."""
    rate = _acceleration(n)
    n.homing_direction = direction
    target = n.position_demand + direction * _FAR_COUNTS
    trapezoid.move(n, t_ns, target, 0.0, _speed(n, slot), rate, rate)


@kernel
def _stop(n: NodeRecord, t_ns: int, stage: int) -> None:
    trapezoid.rest(n, t_ns, _acceleration(n))
    n.homing = stage


@kernel
def new_controlword(n: NodeRecord, t_ns: int, before: int) -> None:
    """Start with the rising edge of bit 4; its end, and halt, interrupt the homing."""
    trapezoid.evaluate(n, t_ns)
    if n.controlword & _HALT or not n.controlword & _START:
        if _running(n):
            _stop(n, t_ns, _IDLE)
    elif not before & _START:
        _start(n, t_ns)


@kernel
def _start(n: NodeRecord, t_ns: int) -> None:
    method = n.values[slots402.HOMING_METHOD]
    place = float(n.in_position_counts)
    n.homing_ns, n.homing_counts, n.homing_inputs = t_ns, place, axis402.inputs(n, place)
    if method in (_HERE_BEFORE, _HERE):
        n.home_counts = place
        _attain(n, t_ns)
        return
    if method <= 0 or method > _HERE or min(_speed(n, _FAST), _speed(n, _SLOW)) <= 0.0:
        _stop(n, t_ns, _FAILED)
    elif method in (_INDEX_DOWN, _INDEX_UP):
        _to_index(n, t_ns, place, 1.0 if method == _INDEX_UP else -1.0)
    elif _METHOD[method, _SWITCH] == 0:
        _stop(n, t_ns, _FAILED)
    else:
        on_it = n.homing_inputs & _METHOD[method, _SWITCH]
        n.homing = _SEARCH
        _run(n, t_ns, float(-_METHOD[method, _EDGE] if on_it else _METHOD[method, _FIRST]), _FAST)


@kernel
def _to_index(n: NodeRecord, t_ns: int, place: float, direction: float) -> None:
    n.home_counts = axis402.next_index(n, place, direction)
    n.homing = _INDEX
    _run(n, t_ns, direction, _SLOW)


@kernel
def _approach(n: NodeRecord, t_ns: int) -> None:
    n.homing = _APPROACH
    rate = _acceleration(n)
    n.target_counts = n.home_counts
    trapezoid.move(n, t_ns, n.home_counts, 0.0, _speed(n, _SLOW), rate, rate)


@kernel
def _attain(n: NodeRecord, t_ns: int) -> None:
    n.zero_counts = int(np.floor(n.home_counts + 0.5)) - n.values[slots402.HOME_OFFSET]
    n.homing = HOMED


@kernel
def _edge_place(n: NodeRecord, method: int) -> float:
    """Return the place of the method's edge."""
    switch = _METHOD[method, _SWITCH]
    k = 0 if switch == NEGATIVE else 3 if switch == POSITIVE else 1 if _METHOD[method, _EDGE] == _LEFT else 2
    return float(n.switch_counts[k])


@kernel
def _continue_search(n: NodeRecord, t_ns: int) -> None:
    """Go on with the search after the axis has moved."""
    place = float(n.in_position_counts)
    bits, before = axis402.inputs(n, place), n.homing_inputs
    moved = 1 if place > n.homing_counts else -1
    n.homing_inputs, n.homing_counts = bits, place
    method = n.values[slots402.HOMING_METHOD]
    if n.homing == _INDEX or not 0 <= method <= _HERE:  # an RPDO may have written another one meanwhile
        method = 0
    switch = _METHOD[method, _SWITCH]
    limit = (NEGATIVE if n.homing_direction < 0.0 else POSITIVE) & ~switch
    if bits & limit:
        if n.homing == _SEARCH and limit == _METHOD[method, _TURNS]:
            _run(n, t_ns, -n.homing_direction, _FAST)
        else:
            _stop(n, t_ns, _FAILED)
        return
    if n.homing == _INDEX:
        if (place - n.home_counts) * n.homing_direction >= 0.0:
            _approach(n, t_ns)
        return
    if (bits ^ before) & switch == 0:
        return
    edge = moved if bits & switch else -moved
    if edge != _METHOD[method, _EDGE]:
        return
    across = _METHOD[method, _ACROSS]
    if moved != across:
        n.homing = _ZERO
        _run(n, t_ns, float(across), _SLOW)
    elif method > _WITHOUT_INDEX:
        n.home_counts = _edge_place(n, method)
        _approach(n, t_ns)
    else:
        _to_index(n, t_ns, _edge_place(n, method), float(across))


@kernel
def actuate(n: NodeRecord, t_ns: int, elapsed_ns: int) -> None:
    """Compute the torque at `t_ns` in Operation Enabled."""
    trapezoid.evaluate(n, t_ns)
    if _running(n) and t_ns - n.homing_ns >= _LONGEST_NS:
        _stop(n, t_ns, _FAILED)
    elif _SEARCH <= n.homing <= _INDEX:
        _continue_search(n, t_ns)
    position402.control(n, t_ns, elapsed_ns)
    if n.homing == _APPROACH and position402.arrived(n):
        _attain(n, t_ns)


@kernel
def status_bits(n: NodeRecord) -> int:
    """Return bits 10, 12 and 13 of the statusword in Operation Enabled."""
    if _running(n):
        return 0
    if n.homing == HOMED:
        return _TARGET_REACHED | _ATTAINED
    bits = _ERROR if n.homing == _FAILED or n.following_lost else 0
    return bits | (_TARGET_REACHED if n.demand_ns >= n.profile_end_ns else 0)
