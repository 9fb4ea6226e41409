"""Cases 7.101 to 7.207 and H.1 to H.5: heartbeat, alone and together with node guarding.

Source: CiA 301, sections 7.2.8.2.2 and 7.2.8.3.2.
"""

from __future__ import annotations

from coulombus.conformance.cases.nmt import nmt_state, produce_heartbeats
from coulombus.conformance.cases.node_guarding import alternating, error_id, guard, need_guarding
from coulombus.conformance.tester.objects import READ_ONLY
from coulombus.conformance.tester.pdo_setup import HeartbeatOfTester
from coulombus.conformance.tester.provoke import (
    EMCY_IS_OPTIONAL,
    GUARD_MS,
    after_lost_heartbeat,
    emcy_id,
    must_be_noticed,
)
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, LeftOpen, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.wire.bus_link import RTR, BusFrame

__all__ = ["HEARTBEAT_MS", "check_heartbeats"]

HEARTBEAT_MS = 50
_STATES = (int(NmtState.PRE_OPERATIONAL), int(NmtState.OPERATIONAL), int(NmtState.STOPPED))
WATCH_MS = 100


def check_heartbeats(unit: Unit, period_ms: int, *, ask: bool = False) -> int:
    """Fail unless heartbeats come with their period, toggle bit 0, and nothing between them.

    With `ask`, remote frames are sent.
    """
    text = cause = ""
    for _ in range(3):  # the tester itself may be late
        unit.flush()
        for _ in range(12):
            if ask:
                unit.send(error_id(unit) | RTR, length=1)
            unit.pause(period_ms * MS)
        frames = unit.pop_frames(error_id(unit))
        for frame in frames:
            if frame.length != 1 or frame.data[0] not in _STATES:
                raise CaseFailed(f"a heartbeat is {frame.data.hex(' ')!r}, expected one byte 04h, 05h or 7Fh")
        if len(frames) < 2:
            text = f"{len(frames)} heartbeats in {12 * period_ms} ms; 1017h is {period_ms} ms"
            cause = "" if frames else "no heartbeat"
            continue
        mean_ms = (frames[-1].t_ns - frames[0].t_ns) / (len(frames) - 1) / 1e6
        if abs(mean_ms - period_ms) <= 0.1 * period_ms:
            return len(frames)
        text = f"heartbeats come every {mean_ms:.1f} ms; 1017h is {period_ms} ms"
    raise CaseFailed(text, cause=cause, clause="CiA 301, 7.5.2.20")


@case("7.101")
def heartbeat_time(unit: Unit) -> None:
    """Write 1017h and read it back."""
    unit.need_writable(0x1017)
    unit.write(0x1017, 0, 1234)
    if unit.number(0x1017) != 1234:
        raise CaseFailed(f"1017h is {unit.number(0x1017)} after 1234 was written")


@case("7.102")
def heartbeat_period(unit: Unit) -> str:
    """Measure the period with 50 and 100 ms, and check the reported state."""
    unit.need_writable(0x1017)
    counts = []
    for period_ms in (HEARTBEAT_MS, 2 * HEARTBEAT_MS):
        unit.write(0x1017, 0, period_ms)
        counts.append(check_heartbeats(unit, period_ms))
    return f"{sum(counts)} heartbeats"


@case("7.103")
def heartbeat_off(unit: Unit) -> None:
    """Switch the heartbeat on and off again: none is sent."""
    unit.need_writable(0x1017)
    unit.write(0x1017, 0, HEARTBEAT_MS)
    unit.pop_frames(error_id(unit))
    unit.expect(error_id(unit), "heartbeat")
    unit.write(0x1017, 0, 0)
    no_more_heartbeats(unit)


def no_more_heartbeats(unit: Unit) -> None:
    """Fail unless the heartbeat stops in time after being switched off."""
    unit.pause(unit.timing.quiet_ns)
    if not unit.until(lambda: not unit.collect(error_id(unit), 6 * HEARTBEAT_MS * MS)):
        raise CaseFailed("heartbeats come although 1017h is 0", clause="CiA 301, 7.5.2.20")


def consumer_subs(unit: Unit) -> list[int]:
    """Return the sub-indices of 1016h that can be written."""
    unit.need(0x1016, 1)
    entries = unit.description.objects[0x1016].variables
    subs = [s for s, v in entries.items() if 0 < s < 0xFF and v.access not in (*READ_ONLY, "wo")]
    if not subs:
        raise NotApplicable("no entry of 1016h can be written, by the EDS")
    return subs


@case("7.104")
def same_node_twice(unit: Unit) -> str:
    """Write one node-id and time to two entries of 1016h: the second is refused.

    Twice to one entry is no error.
    """
    subs = consumer_subs(unit)
    entry = 99 << 16 | 1000
    unit.write(0x1016, subs[0], entry)
    unit.write(0x1016, subs[0], entry)
    if len(subs) < 2:
        return "1016h has one entry: taken twice"
    return f"{unit.refused(0x1016, subs[1], entry):08X}h"


@case("7.105", producer_ms=40, consumer_ms=200, lost=False)
@case("7.106", producer_ms=300, consumer_ms=100, lost=True)
def heartbeat_consumer(unit: Unit, producer_ms: int, consumer_ms: int, lost: bool) -> str | None:
    """Send heartbeats faster and more slowly than 1016h allows: an EMCY comes in the second case only."""
    consumer_subs(unit)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit, consumer_ms)
    unit.flush()
    late_ns = 0
    sent_ns = unit.link.now_ns()
    for _ in range(10 if not lost else 2):
        heartbeat.beat()
        unit.pause(producer_ms * MS)
        late_ns = max(late_ns, unit.link.now_ns() - sent_ns)
        sent_ns = unit.link.now_ns()
    if lost:
        frame = unit.wait(can_id)
        if frame is None:
            must_be_noticed(unit, "a lost heartbeat", heartbeat.lose)
        return f"{int.from_bytes(frame.data[:2], 'little'):04X}h" if frame else None
    frames = unit.pop_frames(can_id)
    if frames and late_ns < consumer_ms * MS:
        raise CaseFailed(f"an EMCY although heartbeats come every {producer_ms} ms and 1016h allows {consumer_ms}")
    return None


@case("7.107")
def consumer_after_reset(unit: Unit) -> None:
    """Make the device monitor a heartbeat, reset the communication, and stop the heartbeat: no EMCY
    except for the reset itself.
    """
    consumer_subs(unit)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit, 100)
    heartbeat.beat()
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    unit.flush()
    unit.pause(300 * MS)
    if any(frame.data[:2] != b"\0\0" for frame in unit.pop_frames(can_id)):
        raise CaseFailed("an EMCY for a heartbeat that was watched before the reset")
    if unit.number(0x1016, heartbeat.subindex) == heartbeat.producer << 16 | 100:
        raise CaseFailed("1016h keeps its value over reset communication")


def need_both(unit: Unit) -> None:
    """Skip devices without both error control services."""
    unit.need_writable(0x1017)
    for index in (0x100C, 0x100D):
        unit.need_writable(index)


@case("7.201")
def both_objects(unit: Unit) -> None:
    """Read 1017h, 100Ch and 100Dh."""
    need_both(unit)
    for index in (0x1017, 0x100C, 0x100D):
        unit.number(index)


@case("7.202")
def both_heartbeat_off(unit: Unit) -> None:
    """Set 1017h to 0 with guarding parameters set: no heartbeat."""
    need_both(unit)
    unit.write(0x1017, 0, HEARTBEAT_MS)
    unit.expect(error_id(unit), "heartbeat")
    _guarding_on(unit)
    unit.write(0x1017, 0, 0)
    no_more_heartbeats(unit)


def _guarding_on(unit: Unit) -> None:
    unit.write(0x100C, 0, 1000)
    unit.write(0x100D, 0, 5)


@case("7.203")
def both_guarding(unit: Unit) -> None:
    """With 1017h at 0, guard six times: the toggle bit alternates."""
    need_both(unit)
    unit.write(0x1017, 0, 0)
    _guarding_on(unit)
    first = guard(unit).data[0]
    alternating(unit, NmtState.PRE_OPERATIONAL, 5, toggle=first >> 7 ^ 1)


@case("7.204", guarding=False, ask=False)
@case("7.205", guarding=False, ask=True)
@case("7.206", guarding=True, ask=False)
@case("7.207", guarding=True, ask=True)
def heartbeat_first(unit: Unit, guarding: bool, ask: bool) -> str:
    """Heartbeat on, guarding parameters 0 or set, with and without remote frames: heartbeats at
    their period, nothing else.
    """
    need_both(unit)
    if guarding:
        _guarding_on(unit)
    else:
        unit.write(0x100C, 0, 0)
        unit.write(0x100D, 0, 0)
    unit.write(0x1017, 0, HEARTBEAT_MS)
    return f"{check_heartbeats(unit, HEARTBEAT_MS, ask=ask)} heartbeats"


def _beat(unit: Unit, producer: int) -> None:
    unit.send(CobId.HEARTBEAT + producer, bytes((NmtState.OPERATIONAL,)))


@case("H.1")
def second_entry(unit: Unit) -> str:
    """Monitor two nodes, and stop only the second entry's heartbeat: EMCY."""
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
    until_ns, frame = unit.link.now_ns() + unit.timing.answer_ns, None
    while frame is None and unit.link.now_ns() < until_ns:
        first.beat()
        frame = unit.wait(can_id, WATCH_MS * MS)
    if frame is None:
        after_lost_heartbeat(unit, can_id)  # of the first entry, whose heartbeat has also ended
        raise CaseFailed(f"no EMCY although node {other} of {where(0x1016, subs[1])} is lost")
    return f"{int.from_bytes(frame.data[:2], 'little'):04X}h"


@case("H.2")
def begins_with_the_first(unit: Unit) -> str:
    """Set 1016h, 100Ch and 100Dh, and send nothing: no EMCY, because monitoring begins with the first frame."""
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
    frames = unit.pop_frames(can_id)
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
    """An entry of 1016h with time 0 is unused: another entry may have the same node."""
    subs = consumer_subs(unit)
    if len(subs) < 2:
        raise NotApplicable("1016h has one entry")
    unit.write(0x1016, subs[0], 99 << 16)
    unit.write(0x1016, subs[1], 99 << 16 | 1000)
    return where(0x1016, subs[1])


@case("H.4")
def in_time(unit: Unit) -> str:
    """Stop a heartbeat with a time of 100 ms, then of 300 ms, and a guarding of 2 x 100 ms: the
    EMCY comes after that time.

    CiA 301 does not specify the delay; but the second EMCY comes 200 ms later than the first, within 90 ms.
    """
    can_id = emcy_id(unit)
    done = []
    try:
        consumer_subs(unit)
    except NotApplicable:
        pass
    else:
        short, long = (_heartbeat_ms(unit, can_id, watch_ms) for watch_ms in (WATCH_MS, 3 * WATCH_MS))
        if abs(long - short - 2 * WATCH_MS) > 0.9 * WATCH_MS:
            text = f"after {short:.0f} ms with {WATCH_MS} ms in 1016h, and after {long:.0f} ms with {3 * WATCH_MS} ms"
            raise CaseFailed(f"the EMCY for a lost heartbeat comes {text}")
        done.append(f"heartbeat {short:.0f} ms")
    try:
        _guarding(unit)
    except NotApplicable:
        if not done:
            raise
        return done[0]
    unit.flush()
    start_ns = unit.link.now_ns()
    guard(unit)
    frame = unit.wait(can_id, 2 * GUARD_MS * MS + unit.timing.answer_ns)
    if frame is None:
        raise LeftOpen("no EMCY after the life time", EMCY_IS_OPTIONAL)
    done.append(f"guarding {_not_early('guarding', frame, start_ns, 2 * GUARD_MS):.0f} ms")
    return ", ".join(done)


def _heartbeat_ms(unit: Unit, can_id: int, watch_ms: int) -> float:
    """Return the delay [ms] of the EMCY for a lost heartbeat."""
    heartbeat = HeartbeatOfTester(unit, watch_ms)
    unit.flush()
    start_ns = unit.link.now_ns()
    heartbeat.beat()
    unit.pause(watch_ms * MS)
    frame = after_lost_heartbeat(unit, can_id)
    unit.restore()
    unit.reset()
    return _not_early("heartbeat", frame, start_ns, watch_ms)


def _not_early(what: str, frame: BusFrame, start_ns: int, limit_ms: int) -> float:
    """Return the delay [ms] of an EMCY; fail if it is early or has another code."""
    if frame.data[:2] != b"\x30\x81":
        raise CaseFailed(f"EMCY {frame.data[:8].hex(' ')} after the lost {what}, expected 8130h")
    after_ms = (frame.t_ns - start_ns) / 1e6
    if after_ms < 0.95 * limit_ms:
        raise CaseFailed(f"the EMCY for the lost {what} comes after {after_ms:.0f} ms; its time is {limit_ms} ms")
    return after_ms


def _reached(unit: Unit, expected: NmtState) -> int | None:
    """Return the NMT state once it is as expected, else the state at the time-out."""
    unit.until(lambda: nmt_state(unit) == expected)
    return nmt_state(unit)


@case("H.5")
def error_behaviour(unit: Unit) -> str:
    """Stop a heartbeat in OPERATIONAL with 1029h:01 at 0, 1 and 2: PRE-OPERATIONAL, OPERATIONAL,
    STOPPED.
    """
    unit.need_writable(0x1029, 1)
    states = (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED)
    for value, expected in enumerate(states):
        produce_heartbeats(unit)
        heartbeat = HeartbeatOfTester(unit)
        try:
            unit.write(0x1029, 1, value)
        except TransferAborted as abort:
            raise NotApplicable(f"{where(0x1029, 1)}: {abort}") from None
        unit.start()
        if nmt_state(unit) is None:
            raise NotApplicable("the device tells its state neither by heartbeat nor by guarding")
        heartbeat.lose()
        if (state := _reached(unit, expected)) != expected:
            raise CaseFailed(
                f"NMT state {state} after a lost heartbeat with 1029h:01 at {value}, expected {expected.name}"
            )
        unit.restore()
        unit.reset()
    return ", ".join(state.name for state in states)
