"""An SDO client on raw frames that can also violate the protocol (CiA 301, section 7.2.4).

Every response is checked to the bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.sdo_frames import crc16, head

__all__ = ["SdoClient"]

_LONGEST = 1 << 24  # an upload that is longer never ends
BLOCK = 127
_SDO, _BLOCKS = "CiA 301, 7.2.4", "CiA 301, 7.2.4.2.9"


class SdoClient:
    """A client of one server.

    Parameters
    ----------
    send
        Sends eight bytes to the server, after discarding its pending messages.
    wait
        Returns the server's next eight bytes, or None after the time-out.
    stream
        Sends eight bytes, and keeps pending messages: a server may acknowledge or abort within a block.
    width
        Returns the bytes of an object's type, 0 for a variable size: for an expedited upload without a size.
    """

    def __init__(
        self,
        send: Callable[[bytes], None],
        wait: Callable[[], bytes | None],
        stream: Callable[[bytes], None],
        width: Callable[[int, int], int] = lambda index, subindex: 0,
    ) -> None:
        self.send, self.stream = send, stream
        self._wait, self._width = wait, width
        self._other: tuple[int, int] | None = None

    # single messages

    def answer(self, what: str) -> bytes:
        """Return the server's next message.

        Raises
        ------
        NoAnswer
            There is no message in time.
        """
        data = self._wait()
        if data is None:
            raise NoAnswer(f"no SDO response to {what}", cause="no SDO response", clause=_SDO)
        if len(data) != 8:
            raise CaseFailed(f"SDO response to {what} has {len(data)} bytes, expected 8")
        return data

    def request(self, data: bytes, index: int, subindex: int, what: str) -> bytes:
        """Send a request and return the response; an abort raises `TransferAborted`."""
        self.send(data)
        return self.response(index, subindex, what)

    def response(self, index: int, subindex: int, what: str) -> bytes:
        """Return the server's next message; an abort raises `TransferAborted`."""
        answer = self.answer(f"{what} {where(index, subindex)}")
        if answer[0] == 0x80:
            place = (int.from_bytes(answer[1:3], "little"), answer[3])
            if place not in ((index, subindex), self._other) and what != "unknown command":
                text = f"abort of {what} {where(index, subindex)} names {where(*place)}"
                raise CaseFailed(text, cause="an SDO abort names another object", clause=_SDO)
            if place == self._other:
                index, subindex = place
            raise TransferAborted(index, subindex, int.from_bytes(answer[4:], "little"), what)
        return answer

    @contextmanager
    def named(self, other: tuple[int, int]) -> Iterator[None]:
        """Accept `other` in an abort, too: the object of a transfer that was still open."""
        self._other = other
        try:
            yield
        finally:
            self._other = None

    def abort(self, index: int, subindex: int, code: int = 0x08000000) -> None:
        """Abort the open transfer; a server does not respond to that."""
        self.send(head(0x80, index, subindex, code.to_bytes(4, "little")))

    # whole transfers

    def upload(self, index: int, subindex: int) -> bytes:
        """Read an object, expedited or segmented as the server chooses."""
        return self.upload_as(index, subindex)[0]

    def upload_up_to(self, index: int, subindex: int, largest: int) -> bytes | None:
        """Read an object; return None if it has more than `largest` bytes."""
        answer = self.initiate_upload(index, subindex)
        return self._go_on(answer, index, subindex, largest)[0]

    def upload_as(self, index: int, subindex: int) -> tuple[bytes, bool]:
        """Read an object; return its bytes and whether the transfer was segmented."""
        data, segmented = self._go_on(self.initiate_upload(index, subindex), index, subindex, _LONGEST)
        if data is None:
            raise CaseFailed(f"upload of {where(index, subindex)} has no end")
        return data, segmented

    def _go_on(self, answer: bytes, index: int, subindex: int, largest: int) -> tuple[bytes | None, bool]:
        """Continue a begun upload to its end; or abort it if it has more than `largest` bytes, and return None.

        It is never begun again before its end: a server may abort either of the two.
        """
        if answer[0] & 0x02:
            return self.expedited(answer, index, subindex), False
        size_said = int.from_bytes(answer[4:], "little") if answer[0] & 0x01 else None
        data, toggle, last = b"", 0, False
        while not last:
            if max(size_said or 0, len(data)) > largest:
                self.abort(index, subindex)
                return None, True
            segment, last = self.upload_segment(index, subindex, toggle)
            data += segment
            toggle ^= 0x10
        if size_said is not None and size_said != len(data):
            raise CaseFailed(f"upload of {where(index, subindex)}: {size_said} bytes were said, {len(data)} came")
        return data, True

    def expedited(self, answer: bytes, index: int, subindex: int) -> bytes:
        """Return the data of an expedited response: by its indicated size, else its type's.

        CiA 301 does not define the bytes without data.
        """
        length = 4 - (answer[0] >> 2 & 3) if answer[0] & 0x01 else 0
        return answer[4 : 4 + (length or min(self._width(index, subindex) or 4, 4))]

    def initiate_upload(self, index: int, subindex: int) -> bytes:
        """Initiate an upload and return the checked response."""
        answer = self.request(head(0x40, index, subindex), index, subindex, "upload of")
        if answer[0] >> 5 != 2 or answer[0] & 0x10:
            raise _failure("upload of", index, subindex, f"command {answer[0]:02X}h is no upload response")
        self._same(answer, index, subindex, "upload of")
        return answer

    def upload_segment(self, index: int, subindex: int, toggle: int) -> tuple[bytes, bool]:
        """Read one segment; return its bytes and whether it is the last."""
        answer = self.request(bytes((0x60 | toggle,)) + bytes(7), index, subindex, "upload segment of")
        if answer[0] >> 5 != 0:
            raise _failure("upload segment of", index, subindex, f"command {answer[0]:02X}h is no segment")
        if answer[0] & 0x10 != toggle:
            raise _failure("upload segment of", index, subindex, "the toggle bit is not that of the request")
        return answer[1 : 8 - (answer[0] >> 1 & 7)], bool(answer[0] & 0x01)

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object: expedited up to four bytes, else by segments."""
        if 1 <= len(data) <= 4:
            command = 0x23 | (4 - len(data)) << 2
            answer = self.request(head(command, index, subindex, data), index, subindex, "download to")
            self._downloaded(answer, index, subindex)
        else:
            self.download_segmented(index, subindex, data)

    def download_segmented(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object by segments, however short it is."""
        size = len(data).to_bytes(4, "little")
        self._downloaded(
            self.request(head(0x21, index, subindex, size), index, subindex, "download to"), index, subindex
        )
        toggle = 0
        for start in range(0, max(len(data), 1), 7):
            part = data[start : start + 7]
            command = toggle | (7 - len(part)) << 1 | (start + 7 >= len(data))
            segment = bytes((command,)) + part.ljust(7, b"\0")
            answer = self.request(segment, index, subindex, "download segment to")
            if answer[0] != 0x20 | toggle:
                text = f"command {answer[0]:02X}h, expected {0x20 | toggle:02X}h"
                raise _failure("download segment to", index, subindex, f"{text} (toggle bit {toggle >> 4})")
            toggle ^= 0x10

    def _downloaded(self, answer: bytes, index: int, subindex: int) -> None:
        if answer[0] != 0x60:
            raise _failure("download to", index, subindex, f"command {answer[0]:02X}h, expected 60h")
        self._same(answer, index, subindex, "download to")

    def _same(self, answer: bytes, index: int, subindex: int, what: str) -> None:
        if answer[1:4] != head(0, index, subindex)[1:4]:
            text = f"{what} {where(index, subindex)}: the response names {_named(answer)}"
            raise CaseFailed(text, cause="an SDO response names another object", clause=_SDO)

    # block transfer

    def initiate_block_upload(
        self, index: int, subindex: int, *, crc: bool, size: int = BLOCK
    ) -> tuple[bool, int | None]:
        """Initiate a block upload with blocks of `size` segments.

        Return whether the server has a CRC, and the length.
        """
        request = head(0xA0 | 0x04 * crc, index, subindex, bytes((size, 0)))
        answer = self.request(request, index, subindex, "block upload of")
        if answer[0] >> 5 != 6 or answer[0] & 0x01:
            raise _failure("block upload of", index, subindex, f"command {answer[0]:02X}h, expected C0h to C6h")
        self._same(answer, index, subindex, "block upload of")
        return bool(answer[0] & 0x04), int.from_bytes(answer[4:], "little") if answer[0] & 0x02 else None

    def read_block(self, index: int, subindex: int, size: int) -> tuple[list[bytes], bool]:
        """Receive the segments of one block, at most `size`.

        Return them and whether the last one is the upload's last.
        """
        segments: list[bytes] = []
        while len(segments) < size:
            answer = self.response(index, subindex, "block segment of")
            if answer[0] & 0x7F != len(segments) + 1:
                text = f"sequence number {answer[0] & 0x7F}, expected {len(segments) + 1}"
                raise CaseFailed(f"block upload of {where(index, subindex)}: {text}")
            segments.append(answer[1:])
            if answer[0] & 0x80:
                return segments, True
        return segments, False

    def acknowledge(self, sequence: int, size: int) -> None:
        """Acknowledge the segments up to `sequence` and request a block of `size` segments."""
        self.send(bytes((0xA2, sequence, size)) + bytes(5))

    def end_block_upload(
        self, index: int, subindex: int, segments: list[bytes], *, crc: bool, said: int | None
    ) -> bytes:
        """Receive the end of a block upload, whose last block is acknowledged; check length and CRC.

        Return the bytes.
        """
        answer = self.response(index, subindex, "end of block upload of")
        if answer[0] & 0xE3 != 0xC1:
            raise CaseFailed(f"block upload of {where(index, subindex)}: command {answer[0]:02X}h, expected its end")
        unused = answer[0] >> 2 & 7
        data = b"".join(segments)
        data = data[: len(data) - unused]
        checksum = int.from_bytes(answer[1:3], "little")
        if crc and checksum != crc16(data):
            raise CaseFailed(
                f"block upload of {where(index, subindex)}: CRC {checksum:04X}h, expected {crc16(data):04X}h"
            )
        if not crc and checksum:
            raise CaseFailed(f"block upload of {where(index, subindex)}: CRC {checksum:04X}h where none was agreed")
        self.send(b"\xa1" + bytes(7))
        if said is not None and said != len(data):
            raise CaseFailed(f"block upload of {where(index, subindex)}: {said} bytes were said, {len(data)} came")
        return data

    def block_upload(self, index: int, subindex: int, *, crc: bool, size: int = BLOCK) -> tuple[bytes, bool]:
        """Read an object by block transfer.

        Return its bytes and whether a CRC was agreed and correct.
        """
        has_crc, size_said = self.initiate_block_upload(index, subindex, crc=crc, size=size)
        self.send(b"\xa3" + bytes(7))
        segments: list[bytes] = []
        last = False
        while not last:
            block, last = self.read_block(index, subindex, size)
            segments += block
            self.acknowledge(len(block), size)
            if len(segments) * 7 > _LONGEST:
                self.abort(index, subindex)
                raise CaseFailed(f"block upload of {where(index, subindex)} has no end")
        agreed = crc and has_crc
        return self.end_block_upload(index, subindex, segments, crc=agreed, said=size_said), agreed

    def initiate_block_download(
        self, index: int, subindex: int, size: int, *, crc: bool, optional: tuple[int, ...] = ()
    ) -> tuple[bool, int]:
        """Initiate a block download of `size` bytes.

        Return whether the server has a CRC, and its block size.

        Raises
        ------
        NotApplicable
            The server aborts it (with `optional`: with one of these codes): it has no block
            downloads, which is allowed.
        """
        request = head(0xC2 | 0x04 * crc, index, subindex, size.to_bytes(4, "little"))
        try:
            answer = self.request(request, index, subindex, "block download to")
        except TransferAborted as abort:
            if optional and abort.code not in optional:
                raise
            raise NotApplicable(f"the server refuses block downloads ({abort.code:08X}h)") from None
        if answer[0] & 0xFB != 0xA0:
            raise _failure("block download to", index, subindex, f"command {answer[0]:02X}h, expected A0h or A4h")
        self._same(answer, index, subindex, "block download to")
        if not 1 <= answer[4] <= BLOCK:
            raise CaseFailed(f"block download to {where(index, subindex)}: block size {answer[4]}, expected 1 to 127")
        return bool(answer[0] & 0x04), answer[4]

    def block_acknowledged(self, index: int, subindex: int) -> tuple[int, int]:
        """Return the server's acknowledge of a block: last good sequence number, next
        block size.
        """
        answer = self.response(index, subindex, "block download to")
        if answer[0] != 0xA2 or not 1 <= answer[2] <= BLOCK:
            raise CaseFailed(f"block download to {where(index, subindex)}: {answer.hex(' ')} acknowledges no block")
        return answer[1], answer[2]

    def end_block_download(self, index: int, subindex: int, size: int, crc: int) -> None:
        """End a block download of `size` bytes."""
        unused = -size % 7 if size else 7
        request = bytes((0xC1 | unused << 2,)) + crc.to_bytes(2, "little") + bytes(5)
        answer = self.request(request, index, subindex, "end of block download to")
        if answer[0] != 0xA1:
            raise CaseFailed(f"block download to {where(index, subindex)}: command {answer[0]:02X}h, expected A1h")

    def block_download(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        crc: bool,
        wrong_crc: bool = False,
        optional: tuple[int, ...] = (),
    ) -> bool:
        """Write an object by block transfer; return whether a CRC was agreed.

        Raises as `initiate_block_download`.
        """
        has_crc, size = self.initiate_block_download(index, subindex, len(data), crc=crc, optional=optional)
        agreed = crc and has_crc
        segments = [data[start : start + 7].ljust(7, b"\0") for start in range(0, max(len(data), 1), 7)]
        position = repeated = 0
        while position < len(segments):
            block = segments[position : position + size]
            for number, segment in enumerate(block, 1):
                last = position + number == len(segments)
                self.stream(bytes((number | 0x80 * last,)) + segment)
            good, size = self.block_acknowledged(index, subindex)
            if good > len(block):
                raise CaseFailed(f"block download to {where(index, subindex)}: {good} of {len(block)} acknowledged")
            repeated = repeated + 1 if good < len(block) else 0
            if repeated > 5:
                self.abort(index, subindex)
                raise CaseFailed(f"block download to {where(index, subindex)}: segments are asked for again and again")
            position += good
        checksum = crc16(data) if agreed else 0
        self.end_block_download(index, subindex, len(data), checksum ^ 0x5555 if wrong_crc else checksum)
        return agreed


def _failure(what: str, index: int, subindex: int, text: str) -> CaseFailed:
    """Return the failure of a response, with a cause that does not depend on the object."""
    clause = _BLOCKS if what.startswith("block") else _SDO
    return CaseFailed(f"{what} {where(index, subindex)}: {text}", cause=f"{what} an object: {text}", clause=clause)


def _named(answer: bytes) -> str:
    return where(int.from_bytes(answer[1:3], "little"), answer[3])
