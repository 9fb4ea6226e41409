"""Cases 1.0 and 4.1 to 4.9: the file, and every object against it (CiA 306-1; CiA 301, section 7.4)."""

from __future__ import annotations

from coulombus.conformance.cases.sdo import RW, beyond
from coulombus.conformance.tester.deviations import deviation, judge_deviations
from coulombus.conformance.tester.objects import (
    ABSENT_NOW,
    LONGEST,
    NOT_NOW,
    READ_ONLY,
    is_command,
    is_output,
    is_parameter,
)
from coulombus.conformance.tester.registry import case
from coulombus.conformance.tester.running import keeps_own_value, unchanged
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, where
from coulombus.eds.cia301 import ARRAY, VAR, NmtCommand
from coulombus.eds.reader import Variable

NO_WRITE, NO_SCAN = 0x1, 0x2


@case("1.0")
def file(unit: Unit) -> str:
    """Check the diagnoses of the description: errors, and the mandatory objects."""
    problems = [str(diagnosis) for diagnosis in unit.description.diagnoses if diagnosis.severity == "error"]
    problems += [
        f"{where(index, subindex)} is missing, which is mandatory"
        for index, subindex in ((0x1000, 0), (0x1001, 0), (0x1018, 0), (0x1018, 1))
        if not unit.has(index, subindex)
    ]
    if problems:
        raise CaseFailed("; ".join(problems[:5]) + (f"; and {len(problems) - 5} more" if len(problems) > 5 else ""))
    return f"{len(unit.description.objects)} objects, {len(unit.description.diagnoses)} warnings"


@case("4.1", operational=False)
@case("4.7", operational=True)
def readable(unit: Unit, operational: bool) -> str:
    """Read every readable object, and compare its length with its type."""
    if operational:
        unit.start()
    count = 0
    for v in unit.variables(0x1000):
        if v.access == "wo":
            continue
        name = where(v.index, v.subindex)
        try:
            data = unit.sdo.upload_up_to(v.index, v.subindex, LONGEST)
        except TransferAborted as abort:
            if abort.code in NOT_NOW or (v.index == 0x1003 and abort.code in ABSENT_NOW):
                continue
            raise CaseFailed(f"AccessType={v.access}, but {abort}", cause=abort.cause) from None
        if data is not None and v.bits and len(data) != (v.bits + 7) // 8:
            raise CaseFailed(f"{name} has {len(data)} bytes; its type has {v.bits} bits")
        count += 1
    return f"{count} objects"


@case("4.2", defaults=True)
def defaults(unit: Unit) -> str:
    """Reset the node and compare every parameter with its default."""
    unit.reset()
    return _compare(unit, [v for v in unit.variables() if is_parameter(v)])


@case("4.8", defaults=True)
def defaults_by_flags(unit: Unit) -> str:
    """The same after reset communication, for [rw] and [ro] objects whose ObjFlags do not refuse a
    read on scan.
    """
    unit.reset(NmtCommand.RESET_COMMUNICATION)
    variables = [v for v in unit.variables() if is_parameter(v) and v.access in ("rw", "ro")]
    return _compare(unit, [v for v in variables if not unit.flags.get((v.index, v.subindex), 0) & NO_SCAN])


def _compare(unit: Unit, variables: list[Variable]) -> str:
    variables = [v for v in variables if unit.default(v) is not None]
    texts = {(v.index, v.subindex): text for v in variables if (text := deviation(unit, v))}
    remark = judge_deviations(unit, texts)
    return f"{len(variables)} objects" + (f"; {remark}" if remark else "")


@case("4.3")
def write_read_only(unit: Unit) -> str:
    """Write every read-only object with its own value: refused."""
    count = 0
    for v in unit.variables(0x1000):
        if v.access not in READ_ONLY:
            continue
        try:
            data = unit.sdo.upload_up_to(v.index, v.subindex, LONGEST)
        except TransferAborted:
            continue
        unit.refused(v.index, v.subindex, b"\0\0\0\0" if data is None else data)
        count += 1
    if not count:
        raise NotApplicable("the EDS has no read-only object")
    return f"{count} objects"


@case("4.4")
def read_write_only(unit: Unit) -> str:
    """Read every write-only object: refused."""
    variables = [v for v in unit.variables() if v.access == "wo"]
    if not variables:
        raise NotApplicable("the EDS has no write-only object")
    for v in variables:
        try:
            unit.read(v.index, v.subindex)
        except TransferAborted as abort:
            unit.judge(abort)
        else:
            raise CaseFailed(f"{where(v.index, v.subindex)} is write-only and can be read")
    return ", ".join(where(v.index, v.subindex) for v in variables)


@case("4.5")
def structure(unit: Unit) -> str:
    """Read sub-index 255 of every object.

    If it responds, compare the object code and the data type with the EDS.
    """
    count = 0
    for index, entry in sorted(unit.description.objects.items()):
        if index < 0x1000:
            continue
        try:
            data = unit.read(index, 0xFF)
        except TransferAborted:
            if 0xFF in entry.variables:
                raise
            continue
        value = int.from_bytes(data, "little")
        count += 1
        if len(data) != 4 or value & 0xFF != entry.object_type:
            raise CaseFailed(f"{where(index, 0xFF)} is {value:08X}h; the EDS has object type {entry.object_type}")
        element = entry.variables.get(1 if entry.object_type == ARRAY else 0)
        if entry.object_type in (VAR, ARRAY) and element and value >> 8 & 0xFFFF != element.data_type:
            raise CaseFailed(f"{where(index, 0xFF)} is {value:08X}h; the EDS has data type {element.data_type:04X}h")
    if not count:
        raise NotApplicable("no object has sub-index 255")
    return f"{count} objects"


@case("4.6")
def limits(unit: Unit) -> str:
    """Write the values next to the limits of every writable parameter, outputs excepted: refused,
    and nothing changes.
    """
    count = 0
    for v in unit.variables(0x1000):
        if v.access not in RW or is_command(v) or is_output(v):
            continue
        for above in (True, False):
            value = beyond(v, above=above)
            if value is None:
                continue
            before = unit.read(v.index, v.subindex)
            unit.refused(v.index, v.subindex, value)
            unchanged(unit, v, before)
            count += 1
    if not count:
        raise NotApplicable("the EDS gives no harmless writable object a limit inside its type")
    return f"{count} limits"


@case("4.9")
def write_back(unit: Unit) -> str:
    """Write every [rw] parameter with its own value, outputs and commands excepted; ObjFlags bit 0
    exempts too.
    """
    count, refused = 0, 0
    runs: list[str] = []
    for v in unit.variables(0x1000):
        exempt = unit.flags.get((v.index, v.subindex), 0) & NO_WRITE
        if v.access != "rw" or is_command(v) or is_output(v) or exempt:
            continue
        data = unit.sdo.upload_up_to(v.index, v.subindex, LONGEST)
        if data is None:
            continue
        try:
            unit.put(v.index, v.subindex, data)
        except TransferAborted as abort:
            if abort.code not in NOT_NOW:
                raise CaseFailed(f"AccessType={v.access}, but {abort}", cause=abort.cause) from None
            refused += 1
            continue
        if remark := keeps_own_value(unit, v, data):
            runs.append(remark)
        count += 1
    if not count:
        raise NotApplicable("the EDS has no such object")
    state = (f"{refused} refused for the device's state",) if refused else ()
    return "; ".join((f"{count} objects", *runs, *state))
