"""Parts of a pcapng file (draft-ietf-opsawg-pcapng): blocks, options, coulombus' attachment block, errors.

Every block is ``type, total length, body, total length``, in multiples of four bytes, in its
section's byte order::

    section header  0A0D0D0A | length | 1A2B3C4D (byte order) | 1.0 | section length | options | length
    interface       00000001 | length | link type, reserved | snapshot length | options | length
    packet          00000006 | length | interface, stamp high, low, captured, original | bytes | options | length

A packet of link type 227 (SocketCAN) is Linux's ``struct can_frame`` with the identifier's word in
big-endian order::

    byte  0 1 2 3      4        5       6 7        8 ... 15
         identifier  length  FD flags  reserved   data bytes
"""

from __future__ import annotations

import hashlib
import re
import struct
import zlib
from collections.abc import Iterator

from coulombus.system.errors import CoulombusError

__all__ = [
    "ATTACHMENT",
    "BYTE_ORDER_MAGIC",
    "ENHANCED_PACKET",
    "HOST_INTERFACE",
    "INTERFACE",
    "LINKTYPE_CAN_SOCKETCAN",
    "MAX_BLOCK",
    "OWN_APPLICATION",
    "SECTION_HEADER",
    "SOURCE_INSIDE",
    "PcapngError",
    "RecordingError",
    "TooLarge",
    "attachment_block",
    "block",
    "iter_options",
    "next_block",
    "option",
    "other_format",
    "read_attachment",
]

SECTION_HEADER = 0x0A0D0D0A
INTERFACE = 1
PACKET = 2  # obsolete
SIMPLE_PACKET = 3
ENHANCED_PACKET = 6
ATTACHMENT = 0x80434C42  # a local-use block type (bit 31 set): other tools skip it
BYTE_ORDER_MAGIC = 0x1A2B3C4D
LINKTYPE_CAN_SOCKETCAN = 227
MAX_BLOCK = 16 << 20  # Wireshark refuses larger ones
MAX_OPTION = 65535

OPT_END = 0
OPT_COMMENT = 1
SHB_HARDWARE = 2
SHB_OS = 3
SHB_APPLICATION = 4
IF_NAME = 2
IF_TSRESOL = 9
IF_TSOFFSET = 14
OWN_APPLICATION = "coulombus"
"""Application in the section header of coulombus' recordings."""
HOST_INTERFACE = "coulombus-host"
"""Name of the interface of the host's telemetry, whose frames were on no bus (`recording.host_telemetry`)."""
SOURCE_INSIDE = -2
"""`source` of these frames in a log."""

OTHER_FORMATS = {
    **dict.fromkeys(
        ("d4c3b2a1", "a1b2c3d4", "4d3cb2a1", "a1b23c4d"),
        "a classic pcap file: convert it with 'editcap -F pcapng IN OUT'",
    ),
    "1f8b": "compressed twice: unpack it once with 'gunzip'",
    "28b52ffd": "compressed twice: unpack it once with 'unzstd'",
}
"""First bytes of other file formats -> their names."""
DESCRIPTION = re.compile(rb"^\[(FileInfo|DeviceInfo)\]|<ISO15745Profile", re.MULTILINE | re.IGNORECASE)
"""Near the begin of an EDS, DCF or XDD file."""
NEAR_BEGIN = 4096
SECTION_MARK = struct.pack("<I", SECTION_HEADER)
SECTION_ORDERS = {struct.pack(byte_order + "I", BYTE_ORDER_MAGIC): byte_order for byte_order in "<>"}
KINDS = (SECTION_HEADER, INTERFACE, PACKET, SIMPLE_PACKET, ENHANCED_PACKET, ATTACHMENT)
KNOWN_BLOCK = {
    byte_order: re.compile(b"|".join(re.escape(struct.pack(byte_order + "I", kind)) for kind in KINDS))
    for byte_order in "<>"
}
ATTACHMENT_HEAD = struct.Struct("<8s32sIII")  # see attachment_block
ATTACHMENT_MAGIC = b"CoulAtt1"


def other_format(data: bytes, path: str) -> str | None:
    """Return what a file of another format is, and what takes it; None if it is not known."""
    if DESCRIPTION.search(data[:NEAR_BEGIN]):
        return (
            f"it is a device description: `coulombus eds check {path}` reads it, `coulombus node` simulates the device"
        )
    texts = (text for magic, text in OTHER_FORMATS.items() if data.startswith(bytes.fromhex(magic)))
    return next((f"it is {text}" for text in texts), None)


class PcapngError(CoulombusError):
    """The file is not a pcapng recording that can be read.

    The text has file, offset, problem and remedy.
    """

    exit_status = 2


class RecordingError(CoulombusError, OSError):
    """The recording cannot be continued (disk full, limit reached).

    The part already written stays readable.
    """

    exit_status = 2


def block(kind: int, body: bytes) -> bytes:
    """Return one little-endian block, padded."""
    body += bytes(-len(body) % 4)
    length = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + length + body + length


def option(code: int, value: bytes) -> bytes:
    """Return one little-endian option, padded; `value` is truncated to 65,535 bytes."""
    if len(value) > MAX_OPTION:
        raise ValueError(f"{len(value)} bytes of text: a pcapng option ends at {MAX_OPTION}; attach it instead")
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def iter_options(data: bytes, byte_order: str) -> Iterator[tuple[int, bytes]]:
    """Yield (code, value) of the options in `data`; an incomplete last option ends the iteration.

    `byte_order` is "<" or ">".
    """
    at = 0
    while at + 4 <= len(data):
        code, size = struct.unpack_from(byte_order + "HH", data, at)
        if code == OPT_END or at + 4 + size > len(data):
            return
        yield code, data[at + 4 : at + 4 + size]
        at += 4 + size + (-size % 4)


def attachment_block(name: str, content: bytes) -> bytes:
    """Return the local-use block that carries `content` under `name`: head, name, zlib data.

    ::

        offset  0        8        40      44           48          52
                magic 8 | SHA-256 | size | name's size | data size | name (UTF-8), zlib data
    """
    label, packed = name.encode(), zlib.compress(content, 1)
    digest = hashlib.sha256(content).digest()
    head = ATTACHMENT_HEAD.pack(ATTACHMENT_MAGIC, digest, len(content), len(label), len(packed))
    whole = block(ATTACHMENT, head + label + packed)
    if len(whole) > MAX_BLOCK or len(content) > 4 * MAX_BLOCK:
        raise ValueError(f"attachment {name!r}: {len(content)} bytes are too many for one block; leave it out")
    return whole


class TooLarge:
    """Placeholder for an attachment that is too large."""


def read_attachment(body: bytes, most_bytes: int = 4 * MAX_BLOCK) -> tuple[str, bytes] | str | TooLarge | None:
    """Return name and content of an attachment; a sentence if it is damaged; None if it is not coulombus'.

    An attachment of more than `most_bytes` bytes, uncompressed, is `TooLarge` and stays packed.
    """
    if len(body) < ATTACHMENT_HEAD.size or not body.startswith(ATTACHMENT_MAGIC):
        return None
    _, digest, size, label_size, packed_size = ATTACHMENT_HEAD.unpack_from(body)
    start = ATTACHMENT_HEAD.size + label_size
    name = body[ATTACHMENT_HEAD.size : start].decode(errors="replace")
    if size > most_bytes:
        return TooLarge()
    try:
        content = zlib.decompressobj().decompress(body[start : start + packed_size], min(size, 4 * MAX_BLOCK) + 1)
    except zlib.error as error:
        return f"attachment {name!r} is damaged ({error}) and was left out"
    if len(content) != size or hashlib.sha256(content).digest() != digest:
        return f"attachment {name!r} is damaged (its SHA-256 differs) and was left out"
    return name, content


def next_block(data: bytes, begin: int, byte_order: str, longest: int) -> int | None:
    """Return the offset of the first complete block of a known type in `data` from byte `begin`, or of a
    section, which may have the other byte order; it has at most `longest` bytes.
    """
    for match in KNOWN_BLOCK[byte_order].finditer(data, begin):
        place = match.start()
        size = data[place + 4 : place + 8]
        magic = data[place + 8 : place + 12]
        is_section = match[0] == SECTION_MARK
        if is_section and magic not in SECTION_ORDERS:
            continue
        length = int.from_bytes(
            size, "little" if (SECTION_ORDERS[magic] if is_section else byte_order) == "<" else "big"
        )
        whole = 12 <= length <= longest and length % 4 == 0 and place + length <= len(data)
        if whole and data[place + length - 4 : place + length] == size:
            return place
    return None
