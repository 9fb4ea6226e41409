"""Reassembly of an SDO transfer's bytes from the frames of a recording.

A recording may begin within a transfer, and lose frames of it. The joined bytes are the object
unless `lacking` returns a reason against it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from coulombus.eds.sdo_frames import BLOCK_SEGMENTS, crc16

__all__ = ["Joined", "Segments", "SubBlocks", "are_wrong"]

_SEGMENT = 7
_MOST_BYTES = 1 << 26
"""Bytes beyond this number are counted but not stored."""


def are_wrong(remark: str) -> bool:
    """Return whether a remark on a whole transfer says that its data are not what was announced."""
    return remark.startswith("CRC ") or "bytes were announced" in remark


@dataclass
class Joined:
    """Bytes received so far.

    Attributes
    ----------
    size : number of bytes that the transfer's initiation announced, None: not announced
    whole : every frame from the initiation on is present
    """

    size: int | None = None
    whole: bool = True
    content: bytearray = field(default_factory=bytearray)
    _uncounted: int = 0

    @property
    def count(self) -> int:
        """Number of bytes so far, including those of missing frames as far as known."""
        return len(self.content) + self._uncounted

    def add(self, part: bytes) -> None:
        """Append the next bytes."""
        if self.whole and len(self.content) < _MOST_BYTES:
            self.content += part
        else:
            self.skip(len(part))

    def skip(self, count: int) -> None:
        """Count bytes of missing frames."""
        self.whole = False
        self._uncounted += count

    def lacking(self, unused: int = 0) -> str:
        """Return why the bytes without the last `unused` ones are not the object; "" if they are."""
        if not self.whole:
            return "incomplete: frames of this transfer are not in the recording"
        count = self.count - unused
        if self.size is not None and self.size != count:
            return f"{self.size} bytes were announced, {count} came"
        return ""


@dataclass
class Segments(Joined):
    """A segmented transfer: the toggle bit distinguishes the next segment from a repeated one."""

    toggle: int = 0
    _last: bytes = b""

    def add_segment(self, data: bytes) -> str:
        """Process a segment; return a remark on it or ""."""
        if data[0] & 0x10 == self.toggle:
            self.toggle ^= 0x10
            self._last = data
            self.add(data[1 : 8 - (data[0] >> 1 & 7)])
            return ""
        if data == self._last:
            return "repeated"
        self.add(data[1 : 8 - (data[0] >> 1 & 7)])
        self._last, self.whole = data, False
        return "the toggle bit did not alternate, or the segment before is not in the recording"

    def missed(self, toggle: int) -> None:
        """Count a segment with this toggle bit, which was sent but is not in the recording."""
        if toggle == self.toggle:
            self.toggle ^= 0x10
            self.skip(_SEGMENT)


@dataclass
class SubBlocks(Joined):
    """A block transfer: only segments that its receiver acknowledges count.

    Attributes
    ----------
    most : segments of the present block, as requested by its receiver
    crc : the end frame has a CRC
    number : number of the last segment since the last acknowledgement, 0: none
    in_order : segments since then in order, from the first on
    finished : the last segment of all was acknowledged
    ended : the end frame came
    """

    most: int = BLOCK_SEGMENTS
    crc: bool = False
    number: int = 0
    in_order: int = 0
    finished: bool = False
    ended: bool = False
    _final: int = 0  # number of the segment marked as the last, 0: none yet
    _segments: dict[int, bytes] = field(default_factory=dict)

    @property
    def all_sent(self) -> bool:
        """Whether the last segment of the transfer came, in order."""
        return 0 < self._final == self.in_order

    @property
    def count_in_order(self) -> int:
        """Number of bytes so far, including those of the present block."""
        count = self.count + _SEGMENT * self.in_order
        return count if self.size is None else min(count, self.size)

    def add_segment(self, data: bytes) -> str:
        """Process a segment; return a remark on it or ""."""
        number, remark = data[0] & 0x7F, ""
        if number <= self.number:
            if self._segments.get(number) == data[1:]:
                return "repeated"
            if self.in_order:  # else: remaining segments of a block whose receiver had requested it again
                self._next_block(self.in_order)
                self.whole, remark = False, "the acknowledgement before it is not in the recording"
            self._segments, self.number = {}, 0
        if not remark and number > self.number + 1:
            first = self.number + 1
            remark = (
                f"segment {first} is missing"
                if number == first + 1
                else f"segments {first} to {number - 1} are missing"
            )
        self._segments[number], self.number = data[1:], number
        while self.in_order + 1 in self._segments:
            self.in_order += 1
        self._final = number if data[0] & 0x80 else 0
        return remark

    def acknowledge(self, number: int, block_size: int) -> str:
        """Process an acknowledgement of the segments up to `number`; return a remark on it or ""."""
        remark = ""
        if number < self.number:
            remark = f"asks for the segments from {number + 1} on again"
        elif number > self.in_order:
            remark = f"of the segments up to {number} some are not in the recording"
        self.finished = 0 < self._final <= number
        self._next_block(number)
        self.most = block_size
        return remark

    def _next_block(self, number: int) -> None:
        for k in range(1, number + 1):
            if k in self._segments:
                self.add(self._segments[k])
            else:
                self.skip(_SEGMENT)
        self._segments, self.number, self.in_order, self._final = {}, 0, 0, 0

    def end(self, unused: int, crc: int) -> str:
        """Process the end frame with its CRC; return a remark on the bytes or ""."""
        self._next_block(self.in_order)
        self.ended = True
        lacking = self.lacking(unused)
        if unused:
            del self.content[-unused:]
        if lacking or not self.crc or crc16(self.content) == crc:
            return lacking
        self.whole = self.size is not None  # else nothing proves that no frame is missing
        return f"CRC {crc:04X}h does not match the bytes, whose CRC is {crc16(self.content):04X}h"
