"""Cases 5.1 to 5.6 and E.1 to E.9: EMCY, error register and history (CiA 301, sections 7.2.7, 7.5.2.2 and 7.5.2.4)."""

from __future__ import annotations

from coulombus.conformance.tester.deviations import judge_deviations
from coulombus.conformance.tester.objects import OTHER_ID, READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import INVALID, HeartbeatOfTester
from coulombus.conformance.tester.provoke import after_lost_heartbeat, cause_error, emcy_id, short_rpdo
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted
from coulombus.eds.cia301 import Abort, CobId, NmtCommand

__all__: list[str] = []

COMMUNICATION = 0x10
"""Bit of 1001h."""


@case("5.1", defaults=True)
def identifier(unit: Unit) -> None:
    """Read 1014h and compare it with the EDS, or with 80h + node-id without a default."""
    default = unit.default(unit.need(0x1014))
    value, expected = unit.number(0x1014), default if isinstance(default, int) else CobId.EMCY + unit.node_id
    if value != expected:
        judge_deviations(unit, {(0x1014, 0): f"1014h is {value:08X}h, expected {expected:08X}h"})


@case("5.2")
def register(unit: Unit) -> str:
    """Reset, and read 1001h: one byte.

    A present error is not a fault of the device; bit 0 indicates any error.
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
    """Reset, clear 1003h if it has entries and allows it, and read :01: an entry or none, consistent with :00."""
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
    """Cause an error, and check the EMCY's identifier, length, code and register."""
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
    """Stop a heartbeat, resume it, and in a drive reset the fault: EMCY 0000h."""
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.flush()
    heartbeat.lose()
    after_lost_heartbeat(unit, can_id)
    unit.flush()
    heartbeat.beat()
    unit.pause(10 * MS)
    if unit.is_drive:
        heartbeat.beat()
        unit.put(0x6040, 0, b"\0\0")
        for _ in range(2):  # a drive that reads the controlword in its main loop sees the edge
            heartbeat.beat()
            unit.pause(heartbeat.consumer_ms * MS // 3)
        heartbeat.beat()
        unit.put(0x6040, 0, b"\x80\0")
    until_ns, frame = unit.link.now_ns() + unit.timing.answer_ns, None
    while frame is None and unit.link.now_ns() < until_ns:
        heartbeat.beat()  # keep the heartbeat alive meanwhile
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
    """Cause an error; 1003h:00 refuses 1 and accepts 0, which clears the list."""
    unit.need_writable(0x1003, 0)
    cause_error(unit)
    unit.refused(0x1003, 0, b"\1", REFUSED)
    unit.put(0x1003, 0, b"\0")
    if unit.number(0x1003, 0):
        raise CaseFailed("1003h:00 is not 0 after 0 was written")


@case("E.3")
def inhibit_time(unit: Unit) -> str:
    """With 1015h at 300 ms, two successive errors: their EMCYs are that far apart."""
    unit.need_writable(0x1015)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1015, 0, 3000)
    unit.flush()
    heartbeat.lose()
    first = after_lost_heartbeat(unit, can_id)
    for _ in range(2):
        heartbeat.lose()
    second = unit.wait(can_id)
    if second is None:
        raise NotApplicable("the second error sends no EMCY: the first one is still present")
    gap_ms = (second.t_ns - first.t_ns) / 1e6
    if gap_ms < 290:
        raise CaseFailed(f"two EMCYs are {gap_ms:.0f} ms apart; the inhibit time is 300 ms")
    return f"{gap_ms:.0f} ms"


def movable(unit: Unit) -> int:
    """Return the identifier of an EMCY whose COB-ID can be written."""
    unit.need_writable(0x1014)
    return emcy_id(unit)


@case("E.4")
def disabled(unit: Unit) -> None:
    """Set bit 31 of 1014h, and cause an error: 1001h shows it, and no EMCY comes."""
    can_id = movable(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1014, 0, can_id | INVALID)
    unit.flush()
    heartbeat.lose()
    frames = unit.pop_frames(can_id)
    if not unit.number(0x1001):
        raise NotApplicable("1001h stays 0 after a lost heartbeat")
    if frames:
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} although bit 31 of 1014h is set")


@case("E.5")
def moved(unit: Unit) -> str:
    """Set another identifier of the EMCY, made invalid first, and cause an error: the EMCY uses it."""
    can_id = movable(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1014, 0, can_id | INVALID)
    try:
        unit.write(0x1014, 0, OTHER_ID)
    except TransferAborted as abort:
        raise NotApplicable(str(abort)) from None
    unit.flush()
    heartbeat.lose()
    frame = unit.wait(OTHER_ID)
    if unit.pop_frames(can_id):
        raise CaseFailed("an EMCY comes with the old identifier" + (", too" if frame else ""))
    if frame is None:
        unit.restore()
        heartbeat = HeartbeatOfTester(unit)
        heartbeat.lose()
        after_lost_heartbeat(unit, can_id)
        raise NoAnswer(f"no EMCY with its new identifier ({OTHER_ID:03X}h); with the old one it comes")
    return f"{OTHER_ID:03X}h"


@case("E.6")
def in_stopped(unit: Unit) -> None:
    """Stop a heartbeat in STOPPED: no EMCY; in PRE-OPERATIONAL 1001h shows the error."""
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    heartbeat.beat()
    unit.nmt(NmtCommand.STOP)
    unit.flush()
    heartbeat.lose()
    frames = unit.pop_frames(can_id)
    unit.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    if not unit.number(0x1001):
        raise NotApplicable("1001h stays 0 after a heartbeat that was lost in STOPPED")
    if frames:
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} in STOPPED")


@case("E.7")
def newest_first(unit: Unit) -> str:
    """Stop a heartbeat, then send a short RPDO: 1003h has both, the newest in :01."""
    unit.need(0x1003, 2)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.flush()
    heartbeat.lose()
    first = after_lost_heartbeat(unit, can_id)
    send_short = short_rpdo(unit)
    unit.flush()
    send_short()
    second = unit.expect(can_id, "EMCY after an RPDO that is too short")
    codes = [int.from_bytes(frame.data[:2], "little") for frame in (second, first)]
    if codes[0] == codes[1]:
        raise NotApplicable(f"both errors have the code {codes[0]:04X}h")
    count, entries = unit.number(0x1003, 0), [unit.number(0x1003, sub) & 0xFFFF for sub in (1, 2)]
    if entries != codes or count < 2:
        told_codes = " and ".join(f"{code:04X}h" for code in entries)
        raise CaseFailed(
            f"1003h:00 is {count}, with {told_codes}; the EMCYs were, newest first, {codes[0]:04X}h and {codes[1]:04X}h"
        )
    return ", ".join(f"{code:04X}h" for code in codes)


@case("E.8")
def after_reset(unit: Unit) -> None:
    """Cause an error, and reset the node: nothing is monitored any more, and 1001h has no new bits.

    An error of the device may persist; a communication error does not persist after a reset.
    """
    before = unit.number(0x1001)
    cause_error(unit)
    unit.reset()
    value = unit.number(0x1001)
    if value & (~before | COMMUNICATION):
        raise CaseFailed(f"1001h is {value:02X}h after reset node, and was {before:02X}h before the error")


@case("E.9")
def inhibit_after_reset(unit: Unit) -> None:
    """With 1015h at 5 s, cause an error, reset the node, and cause it again: 1015h has its earlier
    value, and the EMCY comes at once.
    """
    unit.need_writable(0x1015)
    can_id = emcy_id(unit)
    default = unit.number(0x1015)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1015, 0, 50_000)
    heartbeat.lose()
    after_lost_heartbeat(unit, can_id)
    unit.reset()
    if unit.number(0x1015) != default or default > 1000:
        raise NotApplicable(f"1015h is {unit.number(0x1015)} after a reset")
    heartbeat = HeartbeatOfTester(unit)
    unit.flush()
    heartbeat.lose()
    unit.expect(can_id, "EMCY after a reset, which ends the inhibit time of the one before")
