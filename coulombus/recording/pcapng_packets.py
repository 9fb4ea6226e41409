"""Decode the packets of a pcapng file as columns: stamps of any resolution, frames of link type 227."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.pcapng_blocks import LINKTYPE_CAN_SOCKETCAN
from coulombus.wire.frame import CAN_RTR_FLAG, FRAME, LENGTH_MASKS, Records

__all__ = ["BadPacketError", "Integers", "Interface", "Packets", "Words", "column", "decode_packets"]

Words: TypeAlias = npt.NDArray[np.uint32]
Integers: TypeAlias = npt.NDArray[np.int64]

HEAD = 28  # bytes of an enhanced packet block before the packet
CANFD_FDF = 0x04
NS = 1_000_000_000


class BadPacketError(Exception):
    """A packet before any interface: its `offset` in the file, and the problem (`what`)."""

    def __init__(self, offset: int, what: str) -> None:
        super().__init__(what)
        self.offset, self.what = offset, what


@dataclass(frozen=True)
class Interface:
    """An interface block: link type, time resolution as in the file (9: ns, 0x80 + n: 2^-n s),
    stamps' offset.
    """

    linktype: int
    resolution: int = 6
    offset_s: int = 0
    inside: bool = False
    """Whether its frames were on no bus."""
    name: str = ""


@dataclass(frozen=True)
class Packets:
    """The classical CAN frames of packets.

    `options`: (row of `frames`, first byte, end) in the file. `damaged`: (offset, problem) of undecodable packets.
    """

    frames: Records
    options: list[tuple[int, int, int]]
    damaged: list[tuple[int, str]]


def column(words: Words, at: Integers, order: str) -> Integers:
    """Return the words at `at`, in the section's byte order ("<" or ">")."""
    chosen = words[at]
    return (chosen.byteswap() if order == ">" else chosen).astype(np.int64)


def decode_packets(words: Words, at: Integers, order: str, interfaces: Sequence[Interface], earlier: int) -> Packets:
    """Decode the enhanced packet blocks that begin at the words `at`.

    Packets other than classical CAN frames are omitted, and so are damaged ones: inconsistent
    lengths, an undescribed interface, a stamp beyond 64 bits of nanoseconds.

    `earlier` is added to the interface's number for the frames' `source`.

    Raises
    ------
    BadPacketError
        No interface is described.
    """
    total, interface, captured = (column(words, at + i, order) for i in (1, 2, 5))
    described = len(interfaces)
    if not described:
        raise BadPacketError(4 * int(at[0]), f"a packet on interface {interface[0]} where 0 are described")
    torn = (captured + HEAD + 4 > total) | (interface >= described)
    damaged = []
    for bad in np.flatnonzero(torn).tolist():
        size = f"a packet of {captured[bad]} bytes in a block of {total[bad]}"
        damaged.append((4 * int(at[bad]), f"{size}, on interface {interface[bad]} where {described} are described"))
    at, total, interface, captured = at[~torn], total[~torn], interface[~torn], captured[~torn]
    last = len(words) - 1
    can_id = words[np.minimum(at + 7, last)].byteswap().astype(np.int64)
    flags = words[np.minimum(at + 8, last)].astype(np.int64)  # bytes: length, FD flags, two reserved
    length = flags & 0xFF
    sent = np.where(can_id & CAN_RTR_FLAG, 0, length)
    good = np.array([description.linktype == LINKTYPE_CAN_SOCKETCAN for description in interfaces])[interface]
    good &= (captured >= 8 + sent) & (length <= 8) & (flags & (CANFD_FDF << 8) == 0)

    frames = np.zeros(int(good.sum()), FRAME)
    at, sent = at[good], sent[good]
    frames["can_id"] = can_id[good]
    frames["length"] = length[good]
    frames["source"] = interface[good] + earlier
    low, high = words[np.minimum(at + 9, last)], words[np.minimum(at + 10, last)]
    frames["word"] = (low.astype(np.uint64) | high.astype(np.uint64) << np.uint64(32)).view(np.int64) & LENGTH_MASKS[
        sent
    ]
    stamped = np.ones(len(frames), bool)
    for number, description in enumerate(interfaces):
        rows = np.flatnonzero(interface[good] == number)
        if len(rows):
            frames["t_ns"][rows], late = _stamps_ns(words, at[rows], order, description)
            stamped[rows[list(late)]] = False
            damaged += [(4 * int(at[rows[row]]), what) for row, what in late.items()]
    frames, at, captured, total = frames[stamped], at[stamped], captured[good][stamped], total[good][stamped]

    options = HEAD + captured + (-captured % 4)
    ends = total - 4
    rows = np.flatnonzero(ends > options)
    begin, end = 4 * at[rows] + options[rows], 4 * at[rows] + ends[rows]
    return Packets(frames, list(zip(rows.tolist(), begin.tolist(), end.tolist(), strict=True)), sorted(damaged))


def _stamps_ns(words: Words, at: Integers, order: str, description: Interface) -> tuple[Integers, dict[int, str]]:
    """Return the stamps, and row and problem of the invalid ones."""
    high, low = column(words, at + 3, order), column(words, at + 4, order)
    base_ns = description.offset_s * NS
    scale = {9: 1, 6: 1000, 3: 1_000_000}.get(description.resolution)
    if scale is not None and abs(base_ns) < 1 << 62 and (int(high.max()) + 1) << 32 < (1 << 62) // scale:
        return (high << 32 | low) * scale + base_ns, {}
    ticks_s = 2 ** (description.resolution & 0x7F) if description.resolution & 0x80 else int(10**description.resolution)
    stamps, late = np.zeros(len(at), np.int64), {}
    for row, (upper, lower) in enumerate(zip(high.tolist(), low.tolist(), strict=True)):
        stamp = (upper << 32 | lower) * NS // ticks_s + base_ns
        if -(1 << 63) <= stamp < 1 << 63:
            stamps[row] = stamp
        else:
            late[row] = f"a packet's stamp is {stamp // NS} s after 1970, expected at most 2^63 ns"
    return stamps, late
