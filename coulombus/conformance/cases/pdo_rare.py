"""Own cases R.4 to R.10, T.3 to T.9 and M.1: what is rarely tried with PDOs and their maps (CiA
301, 7.2.2, 7.5.2.35 to 38).
"""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.conformance.cases.pdo_data import HARMLESS
from coulombus.conformance.cases.pdo_mapping import clear, first
from coulombus.conformance.tester.objects import READ_ONLY, REFUSED
from coulombus.conformance.tester.pdo_setup import (
    EVENT_TIMER,
    INVALID,
    NO_RTR,
    RPDO,
    TPDO,
    Event,
    Unsupported,
    arm,
    disable,
    event_type,
    fits,
    mappable,
    mapped,
    numbers,
    remappable,
    sync,
)
from coulombus.conformance.tester.pdo_stimuli import candidates
from coulombus.conformance.tester.provoke import emcy_id
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import MS, Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import DATA_TYPES, Abort
from coulombus.eds.reader import Variable
from coulombus.wire.bus_link import RTR

__all__: list[str] = []

CALM_NS = 10 * MS
DEADLINE_MS = 50
WINDOW_MS = 20
DUMMY = 0x0005


class Harmless:
    """An RPDO that carries one object which moves nothing: `send` a value, `value` reads
    what acts.
    """

    def __init__(
        self, unit: Unit, transmission: int, *, deadline_ms: int = 0, gap: Sequence[int] = (), k: int = -1
    ) -> None:
        found = [unit.variable(i) for i in HARMLESS if unit.is_drive and unit.has(i) and unit.variable(i).pdo_mappable]
        if not found or not remappable(unit, RPDO):
            raise NotApplicable("the EDS has no object that an RPDO may carry and that certainly moves nothing")
        self.unit, self.variable = unit, found[0]
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
        if self.value() != value:
            raise CaseFailed(f"{self.name} is {self.value()} {when}, expected {value}")


@case("R.4")
def too_long(unit: Unit) -> str:
    """Send an RPDO of one byte more than is mapped: its first bytes are used.

    An EMCY, if one comes, is 8220h.
    """
    can_id = emcy_id(unit)
    rpdo = Harmless(unit, 255)
    unit.start()
    unit.flush()
    rpdo.send(rpdo.data(11) + b"\xff")
    frames = unit.take(can_id)
    rpdo.expect(11, "after an RPDO with 11 and one byte more")
    if frames and frames[0].data[:2] != b"\x20\x82":
        raise CaseFailed(f"EMCY {frames[0].data[:8].hex(' ')} after an RPDO that is too long, expected 8220h")
    return "EMCY 8220h" if frames else "no EMCY"


@case("R.5")
def too_short(unit: Unit) -> None:
    """Send an RPDO of one byte less than is mapped: its object keeps its value."""
    rpdo = Harmless(unit, 255)
    unit.start()
    rpdo.send(rpdo.data(rpdo.before ^ 1)[:-1])
    rpdo.expect(rpdo.before, "after an RPDO that is too short")


@case("R.6")
def synchronous_types(unit: Unit) -> str:
    """Type 0 of the first RPDO and 240 of the last: two RPDOs before a SYNC act with it, the last
    one.

    Whether one that waits outlives STOPPED is told, not judged: CiA 301 does not say it.
    """
    outlives = False
    for transmission, k in ((0, 0), (240, -1)):
        rpdo = Harmless(unit, transmission, k=k)
        unit.start()
        rpdo.send(rpdo.data(21))
        rpdo.send(rpdo.data(22))
        rpdo.expect(rpdo.before, f"after RPDOs of type {transmission} without a SYNC")
        sync(unit)
        unit.pause(CALM_NS)
        rpdo.expect(22, f"after RPDOs of type {transmission} with 21 and 22 and a SYNC")
        rpdo.send(rpdo.data(23))
        unit.nmt(2)
        unit.start()
        sync(unit)
        unit.pause(CALM_NS)
        if rpdo.value() != 23:
            rpdo.expect(22, "with a SYNC after STOPPED, by an RPDO from before it")
        outlives |= rpdo.value() == 23
        unit.restore()
        unit.reset()
    return "types 0, 240" + ("; an RPDO that waits for a SYNC outlives STOPPED" if outlives else "")


@case("R.7")
def behind_a_dummy(unit: Unit) -> str:
    """Map one byte of a dummy before the object: the value is taken from behind it."""
    if DUMMY not in unit.description.dummies or not fits(unit, DATA_TYPES[DUMMY].bits):
        raise NotApplicable("[DummyUsage] of the EDS has no UNSIGNED8, or its Granularity allows none in a map")
    rpdo = Harmless(unit, 255, gap=[DUMMY << 16 | DATA_TYPES[DUMMY].bits])
    unit.start()
    rpdo.send(b"\xa5" + rpdo.data(31))
    rpdo.expect(31, "after an RPDO with a dummy of one byte and 31")
    return rpdo.name


@case("R.8")
def deadline(unit: Unit) -> str:
    """Give an RPDO a deadline by its event timer, send it in time, then no more: EMCY 8250h, and
    not before the first RPDO.
    """
    can_id = emcy_id(unit)
    rpdo = Harmless(unit, 255, deadline_ms=DEADLINE_MS)
    unit.start()
    unit.flush()
    unit.pause(3 * DEADLINE_MS * MS)
    if unit.take(can_id):
        raise CaseFailed("an EMCY before the first RPDO")
    for _ in range(5):
        rpdo.send(rpdo.data(rpdo.before))
    if unit.take(can_id):
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

    One within the window does.
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
    unit.pause(CALM_NS)
    rpdo.expect(rpdo.before, f"though the RPDO came {3 * WINDOW_MS} ms after its SYNC")
    for _ in range(3):  # the tester may be late itself
        sync(unit)
        unit.send(rpdo.can_id, rpdo.data(42))
        sync(unit)
        unit.pause(CALM_NS)
        if rpdo.value() == 42:
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


def armed(unit: Unit, transmission: int, *, rtr: bool = False) -> tuple[int, int, Event]:
    """Set the first TPDO that can be up, with what an event changes.

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


def ask(unit: Unit, can_id: int) -> bytes | None:
    """Ask for a TPDO by a remote frame; return what comes."""
    unit.flush()
    unit.send(can_id | RTR, length=8)
    frame = unit.wait(can_id, unit.timing.quiet_ns)
    return None if frame is None else frame.data


@case("T.3")
def no_remote_frames(unit: Unit) -> str:
    """With bit 30 of its COB-ID a TPDO answers no remote frame; without it, it did."""
    k, can_id, _ = armed(unit, 253, rtr=True)
    unit.start()
    if ask(unit, can_id) is None:
        raise NotApplicable(f"TPDO {k + 1} answers no remote frame either way")
    unit.nmt(128)
    unit.write(TPDO + k, 1, disable(unit, TPDO, k) | INVALID)
    unit.write(TPDO + k, 1, can_id | NO_RTR)
    unit.start()
    if ask(unit, can_id) is not None:
        raise CaseFailed(f"TPDO {k + 1} answers a remote frame; bit 30 of {where(TPDO + k, 1)} forbids it")
    return f"TPDO {k + 1}"


@case("T.4", transmission=252)
@case("T.5", transmission=253)
def only_on_request(unit: Unit, transmission: int) -> str:
    """Types 252 and 253: no TPDO with a SYNC or an event.

    Asked for, 252 has the sample of the SYNC, 253 the present value.
    """
    k, can_id, event = armed(unit, transmission, rtr=True)
    unit.start()
    sync(unit)
    unit.pause(CALM_NS)
    before = ask(unit, can_id)
    if before is None:
        raise NoAnswer(f"TPDO {k + 1} of type {transmission} does not answer a remote frame")
    unit.flush()
    event.fire_and_see()
    unit.pause(unit.timing.quiet_ns)
    if unit.take(can_id):
        raise CaseFailed(f"TPDO {k + 1} of type {transmission} comes with an event")
    asked = ask(unit, can_id)
    if (asked == before) != (transmission == 252):
        text = "the SYNC's sample has changed without a SYNC" if transmission == 252 else "an old value"
        raise CaseFailed(f"TPDO {k + 1} of type {transmission}: {text}")
    unit.flush()
    sync(unit)
    unit.pause(unit.timing.quiet_ns)
    if unit.take(can_id):
        raise CaseFailed(f"TPDO {k + 1} of type {transmission} comes with a SYNC")
    if ask(unit, can_id) == before:
        raise CaseFailed(f"TPDO {k + 1} of type {transmission}: an old value after a SYNC")
    return f"TPDO {k + 1}"


@case("T.6")
def both_event_types(unit: Unit) -> str:
    """Types 254 and 255: an event makes the TPDO go."""
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
    """As long as a TPDO is valid, its identifier, inhibit time and SYNC start value are refused."""
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
    """Bits 11 to 28 without bit 29 are no identifier, and are refused."""
    for k in candidates(unit):
        index = TPDO + k
        if unit.variable(index, 1).access in READ_ONLY:
            continue
        disable(unit, TPDO, k)
        return f"{unit.refused(index, 1, NO_RTR | 0x1881, REFUSED):08X}h"
    raise NotApplicable("no TPDO's COB-ID can be written")


@case("T.9")
def empty_map(unit: Unit) -> str:
    """A TPDO whose count is 0 sends nothing, not a frame without data either."""
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
    if unit.take(can_id):
        raise CaseFailed(f"TPDO {k + 1} comes although it maps nothing")
    return f"TPDO {k + 1}"


def _widths(unit: Unit, direction: int) -> Variable:
    found = [v for v in mappable(unit, direction) if v.bits >= 16]
    if not found:
        raise NotApplicable("the EDS has no mappable object of two bytes or more")
    return found[0]


@case("M.1")
def wrong_entries(unit: Unit) -> str:
    """Map what is not there, and what is there in another width: refused with the code for it."""
    direction = TPDO if remappable(unit, TPDO) and mappable(unit, TPDO) else RPDO
    k = first(unit, direction)
    index = direction + 0x200 + k
    wide = _widths(unit, direction)
    disable(unit, direction, k)
    clear(unit, index)
    dummy = DUMMY if direction == TPDO and DUMMY in unit.description.dummies else 0
    absent = next(i for i in range(0x5FFF, 0x2000, -1) if i not in unit.description.objects)
    done = []
    for what, word, codes in (
        ("an absent object", absent << 16 | 8, (Abort.NO_OBJECT, Abort.NOT_MAPPABLE, Abort.GENERAL)),
        ("more bits than the object has", mapped(wide) + 8, (Abort.NOT_MAPPABLE, Abort.PDO_LENGTH, Abort.GENERAL)),
        ("1018h:01", 0x10180120, (Abort.NOT_MAPPABLE, Abort.ACCESS, Abort.GENERAL)),
        ("a dummy in a TPDO", DUMMY << 16 | 8, (Abort.NO_OBJECT, Abort.NOT_MAPPABLE, Abort.GENERAL)),
    ):
        if word >> 16 == DUMMY and not dummy:
            continue
        if what == "1018h:01" and (not unit.has(0x1018, 1) or unit.variable(0x1018, 1).pdo_mappable):
            continue
        try:
            unit.put(index, 1, word.to_bytes(4, "little"))
            unit.put(index, 0, b"\1")
        except TransferAborted as abort:
            done.append(f"{what}: {unit.judge(abort, codes):08X}h")
            continue
        raise CaseFailed(f"{where(index, 0)} took a map of {what}")
    return ", ".join(done)
