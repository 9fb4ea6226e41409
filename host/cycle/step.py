"""The cycle's compiled step: process image in, set-points out.

Virtual time, real time and replay run the same code.

A cycle is `begin` (SYNC), `on_frame` for each arriving frame, and `finish` (measure, watch, phase, law,
limits, RPDOs). Each works on one axis. `host.cycle.axes` calls them for all axes of a bus;
`host.cycle.phases` has the phases.

    c : the CONTROL record of an axis        h : its HOST record        axis : the `AxisRecord`, which holds both, its PDOs and the law

Safety rules of this module:

- The brake's set-point is never negative and never becomes motor torque.
- The motor's torque is limited in size, rate and per mille. Near the speed limit it never accelerates
  the handle. With a stale position it is 0.
- Arming is refused unless the handle is still and not loaded, and motor, encoder and transducer agree
  on the sign.
"""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.eds.codec import pack, unpack
from coulombus.host.cycle.live_parameters import follow
from coulombus.host.cycle.monitors import measure, watch
from coulombus.host.cycle.phases import advance
from coulombus.host.cycle.records import AxisRecord, ControlRecord, HostRecord, Image, LawFunction, Phase, Trip
from coulombus.kernels.decorator import kernel
from coulombus.wire.frame import CAN_RTR_FLAG, Queue, push

__all__ = [
    "SOURCE_HOST",
    "begin",
    "brake_raw",
    "close_and_send",
    "finish",
    "limit_torque",
    "observe",
    "on_frame",
    "send",
]

SOURCE_HOST = -1
"""Station number of the host in a queue and in a log."""

SDO_DOWNLOAD, SDO_BLOCK_DOWNLOAD = 1, 6
"""Client command specifiers of a request that writes (CiA 301, 7.2.4.3)."""
NEAR_LIMIT = 0.85  # above this share of its limit the motor's torque counts as part of an oscillation ...
FAST_SHARE = 0.5  # ... and above this share of its rate downwards a change of the brake's set-point
SPEED_TAPER = 0.8  # above this share of the speed limit the motor may only brake


@kernel
def limit_torque(c: ControlRecord, h: HostRecord, torque_Nm: float) -> float:
    """Return the motor torque [Nm] that may be sent.

    It is 0 outside the phases with motor torque, with a stale position, and for NaN. Else rate, speed
    and size limit it, in this order.
    """
    if h.phase < Phase.SIGN or h.phase > Phase.RUN or h.position_age > 1:
        return 0.0
    if torque_Nm != torque_Nm:
        h.clipped_torque += 1
        h.clipped = 1
        return 0.0
    limit_Nm, count_Nm = c.motor_limit_raw * abs(c.motor_Nm_raw), abs(c.motor_Nm_raw)
    if abs(torque_Nm) > limit_Nm + count_Nm:  # less than a count is rounding
        h.clipped_torque += 1
        h.clipped = 1
    limited_Nm = min(max(torque_Nm, h.torque_Nm - c.motor_rate_Nm), h.torque_Nm + c.motor_rate_Nm)
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    if abs(v) > SPEED_TAPER * c.speed_limit and limited_Nm * v > 0.0:
        limited_Nm = 0.0
    limited_Nm = min(max(limited_Nm, -limit_Nm), limit_Nm)
    if h.phase == Phase.RUN and abs(limited_Nm - min(max(torque_Nm, -limit_Nm), limit_Nm)) > count_Nm:
        h.slowed_torque += 1
        h.clipped = 1
    return limited_Nm


@kernel
def brake_raw(c: ControlRecord, h: HostRecord) -> int:
    """Return the brake's set-point in counts: saturated, from 0 Nm to the largest value of its object or
    to the end of its table.
    """
    if c.brake_points == 0:
        return min(max(round(h.brake_Nm / c.brake_Nm_raw), 0), c.brake_limit_raw)
    k = 1
    while k < c.brake_points - 1 and c.brake_Nm_at[k] < h.brake_Nm:
        k += 1
    share = (h.brake_Nm - c.brake_Nm_at[k - 1]) / (c.brake_Nm_at[k] - c.brake_Nm_at[k - 1])
    share = min(max(share, 0.0), 1.0)
    return round(c.brake_raw_at[k - 1] + share * (c.brake_raw_at[k] - c.brake_raw_at[k - 1]))


@kernel
def _node(c: ControlRecord, node_id: int) -> int:
    """Return the index of `node_id` among the axis' nodes; -1: none."""
    for k in range(c.nodes):
        if c.node_id[k] == node_id:
            return k
    return -1


@kernel
def begin(axis: AxisRecord, t_ns: int, out: Queue) -> None:
    """Start the cycle due at `t_ns`.

    Count the last cycle if it lacked a TPDO, advance live parameters, send SYNC; when due, send the
    host's heartbeat and the guarding requests.
    """
    c, h = axis.control, axis.host
    if h.cycle > 0 and h.phase < Phase.SAFE and h.arrived & c.every_cycle != c.every_cycle:
        h.lost_pdos += 1
    h.arrived &= c.by_timer
    follow(axis)
    h.waiting = 1
    h.sync_ns = t_ns
    h.cycle += 1
    h.next_ns = t_ns + c.window_ns
    if c.sync_cob_id >= 0:  # else another axis of this bus sends SYNC
        push(out, SOURCE_HOST, t_ns, c.sync_cob_id, 0, 0)
        if c.heartbeat_ns > 0 and t_ns >= h.heartbeat_due_ns:
            h.heartbeat_due_ns = t_ns + c.heartbeat_ns
            push(out, SOURCE_HOST, t_ns, CobId.HEARTBEAT + c.host_id, 1, NmtState.OPERATIONAL)
    if c.guard_ns > 0 and t_ns >= h.guard_due_ns:
        h.guard_due_ns = t_ns + c.guard_ns
        for k in range(c.nodes):
            if c.guarded >> k & 1:
                push(out, SOURCE_HOST, t_ns, CAN_RTR_FLAG | (CobId.HEARTBEAT + c.node_id[k]), 1, 0)


@kernel
def _only_of_host(axis: AxisRecord, can_id: int, word: int) -> bool:
    """Return whether only the host may send such a frame during a run: a set-point (RPDO), or a request
    that writes an object of one of the axis' nodes (SDO download, block download).

    The host does not receive its own frames, and it writes no object between arming and the safe
    state. So a received frame of this kind comes from another station.
    """
    for k in range(axis.control.rpdos):
        if axis.rpdos[k].cob_id == can_id:
            return True
    command = word >> 5 & 7
    writes = command in (SDO_DOWNLOAD, SDO_BLOCK_DOWNLOAD)
    return can_id & 0x780 == CobId.SDO_RX and writes and _node(axis.control, can_id & 0x7F) >= 0


@kernel
def _on_emergency(h: HostRecord, k: int, length: int, word: int) -> None:
    """Handle an EMCY of node `k`.

    Any error code trips, whatever the frame's length. A frame without a code trips, too. Only an error
    reset (code 0000h) does not.
    """
    if length != 8:
        h.malformed_services += 1
    code = word & 0xFFFF
    if (code != 0 or length < 2) and h.emcy == Trip.NONE:
        h.emcy = Trip.EMCY_MOTOR if k == 0 else Trip.EMCY_BRAKE if k == 1 else Trip.EMCY_SENSOR
        h.emcy_code = code
        h.suspect_node = k


@kernel
def _on_heartbeat(h: HostRecord, k: int, t_ns: int, length: int, state: int) -> int:
    """Handle a heartbeat of node `k` (-1: not a node of the axis); return 2 if the control plane needs it,
    else 0.

    A heartbeat whose length is not one byte is not accepted as a heartbeat.
    """
    if length != 1:
        h.malformed_services += 1
        return 0
    if k < 0:
        return 2
    unchanged = h.nmt[k] == state
    h.nmt[k] = state
    h.heard_ns[k] = t_ns
    return 0 if unchanged else 2


@kernel
def on_frame(axis: AxisRecord, t_ns: int, can_id: int, length: int, word: int) -> int:
    """Handle a frame from the bus.

    Return 1 if it completes this cycle's TPDOs, 2 if the control plane needs it, else 0.
    """
    c, h = axis.control, axis.host
    for k in range(c.tpdos):
        pdo = axis.tpdos[k]
        if pdo.cob_id == can_id:
            if length != pdo.length:
                h.malformed_pdos += 1
                return 0
            unpack(pdo, word, h.image)
            h.arrived |= 1 << k
            h.tpdo_age[k] = 0
            return 1 if h.waiting and h.arrived & c.awaited == c.awaited else 0
    function, node = can_id & 0x780, can_id & 0x7F
    if can_id > 0x7FF:
        h.stray_frames += 1
        return 0
    if _only_of_host(axis, can_id, word):
        h.stray_frames += 1
        if Phase.OFF < h.phase < Phase.DONE and h.foreign_id < 0:
            h.foreign_id = can_id
        if Phase.OFF < h.phase < Phase.SAFE and h.stop <= 1:
            h.stop = Trip.SECOND_HOST
        return 0
    for k in range(c.nodes):
        if c.emcy_id[k] == can_id:
            _on_emergency(h, k, length, word)
            return 2
    if function == CobId.HEARTBEAT:
        return _on_heartbeat(h, _node(c, node), t_ns, length, word & 0x7F)
    if function == CobId.SDO_TX:
        if length != 8:
            h.malformed_services += 1
        return 2
    h.stray_frames += 1
    return 0


@kernel
def _doubt_clipped_law(c: ControlRecord, h: HostRecord) -> None:
    """Request the safe state if limits change the law's output in most cycles: the hand does not feel the
    law then.
    """
    if h.phase == Phase.RUN:
        h.clipped_balance = max(h.clipped_balance + (1 if h.clipped else -1), 0)
        if h.clipped_balance > c.clipped_cycles and h.stop <= 1:
            h.stop = Trip.LAW_CLIPPED
    h.clipped = 0


@kernel
def _count_reversal(h: HostRecord, k: int, side: int) -> None:
    """Count a change of `side` (1 or -1) of the motor (k = 0) or the brake (1)."""
    if h.side[k] == -side:
        h.reversals[k] += 1.0
    h.side[k] = side


@kernel
def _doubt_oscillating_law(axis: AxisRecord) -> None:
    """Request the safe state if the law shakes motor or brake.

    The motor reverses near or at its limits, or the brake's set-point alternately rises and falls as fast as it may fall,
    more often than in the limit cycle of a sampled friction law, which is the fastest that friction itself does.
    What another program's model does is no doubt of the law.
    """
    c, h = axis.control, axis.host
    moved_Nm = h.brake_Nm - h.moved_from_Nm
    h.moved_from_Nm = h.brake_Nm
    if h.phase != Phase.RUN or h.end_cycles > 0 or (axis.world.on and axis.world.share > 0.0):
        return
    for k in range(2):
        h.reversals[k] *= c.reversal_decay
    if h.clipped or abs(h.torque_Nm) > NEAR_LIMIT * c.motor_limit_raw * abs(c.motor_Nm_raw):
        _count_reversal(h, 0, 1 if h.torque_Nm > 0.0 else -1)
    leads = c.coil_step > 0.0 or c.fluid_step > 0.0  # the lead of a brake's lags alternates by itself
    if not leads and abs(moved_Nm) > FAST_SHARE * c.brake_fall_Nm:
        _count_reversal(h, 1, 1 if moved_Nm > 0.0 else -1)
    if max(h.reversals[0], h.reversals[1]) > c.most_reversals and h.stop <= 1:
        h.stop = Trip.LAW_OSCILLATES


@kernel
def _close(c: ControlRecord, h: HostRecord, t_ns: int) -> None:
    """End the wait for this cycle's TPDOs; count a late cycle and a cycle that lacks a TPDO."""
    h.waiting = 0
    h.next_ns = h.sync_ns + c.period_ns
    if t_ns > h.next_ns:
        h.late_cycles += 1
    complete = h.arrived & c.every_cycle == c.every_cycle
    h.missed_in_a_row = 0 if complete else h.missed_in_a_row + 1
    h.oldest_tpdo = 0
    for k in range(c.tpdos):
        if c.by_timer >> k & 1:
            h.tpdo_age[k] += 1
            h.oldest_tpdo = max(h.oldest_tpdo, h.tpdo_age[k])


@kernel
def send(axis: AxisRecord, t_ns: int, out: Queue) -> None:
    """Send the RPDOs: motor torque and brake set-point in raw counts, and the controlword of the phase."""
    c, h = axis.control, axis.host
    h.image[Image.TARGET_TORQUE] = round(h.torque_Nm / c.motor_Nm_raw)
    h.image[Image.BRAKE_SETPOINT] = brake_raw(c, h)
    for k in range(c.rpdos):
        pdo = axis.rpdos[k]
        push(out, SOURCE_HOST, t_ns, pdo.cob_id, pdo.length, pack(pdo, h.image))


@kernel
def observe(axis: AxisRecord, t_ns: int) -> int:
    """End the wait for this cycle's TPDOs, measure and watch; return a `Trip`, or `Trip.NONE`."""
    c, h = axis.control, axis.host
    _close(c, h, t_ns)
    return watch(c, h, measure(c, h), t_ns)


@kernel
def _follow_display(c: ControlRecord, h: HostRecord) -> None:
    """Follow the torque on the motor that a hand may lean on: the law's part, and in mode active all of it.

    Its largest values count, for the torque of a law in its limit cycle has no constant sign. While the position
    is stale, the motor's command is 0 and the last value stays.
    """
    if h.phase == Phase.RUN and h.fresh and h.end_cycles == 0:
        shown_Nm = min(abs(h.torque_Nm if c.motor_active else h.pushed_Nm), c.motor_limit_raw * abs(c.motor_Nm_raw))
        h.displayed_Nm = max(shown_Nm, h.displayed_Nm * c.motor_lag_decay)


@kernel
def _take_the_drive(c: ControlRecord, h: HostRecord, t_ns: int, out: Queue) -> None:
    """Send the drive to PRE-OPERATIONAL once another station commands it, before or in the safe state.

    There a drive obeys nobody's RPDO. A drive that does not end its torque there is left OPERATIONAL: it still
    gets the host's disable command.
    """
    commanded = h.trip == Trip.SECOND_HOST or h.foreign_id >= 0  # another trip may have come first
    if commanded and Phase.SAFE <= h.phase < Phase.DONE and c.ends_by_nmt and not h.drive_taken:
        h.drive_taken = 1
        push(out, SOURCE_HOST, t_ns, CobId.NMT, 2, NmtCommand.ENTER_PRE_OPERATIONAL | c.node_id[0] << 8)


@kernel
def close_and_send(axis: AxisRecord, t_ns: int, out: Queue) -> None:
    """Follow what the motor displays, doubt the law, and send the RPDOs."""
    h = axis.host
    _follow_display(axis.control, h)
    _doubt_oscillating_law(axis)
    _doubt_clipped_law(axis.control, h)
    send(axis, t_ns, out)
    _take_the_drive(axis.control, h, t_ns, out)
    h.arrived &= ~axis.control.by_timer  # a TPDO by timer that arrives from here on counts for the next cycle


@kernel
def finish(axis: AxisRecord, law_function: LawFunction, t_ns: int, out: Queue) -> None:
    """Finish the cycle at `t_ns`: measure, watch, advance the phase (which evaluates the law), limit the
    torque, and send the RPDOs.
    """
    h = axis.host
    doubt = observe(axis, t_ns)
    torque_Nm = advance(axis, law_function, doubt, t_ns)
    h.torque_Nm = limit_torque(axis.control, h, torque_Nm)
    close_and_send(axis, t_ns, out)
