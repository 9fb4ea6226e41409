"""An SDO server channel: expedited, segmented and block transfers both ways (CiA 301, section 7.2.4).

The server is a function of the requests: one 8-byte request in, at most one response out (None: no
answer), and in a block upload a `burst` of segments. `Backend` holds the objects, so that tests
need no device. At most one transfer is open; a new initiation replaces it, as section 7.2.4.3
requires, and an abort in either direction ends it.

A block (sections 7.2.4.3.9 to 7.2.4.3.15) is up to 127 segments of seven bytes, numbered from 1.
Its receiver acknowledges it with the number of the last segment in order, and the sender continues
after that segment. So a lost segment costs only the rest of its block. The CRC is CCITT's,
polynomial x^16 + x^12 + x^5 + 1, start value 0, over the object's bytes, without the padding.

CAN delivers a frame twice if the last bit of its end is disturbed. So a request that continues a
transfer, and is repeated directly, is the same frame: it is ignored, because its answer is on the
way. An initiation is served again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from coulombus.eds.cia301 import Abort
from coulombus.eds.sdo_frames import BLOCK_SEGMENTS, crc16
from coulombus.node.profile import SdoAbort

__all__ = ["Backend", "BlockDownload", "BlockUpload", "SdoServer", "abort_frame"]

_SEGMENT = 7
_LAST, _NUMBER = 0x80, 0x7F


class BlockDownload:
    """Receiving side of a client's download."""

    def __init__(self, index: int, subindex: int, size: int | None, longest: int, crc: bool, block_size: int) -> None:
        self.index, self.subindex, self.size = index, subindex, size
        self.receiving = True
        """Whether the next frames are segments; else the server waits for the end command."""
        self._data = bytearray()
        self._longest, self._crc, self._block_size = longest, crc, block_size
        self._received = 0  # segments of this block received in order
        self._in_order = True

    @property
    def expected(self) -> tuple[int, int]:
        """Number of the next segment, and of the block's last; (0, 0) after a gap or the last segment of all."""
        return (self._received + 1, self._block_size) if self.receiving and self._in_order else (0, 0)

    def add_segments(self, content: bytes) -> None:
        """Process segments in order, from `expected` on, without the block's last."""
        self._received += len(content) // _SEGMENT
        self._keep(content)

    def _keep(self, content: bytes) -> None:
        if len(self._data) <= self._longest + _SEGMENT:  # enough to prove that it is too long
            self._data += content

    def segment(self, data: bytes, next_block_size: int) -> bytes | None:
        """Process a segment; return the acknowledgement if it was the last of its block, else None.

        Segments after a gap are ignored, and an object that becomes too long is refused at the end of the
        block: a client in the middle of a block does not listen.
        """
        number = data[0] & _NUMBER
        last = bool(data[0] & _LAST)
        if number == 0 or number > self._block_size:
            raise SdoAbort(Abort.SEQUENCE)
        if number == self._received + 1 and self._in_order:
            self._received = number
            self._keep(data[1:8])
        elif number > self._received:
            self._in_order = False  # a gap; a number that came already is a repetition
        if not last and number != self._block_size:
            return None
        if not last and len(self._data) > self._longest:  # the end command gives the padding of the last segment
            raise SdoAbort(Abort.TOO_LONG)
        acknowledged = self._received
        self.receiving = not (last and self._in_order)
        self._received, self._in_order, self._block_size = 0, True, next_block_size
        return bytes((0xA2, acknowledged, next_block_size, 0, 0, 0, 0, 0))

    def end(self, data: bytes) -> bytes:
        """Process the end command; return the object's bytes after a check of length and CRC."""
        padding = data[0] >> 2 & 7
        content = bytes(self._data[: len(self._data) - padding])
        if len(content) > self._longest:
            raise SdoAbort(Abort.TOO_LONG)
        if self._crc and crc16(content) != data[1] | data[2] << 8:
            raise SdoAbort(Abort.CRC)
        return content


class BlockUpload:
    """Sending side of a client's upload."""

    def __init__(self, index: int, subindex: int, content: bytes, crc: bool, block_size: int) -> None:
        self.index, self.subindex = index, subindex
        self._content, self._crc, self._block_size = content, crc, block_size
        self._position = 0  # position of the block's first byte
        self._sent = 0  # segments of the block that is not yet acknowledged
        self._started = self._ended = False

    @property
    def waiting(self) -> int:
        """Number of unacknowledged segments of the present block; -1 after the last block."""
        return -1 if self._ended else self._sent

    def start(self) -> Sequence[bytes]:
        """Handle the client's start command: return the first block."""
        if self._started:
            raise SdoAbort(Abort.COMMAND)
        self._started = True
        return self.segments()

    def segments(self) -> Sequence[bytes]:
        """Return the segments of the next block."""
        content, position = self._content, self._position
        segments = []
        for number in range(1, self._block_size + 1):
            part = content[position : position + _SEGMENT]
            position += _SEGMENT
            last = position >= len(content)
            segments.append(bytes((number | _LAST * last,)) + part.ljust(_SEGMENT, b"\0"))
            if last:
                break
        self._sent = len(segments)
        return segments

    def acknowledge(self, number: int, block_size: int) -> bytes | None:
        """Process the client's acknowledgement of segment `number`; return the end command if that was the last
        of all.
        """
        if not self._started or self._ended:
            raise SdoAbort(Abort.COMMAND)
        if number > self._sent:
            raise SdoAbort(Abort.SEQUENCE)
        if not 1 <= block_size <= BLOCK_SEGMENTS:
            raise SdoAbort(Abort.BLOCK_SIZE)
        self._position += number * _SEGMENT
        self._block_size = block_size
        size = len(self._content)
        if number == 0 or self._position < size:
            return None
        self._ended = True
        padding = self._position - size
        crc = crc16(self._content) if self._crc else 0
        return bytes((0xC1 | padding << 2,)) + crc.to_bytes(2, "little") + bytes(5)

    def check_end(self) -> None:
        """Handle the client's end command: abort unless everything was sent."""
        if not self._ended:
            raise SdoAbort(Abort.COMMAND)


_ABORT = 0x80
_CRC = 0x04  # echoes the client's bit: canopen's client checks the server's bit alone


class Backend(Protocol):
    """Objects that the server serves."""

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the object's bytes or raise `SdoAbort`."""

    def check_download(self, index: int, subindex: int, size: int | None) -> int:
        """Raise `SdoAbort` unless `size` bytes (None: unknown) may be written; return the largest allowed number."""

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the object or raise `SdoAbort`."""


@dataclass
class _Segmented:
    """An open segmented transfer."""

    index: int
    subindex: int
    upload: bool
    data: bytearray
    toggle: int = 0
    position: int = 0
    size: int | None = None  # of a download, if the client gave it
    longest: int = 0


def abort_frame(index: int, subindex: int, code: int) -> bytes:
    """Return the abort frame for an object."""
    return bytes((_ABORT, index & 0xFF, index >> 8, subindex)) + int(code).to_bytes(4, "little")


class SdoServer:
    """An SDO server channel; in downloads it requests `block_size` segments per block (1 to 127, may change
    at any time).
    """

    def __init__(self, backend: Backend, block_size: int = BLOCK_SEGMENTS) -> None:
        self._backend = backend
        self._open: _Segmented | BlockDownload | BlockUpload | None = None
        self._place: tuple[int, int] | None = None  # object of the open transfer, while a request continues it
        self._last = b""  # previous request, if it may be repeated
        self.block_size = block_size
        self.again = False
        """Whether the last request repeated the previous one."""
        self.burst: Sequence[bytes] = ()
        """Segments to be sent after the response of the last request, in order."""
        self.unsent = 0
        """Number of segments of the last burst still to be sent, set by their sender."""

    @property
    def transfer(self) -> tuple[int, int] | None:
        """(index, sub-index) of the open transfer."""
        return (self._open.index, self._open.subindex) if self._open else None

    @property
    def expected(self) -> tuple[int, int]:
        """Number of the next segment of a block download, and of the block's last; (0, 0): none is expected."""
        return self._open.expected if isinstance(self._open, BlockDownload) else (0, 0)

    def add_segments(self, content: bytes) -> None:
        """Process segments of a block download in the order of `expected`, before its last."""
        self._last = b""
        if isinstance(self._open, BlockDownload):
            self._open.add_segments(content)

    def drop(self) -> None:
        """Discard the open transfer (time-out, reset)."""
        self._open, self.burst, self._last = None, (), b""

    def request(self, data: bytes) -> bytes | None:
        """Serve one request of 8 bytes and return the response."""
        self.burst, self._place, transfer = (), None, self._open
        self.again = data == self._last and not self._acknowledges(data)
        if self.again:
            return None
        self._last = data if self._goes_on(data) else b""
        answer = self._serve(data)
        if isinstance(self._open, BlockDownload) and self._open is not transfer:
            self._last = data  # it begins: a repeated initiation would be a segment
        return answer

    def _goes_on(self, data: bytes) -> bool:
        """Tell whether a request continues the open transfer, and cannot legitimately be repeated."""
        if isinstance(self._open, BlockDownload) and self._open.receiving:
            return self._open.expected != (1, 1)  # blocks of one segment may be identical
        initiates = data[0] >> 5 in (1, 2) or data[0] & 0xE3 == 0xA0 or data[0] & 0xE1 == 0xC0
        return not initiates

    def _acknowledges(self, data: bytes) -> bool:
        """Tell whether a request acknowledges sent segments of an upload."""
        transfer = self._open
        return (
            data[0] & 0xE3 == 0xA2 and isinstance(transfer, BlockUpload) and data[1] <= transfer.waiting - self.unsent
        )

    def _serve(self, data: bytes) -> bytes | None:
        transfer = self._open
        try:
            if isinstance(transfer, BlockDownload) and transfer.receiving and data[0] != _ABORT:
                self._place = (transfer.index, transfer.subindex)
                return transfer.segment(data, self.block_size)
            return _SERVICES[data[0] >> 5](self, data, data[1] | data[2] << 8, data[3])
        except SdoAbort as abort:
            self._open, self._last = None, b""
            index, subindex = self._place or (data[1] | data[2] << 8, data[3])
            return abort_frame(index, subindex, abort.code)

    # expedited and segmented

    def _initiate_download(self, data: bytes, index: int, subindex: int) -> bytes:
        self._open = None
        expedited, sized = data[0] & 0x02, data[0] & 0x01
        if expedited:
            # without a size the client means the object's length, at most four bytes
            longest = self._backend.check_download(index, subindex, None)
            content = data[4 : 8 - (data[0] >> 2 & 3)] if sized else data[4 : 4 + min(longest, 4)]
            self._backend.check_download(index, subindex, len(content))
            self._backend.download(index, subindex, content)
        else:
            size = int.from_bytes(data[4:8], "little") if sized else None
            longest = self._backend.check_download(index, subindex, size)
            self._open = _Segmented(index, subindex, False, bytearray(), size=size, longest=longest)
        return b"\x60" + data[1:4] + b"\0\0\0\0"

    def _download_segment(self, data: bytes, index: int, subindex: int) -> bytes:
        transfer = self._expect_segmented(upload=False, toggle=data[0] & 0x10)
        transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
        if len(transfer.data) > (transfer.longest if transfer.size is None else transfer.size):
            raise SdoAbort(Abort.TOO_LONG)
        if data[0] & 0x01:
            self._open = None
            self._finish_download(transfer.index, transfer.subindex, bytes(transfer.data), transfer.size)
        return bytes((0x20 | data[0] & 0x10, 0, 0, 0, 0, 0, 0, 0))

    def _finish_download(self, index: int, subindex: int, content: bytes, size: int | None) -> None:
        if size is not None and len(content) < size:
            raise SdoAbort(Abort.TOO_SHORT)
        self._backend.check_download(index, subindex, len(content))
        self._backend.download(index, subindex, content)

    def _initiate_upload(self, data: bytes, index: int, subindex: int) -> bytes:
        self._open = None
        return self._answer_upload(data, index, subindex, self._backend.upload(index, subindex))

    def _answer_upload(self, data: bytes, index: int, subindex: int, content: bytes) -> bytes:
        size = len(content)
        if 1 <= size <= 4:
            return _EXPEDITED[size] + data[1:4] + content + _PADDING[size]
        self._open = _Segmented(index, subindex, True, bytearray(content))
        return b"\x41" + data[1:4] + size.to_bytes(4, "little")

    def _upload_segment(self, data: bytes, index: int, subindex: int) -> bytes:
        transfer = self._expect_segmented(upload=True, toggle=data[0] & 0x10)
        segment = transfer.data[transfer.position : transfer.position + _SEGMENT]
        transfer.position += _SEGMENT
        last = transfer.position >= len(transfer.data)
        if last:
            self._open = None
        return bytes((data[0] & 0x10 | (_SEGMENT - len(segment)) << 1 | last,)) + bytes(segment).ljust(_SEGMENT, b"\0")

    def _expect_segmented(self, *, upload: bool, toggle: int) -> _Segmented:
        """Return the open transfer in this direction; check and alternate its toggle bit."""
        transfer = self._continue()
        if not isinstance(transfer, _Segmented) or transfer.upload != upload:
            raise SdoAbort(Abort.COMMAND)
        if transfer.toggle != toggle:
            raise SdoAbort(Abort.TOGGLE)
        transfer.toggle ^= 0x10
        return transfer

    def _continue(self) -> _Segmented | BlockDownload | BlockUpload | None:
        """Return the open transfer that the present request continues."""
        self._place = self.transfer
        return self._open

    # block

    def _block_download(self, data: bytes, index: int, subindex: int) -> bytes:
        if data[0] & 0x01:
            transfer = self._continue()
            if not isinstance(transfer, BlockDownload):
                raise SdoAbort(Abort.COMMAND)
            content = transfer.end(data)
            self._open = None
            self._finish_download(transfer.index, transfer.subindex, content, transfer.size)
            return b"\xa1\0\0\0\0\0\0\0"
        self._open = None
        size = int.from_bytes(data[4:8], "little") if data[0] & 0x02 else None
        longest = self._backend.check_download(index, subindex, size)
        crc = bool(data[0] & _CRC)
        self._open = BlockDownload(index, subindex, size, longest if size is None else size, crc, self.block_size)
        return bytes((0xA0 | data[0] & _CRC,)) + data[1:4] + bytes((self.block_size, 0, 0, 0))

    def _block_upload(self, data: bytes, index: int, subindex: int) -> bytes | None:
        what = data[0] & 0x03
        if what == 0:
            return self._initiate_block_upload(data, index, subindex)
        transfer = self._continue()
        if not isinstance(transfer, BlockUpload):
            raise SdoAbort(Abort.COMMAND)
        if what == 1:
            transfer.check_end()
            self._open = None
            return None
        if what == 3:
            self.burst = transfer.start()
            return None
        end = transfer.acknowledge(data[1], data[2])
        self.burst = transfer.segments() if end is None else ()
        return end

    def _initiate_block_upload(self, data: bytes, index: int, subindex: int) -> bytes:
        self._open = None
        block_size, switch = data[4], data[5]
        if not 1 <= block_size <= BLOCK_SEGMENTS:
            raise SdoAbort(Abort.BLOCK_SIZE)
        content = self._backend.upload(index, subindex)
        if switch and len(content) <= switch:  # the client allows other protocols for a small object
            return self._answer_upload(data, index, subindex, content)
        self._open = BlockUpload(index, subindex, content, bool(data[0] & _CRC), block_size)
        return bytes((0xC2 | data[0] & _CRC,)) + data[1:4] + len(content).to_bytes(4, "little")

    def _abort(self, data: bytes, index: int, subindex: int) -> None:
        self._open = None

    def _unknown(self, data: bytes, index: int, subindex: int) -> bytes:
        raise SdoAbort(Abort.COMMAND)


_EXPEDITED = tuple(bytes((0x43 | (4 - size) << 2,)) for size in range(5))
_PADDING = tuple(bytes(4 - size) for size in range(5))

_SERVICES: tuple[Callable[[SdoServer, bytes, int, int], bytes | None], ...] = (
    SdoServer._download_segment,
    SdoServer._initiate_download,
    SdoServer._initiate_upload,
    SdoServer._upload_segment,
    SdoServer._abort,
    SdoServer._block_upload,
    SdoServer._block_download,
    SdoServer._unknown,
)
"""Service of each client command specifier (bits 7-5 of byte 0)."""
