"""Own cases B.11 to B.13 and S.6 to S.12: requests out of turn, lengths that are not what was said, two servers at once."""

from __future__ import annotations

from collections.abc import Callable

from conformance.objects_of import long_object, volatile
from conformance.own_transfers import TEXT, begin, same, text_object
from conformance.pdo_setup import INVALID
from conformance.registry import case
from conformance.sdo_block import need_block
from conformance.sdo_client import head
from conformance.unit import MS, Unit, encode
from conformance.verdict import CaseFailed, NoAnswer, NotApplicable, SdoAborted, where
from eds.cia301 import Abort

__all__: list[str] = []

REFUSED = (Abort.VALUE, Abort.DEVICE_STATE, Abort.ACCESS, Abort.GENERAL)
TOO_MANY = (Abort.LENGTH, Abort.TOO_LONG, Abort.GENERAL)
TOO_FEW = (Abort.LENGTH, Abort.TOO_SHORT, Abort.GENERAL)
STANDSTILL_MS = 2500
"""Longer than a usual server waits before it aborts a transfer."""


def must_abort(unit: Unit, request: bytes, what: str) -> int:
    """Send a request that the server has to abort; return the code."""
    try:
        answer = unit.sdo.request(request, 0, 0, "unknown command")
    except SdoAborted as abort:
        return unit.judge(abort)
    except NoAnswer:
        raise NoAnswer(f"{what}: neither a response nor an abort") from None
    raise CaseFailed(f"{what} is answered with {answer.hex(' ')}")


def upload_segment(toggle: int) -> bytes:
    """Return the request of a segment."""
    return bytes((0x60 | toggle << 4,)) + bytes(7)


@case("B.11")
def threshold(unit: Unit) -> str:
    """A threshold of one byte less than the object has: a block transfer. Of as many: block, segments or expedited."""
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
def after_the_end(unit: Unit) -> None:
    """End a block upload: no answer, nothing later either, and an acknowledge is an error."""
    need_block(unit)
    variable, _ = long_object(unit)
    unit.sdo.block_upload(variable.index, variable.subindex, crc=True)
    unit.pause(STANDSTILL_MS * MS)
    frames = unit.take(unit.sdo_tx)
    if frames:
        raise CaseFailed(f"the server sends {frames[0].data.hex(' ')} after the end of a block upload")
    must_abort(unit, b"\xa2\x01\x7f" + bytes(5), "an acknowledge after the end of a block upload")


@case("B.13")
def out_of_turn(unit: Unit) -> None:
    """In a block upload: a second start, an end before the end, impossible acknowledges. Each is aborted."""
    for what, request in (
        ("a second start", b"\xa3" + bytes(7)),
        ("the end before the end", b"\xa1" + bytes(7)),
        ("an acknowledge of segment 2 of 1", b"\xa2\x02\x01" + bytes(5)),
        ("an acknowledge with block size 0", b"\xa2\x01\x00" + bytes(5)),
        ("an acknowledge with block size 128", b"\xa2\x01\x80" + bytes(5)),
    ):
        index, subindex, *_ = begin(unit, 15, 1)
        unit.sdo.read_block(index, subindex, 1)
        must_abort(unit, request, f"block upload of {where(index, subindex)}: {what}")
    index, subindex, *_ = begin(unit, 5, 127)
    segments, _ = unit.sdo.read_block(index, subindex, 127)
    acknowledge = bytes((0xA2, len(segments), 127)) + bytes(5)
    unit.sdo.request(acknowledge, index, subindex, "block upload of")
    must_abort(unit, acknowledge, f"block upload of {where(index, subindex)}: an acknowledge after the last")


@case("S.6")
def another_length(unit: Unit) -> str:
    """Say 10 bytes and send 7, then 14: both are aborted, and the old text stays."""
    index, subindex, before = text_object(unit)
    done = []
    for last, codes in ((b"\x01" + TEXT[:7], TOO_FEW), (b"\x11" + TEXT[7:14], TOO_MANY)):
        unit.sdo.request(head(0x21, index, subindex, b"\x0a"), index, subindex, "download to")
        try:
            if last[0] & 0x10:
                unit.sdo.request(b"\x00" + TEXT[:7], index, subindex, "download segment to")
            unit.sdo.request(last, index, subindex, "download segment to")
        except SdoAborted as abort:
            done.append(f"{unit.judge(abort, codes):08X}h")
        else:
            raise CaseFailed(f"{where(index, subindex)} took {14 if last[0] & 0x10 else 7} bytes; 10 were said")
        if unit.read(index, subindex) != before:
            raise CaseFailed(f"{where(index, subindex)} has changed although the length was wrong")
    return ", ".join(done)


@case("S.7")
def without_size(unit: Unit) -> str:
    """Write 1017h expedited and a text by segments, without telling their lengths: both are taken."""
    done = []
    if unit.has(0x1017) and unit.variable(0x1017).access == "rw":
        unit.undo_later(0x1017, 0, unit.read(0x1017))
        unit.dirty = True
        unit.sdo.request(head(0x22, 0x1017, 0, (2500).to_bytes(4, "little")), 0x1017, 0, "download to")
        if unit.number(0x1017) != 2500:
            raise CaseFailed(f"1017h:00 is {unit.number(0x1017)} after 2500 was written without a length")
        done.append("1017h:00")
    try:
        index, subindex, _ = text_object(unit)
    except NotApplicable:
        if not done:
            raise
        return done[0]
    unit.sdo.request(head(0x20, index, subindex), index, subindex, "download to")
    unit.sdo.request(b"\x00" + TEXT[:7], index, subindex, "download segment to")
    unit.sdo.request(b"\x15" + TEXT[7:12] + b"\0\0", index, subindex, "download segment to")
    if unit.read(index, subindex) != TEXT[:12]:
        raise CaseFailed(f"{where(index, subindex)} does not read back after a download without a length")
    return ", ".join((*done, where(index, subindex)))


@case("S.8")
def after_the_last_segment(unit: Unit) -> None:
    """Go through an upload and a download by segments: one segment more is an error."""
    variable, content = long_object(unit)
    unit.sdo.upload_as(variable.index, variable.subindex)
    toggle = -(-len(content) // 7) & 1
    must_abort(unit, upload_segment(toggle), "a segment request after the last segment")
    index, subindex, _ = text_object(unit)
    unit.sdo.download_segmented(index, subindex, TEXT[:7])
    must_abort(unit, b"\x11" + TEXT[:7], "a download segment after the last")


@case("S.9")
def new_initiation(unit: Unit) -> None:
    """Begin another transfer in the middle of an upload: it is served, and the old one is over."""
    index, subindex, value = volatile(unit)
    unit.undo_later(index, subindex, unit.read(index, subindex))
    data = encode(unit.variable(index, subindex), value)
    ways: tuple[tuple[str, Callable[[], object]], ...] = (
        ("upload", lambda: unit.read(0x1000, 0)),
        ("download", lambda: unit.put(index, subindex, data)),
    )
    for name, begin_other in ways:
        variable, _ = long_object(unit, 8)
        unit.sdo.initiate_upload(variable.index, variable.subindex)
        unit.sdo.upload_segment(variable.index, variable.subindex, 0)
        try:
            begin_other()
        except SdoAborted as abort:
            raise CaseFailed(f"a new {name} in the middle of an upload: {abort}") from None
        must_abort(unit, upload_segment(1), f"a segment of the upload that a new {name} has replaced")


@case("S.10")
def other_direction(unit: Unit) -> None:
    """A download segment in an upload, and an upload segment in a download: aborted, and nothing is written."""
    variable, _ = long_object(unit, 8)
    unit.sdo.initiate_upload(variable.index, variable.subindex)
    must_abort(unit, b"\x00" + TEXT[:7], "a download segment in an upload")
    index, subindex, before = text_object(unit)
    unit.sdo.request(head(0x21, index, subindex, b"\x0a"), index, subindex, "download to")
    must_abort(unit, upload_segment(0), "an upload segment in a download")
    if unit.read(index, subindex) != before:
        raise CaseFailed(f"{where(index, subindex)} has changed although the download was aborted")


@case("S.11")
def reserved_bytes(unit: Unit) -> str | None:
    """Look at the bytes of the responses to downloads that are reserved: 0."""
    index, subindex, _ = text_object(unit)

    def zero(request: bytes, first: int) -> bytes:
        answer = unit.sdo.request(request, index, subindex, "download to")
        if any(answer[first:]):
            raise CaseFailed(f"reserved bytes of a response are not 0: {answer.hex(' ')}")
        return answer

    zero(head(0x21, index, subindex, b"\x07"), 4)
    zero(b"\x01" + TEXT[:7], 1)
    try:
        need_block(unit)
    except NotApplicable as reason:
        return str(reason)
    zero(head(0xC2, index, subindex, b"\x07"), 5)
    zero(b"\x81" + TEXT[:7], 3)
    zero(b"\xc1" + bytes(7), 1)
    return None


@case("S.12")
def two_servers(unit: Unit) -> str:
    """Give the first free further server identifiers, and read by both servers at once: neither disturbs the other.

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
