"""Own cases B.1 to B.10, B.14 and S.1 to S.5: what block and segmented transfers do when something
goes wrong.
"""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.cases.sdo_block import need_block, refused_size
from coulombus.conformance.tester.objects import NOT_NOW, READ_ONLY, long_object, long_texts
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import Abort
from coulombus.eds.reader import Variable
from coulombus.eds.sdo_frames import crc16, head
from coulombus.wire.bus_link import RTR

__all__: list[str] = []

TEXT = b"Coulombus writes a text of more than one segment, and of a length that is not theirs."
SHORTEST = 15
"""Bytes of three segments: a text that is shorter tells nothing about segments."""

LENGTHS = (Abort.LENGTH, Abort.TOO_LONG, Abort.TOO_SHORT, Abort.MEMORY, Abort.GENERAL, *NOT_NOW)
"""How a device refuses a text for its length."""


def begin(unit: Unit, at_least: int, size: int) -> tuple[int, int, bytes, int | None, bool]:
    """Begin a block upload with CRC of a long object.

    Return index, sub-index, its bytes, the said length, the CRC.
    """
    need_block(unit)
    variable, content = long_object(unit, at_least)
    index, subindex = variable.index, variable.subindex
    crc, said = unit.sdo.initiate_block_upload(index, subindex, crc=True, size=size)
    unit.sdo.send(b"\xa3" + bytes(7))
    return index, subindex, content, said, crc


def same(index: int, subindex: int, data: bytes, content: bytes) -> None:
    """Fail unless an upload brought what a segmented one does."""
    if data != content:
        raise CaseFailed(f"{where(index, subindex)} is {data!r} by block transfer, {content!r} by segments")


@case("B.1")
def repetition(unit: Unit) -> None:
    """Acknowledge one segment less than came: the last one comes again, as segment 1 of the next
    block.
    """
    index, subindex, content, said, crc = begin(unit, 15, 2)
    block, _ = unit.sdo.read_block(index, subindex, 2)
    segments = block[:1]
    unit.sdo.acknowledge(1, 127)
    block, last = unit.sdo.read_block(index, subindex, 127)
    if not last:
        raise CaseFailed(f"{where(index, subindex)}: the last segment is not marked")
    segments += block
    unit.sdo.acknowledge(len(block), 127)
    same(index, subindex, unit.sdo.end_block_upload(index, subindex, segments, crc=crc, said=said), content)


@case("B.2")
def changing_size(unit: Unit) -> None:
    """Ask for blocks of 1 segment, then 2, then 127: each block has so many."""
    index, subindex, content, said, crc = begin(unit, 15, 1)
    segments: list[bytes] = []
    last = False
    for size, following in ((1, 2), (2, 127), (127, 127)):
        if last:
            break
        block, last = unit.sdo.read_block(index, subindex, size)
        segments += block
        unit.sdo.acknowledge(len(block), following)
    same(index, subindex, unit.sdo.end_block_upload(index, subindex, segments, crc=crc, said=said), content)


@case("B.3")
def single_segments(unit: Unit) -> None:
    """Read a long object in blocks of one segment."""
    need_block(unit)
    variable, content = long_object(unit)
    data, _ = unit.sdo.block_upload(variable.index, variable.subindex, crc=True, size=1)
    same(variable.index, variable.subindex, data, content)


@case("B.4")
def size_zero(unit: Unit) -> str:
    """Ask for an upload in blocks of 0 segments."""
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
    if unit.take(unit.sdo_tx):
        raise CaseFailed("the server answers the client's abort")
    same(index, subindex, unit.read(index, subindex), content)


def text_object(unit: Unit) -> tuple[int, int, bytes, bytes]:
    """Return a writable string: index, sub-index, its bytes, which are restored later, and a text
    that it has room for.

    An EDS does not tell how long a string may be. So it is tried, once in a run: `TEXT`, beginnings
    of it, and as many bytes as the string has.
    """
    reason = ""
    for variable in long_texts(unit):
        index, subindex = variable.index, variable.subindex
        before = unit.read(index, subindex)
        unit.undo_later(index, subindex, before)
        unit.dirty = True
        if (index, subindex) not in unit.rooms:
            unit.rooms[index, subindex] = _room(unit, variable, before)
        if unit.rooms[index, subindex] >= SHORTEST:
            return index, subindex, before, TEXT[: unit.rooms[index, subindex]]
        reason = f"{where(index, subindex)} has no room for {SHORTEST} bytes"
    raise NotApplicable(f"the device has no writable string of three segments: {reason}")


def _room(unit: Unit, variable: Variable, before: bytes) -> int:
    """Return how many bytes of `TEXT` the string holds, 0 for fewer than `SHORTEST`.

    It has them no longer when this returns.
    """
    index, subindex = variable.index, variable.subindex
    own: tuple[int, ...] = (len(before),) if SHORTEST <= len(before) < len(TEXT) else ()
    for length in (len(TEXT), *own, 57, 29, SHORTEST):
        try:
            unit.sdo.download_segmented(index, subindex, TEXT[:length])
        except TransferAborted as abort:
            if abort.code not in LENGTHS:
                raise
            continue
        held: bool = shown(unit.read(index, subindex)) == TEXT[:length]
        unit.sdo.download_segmented(index, subindex, before)
        if held:
            return length
    return 0


def shown(text: bytes) -> bytes:
    """Return a string without the zeros behind it, by which a string of fixed length may be filled
    up.
    """
    return text.rstrip(b"\0")


def untouched(unit: Unit, index: int, subindex: int, before: bytes) -> str:
    """Return what an aborted download has left of the old text: nothing to be said, or that a part
    was written.

    CiA 301 does not say that a download is written at once: a device of little memory writes a long
    one part by part.
    """
    if shown(unit.read(index, subindex)) == shown(before):
        return ""
    return f"; {where(index, subindex)} has a part of what was aborted"


def refused(unit: Unit, transfer: Callable[[int, int, bytes], object], what: str, *, silence: bool = False) -> str:
    """Let `transfer` write a text wrongly: it is aborted (or, with `silence`, ignored).

    Return the code.
    """
    index, subindex, before, text = text_object(unit)
    try:
        transfer(index, subindex, text)
    except TransferAborted as abort:
        how = "ignored" if silence and abort.code == Abort.TIMEOUT else f"{unit.judge(abort):08X}h"
    except NoAnswer:
        if not silence:
            raise
        unit.sdo.abort(index, subindex)
        how = "ignored"
    else:
        raise CaseFailed(f"{where(index, subindex)} took {what}")
    return how + untouched(unit, index, subindex, before)


def block_segments(text: bytes) -> list[bytes]:
    """Return the data of a text's segments."""
    return [text[start : start + 7].ljust(7, b"\0") for start in range(0, len(text), 7)]


def reads_back(unit: Unit, index: int, subindex: int, text: bytes, after: str = "") -> None:
    """Fail unless a string has the text that was written to it."""
    if shown(unit.read(index, subindex)) != text:
        raise CaseFailed(f"{where(index, subindex)} does not read back{after}")


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
    """Leave a segment of the first block out: the server acknowledges those before it, and takes
    the others again.
    """
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
        unit.take(unit.sdo_tx)
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
    """Say more bytes than follow: abort, and the old text stays."""
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
        unit.sdo.block_download(0x1000, 0, bytes(4), crc=False)
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    raise CaseFailed("1000h:00 took a block download")


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


@case("S.1")
def long_download(unit: Unit) -> str:
    """Write a text by segments and read it back."""
    index, subindex, _, text = text_object(unit)
    unit.sdo.download_segmented(index, subindex, text)
    reads_back(unit, index, subindex, text)
    return where(index, subindex)


@case("S.2")
def toggle_in_download(unit: Unit) -> str:
    """Repeat the toggle bit in a download: it is aborted, or ignored."""

    def transfer(index: int, subindex: int, text: bytes) -> None:
        request = head(0x21, index, subindex, len(text).to_bytes(4, "little"))
        unit.sdo.request(request, index, subindex, "download to")
        for segment in (text[:7], text[7:14]):
            unit.sdo.request(b"\x00" + segment, index, subindex, "download segment to")

    return refused(unit, transfer, "a repeated toggle bit", silence=True)


@case("S.3")
def client_abort(unit: Unit) -> str:
    """Abort a segmented upload: no answer; the next segment request is an error, or ignored."""
    variable, _ = long_object(unit, 8)
    unit.sdo.initiate_upload(variable.index, variable.subindex)
    unit.sdo.abort(variable.index, variable.subindex)
    unit.pause(unit.timing.quiet_ns)
    if unit.take(unit.sdo_tx):
        raise CaseFailed("the server answers the client's abort")
    try:
        answer = unit.sdo.request(b"\x60" + bytes(7), variable.index, variable.subindex, "unknown command")
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    except NoAnswer:
        unit.read(0x1000, 0)
        return "ignored"
    raise CaseFailed(f"the transfer goes on after the client's abort: {answer.hex(' ')}")


@case("S.4")
def short_request(unit: Unit) -> None:
    """Send requests of 0, 1 and 7 bytes; then the server still serves."""
    for length in (0, 1, 7):
        unit.send(unit.sdo_rx, b"\x40\0\x10\0\0\0\0"[:length])
        unit.pause(unit.timing.quiet_ns // 3)
    unit.flush()
    unit.read(0x1000, 0)


@case("S.5")
def remote_request(unit: Unit) -> None:
    """Send a remote frame with the request's identifier: no answer."""
    unit.flush()
    unit.send(unit.sdo_rx | RTR, length=8)
    unit.pause(unit.timing.quiet_ns)
    if unit.take(unit.sdo_tx):
        raise CaseFailed("a remote frame on the SDO request's identifier is answered")
    unit.read(0x1000, 0)
