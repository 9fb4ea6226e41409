"""Recordings: pcapng files of link type 227 (SocketCAN) with nanosecond stamps, as Wireshark reads them.

Every `PcapngWriter.write` writes complete blocks with one system call, so a killed process leaves a
readable file. The file holds no clock reading and no host name: same input, same bytes.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from coulombus.kernels.records import Records
from coulombus.recording.output_file import is_stream, open_new
from coulombus.recording.pcapng_blocks import (
    BYTE_ORDER_MAGIC,
    ENHANCED_PACKET,
    IF_NAME,
    IF_TSOFFSET,
    IF_TSRESOL,
    INTERFACE,
    LINKTYPE_CAN_SOCKETCAN,
    OPT_COMMENT,
    OPT_END,
    OWN_APPLICATION,
    SECTION_HEADER,
    SHB_APPLICATION,
    SHB_HARDWARE,
    SHB_OS,
    SOURCE_INSIDE,
    RecordingError,
    attachment_block,
    block,
    option,
)

__all__ = ["PcapngWriter", "SectionTexts"]

CAN_FRAME_BYTES = 16

PACKET_BLOCK = np.dtype(
    [
        ("kind", "<u4"),
        ("total", "<u4"),
        ("interface", "<u4"),
        ("stamp_high", "<u4"),
        ("stamp_low", "<u4"),
        ("captured", "<u4"),
        ("original", "<u4"),
        ("can_id", ">u4"),
        ("length", "u1"),
        ("flags", "u1", (3,)),
        ("data", "<i8"),
        ("total_again", "<u4"),
    ]
)
"""One frame without options: 48 bytes."""


@dataclass(frozen=True)
class SectionTexts:
    """Texts of a file's section (options of the Section Header Block); empty ones are omitted."""

    comment: str = ""
    """Comment on the whole recording."""
    application: str = OWN_APPLICATION
    hardware: str = ""
    operating_system: str = "Linux"


OWN_TEXTS = SectionTexts()


class PcapngWriter:
    """Write frames to a pcapng file.

    Parameters
    ----------
    path
        The file; a named pipe works too (``wireshark -k -i PIPE``).
    attachments
        Name -> content, stored before the frames with its SHA-256.
    epoch_ns
        Added to each frame's `t_ns`: nanoseconds from 1970 to the frames' time 0.
    started_ns
        CLOCK_REALTIME at the frames' time 0, if known. The stamps are unchanged; its whole seconds
        are stored as if_tsoffset, so that Wireshark shows the date. The reader ignores it in
        coulombus' files.
    force
        Overwrite an existing file.
    texts
        Texts on the recording and its application.
    interface
        Name of the interface; an empty name is omitted. None: all are added later (`add_interface`).
    second
        Name of a second interface, for frames whose `source` is `SOURCE_INSIDE`.

    Raises
    ------
    RecordingError
        The file cannot be opened or written, or was removed; also raised by every later call but `close`.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        attachments: Mapping[str, bytes],
        epoch_ns: int = 0,
        started_ns: int = 0,
        force: bool = False,
        texts: SectionTexts = OWN_TEXTS,
        interface: str | None = "can0",
        second: str = "",
    ) -> None:
        self.path = str(path)
        self.epoch_ns = epoch_ns
        self.frames = 0
        self.bytes = 0
        self._failure: str | None = None
        self._buffer = _template(0)
        head = _section(texts)
        if interface is not None:
            head += _interface(interface, started_ns // 1_000_000_000)
        self._second = bool(second)
        self._interfaces = 0 if interface is None else 1
        self._started_s = started_ns // 1_000_000_000
        if second:
            head += _interface(second, started_ns // 1_000_000_000)
        head += b"".join(attachment_block(name, content) for name, content in attachments.items())
        try:
            self._fd = open_new(Path(self.path), force=force)
        except FileExistsError as error:
            raise RecordingError(f"{self.path} {error.strerror}") from error
        except OSError as error:
            raise RecordingError(
                f"{self.path}: the recording cannot be created ({error.strerror}); "
                "choose a folder that exists and can be written"
            ) from error
        self._is_file = stat.S_ISREG(os.fstat(self._fd).st_mode)
        try:
            self._write(head)
        except BaseException:  # without its header it is no recording, and would block the next one
            os.close(self._fd)
            if not force and not is_stream(Path(self.path)):
                with suppress(OSError):
                    os.unlink(self.path)
            raise

    def write(self, frames: Records, comments: Mapping[int, str] | None = None) -> None:
        """Append `frames` (records of `FRAME`); `comments` maps a row of this batch to its text.

        Raises
        ------
        RecordingError
            The file has none or only the first complete blocks of the batch; nothing more is written.
        ValueError
            A row does not exist, a stamp is before 1970, or a length exceeds 8.
        """
        count = len(frames)
        if count > len(self._buffer):
            self._buffer = _template(count)
        blocks = self._buffer[:count]
        if count:
            stamps = frames["t_ns"] + self.epoch_ns
            if stamps.min() < 0:
                raise ValueError(f"a frame's stamp is {stamps.min()} ns: stamps begin at 1970; raise epoch_ns")
            if frames["length"].max() > 8 or frames["length"].min() < 0:
                raise ValueError("a frame's length is not in 0..8: CAN FD frames are not recorded")
            blocks["stamp_high"] = stamps >> 32
            blocks["stamp_low"] = stamps & 0xFFFFFFFF
            blocks["can_id"] = frames["can_id"]
            blocks["length"] = frames["length"]
            blocks["data"] = frames["word"]
            if self._second:
                blocks["interface"] = frames["source"] == SOURCE_INSIDE
                count -= int(np.count_nonzero(blocks["interface"]))
            elif self._interfaces != 1:
                blocks["interface"] = frames["source"]
        self._write(_commented(blocks, comments) if comments else blocks.tobytes())
        self.frames += count

    def add_interface(self, name: str) -> int:
        """Add an interface; return its number, the `source` of its frames.

        Raises
        ------
        RecordingError
            As from `write`.
        ValueError
            The file has a `second` interface.
        """
        if self._second:
            raise ValueError(f"{self.path}: it has an interface of the host, and no more than two")
        self._write(_interface(name, self._started_s))
        self._interfaces += 1
        return self._interfaces - 1

    def attach(self, name: str, content: bytes) -> None:
        """Add an attachment between the frames, for data known only now; RecordingError as from `write`."""
        self._write(attachment_block(name, content))

    def flush(self) -> None:
        """Sync the file to disk (against a power cut; a killed process needs no flush)."""
        try:
            os.fsync(self._fd)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EROFS):  # a pipe cannot be synchronised
                raise self._fail(error) from error

    def fileno(self) -> int:
        """Return the file's descriptor, -1 when it is closed."""
        return self._fd

    @property
    def failed(self) -> bool:
        """Whether the file can no longer be written."""
        return self._failure is not None

    def close(self) -> None:
        """Close the file; idempotent."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            try:
                os.close(fd)
                self._check_there()
            except OSError as error:  # a network file system may refuse only here
                if self._failure is None:
                    raise self._fail(error) from error

    def __enter__(self) -> PcapngWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, data: bytes) -> None:
        if self._failure is not None:
            raise RecordingError(self._failure)
        if self._fd < 0:
            raise ValueError(f"{self.path}: the recording is closed")
        rest = memoryview(data)
        try:
            self._check_there()
            while rest:  # one call, unless the disk fills up or it is a pipe
                rest = rest[os.write(self._fd, rest) :]
        except OSError as error:
            if len(rest) < len(data):  # a torn block: truncate it if possible
                with suppress(OSError):
                    os.ftruncate(self._fd, self.bytes)
            raise self._fail(error) from error
        self.bytes += len(data)

    def _check_there(self) -> None:
        """Raise an OSError if the file is no longer at its path: without one, a removed file can be written."""
        if self._is_file:
            os.stat(self.path)

    def _fail(self, error: OSError) -> RecordingError:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        gone = error.errno in (errno.ENOENT, errno.ENOTDIR)
        self._failure = (
            f"{self.path}: the recording stopped after {self.frames} frames, {self.bytes} bytes ({error.strerror}); "
            + ("the file or its folder was removed; " if gone else "what was written stays readable; ")
            + ("free some space, or record to another disk" if full else "record to another place")
        )
        return RecordingError(self._failure)


def _template(count: int) -> Records:
    blocks = np.zeros(count, PACKET_BLOCK)
    blocks["kind"] = ENHANCED_PACKET
    blocks["total"] = blocks["total_again"] = PACKET_BLOCK.itemsize
    blocks["captured"] = blocks["original"] = CAN_FRAME_BYTES
    return blocks


def _section(texts: SectionTexts) -> bytes:
    options = (
        (OPT_COMMENT, texts.comment),
        (SHB_HARDWARE, texts.hardware),
        (SHB_OS, texts.operating_system),
        (SHB_APPLICATION, texts.application),
    )
    section = struct.pack("<IHHq", BYTE_ORDER_MAGIC, 1, 0, -1)
    section += b"".join(option(code, text.encode()) for code, text in options if text)
    return block(SECTION_HEADER, section + option(OPT_END, b""))


def _interface(name: str, offset_s: int) -> bytes:
    content = struct.pack("<HHI", LINKTYPE_CAN_SOCKETCAN, 0, CAN_FRAME_BYTES)
    content += (option(IF_NAME, name.encode()) if name else b"") + option(IF_TSRESOL, b"\x09")
    content += option(IF_TSOFFSET, struct.pack("<q", offset_s)) if offset_s else b""
    return block(INTERFACE, content + option(OPT_END, b""))


def _commented(blocks: Records, comments: Mapping[int, str]) -> bytes:
    """Return the blocks' bytes; rows in `comments` have a comment option."""
    if min(comments) < 0 or max(comments) >= len(blocks):
        raise ValueError(f"comments on rows {sorted(comments)}: this batch has {len(blocks)} frames, counted from 0")
    pieces, at = [], 0
    for row in sorted(comments):
        body = blocks[row].tobytes()[8:-4] + option(OPT_COMMENT, comments[row].encode()) + option(OPT_END, b"")
        pieces += [blocks[at:row].tobytes(), block(ENHANCED_PACKET, body)]
        at = row + 1
    return b"".join([*pieces, blocks[at:].tobytes()])
