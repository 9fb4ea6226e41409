"""Cases 6.1 to 6.10 and Y.1 to Y.6: SYNC producer, consumer and counter; identifiers of SYNC, TIME and EMCY.

Source: CiA 301, sections 7.2.5, 7.5.2.5 and 7.5.2.22.
"""

from __future__ import annotations

from coulombus.conformance.tester.deviations import judge_deviations
from coulombus.conformance.tester.objects import OTHER_ID, READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import INVALID, NO_SYNC_TPDO, Unsupported, arm, write_overflow
from coulombus.conformance.tester.pdo_setup import sync as send_sync
from coulombus.conformance.tester.pdo_stimuli import candidates
from coulombus.conformance.tester.provoke import emcy_id
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, STORE_IS_LOST, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.wire.bus_link import BusFrame

__all__: list[str] = []

PRODUCER = 1 << 30
PERIOD_MS = 20
OVERFLOW = 5
NO_SYNC = "the device produces no SYNC"


def produce(unit: Unit, overflow: int | None = None) -> None:
    """Make the device send SYNC, with a counter up to `overflow`, in the order of CiA 301.

    Raises
    ------
    NotApplicable
        It is not a SYNC producer.
    """
    unit.need_writable(0x1005)
    cob_id = unit.number(0x1005)
    unit.need_writable(0x1006)
    if overflow is not None:
        write_overflow(unit, overflow)
    try:
        unit.write(0x1006, 0, PERIOD_MS * 1000)
        unit.write(0x1005, 0, cob_id | PRODUCER)
    except TransferAborted as abort:
        raise NotApplicable(f"the device refuses to produce SYNC: {abort}") from None


def syncs(unit: Unit, count: int) -> list[BusFrame]:
    """Return this many SYNCs of the device, at their period (measured up to three times: the tester may be late)."""
    text = cause = ""
    for _ in range(3):
        frames = unit.collect(unit.sync_id, count * PERIOD_MS * MS + PERIOD_MS * MS // 2)
        if len(frames) < 3:
            text = f"{len(frames)} SYNCs in {count * PERIOD_MS} ms; 1006h is {PERIOD_MS} ms"
            cause = "" if frames else NO_SYNC
            continue
        mean_ms = (frames[-1].t_ns - frames[0].t_ns) / (len(frames) - 1) / 1e6
        if abs(mean_ms - PERIOD_MS) <= 0.1 * PERIOD_MS:
            return frames
        text = f"SYNC comes every {mean_ms:.2f} ms; 1006h is {PERIOD_MS} ms"
    raise CaseFailed(text, cause=cause)


@case("6.1", defaults=True)
def identifier(unit: Unit) -> None:
    """Read 1005h: identifier 80h, no producer."""
    unit.need(0x1005)
    value = unit.number(0x1005)
    if value & 0x1FFFFFFF != CobId.SYNC:
        judge_deviations(unit, {(0x1005, 0): f"1005h is {value:08X}h, expected 00000080h"})


@case("6.2")
def producer(unit: Unit) -> str:
    """Set 1006h and bit 30 of 1005h, and measure the period."""
    produce(unit)
    frames = syncs(unit, 25)
    return f"{len(frames)} SYNCs"


@case("6.3")
def tpdos(unit: Unit) -> str:
    """Compare the number of TPDOs of type 1 with that of SYNCs: the device's own if it can produce
    them, and the tester's.
    """
    can_id = synchronous(unit)
    unit.start()
    unit.flush()
    for _ in range(10):
        send_sync(unit)
        unit.pause(5 * MS)
    count = len(unit.gather(can_id, 10))
    if count != 10:
        cause = "" if count else NO_SYNC_TPDO
        raise CaseFailed(f"{count} TPDOs after 10 SYNCs of the tester", cause=cause)
    try:
        produce(unit)
    except (NotApplicable, TransferAborted):
        return "SYNCs of the tester"
    unit.flush()
    unit.pause(15 * PERIOD_MS * MS)
    unit.write(0x1005, 0, unit.number(0x1005) & ~PRODUCER)
    unit.pause(unit.timing.quiet_ns)
    sent, count = len(unit.pop_frames(unit.sync_id)), len(unit.pop_frames(can_id))
    if abs(sent - count) > 1 or sent < 10:  # the first SYNC may have been under way when the counting began
        raise CaseFailed(f"{count} TPDOs with {sent} SYNCs of the device")
    return f"{count} TPDOs with {sent} SYNCs of the device"


def synchronous(unit: Unit) -> int:
    """Set a TPDO up for every SYNC, and return its identifier."""
    reason = ""
    for k in candidates(unit):
        try:
            return arm(unit, k, 1)
        except Unsupported as error:
            reason = str(error)
    raise NotApplicable(reason)


@case("6.4")
def consumer(unit: Unit) -> None:
    """Set 1006h to 0 and bit 30 of 1005h to 0: no SYNC from the device, and its TPDO follows the
    tester's.
    """
    unit.need_writable(0x1005)
    cob_id = unit.number(0x1005)
    if unit.has(0x1006) and unit.variable(0x1006).access not in READ_ONLY:
        unit.write(0x1006, 0, 0)
    unit.write(0x1005, 0, cob_id & ~PRODUCER)
    can_id = synchronous(unit)
    unit.start()
    if not unit.until(lambda: not unit.collect(unit.sync_id, 5 * PERIOD_MS * MS)):
        raise CaseFailed("the device sends SYNC although 1006h is 0")
    send_sync(unit)
    unit.expect(can_id, "TPDO of type 1 after a SYNC", cause=NO_SYNC_TPDO)


@case("6.5")
def counter_out_of_range(unit: Unit) -> str:
    """Write 1, 241 and 255 to 1019h."""
    unit.need_writable(0x1019)
    return ", ".join(f"{value}: {unit.refused(0x1019, 0, value):08X}h" for value in (1, 241, 255))


@case("6.6")
def no_counter(unit: Unit) -> str:
    """Set 1019h to 0: SYNCs of the device have no data."""
    unit.need_writable(0x1019)
    produce(unit, 0)
    frames = syncs(unit, 6)
    if any(frame.length for frame in frames):
        raise CaseFailed("SYNCs carry data although 1019h is 0")
    return f"{len(frames)} SYNCs"


@case("6.7")
def counter(unit: Unit) -> str:
    """Set 1019h, start the SYNC, and read the counter from its first value over two overflows."""
    unit.need_writable(0x1019)
    unit.flush()
    produce(unit, OVERFLOW)
    unit.pause((2 * OVERFLOW + 3) * PERIOD_MS * MS)
    check_counter(unit.gather(unit.sync_id, 2 * OVERFLOW), OVERFLOW, first=1)
    return f"1 to {OVERFLOW}"


def check_counter(frames: list[BusFrame], overflow: int, first: int | None = None) -> None:
    """Fail unless the SYNC counter increments by one and restarts at 1 after `overflow`."""
    if len(frames) < overflow:
        text = f"{len(frames)} SYNCs, too few to see the counter's overflow at {overflow}"
        raise CaseFailed(text, cause="" if frames else NO_SYNC)
    if any(frame.length != 1 for frame in frames):
        raise CaseFailed("a SYNC has not one byte although 1019h is set")
    values = [frame.data[0] for frame in frames]
    expected = first or values[0]
    for value in values:
        if value != expected:
            raise CaseFailed(f"SYNC counter {' '.join(map(str, values))}; expected {expected} (overflow {overflow})")
        expected = expected % overflow + 1


@case("6.8", defaults=True)
def counter_stored(unit: Unit) -> None:
    """Set 1019h, store, set it to 0, reset, and read it."""
    unit.need_writable(0x1019)
    unit.need_ability(0x1010)
    write_overflow(unit, 10)
    unit.save()
    unit.put(0x1019, 0, b"\0")
    unit.reset()
    value = unit.number(0x1019)
    if value != 10:
        raise CaseFailed(f"1019h is {value} after store and reset, expected 10", cause=STORE_IS_LOST)


@case("6.9")
def counter_while_running(unit: Unit) -> str:
    """Set 1006h, and write 1019h: refused."""
    unit.need_writable(0x1019)
    unit.need_writable(0x1006)
    unit.write(0x1006, 0, PERIOD_MS * 1000)
    return f"{unit.refused(0x1019, 0, 10):08X}h"


@case("6.10", defaults=True)
def sync_stored(unit: Unit) -> None:
    """Set 1019h, 1006h and the producer's bit, store, reset: the values are kept, and SYNC runs with its counter."""
    unit.need_ability(0x1010)
    for index in (0x1005, 0x1006, 0x1019):
        unit.need_writable(index)
    produce(unit, OVERFLOW)
    expected = {index: unit.number(index) for index in (0x1005, 0x1006, 0x1019)}
    unit.save()
    unit.put(0x1006, 0, bytes(4))
    unit.put(0x1005, 0, encode(unit.variable(0x1005), expected[0x1005] & ~PRODUCER))
    unit.put(0x1019, 0, b"\0")
    unit.reset()
    for index, value in expected.items():
        if unit.number(index) != value:
            text = f"{index:04X}h is {unit.number(index)} after store and reset, expected {value}"
            raise CaseFailed(text, cause=STORE_IS_LOST)
    check_counter(unit.collect(unit.sync_id, (2 * OVERFLOW + 2) * PERIOD_MS * MS), OVERFLOW)


@case("Y.1")
def wrong_length(unit: Unit) -> str:
    """Send a SYNC of one byte with 1019h = 0: an EMCY, if one comes, is 8240h.

    The next SYNC without data acts.
    """
    can_id = synchronous(unit)
    emcy = emcy_id(unit)
    unit.start()
    unit.flush()
    send_sync(unit, 1)
    unit.pause(unit.timing.quiet_ns)
    frames = unit.pop_frames(emcy)
    unit.flush()
    send_sync(unit)
    unit.expect(can_id, "TPDO of type 1 after a SYNC", cause=NO_SYNC_TPDO)
    if frames and frames[0].data[:2] != b"\x40\x82":
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} after a SYNC of an unexpected length, expected 8240h")
    return "EMCY 8240h" if frames else "no EMCY"


@case("Y.2")
def another_identifier(unit: Unit) -> str:
    """Set another identifier in 1005h: the device reacts to SYNCs with it, and to no others."""
    unit.need_writable(0x1005)
    can_id = synchronous(unit)
    try:
        unit.write(0x1005, 0, OTHER_ID)
    except TransferAborted as abort:
        raise NotApplicable(str(abort)) from None
    unit.start()
    unit.pause(unit.timing.quiet_ns)
    unit.flush()
    send_sync(unit)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(can_id):
        raise CaseFailed("a TPDO comes with a SYNC of the old identifier")
    unit.send(OTHER_ID)
    unit.expect(can_id, "TPDO of type 1 after a SYNC with the new identifier")
    return f"{OTHER_ID:03X}h"


@case("Y.3")
def producer_in_stopped(unit: Unit) -> None:
    """Produce SYNC with a counter, and stop: no SYNC. Back in PRE-OPERATIONAL it begins with 1."""
    unit.need_writable(0x1019)
    produce(unit, OVERFLOW)
    unit.pause(2 * PERIOD_MS * MS + PERIOD_MS * MS // 2)
    unit.nmt(NmtCommand.STOP)
    unit.pause(PERIOD_MS * MS // 4)  # one already under way
    if not unit.until(lambda: not unit.collect(unit.sync_id, 5 * PERIOD_MS * MS)):
        raise CaseFailed("the device sends SYNC in STOPPED")
    unit.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    unit.pause((OVERFLOW + 2) * PERIOD_MS * MS)
    check_counter(unit.gather(unit.sync_id, OVERFLOW), OVERFLOW, first=1)


@case("Y.4")
def identifiers_in_use(unit: Unit) -> str:
    """Change the identifier of SYNC while it is produced, of a valid EMCY, of TIME that is
    consumed: refused.
    """
    done = []
    if unit.has(0x1005) and unit.variable(0x1005).access not in READ_ONLY:
        try:
            produce(unit)
        except (NotApplicable, TransferAborted):
            pass
        else:
            unit.refused(0x1005, 0, PRODUCER | OTHER_ID, REFUSED)
            done.append("1005h:00")
    for index, in_use in ((0x1014, 0), (0x1012, INVALID)):
        if unit.has(index) and unit.variable(index).access not in READ_ONLY:
            if unit.number(index) & INVALID != in_use:
                continue
            unit.refused(index, 0, in_use | OTHER_ID, REFUSED)
            done.append(where(index, 0))
    if not done:
        raise NotApplicable("no identifier that is in use can be written")
    return ", ".join(done)


@case("Y.5")
def wide_identifiers(unit: Unit) -> str:
    """Write an identifier of more than 11 bits without bit 29 to 1005h, 1012h and 1014h, made
    invalid first: refused.
    """
    done = []
    for index in (0x1005, 0x1012, 0x1014):
        if unit.has(index) and unit.variable(index).access not in READ_ONLY:
            if index == 0x1014:
                unit.write(index, 0, unit.number(index) | INVALID)
            unit.refused(index, 0, 0x1880, REFUSED)
            done.append(where(index, 0))
    if not done:
        raise NotApplicable("the EDS has no identifier that can be configured")
    return ", ".join(done)


@case("Y.6", defaults=True)
def counter_after_reset(unit: Unit) -> None:
    """Store a SYNC producer with a counter, and reset the node in mid-count: the first SYNC behind
    the boot-up has 1.
    """
    unit.need_ability(0x1010)
    unit.need_writable(0x1019)
    produce(unit, OVERFLOW)
    unit.save()
    unit.pause(2 * PERIOD_MS * MS + PERIOD_MS * MS // 2)
    boot = unit.reset(must=True)
    unit.pause((OVERFLOW + 2) * PERIOD_MS * MS)
    frames = unit.pop_frames(unit.sync_id)
    check_counter([frame for frame in frames if boot is None or frame.t_ns >= boot.t_ns], OVERFLOW, first=1)
