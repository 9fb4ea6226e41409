"""The bytes of a log, possibly compressed with gzip, to its end or its truncation."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from coulombus.eds.regular_file import naming

__all__ = ["LONGEST_LINE", "Content"]

CHUNK = 1 << 16
LONGEST_LINE = 1 << 16
"""Maximum bytes of a line; a longer one is split, and no part is a frame."""
GZIP = b"\x1f\x8b"
GZIP_FORMAT = 31  # of zlib's `wbits`: a gzip header, and the largest window


class Content:
    """A file's content, unpacked; a context manager.

    Attributes
    ----------
    broken : bool
        The compressed data are truncated or damaged; the data before are read.
    given : int
        Bytes of the content read so far.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = str(path)
        self._file = Path(path).open("rb")  # noqa: SIM115 (closed at the end of this context)
        try:
            with naming(self._path):
                start = self._file.read(2)
                self._file.seek(0)
        except OSError:
            self._file.close()
            raise
        self._chunks = self._unpacked() if start == GZIP else self._plain()
        self._waiting = b""
        self.broken = False
        self.given = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def read(self, count: int) -> bytes:
        """Return this many bytes; fewer at the end of the content."""
        parts, size = [self._waiting], len(self._waiting)
        while size < count and (chunk := next(self._chunks, b"")):
            parts.append(chunk)
            size += len(chunk)
        whole = b"".join(parts)
        self._waiting = whole[count:]
        self.given += min(count, size)
        return whole[:count]

    def rest(self) -> int:
        """Skip to the end; return the number of bytes skipped."""
        count = 0
        while chunk := self.read(CHUNK):
            count += len(chunk)
        return count

    def lines(self) -> Iterator[tuple[str, bool]]:
        """Yield each line without its line end, and whether it has one."""
        text = b""
        while chunk := self.read(CHUNK):
            *whole, text = (text + chunk).split(b"\n")
            for line in whole:
                yield line.decode("utf-8", "replace"), True
            while len(text) > LONGEST_LINE:
                yield text[:LONGEST_LINE].decode("utf-8", "replace"), True
                text = text[LONGEST_LINE:]
        if text:
            yield text.decode("utf-8", "replace"), False

    def _plain(self) -> Iterator[bytes]:
        with naming(self._path):
            while chunk := self._file.read(CHUNK):
                yield chunk

    def _unpacked(self) -> Iterator[bytes]:
        unpacker = zlib.decompressobj(GZIP_FORMAT)
        for packed in self._plain():
            while packed:
                if unpacker.eof:  # gzip members may be concatenated
                    unpacker = zlib.decompressobj(GZIP_FORMAT)
                try:
                    chunk = unpacker.decompress(packed, CHUNK)
                except zlib.error:
                    self.broken = True
                    return
                packed = unpacker.unused_data if unpacker.eof else unpacker.unconsumed_tail
                if chunk:
                    yield chunk
        self.broken = not unpacker.eof
