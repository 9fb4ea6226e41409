"""The loop's link to a world outside, compiled: states out, models in.

w : the `LocalModelRecord` of an axis
"""

from __future__ import annotations

from coulombus.host.cycle.display_state import describe
from coulombus.host.cycle.records import AXIS, AxisRecords
from coulombus.host.realtime.log_rings import log_moment
from coulombus.host.realtime.shared_memory import PlaneRecord
from coulombus.host.world.recorded import AXIS_BITS, KEY_MASK
from coulombus.host.world.records import StateRecord, offset_of
from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import MSG_DONTWAIT, MSG_NOSIGNAL, load_acquire, now_ns, send
from coulombus.kernels.records import RecordArray
from coulombus.recording.trace import Moment, TraceRow

__all__ = ["take_models", "tell_world"]

AXIS_SIZE = AXIS.itemsize
AT_PUBLISHED = offset_of(AXIS, "world", "published")


@kernel
def tell_world(fd: int, state: RecordArray[StateRecord], axes: AxisRecords, done_ns: int) -> None:
    """Send the state of each axis after a cycle to the socket `fd` (-1: none); without room it is lost there.

    `state` is one record for the states, one after the other.
    """
    for k in range(axes.shape[0] if fd >= 0 else 0):
        describe(axes, k, done_ns, state[0])
        send(fd, state.ctypes.data, state.itemsize, MSG_DONTWAIT | MSG_NOSIGNAL)


@kernel
def take_models(plane: RecordArray[PlaneRecord], trace: RecordArray[TraceRow], axes: AxisRecords) -> None:
    """Let the law take the newest model of each axis: also one that came after the cycle had begun."""
    for k in range(axes.shape[0]):
        w = axes[k].world
        if w.on == 0:
            continue
        number = load_acquire(axes.ctypes.data + k * AXIS_SIZE + AT_PUBLISHED)
        if number != w.wanted:
            w.wanted = number
            log_moment(plane, trace, Moment.MODEL, now_ns(), (number << AXIS_BITS | k) & KEY_MASK)
