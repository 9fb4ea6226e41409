"""Own cases E.4 to E.9, Y.1 to Y.6, H.1 to H.5, N.3, N.4, K.1 and K.2: EMCY, SYNC, error control,
NMT and storing, tried harder.
"""

from __future__ import annotations

from coulombus.conformance.cases.heartbeat import consumer_subs, guard, need_guarding
from coulombus.conformance.cases.nmt import produce_heartbeats, told
from coulombus.conformance.cases.sdo_wrong import reads_back, shown, text_object
from coulombus.conformance.cases.sync import OVERFLOW, PERIOD_MS, PRODUCER, check_counter, produce, store, synchronous
from coulombus.conformance.tester.objects import READ_ONLY, REFUSED, volatile
from coulombus.conformance.tester.pdo_setup import INVALID, TPDO, HeartbeatOfTester, sync
from coulombus.conformance.tester.pdo_stimuli import candidates
from coulombus.conformance.tester.provoke import GUARD_MS, cause_error, emcy_id, short_rpdo
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.wire.bus_link import BusFrame

__all__: list[str] = []

OTHER_ID = 0x6DA
"""Of no service in the pre-defined connection set, and not restricted."""

WATCH_MS = 100
COMMUNICATION = 0x10
"""Bit of 1001h."""


# EMCY


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
    frames = unit.take(can_id)
    if not unit.number(0x1001):
        raise NotApplicable("1001h stays 0 after a lost heartbeat")
    if frames:
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} although bit 31 of 1014h is set")


@case("E.5")
def moved(unit: Unit) -> str:
    """Give the EMCY another identifier, made invalid first, and cause an error: it comes there."""
    can_id = movable(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1014, 0, can_id | INVALID)
    try:
        unit.write(0x1014, 0, OTHER_ID)
    except TransferAborted as abort:
        raise NotApplicable(str(abort)) from None
    unit.flush()
    heartbeat.lose()
    unit.expect(OTHER_ID, "EMCY with its new identifier")
    if unit.take(can_id):
        raise CaseFailed("an EMCY comes with the old identifier, too")
    return f"{OTHER_ID:03X}h"


@case("E.6")
def in_stopped(unit: Unit) -> None:
    """Lose a heartbeat in STOPPED: no EMCY; in PRE-OPERATIONAL 1001h shows the error."""
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    heartbeat.beat()
    unit.nmt(NmtCommand.STOP)
    unit.flush()
    heartbeat.lose()
    frames = unit.take(can_id)
    unit.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    if not unit.number(0x1001):
        raise NotApplicable("1001h stays 0 after a heartbeat that was lost in STOPPED")
    if frames:
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} in STOPPED")


@case("E.7")
def newest_first(unit: Unit) -> str:
    """Lose a heartbeat, then send a short RPDO: 1003h has both, the newest in :01."""
    unit.need(0x1003, 2)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit)
    unit.flush()
    heartbeat.lose()
    first = unit.expect(can_id, "EMCY after a lost heartbeat")
    send_short = short_rpdo(unit)
    unit.flush()
    send_short()
    second = unit.expect(can_id, "EMCY after an RPDO that is too short")
    codes = [int.from_bytes(frame.data[:2], "little") for frame in (second, first)]
    if codes[0] == codes[1]:
        raise NotApplicable(f"both errors have the code {codes[0]:04X}h")
    count, found = unit.number(0x1003, 0), [unit.number(0x1003, sub) & 0xFFFF for sub in (1, 2)]
    if found != codes or count < 2:
        told_codes = " and ".join(f"{code:04X}h" for code in found)
        raise CaseFailed(
            f"1003h:00 is {count}, with {told_codes}; the EMCYs were, newest first, {codes[0]:04X}h and {codes[1]:04X}h"
        )
    return ", ".join(f"{code:04X}h" for code in codes)


@case("E.8")
def after_reset(unit: Unit) -> None:
    """Cause an error, and reset the node: nothing is watched any more, and 1001h is at most what it
    was before.

    An error of the device may be present all the time; an error of communication is not, behind a
    reset.
    """
    before = unit.number(0x1001)
    cause_error(unit)
    unit.reset()
    value = unit.number(0x1001)
    if value & (~before | COMMUNICATION):
        raise CaseFailed(f"1001h is {value:02X}h after reset node, and was {before:02X}h before the error")


@case("E.9")
def inhibit_after_reset(unit: Unit) -> None:
    """With 1015h at 5 s, cause an error, reset the node, and cause it again: 1015h is what it was,
    and the EMCY comes at once.
    """
    unit.need_writable(0x1015)
    can_id = emcy_id(unit)
    default = unit.number(0x1015)
    heartbeat = HeartbeatOfTester(unit)
    unit.write(0x1015, 0, 50_000)
    heartbeat.lose()
    unit.expect(can_id, "EMCY after a lost heartbeat")
    unit.reset()
    if unit.number(0x1015) != default or default > 1000:
        raise NotApplicable(f"1015h is {unit.number(0x1015)} after a reset")
    heartbeat = HeartbeatOfTester(unit)
    unit.flush()
    heartbeat.lose()
    unit.expect(can_id, "EMCY after a reset, which ends the inhibit time of the one before")


# SYNC


@case("Y.1")
def wrong_length(unit: Unit) -> str:
    """Send a SYNC of one byte where 1019h is 0: an EMCY, if one comes, is 8240h.

    The next SYNC of no byte acts.
    """
    can_id = synchronous(unit)
    emcy = emcy_id(unit)
    unit.start()
    unit.flush()
    sync(unit, 1)
    unit.pause(unit.timing.quiet_ns)
    frames = unit.take(emcy)
    unit.flush()
    sync(unit)
    unit.expect(can_id, "TPDO of type 1 after a SYNC")
    if frames and frames[0].data[:2] != b"\x40\x82":
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} after a SYNC of an unexpected length, expected 8240h")
    return "EMCY 8240h" if frames else "no EMCY"


@case("Y.2")
def another_identifier(unit: Unit) -> str:
    """Give 1005h another identifier: the device obeys SYNCs with it, and no others."""
    unit.need_writable(0x1005)
    can_id = synchronous(unit)
    try:
        unit.write(0x1005, 0, OTHER_ID)
    except TransferAborted as abort:
        raise NotApplicable(str(abort)) from None
    unit.start()
    unit.pause(unit.timing.quiet_ns)
    unit.flush()
    sync(unit)
    unit.pause(unit.timing.quiet_ns)
    if unit.take(can_id):
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
    unit.pause(PERIOD_MS * MS // 4)  # one that was under way
    if unit.collect(unit.sync_id, 5 * PERIOD_MS * MS):
        raise CaseFailed("the device sends SYNC in STOPPED")
    unit.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    unit.pause((OVERFLOW + 2) * PERIOD_MS * MS)
    check_counter(unit.take(unit.sync_id), OVERFLOW, first=1)


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


@case("Y.6")
def counter_after_reset(unit: Unit) -> None:
    """Store a SYNC producer with a counter, and reset the node in mid-count: the first SYNC behind
    the boot-up has 1.
    """
    unit.need_ability(0x1010)
    unit.need_writable(0x1019)
    produce(unit, OVERFLOW)
    store(unit)
    unit.pause(2 * PERIOD_MS * MS + PERIOD_MS * MS // 2)
    boot = unit.reset(must=True)
    unit.pause((OVERFLOW + 2) * PERIOD_MS * MS)
    frames = unit.take(unit.sync_id)
    check_counter([frame for frame in frames if boot is None or frame.t_ns >= boot.t_ns], OVERFLOW, first=1)


# error control


def _beat(unit: Unit, producer: int) -> None:
    unit.send(CobId.HEARTBEAT + producer, bytes((NmtState.OPERATIONAL,)))


@case("H.1")
def second_entry(unit: Unit) -> str:
    """Watch two nodes, and lose the one of the second entry alone: EMCY."""
    subs = consumer_subs(unit)
    if len(subs) < 2:
        raise NotApplicable("1016h has one entry")
    can_id = emcy_id(unit)
    first = HeartbeatOfTester(unit, 4 * WATCH_MS)
    other = next(n for n in (124, 123) if n != unit.node_id)
    unit.write(0x1016, subs[1], other << 16 | 2 * WATCH_MS)
    unit.flush()
    _beat(unit, other)
    for _ in range(5):
        first.beat()
        unit.pause(WATCH_MS * MS)
    frame = unit.wait(can_id, unit.timing.quiet_ns)
    if frame is None:
        raise CaseFailed(f"no EMCY although node {other} of {where(0x1016, subs[1])} is lost")
    return f"{int.from_bytes(frame.data[:2], 'little'):04X}h"


@case("H.2")
def begins_with_the_first(unit: Unit) -> str:
    """Set 1016h, 100Ch and 100Dh, and send nothing: no EMCY, as nothing is watched before the first
    frame.
    """
    can_id = emcy_id(unit)
    done = []
    if unit.has(0x1016, 1):
        consumer_subs(unit)
        HeartbeatOfTester(unit, WATCH_MS)
        done.append("heartbeat")
    try:
        _guarding(unit)
        done.append("guarding")
    except NotApplicable:
        if not done:
            raise
    unit.flush()
    unit.pause(5 * WATCH_MS * MS)
    frames = unit.take(can_id)
    if frames:
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} before the first heartbeat and remote frame")
    return ", ".join(done)


def _guarding(unit: Unit) -> None:
    need_guarding(unit)
    for index, value in ((0x100C, GUARD_MS), (0x100D, 2)):
        unit.need_writable(index)
        unit.write(index, 0, value)


@case("H.3")
def unused_entries(unit: Unit) -> str:
    """An entry of 1016h with time 0 is unused: the same node may stand in another one."""
    subs = consumer_subs(unit)
    if len(subs) < 2:
        raise NotApplicable("1016h has one entry")
    unit.write(0x1016, subs[0], 99 << 16)
    unit.write(0x1016, subs[1], 99 << 16 | 1000)
    return where(0x1016, subs[1])


@case("H.4")
def in_time(unit: Unit) -> str:
    """Lose a heartbeat watched for 100 ms, and a guarding of 2 x 100 ms: the EMCY comes after that
    time, before half of it more.
    """
    can_id = emcy_id(unit)
    done = []
    try:
        consumer_subs(unit)
    except NotApplicable:
        pass
    else:
        heartbeat = HeartbeatOfTester(unit, WATCH_MS)
        unit.flush()
        start_ns = unit.link.now_ns()
        heartbeat.beat()
        frame = unit.expect(can_id, "EMCY after a lost heartbeat")
        done.append(_between("heartbeat", frame, start_ns, WATCH_MS))
        unit.restore()
        unit.reset()
    try:
        _guarding(unit)
    except NotApplicable:
        if not done:
            raise
        return done[0]
    unit.flush()
    start_ns = unit.link.now_ns()
    guard(unit)
    frame = unit.expect(can_id, "EMCY after the life time")
    done.append(_between("guarding", frame, start_ns, 2 * GUARD_MS))
    return ", ".join(done)


def _between(what: str, frame: BusFrame, start_ns: int, limit_ms: int) -> str:
    if frame.data[:2] != b"\x30\x81":
        raise CaseFailed(f"EMCY {frame.data[:8].hex(' ')} after the lost {what}, expected 8130h")
    after_ms = (frame.t_ns - start_ns) / 1e6
    if not 0.95 * limit_ms <= after_ms <= 1.5 * limit_ms:
        raise CaseFailed(f"the EMCY for the lost {what} comes after {after_ms:.0f} ms; its time is {limit_ms} ms")
    return f"{what} {after_ms:.0f} ms"


@case("H.5")
def error_behaviour(unit: Unit) -> str:
    """Lose a heartbeat in OPERATIONAL with 1029h:01 at 0, 1 and 2: PRE-OPERATIONAL, OPERATIONAL,
    STOPPED.
    """
    unit.need_writable(0x1029, 1)
    states = (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED)
    for value, wanted in enumerate(states):
        produce_heartbeats(unit)
        heartbeat = HeartbeatOfTester(unit)
        try:
            unit.write(0x1029, 1, value)
        except TransferAborted as abort:
            raise NotApplicable(f"{where(0x1029, 1)}: {abort}") from None
        unit.start()
        heartbeat.lose()
        state = told(unit)
        if state is None:
            raise NotApplicable("the device tells its state neither by heartbeat nor by guarding")
        if state != wanted:
            raise CaseFailed(
                f"NMT state {state} after a lost heartbeat with 1029h:01 at {value}, expected {wanted.name}"
            )
        unit.restore()
        unit.reset()
    return ", ".join(state.name for state in states)


# NMT, storing


@case("N.3")
def reserved_commands(unit: Unit) -> None:
    """Send NMT commands that are none: the device stays in PRE-OPERATIONAL, and does not boot."""
    produce_heartbeats(unit)
    for command in (0, 3, 5, 127, 131, 255):
        unit.flush()
        unit.nmt(command)
        unit.pause(unit.timing.quiet_ns)
        if any(frame.data == b"\0" for frame in unit.take(CobId.HEARTBEAT + unit.node_id)):
            raise CaseFailed(f"NMT command {command} resets the device")
        state = told(unit)
        if state not in (None, NmtState.PRE_OPERATIONAL):
            raise CaseFailed(f"NMT command {command} leads to state {state}")


@case("N.4")
def reset_communication(unit: Unit) -> str:
    """Change a TPDO's parameter and a text of the manufacturer's, and reset the communication: the
    first has its default, the text stays.
    """
    places = [(k, sub, value) for k in candidates(unit) for sub, value in ((2, 7), (5, 700)) if unit.has(TPDO + k, sub)]
    places = [(k, sub, value) for k, sub, value in places if unit.variable(TPDO + k, sub).access not in READ_ONLY]
    if not places:
        raise NotApplicable("no TPDO's parameter can be written")
    k, subindex, value = places[-1]
    index = TPDO + k
    default = unit.read(index, subindex)
    try:
        text: tuple[int, int, bytes, bytes] | None = text_object(unit)
    except NotApplicable:
        text = None
    unit.put(index, subindex, encode(unit.variable(index, subindex), value))
    if text:
        unit.put(text[0], text[1], text[3])
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    if unit.read(index, subindex) != default:
        raise CaseFailed(f"{where(index, subindex)} is {unit.read(index, subindex).hex()} after reset communication")
    if text:
        reads_back(unit, text[0], text[1], text[3], " after reset communication, which is for 1000h to 1FFFh")
    return where(index, subindex)


@case("K.1")
def verification_is_lost(unit: Unit) -> str:
    """Write date and time to 1020h, and change a parameter: both are 0, or stay, as the boot-up
    configuration has not changed yet.

    Where they stay: store them, load the defaults and reset. That changes the boot-up
    configuration, and both are 0.
    """

    def told() -> list[int]:
        return [unit.number(0x1020, sub) for sub in (1, 2)]

    def tell() -> None:
        for sub in (1, 2):
            unit.put(0x1020, sub, (14_000).to_bytes(4, "little"))

    for sub in (1, 2):
        unit.need_writable(0x1020, sub)
    tell()
    index, subindex, value = volatile(unit)
    unit.put(index, subindex, encode(unit.variable(index, subindex), value))
    if not any(told()):
        return f"0 after {where(index, subindex)} was changed"
    for index in (0x1010, 0x1011):
        unit.need_ability(index)
    tell()
    unit.stored = True
    unit.sdo.download(0x1010, 1, b"save")
    unit.sdo.download(0x1011, 1, b"load")
    unit.reset()
    left = told()
    if any(left):
        raise CaseFailed(f"1020h is {left[0]} and {left[1]} after the defaults were loaded, expected 0")
    return "0 after the defaults were loaded"


@case("K.2")
def only_the_group(unit: Unit) -> str:
    """Change a text of the manufacturer's, and store the communication group alone: the text is
    lost with a reset.
    """
    unit.need_ability(0x1010, 2)
    index, subindex, before, text = text_object(unit)
    unit.put(index, subindex, text)
    unit.stored = True
    unit.sdo.download(0x1010, 2, b"save")
    unit.reset()
    if shown(unit.read(index, subindex)) != shown(before):
        raise CaseFailed(f"{where(index, subindex)} has been stored with the communication group")
    return where(index, subindex)
