"""A clock that runs fast or slow, compiled: a station's own time, in which all of its timers are.

A record with the fields of `Clock` has a time of its own since
`clock_from_ns` of the bus, when it was `clock_at_ns`::

    own = clock_at_ns + floor((bus - clock_from_ns) * (1 + ppb / 1e9))

in int64 without loss. `bus_ns` is the first instant of the bus at which an own time is reached.
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import Record
from coulombus.wire.frame import Queue

__all__ = ["NEVER_NS", "Clock", "bus_ns", "own_ns", "set_clock", "to_bus"]

NS = 1_000_000_000
NEVER_NS = 1 << 62
"""A time that never comes, on every clock."""


class Clock(Record):
    """A time of its own, of a record that has these fields."""

    clock_on: int  # 1: it has a time of its own
    clock_ppb: int  # by how much it runs fast, 1e-9
    clock_from_ns: int  # the bus's time and its own when that began
    clock_at_ns: int  # ... and what it showed then


@inlined
def own_ns(clock: Clock, t_ns: int) -> int:
    """Return the own time at `t_ns` of the bus."""
    if clock.clock_on == 0:
        return t_ns
    since, rate = t_ns - clock.clock_from_ns, NS + clock.clock_ppb
    return int(clock.clock_at_ns + since // NS * rate + since % NS * rate // NS)


@inlined
def bus_ns(clock: Clock, own: int) -> int:
    """Return the first time of the bus at which the own time is `own` or later."""
    if clock.clock_on == 0 or own >= NEVER_NS:
        return own
    ahead, rate = own - clock.clock_at_ns, NS + clock.clock_ppb
    return int(clock.clock_from_ns + ahead // rate * NS - -(ahead % rate) * NS // rate)


@kernel
def to_bus(clock: Clock, out: Queue, first: int) -> None:
    """Turn the times of what was pushed from place `first` on into the bus's."""
    for k in range(first, out.count):
        out.frames[k].t_ns = bus_ns(clock, out.frames[k].t_ns)


def set_clock(clock: Clock, t_ns: int, ppb: int) -> None:
    """Let the clock run fast by `ppb` (1e-9; negative: slow) from
    `t_ns` of the bus on, without a jump.
    """
    now = int(own_ns(clock, t_ns))
    clock.clock_on, clock.clock_ppb, clock.clock_from_ns, clock.clock_at_ns = 1, ppb, t_ns, now
