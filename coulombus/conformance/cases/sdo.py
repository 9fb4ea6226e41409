"""Cases 2.1 to 2.12, 2.28 to 2.30, S.4, S.5 and S.12: expedited transfers, invalid requests, further channels.

Source: CiA 301, section 7.2.4.
"""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.tester.objects import NOT_NOW, READ_ONLY, REFUSED, is_command, is_output, keeps, long_object
from coulombus.conformance.tester.pdo_setup import INVALID
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.running import keeps_own_value, unchanged
from coulombus.conformance.tester.unit import Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.eds.reader import Variable
from coulombus.eds.sdo_frames import head
from coulombus.wire.bus_link import RTR

RW = ("rw", "rwr", "rww")
RESTRICTED_ID = 0x6E1

IDENTIFIERS = (0x6D8, 0x6D9)
"""Identifiers outside the pre-defined connection set, and not restricted."""


def short(unit: Unit, sizes: tuple[int, ...]) -> Variable:
    """Return a harmless writable object of this size, preferably of the communication profile."""
    variables = [
        v
        for v in unit.variables()
        if v.access in RW and v.bits // 8 in sizes and v.bits % 8 == 0 and not is_command(v) and not is_output(v)
    ]
    if not variables:
        raise NotApplicable(f"the EDS has no writable object of {' or '.join(str(size) for size in sizes)} bytes")
    return variables[0]


@case("2.1")
def device_type(unit: Unit) -> None:
    """Read 1000h:00: four bytes, expedited (with or without size) or segmented, as the server chooses; and the value."""
    data = unit.read(0x1000, 0)
    if len(data) != 4:
        raise CaseFailed(f"1000h:00 has {len(data)} bytes, expected 4")
    default = unit.default(unit.variable(0x1000)) if unit.has(0x1000) else None
    value = int.from_bytes(data, "little")
    if isinstance(default, int) and value != default:
        raise CaseFailed(f"1000h:00 is {value:08X}h; the EDS says {default:08X}h")


@case("2.2")
def write_back(unit: Unit) -> str:
    """Choose up to 12 writable entries of 1000h to 1FFFh at random, write each with its own value
    and read it again.
    """
    variables = [v for v in unit.variables(0x1000, 0x1FFF) if keeps(v)]
    if not variables:
        raise NotApplicable("the EDS has no such entry")
    sample = unit.random.sample(variables, min(12, len(variables)))
    remarks: list[str] = []
    for v in sample:
        try:
            value = unit.read(v.index, v.subindex)
            unit.put(v.index, v.subindex, value)
        except TransferAborted as abort:
            if abort.code not in NOT_NOW:
                raise
            continue
        if remark := keeps_own_value(unit, v, value):
            remarks.append(remark)
    return ", ".join((*(where(v.index, v.subindex) for v in sample), *remarks))


@case("2.3")
def write_read_only(unit: Unit) -> str:
    """Write 1000h:00 with its own value."""
    return f"{unit.refused(0x1000, 0, unit.read(0x1000, 0)):08X}h"


@case("2.4")
def read_write_only(unit: Unit) -> str:
    """Read the first write-only object."""
    variables = [v for v in unit.variables() if v.access == "wo"]
    if not variables:
        raise NotApplicable("the EDS has no write-only object")
    return _unreadable(unit, variables[0].index, variables[0].subindex)


@case("2.5", index=0x1000, subindex=1)
@case("2.6", index=0x1004, subindex=0)
def read_absent(unit: Unit, index: int, subindex: int) -> str:
    """Read an absent object or sub-index."""
    if unit.has(index, subindex):
        raise NotApplicable(f"the EDS has {where(index, subindex)}")
    return _unreadable(unit, index, subindex)


def _unreadable(unit: Unit, index: int, subindex: int) -> str:
    try:
        data = unit.read(index, subindex)
    except TransferAborted as abort:
        return f"{where(index, subindex)}: {unit.judge(abort):08X}h"
    raise CaseFailed(f"{where(index, subindex)} answers with {data.hex(' ').upper()}")


@case("2.7")
def unknown_command(unit: Unit) -> str:
    """Send a request with command specifier 7; the server still works afterwards."""
    try:
        answer = unit.sdo.request(head(0xE0, 0x1000, 0), 0x1000, 0, "unknown command")
    except TransferAborted as abort:
        code = unit.judge(abort)
    else:
        raise CaseFailed(f"command specifier 7 is answered with {answer.hex(' ')}")
    unit.read(0x1000, 0)
    return f"{code:08X}h"


@case("2.8", sizes=(2, 1), data=b"\1\0\0\0")
@case("2.9", sizes=(4, 2), data=b"\1")
def wrong_size(unit: Unit, sizes: tuple[int, ...], data: bytes) -> str:
    """Write an object of each size with another number of bytes; it keeps its value."""
    done = []
    for size in sizes:
        try:
            variable = short(unit, (size,))
        except NotApplicable:
            continue
        before = unit.read(variable.index, variable.subindex)
        code = unit.refused(variable.index, variable.subindex, data)
        unchanged(unit, variable, before)
        done.append(f"{where(variable.index, variable.subindex)}: {code:08X}h")
    if not done:
        raise NotApplicable("the EDS has no writable object of that size")
    return ", ".join(done)


def beyond(variable: Variable, *, above: bool) -> int | None:
    """Return the value next to a limit, if the type can hold it."""
    limit = variable.high if above else variable.low
    if not isinstance(limit, int) or not variable.bits:
        return None
    value = limit + (1 if above else -1)
    signed = variable.data_type in (0x02, 0x03, 0x04, 0x10, 0x12, 0x13, 0x14, 0x15)
    lowest = -(1 << variable.bits - 1) if signed else 0
    highest = (1 << variable.bits - signed) - 1
    return value if lowest <= value <= highest else None


@case("2.10", above=True)
@case("2.11", above=False)
def beyond_limit(unit: Unit, above: bool) -> str:
    """Write up to three objects with the value next to their limit; they keep their values."""
    variables = [v for v in unit.variables() if v.access in RW and beyond(v, above=above) is not None]
    variables = [v for v in variables if not is_command(v) and not is_output(v)][:3]
    if not variables:
        limit = "HighLimit" if above else "LowLimit"
        raise NotApplicable(f"the EDS gives no harmless writable object a {limit} inside its type")
    done = []
    for v in variables:
        before = unit.read(v.index, v.subindex)
        code = unit.refused(v.index, v.subindex, beyond(v, above=above))
        unchanged(unit, v, before)
        done.append(f"{where(v.index, v.subindex)}: {code:08X}h")
    return ", ".join(done)


@case("2.12")
def server_identifiers(unit: Unit) -> None:
    """Read 1200h:01 and :02."""
    unit.need(0x1200, 1)
    for subindex, expected in ((1, CobId.SDO_RX + unit.node_id), (2, CobId.SDO_TX + unit.node_id)):
        value = unit.number(0x1200, subindex)
        if value != expected:
            raise CaseFailed(f"1200h:{subindex:02X} is {value:08X}h, expected {expected:08X}h")


def written_and_read(unit: Unit, index: int, value: int, write: Callable[[bytes], object]) -> None:
    """Write an object of the communication profile with `write`, read it, and register it for `restore`."""
    variable = unit.need_writable(index)
    before = unit.read(index, 0)
    unit.undo_later(index, 0, before)
    unit.dirty = True
    write(encode(variable, value))
    if unit.number(index) != value:
        raise CaseFailed(f"{where(index, 0)} is {unit.number(index)} after {value} was written")


def channels(unit: Unit, first: int, last: int) -> list[tuple[int, dict[int, bytes]]]:
    """Read a range of SDO parameters.

    Objects outside the EDS must be refused with an accepted code.
    """
    described = []
    for index in range(first, last + 1):
        if unit.has(index):
            subs = [s for s, v in unit.description.objects[index].variables.items() if s < 4 and v.access != "wo"]
            described.append((index, {subindex: unit.read(index, subindex) for subindex in subs}))
            continue
        try:
            unit.read(index, 1)
        except TransferAborted as abort:
            unit.judge(abort)
        else:
            raise CaseFailed(f"{where(index, 1)} answers but is not in the EDS")
    return described


@case("2.28")
def further_servers(unit: Unit) -> str:
    """Read 1201h to 127Fh: present with valid identifiers, or refused."""
    servers = channels(unit, 0x1201, 0x127F)
    for index, values in servers:
        for subindex in {1, 2} & values.keys():
            cob_id = int.from_bytes(values[subindex], "little")
            if not cob_id & 1 << 31 and not cob_id & 0x1FFFFFFF:
                raise CaseFailed(f"{where(index, subindex)} is valid with identifier 0")
    return f"{len(servers)} further servers"


@case("2.29")
def further_servers_after_reset(unit: Unit) -> str:
    """Change all writable entries of 1201h to 127Fh and reset the communication: they have their earlier values."""
    before = channels(unit, 0x1201, 0x127F)
    for index, _ in before:
        if unit.has(index, 1) and unit.variable(index, 1).access == "rw":
            cob_id = unit.number(index, 1)
            try:
                unit.put(index, 1, encode(unit.variable(index, 1), cob_id | 1 << 31))
            except TransferAborted as abort:
                unit.judge(abort, REFUSED)
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    if channels(unit, 0x1201, 0x127F) != before:
        raise CaseFailed("1201h to 127Fh are not as they were after reset communication")
    return f"{len(before)} further servers"


@case("2.30", defaults=True)
def clients_after_storing(unit: Unit) -> str:
    """Store all parameters and reset the communication: 1280h to 12FFh are unchanged.

    Absent objects are refused.
    """
    unit.need_ability(0x1010)
    before = channels(unit, 0x1280, 0x12FF)
    unit.save()
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    if channels(unit, 0x1280, 0x12FF) != before:
        raise CaseFailed("1280h to 12FFh are not as they were stored")
    unit.dirty = True
    return f"{len(before)} clients"


def upload_segment(toggle: int) -> bytes:
    """Return the request of a segment."""
    return bytes((0x60 | toggle << 4,)) + bytes(7)


@case("S.4")
def short_request(unit: Unit) -> None:
    """Send requests of 0, 1 and 7 bytes; the server still works afterwards."""
    for length in (0, 1, 7):
        unit.send(unit.sdo_rx, b"\x40\0\x10\0\0\0\0"[:length])
        unit.pause(unit.timing.quiet_ns // 3)
    unit.flush()
    unit.read(0x1000, 0)


@case("S.5")
def remote_request(unit: Unit) -> None:
    """Send a remote frame with the request's identifier: no response."""
    unit.flush()
    unit.send(unit.sdo_rx | RTR, length=8)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(unit.sdo_tx):
        raise CaseFailed("a remote frame on the SDO request's identifier is answered")
    unit.read(0x1000, 0)


@case("S.12")
def two_servers(unit: Unit) -> str:
    """Configure the first unused additional server, and read by both servers at once: neither disturbs the other.

    Before that, a restricted identifier is refused; afterwards another identifier is refused,
    because the server is valid.
    """
    indices = [index for index in range(0x1201, 0x1280) if unit.has(index, 1) and unit.has(index, 2)]
    indices = [i for i in indices if all(unit.variable(i, sub).access not in READ_ONLY for sub in (1, 2))]
    indices = [i for i in indices if unit.number(i, 1) & INVALID]
    if not indices:
        raise NotApplicable("the EDS has no further SDO server whose identifiers can be written")
    index, (request_id, response_id) = indices[0], IDENTIFIERS
    unit.refused(index, 1, RESTRICTED_ID, REFUSED)
    unit.write(index, 2, response_id)
    unit.write(index, 1, request_id)
    unit.refused(index, 1, request_id + 2, REFUSED)
    variable, content = long_object(unit, 8)
    came = {unit.sdo_tx: b"", response_id: b""}
    for request in (head(0x40, variable.index, variable.subindex), upload_segment(0), upload_segment(1)):
        for rx, tx in ((unit.sdo_rx, unit.sdo_tx), (request_id, response_id)):
            unit.send(rx, request)
            answer = unit.expect(tx, f"response of the server with request {rx:03X}h").data
            if len(answer) != 8:
                raise CaseFailed(f"a response of server {rx:03X}h has {len(answer)} bytes, expected 8")
            if answer[0] == 0x80:
                raise CaseFailed(f"two uploads at once: server {rx:03X}h aborts with {answer.hex(' ')}")
            if request[0] >> 5 == 3:
                came[tx] += answer[1 : 8 - (answer[0] >> 1 & 7)]
    unit.sdo.abort(variable.index, variable.subindex)
    unit.send(request_id, head(0x80, variable.index, variable.subindex, b"\0\0\0\x08"))
    if any(data != content[:14] for data in came.values()):
        raise CaseFailed("two uploads of one object at once bring different bytes")
    return where(index, 1)
