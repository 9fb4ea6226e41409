"""Vector's .blf: objects in containers, which may be compressed.

::

    file     LOGG | size of the header | ... | objects | ... | start       144 bytes
    object   LOBJ | size of its header | version | size | kind | flags, ... | stamp | content
    container (kind 10)   LOBJ | 16 | 1 | size | 10 | compression | size of the content | content

An object may begin in one container and end in the next.
"""

from __future__ import annotations

import struct
import zlib
from datetime import UTC, datetime

from coulombus.recording.logs.content import Content
from coulombus.recording.logs.log import BUS_ERROR, FD, Log, identifier
from coulombus.wire.can_flags import CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["BASE", "LEAST", "MAGIC", "MOST", "read"]

MAGIC = b"LOGG"
FILE_HEADER = struct.Struct("<4sL8xQ8xL4x8H16x")
"""Signature, size, size of the file, number of objects, Windows' SYSTEMTIME of the start."""
BASE = struct.Struct("<4sHHLL")
"""Header of each object: signature, size and version of the header, size of the object, kind."""
STAMP = struct.Struct("<L4xQ")
CONTAINER = struct.Struct("<H6xL4x")
MESSAGE = struct.Struct("<HBBL8s")
ERROR_EXT = struct.Struct("<H8xBx4xL4x8s")
FD_MESSAGE = struct.Struct("<HBBL5xBB5x64s")
FD_MESSAGE_64 = struct.Struct("<BBBxL4xL24x")
LOG_CONTAINER, DEFLATE = 10, 2
MESSAGES, ERROR, ERROR_EXTENDED, MESSAGE_FD, MESSAGE_FD_64 = (1, 86), 2, 73, 100, 101
HEADERS = {1: 32, 2: 40}  # sizes by the header's version
LEAST = 32
"""Least bytes of an object: its two headers."""
MOST = 1 << 26
"""Maximum bytes of a container's content; writers begin a new one after 128 kB."""
PADDING = 8
TEN_US, REMOTE, EXTENDED, ID_BITS, CLASSICAL = 1, 0x80, 1 << 31, 0x1FFF_FFFF, 8
FDF, FDF_64, REMOTE_64 = 0x1, 0x1000, 0x10

OTHER = "no CAN frame (statistics, markers, other buses)"
DAMAGED = "shorter than its kind, or of an unknown form"


def read(content: Content) -> Log:
    """Read a .blf file.

    Raises
    ------
    ValueError
        It is not a .blf file, or a container is too large.
    """
    log = Log(unit="object")
    head = content.read(FILE_HEADER.size)
    if head[: len(MAGIC)] != MAGIC[: len(head)]:
        raise ValueError("it does not begin as a .blf file does")
    if len(head) < FILE_HEADER.size:
        log.remarks.append(f"{len(head)} bytes were left out: the file ends within its header")
        return log
    _, size, whole, count, *start = FILE_HEADER.unpack(head)
    content.read(max(size - FILE_HEADER.size, 0))
    reader = _Objects(log, _start_ns(start))
    torn = reader.read(content)
    missing = count - reader.count
    if missing > 0 and (torn or content.position < whole):
        log.lose("the file ends before them, or is damaged there", count=missing)
    elif torn:
        log.remarks.append(f"{torn} bytes were left out: the file is damaged there, or ends within an object")
    return log


def _start_ns(fields: list[int]) -> int:
    year, month, _, day, hour, minute, second, millisecond = fields
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:  # zeros: no wall-clock time
        return 0
    return int(start.timestamp()) * 10**9 + millisecond * 10**6


class _Objects:
    """The objects of a file, in its order."""

    def __init__(self, log: Log, start_ns: int) -> None:
        self._log, self._start_ns = log, start_ns
        self._tail = b""
        self.count = 0

    def read(self, content: Content) -> int:
        """Read all objects; return the number of bytes outside complete objects."""
        torn = 0
        while head := content.read(BASE.size):
            at = content.position - len(head)
            whole = len(head) == BASE.size
            signature, _, _, size, kind = BASE.unpack(head) if whole else (b"", 0, 0, 0, 0)
            if signature != b"LOBJ" or size < LEAST:
                return torn + len(self._tail) + len(head) + content.rest()
            body = content.read(size - BASE.size)
            content.read(size % 4)
            data = _unpacked(body, at) if kind == LOG_CONTAINER else head + body
            torn += self._read_objects(self._tail + data)
            if len(body) < size - BASE.size:
                return torn + max(len(self._tail), 1)
        return torn + len(self._tail.strip(b"\0"))

    def _read_objects(self, data: bytes) -> int:
        """Read the objects of a container and keep its tail, which continues in the next one;
        return the number of bytes outside objects.
        """
        place = lost = 0
        damaged = False
        while True:
            begin = data.find(b"LOBJ", place)
            if begin < 0 or begin + LEAST > len(data):
                break
            lost += 0 if damaged else max(begin - place - PADDING, 0)
            size = BASE.unpack_from(data, begin)[3]
            if size < LEAST:  # it does not locate the next object
                self.count += 1
                self._log.lose(DAMAGED)
                place, damaged = begin + len(MAGIC), True
                continue
            damaged = False
            inner = _next_begin(data, begin + len(MAGIC), begin + size)
            if not inner and begin + size > len(data):
                break
            self.count += 1
            if inner:
                self._log.lose(DAMAGED)
            else:
                self._object(data[begin : begin + size])
            place = inner or begin + size
        self._tail = data[place:]
        return lost

    def _object(self, data: bytes) -> None:
        _, _, version, _, kind = BASE.unpack_from(data)
        flags, stamp = STAMP.unpack_from(data, BASE.size)
        t_ns = self._start_ns + stamp * (10_000 if flags == TEN_US else 1)
        try:
            self._frame(t_ns, kind, data[HEADERS[version] :])
        except (struct.error, KeyError, ValueError):
            self._log.lose(DAMAGED)

    def _frame(self, t_ns: int, kind: int, body: bytes) -> None:
        if kind in MESSAGES:
            channel, flags, length, can_id, data = MESSAGE.unpack_from(body)
            self._add(t_ns, channel, can_id, bool(flags & REMOTE), min(length, CLASSICAL), data)
        elif kind == ERROR_EXTENDED:
            channel, length, can_id, data = ERROR_EXT.unpack_from(body)
            length = min(length, CLASSICAL)
            self._log.add((t_ns, CAN_ERR_FLAG | can_id & ID_BITS, length, data[:length], str(channel)))
        elif kind == ERROR:
            self._log.add((t_ns, BUS_ERROR, 0, b"", str(struct.unpack_from("<H", body)[0])))
        elif kind == MESSAGE_FD:
            channel, flags, length, can_id, fd_flags, valid, data = FD_MESSAGE.unpack_from(body)
            self._fd(t_ns, channel, can_id, fd_flags & FDF, flags & REMOTE, (length, data[:valid]))
        elif kind == MESSAGE_FD_64:
            channel, length, valid, can_id, fd_flags = FD_MESSAGE_64.unpack_from(body)
            data = body[FD_MESSAGE_64.size :][:valid]
            self._fd(t_ns, channel, can_id, fd_flags & FDF_64, fd_flags & REMOTE_64, (length, data))
        else:
            self._log.lose(OTHER)

    def _fd(self, t_ns: int, channel: int, can_id: int, fd: int, remote: int, content: tuple[int, bytes]) -> None:
        """Read a frame received by a CAN FD controller: CAN FD or classical."""
        length, data = content
        if fd:
            self._log.lose(FD)
        elif not remote and len(data) < min(length, CLASSICAL):
            self._log.lose(DAMAGED)
        else:
            self._add(t_ns, channel, can_id, bool(remote), min(length, CLASSICAL), data)

    def _add(self, t_ns: int, channel: int, can_id: int, remote: bool, length: int, data: bytes) -> None:
        word = identifier(can_id & ID_BITS, bool(can_id & EXTENDED)) | (CAN_RTR_FLAG if remote else 0)
        self._log.add((t_ns, word, length, b"" if remote else data[:length], str(channel)))


def _next_begin(data: bytes, begin: int, end: int) -> int:
    """Return the offset of another object within this one; 0: none, it is complete."""
    at = data.find(b"LOBJ", begin, end + len(MAGIC) - 1)
    if at < 0 or at + BASE.size > len(data):
        return 0
    return at if BASE.unpack_from(data, at)[1:3] in {(size, version) for version, size in HEADERS.items()} else 0


def _unpacked(content: bytes, at: int) -> bytes:
    """Return the content of a container; of a truncated or damaged one, the readable part."""
    if len(content) < CONTAINER.size:
        return b""
    method, _ = CONTAINER.unpack_from(content)
    data = content[CONTAINER.size :]
    if method != DEFLATE:
        return data
    packed, parts = zlib.decompressobj(), []
    try:
        parts.append(packed.decompress(data, MOST))
    except zlib.error:
        return b""
    if packed.unconsumed_tail:
        raise ValueError(f"the container at byte {at} has more than {MOST >> 20} MB")
    return parts[0]
