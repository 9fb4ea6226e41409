"""Walk from block to block of a pcapng file, and decode its packets, both compiled.

Stamps may have any resolution; frames are of link type 227.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import Entry, inlined, kernel
from coulombus.kernels.records import Records, new_records
from coulombus.recording.pcapng_blocks import (
    HOST_INTERFACE,
    IF_NAME,
    IF_TSOFFSET,
    IF_TSRESOL,
    LINKTYPE_CAN_SOCKETCAN,
    iter_options,
)
from coulombus.wire.frame import CAN_RTR_FLAG, LENGTH_MASKS, Frame

__all__ = [
    "BAD",
    "END",
    "FULL",
    "SECTION",
    "BadPacketError",
    "Integers",
    "Interface",
    "Packets",
    "Words",
    "column",
    "decode_packets",
    "read_interface",
    "walk",
]

Words: TypeAlias = npt.NDArray[np.uint32]
Integers: TypeAlias = npt.NDArray[np.int64]

END, FULL, SECTION, BAD = range(4)
"""Why a walk stops: the words end, `offsets` is full, a section header, no block."""

HEAD = 28  # bytes of an enhanced packet block before the packet
CANFD_FDF = 0x04
NS = 1_000_000_000
OTHER, BUS, INSIDE, TORN = range(4)
"""What a packet is, as its interface says (one of the first three) or its lengths."""


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

    @property
    def role(self) -> int:
        """What its packets are."""
        if self.linktype != LINKTYPE_CAN_SOCKETCAN:
            return OTHER
        return INSIDE if self.inside else BUS


def read_interface(body: bytes, byte_order: str, *, own: bool) -> Interface:
    """Return the interface of a block's body, 8 bytes at least.

    Parameters
    ----------
    own : whether it is of a recording of this project, whose stamps count from its own time 0
    """
    linktype, resolution, offset_s, name = struct.unpack_from(byte_order + "H", body)[0], 6, 0, ""
    for code, value in iter_options(body[8:], byte_order):
        if code == IF_TSRESOL and len(value) == 1:
            resolution = value[0]
        elif code == IF_TSOFFSET and len(value) == 8:
            offset_s = 0 if own else struct.unpack(byte_order + "q", value)[0]
        elif code == IF_NAME:
            name = value.decode(errors="replace")
    return Interface(linktype, resolution, offset_s, name == HOST_INTERFACE, name)


@dataclass(frozen=True)
class Packets:
    """The classical CAN frames of packets, in the file's order."""

    frames: Records
    inside: Records
    """Those that were on no bus."""
    options: list[tuple[int, int, int]]
    """(number of `frames` before the packet, first byte, end) in the file; also of a packet with an invalid stamp."""
    damaged: list[tuple[int, str]]
    """(offset, problem) of undecodable packets."""

    @property
    def stamps_ns(self) -> Integers:
        """The stamps of all these frames."""
        return np.concatenate((self.frames["t_ns"], self.inside["t_ns"]))


@inlined
def swapped(word: int) -> int:
    """Return a word of 32 bits with its bytes in the other order."""
    return (word & 0xFF) << 24 | (word & 0xFF00) << 8 | (word >> 8) & 0xFF00 | word >> 24


@kernel
def walk(words: Words, at: int, swap: int, offsets: Integers) -> tuple[int, int, int]:
    """Note where blocks begin (in words), from `at` on.

    Return their number, the stop position, and its reason.
    """
    size = words.shape[0]
    count = 0
    while True:
        if size - at < 3:
            return count, at, END
        if np.int64(words[at]) == 0x0A0D0D0A:
            return count, at, SECTION
        if count == offsets.shape[0]:
            return count, at, FULL
        length: Any = np.int64(words[at + 1])
        if swap:
            length = swapped(length)
        if length < 12 or length % 4 != 0 or length > 0x1000000:
            return count, at, BAD
        after = at + length // 4
        if after > size:
            return count, at, END
        if words[after - 1] != words[at + 1]:
            return count, at, BAD
        offsets[count] = at
        count += 1
        at = after


def column(words: Words, at: Integers, byte_order: str) -> Integers:
    """Return the words at `at`, in the section's byte order ("<" or ">")."""
    selection = words[at]
    return (selection.byteswap() if byte_order == ">" else selection).astype(np.int64)


@inlined
def _word(words: Words, at: int, swap: int) -> int:
    word: Any = np.int64(words[at])
    return swapped(word) if swap else word


@kernel
def _unpack(
    words: Words,
    at: Integers,
    swap: int,
    roles: Integers,
    kinds: Integers,
    frames: Records,
    inside: Records,
    options: Integers,
) -> tuple[int, int, int]:
    """Decode the packets at `at`; their stamps are left in units of their interfaces.

    Return the number of frames, of frames inside, and of packets with options. `kinds` gets what each
    packet is, `options` the row of the next frame, the options' first word and their end.
    """
    count = count_inside = count_options = 0
    for packet in range(at.shape[0]):
        begin = at[packet]
        total = _word(words, begin + 1, swap)
        if total < HEAD + 4:
            kinds[packet] = TORN
            continue
        interface, captured = _word(words, begin + 2, swap), _word(words, begin + 5, swap)
        if captured + HEAD + 4 > total or interface >= roles.shape[0]:
            kinds[packet] = TORN
            continue
        if roles[interface] == OTHER or captured < 8:
            continue
        head: Any = np.int64(words[begin + 7])
        can_id = swapped(head)
        flags: Any = np.int64(words[begin + 8])  # bytes: length, FD flags, two reserved
        length = flags & 0xFF
        sent = 0 if can_id & CAN_RTR_FLAG else length
        if length > 8 or captured < 8 + sent or flags & (CANFD_FDF << 8):
            continue
        word: Any = np.int64(words[begin + 9]) if sent > 0 else 0
        if sent > 4:
            word |= np.int64(words[begin + 10]) << 32
        if roles[interface] == BUS:
            frame = frames[count]
            count += 1
        else:
            frame = inside[count_inside]
            count_inside += 1
        kinds[packet] = roles[interface]
        frame.t_ns = _word(words, begin + 3, swap) << 32 | _word(words, begin + 4, swap)
        frame.can_id = can_id
        frame.length = length
        frame.word = word & LENGTH_MASKS[sent]
        frame.source = interface
        first = (HEAD + captured + 3) // 4
        if first < total // 4 - 1:
            option = options[count_options]
            option[0], option[1], option[2] = count - (roles[interface] == BUS), begin + first, begin + total // 4 - 1
            count_options += 1
    return count, count_inside, count_options


_ENTRY = Entry(_unpack)


def decode_packets(
    words: Words, at: Integers, byte_order: str, interfaces: Sequence[Interface], earlier: int
) -> Packets:
    """Decode the enhanced packet blocks that begin at the words `at`.

    Packets other than classical CAN frames are omitted, and so are damaged ones: inconsistent
    lengths, an undescribed interface, a stamp beyond 64 bits of nanoseconds.

    `earlier` is added to the interface's number for the frames' `source`.

    Raises
    ------
    BadPacketError
        No interface is described.
    """
    described = len(interfaces)
    if not described:
        number = column(words, at[:1] + 2, byte_order)[0]  # or what else stands there in a block without it
        raise BadPacketError(4 * int(at[0]), f"a packet on interface {number} where 0 are described")
    roles = np.array([description.role for description in interfaces])
    kinds, options = np.zeros(len(at), np.int64), np.zeros((len(at), 3), np.int64)
    decoded = new_records(Frame, len(at)), new_records(Frame, len(at) if INSIDE in roles else 0)
    counts = _ENTRY(words, at, int(byte_order == ">"), roles, kinds, *decoded, options)
    frames, inside = (rows[:count].view(np.ndarray) for rows, count in zip(decoded, counts[:2], strict=True))
    options = options[: counts[2]]
    damaged = []
    for torn in at.compress(kinds == TORN).tolist():
        damaged.append(
            (4 * torn, _torn(column(words, np.arange(torn, min(torn + 6, len(words))), byte_order), described))
        )
    late, late_inside = _stamp(frames, interfaces), _stamp(inside, interfaces)
    for kind, problems in ((BUS, late), (INSIDE, late_inside)):
        places = at.compress(kinds == kind) if problems else at
        damaged += [(4 * int(places[row]), what) for row, what in problems.items()]
    if late or late_inside:
        options[:, 0] -= np.searchsorted(list(late), options[:, 0])
        frames, inside = np.delete(frames, list(late)), np.delete(inside, list(late_inside))
    frames["source"] += earlier
    inside["source"] += earlier
    return Packets(frames, inside, [(row, 4 * begin, 4 * end) for row, begin, end in options.tolist()], sorted(damaged))


def _torn(head: Integers, described: int) -> str:
    """Return the problem of a packet block, from its first words."""
    total = int(head[1])
    if total < HEAD + 4:
        return f"a packet's block of {total} bytes, expected {HEAD + 4} at least"
    return f"a packet of {head[5]} bytes in a block of {total}, on interface {head[2]} where {described} are described"


def _stamp(frames: Records, interfaces: Sequence[Interface]) -> dict[int, str]:
    """Convert the frames' stamps to ns; return rows, rising, and problems of the invalid ones."""
    usual = all(description.resolution == 9 and not description.offset_s for description in interfaces)
    if not len(frames) or (usual and frames["t_ns"].min() >= 0):
        return {}
    late = {}
    for number in np.unique(frames["source"]).tolist():
        rows = np.flatnonzero(frames["source"] == number)
        frames["t_ns"][rows], problems = _stamps_ns(frames["t_ns"][rows], interfaces[number])
        late.update({int(rows[row]): what for row, what in problems.items()})
    return dict(sorted(late.items()))


def _stamps_ns(ticks: Integers, description: Interface) -> tuple[Integers, dict[int, str]]:
    """Return the stamps, and row and problem of the invalid ones; `ticks` has their 64 bits."""
    base_ns = description.offset_s * NS
    scale = {9: 1, 6: 1000, 3: 1_000_000}.get(description.resolution)
    if scale is not None and abs(base_ns) < 1 << 62 and np.all(ticks.view(np.uint64) < (1 << 62) // scale):
        return ticks * scale + base_ns, {}
    ticks_s = 2 ** (description.resolution & 0x7F) if description.resolution & 0x80 else int(10**description.resolution)
    stamps, late = np.zeros(len(ticks), np.int64), {}
    for row, tick in enumerate(ticks.view(np.uint64).tolist()):
        stamp = tick * NS // ticks_s + base_ns
        if -(1 << 63) <= stamp < 1 << 63:
            stamps[row] = stamp
        else:
            late[row] = f"a packet's stamp is {stamp // NS} s after 1970, expected at most 2^63 ns"
    return stamps, late
