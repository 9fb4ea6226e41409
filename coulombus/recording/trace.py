"""What the loop in real time did when: the part of a run that its frames do not tell, and that a
replay needs.

The step is a function of frames and times. In virtual time both are in the recording, since all
happens at the stamps' own times. In real time a frame that came while the loop was computing is
older than the RPDO that the loop sent then, and yet the step saw it only in the next cycle; a
window that ended by time leaves no trace on the bus, nor does a wish to stop, nor the cycle from
which on a parameter is another one (which, the markers tell: `host.cycle.parameter_changes`). So the loop keeps a
row for each `Moment`, and the recording carries them as attachments (``host.trace.0``,
``host.trace.1`` ...; `pack`, `unpack`).

In virtual time frames and stamps tell when the host did what. They do not tell which frames it had:
it may be in bus-off or behind a cut cable, and a fault may have kept a frame from it alone. Nor do
they tell how its clock ran, or that it was asked to stop. That is in the same attachments, with
rows of EVENT. With a fault file they do not even tell what the host has sent: a frame may never
come to the bus, or twice. Then what it asked for is kept, too (``host.sent.0`` ...; `pack_sent`).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Record, dtype_of
from coulombus.wire.frame import FRAME, Records

__all__ = ["EVENT", "NAME", "SENT", "TRACE", "Event", "Moment", "pack", "pack_sent", "unpack", "unpack_sent"]

NAME = "host.trace."
"""What the attachments' names begin with; a number follows."""

SENT = "host.sent."
"""The same of what the host asked the bus to send."""

_HEAD = struct.Struct("<II")


class Moment(IntEnum):
    """What a row tells."""

    START = 0  # the cycle begins with the first period at `t_ns`; what was received before it counts for nothing
    BEGIN = 1  # a cycle that was due at `t_ns`; `value`: whether the dead man's switch is held
    ARRIVED = 2  # an axis' TPDOs had all come: `host.cycle.axes.finish` at `t_ns`; `value`: why all were asked to stop
    WINDOW = 3  # the window was over, or nothing was left to wait for: `finish`, of all that wait; `value` as before
    END = 4  # the cycle is over, the safe set-points follow
    SET = 5  # the parameters of order `value` are wanted from the cycle on that begins next (marker "set")


class TraceRow(Record):
    """A row of the trace. All counts begin with the loop's process."""

    t_ns: int  # CLOCK_MONOTONIC
    received: int  # frames that the loop had received until then
    kind: Annotated[int, np.int32]  # `Moment`
    value: Annotated[int, np.int32]  # by `kind`
    refused: int  # frames that the bus had not taken until then
    dropped: int  # frames that found no place in the log until then


TRACE = dtype_of(TraceRow)


class Event(IntEnum):
    """What a row tells that was kept in virtual time."""

    START = 0  # the cycle begins with the first period at `t_ns` of the host's clock
    CLOCK = 1  # the host's clock runs fast by `value` 1e-9 from `t_ns` of the bus on
    STOP = 2  # the host is asked to stop; `value`: why (`host.cycle.records.Trip`)
    SET = 3  # the parameters of order `value` are wanted from the next cycle on (marker "set")


EVENT = np.dtype(
    [
        ("t_ns", "<i8"),
        ("received", "<i8"),  # when: it has received so many frames
        ("next_ns", "<i8"),  # and done all that was due on its clock before this
        ("kind", "<i4"),  # `Event`
        ("value", "<i4"),
    ],
    align=True,
)

_SENT = np.dtype([("t_ns", "<i8"), ("word", "<i8"), ("can_id", "<u4"), ("length", "<u4")])

Table = npt.NDArray[Any]


def pack(own: npt.NDArray[np.bool_], trace: Table) -> bytes:
    """Return the content of an attachment: whether each of the frames written since the last one
    was none that the host received; and rows.

    ::

        u32 frames  u32 rows  | one bit for each frame, the first one lowest, padded to bytes | rows of TRACE or EVENT
    """
    return _HEAD.pack(len(own), len(trace)) + np.packbits(own, bitorder="little").tobytes() + trace.tobytes()


def pack_sent(frames: Table) -> bytes:
    """Return the content of an attachment: what the host asked for since the last one (FRAME
    records, stamped with when it was ready).
    """
    rows = np.zeros(len(frames), _SENT)
    for name in _SENT.names or ():
        rows[name] = frames[name]
    return rows.tobytes()


def unpack_sent(attachments: Mapping[str, bytes]) -> Records | None:
    """Return what the host asked for, as FRAME records; None where a recording does not tell."""
    parts: list[Table] = []
    while (content := attachments.get(f"{SENT}{len(parts)}")) is not None and len(content) % _SENT.itemsize == 0:
        parts.append(np.frombuffer(content, _SENT))
    if not parts:
        return None
    rows = np.concatenate(parts)
    frames = np.zeros(len(rows), FRAME)
    for name in _SENT.names or ():
        frames[name] = rows[name]
    return frames


def unpack(
    attachments: Mapping[str, bytes], dtype: np.dtype[Any] = TRACE
) -> tuple[npt.NDArray[np.bool_], Table] | None:
    """Return all that a recording's attachments tell: which frames the host did not receive, rows
    of `dtype`; None when there are none.

    What stands behind a missing or damaged attachment is left out.
    """
    own: list[Table] = []
    rows: list[Table] = []
    while (content := attachments.get(f"{NAME}{len(rows)}")) is not None:
        if len(content) < _HEAD.size:
            break
        frames, count = _HEAD.unpack_from(content)
        at = _HEAD.size + (frames + 7) // 8
        if len(content) != at + count * dtype.itemsize:
            break
        bits = np.frombuffer(content, np.uint8, at - _HEAD.size, _HEAD.size)
        own.append(np.unpackbits(bits, count=frames, bitorder="little").astype(bool))
        rows.append(np.frombuffer(content, dtype, count, at))
    if not rows:
        return None
    return np.concatenate(own), np.concatenate(rows)
