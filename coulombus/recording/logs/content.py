"""The bytes of a recording or a log, unpacked from gzip or zstd, to their end or their truncation."""

from __future__ import annotations

import codecs
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from coulombus.eds.regular_file import naming

__all__ = ["LONGEST_LINE", "Content"]

CHUNK = 1 << 16
SLICE = 1 << 11
"""Compressed bytes unpacked at a time: at most 64 MiB of content, in a file made for that."""
LONGEST_LINE = 1 << 16
"""Maximum bytes of a line; a longer one is split, and no part is a frame."""
MOST_RATIO, FREE_BYTES = 500, 32 << 20
"""Maximum content of a compressed file: 32 MiB, and 500 times its bytes. A log's stamps differ, so that it has a few
dozen times its bytes.
"""
GZIP_FORMAT = 31  # of zlib's `wbits`: a gzip header, and the largest window


def _zstd() -> Any:
    import zstandard

    return zstandard.ZstdDecompressor().decompressobj()


PACKINGS: dict[bytes, tuple[str, Callable[[], Any]]] = {
    b"\x1f\x8b": ("gzip", lambda: zlib.decompressobj(GZIP_FORMAT)),
    b"\x28\xb5\x2f\xfd": ("zstd", _zstd),
}
"""First bytes of a compressed file -> its format, and an object that unpacks one member (frame) of it."""


class Content:
    """A file's content, unpacked while it is read; a context manager.

    Attributes
    ----------
    packing : str
        "gzip", "zstd", or "" for a file that is not compressed.
    broken : str
        If the compressed data are truncated or damaged, or unpack to more than a log can have, where and how; the
        data before are read.
    position : int
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
                start = self._file.read(4)
                self._file.seek(0)
        except OSError:
            self._file.close()
            raise
        self.packing, member = next((PACKINGS[magic] for magic in PACKINGS if start.startswith(magic)), ("", None))
        self._chunks = self._plain(CHUNK) if member is None else self._unpacked(member)
        self._chunk, self._at = b"", 0
        self.broken = ""
        self.position = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def read(self, count: int) -> bytes:
        """Return this many bytes; fewer at the end of the content."""
        parts, left = [], count
        while left:
            if self._at == len(self._chunk):
                self._chunk, self._at = next(self._chunks, b""), 0
                if not self._chunk:
                    break
            part = self._chunk[self._at : self._at + left]
            parts.append(part)
            self._at += len(part)
            left -= len(part)
        self.position += count - left
        return b"".join(parts)

    def seek(self, offset: int) -> None:
        """Go on at an offset of a file that is not compressed."""
        with naming(self._path):
            self._file.seek(offset)
        self._chunk, self._at = b"", 0

    def rest(self) -> int:
        """Skip to the end; return the number of bytes skipped."""
        count = 0
        while chunk := self.read(CHUNK):
            count += len(chunk)
        return count

    def lines(self, end: bytes = b"\n") -> Iterator[tuple[str, bool]]:
        """Yield each line without its line end, and whether it has one."""
        text = b""
        while chunk := self.read(CHUNK):
            chunk = chunk.removeprefix(codecs.BOM_UTF8) if self.position <= CHUNK else chunk
            *whole, text = (text + chunk).split(end)
            for line in whole:
                yield line.decode("utf-8", "replace"), True
            while len(text) > LONGEST_LINE:
                yield text[:LONGEST_LINE].decode("utf-8", "replace"), True
                text = text[LONGEST_LINE:]
        if text:
            yield text.decode("utf-8", "replace"), False

    def _plain(self, size: int) -> Iterator[bytes]:
        with naming(self._path):
            while chunk := self._file.read(size):
                yield chunk

    def _unpacked(self, member: Callable[[], Any]) -> Iterator[bytes]:
        unpacker, at, size = member(), 0, 0
        for packed in self._plain(SLICE):
            at += len(packed)
            while packed:
                if unpacker.eof:  # members may be concatenated
                    unpacker = member()
                try:
                    chunk = unpacker.decompress(packed)
                except Exception as error:  # each library has its own
                    self.broken = f"offset {at - len(packed)}: its {self.packing} data are damaged ({error})"
                    return
                packed = unpacker.unused_data
                size += len(chunk)
                if chunk:
                    yield chunk
                if size > FREE_BYTES + MOST_RATIO * at:
                    self.broken = (
                        f"offset {at}: it unpacks to {size >> 20} MiB, more than {FREE_BYTES >> 20} MiB and {MOST_RATIO} "
                        "times its bytes, so that it is no log; unpack it yourself if it is"
                    )
                    return
        if not unpacker.eof:
            self.broken = f"offset {at}: its {self.packing} data end too early"
