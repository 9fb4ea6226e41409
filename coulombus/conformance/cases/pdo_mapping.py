"""Cases 3.21 to 3.33 and M.1: maps and remapping (CiA 301, sections 7.5.2.36 and 7.5.2.38)."""

from __future__ import annotations

from coulombus.conformance.tester.objects import NOT_NOW
from coulombus.conformance.tester.pdo_setup import (
    INVALID,
    NO_SYNC_TPDO,
    READABLE,
    RPDO,
    TPDO,
    WRITABLE,
    Unsupported,
    arm,
    disable,
    fits,
    length_of,
    mappable,
    mapped,
    numbers,
    remap,
    remappable,
    sync,
    words_of,
)
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, left_open, where
from coulombus.eds.cia301 import DATA_TYPES, DUMMY_TYPES, Abort
from coulombus.eds.reader import Variable

_NAME = {RPDO: "RPDO", TPDO: "TPDO"}
_OUTPUT, _INPUT = ("rww", "wo"), ("rwr", "ro")
DUMMY = 0x0005


def first(unit: Unit, direction: int) -> int:
    """Return the first PDO whose map can be written."""
    pdo_numbers = remappable(unit, direction)
    if not pdo_numbers:
        raise NotApplicable(f"the EDS has no {_NAME[direction]} whose map and COB-ID can be written")
    return pdo_numbers[0]


def either(unit: Unit) -> tuple[int, int]:
    """Return direction and number of a PDO whose map can be written, preferably a TPDO."""
    for direction in (TPDO, RPDO):
        if remappable(unit, direction) and mappable(unit, direction):
            return direction, remappable(unit, direction)[0]
    raise NotApplicable("the EDS has no PDO whose map and COB-ID can be written")


@case("3.21")
def default_maps(unit: Unit) -> str:
    """Read every map and check each entry with the EDS: it exists, is mappable in this direction
    and has this width; at most 64 bits in all.
    """
    entries = 0
    for direction, access in ((RPDO, WRITABLE), (TPDO, READABLE)):
        for k in numbers(unit, direction):
            words = words_of(unit, direction, k)
            for word in words:
                _check_entry(unit, f"{_NAME[direction]} {k + 1}", word, access, dummy=direction == RPDO)
            if sum(word & 0xFF for word in words) > 64:
                raise CaseFailed(f"{_NAME[direction]} {k + 1} maps more than 64 bits")
            entries += len(words)
    if not entries:
        raise NotApplicable("no PDO maps anything by default")
    return f"{entries} entries"


def _check_entry(unit: Unit, pdo: str, word: int, access: tuple[str, ...], *, dummy: bool) -> None:
    index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
    if dummy and index in DUMMY_TYPES:
        if bits != DATA_TYPES[index].bits:
            raise CaseFailed(f"{pdo} maps the dummy {index:04X}h in {bits} bits")
        return
    if not unit.has(index, subindex):
        raise CaseFailed(f"{pdo} maps {where(index, subindex)}, which is not in the EDS")
    variable = unit.variable(index, subindex)
    if not variable.pdo_mappable or variable.access not in access:
        mapping = int(variable.pdo_mappable)
        raise CaseFailed(f"{pdo} maps {where(index, subindex)}: AccessType={variable.access}, PDOMapping={mapping}")
    if variable.bits and bits > (variable.bits + 7) // 8 * 8:
        raise CaseFailed(f"{pdo} maps {where(index, subindex)} in {bits} bits; it has {variable.bits}")
    if "r" in variable.access or variable.access == "const":
        try:
            unit.read(index, subindex)
        except TransferAborted as abort:
            if abort.code not in NOT_NOW:
                raise


def other_map(unit: Unit, direction: int, k: int) -> list[int]:
    """Return a valid map other than the present one."""
    present = words_of(unit, direction, k)
    words: list[int] = []
    for variable in sorted(mappable(unit, direction), key=lambda v: v.bits, reverse=True):
        bits = sum(word & 0xFF for word in words) + variable.bits
        if variable.bits >= 8 and bits <= 64 and unit.has(direction + 0x200 + k, len(words) + 1) and len(words) < 3:
            words.append(mapped(variable))
    if words == present:
        words = words[::-1] if len(words) > 1 and words[::-1] != present else words[:-1]
    if not words:
        raise NotApplicable(f"the EDS has not enough objects that can be mapped into a {_NAME[direction]}")
    return words


@case("3.22")
def procedure(unit: Unit) -> str:
    """Remap the first PDOs in the prescribed order, read it back, and count the TPDO's
    bytes on the bus.
    """
    done = []
    reason = "the EDS has no PDO whose map and COB-ID can be written"
    for direction in (RPDO, TPDO):
        if not remappable(unit, direction) or not mappable(unit, direction):
            continue
        k = first(unit, direction)
        try:
            words = other_map(unit, direction, k)
            disable(unit, direction, k)
            remap(unit, direction, k, words)
        except (NotApplicable, Unsupported) as error:
            reason = str(error)
            continue
        if words_of(unit, direction, k) != words:
            raise CaseFailed(f"{_NAME[direction]} {k + 1}: the map that was written does not read back")
        done.append(f"{_NAME[direction]} {k + 1}")
        if direction == TPDO:
            _send_once(unit, k)
    if not done:
        raise NotApplicable(reason)
    return ", ".join(done)


def _send_once(unit: Unit, k: int) -> None:
    try:
        can_id = arm(unit, k, 1)
    except Unsupported:
        return
    length = length_of(unit, TPDO, k)
    unit.start()
    unit.flush()
    sync(unit)
    frame = unit.expect(can_id, f"TPDO {k + 1} with its new map after a SYNC", cause=NO_SYNC_TPDO)
    if frame.length != length:
        raise CaseFailed(f"TPDO {k + 1} has {frame.length} bytes; its new map has {length}")


@case("3.23")
def without_clearing(unit: Unit) -> str:
    """Write an entry of an invalid PDO's map while its count is not 0: it is refused."""
    direction, k = either(unit)
    disable(unit, direction, k)
    index = direction + 0x200 + k
    words = other_map(unit, direction, k)
    if not words_of(unit, direction, k):
        try:
            remap(unit, direction, k, words)
        except Unsupported as reason:
            raise NotApplicable(str(reason)) from None
    present = words_of(unit, direction, k)[0]
    word = next((mapped(v) for v in mappable(unit, direction) if mapped(v) != present), None)
    if word is None:
        raise NotApplicable("the EDS has only one object that can be mapped")
    code = unit.refused(index, 1, word)
    return f"{code:08X}h"


@case("3.24")
def while_valid(unit: Unit) -> str:
    """Remap a valid PDO without making it invalid: a step is refused, and the map stays."""
    direction, k = either(unit)
    index = direction + 0x200 + k
    try:
        arm(
            unit,
            k,
            None,
            words=() if words_of(unit, direction, k) else other_map(unit, direction, k),
            direction=direction,
        )
    except Unsupported as reason:
        raise NotApplicable(str(reason)) from None
    present = words_of(unit, direction, k)
    words = other_map(unit, direction, k)
    try:
        remap(unit, direction, k, words)
    except TransferAborted as abort:
        return f"{abort.code:08X}h"
    if words_of(unit, direction, k) == words != present:
        raise CaseFailed(f"{where(index, 0)}: a valid PDO took another map")
    raise CaseFailed(f"{where(index, 0)}: a map was acknowledged for a valid PDO but is not there")


@case("3.25")
def too_many(unit: Unit) -> str:
    """Fill all entries with the smallest object and write a count one above their number."""
    direction, k = either(unit)
    index = direction + 0x200 + k
    entries = sum(1 for sub in unit.description.objects[index].variables if 0 < sub < 0xFF)
    smallest = min((v for v in mappable(unit, direction)), key=lambda v: v.bits)
    filled = min(entries, 64 // smallest.bits)
    disable(unit, direction, k)
    clear(unit, index)
    for sub in range(1, filled + 1):
        unit.write(index, sub, mapped(smallest))
    count = entries + 1 if entries < 0xFE else 0xFE
    try:
        unit.put(index, 0, bytes((count,)))
    except TransferAborted as abort:
        return f"count {count}: {_judge_count(unit, abort, index, count)}"
    raise CaseFailed(f"{where(index, 0)} took {count}; it has {entries} entries")


def _judge_count(unit: Unit, abort: TransferAborted, index: int, count: int) -> str:
    """Return the code of a refused count, with a remark if it says "not this value": the EDS's
    limit of the count is exceeded, too, and CiA 301 does not define which code takes precedence.
    """
    limits = unit.range_codes(index, 0, bytes((count,)))
    code = f"{unit.judge(abort, (*unit.codes, *limits)):08X}h"
    if abort.code in limits and abort.subindex == 0:
        return f"{code}; {left_open('which code refuses a count above its HighLimit', 'CiA 301, table 22')}"
    return code


def clear(unit: Unit, index: int) -> None:
    """Set a map's count to 0 for the duration of the case."""
    before = unit.read(index, 0)
    unit.put(index, 0, b"\0")
    unit.undo_later(index, 0, before)
    unit.undo_later(index, 0, b"\0")


@case("3.26")
def too_long(unit: Unit) -> str:
    """Map the widest object until 64 bits are exceeded: an entry or the count is refused."""
    for direction in (TPDO, RPDO):
        if not remappable(unit, direction) or not mappable(unit, direction):
            continue
        k = first(unit, direction)
        index = direction + 0x200 + k
        widest = max(mappable(unit, direction), key=lambda v: v.bits)
        count = 64 // widest.bits + 1
        if not unit.has(index, count):
            continue
        disable(unit, direction, k)
        clear(unit, index)
        try:
            for sub in range(1, count + 1):
                unit.write(index, sub, mapped(widest))
            unit.put(index, 0, bytes((count,)))
        except TransferAborted as abort:
            return f"{count} times {widest.bits} bits: {_judge_count(unit, abort, index, count)}"
        raise CaseFailed(f"{where(index, 0)} took a map of {count * widest.bits} bits")
    raise NotApplicable("no PDO whose map can be written has entries for more than 64 bits")


@case("3.27", direction=RPDO, access=_OUTPUT, accepted=True)
@case("3.28", direction=RPDO, access=_INPUT, accepted=False)
@case("3.30", direction=TPDO, access=_INPUT, accepted=True)
@case("3.31", direction=TPDO, access=_OUTPUT, accepted=False)
def map_one(unit: Unit, direction: int, access: tuple[str, ...], accepted: bool) -> str:
    """Map a single object of this access type: accepted, or refused at the entry or at the count."""
    variables = [v for v in unit.variables() if v.pdo_mappable and v.access in access and fits(unit, v.bits)]
    if not variables:
        raise NotApplicable(f"the EDS has no mappable object of access {' or '.join(access)}")
    return _map_one(unit, direction, variables, accepted=accepted)


@case("3.29", direction=RPDO)
@case("3.32", direction=TPDO)
def map_unmappable(unit: Unit, direction: int) -> str:
    """Map an object without PDOMapping but with a suitable access type: it is refused."""
    access = WRITABLE if direction == RPDO else READABLE
    variables = [v for v in unit.variables() if not v.pdo_mappable and v.access in access and 0 < v.bits <= 64]
    if not variables:
        raise NotApplicable("the EDS has no such object without PDOMapping")
    return _map_one(unit, direction, variables, accepted=False)


def _map_one(unit: Unit, direction: int, variables: list[Variable], *, accepted: bool) -> str:
    k = first(unit, direction)
    index = direction + 0x200 + k
    disable(unit, direction, k)
    clear(unit, index)
    tried = variables[:1] + unit.random.sample(variables, min(2, len(variables)))
    for variable in dict.fromkeys(tried):
        try:
            unit.put(index, 0, b"\0")
            unit.write(index, 1, mapped(variable))
            unit.put(index, 0, b"\1")
        except TransferAborted as abort:
            if accepted:
                raise CaseFailed(f"{where(variable.index, variable.subindex)} cannot be mapped: {abort}") from None
            continue
        name = f"{where(variable.index, variable.subindex)} (AccessType={variable.access})"
        if not accepted:
            raise CaseFailed(f"{name} was mapped into {_NAME[direction]} {k + 1}")
        if words_of(unit, direction, k) != [mapped(variable)]:
            raise CaseFailed(f"{name}: the map does not read back")
    return ", ".join(where(v.index, v.subindex) for v in dict.fromkeys(tried))


@case("3.33")
def dummies(unit: Unit) -> str:
    """Map every dummy type of the EDS into an RPDO, before an object, and read the map back."""
    types = sorted(code for code in unit.description.dummies if code in DATA_TYPES)
    if not types:
        raise NotApplicable("[DummyUsage] of the EDS has none")
    k = first(unit, RPDO)
    objects = mappable(unit, RPDO)
    disable(unit, RPDO, k)
    for code in types:
        bits = DATA_TYPES[code].bits
        if not fits(unit, bits):
            continue
        words = [code << 16 | bits]
        if objects and bits % 8 == 0 and bits + objects[0].bits <= 64 and unit.has(RPDO + 0x200 + k, 2):
            words.append(mapped(objects[0]))
        remap(unit, RPDO, k, words)
        if words_of(unit, RPDO, k) != words:
            raise CaseFailed(f"dummy {code:04X}h: the map does not read back")
    if unit.number(RPDO + k, 1) & INVALID == 0:
        raise CaseFailed(f"{where(RPDO + k, 1)} became valid by itself")
    return ", ".join(f"{code:04X}h" for code in types)


def _widths(unit: Unit, direction: int) -> Variable:
    variables = [v for v in mappable(unit, direction) if v.bits >= 16]
    if not variables:
        raise NotApplicable("the EDS has no mappable object of two bytes or more")
    return variables[0]


@case("M.1")
def wrong_entries(unit: Unit) -> str:
    """Map an absent object, and an object with another width: refused with the specified code."""
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
