"""Trace of the real-time loop: the data that a replay needs beyond the frames.

The step is a function of frames and times. In virtual time both are in the recording, since all
happens at the stamps' own times. In real time a frame that arrived while the loop was computing is
older than the RPDO that the loop then sent, but the step used it only in the next cycle. A window
that timed out leaves no trace on the bus; neither does a stop request, nor the cycle in which a
parameter changed (the markers name the parameter: `host.cycle.parameter_changes`). So the loop
keeps a row for each `Moment`, and the recording stores them as attachments (``host.trace.0``,
``host.trace.1`` ...; `pack`, `unpack`).

In virtual time frames and stamps give the times of the host's actions. They do not give its
received frames: it may be in bus-off or behind a cut cable, or a fault may have dropped a frame for
it alone. Nor do they give its clock drift or a stop request. The same attachments store these, with
rows of EVENT. With a fault file even the sent frames are unknown: a frame may be lost or doubled.
Then the send requests are stored, too (``host.sent.0`` ...; `pack_sent`). The models that a world
outside has sent are attachments in both (``host.models.0`` ...; `pack_models`).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from enum import IntEnum
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Record, Records, dtype_of
from coulombus.wire.frame import FRAME

__all__ = [
    "EVENT",
    "MODELS",
    "NAME",
    "SENT",
    "TRACE",
    "Event",
    "Moment",
    "pack",
    "pack_models",
    "pack_sent",
    "unpack",
    "unpack_models",
    "unpack_sent",
]

NAME = "host.trace."
"""Prefix of the attachments' names; a number follows."""

SENT = "host.sent."
"""Prefix of the attachments with the host's send requests."""

MODELS = "host.models."
"""Prefix of the attachments with the models of a world (`host.world`)."""
MOST_MODEL_BYTES = 1 << 31

_HEAD = struct.Struct("<II")


class Moment(IntEnum):
    """Kind of a row of the real-time loop."""

    START = 0  # the cycle begins with the first period at `t_ns`; earlier frames are ignored
    BEGIN = 1  # a cycle due at `t_ns`; `value`: whether the dead man's switch is held
    ARRIVED = 2  # all TPDOs of an axis received: `host.cycle.axes.finish` at `t_ns`; `value`: reason of a stop request
    WINDOW = 3  # window over or nothing pending: `finish` for all waiting axes; `value` as before
    END = 4  # the cycle is over, the safe set-points follow
    SET = 5  # the parameters of order `value` apply from the next cycle (marker "set")
    MODEL = 6  # the world's model `value` applies from the next cycle (`MODELS`)


class TraceRow(Record):
    """A row of the trace. All counts begin with the loop's process."""

    t_ns: int  # CLOCK_MONOTONIC
    received: int  # frames received by the loop so far
    kind: Annotated[int, np.int32]  # `Moment`
    value: Annotated[int, np.int32]  # by `kind`
    refused: int  # frames so far that a bus refused, or that were for a lost bus
    dropped: int  # frames dropped from the log so far


TRACE = dtype_of(TraceRow)


class Event(IntEnum):
    """Kind of a row kept in virtual time."""

    START = 0  # the cycle begins with the first period at `t_ns` of the host's clock
    CLOCK = 1  # from `t_ns` of the bus the host's clock runs fast by `value` 1e-9
    STOP = 2  # stop request; `value`: reason (`host.cycle.records.Trip`)
    SET = 3  # the parameters of order `value` apply from the next cycle (marker "set")
    MODEL = 4  # the world's model `value` applies from the next cycle (`MODELS`)


EVENT = np.dtype(
    [
        ("t_ns", "<i8"),
        ("received", "<i8"),  # number of frames received by then
        ("next_ns", "<i8"),  # everything due before this on its clock is done
        ("kind", "<i4"),  # `Event`
        ("value", "<i4"),
    ],
    align=True,
)

_SENT = np.dtype([("t_ns", "<i8"), ("word", "<i8"), ("can_id", "<u4"), ("length", "<u4")])

Table = npt.NDArray[Any]


def pack(unreceived: npt.NDArray[np.bool_], trace: Table) -> bytes:
    """Return the content of an attachment: a flag for each frame since the last attachment that the
    host did not receive; and rows.

    ::

        u32 frames  u32 rows  | one bit for each frame, the first one lowest, padded to bytes | rows of TRACE or EVENT
    """
    return (
        _HEAD.pack(len(unreceived), len(trace)) + np.packbits(unreceived, bitorder="little").tobytes() + trace.tobytes()
    )


def pack_sent(frames: Table) -> bytes:
    """Return the content of an attachment: the host's send requests since the last one (FRAME
    records, stamped with their ready times).
    """
    rows = np.zeros(len(frames), _SENT)
    for name in _SENT.names or ():
        rows[name] = frames[name]
    return rows.tobytes()


def unpack_sent(attachments: Mapping[str, bytes]) -> Records | None:
    """Return the host's send requests as FRAME records; None if not recorded."""
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


def pack_models(rows: bytes) -> bytes:
    """Return the content of an attachment: rows of `host.world.recorded`, compressed by zlib."""
    return zlib.compress(rows, 1)


def unpack_models(attachments: Mapping[str, bytes]) -> bytes:
    """Return the rows of all attachments with models; those after a damaged one are omitted."""
    rows = bytearray()
    count = 0
    while (content := attachments.get(f"{MODELS}{count}")) is not None:
        try:
            rows += zlib.decompressobj().decompress(content, MOST_MODEL_BYTES - len(rows))
        except zlib.error:
            break
        count += 1
    return bytes(rows)


def unpack(
    attachments: Mapping[str, bytes], dtype: np.dtype[Any] = TRACE
) -> tuple[npt.NDArray[np.bool_], Table] | None:
    """Return the trace in a recording's attachments: frames that the host did not receive, and rows
    of `dtype`; None without attachments.

    Data after a missing or damaged attachment are omitted.
    """
    unreceived: list[Table] = []
    rows: list[Table] = []
    while (content := attachments.get(f"{NAME}{len(rows)}")) is not None:
        if len(content) < _HEAD.size:
            break
        frames, count = _HEAD.unpack_from(content)
        at = _HEAD.size + (frames + 7) // 8
        if len(content) != at + count * dtype.itemsize:
            break
        bits = np.frombuffer(content, np.uint8, at - _HEAD.size, _HEAD.size)
        unreceived.append(np.unpackbits(bits, count=frames, bitorder="little").astype(bool))
        rows.append(np.frombuffer(content, dtype, count, at))
    if not rows:
        return None
    return np.concatenate(unreceived), np.concatenate(rows)
