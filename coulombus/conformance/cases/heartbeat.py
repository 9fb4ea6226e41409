"""Cases 7.1 to 7.207: node guarding, heartbeat, and both (CiA 301, sections 7.2.8.2.2 and
7.2.8.3.2).
"""

from __future__ import annotations

from coulombus.conformance.tester.pdo_setup import HeartbeatOfTester
from coulombus.conformance.tester.provoke import GUARD_MS, emcy_id
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable
from coulombus.eds.cia301 import CobId, NmtCommand, NmtState
from coulombus.wire.bus_link import RTR, BusFrame

__all__ = ["HEARTBEAT_MS", "check_heartbeats", "guard"]

HEARTBEAT_MS = 50
_STATES = (int(NmtState.PRE_OPERATIONAL), int(NmtState.OPERATIONAL), int(NmtState.STOPPED))


def need_guarding(unit: Unit) -> None:
    """Guarding takes both objects; a heartbeat that runs by default has precedence, and is switched
    off.
    """
    unit.need(0x100C)
    unit.need(0x100D)
    no_heartbeat(unit)


def no_heartbeat(unit: Unit) -> None:
    """Switch a heartbeat off that runs by default."""
    if unit.has(0x1017) and unit.number(0x1017):
        unit.write(0x1017, 0, 0)


def error_id(unit: Unit) -> int:
    """Return the identifier of heartbeat and guarding."""
    return CobId.HEARTBEAT + unit.node_id


def guard(unit: Unit) -> BusFrame:
    """Ask with a remote frame, and return the answer."""
    unit.pause(2 * MS)
    unit.take(error_id(unit))
    unit.send(error_id(unit) | RTR, length=1)
    frame = unit.expect(error_id(unit), "answer to the guarding's remote frame")
    if frame.length != 1:
        raise CaseFailed(f"the guarding's answer has {frame.length} bytes, expected 1")
    return frame


def alternating(unit: Unit, state: NmtState, count: int = 6, toggle: int = 0) -> None:
    """Guard so many times: the state is told, and the toggle bit alternates from `toggle` on."""
    for k in range(count):
        wanted = state | 0x80 * (toggle ^ (k & 1))
        value = guard(unit).data[0]
        if value != wanted:
            raise CaseFailed(f"guarding answer {k + 1} is {value:02X}h, expected {wanted:02X}h")


def check_heartbeats(unit: Unit, period_ms: int, *, ask: bool = False) -> int:
    """Fail unless heartbeats come with their period, toggle bit 0, and nothing between them.

    With `ask`, remote frames go out.
    """
    text = ""
    for _ in range(3):  # the tester may be late itself
        unit.flush()
        for _ in range(12):
            if ask:
                unit.send(error_id(unit) | RTR, length=1)
            unit.pause(period_ms * MS)
        frames = unit.take(error_id(unit))
        for frame in frames:
            if frame.length != 1 or frame.data[0] not in _STATES:
                raise CaseFailed(f"a heartbeat is {frame.data.hex(' ')!r}, expected one byte 04h, 05h or 7Fh")
        if len(frames) < 2:
            raise CaseFailed(f"{len(frames)} heartbeats in {12 * period_ms} ms; 1017h is {period_ms} ms")
        mean_ms = (frames[-1].t_ns - frames[0].t_ns) / (len(frames) - 1) / 1e6
        if abs(mean_ms - period_ms) <= 0.1 * period_ms:
            return len(frames)
        text = f"heartbeats come every {mean_ms:.1f} ms; 1017h is {period_ms} ms"
    raise CaseFailed(text)


@case("7.1")
def guarding_objects(unit: Unit) -> str:
    """Read 100Ch and 100Dh and compare them with the EDS."""
    need_guarding(unit)
    values = [unit.number(0x100C), unit.number(0x100D)]
    wanted = [unit.default(unit.variable(index)) for index in (0x100C, 0x100D)]
    for index, value, default in zip((0x100C, 0x100D), values, wanted, strict=True):
        if isinstance(default, int) and value != default:
            raise CaseFailed(f"{index:04X}h is {value}; the EDS says {default}")
    return f"{values[0]} ms, factor {values[1]}"


@case("7.2")
def guarding_answer(unit: Unit) -> None:
    """Guard once in PRE-OPERATIONAL and OPERATIONAL."""
    need_guarding(unit)
    for command, state in ((NmtCommand.ENTER_PRE_OPERATIONAL, 127), (NmtCommand.START, 5), (NmtCommand.STOP, 4)):
        unit.nmt(command)
        value = guard(unit).data[0] & 0x7F
        if value != state:
            raise CaseFailed(f"the guarding's answer tells state {value}, expected {state}")


@case("7.3")
def guarding_toggle(unit: Unit) -> None:
    """Reset the communication, and guard six times: 0, 1, 0, 1, 0, 1.

    After another reset 0 again.
    """
    need_guarding(unit)
    for count in (5, 2):
        unit.reset(NmtCommand.RESET_COMMUNICATION)
        no_heartbeat(unit)
        alternating(unit, NmtState.PRE_OPERATIONAL, count)


@case("7.4")
def guarding_identifiers(unit: Unit) -> None:
    """Send remote frames with all 127 identifiers: the device answers to its own only."""
    need_guarding(unit)
    unit.flush()
    for node_id in range(1, 128):
        if node_id == unit.node_id:
            continue
        unit.send(CobId.HEARTBEAT + node_id | RTR, length=1)
        unit.pause(MS)
    unit.pause(unit.timing.quiet_ns)
    if unit.take(error_id(unit)):
        raise CaseFailed("the device answers to a remote frame with another node's identifier")
    alternating(unit, NmtState.PRE_OPERATIONAL, 1)


@case("7.5")
def guarding_parameters(unit: Unit) -> None:
    """Write 100Ch and 100Dh and read them back."""
    need_guarding(unit)
    for index, value in ((0x100C, 500), (0x100D, 3)):
        unit.need_writable(index)
        unit.write(index, 0, value)
        if unit.number(index) != value:
            raise CaseFailed(f"{index:04X}h is {unit.number(index)} after {value} was written")


@case("7.6")
def life_guarding(unit: Unit) -> str:
    """Guard in time: no EMCY. Then no more: EMCY after the life time, not before half of it."""
    need_guarding(unit)
    can_id = emcy_id(unit)
    for index, value in ((0x100C, GUARD_MS), (0x100D, 4)):
        unit.need_writable(index)
        unit.write(index, 0, value)
    unit.flush()
    for _ in range(8):
        guard(unit)
        unit.pause(GUARD_MS * MS)
    if unit.take(can_id):
        raise CaseFailed("an EMCY although the guarding is in time")
    last_ns = unit.link.now_ns()
    guard(unit)
    frame = unit.expect(can_id, "EMCY after the life time", 4 * GUARD_MS * MS + unit.timing.answer_ns)
    after_ms = (frame.t_ns - last_ns) / 1e6
    if after_ms < 2 * GUARD_MS:
        raise CaseFailed(f"EMCY after {after_ms:.0f} ms; the life time is {4 * GUARD_MS} ms")
    return f"{int.from_bytes(frame.data[:2], 'little'):04X}h after {after_ms:.0f} ms"


@case("7.101")
def heartbeat_time(unit: Unit) -> None:
    """Write 1017h and read it back."""
    unit.need_writable(0x1017)
    unit.write(0x1017, 0, 1234)
    if unit.number(0x1017) != 1234:
        raise CaseFailed(f"1017h is {unit.number(0x1017)} after 1234 was written")


@case("7.102")
def heartbeat_period(unit: Unit) -> str:
    """Measure the period twice, with 50 and 100 ms, and the state that is told."""
    unit.need_writable(0x1017)
    counts = []
    for period_ms in (HEARTBEAT_MS, 2 * HEARTBEAT_MS):
        unit.write(0x1017, 0, period_ms)
        counts.append(check_heartbeats(unit, period_ms))
    return f"{sum(counts)} heartbeats"


@case("7.103")
def heartbeat_off(unit: Unit) -> None:
    """Switch the heartbeat on and off again: none comes."""
    unit.need_writable(0x1017)
    unit.write(0x1017, 0, HEARTBEAT_MS)
    unit.take(error_id(unit))
    unit.expect(error_id(unit), "heartbeat")
    unit.write(0x1017, 0, 0)
    unit.pause(unit.timing.quiet_ns)
    if unit.collect(error_id(unit), 6 * HEARTBEAT_MS * MS):
        raise CaseFailed("heartbeats come although 1017h is 0")


def consumer_subs(unit: Unit) -> list[int]:
    """Return the sub-indices of 1016h that can be written."""
    unit.need(0x1016, 1)
    found = [s for s, v in unit.description.objects[0x1016].variables.items() if 0 < s < 0xFF and v.access != "ro"]
    if not found:
        raise NotApplicable("1016h cannot be written")
    return found


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
    """Send heartbeats faster or more slowly than 1016h allows: an EMCY comes in the second case
    only.
    """
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
    frames = unit.take(can_id)
    if lost:
        if not frames:
            raise CaseFailed(
                f"no EMCY although the heartbeats come every {producer_ms} ms and 1016h allows {consumer_ms}"
            )
        return f"{int.from_bytes(frames[0].data[:2], 'little'):04X}h"
    if frames and late_ns < consumer_ms * MS:
        raise CaseFailed(f"an EMCY although heartbeats come every {producer_ms} ms and 1016h allows {consumer_ms}")
    return None


@case("7.107")
def consumer_after_reset(unit: Unit) -> None:
    """Let it watch a heartbeat, reset the communication, and stop the heartbeat: no EMCY but for
    the reset itself.
    """
    consumer_subs(unit)
    can_id = emcy_id(unit)
    heartbeat = HeartbeatOfTester(unit, 100)
    heartbeat.beat()
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    unit.flush()
    unit.pause(300 * MS)
    if any(frame.data[:2] != b"\0\0" for frame in unit.take(can_id)):
        raise CaseFailed("an EMCY for a heartbeat that was watched before the reset")
    if unit.number(0x1016, heartbeat.subindex) == heartbeat.producer << 16 | 100:
        raise CaseFailed("1016h keeps its value over reset communication")


def need_both(unit: Unit) -> None:
    """Both error controls."""
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
    """Set 1017h to 0 with the guarding's parameters set: no heartbeat."""
    need_both(unit)
    unit.write(0x1017, 0, HEARTBEAT_MS)
    unit.expect(error_id(unit), "heartbeat")
    _guarding_on(unit)
    unit.write(0x1017, 0, 0)
    unit.pause(unit.timing.quiet_ns)
    if unit.collect(error_id(unit), 6 * HEARTBEAT_MS * MS):
        raise CaseFailed("heartbeats come although 1017h is 0")


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
    """Heartbeat on, guarding's parameters 0 or set, remote frames or none: heartbeats in their
    period, nothing else.
    """
    need_both(unit)
    if guarding:
        _guarding_on(unit)
    else:
        unit.write(0x100C, 0, 0)
        unit.write(0x100D, 0, 0)
    unit.write(0x1017, 0, HEARTBEAT_MS)
    return f"{check_heartbeats(unit, HEARTBEAT_MS, ask=ask)} heartbeats"
