"""SDO transfers of a client as generators: they yield messages to send, and receive the responses.

A transfer knows no bus and no clock; `host.sdo.sdo_client` drives it, for one node or for several nodes
in parallel. A `SdoStep` has the messages to the server, eight bytes each. The generator then receives the
server's next message.

The tester of `coulombus conformance` checks each bit of a server, and can send wrong messages on purpose.
This client accepts deviations of real devices, as long as the data are unambiguous.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import NamedTuple, TypeAlias, TypeVar

from coulombus.eds.cia301 import Abort, abort_text
from coulombus.eds.sdo_frames import crc16, head, named, where
from coulombus.host.errors import AnswerUntrusted, NodeMissing, SdoAborted

__all__ = [
    "ABORT",
    "APART",
    "BLOCK",
    "DuplicateNodeId",
    "Progress",
    "SdoProtocolError",
    "SdoRefused",
    "SdoSilent",
    "SdoStep",
    "Transfer",
    "abort",
    "download",
    "upload",
]

T = TypeVar("T")


class SdoStep(NamedTuple):
    """Messages to the server, and whether the transfer waits for a response; if not, it receives b"".

    Attributes
    ----------
    initiates : whether the message initiates a transfer
    """

    messages: Sequence[bytes] = ()
    waits: bool = True
    initiates: bool = False


Transfer: TypeAlias = Generator[SdoStep, bytes, T]
Progress: TypeAlias = Callable[[int, int], None]
"""Called with the number of bytes so far, and the total; 0: the total is unknown."""

ABORT = 0x80
BLOCK = 127
"""Largest number of segments in a block."""
LONG = 7 * BLOCK
"""Size above which block transfer is used, if the server supports it."""
DOMAINS = frozenset((0x1021, 0x1F20, 0x1F22, 0x1F50))
"""Objects that are long by their definition (CiA 301, CiA 302-3): their read begins as a block transfer."""
SWITCH = 255
"""Protocol switch threshold: a server answers a block upload of an object up to this size as an ordinary one."""
MOST_BYTES = 1 << 26
"""Largest accepted length of an upload."""
MOST_UNTOLD = 1 << 22
"""Largest accepted length of an upload that does not indicate its length."""
APART = (
    "take one off the bus, and give the other another id (coulombus lss); or another SDO client asks it now (sdo, scan)"
)
"""Remedy for two devices with the same node id."""
REPEATS = 5
"""Largest number of repeated requests in a row for the same segments."""


class SdoSilent(NodeMissing):
    """The server did not answer in time."""


class SdoRefused(SdoAborted):
    """The server aborted the transfer; `code` is its abort code."""

    def __init__(self, what: str, index: int, subindex: int, code: int) -> None:
        super().__init__(f"{what} {where(index, subindex)} was aborted: {abort_text(code)}")
        self.index, self.subindex, self.code = index, subindex, code


class SdoProtocolError(AnswerUntrusted):
    """Invalid SDO response.

    Attributes
    ----------
    code : abort code that the client sends
    reason : the error of the response, without the object's name
    """

    def __init__(self, text: str, code: int, reason: str = "") -> None:
        super().__init__(text)
        self.code, self.reason = code, reason or text


class DuplicateNodeId(SdoProtocolError):
    """Two devices have one node id."""

    exit_status = 3


def abort(index: int, subindex: int, code: int = Abort.GENERAL) -> bytes:
    """Return the message that ends a transfer."""
    return head(ABORT, index, subindex, int(code).to_bytes(4, "little"))


def _nothing(done: int, total: int) -> None:
    pass


class _Exchange:
    """The server's responses in one transfer, with checks."""

    def __init__(self, what: str, index: int, subindex: int) -> None:
        self.what, self.index, self.subindex = what, index, subindex
        self.refusal = b""

    def next(self, *messages: bytes, initiates: bool = False) -> Transfer[bytes]:
        """Send messages; return the server's next one. An abort raises `SdoRefused`."""
        answer = yield SdoStep(messages, initiates=initiates)
        while answer[0] == ABORT and named(answer) not in ((self.index, self.subindex), (0, 0)):
            answer = yield SdoStep()  # an abort of an earlier transfer
        if answer == self.refusal:  # the same abort delivered twice, while this client tries another protocol
            answer = yield SdoStep()
        if answer[0] == ABORT:
            self.refusal = answer
            raise SdoRefused(self.what, self.index, self.subindex, int.from_bytes(answer[4:8], "little"))
        return answer

    def first(self, message: bytes) -> Transfer[bytes]:
        """Initiate the transfer; ignore answers to an earlier request (another object)."""
        answer = yield from self.next(message, initiates=True)
        for _ in range(BLOCK):
            if named(answer) == (self.index, self.subindex) and answer[0] >> 5 in (2, 3, 5, 6):
                return answer
            answer = yield from self.next()
        raise self.protocol_error(f"{answer.hex(' ')} is no answer", Abort.COMMAND)

    def no_segment(self, answer: bytes, text: str) -> SdoProtocolError:
        """Return the error for an answer that is not that of a segment."""
        if answer[0] >> 5 in (2, 3) and named(answer) != (self.index, self.subindex):
            return DuplicateNodeId(
                f"an answer to an SDO of {where(*named(answer))} came within the {self.what} "
                f"{where(self.index, self.subindex)}: two devices have this node id: {APART}",
                Abort.GENERAL,
            )
        return self.protocol_error(f"command {answer[0]:02X}h {text}", Abort.COMMAND)

    def protocol_error(self, text: str, code: int) -> SdoProtocolError:
        return SdoProtocolError(f"{self.what} {where(self.index, self.subindex)}: {text}", code, text)


def upload(
    index: int,
    subindex: int,
    *,
    most: int = MOST_BYTES,
    block: bool = True,
    unsized: Callable[[bytes], bytes] = bytes,
    progress: Progress = _nothing,
) -> Transfer[bytes]:
    """Read an object: expedited or by segments, as the server chooses; long ones by block transfer, if the
    server supports it. A read of `DOMAINS` begins as a block transfer, that of another object when its size is known.

    Parameters
    ----------
    most : largest accepted number of bytes
    block : whether block transfer may be used for a long object
    unsized : returns the object's bytes from the four of an expedited answer without a length

    Raises
    ------
    SdoRefused
        the server aborted the transfer
    SdoProtocolError
        the server's answer is not valid, or the object has more bytes than `most` or than indicated
    """
    exchange = _Exchange("upload of", index, subindex)
    answer = b""
    if block and index in DOMAINS:
        block = False  # asked for here: what comes instead is the server's choice
        try:
            answer = yield from exchange.first(head(0xA4, index, subindex, bytes((BLOCK, SWITCH))))
        except SdoRefused as refused:
            if refused.code != Abort.COMMAND:
                raise
        if answer and answer[0] >> 5 == 6:
            return (yield from _blocks(exchange, answer, most, progress))
    answer = answer or (yield from exchange.first(head(0x40, index, subindex)))
    if answer[0] >> 5 == 2 and answer[0] & 0x03 == 0x01 and block:
        size = int.from_bytes(answer[4:8], "little")
        if LONG < size <= most:
            yield SdoStep((abort(index, subindex),), waits=False)  # aborts the segmented transfer
            try:
                content = yield from _block_upload(exchange, most, progress)
                if content is not None:
                    return content
            except SdoRefused as refused:
                if refused.code != Abort.COMMAND:
                    raise
            answer = yield from exchange.first(head(0x40, index, subindex))
            if answer[0] >> 5 == 6:  # the block upload's late answer: the first answer had been delivered twice
                answer = yield from exchange.next()
    if answer[0] & 0xE3 == 0x42:
        return unsized(answer[4:8])
    return (yield from _ordinary(exchange, answer, most, progress))


def _ordinary(exchange: _Exchange, answer: bytes, max_bytes: int, progress: Progress) -> Transfer[bytes]:
    """Continue an upload after the server's first answer, expedited or by segments."""
    if answer[0] >> 5 != 2:
        raise exchange.protocol_error(f"command {answer[0]:02X}h is no upload response", Abort.COMMAND)
    if answer[0] & 0x02:
        return answer[4 : 8 - (answer[0] >> 2 & 3)]
    size = int.from_bytes(answer[4:8], "little") if answer[0] & 0x01 else None
    if size is not None and size > max_bytes:
        raise exchange.protocol_error(f"it has {size} bytes, {max_bytes} are the most expected", Abort.MEMORY)
    limit = size if size is not None else min(max_bytes, MOST_UNTOLD)
    data, toggle, last = b"", 0, False
    while not last:
        answer = yield from exchange.next(bytes((0x60 | toggle,)) + bytes(7))
        if answer[0] >> 5 != 0:
            raise exchange.no_segment(answer, "is no segment")
        if answer[0] & 0x10 != toggle:
            raise exchange.protocol_error("the toggle bit did not alternate", Abort.TOGGLE)
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
        last, toggle = bool(answer[0] & 0x01), toggle ^ 0x10
        if len(data) > limit:
            raise exchange.protocol_error(f"it continues beyond {limit} bytes, the most expected", Abort.TOO_LONG)
        progress(len(data), size or 0)
    if size is not None and size != len(data):
        raise exchange.protocol_error(f"{size} bytes were told, {len(data)} came", Abort.LENGTH)
    return data


def _block_upload(exchange: _Exchange, max_bytes: int, progress: Progress) -> Transfer[bytes | None]:
    """Return the object's bytes; None if the server begins a segmented upload.

    Then the server lacks block transfer, or its answer to the previous request was delivered twice.
    """
    answer = yield from exchange.first(head(0xA4, exchange.index, exchange.subindex, bytes((BLOCK, 0))))
    if answer[0] >> 5 == 2:
        exchange.refusal = abort(exchange.index, exchange.subindex, Abort.COMMAND)  # may still arrive
        return None
    return (yield from _blocks(exchange, answer, max_bytes, progress))


def _blocks(exchange: _Exchange, answer: bytes, max_bytes: int, progress: Progress) -> Transfer[bytes]:
    """Continue a block upload after the server's first answer."""
    if answer[0] & 0xE1 != 0xC0:
        raise exchange.protocol_error(f"command {answer[0]:02X}h, expected C0h to C6h", Abort.COMMAND)
    crc = bool(answer[0] & 0x04)
    size = int.from_bytes(answer[4:8], "little") if answer[0] & 0x02 else 0
    limit = size or min(max_bytes, MOST_UNTOLD)
    data = bytearray()
    message = b"\xa3" + bytes(7)
    repeated, last = 0, False
    while not last:
        good, number, ended = 0, 0, False
        answer = yield from exchange.next(message)
        while True:
            number, ended = answer[0] & 0x7F, bool(answer[0] & 0x80)
            if number == good + 1:
                data += answer[1:8]
                good, last = number, ended
            if ended or number >= BLOCK:
                break
            answer = yield from exchange.next()
        repeated = 0 if good else repeated + 1
        if repeated > REPEATS:
            raise exchange.protocol_error("segments are lost again and again", Abort.SEQUENCE)
        if len(data) > limit + 6:
            raise exchange.protocol_error(f"it continues beyond {limit} bytes, the most expected", Abort.TOO_LONG)
        progress(min(len(data), limit), size)
        message = bytes((0xA2, good, BLOCK)) + bytes(5)
    answer = yield from exchange.next(message)
    if answer[0] & 0xE3 != 0xC1:
        raise exchange.protocol_error(f"command {answer[0]:02X}h, expected the end of a block upload", Abort.COMMAND)
    content = bytes(data[: len(data) - (answer[0] >> 2 & 7)])
    if crc and int.from_bytes(answer[1:3], "little") != crc16(content):
        raise exchange.protocol_error("the CRC is wrong", Abort.CRC)
    if size and size != len(content):
        raise exchange.protocol_error(f"{size} bytes were told, {len(content)} came", Abort.LENGTH)
    yield SdoStep((b"\xa1" + bytes(7),), waits=False)
    return content


def download(index: int, subindex: int, data: bytes, *, progress: Progress = _nothing) -> Transfer[None]:
    """Write an object: expedited up to four bytes, long ones by block transfer if the server supports it,
    else by segments.

    Raises
    ------
    SdoRefused
        the server aborted the transfer
    SdoProtocolError
        the server's answer is not valid
    """
    exchange = _Exchange("download to", index, subindex)
    if 1 <= len(data) <= 4:
        _check_download(exchange, (yield from exchange.first(head(0x23 | (4 - len(data)) << 2, index, subindex, data))))
        return
    if len(data) > LONG:
        try:
            yield from _block_download(exchange, data, progress)
            return
        except SdoRefused as refused:
            if refused.code != Abort.COMMAND:
                raise
    _check_download(exchange, (yield from exchange.first(head(0x21, index, subindex, len(data).to_bytes(4, "little")))))
    toggle = 0
    for start in range(0, max(len(data), 1), 7):
        part = data[start : start + 7]
        command = toggle | (7 - len(part)) << 1 | (start + 7 >= len(data))
        answer = yield from exchange.next(bytes((command,)) + part.ljust(7, b"\0"))
        if answer[0] >> 5 != 1:
            raise exchange.no_segment(answer, "acknowledges no segment")
        if answer[0] & 0x10 != toggle:
            raise exchange.protocol_error("the toggle bit did not alternate", Abort.TOGGLE)
        toggle ^= 0x10
        progress(start + len(part), len(data))


def _check_download(exchange: _Exchange, answer: bytes) -> None:
    if answer[0] >> 5 != 3:
        raise exchange.protocol_error(f"command {answer[0]:02X}h, expected 60h", Abort.COMMAND)


def _block_download(exchange: _Exchange, data: bytes, progress: Progress) -> Transfer[None]:
    answer = yield from exchange.first(head(0xC6, exchange.index, exchange.subindex, len(data).to_bytes(4, "little")))
    if answer[0] & 0xFB != 0xA0:
        raise exchange.protocol_error(f"command {answer[0]:02X}h, expected A0h or A4h", Abort.COMMAND)
    crc, size = bool(answer[0] & 0x04), answer[4]
    segments = [data[start : start + 7].ljust(7, b"\0") for start in range(0, len(data), 7)]
    position = repeated = 0
    while position < len(segments):
        if not 1 <= size <= BLOCK:
            raise exchange.protocol_error(f"block size {size}, expected 1 to 127", Abort.BLOCK_SIZE)
        block = segments[position : position + size]
        final = position + len(block) == len(segments)
        numbered = [
            bytes((number | 0x80 * (final and number == len(block)),)) + segment
            for number, segment in enumerate(block, 1)
        ]
        answer = yield from exchange.next(*numbered)
        if answer[0] & 0xE3 != 0xA2 or answer[1] > len(block):
            raise exchange.protocol_error(f"{answer.hex(' ')} acknowledges no block", Abort.COMMAND)
        good, size = answer[1], answer[2]
        repeated = 0 if good else repeated + 1
        if repeated > REPEATS:
            raise exchange.protocol_error("the server asks for the same segments again and again", Abort.SEQUENCE)
        position += good
        progress(min(7 * position, len(data)), len(data))
    end = bytes((0xC1 | -len(data) % 7 << 2,)) + (crc16(data) if crc else 0).to_bytes(2, "little")
    answer = yield from exchange.next(end.ljust(8, b"\0"))
    if answer[0] & 0xE3 != 0xA1:
        raise exchange.protocol_error(f"command {answer[0]:02X}h, expected A1h", Abort.COMMAND)
