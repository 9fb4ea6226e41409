"""Read pcapng files of link type 227: coulombus' recordings, and those of dumpcap, tcpdump -w, editcap.

A file is read `CHUNK` bytes at a time, so that memory does not depend on its length
(`iter_pcapng`). A file compressed with gzip or zstd is unpacked while it is read; offsets in texts
are those of its content. One kernel walks from block to block, another decodes the packets.
Sections may have either byte order and any time resolution; captured packets may be 16 bytes (as
the kernel gives them) or 8 + length.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from coulombus.eds.regular_file import require_regular
from coulombus.kernels.records import Records
from coulombus.recording.file_content import LATE, Capture, joined, unpack_late
from coulombus.recording.folders import present, segments
from coulombus.recording.logs.content import Content
from coulombus.recording.pcapng_blocks import (
    ATTACHMENT,
    BYTE_ORDER_MAGIC,
    ENHANCED_PACKET,
    INTERFACE,
    LINKTYPE_CAN_SOCKETCAN,
    MAX_BLOCK,
    OPT_COMMENT,
    OWN_APPLICATION,
    PACKET,
    SHB_APPLICATION,
    SHB_HARDWARE,
    SHB_OS,
    SIMPLE_PACKET,
    PcapngError,
    TooLarge,
    iter_options,
    next_block,
    other_format,
    read_attachment,
)
from coulombus.recording.pcapng_packets import (
    BAD,
    END,
    FULL,
    SECTION,
    BadPacketError,
    Integers,
    Interface,
    Words,
    column,
    decode_packets,
    read_interface,
    walk,
)
from coulombus.recording.time_search import ALL, Window, offset_before
from coulombus.wire.frame import FRAME

__all__ = ["iter_pcapng", "read_pcapng"]

CHUNK = 1 << 20
"""Bytes read at a time: 22,000 frames, 3.6 s of a rig with one axis at 1 kHz."""
MOST_ATTACHED, ATTACHED_SHARE = 128 << 20, 4
"""Maximum bytes of all attachments, plus 4 per byte of the file before them: a trace is shorter than its frames."""
BLOCKS = 1 << 15  # walked at a time
RESUMED = 1 << 16
"""Maximum bytes of the next block after damage."""
MOST_DESCRIBED = 1 << 14
"""Maximum number of sections and interfaces of a file together: 8,192 captures in a row, of an interface each."""
MOST_LISTED = 10
FEW = 64
"""Packets that are decoded of a stretch before the window: its end is known then."""


@dataclass
class _Reader:
    path: str
    file: Content
    window: Window
    data: bytes = b""
    words: Words = field(default_factory=lambda: np.zeros(0, np.uint32))
    base: int = 0
    """Offset of `data` in the file."""
    order: str = "<"
    own: bool = False
    """Whether the section is a coulombus recording, whose times count from its own time 0."""
    interfaces: list[Interface] = field(default_factory=list)
    earlier: int = 0
    buses: list[str] = field(default_factory=list)
    """Name of the bus of each interface, of all sections so far; "" without a bus."""
    sections: int = 0
    linktypes: set[int] = field(default_factory=set)
    texts: dict[int, str] = field(default_factory=dict)
    # of this stretch
    parts: list[Records] = field(default_factory=list)
    rows: int = 0
    """Number of frames in `parts`."""
    inside: list[Records] = field(default_factory=list)
    comments: list[tuple[int, str]] = field(default_factory=list)
    late: list[tuple[int, str]] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    skipped: int = 0
    torn: int = 0
    attached: int = 0
    """Bytes of all attachments so far, uncompressed."""
    excessive: bool = False
    begun: bool = False
    """Whether a stretch with frames was taken: the first one gives the recording's time 0."""

    def more(self, at: int) -> bool:
        """Drop the words before `at` and read more; return whether there was more."""
        chunk = self.file.read(CHUNK)
        self.base += 4 * at
        self.data = self.data[4 * at :] + chunk
        self.words = np.frombuffer(self.data, "<u4", len(self.data) // 4)
        return bool(chunk)

    def leave(self, size: int) -> None:
        """Drop the first bytes of `data`; the next block need not be aligned to four bytes."""
        self.base += size
        self.data = self.data[size:]
        self.words = np.frombuffer(self.data, "<u4", len(self.data) // 4)

    def seek(self) -> None:
        """Go on shortly before the window, if it is behind what was read of a recording of this project."""
        last = np.concatenate([part["t_ns"] for part in self.parts[-1:]] or [np.zeros(0, np.int64)])
        if self.own and not self.file.packing and len(last) and self.window.is_behind(int(last[-1])):
            self.base = offset_before(self.path, self.base, self.order, self.interfaces, self.window)
            self.file.seek(self.base)
            self.data, self.window = b"", ALL

    def is_earlier(self, packet: Integers) -> bool:
        """Return whether this packet, the last of some, is before the window of a recording of this project."""
        if not self.own or self.window.begin_ns is None or not self.begun:
            return False
        stamps_ns = decode_packets(self.words, packet, self.order, self.interfaces, 0).stamps_ns
        return len(stamps_ns) == 1 and self.window.is_behind(int(stamps_ns[0]))

    def end_stretch(self, torn: int = 0) -> Capture:
        """Return the stretch just read, and begin the next."""
        capture = Capture(
            path=self.path,
            frames=_joined(self.parts),
            comments=self.comments,
            attachments=self.attachments,
            comment=self.texts.get(OPT_COMMENT, ""),
            application=self.texts.get(SHB_APPLICATION, ""),
            hardware=self.texts.get(SHB_HARDWARE, ""),
            operating_system=self.texts.get(SHB_OS, ""),
            torn=torn,
            skipped=self.skipped,
            warnings=tuple(self.warnings),
            inside=_joined(self.inside),
            buses=tuple(self.buses),
            late=tuple(self.late),
        )
        self.begun = self.begun or len(capture.frames) > 0
        self.inside, self.late = [], []
        self.parts, self.comments, self.attachments, self.warnings = [], [], {}, []
        self.rows = self.skipped = 0
        return capture


def _joined(parts: Sequence[Records]) -> Records:
    if len(parts) == 1:  # as usual: not copied
        return parts[0]
    return np.concatenate([np.zeros(0, FRAME), *parts])


def iter_pcapng(path: str | Path, window: Window = ALL) -> Iterator[Capture]:
    """Read a pcapng file of SocketCAN frames stretch by stretch, in bounded memory. For a folder
    (`recording.segments`) the segments of its newest run are read as one file.

    Each stretch has its own content; the section's texts are those read so far. After a damaged
    block, reading continues at the next complete one, and `Capture.warnings` has the bytes between
    them. The last stretch, perhaps without a frame, reports an incomplete last block, which is
    omitted (`Capture.torn`). A file that is still being written is read to its present end.

    With a `window` stretches outside of it may be left out, in recordings of this project, whose
    stamps rise. The first stretch has the attachments.

    Raises
    ------
    PcapngError
        The file is empty, of another format, has a damaged section header or interface, or holds no
        CAN interface; raised at the stretch concerned.
    OSError
        It cannot be opened or read.
    """
    if Path(path).is_dir():
        yield from _of_segments(_segments(path), window)
        return
    require_regular(path)
    with Content(path) as file:
        reader = _Reader(str(path), file, window)
        reader.more(0)
        _check_start(reader)
        offsets = np.zeros(BLOCKS, np.int64)
        at, reason = 0, FULL
        while True:
            if reason == END:
                reader.leave(4 * at)
                reader.seek()
                more, at = reader.more(0), 0
                if more:
                    if reader.begun or reader.rows:  # the first stretch has frames
                        yield (capture := reader.end_stretch())
                        if reader.own and len(capture.frames) and window.is_before(int(capture.frames["t_ns"][0])):
                            return
                elif not _resume(reader, 0, "a block that does not end"):
                    break
            count, at, reason = walk(reader.words, at, int(reader.order == ">"), offsets)
            _decode_blocks(reader, offsets[:count])
            if reason == SECTION:
                at, reason = _section(reader, at)
            elif reason == BAD:
                if not _resume(reader, at, _what_is_bad(reader, at)):
                    break
                at = 0
    if file.broken:
        reader.warnings.append(f"{reader.path}: {file.broken}: what stood behind is not known")
    _check_linktypes(reader)
    yield reader.end_stretch(reader.torn)


def _of_segments(paths: list[Path], window: Window) -> Iterator[Capture]:
    """Yield the stretches of a run's segments, from the last that begins before the window on."""
    first, end = 0, len(paths)
    while window.begin_ns is not None and end - first > 1:
        middle = (first + end) // 2
        begin_ns = _first_ns(paths[middle])
        if begin_ns is not None and window.is_behind(begin_ns):
            first = middle
        else:
            end = middle
    for path in paths[first:]:
        for capture in iter_pcapng(present(path), window):
            yield capture
            if len(capture.frames) and window.is_before(int(capture.frames["t_ns"][0])):
                return


def _first_ns(path: Path) -> int | None:
    """Return the first stamp of a segment; None if it has no frame."""
    stamps = (int(capture.frames["t_ns"][0]) for capture in iter_pcapng(present(path)) if len(capture.frames))
    return next(stamps, None)


def _segments(path: str | Path) -> list[Path]:
    """Return the segments in a folder, at least one."""
    paths = segments(Path(path))
    if not paths:
        raise PcapngError(
            f"{path}: there is no recording in this folder; expected a run's segments, as in 000001.pcapng"
        )
    return paths


def read_pcapng(path: str | Path) -> Capture:
    """Read a whole pcapng file of SocketCAN frames, 40 bytes of memory for each.

    Raises as `iter_pcapng`.
    """
    return joined(path, list(iter_pcapng(path)))


def _check_start(reader: _Reader) -> None:
    start = reader.data[:4]
    if not start and reader.file.broken:
        raise PcapngError(f"{reader.path}: {reader.file.broken}: nothing of it can be unpacked; take another file")
    if not start:
        raise PcapngError(f"{reader.path}: the file is empty: nothing was recorded; take another file")
    if not b"\x0a\x0d\x0d\x0a".startswith(start):
        what = other_format(reader.data, str(reader.path)) or (
            f"it begins with {start.hex(' ')}, a pcapng file with 0a 0d 0d 0a; and it is no log that is known by its "
            "content or its name: candump's .log, .asc, .blf, .trc, .csv, .mf4"
        )
        raise PcapngError(f"{reader.path}: offset 0: not a pcapng file: {what}")


def _damaged(reader: _Reader, start: int, what: str) -> PcapngError:
    """Return the error for byte `start` of the reader's data."""
    offset, path = reader.base + start, reader.path
    unpacked = {"gzip": f"zcat {path} | head -c {offset}", "zstd": f"zstdcat {path} | head -c {offset}"}
    remedy = unpacked.get(reader.file.packing, f"head -c {offset} {path}")
    return PcapngError(
        f"{path}: offset {offset}: {what}; the file is damaged there: "
        f"keep what stands before it with '{remedy} > repaired.pcapng'"
    )


def _what_is_bad(reader: _Reader, at: int) -> str:
    kind, length = struct.unpack_from(reader.order + "II", reader.data, 4 * at)
    if length < 12 or length % 4 or length > MAX_BLOCK:
        return f"a block (type {kind:#010x}) of {length} bytes, expected 12 to {MAX_BLOCK} in steps of four"
    (again,) = struct.unpack_from(reader.order + "I", reader.data, 4 * at + length - 4)
    return f"a block (type {kind:#010x}) of {length} bytes ends with the length {again}, expected the same"


def _section(reader: _Reader, at: int) -> tuple[int, int]:
    """Process the section header at word `at`.

    Return the next block's position and FULL, or `at` and END if more must be read first.
    """
    start = 4 * at
    if len(reader.data) < start + 12:
        return at, END
    for byte_order in "<>":
        length, magic = struct.unpack_from(byte_order + "II", reader.data, start + 4)
        if magic == BYTE_ORDER_MAGIC:
            break
    else:
        raise _damaged(reader, start, f"a section header with the byte-order magic {magic:#x}, expected 0x1a2b3c4d")
    reader.order = byte_order
    if length < 28 or length % 4 or length > MAX_BLOCK:
        raise _damaged(reader, start, f"a section header of {length} bytes, expected 28 to {MAX_BLOCK}")
    if start + length > len(reader.data):
        return at, END
    if struct.unpack_from(byte_order + "I", reader.data, start + length - 4)[0] != length:
        raise _damaged(reader, start, _what_is_bad(reader, at))
    major = struct.unpack_from(byte_order + "H", reader.data, start + 12)[0]
    if major != 1:
        where = f"{reader.path}: offset {reader.base + start}"
        raise PcapngError(f"{where}: pcapng version {major}, this reads version 1; convert it")
    reader.own = False
    for code, value in iter_options(reader.data[start + 24 : start + length - 4], byte_order):
        text = value.decode(errors="replace")
        reader.own |= code == SHB_APPLICATION and text == OWN_APPLICATION
        reader.texts.setdefault(code, text)
    reader.earlier += len(reader.interfaces)
    reader.interfaces = []
    reader.sections += 1
    _check_number(reader, start)
    return at + int(length) // 4, FULL


def _resume(reader: _Reader, at: int, what: str) -> bool:
    """Skip the damaged block at word `at` to the next complete block; return whether there is one.
    Otherwise all bytes to the file's end are an incomplete block.
    """
    reader.leave(4 * at)
    offset, begin = reader.base, min(4, len(reader.data))
    while (place := next_block(reader.data, begin, reader.order, RESUMED)) is None:
        reader.leave(max(len(reader.data) - RESUMED, begin))
        begin = 0
        chunk = reader.file.read(CHUNK)
        if not chunk:
            reader.torn = reader.base + len(reader.data) - offset
            return False
        reader.data += chunk
    reader.leave(place)
    reader.warnings.append(f"{reader.path}: offset {offset}: {reader.base - offset} bytes were left out: {what}")
    return True


def _decode_blocks(reader: _Reader, offsets: Integers) -> None:
    """Decode the blocks at `offsets` (words): packets as columns, other blocks singly."""
    kinds = column(reader.words, offsets, reader.order)
    for at, kind in zip(offsets[kinds != ENHANCED_PACKET].tolist(), kinds[kinds != ENHANCED_PACKET], strict=True):
        length = struct.unpack_from(reader.order + "I", reader.data, 4 * at + 4)[0]
        body = reader.data[4 * at + 8 : 4 * at + length - 4]
        if kind == INTERFACE:
            if len(body) < 8:
                raise _damaged(reader, 4 * at, f"an interface block of {len(body)} bytes, expected at least 8")
            interface = read_interface(body, reader.order, own=reader.own)
            reader.linktypes.add(interface.linktype)
            is_bus = interface.linktype == LINKTYPE_CAN_SOCKETCAN and not interface.inside
            reader.buses.append((interface.name or str(len(reader.interfaces))) if is_bus else "")
            reader.interfaces.append(interface)
            _check_number(reader, 4 * at)
        elif kind == ATTACHMENT:
            most_bytes = MOST_ATTACHED + ATTACHED_SHARE * (reader.base + 4 * at) - reader.attached
            attached = read_attachment(body, most_bytes)
            if isinstance(attached, TooLarge):
                if not reader.excessive:
                    text = f"attachments of more than {reader.attached} bytes, in so small a file, are left out from here on"
                    reader.warnings.append(f"{reader.path}: offset {reader.base + 4 * at}: {text}")
                reader.excessive = True
            elif isinstance(attached, str):
                reader.warnings.append(f"{reader.path}: offset {reader.base + 4 * at}: {attached}")
            elif attached is not None:
                reader.attached += len(attached[1])
                _attach(reader, *attached, 4 * at)
        elif kind in (PACKET, SIMPLE_PACKET):
            reader.skipped += 1
    packets = offsets[kinds == ENHANCED_PACKET]
    if not len(packets):
        return
    if reader.is_earlier(packets[-1:]):
        packets = packets[-FEW:]
    try:
        decoded = decode_packets(reader.words, packets, reader.order, reader.interfaces, reader.earlier)
    except BadPacketError as error:
        raise _damaged(reader, error.offset, error.what) from None
    if decoded.damaged:
        (offset, what), count = decoded.damaged[0], len(decoded.damaged)
        packets_ = "1 packet was" if count == 1 else f"{count} packets were"
        reader.warnings.append(f"{reader.path}: offset {reader.base + offset}: {what}: {packets_} left out")
    done, frames, inside = reader.rows, decoded.frames, decoded.inside
    reader.rows += len(frames)
    reader.parts.append(frames)
    reader.inside.append(inside)
    reader.skipped += len(packets) - len(frames) - len(inside) - len(decoded.damaged)
    for before, begin, end in decoded.options:
        row = min(before, len(frames) - 1)  # a comment on telemetry moves to the next frame
        if row < 0:
            continue
        for code, value in iter_options(reader.data[begin:end], reader.order):
            if code == OPT_COMMENT:
                reader.comments.append((done + row, value.decode(errors="replace")))


def _attach(reader: _Reader, name: str, content: bytes, start: int) -> None:
    """Keep an attachment; that of the markers after the last frame is read."""
    if name != LATE or not reader.own:
        reader.attachments[name] = content
        return
    try:
        reader.late += unpack_late(content)
    except ValueError as error:
        text = f"attachment {name!r} is damaged ({error}) and was left out"
        reader.warnings.append(f"{reader.path}: offset {reader.base + start}: {text}")


def _check_number(reader: _Reader, start: int) -> None:
    """Refuse a file of more sections and interfaces than a recording has."""
    if reader.sections + len(reader.buses) > MOST_DESCRIBED:
        raise _damaged(reader, start, f"more than {MOST_DESCRIBED} sections and interfaces, which no recording has")


def _check_linktypes(reader: _Reader) -> None:
    if reader.linktypes and LINKTYPE_CAN_SOCKETCAN not in reader.linktypes:
        kinds = ", ".join(str(kind) for kind in sorted(reader.linktypes)[:MOST_LISTED])
        if len(reader.linktypes) > MOST_LISTED:
            kinds += f" and {len(reader.linktypes) - MOST_LISTED} more"
        raise PcapngError(
            f"{reader.path}: it holds link type {kinds}, expected {LINKTYPE_CAN_SOCKETCAN} (SocketCAN): "
            "record on a CAN interface (can0, vcan0), not on 'any' or a network card"
        )
