"""Own cases R.1 to R.10: RPDOs, their data, lengths, transmission types, deadline and window.

Source: CiA 301, 7.2.2, 7.5.2.35 and 36.
"""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.conformance.cases.pdo_mapping import DUMMY
from coulombus.conformance.tester.objects import READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import (
    EVENT_TIMER,
    RPDO,
    Unsupported,
    arm,
    disable,
    fits,
    length_of,
    mapped,
    numbers,
    remappable,
    sync,
)
from coulombus.conformance.tester.provoke import emcy_id
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import DATA_TYPES
from coulombus.wire.bus_link import BusFrame

__all__: list[str] = []

HARMLESS = (0x6087, 0x60E0, 0x60E1, 0x6072)
"""Mappable objects of a drive that move nothing while its power stage is off."""

CALM_NS = 10 * MS
NO_EFFECT = "an RPDO does not act on its object"
DEADLINE_MS = 50
WINDOW_MS = 20


def harmless(unit: Unit, transmission: int) -> tuple[int, int, int, bytes]:
    """Map a single harmless object into an RPDO.

    Return identifier, object, another value, and its bytes.
    """
    variables = [unit.variable(i) for i in HARMLESS if unit.is_drive and unit.has(i) and unit.variable(i).pdo_mappable]
    if not variables:
        raise NotApplicable("the EDS has no object that an RPDO may carry and that certainly moves nothing")
    if not remappable(unit, RPDO):
        raise NotApplicable("the EDS has no RPDO whose map can be written")
    variable = variables[0]
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
    """Send an RPDO of type 255: its object takes the value.

    Of type 1: after the next SYNC, not before.
    """
    can_id, index, value, data = harmless(unit, 255)
    unit.start()
    unit.send(can_id, data)
    if not unit.until(lambda: unit.number(index) == value):
        raise CaseFailed(f"{where(index, 0)} is {unit.number(index)} after an RPDO with {value}", cause=NO_EFFECT)
    unit.restore()
    unit.reset()
    can_id, index, value, data = harmless(unit, 1)
    unit.start()
    unit.send(can_id, data)
    unit.pause(unit.timing.quiet_ns)
    if unit.number(index) == value:
        raise CaseFailed(f"{where(index, 0)}: a synchronous RPDO acts before the SYNC")
    sync(unit)
    if not unit.until(lambda: unit.number(index) == value):
        raise CaseFailed(f"{where(index, 0)} is {unit.number(index)} after a synchronous RPDO with {value} and a SYNC")
    return where(index, 0)


@case("R.2")
def rpdo_pre_operational(unit: Unit) -> str:
    """Send an RPDO in PRE-OPERATIONAL: its object keeps its value, also after the start."""
    can_id, index, _, data = harmless(unit, 255)
    before = unit.number(index)
    unit.send(can_id, data)
    unit.pause(unit.timing.quiet_ns)
    unit.start()
    unit.pause(unit.timing.quiet_ns)
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


class Harmless:
    """An RPDO with one object that moves nothing: `send` sends a value, `value` reads the active value."""

    def __init__(
        self, unit: Unit, transmission: int, *, deadline_ms: int = 0, gap: Sequence[int] = (), k: int = -1
    ) -> None:
        variables = [
            unit.variable(i) for i in HARMLESS if unit.is_drive and unit.has(i) and unit.variable(i).pdo_mappable
        ]
        if not variables or not remappable(unit, RPDO):
            raise NotApplicable("the EDS has no object that an RPDO may carry and that certainly moves nothing")
        self.unit, self.variable = unit, variables[0]
        unit.undo_later(self.variable.index, 0, unit.read(self.variable.index, 0))
        words = [*gap, mapped(self.variable)]
        number = remappable(unit, RPDO)[k]
        try:
            self.can_id = arm(
                unit, number, transmission, direction=RPDO, words=words, entries={EVENT_TIMER: deadline_ms}
            )
        except Unsupported as reason:
            raise NotApplicable(str(reason)) from None
        self.before = self.value()
        self.name = where(self.variable.index, 0)

    def data(self, value: int) -> bytes:
        return encode(self.variable, value)

    def send(self, data: bytes) -> None:
        self.unit.send(self.can_id, data)
        self.unit.pause(CALM_NS)

    def value(self) -> int:
        return self.unit.number(self.variable.index)

    def expect(self, value: int, when: str) -> None:
        """Fail unless the object gets this value in time."""
        if not self.unit.until(lambda: self.value() == value):
            cause = NO_EFFECT if self.value() == self.before else ""
            raise CaseFailed(f"{self.name} is {self.value()} {when}, expected {value}", cause=cause)


@case("R.4")
def too_long(unit: Unit) -> str:
    """Send an RPDO with one byte more than mapped: its first bytes are used.

    An EMCY, if one comes, is 8220h.
    """
    can_id = emcy_id(unit)
    rpdo = Harmless(unit, 255)
    unit.start()
    unit.flush()
    rpdo.send(rpdo.data(11) + b"\xff")
    unit.pause(unit.timing.quiet_ns)
    frames = unit.pop_frames(can_id)
    rpdo.expect(11, "after an RPDO with 11 and one byte more")
    if frames and frames[0].data[:2] != b"\x20\x82":
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} after an RPDO that is too long, expected 8220h")
    return "EMCY 8220h" if frames else "no EMCY"


@case("R.5")
def too_short(unit: Unit) -> None:
    """Send an RPDO with one byte less than mapped: its object keeps its value."""
    rpdo = Harmless(unit, 255)
    unit.start()
    rpdo.send(rpdo.data(rpdo.before ^ 1)[:-1])
    unit.pause(unit.timing.quiet_ns)
    rpdo.expect(rpdo.before, "after an RPDO that is too short")


@case("R.6")
def synchronous_types(unit: Unit) -> str:
    """Type 0 of the first RPDO and 240 of the last: of two RPDOs before a SYNC, the last one acts with it.

    Whether a pending RPDO survives STOPPED is reported, not judged: CiA 301 does not define it.
    """
    outlives = False
    for transmission, k in ((0, 0), (240, -1)):
        rpdo = Harmless(unit, transmission, k=k)
        unit.start()
        rpdo.send(rpdo.data(21))
        rpdo.send(rpdo.data(22))
        unit.pause(unit.timing.quiet_ns)
        rpdo.expect(rpdo.before, f"after RPDOs of type {transmission} without a SYNC")
        sync(unit)
        rpdo.expect(22, f"after RPDOs of type {transmission} with 21 and 22 and a SYNC")
        rpdo.send(rpdo.data(23))
        unit.nmt(2)
        unit.start()
        sync(unit)
        unit.pause(unit.timing.quiet_ns)
        if rpdo.value() != 23:
            rpdo.expect(22, "with a SYNC after STOPPED, by an RPDO from before it")
        outlives |= rpdo.value() == 23
        unit.restore()
        unit.reset()
    return "types 0, 240" + ("; an RPDO that waits for a SYNC outlives STOPPED" if outlives else "")


@case("R.7")
def behind_a_dummy(unit: Unit) -> str:
    """Map one byte of a dummy before the object: the value is read after it."""
    if DUMMY not in unit.description.dummies or not fits(unit, DATA_TYPES[DUMMY].bits):
        raise NotApplicable("[DummyUsage] of the EDS has no UNSIGNED8, or its Granularity allows none in a map")
    rpdo = Harmless(unit, 255, gap=[DUMMY << 16 | DATA_TYPES[DUMMY].bits])
    unit.start()
    rpdo.send(b"\xa5" + rpdo.data(31))
    rpdo.expect(31, "after an RPDO with a dummy of one byte and 31")
    return rpdo.name


@case("R.8")
def deadline(unit: Unit) -> str:
    """Set the deadline of an RPDO by its event timer, send it in time, then stop: EMCY 8250h, and
    not before the first RPDO.
    """
    can_id = emcy_id(unit)
    rpdo = Harmless(unit, 255, deadline_ms=DEADLINE_MS)
    unit.start()
    unit.flush()
    unit.pause(3 * DEADLINE_MS * MS)
    if unit.pop_frames(can_id):
        raise CaseFailed("an EMCY before the first RPDO")
    for _ in range(5):
        rpdo.send(rpdo.data(rpdo.before))
    if unit.pop_frames(can_id):
        raise CaseFailed("an EMCY although the RPDO is in time")
    frame = unit.wait(can_id)
    if frame is None:
        raise NotApplicable("no EMCY comes: the event timer is no deadline here, which is allowed")
    if frame.data[:2] != b"\x50\x82":
        raise CaseFailed(f"EMCY {frame.data[:8].hex(' ')} after the RPDO's deadline, expected 8250h")
    return f"{DEADLINE_MS} ms"


@case("R.9")
def window(unit: Unit) -> str:
    """With 1007h at 20 ms, a synchronous RPDO 60 ms after the SYNC acts on no SYNC.

    An RPDO within the window does.
    """
    unit.need_writable(0x1007)
    rpdo = Harmless(unit, 1)
    try:
        unit.write(0x1007, 0, WINDOW_MS * 1000)
    except TransferAborted as abort:
        raise NotApplicable(str(abort)) from None
    unit.start()
    sync(unit)
    unit.pause(3 * WINDOW_MS * MS)
    rpdo.send(rpdo.data(41))
    sync(unit)
    unit.pause(unit.timing.quiet_ns)
    rpdo.expect(rpdo.before, f"though the RPDO came {3 * WINDOW_MS} ms after its SYNC")
    for _ in range(3):  # the tester may be late itself
        sync(unit)
        unit.send(rpdo.can_id, rpdo.data(42))
        sync(unit)
        if unit.until(lambda: rpdo.value() == 42):
            return f"{WINDOW_MS} ms"
    raise CaseFailed(f"{rpdo.name} is {rpdo.value()}: an RPDO within the window does not act")


@case("R.10")
def reserved_types(unit: Unit) -> str:
    """Write 241, 252 and 253 to an RPDO's transmission type, made invalid first: refused."""
    for k in numbers(unit, RPDO):
        if any(unit.variable(RPDO + k, sub).access in READ_ONLY for sub in (1, 2)):
            continue
        disable(unit, RPDO, k)
        return ", ".join(f"{unit.refused(RPDO + k, 2, kind, REFUSED):08X}h" for kind in (241, 252, 253))
    raise NotApplicable("no RPDO's transmission type can be written")
