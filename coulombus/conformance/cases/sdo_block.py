"""Cases 2.19 to 2.27 and B.1 to B.14: block transfers (CiA 301, section 7.2.4.2.9 on)."""

from __future__ import annotations

from coulombus.conformance.cases.sdo import written_and_read
from coulombus.conformance.tester.objects import READ_ONLY, long_object, long_objects
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.running import running
from coulombus.conformance.tester.sdo_checks import must_abort, reads_back, refused, shown, text_object
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import Abort
from coulombus.eds.sdo_frames import crc16, head

__all__ = ["block_segments", "need_block"]

STANDSTILL_MS = 2500
"""Longer than the usual time-out of a server's transfer."""


def need_block(unit: Unit) -> None:
    """Require block transfers: a server that aborts them, with any code, does not support them, which is allowed."""
    try:
        unit.sdo.initiate_block_upload(0x1000, 0, crc=False)
    except TransferAborted as abort:
        text = f"the server refuses block transfers ({abort.code:08X}h), which are optional"
        raise NotApplicable(f"{text} (CiA 301, 7.2.4)") from None
    unit.sdo.abort(0x1000, 0)


@case("2.19")
def short_upload(unit: Unit) -> None:
    """Read 1000h:00 by block transfer and expedited: the same."""
    need_block(unit)
    data, _ = unit.sdo.block_upload(0x1000, 0, crc=False)
    if data != unit.read(0x1000, 0):
        raise CaseFailed(f"1000h:00 by block transfer is {data.hex(' ')}")


@case("2.20", index=0x100C, crc=False)
@case("2.21", index=0x1017, crc=False)
@case("2.24", index=0x100C, crc=True)
@case("2.25", index=0x1017, crc=True)
def short_download(unit: Unit, index: int, crc: bool) -> str | None:
    """Write a short object by block transfer and read it back."""
    unit.need_writable(index)
    need_block(unit)
    agreed: list[bool] = []
    written_and_read(unit, index, 1234, lambda data: agreed.append(unit.sdo.block_download(index, 0, data, crc=crc)))
    return "the server has no CRC" if crc and not agreed[0] else None


@case("2.22", crc=False)
@case("2.23", crc=True)
def long_upload(unit: Unit, crc: bool) -> str:
    """Read the shortest and the longest long object by block transfer and by segments: the same."""
    need_block(unit)
    objects = sorted(long_objects(unit), key=lambda pair: len(pair[1]))
    remark = ""
    for variable, content in (objects[0], objects[-1]):
        data, agreed = unit.sdo.block_upload(variable.index, variable.subindex, crc=crc)
        if data != content and not running(unit, [variable]):
            raise CaseFailed(f"{where(variable.index, variable.subindex)} differs between block transfer and segments")
        remark = f"{where(variable.index, variable.subindex)}, {len(data)} bytes"
        remark += ", the server has no CRC" if crc and not agreed else ""
    return remark


@case("2.26")
def wrong_block_size(unit: Unit) -> str:
    """Request an upload in blocks of 128 segments."""
    need_block(unit)
    variable, _ = long_object(unit)
    return refused_size(unit, variable.index, variable.subindex, 128)


def refused_size(unit: Unit, index: int, subindex: int, size: int) -> str:
    """Request an upload in blocks of an impossible size: abort."""
    try:
        unit.sdo.initiate_block_upload(index, subindex, crc=False, size=size)
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    unit.sdo.abort(index, subindex)
    raise CaseFailed(f"a block upload of {where(index, subindex)} with {size} segments a block is taken")


@case("2.27")
def wrong_sequence(unit: Unit) -> str:
    """Acknowledge segment 128 of a block: abort."""
    need_block(unit)
    variable, _ = long_object(unit)
    index, subindex = variable.index, variable.subindex
    unit.sdo.initiate_block_upload(index, subindex, crc=False)
    unit.sdo.send(b"\xa3" + bytes(7))
    unit.sdo.read_block(index, subindex, 127)
    unit.sdo.acknowledge(128, 127)
    try:
        unit.sdo.response(index, subindex, "end of block upload of")
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    raise CaseFailed(f"block upload of {where(index, subindex)}: an acknowledge of segment 128 is taken")


def begin(unit: Unit, at_least: int, size: int) -> tuple[int, int, bytes, int | None, bool]:
    """Begin a block upload with CRC of a long object.

    Return index, sub-index, its bytes, the indicated length, the CRC.
    """
    need_block(unit)
    variable, content = long_object(unit, at_least)
    index, subindex = variable.index, variable.subindex
    crc, size_said = unit.sdo.initiate_block_upload(index, subindex, crc=True, size=size)
    unit.sdo.send(b"\xa3" + bytes(7))
    return index, subindex, content, size_said, crc


def same(index: int, subindex: int, data: bytes, content: bytes) -> None:
    """Fail unless an upload equals the segmented one."""
    if data != content:
        raise CaseFailed(f"{where(index, subindex)} is {data!r} by block transfer, {content!r} by segments")


@case("B.1")
def repetition(unit: Unit) -> None:
    """Acknowledge one segment less than received: the last one is repeated as segment 1 of the next block."""
    index, subindex, content, size_said, crc = begin(unit, 15, 2)
    block, _ = unit.sdo.read_block(index, subindex, 2)
    segments = block[:1]
    unit.sdo.acknowledge(1, 127)
    block, last = unit.sdo.read_block(index, subindex, 127)
    if not last:
        raise CaseFailed(f"{where(index, subindex)}: the last segment is not marked")
    segments += block
    unit.sdo.acknowledge(len(block), 127)
    same(index, subindex, unit.sdo.end_block_upload(index, subindex, segments, crc=crc, said=size_said), content)


@case("B.2")
def changing_size(unit: Unit) -> None:
    """Request blocks of 1 segment, then 2, then 127: each block has this size."""
    index, subindex, content, size_said, crc = begin(unit, 15, 1)
    segments: list[bytes] = []
    last = False
    for size, following in ((1, 2), (2, 127), (127, 127)):
        if last:
            break
        block, last = unit.sdo.read_block(index, subindex, size)
        segments += block
        unit.sdo.acknowledge(len(block), following)
    same(index, subindex, unit.sdo.end_block_upload(index, subindex, segments, crc=crc, said=size_said), content)


@case("B.3")
def single_segments(unit: Unit) -> None:
    """Read a long object in blocks of one segment."""
    need_block(unit)
    variable, content = long_object(unit)
    data, _ = unit.sdo.block_upload(variable.index, variable.subindex, crc=True, size=1)
    same(variable.index, variable.subindex, data, content)


@case("B.4")
def size_zero(unit: Unit) -> str:
    """Request an upload in blocks of 0 segments."""
    need_block(unit)
    variable, _ = long_object(unit)
    return refused_size(unit, variable.index, variable.subindex, 0)


@case("B.5")
def aborted(unit: Unit) -> None:
    """Abort a block upload after its first segment; the next upload works."""
    index, subindex, content, _, _ = begin(unit, 5, 1)
    unit.sdo.read_block(index, subindex, 1)
    unit.sdo.abort(index, subindex)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(unit.sdo_tx):
        raise CaseFailed("the server answers the client's abort")
    same(index, subindex, unit.read(index, subindex), content)


def block_segments(text: bytes) -> list[bytes]:
    """Return the data of a text's segments."""
    return [text[start : start + 7].ljust(7, b"\0") for start in range(0, len(text), 7)]


@case("B.6")
def block_download(unit: Unit) -> str:
    """Write a text by block transfer with CRC, and read it by segments."""
    need_block(unit)
    index, subindex, _, text = text_object(unit)
    agreed = unit.sdo.block_download(index, subindex, text, crc=True)
    reads_back(unit, index, subindex, text)
    return where(index, subindex) + ("" if agreed else ", the server has no CRC")


@case("B.7")
def wrong_crc(unit: Unit) -> str:
    """Write a text by block transfer with a wrong CRC: abort, and the old text stays."""
    need_block(unit)

    def transfer(index: int, subindex: int, text: bytes) -> None:
        agreed, _ = unit.sdo.initiate_block_download(index, subindex, len(text), crc=True)
        unit.sdo.abort(index, subindex)
        if not agreed:
            raise NotApplicable("the server has no CRC")
        unit.sdo.block_download(index, subindex, text, crc=True, wrong_crc=True)

    return refused(unit, transfer, "a block download with a wrong CRC")


@case("B.8")
def lost_segment(unit: Unit) -> None:
    """Omit a segment of the first block: the server acknowledges those before it, and accepts the others again."""
    need_block(unit)
    index, subindex, _, text = text_object(unit)
    crc, size = unit.sdo.initiate_block_download(index, subindex, len(text), crc=True)
    if size < 3:
        unit.sdo.abort(index, subindex)
        raise NotApplicable(f"the server's blocks have {size} segments")
    segments = block_segments(text)
    first = segments[:size]
    for number, segment in enumerate(first, 1):
        if number != 2:
            unit.sdo.stream(bytes((number | 0x80 * (number == len(segments)),)) + segment)
    good, size = unit.sdo.block_acknowledged(index, subindex)
    if good != 1:
        raise CaseFailed(f"the server acknowledges segment {good} although segment 2 is missing")
    position = good
    while position < len(segments):
        unit.pause(unit.timing.quiet_ns)  # a server that acknowledges at the gap may do so again
        unit.pop_frames(unit.sdo_tx)
        for number, segment in enumerate(segments[position : position + size], 1):
            unit.sdo.stream(bytes((number | 0x80 * (position + number == len(segments)),)) + segment)
        good, size = unit.sdo.block_acknowledged(index, subindex)
        if good == 0:
            raise CaseFailed("the server does not take the segments that it asked for again")
        position += good
    unit.sdo.end_block_download(index, subindex, len(text), crc16(text) if crc else 0)
    reads_back(unit, index, subindex, text, " after a repetition")


@case("B.9")
def another_length(unit: Unit) -> str:
    """Indicate more bytes than follow: abort, and the old text stays."""
    need_block(unit)

    def transfer(index: int, subindex: int, text: bytes) -> None:
        crc, _ = unit.sdo.initiate_block_download(index, subindex, len(text), crc=True)
        unit.sdo.send(b"\x81" + text[:7])
        unit.sdo.block_acknowledged(index, subindex)
        unit.sdo.end_block_download(index, subindex, 7, crc16(text[:7]) if crc else 0)

    return refused(unit, transfer, "7 bytes of which more were said")


@case("B.10")
def to_read_only(unit: Unit) -> str:
    """Begin a block download to 1000h."""
    need_block(unit)
    if unit.has(0x1000) and unit.variable(0x1000).access not in READ_ONLY:
        raise NotApplicable("1000h is writable in the EDS")
    try:
        unit.sdo.block_download(0x1000, 0, bytes(4), crc=False, optional=(Abort.COMMAND,))
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    raise CaseFailed("1000h:00 took a block download")


@case("B.11")
def threshold(unit: Unit) -> str:
    """A threshold one byte below the object's size: a block transfer.

    A threshold of the object's size: block, segmented or expedited.
    """
    need_block(unit)
    variable, content = long_object(unit)
    index, subindex, size = variable.index, variable.subindex, len(content)
    if size > 255:
        raise NotApplicable(f"the shortest long object, {where(index, subindex)}, has more than 255 bytes")
    answer = unit.sdo.request(head(0xA0, index, subindex, bytes((127, size - 1))), index, subindex, "block upload of")
    if answer[0] >> 5 != 6:
        text = f"of {size} bytes comes by another protocol; the threshold is {size - 1}"
        raise CaseFailed(f"{where(index, subindex)} {text}")
    unit.sdo.abort(index, subindex)
    answer = unit.sdo.request(head(0xA0, index, subindex, bytes((127, size))), index, subindex, "block upload of")
    if answer[0] >> 5 == 6:
        unit.sdo.abort(index, subindex)
        return "the server stays with the block transfer"
    data, toggle, last = b"", 0, False
    while not last and len(data) <= size:
        segment, last = unit.sdo.upload_segment(index, subindex, toggle)
        data, toggle = data + segment, toggle ^ 0x10
    same(index, subindex, data, content)
    return "the server changes the protocol"


@case("B.12")
def after_the_end(unit: Unit) -> str:
    """End a block upload: no response, nothing later, and an acknowledge is an error, or ignored."""
    need_block(unit)
    variable, _ = long_object(unit)
    unit.sdo.block_upload(variable.index, variable.subindex, crc=True)
    unit.pause(STANDSTILL_MS * MS)
    frames = unit.pop_frames(unit.sdo_tx)
    if frames:
        raise CaseFailed(f"the server sends {frames[0].data.hex(' ')} after the end of a block upload")
    return must_abort(unit, b"\xa2\x01\x7f" + bytes(5), "an acknowledge after the end of a block upload")


@case("B.13")
def out_of_turn(unit: Unit) -> None:
    """In a block upload: a second start, an end before the end, impossible acknowledges.

    Each is aborted, or ignored.
    """
    for what, request in (
        ("a second start", b"\xa3" + bytes(7)),
        ("the end before the end", b"\xa1" + bytes(7)),
        ("an acknowledge of segment 2 of 1", b"\xa2\x02\x01" + bytes(5)),
        ("an acknowledge with block size 0", b"\xa2\x01\x00" + bytes(5)),
        ("an acknowledge with block size 128", b"\xa2\x01\x80" + bytes(5)),
    ):
        index, subindex, *_ = begin(unit, 15, 1)
        unit.sdo.read_block(index, subindex, 1)
        must_abort(unit, request, f"block upload of {where(index, subindex)}: {what}", (index, subindex))
    index, subindex, *_ = begin(unit, 5, 127)
    segments, _ = unit.sdo.read_block(index, subindex, 127)
    acknowledge = bytes((0xA2, len(segments), 127)) + bytes(5)
    unit.sdo.request(acknowledge, index, subindex, "block upload of")
    what = f"block upload of {where(index, subindex)}: an acknowledge after the last"
    must_abort(unit, acknowledge, what, (index, subindex))


@case("B.14")
def number_zero(unit: Unit) -> str:
    """Send segment 0, then segment 2 as the last: abort, or neither is acknowledged.

    The old text stays.
    """
    need_block(unit)
    index, subindex, before, text = text_object(unit)
    unit.sdo.initiate_block_download(index, subindex, len(text), crc=False)
    unit.sdo.stream(b"\x00" + text[:7])
    unit.sdo.stream(b"\x82" + text[7:14])
    how = "ignored"
    try:
        good, _ = unit.sdo.block_acknowledged(index, subindex)
    except TransferAborted as abort:
        how = f"{unit.judge(abort):08X}h"
    except NoAnswer:
        pass
    else:
        if good:
            raise CaseFailed(f"segment {good} is acknowledged; 0 and 2 were sent")
    unit.sdo.abort(index, subindex)
    if shown(unit.read(index, subindex)) != shown(before):
        raise CaseFailed(f"{where(index, subindex)} took a segment without a number")
    return how
