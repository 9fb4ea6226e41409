"""The SDO server: expedited and segmented transfers both ways (CiA 301, section 7.2.4).

The server is a function of the requests: one 8-byte request in, one response out (None: no answer). What is read and
written is behind `Backend`, so that the protocol is tested without a device. One transfer is open at most;
a new initiation replaces it, as section 7.2.4.3 wants it, and an abort in either direction ends it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from eds.cia301 import Abort
from node.dictionary import SdoAbort

__all__ = ["Backend", "SdoServer", "abort_frame"]

_SEGMENT = 7


class Backend(Protocol):
    """What the server serves."""

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the object's bytes or raise `SdoAbort`."""

    def check_download(self, index: int, subindex: int, size: int | None) -> int:
        """Raise `SdoAbort` unless `size` bytes (None: not said) may be written; return how many at most."""

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the object or raise `SdoAbort`."""


@dataclass
class _Transfer:
    """A segmented transfer that is open."""

    index: int
    subindex: int
    upload: bool
    data: bytearray
    toggle: int = 0
    position: int = 0
    size: int | None = None  # of a download, when the client said it
    longest: int = 0


def abort_frame(index: int, subindex: int, code: int) -> bytes:
    """Return the abort frame for an object."""
    return bytes((0x80, index & 0xFF, index >> 8, subindex)) + int(code).to_bytes(4, "little")


class SdoServer:
    """One SDO server channel."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._open: _Transfer | None = None

    @property
    def transfer(self) -> tuple[int, int] | None:
        """(index, sub-index) of the transfer that is open."""
        return (self._open.index, self._open.subindex) if self._open else None

    def drop(self) -> None:
        """Forget the open transfer (time-out, reset)."""
        self._open = None

    def request(self, data: bytes) -> bytes | None:
        """Serve one request of 8 bytes and return the response."""
        command = data[0] >> 5
        index, subindex = int.from_bytes(data[1:3], "little"), data[3]
        if command in (_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT) and self._open:
            index, subindex = self._open.index, self._open.subindex
        try:
            return _SERVICES[command](self, data, index, subindex)
        except SdoAbort as abort:
            self._open = None
            return abort_frame(index, subindex, abort.code)

    def _initiate_download(self, data: bytes, index: int, subindex: int) -> bytes:
        self._open = None
        expedited, sized = data[0] & 0x02, data[0] & 0x01
        if expedited:
            # without a size the client means as many of the four bytes as the object has
            longest = self._backend.check_download(index, subindex, None)
            content = data[4 : 8 - (data[0] >> 2 & 3)] if sized else data[4 : 4 + min(longest, 4)]
            self._backend.check_download(index, subindex, len(content))
            self._backend.download(index, subindex, content)
        else:
            size = int.from_bytes(data[4:8], "little") if sized else None
            longest = self._backend.check_download(index, subindex, size)
            self._open = _Transfer(index, subindex, False, bytearray(), size=size, longest=longest)
        return bytes((0x60, data[1], data[2], data[3], 0, 0, 0, 0))

    def _download_segment(self, data: bytes, index: int, subindex: int) -> bytes:
        transfer = self._expect(upload=False, toggle=data[0] & 0x10)
        transfer.data += data[1 : 8 - (data[0] >> 1 & 7)]
        if len(transfer.data) > (transfer.longest if transfer.size is None else transfer.size):
            raise SdoAbort(Abort.TOO_LONG)
        if data[0] & 0x01:
            self._open = None
            if transfer.size is not None and len(transfer.data) < transfer.size:
                raise SdoAbort(Abort.TOO_SHORT)
            self._backend.check_download(index, subindex, len(transfer.data))
            self._backend.download(index, subindex, bytes(transfer.data))
        return bytes((0x20 | data[0] & 0x10, 0, 0, 0, 0, 0, 0, 0))

    def _initiate_upload(self, data: bytes, index: int, subindex: int) -> bytes:
        self._open = None
        content = self._backend.upload(index, subindex)
        head = bytes((data[1], data[2], data[3]))
        if 1 <= len(content) <= 4:
            return bytes((0x43 | (4 - len(content)) << 2,)) + head + content.ljust(4, b"\0")
        self._open = _Transfer(index, subindex, True, bytearray(content))
        return b"\x41" + head + len(content).to_bytes(4, "little")

    def _upload_segment(self, data: bytes, index: int, subindex: int) -> bytes:
        transfer = self._expect(upload=True, toggle=data[0] & 0x10)
        segment = transfer.data[transfer.position : transfer.position + _SEGMENT]
        transfer.position += _SEGMENT
        last = transfer.position >= len(transfer.data)
        if last:
            self._open = None
        return bytes((data[0] & 0x10 | (_SEGMENT - len(segment)) << 1 | last,)) + bytes(segment).ljust(_SEGMENT, b"\0")

    def _expect(self, *, upload: bool, toggle: int) -> _Transfer:
        """Return the open transfer of this direction, its toggle bit checked and alternated."""
        if self._open is None or self._open.upload != upload:
            raise SdoAbort(Abort.COMMAND)
        if self._open.toggle != toggle:
            raise SdoAbort(Abort.TOGGLE)
        self._open.toggle ^= 0x10
        return self._open

    def _abort(self, data: bytes, index: int, subindex: int) -> None:
        self._open = None

    def _unknown(self, data: bytes, index: int, subindex: int) -> bytes:
        raise SdoAbort(Abort.COMMAND)


_DOWNLOAD_SEGMENT, _UPLOAD_SEGMENT = 0, 3
_SERVICES: tuple[Callable[[SdoServer, bytes, int, int], bytes | None], ...] = (
    SdoServer._download_segment,
    SdoServer._initiate_download,
    SdoServer._initiate_upload,
    SdoServer._upload_segment,
    SdoServer._abort,
    SdoServer._unknown,  # block upload
    SdoServer._unknown,  # block download
    SdoServer._unknown,
)
"""The service of each client command specifier (bits 7-5 of byte 0)."""
