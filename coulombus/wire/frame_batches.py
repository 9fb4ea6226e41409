"""Batches of frames as arrays, for readers that poll a bus a few times a second.

`BlockReader` empties a client's socket with recvmmsg(2): one system call for up to `MESSAGES`
messages, and no Python object per frame. An adapter of python-can has its frames as objects already.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records, new_records
from coulombus.system.c_library import c_library
from coulombus.wire.ancillary import CONTROL_WORDS, OVERFLOW, SECOND_NS, STAMP
from coulombus.wire.client import CAN_LENGTH, MESSAGE_BYTES, Client, OpenBus, Received
from coulombus.wire.frame import LENGTH_MASKS, Frame

__all__ = ["Block", "BlockReader", "ObjectReader", "block_reader"]

Integers: TypeAlias = npt.NDArray[np.int64]

MESSAGES, ROUNDS = 256, 64
STAMP_WORDS = 4  # the next control message begins with its length, which is never 0
FRAME_BYTES = 16

FRAME = np.dtype([("can_id", "u4"), ("length", "u1"), ("padding", "u1", 3), ("word", "<i8")])
"""``struct can_frame``."""
HEADER = np.dtype(
    [
        # struct mmsghdr of a 64-bit system
        ("name", np.int64),
        ("name_length", np.int64),
        ("iov", np.int64),
        ("iov_length", np.int64),
        ("control", np.int64),
        ("control_length", np.int64),
        ("flags", np.int32),
        ("padding", np.int32),
        ("size", np.int64),  # an unsigned int and its padding
    ]
)
_libc = c_library()


@dataclass(frozen=True)
class Block:
    """Frames in the order in which they came, one row each.

    Attributes
    ----------
    t_ns : stamps [ns since 1970]
    can_ids : identifiers with flags
    lengths : 0 to 8
    words : the data bytes as a little-endian integer; those beyond the length are 0
    """

    t_ns: Integers
    can_ids: Integers
    lengths: Integers
    words: Integers

    def __len__(self) -> int:
        return len(self.t_ns)

    @classmethod
    def from_frames(cls, frames: Sequence[Received]) -> Block:
        """Return single received frames as a block."""
        t_ns, can_ids, lengths, data = zip(*frames, strict=True) if frames else ((), (), (), ())
        words = np.frombuffer(b"".join(data), "<i8").astype(np.int64)
        return cls(np.array(t_ns, np.int64), np.array(can_ids, np.int64), np.array(lengths, np.int64), words)

    @classmethod
    def joined(cls, blocks: Sequence[Block]) -> Block:
        """Return blocks joined into one."""
        if len(blocks) == 1:
            return blocks[0]
        if not blocks:
            return cls.from_frames(())
        return cls(
            np.concatenate([block.t_ns for block in blocks]),
            np.concatenate([block.can_ids for block in blocks]),
            np.concatenate([block.lengths for block in blocks]),
            np.concatenate([block.words for block in blocks]),
        )

    @cached_property
    def rows(self) -> dict[int, Integers]:
        """Rows of each identifier, in order."""
        if not len(self):
            return {}
        by_identifier = np.argsort(self.can_ids, kind="stable")
        ordered = self.can_ids[by_identifier]
        starts = [0, *(np.flatnonzero(ordered[1:] != ordered[:-1]) + 1).tolist()]
        ends = [*starts[1:], len(ordered)]
        return {int(ordered[a]): by_identifier[a:b] for a, b in zip(starts, ends, strict=True)}

    @property
    def records(self) -> Records:
        """The frames as records of `wire.frame.Frame`."""
        records = new_records(Frame, len(self))
        for name, column in zip(
            ("t_ns", "can_id", "length", "word"), (self.t_ns, self.can_ids, self.lengths, self.words), strict=True
        ):
            records[name] = column
        return records

    def data(self, row: int) -> bytes:
        """Return the eight data bytes of a row."""
        return int(self.words[row]).to_bytes(8, "little", signed=True)

    def frames(self, rows: Integers) -> list[Received]:
        """Return rows as single received frames."""
        columns = zip(self.t_ns[rows], self.can_ids[rows], self.lengths[rows], self.words[rows], strict=True)
        return [(int(t), int(can_id), int(length), word.tobytes()) for t, can_id, length, word in columns]


def block_reader(bus: OpenBus) -> BlockReader | ObjectReader:
    """Return the reader of an open bus."""
    return BlockReader(bus) if isinstance(bus, Client) else ObjectReader(bus)


class ObjectReader:
    """Receives from a bus without a socket; raises as `OpenBus.receive`."""

    def __init__(self, bus: OpenBus) -> None:
        self._bus = bus

    def receive(self) -> Block:
        """Return the frames of all pending messages; empty if there is no message."""
        return Block.from_frames(self._bus.receive())


class BlockReader:
    """Receives for a client; the client keeps `lost`, `malformed` and the bus's answers.

    Raises
    ------
    ImportError
        The system is not a 64-bit system.
    """

    def __init__(self, client: Client) -> None:
        if ctypes.sizeof(ctypes.c_void_p) != 8:
            raise ImportError("reading a bus in blocks needs a 64-bit system")
        self._client, self._ended = client, False
        self._buffer = np.empty((MESSAGES, MESSAGE_BYTES), np.uint8)  # the kernel allocates pages on first use
        self._frames = self._buffer.reshape(-1).view(FRAME)
        self._control = np.zeros((MESSAGES, CONTROL_WORDS), np.int64)
        self._vectors = np.zeros((MESSAGES, 2), np.int64)
        self._headers = np.zeros(MESSAGES, HEADER)
        each = np.arange(MESSAGES)
        self._vectors[:, 0] = self._buffer.ctypes.data + each * MESSAGE_BYTES
        self._vectors[:, 1] = MESSAGE_BYTES
        self._headers["iov"] = self._vectors.ctypes.data + each * self._vectors.strides[0]
        self._headers["iov_length"] = 1
        self._headers["control"] = self._control.ctypes.data + each * self._control.strides[0]

    def receive(self) -> Block:
        """Return the frames of all pending messages; empty if there is no message.

        Raises
        ------
        coulombus.wire.address.BusUnavailable
            As `Client.receive`.
        """
        blocks: list[Block] = []
        for _ in range(ROUNDS):  # bounded, so that a flood does not block the caller
            try:
                count = self._call()
            except OSError:
                if not blocks:
                    raise
                break  # what was received counts; the next call fails, too
            if count:
                blocks.append(self._block(count))
            if count < MESSAGES or self._ended:
                break
        return Block.joined(blocks)

    def _call(self) -> int:
        """Receive messages; return their number."""
        if self._ended:
            raise self._client.gone()
        headers = self._headers
        headers["control_length"] = self._control.strides[0]
        self._control[:] = 0
        place = ctypes.c_void_p(headers.ctypes.data)
        count: int = _libc.recvmmsg(self._client.fileno(), place, MESSAGES, socket.MSG_DONTWAIT, None)
        if count >= 0:
            return count
        number = ctypes.get_errno()
        if number in (errno.EAGAIN, errno.EINTR):
            return 0
        raise self._client.failure(OSError(number, os.strerror(number)))

    def _block(self, count: int) -> Block:
        sizes = self._headers["size"][:count] & 0xFFFFFFFF
        if not sizes.all():  # the other side has closed; messages before that are valid
            self._ended = True
            count = int(np.argmin(sizes > 0))
            sizes = sizes[:count]
        odd = (sizes % FRAME_BYTES != 0) | (self._headers["flags"][:count] & socket.MSG_TRUNC != 0)
        for row in np.flatnonzero(odd).tolist():
            self._client.take_other(self._buffer[row, : sizes[row]].tobytes())
        stamps = self._stamps(count)
        rows = np.flatnonzero(~odd)
        counts = sizes[rows] // FRAME_BYTES
        first = np.repeat(rows * (MESSAGE_BYTES // FRAME_BYTES) - np.cumsum(counts) + counts, counts)
        frames = self._frames[first + np.arange(len(first))]
        lengths = frames["length"].astype(np.int64)
        words = frames["word"].astype(np.int64) & LENGTH_MASKS[np.minimum(lengths, CAN_LENGTH)]
        block = Block(np.repeat(stamps[rows], counts), frames["can_id"].astype(np.int64), lengths, words)
        too_long = lengths > CAN_LENGTH
        if too_long.any():
            self._client.malformed += int(too_long.sum())
            block = Block(*(column[~too_long] for column in (block.t_ns, block.can_ids, lengths, block.words)))
        return block

    def _stamps(self, count: int) -> Integers:
        """Return the stamps of messages, 0 without a stamp; add lost frames to the client's count."""
        control: Any = self._control[:count]
        if (control[:, 1] == STAMP).all() and not control[:, STAMP_WORDS].any():  # the usual case: only a stamp
            alone: Integers = control[:, 2] * SECOND_NS + control[:, 3]
            return alone
        stamps = np.zeros(count, np.int64)
        dropped = np.full(count, -1)
        at = np.zeros(count, np.int64)
        each = np.arange(count)
        for _ in range(2):  # a stamp, and the socket's count of dropped frames
            kind = control[each, at + 1]
            value = control[each, at + 2]
            stamps = np.where(kind == STAMP, value * SECOND_NS + control[each, at + 3], stamps)
            dropped = np.where(kind == OVERFLOW, value & 0xFFFFFFFF, dropped)
            at = np.minimum((control[each, at] + 7) // 8, CONTROL_WORDS - 4)
        if len(counts := dropped[dropped >= 0]):
            self._client.lost = int(counts[-1])
        return stamps
