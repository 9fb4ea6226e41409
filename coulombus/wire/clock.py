"""A compiled clock that runs fast or slow: the local time of a station, which all of its timers use.

A record with the fields of `Clock` has a local time since the bus time `clock_from_ns`, at which it
showed `clock_at_ns`::

    own = clock_at_ns + floor((bus - clock_from_ns) * (1 + ppb / 1e9))

in int64 without loss. `bus_ns` returns the first bus time at which a local time is reached.
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import Record
from coulombus.wire.frame import Queue

__all__ = ["NEVER_NS", "Clock", "bus_ns", "own_ns", "set_clock", "to_bus"]

NS = 1_000_000_000
NEVER_NS = 1 << 62
"""A time that never comes, on every clock; its negative is before every time."""


class Clock(Record):
    """Local time of a record that has these fields."""

    clock_on: int  # 1: the record has a local time
    clock_ppb: int  # rate error, 1e-9; positive: fast
    clock_from_ns: int  # bus time at which the local time began
    clock_at_ns: int  # local time at `clock_from_ns`


@inlined
def own_ns(clock: Clock, t_ns: int) -> int:
    """Return the local time at the bus time `t_ns`."""
    if clock.clock_on == 0:
        return t_ns
    since, rate = t_ns - clock.clock_from_ns, NS + clock.clock_ppb
    return int(clock.clock_at_ns + since // NS * rate + since % NS * rate // NS)


@inlined
def bus_ns(clock: Clock, local_ns: int) -> int:
    """Return the first bus time at which the local time is `local_ns` or later."""
    if clock.clock_on == 0 or local_ns >= NEVER_NS:
        return local_ns
    ahead, rate = local_ns - clock.clock_at_ns, NS + clock.clock_ppb
    return int(clock.clock_from_ns + ahead // rate * NS - -(ahead % rate) * NS // rate)


@kernel
def to_bus(clock: Clock, out: Queue, first: int) -> None:
    """Convert the times of the frames pushed from index `first` on to bus time."""
    for k in range(first, out.count):
        out.frames[k].t_ns = bus_ns(clock, out.frames[k].t_ns)


def set_clock(clock: Clock, t_ns: int, ppb: int) -> None:
    """Let the clock run fast by `ppb` (1e-9; negative: slow) from the bus time `t_ns` on, without a jump."""
    now = int(own_ns(clock, t_ns))
    clock.clock_on, clock.clock_ppb, clock.clock_from_ns, clock.clock_at_ns = 1, ppb, t_ns, now
