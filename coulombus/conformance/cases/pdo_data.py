"""Own cases R.1 to R.3, T.1 and T.2: data of RPDOs, inhibit time, reserved transmission types."""

from __future__ import annotations

from coulombus.conformance.tester.objects import REFUSED
from coulombus.conformance.tester.pdo_setup import (
    EVENT_TIMER,
    INHIBIT_TIME,
    RPDO,
    Unsupported,
    arm,
    event_type,
    length_of,
    mapped,
    numbers,
    remappable,
    sync,
)
from coulombus.conformance.tester.pdo_stimuli import candidates
from coulombus.conformance.tester.provoke import emcy_id
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, where
from coulombus.wire.bus_link import BusFrame

__all__: list[str] = []

HARMLESS = (0x6087, 0x60E0, 0x60E1, 0x6072)
"""Objects of a drive that a PDO may carry and that move nothing while its power stage is off."""

INHIBIT_MS, TIMER_MS = 100, 20


def harmless(unit: Unit, transmission: int) -> tuple[int, int, int, bytes]:
    """Map one harmless object alone into an RPDO.

    Return identifier, object, another value, and its bytes.
    """
    found = [unit.variable(i) for i in HARMLESS if unit.is_drive and unit.has(i) and unit.variable(i).pdo_mappable]
    if not found:
        raise NotApplicable("the EDS has no object that an RPDO may carry and that certainly moves nothing")
    if not remappable(unit, RPDO):
        raise NotApplicable("the EDS has no RPDO whose map can be written")
    variable = found[0]
    unit.undo_later(variable.index, 0, unit.read(variable.index, 0))
    k = remappable(unit, RPDO)[-1]
    try:
        can_id = arm(unit, k, transmission, direction=RPDO, words=[mapped(variable)])
    except Unsupported as reason:
        raise NotApplicable(str(reason)) from None
    present = unit.number(variable.index)
    value = present - 1 if present > 1 else present + 1
    return can_id, variable.index, value, encode(variable, value)


@case("R.1")
def rpdo_data(unit: Unit) -> str:
    """Send an RPDO of type 255: its object has the value.

    Of type 1: after the next SYNC, not before.
    """
    can_id, index, value, data = harmless(unit, 255)
    unit.start()
    unit.send(can_id, data)
    unit.pause(10 * MS)
    if unit.number(index) != value:
        raise CaseFailed(f"{where(index, 0)} is {unit.number(index)} after an RPDO with {value}")
    unit.restore()
    unit.reset()
    can_id, index, value, data = harmless(unit, 1)
    unit.start()
    unit.send(can_id, data)
    unit.pause(10 * MS)
    if unit.number(index) == value:
        raise CaseFailed(f"{where(index, 0)}: a synchronous RPDO acts before the SYNC")
    sync(unit)
    unit.pause(10 * MS)
    if unit.number(index) != value:
        raise CaseFailed(f"{where(index, 0)} is {unit.number(index)} after a synchronous RPDO with {value} and a SYNC")
    return where(index, 0)


@case("R.2")
def rpdo_pre_operational(unit: Unit) -> str:
    """Send an RPDO in PRE-OPERATIONAL: its object keeps its value, also after the start."""
    can_id, index, _, data = harmless(unit, 255)
    before = unit.number(index)
    unit.send(can_id, data)
    unit.pause(10 * MS)
    unit.start()
    unit.pause(10 * MS)
    if unit.number(index) != before:
        raise CaseFailed(f"{where(index, 0)} has changed by an RPDO in PRE-OPERATIONAL")
    return where(index, 0)


@case("R.3")
def rpdo_too_short(unit: Unit) -> str:
    """Send the first RPDO with one byte too few, all zeros: EMCY 8210h."""
    can_id = emcy_id(unit)
    reason = "the EDS has no RPDO"
    for k in numbers(unit, RPDO):
        try:
            rpdo = arm(unit, k, 255, direction=RPDO)
        except Unsupported as error:
            reason = str(error)
            continue
        length = length_of(unit, RPDO, k)
        unit.start()
        unit.flush()
        unit.send(rpdo, bytes(length - 1))
        frame: BusFrame = unit.expect(can_id, "EMCY after an RPDO that is too short")
        if frame.data[:2] != b"\x10\x82":
            raise CaseFailed(f"EMCY {int.from_bytes(frame.data[:2], 'little'):04X}h after a short RPDO, expected 8210h")
        return f"RPDO {k + 1}"
    raise NotApplicable(reason)


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
        if unit.variable(index, 2).access not in ("ro", "const") and unit.variable(index, 1).access == "rw":
            cob_id = unit.number(index, 1)
            if not cob_id & 1 << 31:
                unit.write(index, 1, cob_id | 1 << 31)
            refused = [unit.refused(index, 2, encode(unit.variable(index, 2), kind), REFUSED) for kind in (241, 251)]
            return ", ".join(f"{code:08X}h" for code in refused)
    raise NotApplicable("no TPDO's transmission type can be written")
