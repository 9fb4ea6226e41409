"""Cases 2.19 to 2.27: block transfers of the test plan (CiA 301, section 7.2.4.2.9 on)."""

from __future__ import annotations

from coulombus.conformance.cases.sdo import written_and_read
from coulombus.conformance.tester.objects import long_object, long_objects
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import Abort

__all__ = ["need_block"]


def need_block(unit: Unit) -> None:
    """Make sure that the server knows block transfers: one that refuses the command has none, and
    that is allowed.
    """
    try:
        unit.sdo.initiate_block_upload(0x1000, 0, crc=False)
    except TransferAborted as abort:
        if abort.code in (Abort.COMMAND, Abort.GENERAL, Abort.ACCESS):
            raise NotApplicable(f"the server refuses block transfers ({abort.code:08X}h)") from None
        raise
    unit.sdo.abort(0x1000, 0)


@case("2.19")
def short_upload(unit: Unit) -> None:
    """Read 1000h:00 by block transfer and expedited: the same."""
    need_block(unit)
    data, _ = unit.sdo.block_upload(0x1000, 0, crc=False)
    if data != unit.read(0x1000, 0):
        raise CaseFailed(f"1000h:00 by block transfer is {data.hex(' ')}")


@case("2.20", index=0x100C, crc=False)
@case("2.21", index=0x1017, crc=False)
@case("2.24", index=0x100C, crc=True)
@case("2.25", index=0x1017, crc=True)
def short_download(unit: Unit, index: int, crc: bool) -> str | None:
    """Write a short object by block transfer and read it back."""
    unit.need_writable(index)
    need_block(unit)
    agreed: list[bool] = []
    written_and_read(unit, index, 1234, lambda data: agreed.append(unit.sdo.block_download(index, 0, data, crc=crc)))
    return "the server has no CRC" if crc and not agreed[0] else None


@case("2.22", crc=False)
@case("2.23", crc=True)
def long_upload(unit: Unit, crc: bool) -> str:
    """Read the shortest and the longest long object by block transfer and by segments: the same."""
    need_block(unit)
    found = sorted(long_objects(unit), key=lambda one: len(one[1]))
    remark = ""
    for variable, content in (found[0], found[-1]):
        data, agreed = unit.sdo.block_upload(variable.index, variable.subindex, crc=crc)
        if data != content:
            raise CaseFailed(f"{where(variable.index, variable.subindex)} differs between block transfer and segments")
        remark = f"{where(variable.index, variable.subindex)}, {len(data)} bytes"
        remark += ", the server has no CRC" if crc and not agreed else ""
    return remark


@case("2.26")
def wrong_block_size(unit: Unit) -> str:
    """Ask for an upload in blocks of 128 segments."""
    need_block(unit)
    variable, _ = long_object(unit)
    return refused_size(unit, variable.index, variable.subindex, 128)


def refused_size(unit: Unit, index: int, subindex: int, size: int) -> str:
    """Ask for an upload in blocks of an impossible size: abort."""
    try:
        unit.sdo.initiate_block_upload(index, subindex, crc=False, size=size)
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    unit.sdo.abort(index, subindex)
    raise CaseFailed(f"a block upload of {where(index, subindex)} with {size} segments a block is taken")


@case("2.27")
def wrong_sequence(unit: Unit) -> str:
    """Acknowledge segment 128 of a block: abort."""
    need_block(unit)
    variable, _ = long_object(unit)
    index, subindex = variable.index, variable.subindex
    unit.sdo.initiate_block_upload(index, subindex, crc=False)
    unit.sdo.send(b"\xa3" + bytes(7))
    unit.sdo.read_block(index, subindex, 127)
    unit.sdo.acknowledge(128, 127)
    try:
        unit.sdo.response(index, subindex, "end of block upload of")
    except TransferAborted as abort:
        return f"{unit.judge(abort):08X}h"
    raise CaseFailed(f"block upload of {where(index, subindex)}: an acknowledge of segment 128 is taken")
