"""Set up PDOs for the cases, and cause events over the bus alone (CiA 301, sections 7.2.2 and 7.5.2.35 to 38)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from coulombus.conformance.tester.unit import MS, OPERATIONAL, STOPPED, Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import CobId, NmtState
from coulombus.eds.data import READ_ONLY
from coulombus.eds.reader import Variable

__all__ = [
    "CONSUMER_MS",
    "EVENT_TIMER",
    "INHIBIT_TIME",
    "INVALID",
    "NO_SYNC_TPDO",
    "READABLE",
    "RPDO",
    "SYNC_START",
    "TPDO",
    "WRITABLE",
    "Event",
    "HeartbeatOfTester",
    "Unsupported",
    "arm",
    "enter",
    "event_type",
    "fits",
    "length_of",
    "mappable",
    "mapped",
    "numbers",
    "remap",
    "remappable",
    "sync",
    "words_of",
]

INVALID, NO_RTR, EXTENDED = 1 << 31, 1 << 30, 1 << 29
RPDO, TPDO = 0x1400, 0x1800
"""First communication parameter of each direction; its map is at +200h."""
TRANSMISSION, INHIBIT_TIME, EVENT_TIMER, SYNC_START = 2, 3, 5, 6
"""Sub-indices of a communication parameter: type, 100 us, ms, value of the SYNC counter."""
NO_SYNC_TPDO = "no TPDO comes with a SYNC"
"""Common cause of failures of a device that ignores SYNC."""
DEFAULTS: Mapping[int, int] = MappingProxyType({})

MOST = 4
"""Maximum number of PDOs tested per direction, the first of the EDS."""

CONSUMER_MS = 60
READABLE, WRITABLE = ("ro", "rw", "rwr", "const"), ("rw", "rww", "wo")
_DEFAULT_ID = {
    RPDO: (CobId.RPDO1, CobId.RPDO2, CobId.RPDO3, CobId.RPDO4),
    TPDO: (CobId.TPDO1, CobId.TPDO2, CobId.TPDO3, CobId.TPDO4),
}


class Unsupported(Exception):
    """The set-up of a PDO is not supported; another PDO may support it."""


def numbers(unit: Unit, direction: int) -> list[int]:
    """Return the numbers (from 0) of the EDS's PDOs that have a map, at most `MOST`."""
    pdo_numbers = [i - direction for i in unit.description.objects if direction <= i < direction + 0x200]
    return sorted(k for k in pdo_numbers if unit.has(direction + k, 1) and unit.has(direction + 0x200 + k, 0))[:MOST]


def words_of(unit: Unit, direction: int, k: int) -> list[int]:
    """Return the entries of the present map."""
    index = direction + 0x200 + k
    return [unit.number(index, sub) for sub in range(1, unit.number(index, 0) + 1)]


def length_of(unit: Unit, direction: int, k: int) -> int:
    """Return the data bytes of the present map."""
    return (sum(word & 0xFF for word in words_of(unit, direction, k)) + 7) // 8


def mapped(variable: Variable) -> int:
    """Return the mapping word of a variable."""
    return variable.index << 16 | variable.subindex << 8 | variable.bits


def mappable(unit: Unit, direction: int) -> list[Variable]:
    """Return the variables of fixed width that may be mapped in a direction."""
    access = WRITABLE if direction == RPDO else READABLE
    return [v for v in unit.variables() if v.pdo_mappable and v.access in access and fits(unit, v.bits)]


def fits(unit: Unit, bits: int) -> bool:
    """Return whether an entry of a map may have this many bits, by [DeviceInfo] Granularity."""
    return 0 < bits <= 64 and unit.granularity > 0 and bits % unit.granularity == 0


def remappable(unit: Unit, direction: int) -> list[int]:
    """Return the PDOs whose map may be written, by the EDS; empty if its Granularity is 0."""
    if not unit.granularity:
        return []
    return [
        k
        for k in numbers(unit, direction)
        if unit.has(direction + 0x200 + k, 1)
        and all(
            v.access not in READ_ONLY
            for sub, v in unit.description.objects[direction + 0x200 + k].variables.items()
            if sub < 0xFF
        )
        and unit.variable(direction + k, 1).access not in READ_ONLY
    ]


def disable(unit: Unit, direction: int, k: int) -> int:
    """Make the PDO invalid and return its previous COB-ID."""
    cob_id = unit.number(direction + k, 1)
    if not cob_id & INVALID:
        unit.write(direction + k, 1, cob_id | INVALID)
    return cob_id


def remap(unit: Unit, direction: int, k: int, words: Sequence[int]) -> None:
    """Remap an invalid PDO: count 0, entries, count."""
    index = direction + 0x200 + k
    for sub in range(1, len(words) + 1):
        if not unit.has(index, sub):
            raise Unsupported(f"{where(index, sub)} is not in the EDS")
    before = unit.read(index, 0)
    unit.put(index, 0, b"\0")
    unit.undo_later(index, 0, before)
    for sub, word in enumerate(words, 1):
        unit.write(index, sub, word)
    unit.put(index, 0, bytes((len(words),)))
    unit.undo_later(index, 0, b"\0")


def can_id_of(unit: Unit, direction: int, k: int, cob_id: int) -> int:
    """Return the 11-bit identifier of a COB-ID, else the pre-defined one."""
    if cob_id & EXTENDED:
        raise Unsupported(f"{where(direction + k, 1)} has a 29-bit identifier")
    if cob_id & 0x7FF:
        return cob_id & 0x7FF
    if k >= len(_DEFAULT_ID[direction]):
        raise Unsupported(f"{where(direction + k, 1)} has no identifier")
    return _DEFAULT_ID[direction][k] + unit.node_id


def still(unit: Unit) -> None:
    """Stop the device's own SYNC: only the tester's count."""
    if unit.has(0x1006) and unit.variable(0x1006).access not in READ_ONLY and unit.number(0x1006):
        unit.write(0x1006, 0, 0)


def write_overflow(unit: Unit, value: int) -> None:
    """Write 1019h; CiA 301 permits changes only while 1006h is 0."""
    still(unit)
    unit.write(0x1019, 0, value)


def arm(
    unit: Unit,
    k: int,
    transmission: int | None,
    *,
    entries: Mapping[int, int] = DEFAULTS,
    rtr: bool = False,
    words: Sequence[int] = (),
    direction: int = TPDO,
) -> int:
    """Set a PDO up and make it valid; return its identifier.

    Parameters
    ----------
    transmission : type (sub-index 2); None: the device's own
    entries : values of further sub-indices: `EVENT_TIMER`, `INHIBIT_TIME`, `SYNC_START`

    Raises
    ------
    Unsupported
        The EDS or the device does not allow this of this PDO.
    """
    still(unit)
    index = direction + k
    untimed = {INHIBIT_TIME: 0, EVENT_TIMER: 0} if direction == TPDO else {EVENT_TIMER: 0}
    parameters = {TRANSMISSION: transmission, **untimed, **entries}
    fixed = unit.variable(index, 1).access in READ_ONLY
    cob_id = unit.number(index, 1) if fixed else disable(unit, direction, k)
    can_id = can_id_of(unit, direction, k, cob_id)
    if fixed and (cob_id & INVALID or (rtr and cob_id & NO_RTR)):
        raise Unsupported(f"{where(index, 1)} is fixed at {cob_id:08X}h")
    if words and words_of(unit, direction, k) != list(words):
        remap(unit, direction, k, words)
    for subindex, value in parameters.items():
        if value is None or (not unit.has(index, subindex) and not value):
            continue
        if not unit.has(index, subindex):
            raise Unsupported(f"the EDS has no {where(index, subindex)}")
        if unit.number(index, subindex) == value:
            continue
        if unit.variable(index, subindex).access in READ_ONLY:
            raise Unsupported(f"{where(index, subindex)} is fixed in the EDS")
        try:
            unit.write(index, subindex, value)
        except TransferAborted as abort:
            raise Unsupported(str(abort)) from None
    if not length_of(unit, direction, k):
        raise Unsupported(f"{where(direction + 0x200 + k, 0)} maps nothing")
    if not fixed:
        valid = can_id | (cob_id & NO_RTR if not rtr else 0)
        try:
            unit.write(index, 1, valid)
        except TransferAborted as abort:
            if not rtr:
                raise CaseFailed(f"a PDO cannot be made valid: {abort}") from None
            raise Unsupported(f"RTR is refused: {abort}") from None
        if rtr and unit.number(index, 1) & NO_RTR:
            raise Unsupported(f"{where(index, 1)} keeps bit 30: no RTR")
    return can_id


def event_type(unit: Unit, k: int) -> int:
    """Return the event-driven transmission type that a TPDO has, else 255."""
    present = unit.number(TPDO + k, 2)
    return present if present >= 254 else 255


def sync(unit: Unit, counter: int | None = None) -> None:
    """Send a SYNC, with a counter if given."""
    unit.dirty = True
    unit.send(unit.sync_id, b"" if counter is None else bytes((counter,)))


def enter(unit: Unit, state: NmtState) -> None:
    """Send the command that leads to a state."""
    unit.nmt({OPERATIONAL: 1, STOPPED: 2}.get(state, 128))


class HeartbeatOfTester:
    """A heartbeat that the device monitors: its loss is the only harmless error that can be caused over any bus.

    Raises
    ------
    NotApplicable
        It monitors no heartbeat.
    """

    def __init__(self, unit: Unit, consumer_ms: int = CONSUMER_MS) -> None:
        subs = unit.description.objects[0x1016].variables if 0x1016 in unit.description.objects else {}
        free = [s for s, v in subs.items() if 0 < s < 0xFF and v.access not in (*READ_ONLY, "wo")]
        if not free:
            raise NotApplicable("the EDS has no 1016h that can be written: no error can be caused over the bus")
        self.unit, self.consumer_ms = unit, consumer_ms
        self.producer = 126 if unit.node_id != 126 else 125
        self.subindex = free[0]
        if unit.has(0x1029, 1) and unit.variable(0x1029, 1).access == "rw":
            unit.write(0x1029, 1, 1)  # else the device leaves OPERATIONAL by itself
        unit.write(0x1016, self.subindex, self.producer << 16 | consumer_ms)

    def beat(self) -> None:
        """Send one heartbeat."""
        self.unit.send(CobId.HEARTBEAT + self.producer, bytes((NmtState.OPERATIONAL,)))

    def lose(self) -> None:
        """Send one heartbeat and wait until the next is overdue."""
        self.beat()
        self.unit.pause(self.consumer_ms * MS + self.unit.timing.quiet_ns)


class Event:
    """A change of an object in TPDO `k`: the statusword by the controlword in a drive, else the error register.

    The drive alternates between Switch On Disabled and Ready To Switch On, so its power stage stays off.
    """

    def __init__(self, unit: Unit, k: int) -> None:
        self.unit, self.k = unit, k
        self.word = mapped(unit.variable(0x6041) if unit.is_drive else unit.need(0x1001))
        self.possible, self.why = self._possible()
        self.times = 2 if unit.is_drive else 1  # a heartbeat can be lost only once
        self._heartbeat: HeartbeatOfTester | None = None
        self._commands = 0

    def _possible(self) -> tuple[bool, str]:
        if self.word in words_of(self.unit, TPDO, self.k):
            return True, ""
        index = self.word >> 16
        if self.k not in remappable(self.unit, TPDO):
            return False, f"TPDO {self.k + 1} has a fixed map without {where(index, 0)}"
        if not self.unit.variable(index).pdo_mappable or not fits(self.unit, self.word & 0xFF):
            return False, f"{where(index, 0)} cannot be mapped"
        return True, ""

    def _leaves_operational(self) -> bool:
        unit = self.unit
        return not unit.has(0x1029, 1) or unit.variable(0x1029, 1).access != "rw"

    def prepare(self) -> tuple[int, ...]:
        """Return the map that shows the event; empty to keep the present map.

        Call it in PRE-OPERATIONAL.
        """
        if not self.possible:
            return ()
        if not self.unit.is_drive and self._leaves_operational():
            self.possible, self.why = False, "without 1029h a lost heartbeat ends OPERATIONAL"
            return ()
        try:
            self._heartbeat = HeartbeatOfTester(self.unit)
        except NotApplicable as reason:
            if not self.unit.is_drive:
                self.possible, self.why = False, str(reason)
                return ()
        return (self.word,) if self.k in remappable(self.unit, TPDO) and fits(self.unit, self.word & 0xFF) else ()

    def fire_and_see(self) -> None:
        """Cause one change in OPERATIONAL.

        Raises
        ------
        NotApplicable
            The mapped object has not changed, so there was no event.
        """
        index, subindex = self.word >> 16, self.word >> 8 & 0xFF
        before = self.unit.read(index, subindex)
        self.fire()
        if not self.unit.until(lambda: self.unit.read(index, subindex) != before):
            raise NotApplicable(f"no event can be caused over the bus: {where(index, subindex)} does not change")

    def need_frame(self, came: bool, what: str) -> None:
        """Fail if a change triggered no TPDO, provided it is an event of the device's profile.

        CiA 301 leaves the definition of events to the profile and the manufacturer (section
        7.5.2.37). A change of a drive's statusword in its TPDO is an event of CiA 402; a change of
        another device's error register may not be.
        """
        if came:
            return
        if self.unit.is_drive:
            raise NoAnswer(f"no {what}")
        place = where(self.word >> 16, self.word >> 8 & 0xFF)
        raise NotApplicable(f"no {what}: a change of {place} is no event here, which is left to the device")

    def fire(self, state: NmtState = OPERATIONAL) -> None:
        """Cause one change."""
        if not self.possible:
            return
        if self.unit.is_drive and state != STOPPED:
            self._commands += 1
            if self._commands == 1:
                self.unit.undo_later(0x6040, 0, b"\0\0")
            self.unit.put(0x6040, 0, b"\x06\0" if self._commands & 1 else b"\0\0")
        elif self._heartbeat is not None:
            self._commands += 1
            if self.unit.is_drive or self._commands & 1:
                self._heartbeat.lose()
            else:
                self._heartbeat.beat()
