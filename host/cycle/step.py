"""The cycle's compiled step: process image in, set-points out. The same code in virtual time, in real time and in replay.

A cycle is: `begin` (SYNC) - `on_frame` for what arrives - `finish` (measure, watch, phase, law, limits, RPDOs), each for one axis. `host.cycle.axes`
calls them for all axes of a bus, `host.cycle.phases` has what a phase does.

    c : the CONTROL record of an axis        h : its HOST record        axis : the AXIS record, which holds both, its PDOs and the law

Safety that lives here: the brake's set-point is never negative and never becomes motor torque; the motor's torque is limited in
size, rate and per mille, is never accelerating near the speed limit, and is 0 when stale; arming is refused unless the handle is still,
little loaded, and motor, encoder and transducer agree on the sign.
"""

from __future__ import annotations

from typing import Any

from coulombus.compiled.decorator import kernel
from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.codec import pack, unpack
from coulombus.host.cycle.phases import advance
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.cycle.watch import measure, watch
from coulombus.wire.frame import push

__all__ = ["SOURCE_HOST", "begin", "brake_raw", "finish", "limit_torque", "on_frame", "send"]

SOURCE_HOST = -1
"""Station number of the host in a queue and in a log."""

SPEED_TAPER = 0.8  # above this share of the speed limit the motor may only brake


@kernel
def limit_torque(c: Any, h: Any, torque_Nm: float) -> float:
    """Return the motor torque [Nm] that may be sent: 0 outside the phases that show torque, when stale or not a number; then rate, speed and size."""
    if h.phase < Phase.SIGN or h.phase > Phase.RUN or h.position_age > 1:
        return 0.0
    if torque_Nm != torque_Nm:
        h.clipped_torque += 1
        return 0.0
    limit_Nm, count_Nm = c.motor_limit_pm * abs(c.Nm_pm), abs(c.Nm_pm)
    if abs(torque_Nm) > limit_Nm + count_Nm:  # less than a count is rounding
        h.clipped_torque += 1
    limited_Nm = min(max(torque_Nm, h.torque_Nm - c.motor_rate_Nm), h.torque_Nm + c.motor_rate_Nm)
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    if abs(v) > SPEED_TAPER * c.speed_limit and limited_Nm * v > 0.0:
        limited_Nm = 0.0
    limited_Nm = min(max(limited_Nm, -limit_Nm), limit_Nm)
    if h.phase == Phase.RUN and abs(limited_Nm - min(max(torque_Nm, -limit_Nm), limit_Nm)) > count_Nm:
        h.slowed_torque += 1
    return limited_Nm


@kernel
def brake_raw(c: Any, h: Any) -> int:
    """Return the brake's set-point in counts: unsigned, without a wrap, within what its object takes."""
    return min(max(round(h.brake_Nm / c.brake_Nm_raw), 0), c.brake_limit_raw)


@kernel
def begin(axis: Any, t_ns: int, out: Any) -> None:
    """Begin the cycle that is due at `t_ns`: count what the last one lost, send SYNC (and the host's heartbeat when due)."""
    c, h = axis.control, axis.host
    if h.cycle > 0 and h.phase < Phase.SAFE and h.arrived != (1 << c.tpdos) - 1:
        h.lost_pdos += 1
    h.arrived = 0
    h.waiting = 1
    h.sync_ns = t_ns
    h.cycle += 1
    h.next_ns = t_ns + c.window_ns
    if c.sync_cob_id < 0:  # another axis of this bus leads
        return
    push(out, SOURCE_HOST, t_ns, c.sync_cob_id, 0, 0)
    if c.heartbeat_ns > 0 and t_ns >= h.heartbeat_due_ns:
        h.heartbeat_due_ns = t_ns + c.heartbeat_ns
        push(out, SOURCE_HOST, t_ns, CobId.HEARTBEAT + c.host_id, 1, NmtState.OPERATIONAL)


@kernel
def on_frame(axis: Any, t_ns: int, can_id: int, length: int, data: int) -> int:
    """Take a frame from the bus; return 1 when it completes this cycle's TPDOs, 2 when the control plane wants it, else 0."""
    c, h = axis.control, axis.host
    for k in range(c.tpdos):
        pdo = axis.tpdos[k]
        if pdo.cob_id == can_id:
            if length != pdo.length:
                h.malformed_pdos += 1
                return 0
            unpack(pdo, data, h.image)
            h.arrived |= 1 << k
            return 1 if h.waiting and h.arrived == (1 << c.tpdos) - 1 else 0
    function, node = can_id & 0x780, can_id & 0x7F
    if can_id > 0x7FF:
        h.stray_frames += 1
        return 0
    if function == CobId.HEARTBEAT and length == 1:
        state = data & 0x7F
        known = False
        if node == c.motor_id:
            known = h.motor_nmt == state
            h.motor_nmt = state
            h.motor_heartbeat_ns = t_ns
        elif node == c.brake_id:
            known = h.brake_nmt == state
            h.brake_nmt = state
            h.brake_heartbeat_ns = t_ns
        return 0 if known else 2
    if function == CobId.SDO_TX:
        return 2
    if function == CobId.EMCY and length == 8 and (node == c.motor_id or node == c.brake_id):
        code = data & 0xFFFF
        if code != 0 and h.emcy == Trip.NONE:
            h.emcy = Trip.EMCY_MOTOR if node == c.motor_id else Trip.EMCY_BRAKE
            h.emcy_code = code
        return 2
    h.stray_frames += 1
    return 0


@kernel
def _close(c: Any, h: Any, t_ns: int) -> None:
    """End the window for this cycle's TPDOs: count a cycle that is late or that lacks one."""
    h.waiting = 0
    h.next_ns = h.sync_ns + c.period_ns
    if t_ns > h.next_ns:
        h.missed_deadlines += 1
    complete = h.arrived == (1 << c.tpdos) - 1
    h.missed_in_a_row = 0 if complete else h.missed_in_a_row + 1


@kernel
def send(axis: Any, t_ns: int, out: Any) -> None:
    """Send the RPDOs: torque and brake in raw counts, beside the controlword of the phase."""
    c, h = axis.control, axis.host
    h.image[Image.TARGET_TORQUE] = round(h.torque_Nm / c.Nm_pm)
    h.image[Image.BRAKE_SETPOINT] = brake_raw(c, h)
    for k in range(c.rpdos):
        pdo = axis.rpdos[k]
        push(out, SOURCE_HOST, t_ns, pdo.cob_id, pdo.length, pack(pdo, h.image))


@kernel
def finish(axis: Any, law_function: Any, t_ns: int, out: Any) -> None:
    """Finish the cycle at `t_ns`: measure, watch, advance the phase (which asks the law), limit, and send the RPDOs."""
    c, h = axis.control, axis.host
    _close(c, h, t_ns)
    jump = measure(c, h)
    doubt = watch(c, h, jump, t_ns)
    torque_Nm = advance(axis, law_function, doubt, t_ns)
    h.torque_Nm = limit_torque(c, h, torque_Nm)
    send(axis, t_ns, out)
