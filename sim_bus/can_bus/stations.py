"""Compiled list of the stations on the bus, and whether they require the detailed path."""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.can_bus.controller_bits import ControllerMode
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.faults import plan_alarm
from coulombus.sim_bus.can_bus.records import STATION_MASK, BusRecord, Stage
from coulombus.wire.clock import NEVER_NS

__all__ = ["attach", "detach", "number", "refresh", "restart"]


@inlined
def _in_slow_motion(bus: BusRecord) -> bool:
    """Tell whether a bit-level simulation is in progress, with more bits to come."""
    return bool(bus.stage == Stage.PLAYED or bus.stage == Stage.TOLD)


@kernel
def refresh(bus: BusRecord) -> None:
    """Determine whether the bus needs the detailed path, after a change."""
    bus.alert = bus.limited = 0
    if bus.bit_rate <= 0:
        return
    acknowledging = 0
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        if c.tec | c.rec | c.state | c.changed | c.listen_only | c.one_shot | c.loopback | c.queue_limit:
            bus.alert = 1
            if c.queue_limit or c.state == CanState.BUS_OFF:
                bus.limited = 1
        if c.state != CanState.BUS_OFF and c.listen_only == 0:
            acknowledging += 1
    if bus.fault_count > 0 or bus.alarm_ns < NEVER_NS or (bus.on_count > 0 and acknowledging < 2):
        bus.alert = 1


@kernel
def attach(bus: BusRecord, station: int) -> None:
    """Switch a station's controller on."""
    row = station & STATION_MASK
    c = bus.stations[row]
    if c.attached == 0:
        c.attached = 1
        c.tec = c.rec = c.state = c.changed = c.recovered = c.suspend_ns = 0
        c.mode = ControllerMode.INTEGRATING if _in_slow_motion(bus) or bus.play.unsettled else 0
        c.count = c.transmitted = c.joins = 0
        c.frame = c.contends_ns = -1
        bus.on[bus.on_count] = row
        bus.on_count += 1
    refresh(bus)


@kernel
def detach(bus: BusRecord, station: int) -> None:
    """Switch a station's controller off.

    The frame that it is sending breaks off if the bit-level simulation is active.
    """
    row = station & STATION_MASK
    c = bus.stations[row]
    if c.attached:
        c.attached = c.hears = 0
        count = 0
        for k in range(bus.on_count):
            if bus.on[k] != row:
                bus.on[count] = bus.on[k]
                count += 1
        bus.on_count = count
    plan_alarm(bus, bus.play.begin_ns if _in_slow_motion(bus) else 0)
    refresh(bus)


@kernel
def restart(bus: BusRecord, station: int, now_ns: int) -> None:
    """Begin the recovery of a station in bus-off, like ``ip link set can0 type can restart``."""
    c = bus.stations[station & STATION_MASK]
    if c.state == CanState.BUS_OFF:
        c.restart_at_ns = now_ns
        plan_alarm(bus, now_ns)
        refresh(bus)


@inlined
def number(row: int) -> int:
    """Return the number of the station in a row: the host's is -1."""
    return -1 if row == STATION_MASK else row
