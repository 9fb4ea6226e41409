"""State of an SDO block transfer at the server (CiA 301, sections 7.2.4.3.9 to 7.2.4.3.15).

A block is up to 127 segments of seven bytes, numbered from 1. Its receiver acknowledges it with the
number of the last segment in order, and the sender continues after that segment. So a lost segment
costs only the rest of its block. The CRC is CCITT's, polynomial x^16 + x^12 + x^5 + 1, start value
0, over the object's bytes, without the padding.
"""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.eds.cia301 import Abort
from coulombus.eds.sdo_frames import crc16
from coulombus.node.constants import BLOCK_SEGMENTS
from coulombus.node.profile import SdoAbort

__all__ = ["BLOCK_SEGMENTS", "BlockDownload", "BlockUpload"]

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
