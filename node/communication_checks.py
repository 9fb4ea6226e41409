"""Checks of writes to the communication objects 1000h-13FFh and 1F80h (CiA 301, section 7.5.2).

Each object is a row of `CHECKS`. PDO parameters have their own rules in `node.pdo_parameters`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from coulombus.eds.cia301 import Abort
from coulombus.node.constants import MAX_CONSUMERS, MAX_SDO_SERVERS
from coulombus.node.dictionary import Dictionary
from coulombus.node.pdo_parameters import restricted
from coulombus.node.sdo_abort import SdoAbort

__all__ = ["CHECKS", "CONSUMER", "EXTENDED", "INVALID", "PRODUCER", "SDO_SERVERS", "SHORTEST_SYNC_US"]

INVALID = CONSUMER = 1 << 31
PRODUCER = 1 << 30
EXTENDED = 1 << 29
SHORTEST_SYNC_US = 100
"""Shortest period of 1006h that a node can produce."""

SDO_SERVERS = range(0x1200, 0x1200 + MAX_SDO_SERVERS)

_IDENTIFIER = 0x7FF
_NMT_MASTER = 0x01


def _identifier(value: int) -> None:
    """Abort unless bits 0-29 of a COB-ID are an 11-bit identifier that may be configured."""
    if value & EXTENDED or value & 0x1FFFF800 or restricted(value & _IDENTIFIER):
        raise SdoAbort(Abort.VALUE)


def _sync_id(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    before = objects.number(index)
    _identifier(value)
    if before & value & PRODUCER and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.DEVICE_STATE)  # fixed while SYNC is produced


def _time_id(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    before = objects.number(index)
    _identifier(value)
    if before & value & (CONSUMER | PRODUCER) and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.DEVICE_STATE)  # fixed while TIME is consumed or produced


def _period(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if 0 < value < SHORTEST_SYNC_US:
        raise SdoAbort(Abort.VALUE)


def _overflow(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if value == 1 or value > 240:
        raise SdoAbort(Abort.VALUE)
    if objects.number(0x1006):
        raise SdoAbort(Abort.DEVICE_STATE)


def _emcy_id(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    before = objects.number(index)
    if value & 0x7FFFF800 or (not value & INVALID and restricted(value & _IDENTIFIER)):  # bit 30 is reserved
        raise SdoAbort(Abort.VALUE)
    if not before & INVALID and not value & INVALID and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.VALUE)  # it must be made invalid before the identifier changes


def _history(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if value:
        raise SdoAbort(Abort.VALUE)


def _consumer(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    node_id, time_ms = value >> 16 & 0xFF, value & 0xFFFF
    if value >> 24 or (node_id > 127 and time_ms):
        raise SdoAbort(Abort.VALUE)
    if not node_id or not time_ms:
        return
    for other in range(1, MAX_CONSUMERS + 1):
        entry = objects.number(index, other)
        if other != subindex and entry & 0xFFFF and entry >> 16 & 0xFF == node_id:
            raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)


def _sdo_server(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if subindex not in (1, 2):
        return
    before = objects.number(index, subindex)
    if value & EXTENDED or value & 0x1FFFF800 or (not value & INVALID and restricted(value & _IDENTIFIER)):
        raise SdoAbort(Abort.VALUE)
    if not before & INVALID and not value & INVALID and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.VALUE)
    for other in SDO_SERVERS:
        entry = objects.number(other, 1, INVALID)
        if subindex == 1 and other != index and not (value | entry) & INVALID and not (entry ^ value) & _IDENTIFIER:
            raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)  # a request would have two responses


def _startup(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if value & _NMT_MASTER:
        raise SdoAbort(Abort.VALUE)  # a device without an NMT master


CHECKS: Mapping[int, Callable[[Dictionary, int, int, int], None]] = {
    0x1003: _history,
    0x1005: _sync_id,
    0x1006: _period,
    0x1012: _time_id,
    0x1014: _emcy_id,
    0x1016: _consumer,
    0x1019: _overflow,
    0x1F80: _startup,
    **dict.fromkeys(SDO_SERVERS, _sdo_server),
}
"""Index -> function that raises `SdoAbort` unless the value may be written now."""
