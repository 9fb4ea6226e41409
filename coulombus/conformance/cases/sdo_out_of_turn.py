"""Own cases B.11 to B.13 and S.6 to S.12: requests out of turn, lengths that are not what was said,
two servers at once.
"""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.cases.sdo import short
from coulombus.conformance.cases.sdo_block import need_block
from coulombus.conformance.cases.sdo_wrong import (
    LENGTHS,
    begin,
    block_segments,
    reads_back,
    same,
    shown,
    text_object,
    untouched,
)
from coulombus.conformance.tester.objects import REFUSED, long_object, volatile
from coulombus.conformance.tester.pdo_setup import INVALID
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import Abort
from coulombus.eds.sdo_frames import head

__all__: list[str] = []

STANDSTILL_MS = 2500
"""Longer than a usual server waits before it aborts a transfer."""


def must_abort(unit: Unit, request: bytes, what: str, place: tuple[int, int] = (0x1000, 0)) -> str:
    """Send a request that has no place here: it is aborted or ignored; return which.

    CiA 301 names abort codes, but does not say that a server answers what is not for it; so it may
    be silent, if it serves afterwards. `place` is the open transfer's object.
    """
    try:
        answer = unit.sdo.request(request, 0, 0, "unknown command")
    except TransferAborted as abort:
        return "ignored" if abort.code == Abort.TIMEOUT else f"{unit.judge(abort):08X}h"
    except NoAnswer:
        unit.sdo.abort(*place)
        unit.read(0x1000, 0)
        return "ignored"
    raise CaseFailed(f"{what} is answered with {answer.hex(' ')}")


def upload_segment(toggle: int) -> bytes:
    """Return the request of a segment."""
    return bytes((0x60 | toggle << 4,)) + bytes(7)


@case("B.11")
def threshold(unit: Unit) -> str:
    """A threshold of one byte less than the object has: a block transfer.

    Of as many: block, segments or expedited.
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
    """End a block upload: no answer, nothing later either, and an acknowledge is an error, or
    ignored.
    """
    need_block(unit)
    variable, _ = long_object(unit)
    unit.sdo.block_upload(variable.index, variable.subindex, crc=True)
    unit.pause(STANDSTILL_MS * MS)
    frames = unit.take(unit.sdo_tx)
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


@case("S.6")
def another_length(unit: Unit) -> str:
    """Say 10 bytes and send 7, then 14: both are aborted."""
    index, subindex, before, text = text_object(unit)
    done = []
    for last in (b"\x01" + text[:7], b"\x11" + text[7:14]):
        try:
            unit.sdo.request(head(0x21, index, subindex, b"\x0a"), index, subindex, "download to")
            if last[0] & 0x10:
                unit.sdo.request(b"\x00" + text[:7], index, subindex, "download segment to")
            unit.sdo.request(last, index, subindex, "download segment to")
        except TransferAborted as abort:
            done.append(f"{unit.judge(abort, LENGTHS):08X}h")
        else:
            raise CaseFailed(f"{where(index, subindex)} took {14 if last[0] & 0x10 else 7} bytes; 10 were said")
    return ", ".join(done) + untouched(unit, index, subindex, before)


@case("S.7")
def without_size(unit: Unit) -> str:
    """Write 1017h expedited and a text by segments, without telling their lengths: both are taken.

    Expedited, the bytes are of an unspecified number then. A server that takes all four refuses
    them for 1017h, but not for an object of four bytes.
    """
    done = []
    if unit.has(0x1017) and unit.variable(0x1017).access == "rw":
        unit.undo_later(0x1017, 0, unit.read(0x1017))
        unit.dirty = True
        request = head(0x22, 0x1017, 0, (2500).to_bytes(4, "little"))
        try:
            unit.sdo.request(request, 0x1017, 0, "download to")
        except TransferAborted as abort:
            code = unit.judge(abort, LENGTHS)
            done.append(f"1017h:00 refuses four bytes ({code:08X}h), {_four_bytes(unit)} takes them")
        else:
            if unit.number(0x1017) != 2500:
                raise CaseFailed(f"1017h:00 is {unit.number(0x1017)} after 2500 was written without a length")
            done.append("1017h:00")
    try:
        index, subindex, _, text = text_object(unit)
    except NotApplicable:
        if not done:
            raise
        return done[0]
    unit.sdo.request(head(0x20, index, subindex), index, subindex, "download to")
    for request in segments(text):
        unit.sdo.request(request, index, subindex, "download segment to")
    reads_back(unit, index, subindex, text, " after a download without a length")
    return ", ".join((*done, where(index, subindex)))


def _four_bytes(unit: Unit) -> str:
    """Write an object of four bytes with its own value, without telling its length.

    Return where it is.
    """
    variable = short(unit, (4,))
    place = (variable.index, variable.subindex)
    try:
        unit.sdo.request(head(0x22, *place, unit.read(*place)), *place, "download to")
    except TransferAborted as abort:
        raise CaseFailed(
            f"without a length neither 1017h:00 nor {where(*place)}, of four bytes, is taken: {abort}"
        ) from None
    return where(*place)


def segments(text: bytes) -> list[bytes]:
    """Return the segment requests that write a text."""
    found = []
    for start in range(0, len(text), 7):
        part = text[start : start + 7]
        command = (start // 7 & 1) << 4 | (7 - len(part)) << 1 | (start + 7 >= len(text))
        found.append(bytes((command,)) + part.ljust(7, b"\0"))
    return found


@case("S.8")
def after_the_last_segment(unit: Unit) -> None:
    """Go through an upload and a download by segments: one segment more is an error, or ignored."""
    variable, content = long_object(unit)
    unit.sdo.upload_as(variable.index, variable.subindex)
    toggle = -(-len(content) // 7) & 1
    must_abort(unit, upload_segment(toggle), "a segment request after the last segment")
    index, subindex, _, text = text_object(unit)
    unit.sdo.download_segmented(index, subindex, text)
    toggle = -(-len(text) // 7) & 1
    must_abort(unit, bytes((toggle << 4 | 1,)) + text[:7], "a download segment after the last")


@case("S.9")
def new_initiation(unit: Unit) -> str:
    """Begin another transfer in the middle of an upload: it is served, or aborted in the name of
    either; the old one is over.
    """
    index, subindex, value = volatile(unit)
    unit.undo_later(index, subindex, unit.read(index, subindex))
    data = encode(unit.variable(index, subindex), value)
    ways: tuple[tuple[str, Callable[[], object]], ...] = (
        ("upload", lambda: unit.read(0x1000, 0)),
        ("download", lambda: unit.put(index, subindex, data)),
    )
    done = []
    for name, begin_other in ways:
        variable, _ = long_object(unit, 8)
        old = (variable.index, variable.subindex)
        unit.sdo.initiate_upload(*old)
        unit.sdo.upload_segment(*old, 0)
        try:
            with unit.sdo.named(old):
                begin_other()
        except TransferAborted as abort:
            unit.judge(abort)
            begin_other()  # now that both are over
            done.append(f"a new {name} is aborted, naming {where(abort.index, abort.subindex)}")
            continue
        must_abort(unit, upload_segment(1), f"a segment of the upload that a new {name} has replaced", old)
        done.append(f"a new {name} is served")
    return ", ".join(done)


@case("S.10")
def other_direction(unit: Unit) -> None:
    """A download segment in an upload, and an upload segment in a download: aborted or ignored, and
    nothing is written.
    """
    variable, _ = long_object(unit, 8)
    place = (variable.index, variable.subindex)
    unit.sdo.initiate_upload(*place)
    must_abort(unit, bytes(8), "a download segment in an upload", place)
    index, subindex, before, text = text_object(unit)
    size = len(text).to_bytes(4, "little")
    unit.sdo.request(head(0x21, index, subindex, size), index, subindex, "download to")
    must_abort(unit, upload_segment(0), "an upload segment in a download", (index, subindex))
    if shown(unit.read(index, subindex)) != shown(before):
        raise CaseFailed(f"{where(index, subindex)} has changed although the download was aborted")


@case("S.11")
def reserved_bytes(unit: Unit) -> str | None:
    """Look at the bytes of the responses to downloads that are reserved: 0."""
    index, subindex, _, text = text_object(unit)

    def zero(request: bytes, first: int) -> bytes:
        answer = unit.sdo.request(request, index, subindex, "download to")
        if any(answer[first:]):
            raise CaseFailed(f"reserved bytes of a response are not 0: {answer.hex(' ')}")
        return answer

    size = len(text).to_bytes(4, "little")
    zero(head(0x21, index, subindex, size), 4)
    for request in segments(text):
        zero(request, 1)
    try:
        need_block(unit)
        unit.sdo.initiate_block_download(index, subindex, len(text), crc=False)
    except NotApplicable as reason:
        return str(reason)
    unit.sdo.abort(index, subindex)
    answer = zero(head(0xC2, index, subindex, size), 5)
    parts = block_segments(text)
    if answer[4] < len(parts):
        unit.sdo.abort(index, subindex)
        return f"the server's blocks have {answer[4]} segments"
    for number, part in enumerate(parts[:-1], 1):
        unit.sdo.stream(bytes((number,)) + part)
    unit.sdo.stream(bytes((0x80 | len(parts),)) + parts[-1])
    answer = unit.sdo.response(index, subindex, "block download to")
    if any(answer[3:]):
        raise CaseFailed(f"reserved bytes of a response are not 0: {answer.hex(' ')}")
    zero(bytes((0xC1 | (-len(text) % 7) << 2,)) + bytes(7), 1)
    return None


@case("S.12")
def two_servers(unit: Unit) -> str:
    """Give the first free further server identifiers, and read by both servers at once: neither
    disturbs the other.

    Before that a restricted identifier is refused, and then another one, as the server is valid.
    """
    found = [index for index in range(0x1201, 0x1280) if unit.has(index, 1) and unit.has(index, 2)]
    found = [i for i in found if all(unit.variable(i, sub).access not in ("ro", "const") for sub in (1, 2))]
    found = [i for i in found if unit.number(i, 1) & INVALID]
    if not found:
        raise NotApplicable("the EDS has no further SDO server whose identifiers can be written")
    index, (request_id, response_id) = found[0], IDENTIFIERS
    unit.refused(index, 1, RESTRICTED_ID, REFUSED)
    unit.write(index, 2, response_id)
    unit.write(index, 1, request_id)
    unit.refused(index, 1, request_id + 2, REFUSED)
    variable, content = long_object(unit, 8)
    came = {unit.sdo_tx: b"", response_id: b""}
    for request in (head(0x40, variable.index, variable.subindex), upload_segment(0), upload_segment(1)):
        for rx, tx in ((unit.sdo_rx, unit.sdo_tx), (request_id, response_id)):
            unit.send(rx, request)
            answer = unit.expect(tx, f"response of the server with request {rx:03X}h").data
            if len(answer) != 8:
                raise CaseFailed(f"a response of server {rx:03X}h has {len(answer)} bytes, expected 8")
            if answer[0] == 0x80:
                raise CaseFailed(f"two uploads at once: server {rx:03X}h aborts with {answer.hex(' ')}")
            if request[0] >> 5 == 3:
                came[tx] += answer[1 : 8 - (answer[0] >> 1 & 7)]
    unit.sdo.abort(variable.index, variable.subindex)
    unit.send(request_id, head(0x80, variable.index, variable.subindex, b"\0\0\0\x08"))
    if any(data != content[:14] for data in came.values()):
        raise CaseFailed("two uploads of one object at once bring different bytes")
    return where(index, 1)


RESTRICTED_ID = 0x6E1
IDENTIFIERS = (0x6D8, 0x6D9)
"""Of no service in the pre-defined connection set, and not restricted."""
