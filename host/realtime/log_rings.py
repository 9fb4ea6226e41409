"""Ring buffers between the data plane's loop and its parent, compiled.

One ring is the log of frames, the other the trace of the events of each cycle. The loop writes at a
ring's head, and the parent reads at its tail. Each side moves only its own end, after the access to the
row, so a row is visible as a whole or not at all. Rows without room are dropped and counted.

    p : the PLANE record        f, g, r : a frame or a row
"""

from __future__ import annotations

from coulombus.host.realtime.shared_memory import PlaneRecord, field_offset
from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import load_acquire, store_release
from coulombus.kernels.records import RecordArray, Records
from coulombus.recording.trace import TraceRow
from coulombus.wire.frame import Frame

__all__ = ["log_frame", "log_moment", "take_log", "take_trace"]

AT_HEAD, AT_TAIL = field_offset("log_head"), field_offset("log_tail")
AT_TRACE_HEAD, AT_TRACE_TAIL = field_offset("trace_head"), field_offset("trace_tail")


@kernel
def log_frame(
    plane: RecordArray[PlaneRecord],
    ring: RecordArray[Frame],
    t_ns: int,
    can_id: int,
    length: int,
    word: int,
    source: int,
) -> None:
    """Append a frame to the ring; without room it is dropped and counted."""
    p = plane[0]
    head = p.log_head
    if head - load_acquire(plane.ctypes.data + AT_TAIL) >= ring.shape[0]:
        p.log_dropped += 1
        return
    f = ring[head & (ring.shape[0] - 1)]
    f.t_ns = t_ns
    f.can_id = can_id
    f.length = length
    f.word = word
    f.source = source
    store_release(plane.ctypes.data + AT_HEAD, head + 1)


@kernel
def log_moment(plane: RecordArray[PlaneRecord], trace: RecordArray[TraceRow], kind: int, t_ns: int, value: int) -> None:
    """Append a row to the trace; without room it is dropped and counted."""
    p = plane[0]
    head = p.trace_head
    if head - load_acquire(plane.ctypes.data + AT_TRACE_TAIL) >= trace.shape[0]:
        p.log_dropped += 1
        return
    r = trace[head & (trace.shape[0] - 1)]
    r.t_ns = t_ns
    r.received = p.rx_frames
    r.kind = kind
    r.value = value
    r.refused = p.tx_full + p.unsent
    r.dropped = p.log_dropped
    store_release(plane.ctypes.data + AT_TRACE_HEAD, head + 1)


@kernel
def take_trace(plane: RecordArray[PlaneRecord], trace: RecordArray[TraceRow], out: Records) -> int:
    """Move rows from the trace to `out`; return their number. Called by the parent."""
    p = plane[0]
    tail = p.trace_tail
    count: int = min(load_acquire(plane.ctypes.data + AT_TRACE_HEAD) - tail, out.shape[0])
    for i in range(count):
        f, g = trace[(tail + i) & (trace.shape[0] - 1)], out[i]
        g.t_ns = f.t_ns
        g.received = f.received
        g.kind = f.kind
        g.value = f.value
        g.refused = f.refused
        g.dropped = f.dropped
    store_release(plane.ctypes.data + AT_TRACE_TAIL, tail + count)
    return count


@kernel
def take_log(plane: RecordArray[PlaneRecord], ring: RecordArray[Frame], out: Records) -> int:
    """Move frames from the ring to `out`; return their number. Called by the parent."""
    p = plane[0]
    tail = p.log_tail
    count: int = min(load_acquire(plane.ctypes.data + AT_HEAD) - tail, out.shape[0])
    for i in range(count):
        f, g = ring[(tail + i) & (ring.shape[0] - 1)], out[i]
        g.t_ns = f.t_ns
        g.can_id = f.can_id
        g.length = f.length
        g.word = f.word
        g.source = f.source
    store_release(plane.ctypes.data + AT_TAIL, tail + count)
    return count
