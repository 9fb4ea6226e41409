"""Own cases T.1 to T.9: timing of TPDOs, refused writes while they are valid, and an empty map.

Source: CiA 301, 7.2.2, 7.5.2.37 and 38.
"""

from __future__ import annotations

from coulombus.conformance.cases.pdo_mapping import clear, first
from coulombus.conformance.tester.objects import READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import (
    EVENT_TIMER,
    INHIBIT_TIME,
    INVALID,
    NO_RTR,
    TPDO,
    Event,
    Unsupported,
    arm,
    disable,
    event_type,
    sync,
)
from coulombus.conformance.tester.pdo_stimuli import candidates
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.wire.bus_link import RTR

__all__: list[str] = []

INHIBIT_MS, TIMER_MS = 100, 20
CALM_NS = 10 * MS


@case("T.1")
def inhibit_time(unit: Unit) -> str:
    """Event timer 20 ms, inhibit time 100 ms: the TPDO comes every 100 ms."""
    reason = "no TPDO has an inhibit time and an event timer"
    for k in candidates(unit):
        if not unit.has(0x1800 + k, 3):
            continue
        try:
            can_id = arm(unit, k, event_type(unit, k), entries={EVENT_TIMER: TIMER_MS, INHIBIT_TIME: INHIBIT_MS * 10})
        except Unsupported as error:
            reason = str(error)
            continue
        unit.start()
        text = ""
        for _ in range(3):
            frames = unit.collect(can_id, 8 * INHIBIT_MS * MS)
            if len(frames) < 2:
                raise CaseFailed(f"TPDO {k + 1}: {len(frames)} frames in {8 * INHIBIT_MS} ms")
            mean_ms = (frames[-1].t_ns - frames[0].t_ns) / (len(frames) - 1) / 1e6
            if mean_ms >= 0.9 * INHIBIT_MS:
                return f"TPDO {k + 1}: every {mean_ms:.0f} ms"
            text = f"TPDO {k + 1} comes every {mean_ms:.1f} ms; its inhibit time is {INHIBIT_MS} ms"
        raise CaseFailed(text)
    raise NotApplicable(reason)


@case("T.2")
def reserved_types(unit: Unit) -> str:
    """Write 241 and 251 to a TPDO's transmission type, made invalid first: refused."""
    for k in candidates(unit):
        index = 0x1800 + k
        if unit.variable(index, 2).access not in READ_ONLY and unit.variable(index, 1).access == "rw":
            cob_id = unit.number(index, 1)
            if not cob_id & 1 << 31:
                unit.write(index, 1, cob_id | 1 << 31)
            refused = [unit.refused(index, 2, encode(unit.variable(index, 2), kind), REFUSED) for kind in (241, 251)]
            return ", ".join(f"{code:08X}h" for code in refused)
    raise NotApplicable("no TPDO's transmission type can be written")


def armed(unit: Unit, transmission: int, *, rtr: bool = False) -> tuple[int, int, Event]:
    """Set up the first possible TPDO with an object that the event changes.

    Return its number, identifier and the event.
    """
    reasons = []
    for k in candidates(unit):
        event = Event(unit, k)
        try:
            can_id = arm(unit, k, transmission, words=event.prepare(), rtr=rtr)
        except Unsupported as reason:
            reasons.append(str(reason))
            continue
        if event.possible:
            return k, can_id, event
        reasons.append(event.why)
    raise NotApplicable(reasons[0])


def ask(unit: Unit, can_id: int, timeout_ns: int | None = None) -> bytes | None:
    """Request a TPDO by a remote frame; return the response."""
    unit.flush()
    unit.send(can_id | RTR, length=8)
    frame = unit.wait(can_id, timeout_ns)
    return None if frame is None else frame.data


@case("T.3")
def no_remote_frames(unit: Unit) -> str:
    """With bit 30 of its COB-ID a TPDO does not respond to remote frames; without it, it does."""
    k, can_id, _ = armed(unit, 253, rtr=True)
    unit.start()
    if ask(unit, can_id) is None:
        raise NotApplicable(f"TPDO {k + 1} answers no remote frame either way")
    unit.nmt(128)
    unit.write(TPDO + k, 1, disable(unit, TPDO, k) | INVALID)
    unit.write(TPDO + k, 1, can_id | NO_RTR)
    unit.start()
    if ask(unit, can_id, unit.timing.quiet_ns) is not None:
        raise CaseFailed(f"TPDO {k + 1} answers a remote frame; bit 30 of {where(TPDO + k, 1)} forbids it")
    return f"TPDO {k + 1}"


@case("T.4", transmission=252)
@case("T.5", transmission=253)
def only_on_request(unit: Unit, transmission: int) -> str:
    """Types 252 and 253: no TPDO with a SYNC or an event.

    On request, 252 has the sample of the SYNC, 253 the present value.
    """
    k, can_id, event = armed(unit, transmission, rtr=True)
    unit.start()
    sync(unit)
    unit.pause(unit.timing.quiet_ns)
    before = ask(unit, can_id)
    if before is None:
        raise NoAnswer(f"TPDO {k + 1} of type {transmission} does not answer a remote frame")
    unit.flush()
    event.fire_and_see()
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(can_id):
        raise CaseFailed(f"TPDO {k + 1} of type {transmission} comes with an event")
    sample = ask(unit, can_id)
    if (sample == before) != (transmission == 252):
        text = "the SYNC's sample has changed without a SYNC" if transmission == 252 else "an old value"
        raise CaseFailed(f"TPDO {k + 1} of type {transmission}: {text}")
    unit.flush()
    sync(unit)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(can_id):
        raise CaseFailed(f"TPDO {k + 1} of type {transmission} comes with a SYNC")
    if not unit.until(lambda: ask(unit, can_id) != before):
        raise CaseFailed(f"TPDO {k + 1} of type {transmission}: an old value after a SYNC")
    return f"TPDO {k + 1}"


@case("T.6")
def both_event_types(unit: Unit) -> str:
    """Types 254 and 255: an event triggers the TPDO."""
    done = []
    for transmission in (254, 255):
        try:
            k, can_id, event = armed(unit, transmission)
        except NotApplicable:
            if transmission == 255:
                raise
            continue
        unit.start()
        unit.pause(unit.timing.quiet_ns)
        unit.flush()
        event.fire_and_see()
        event.need_frame(unit.wait(can_id) is not None, f"TPDO {k + 1} of type {transmission} after an event")
        done.append(str(transmission))
        unit.restore()
        unit.reset()
    return f"types {', '.join(done)}"


@case("T.7")
def while_valid(unit: Unit) -> str:
    """While a TPDO is valid, writes to its identifier, inhibit time and SYNC start value are refused."""
    reason = "no TPDO's COB-ID can be written"
    for k in candidates(unit):
        index = TPDO + k
        if unit.variable(index, 1).access in READ_ONLY:
            continue
        try:
            can_id = arm(unit, k, event_type(unit, k))
        except Unsupported as error:
            reason = str(error)
            continue
        tried = {1: unit.number(index, 1) & ~0x7FF | can_id ^ 0x08, 3: 50, 6: 2}
        done = []
        for subindex, value in tried.items():
            if unit.has(index, subindex) and unit.variable(index, subindex).access not in READ_ONLY:
                unit.refused(index, subindex, value, REFUSED)
                done.append(where(index, subindex))
        return ", ".join(done)
    raise NotApplicable(reason)


@case("T.8")
def wide_identifier(unit: Unit) -> str:
    """Bits 11 to 28 without bit 29 are not a valid identifier, and are refused."""
    for k in candidates(unit):
        index = TPDO + k
        if unit.variable(index, 1).access in READ_ONLY:
            continue
        disable(unit, TPDO, k)
        return f"{unit.refused(index, 1, NO_RTR | 0x1881, REFUSED):08X}h"
    raise NotApplicable("no TPDO's COB-ID can be written")


@case("T.9")
def empty_map(unit: Unit) -> str:
    """A TPDO with count 0 sends nothing, not even a frame without data."""
    k = first(unit, TPDO)
    try:
        can_id = arm(unit, k, 1)
    except Unsupported as reason:
        raise NotApplicable(str(reason)) from None
    cob_id = disable(unit, TPDO, k)
    clear(unit, TPDO + 0x200 + k)
    try:
        unit.write(TPDO + k, 1, cob_id)
    except TransferAborted as abort:
        return f"cannot be made valid: {abort.code:08X}h"
    unit.start()
    unit.flush()
    sync(unit)
    unit.pause(unit.timing.quiet_ns)
    if unit.pop_frames(can_id):
        raise CaseFailed(f"TPDO {k + 1} comes although it maps nothing")
    return f"TPDO {k + 1}"
