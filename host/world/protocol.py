"""The socket of a world outside: records of fixed size in a stream (docs/worlds.md has each byte).

AF_UNIX, SOCK_STREAM, little-endian. Each record begins with its kind (u16), its size in bytes (u16) and
four zero bytes. All further fields have eight bytes, except for texts and the samples of a profile.

=========  ====  ====================  ==========================================================
kind       size  from                  meaning
=========  ====  ====================  ==========================================================
HELLO        64  program               first record of a connection
MODEL       776  program               `host.world.records.ModelRecord`
WELCOME      64  host                  answer to HELLO; `parameters` records follow it
PARAMETER    88  host                  a parameter of a law, or a limit
STATE       224  host                  `host.world.records.StateRecord`, of each axis after each cycle
REFUSED     256  host                  a model, or the connection, was refused
=========  ====  ====================  ==========================================================
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from coulombus.host.world.records import MODEL, STATE

__all__ = [
    "MAGIC",
    "SIZES",
    "VERSION",
    "WITH_STATES",
    "Greeting",
    "Kind",
    "Named",
    "Refusal",
    "Welcome",
    "head_of",
    "read_greeting",
    "read_named",
    "read_refusal",
    "read_welcome",
    "records_in",
]

MAGIC, VERSION = b"COULWRLD", 2
WITH_STATES = 1
"""Flag of HELLO: the host sends states."""
_HEAD = struct.Struct("<HHI")
_HELLO, _WELCOME = struct.Struct("<q8sqq32s"), struct.Struct("<8q")
_PARAMETER, _REFUSED = struct.Struct("<qqqddd40s"), struct.Struct("<qqq232s")


class Kind(IntEnum):
    """Kind of a record."""

    HELLO = 1
    MODEL = 2
    WELCOME = 3
    PARAMETER = 4
    STATE = 5
    REFUSED = 6


SIZES = {
    Kind.HELLO: _HELLO.size,
    Kind.MODEL: MODEL.itemsize,
    Kind.WELCOME: _WELCOME.size,
    Kind.PARAMETER: _PARAMETER.size,
    Kind.STATE: STATE.itemsize,
    Kind.REFUSED: _REFUSED.size,
}
"""Size of each kind of record in bytes."""


def head_of(kind: Kind) -> int:
    """Return the first eight bytes of a record as an integer."""
    return kind | SIZES[kind] << 16


def _text(field: bytes) -> str:
    return field.partition(b"\0")[0].decode(errors="replace")


class Greeting(NamedTuple):
    """HELLO: `flags` are of `WITH_STATES`, `key` is the arm key of a host on a real rig."""

    flags: int = WITH_STATES
    key: str = ""
    magic: bytes = MAGIC
    version: int = VERSION

    def record(self) -> bytes:
        """Return the record."""
        return _HELLO.pack(head_of(Kind.HELLO), self.magic, self.version, self.flags, self.key.encode()[:32])


class Welcome(NamedTuple):
    """WELCOME: the host's answer to HELLO."""

    version: int
    axes: int
    parameters: int
    """Number of PARAMETER records that follow."""
    period_ns: int
    mode: int
    """0: passive, 1: hybrid, 2: active."""
    longest_life_ns: int
    now_ns: int
    """CLOCK_MONOTONIC of the host."""

    def record(self) -> bytes:
        """Return the record."""
        return _WELCOME.pack(head_of(Kind.WELCOME), *self)


class Named(NamedTuple):
    """PARAMETER: a parameter that a model may set, by its slot; or with slot -1 a limit."""

    axis: int
    slot: int
    low: float
    high: float
    value: float
    name: str

    def record(self) -> bytes:
        """Return the record."""
        return _PARAMETER.pack(head_of(Kind.PARAMETER), *self[:-1], self.name.encode()[:40])


class Refusal(NamedTuple):
    """REFUSED: the sequence of the model, or 0 for the connection, and the reason.

    `again` is 1 if the model itself is right, and may be sent again.
    """

    sequence: int
    again: int
    reason: str

    def record(self) -> bytes:
        """Return the record."""
        return _REFUSED.pack(head_of(Kind.REFUSED), self.sequence, self.again, self.reason.encode()[:232])


def read_greeting(record: bytes) -> Greeting:
    """Return a HELLO record's fields."""
    _, magic, version, flags, key = _HELLO.unpack(record)
    return Greeting(flags, _text(key), magic, version)


def read_welcome(record: bytes) -> Welcome:
    """Return a WELCOME record's fields."""
    return Welcome(*_WELCOME.unpack(record)[1:])


def read_named(record: bytes) -> Named:
    """Return a PARAMETER record's fields."""
    _, axis, slot, low, high, value, name = _PARAMETER.unpack(record)
    return Named(axis, slot, low, high, value, _text(name))


def read_refusal(record: bytes) -> Refusal:
    """Return a REFUSED record's fields."""
    _, sequence, again, reason = _REFUSED.unpack(record)
    return Refusal(sequence, again, _text(reason))


def records_in(data: bytearray, max_count: int) -> list[tuple[Kind, bytes]] | None:
    """Remove the whole records from the beginning of `data`, at most `max_count`, and return them.

    None: `data` does not begin with a record; the stream cannot be read any further.
    """
    records: list[tuple[Kind, bytes]] = []
    while len(data) >= _HEAD.size and len(records) < max_count:
        number, size, zero = _HEAD.unpack_from(data)
        kind = next((kind for kind in Kind if kind == number), None)
        if kind is None or size != SIZES[kind] or zero != 0:
            return None
        if len(data) < size:
            break
        records.append((kind, bytes(data[:size])))
        del data[:size]
    return records
