"""Cause an error over the bus alone, and get the device's EMCY: three methods, the mildest first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

from coulombus.conformance.tester.pdo_setup import (
    EXTENDED,
    INVALID,
    RPDO,
    HeartbeatOfTester,
    Unsupported,
    arm,
    length_of,
    numbers,
)
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, LeftOpen, NotApplicable
from coulombus.eds.cia301 import CobId, NmtState
from coulombus.wire.bus_link import RTR, BusFrame

__all__ = [
    "EMCY_IS_OPTIONAL",
    "GUARD_MS",
    "after_lost_heartbeat",
    "cause_error",
    "check_emcy",
    "emcy_id",
    "must_be_noticed",
    "short_rpdo",
]

GUARD_MS = 100
_HEARTBEAT_MS = 20
EMCY_IS_OPTIONAL = "CiA 301, 7.2.7 and 7.2.8.2.2: a heartbeat or life guarding event need not be an EMCY"
_SHORT_RPDO = "a short RPDO"


def emcy_id(unit: Unit) -> int:
    """Return the identifier of the device's EMCY.

    If 1014h is invalid, or has 29 bits, the case does not apply.
    """
    unit.need(0x1014)
    cob_id = unit.number(0x1014)
    if cob_id & (INVALID | EXTENDED):
        raise NotApplicable(f"1014h is {cob_id:08X}h: no EMCY of 11 bits")
    return cob_id & 0x7FF


def _by_heartbeat(unit: Unit) -> Callable[[], None]:
    heartbeat = HeartbeatOfTester(unit)
    return heartbeat.lose


def _by_life_guarding(unit: Unit) -> Callable[[], None]:
    unit.need_writable(0x100C)
    unit.need_writable(0x100D)
    if unit.has(0x1017) and unit.number(0x1017):
        unit.write(0x1017, 0, 0)
    unit.write(0x100C, 0, GUARD_MS)
    unit.write(0x100D, 0, 2)

    def lose() -> None:
        unit.send(CobId.HEARTBEAT + unit.node_id | RTR, length=1)
        unit.pause(2 * GUARD_MS * MS + unit.timing.quiet_ns)

    return lose


def short_rpdo(unit: Unit) -> Callable[[], None]:
    """Set an RPDO up, start the node, and return a function that sends it one byte short, all zeros: set-points are 0."""
    for k in numbers(unit, RPDO):
        length = length_of(unit, RPDO, k)
        with suppress(Unsupported):
            can_id = arm(unit, k, 255, direction=RPDO)
            unit.start()

            def send(can_id: int = can_id, length: int = length) -> None:
                unit.send(can_id, bytes(length - 1))

            return send
    raise NotApplicable("the EDS has no RPDO that can be used")


_WAYS = (("a lost heartbeat", _by_heartbeat), ("life guarding", _by_life_guarding), (_SHORT_RPDO, short_rpdo))


def _ways(unit: Unit) -> Iterator[tuple[str, Callable[[], None]]]:
    for name, prepare in _WAYS:
        try:
            yield name, prepare(unit)
        except NotApplicable:
            continue


def after_lost_heartbeat(unit: Unit, can_id: int) -> BusFrame:
    """Return the EMCY after a lost heartbeat; without one, the case is left open."""
    frame = unit.wait(can_id)
    if frame is None:
        limit_ms = unit.timing.answer_ns / 1e6
        raise LeftOpen(f"no EMCY ({can_id:03X}h) within {limit_ms:.0f} ms after a lost heartbeat", EMCY_IS_OPTIONAL)
    return frame


def must_be_noticed(unit: Unit, event: str, cause: Callable[[], None]) -> None:
    """Judge a device that sends no EMCY after a communication error.

    1029h:01 = 0 must then make it leave OPERATIONAL.

    Raises
    ------
    LeftOpen
        It does, or it has no 1029h.
    CaseFailed
        It does not: the error is not detected at all.
    """
    text = f"no EMCY after {event}"
    if unit.has(0x1029, 1) and unit.variable(0x1029, 1).access == "rw":
        unit.write(0x1029, 1, 0)
        unit.start()
        if unit.state() is None and unit.has(0x1017) and unit.variable(0x1017).access == "rw":
            unit.write(0x1017, 0, _HEARTBEAT_MS)
        if unit.state() is None:
            raise LeftOpen(text, EMCY_IS_OPTIONAL)
        cause()
        if unit.until(lambda: unit.state() != NmtState.OPERATIONAL):
            text += ", which the device notices: it leaves OPERATIONAL"
        else:
            text = f"neither an EMCY after {event}, nor does the device leave OPERATIONAL though 1029h:01 is 0"
            raise CaseFailed(text, clause="CiA 301, 7.5.2.32")
    raise LeftOpen(text, EMCY_IS_OPTIONAL)


def cause_error(unit: Unit) -> tuple[str, BusFrame]:
    """Cause an error; return the method, and the EMCY received.

    Raises
    ------
    NotApplicable
        The EDS offers no way to cause an error.
    LeftOpen
        No EMCY came after a lost heartbeat or life guarding, and no RPDO can be sent too short.
    CaseFailed
        No EMCY came after a short RPDO.
    """
    can_id = emcy_id(unit)
    tried = []
    for name, act in _ways(unit):
        unit.flush()
        act()
        frame = unit.wait(can_id)
        tried.append(name)
        if frame is not None:
            check_emcy(unit, frame)
            return name, frame
        unit.restore()
    if not tried:
        raise NotApplicable("the EDS has neither 1016h nor guarding nor RPDOs: no error can be caused over the bus")
    text = f"no EMCY ({can_id:03X}h) after {', '.join(tried)}"
    if _SHORT_RPDO not in tried:
        raise LeftOpen(text, EMCY_IS_OPTIONAL)
    raise CaseFailed(text, cause="no EMCY after an RPDO that is too short", clause="CiA 301, 7.2.2 and 7.2.7")


def check_emcy(unit: Unit, frame: BusFrame) -> None:
    """Fail unless an EMCY of an error is well formed."""
    if frame.length != 8 or frame.can_id & RTR:
        raise CaseFailed(f"an EMCY has {frame.length} bytes, expected 8")
    code = int.from_bytes(frame.data[:2], "little")
    if code == 0:
        raise CaseFailed("the EMCY of an error has error code 0000h")
    if not frame.data[2] & 0x01:
        raise CaseFailed(f"the EMCY's error register is {frame.data[2]:02X}h: the generic error's bit is missing")
