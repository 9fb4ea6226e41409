"""Telemetry of the host after each cycle: frames for the second interface of a recording.

They never go to a bus (`recording.host_telemetry` has their layout). Telemetry only reads the cycle's
state; it writes nothing but the fields for the last report.

    h : the `HostRecord` of an axis
"""

from __future__ import annotations

import numpy as np

from coulombus.host.cycle.records import AxisRecord, AxisRecords, HostRecord
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import RecordArray, Records
from coulombus.recording.host_telemetry import FIRST, GAIN, OF_WORLD, PER_AXIS, SOURCE_INSIDE, Limit
from coulombus.wire.frame import Frame

__all__ = ["write_axes", "write_axis"]

MOST_GAIN = round(1.0 / GAIN)
MOST_AGE = 127


@kernel
def _grown(last: Records, k: int, count: int) -> int:
    """Return 1 if a counter has increased since the last cycle's end."""
    grown = 1 if count > last[k] else 0
    last[k] = count
    return grown


@kernel
def _limits(h: HostRecord) -> int:
    """Return the limits that acted in this cycle: bits of `recording.host_telemetry.Limit`."""
    limits = 0
    counts = h.clipped_torque, h.slowed_torque, h.limited_by_drive, h.clipped_setpoints, h.negative_setpoints
    for k, count in enumerate((*counts, h.withheld_compensation)):
        limits |= _grown(h.last_counters, k, count) << k  # the first bits of `Limit`, in their order
    if h.missed_in_a_row > 0:
        limits |= Limit.TPDO_MISSED
    if not h.deadman_ok:
        limits |= Limit.DEADMAN_OPEN
    return limits


@kernel
def _put(rows: Records, row: int, t_ns: int, can_id: int, word: int, length: int = 8) -> None:
    f = rows[row]
    f.t_ns = t_ns
    f.can_id = can_id
    f.length = length
    f.word = word
    f.source = SOURCE_INSIDE


@kernel
def _two(first: float, second: float) -> int:
    """Return two numbers as a frame's data word: two REAL32, the first in the low half."""
    low, high = np.float32(first).view(np.uint32), np.float32(second).view(np.uint32)
    word: int = np.int64(low) | np.int64(high) << 32  # type: ignore[assignment]
    return word


@kernel
def write_axis(axis: AxisRecord, number: int, t_ns: int, rows: Records, row: int) -> int:
    """Write the telemetry of the finished cycle of axis `number` into `rows`, from `row` on; return the
    next row.

    Does nothing while the cycle waits for TPDOs, or if it was reported already.
    """
    c, h, state = axis.control, axis.host, axis.state
    if h.waiting or h.cycle == h.told_cycle:
        return row
    h.told_cycle = h.cycle
    first = FIRST + PER_AXIS * number
    gain = min(max(round(h.gain / GAIN), 0), MOST_GAIN)
    limits = _limits(h)
    if axis.world.on:
        limits |= _grown(h.last_counters, 6, axis.world.clipped) * Limit.WORLD_CLIPPED
    word = h.phase | h.trip << 8 | limits << 16 | gain << 32
    word |= (1 if state.stuck else 0) << 48 | min(max(h.position_age, 0), MOST_AGE) << 56
    _put(rows, row, t_ns, first, word)
    _put(rows, row + 1, t_ns, first + 1, _two(state.psi_Nm, state.brake_Nm))
    _put(rows, row + 2, t_ns, first + 2, _two(axis.motion.v_rad_s, state.x_stuck))
    row += 3
    for k in range(0, c.law_keeps, 2):
        another = k + 1 < c.law_keeps
        word = _two(state.user[k], state.user[k + 1] if another else 0.0)
        _put(rows, row, t_ns, first + 3 + k // 2, word, 8 if another else 4)
        row += 1
    if axis.world.on:
        w = axis.world
        word = round(w.share / GAIN) | round(w.law_share / GAIN) << 16 | (w.taken & 0xFFFFFFFF) << 32
        _put(rows, row, t_ns, first + OF_WORLD, _two(0.0 - w.world_Nm, w.world_brake_Nm))
        _put(rows, row + 1, t_ns, first + OF_WORLD + 1, word)
        row += 2
    return row


@kernel
def write_axes(axes: AxisRecords, t_ns: int, rows: RecordArray[Frame], row: int) -> int:
    """Write the telemetry of all axes; return the next row."""
    for k in range(axes.shape[0]):
        row = write_axis(axes[k], k, t_ns, rows, row)
    return row
