"""Cases 2.13 to 2.18, S.1 to S.3 and S.6 to S.11: segmented transfers (CiA 301, section 7.2.4)."""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.cases.sdo import short, upload_segment, written_and_read
from coulombus.conformance.cases.sdo_block import block_segments, need_block
from coulombus.conformance.tester.objects import long_object, long_objects, volatile
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.running import running
from coulombus.conformance.tester.sdo_checks import (
    LENGTHS,
    judge_out_of_turn,
    must_abort,
    reads_back,
    refused,
    shown,
    text_object,
    untouched,
)
from coulombus.conformance.tester.unit import Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.sdo_frames import head

__all__: list[str] = []


@case("2.13")
def segments_of_a_short_object(unit: Unit) -> str:
    """Read 1000h:00 by segments if the server wants them.

    After an expedited response a segment request is an error, or ignored.
    """
    answer = unit.sdo.initiate_upload(0x1000, 0)
    if not answer[0] & 0x02:
        data, last = unit.sdo.upload_segment(0x1000, 0, 0)
        if len(data) != 4 or not last:
            raise CaseFailed(f"1000h:00 by segments has {len(data)} bytes in the first segment")
        return "by segments"
    try:
        answer = unit.sdo.request(b"\x60" + bytes(7), 0x1000, 0, "unknown command")
    except TransferAborted as abort:
        return f"expedited; the segment request: {abort.code:08X}h"
    except NoAnswer:
        unit.read(0x1000, 0)
        return "expedited; the segment request is ignored"
    raise CaseFailed(f"a segment request after an expedited upload is answered with {answer.hex(' ')}")


@case("2.14", index=0x100C)
@case("2.15", index=0x1017)
def segmented_download(unit: Unit, index: int) -> None:
    """Write a short object with one segment and read it back."""
    written_and_read(unit, index, 1234, lambda data: unit.sdo.download_segmented(index, 0, data))


@case("2.16")
def segmented_upload(unit: Unit) -> str:
    """Read the shortest long object by segments.

    Toggle bits and length are checked with every segment.
    """
    variable, _ = long_object(unit)
    data, segmented = unit.sdo.upload_as(variable.index, variable.subindex)
    if not segmented:
        raise CaseFailed(f"{where(variable.index, variable.subindex)} came expedited, with {len(data)} bytes")
    return f"{where(variable.index, variable.subindex)}, {len(data)} bytes"


@case("2.17")
def wrong_toggle(unit: Unit) -> str:
    """Repeat the toggle bit in an upload: abort, and the transfer is over."""
    variable, _ = long_object(unit)
    index, subindex = variable.index, variable.subindex
    unit.sdo.initiate_upload(index, subindex)
    try:
        unit.sdo.request(b"\x70" + bytes(7), index, subindex, "upload segment of")
    except TransferAborted as abort:
        code = unit.judge(abort)
    else:
        raise CaseFailed(f"upload of {where(index, subindex)}: a first segment request with toggle bit 1 is answered")
    try:
        answer = unit.sdo.request(b"\x60" + bytes(7), index, subindex, "unknown command")
    except TransferAborted:
        return f"{code:08X}h"
    except NoAnswer:
        unit.read(0x1000, 0)
        return f"{code:08X}h; a further segment request is ignored"
    raise CaseFailed(f"the transfer goes on after its abort: {answer.hex(' ')}")


@case("2.18")
def all_long_objects(unit: Unit) -> str:
    """Read every object of more than four bytes twice; compare both readings, and a default of the EDS."""
    objects = long_objects(unit)
    for v, content in objects:
        if unit.read(v.index, v.subindex) != content and not running(unit, [v]):
            raise CaseFailed(f"{where(v.index, v.subindex)} reads differently the second time")
        default = unit.default(v)
        expected = encode(v, default) if isinstance(default, str | bytes) else b""
        if expected and v.access == "const" and content.rstrip(b"\0") != expected.rstrip(b"\0"):
            raise CaseFailed(f"{where(v.index, v.subindex)} is {content!r}; the EDS says {expected!r}")
    return ", ".join(f"{where(v.index, v.subindex)} ({len(content)} bytes)" for v, content in objects)


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
    """Abort a segmented upload: no response; the next segment request is an error, or ignored."""
    variable, _ = long_object(unit, 8)
    unit.sdo.initiate_upload(variable.index, variable.subindex)
    unit.sdo.abort(variable.index, variable.subindex)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(unit.sdo_tx):
        raise CaseFailed("the server answers the client's abort")
    try:
        answer = unit.sdo.request(b"\x60" + bytes(7), variable.index, variable.subindex, "unknown command")
    except TransferAborted as abort:
        return judge_out_of_turn(unit, abort)
    except NoAnswer:
        unit.read(0x1000, 0)
        return "ignored"
    raise CaseFailed(f"the transfer goes on after the client's abort: {answer.hex(' ')}")


@case("S.6")
def another_length(unit: Unit) -> str:
    """Indicate 10 bytes and send 7, then 14: both are aborted."""
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
    """Write 1017h expedited and a text by segments, without their sizes: both are accepted.

    The number of expedited bytes is then unspecified. A server that uses all four refuses them for
    1017h, but not for an object of four bytes.
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
    """Write an object of four bytes with its own value, without its size.

    Return its index and sub-index.
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
    requests = []
    for start in range(0, len(text), 7):
        part = text[start : start + 7]
        command = (start // 7 & 1) << 4 | (7 - len(part)) << 1 | (start + 7 >= len(text))
        requests.append(bytes((command,)) + part.ljust(7, b"\0"))
    return requests


@case("S.8")
def after_the_last_segment(unit: Unit) -> str:
    """Complete an upload and a download by segments: a further segment is an error, or ignored."""
    variable, content = long_object(unit)
    unit.sdo.upload_as(variable.index, variable.subindex)
    toggle = -(-len(content) // 7) & 1
    how = must_abort(unit, upload_segment(toggle), "a segment request after the last segment")
    index, subindex, _, text = text_object(unit)
    unit.sdo.download_segmented(index, subindex, text)
    toggle = -(-len(text) // 7) & 1
    last = must_abort(unit, bytes((toggle << 4 | 1,)) + text[:7], "a download segment after the last")
    return "; ".join(dict.fromkeys((how, last)))


@case("S.9")
def new_initiation(unit: Unit) -> str:
    """Begin another transfer during an upload: it is executed, or aborted with either object; the old one is over."""
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
            judge_out_of_turn(unit, abort)
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
    """Check the reserved bytes of download responses: 0."""
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
