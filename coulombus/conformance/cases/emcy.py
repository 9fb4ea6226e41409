"""Cases 5.1 to 5.6 and E.1 to E.3: EMCY, error register and history (CiA 301, sections 7.2.7,
7.5.2.2 and 7.5.2.4).
"""

from __future__ import annotations

from coulombus.conformance.tester.objects import READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import HeartbeatOfTester
from coulombus.conformance.tester.provoke import cause_error, emcy_id
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted
from coulombus.eds.cia301 import Abort, CobId

__all__: list[str] = []


@case("5.1")
def identifier(unit: Unit) -> None:
    """Read 1014h and compare it with the EDS, or with 80h + node-id where that gives no default."""
    said = unit.default(unit.need(0x1014))
    value, wanted = unit.number(0x1014), said if isinstance(said, int) else CobId.EMCY + unit.node_id
    if value != wanted:
        raise CaseFailed(f"1014h is {value:08X}h, expected {wanted:08X}h")


@case("5.2")
def register(unit: Unit) -> str:
    """Reset, and read 1001h: one byte.

    An error that is present is no fault of the device; its bit 0 tells of any.
    """
    unit.reset()
    data = unit.read(0x1001)
    if len(data) != 1:
        raise CaseFailed(f"1001h has {len(data)} bytes, expected 1")
    if data[0] and not data[0] & 0x01:
        raise CaseFailed(f"1001h is {data[0]:02X}h: the generic error's bit is missing")
    return f"{data[0]:02X}h" + (": an error is present" if data[0] else "")


@case("5.3")
def history(unit: Unit) -> str | None:
    """Reset, clear 1003h where it has entries and that is allowed, and read :01: what :00 says, an
    entry or none.
    """
    unit.need(0x1003, 1)
    unit.reset()
    count = unit.number(0x1003, 0)
    if count and unit.variable(0x1003, 0).access not in READ_ONLY:
        unit.put(0x1003, 0, b"\0")
        count = unit.number(0x1003, 0)
    if count:
        value = unit.number(0x1003, 1)
        if not value & 0xFFFF:
            raise CaseFailed(f"1003h:01 is {value:08X}h although 1003h:00 is {count}")
        return f"{count} errors are present"
    try:
        value = unit.number(0x1003, 1)
    except TransferAborted as abort:
        codes = (Abort.NO_DATA, Abort.NO_SUBINDEX, Abort.NO_RESOURCE, Abort.GENERAL)
        return f"1003h:01: {unit.judge(abort, codes):08X}h"
    if value:
        raise CaseFailed(f"1003h:01 is {value:08X}h although 1003h:00 is 0")
    return None


@case("5.4")
def emergency(unit: Unit) -> str:
    """Cause an error, and look at the EMCY's identifier, length, code and register."""
    how, frame = cause_error(unit)
    return f"{int.from_bytes(frame.data[:2], 'little'):04X}h after {how}"


@case("5.5")
def register_with_error(unit: Unit) -> str:
    """Cause an error, and compare 1001h with the EMCY."""
    _, frame = cause_error(unit)
    value = unit.number(0x1001)
    if value != frame.data[2] or not value & 0x01:
        raise CaseFailed(f"1001h is {value:02X}h; the EMCY said {frame.data[2]:02X}h")
    return f"{value:02X}h"


@case("5.6")
def history_with_error(unit: Unit) -> str:
    """Cause an error, and compare the newest entry of 1003h with the EMCY."""
    unit.need(0x1003, 1)
    _, frame = cause_error(unit)
    count, entry = unit.number(0x1003, 0), unit.number(0x1003, 1)
    code = int.from_bytes(frame.data[:2], "little")
    if count < 1 or entry & 0xFFFF != code:
        raise CaseFailed(f"1003h:00 is {count}, 1003h:01 is {entry:08X}h; the EMCY said {code:04X}h")
    return f"{entry:08X}h"


@case("E.1")
def error_reset(unit: Unit) -> str:
    """Lose a heartbeat, give it again, and in a drive reset the fault: EMCY 0000h."""
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.flush()
    heartbeat.lose()
    unit.expect(can_id, "EMCY after a lost heartbeat")
    unit.flush()
    heartbeat.beat()
    unit.pause(10 * MS)
    if unit.is_drive:
        heartbeat.beat()
        unit.put(0x6040, 0, b"\0\0")
        unit.put(0x6040, 0, b"\x80\0")
    until_ns, frame = unit.link.now_ns() + unit.timing.answer_ns, None
    while frame is None and unit.link.now_ns() < until_ns:
        heartbeat.beat()  # it is not to be lost again meanwhile
        frame = unit.wait(can_id, heartbeat.consumer_ms * MS // 3)
    unit.write(0x1016, heartbeat.subindex, 0)
    if frame is None:
        left = unit.number(0x1001)
        if left:
            raise NotApplicable(f"1001h stays {left:02X}h: what ends the error is left to the device")
        raise CaseFailed("no EMCY 0000h after the heartbeat is there again, and 1001h is 0")
    if frame.length != 8:
        raise CaseFailed(f"an EMCY has {frame.length} bytes, expected 8")
    code = int.from_bytes(frame.data[:2], "little")
    if code:
        raise CaseFailed(f"EMCY {code:04X}h after the heartbeat is there again, expected 0000h")
    if unit.has(0x1003, 1):
        listed = [unit.number(0x1003, sub) for sub in range(1, unit.number(0x1003) + 1) if unit.has(0x1003, sub)]
        if any(entry & 0xFFFF == 0 for entry in listed):
            raise CaseFailed("1003h lists an error 0000h: an error reset is no error")
    return f"register {frame.data[2]:02X}h"


@case("E.2")
def history_cleared(unit: Unit) -> None:
    """Cause an error; 1003h:00 refuses 1 and takes 0, which clears the list."""
    unit.need_writable(0x1003, 0)
    cause_error(unit)
    unit.refused(0x1003, 0, b"\1", REFUSED)
    unit.put(0x1003, 0, b"\0")
    if unit.number(0x1003, 0):
        raise CaseFailed("1003h:00 is not 0 after 0 was written")


@case("E.3")
def inhibit_time(unit: Unit) -> str:
    """With 1015h at 300 ms, two errors in a row: their EMCYs are that far apart."""
    unit.need_writable(0x1015)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1015, 0, 3000)
    unit.flush()
    heartbeat.lose()
    first = unit.expect(can_id, "EMCY after a lost heartbeat")
    for _ in range(2):
        heartbeat.lose()
    second = unit.wait(can_id)
    if second is None:
        raise NotApplicable("the second error sends no EMCY: the first one is still present")
    gap_ms = (second.t_ns - first.t_ns) / 1e6
    if gap_ms < 290:
        raise CaseFailed(f"two EMCYs are {gap_ms:.0f} ms apart; the inhibit time is 300 ms")
    return f"{gap_ms:.0f} ms"
