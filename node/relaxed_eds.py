"""Relax types, limits and defaults of a vendor's EDS that would mislead or block a simulated device.

An EDS file is written by hand. Some types have another sign than CiA's: an unsigned 60FFh would take
-1000 for full speed forwards. Some limits contradict CiA's own range of an object, and some
defaults, which the real device replaces by its stored values, would prevent any torque of the
drive. All are relaxed, and each change is reported. Files of our own devices are not changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from coulombus.eds.cia301 import DATA_TYPES, DataType
from coulombus.eds.description import Description, Object, Variable
from coulombus.eds.drive_axis import first_axis_object, of_axis
from coulombus.eds.drive_scale import defaults, position_scale
from coulombus.eds.own_devices import identity_from_1018h
from coulombus.node import slots402
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC, of_identity
from coulombus.node.profile import Key, Profile

__all__ = ["Opened", "completed", "opened"]

_COB_ID, _CONSUMER, _MAPPED = 0x800007FF, 0x007FFFFF, 0x9FFFFF40
_RANGES: tuple[tuple[range, range, int, str], ...] = (
    (range(0x1014, 0x1015), range(1), _COB_ID, "a COB-ID, whose bit 31 makes it not valid"),
    (range(0x1016, 0x1017), range(1, 128), _CONSUMER, "a node id in bits 16 to 22 and a time in ms"),
    (range(0x1200, 0x1280), range(1, 3), _COB_ID, "a COB-ID, whose bit 31 makes it not valid"),
    (range(0x1400, 0x1600), range(1, 2), _COB_ID, "a COB-ID, whose bit 31 makes it not valid"),
    (range(0x1600, 0x1800), range(1, 65), _MAPPED, "index, sub-index and length of an object"),
    (range(0x1800, 0x1A00), range(1, 2), _COB_ID, "a COB-ID, whose bit 31 makes it not valid"),
    (range(0x1A00, 0x1C00), range(1, 65), _MAPPED, "index, sub-index and length of an object"),
)
"""Objects of CiA 301: indices, sub-indices, the value that each must be able to hold, and its meaning."""

_SIGNED = frozenset((
    *(0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6060, 0x6061, 0x6062, 0x6063, 0x6064, 0x606B, 0x606C),
    *(0x6071, 0x6074, 0x6077, 0x6078, 0x607A, 0x607B, 0x607C, 0x607D, 0x6098, 0x60B0, 0x60B1, 0x60B2),
    *(0x60BA, 0x60BB, 0x60BC, 0x60BD, 0x60C1, 0x60F4, 0x60FF),
))  # fmt: skip
"""Objects of a drive that have a sign (CiA 402), and that the drive's kernels read."""
_WINDOWS, _COMMUNICATION = (0x6065, 0x6067), range(0x1000, 0x2000)
"""Objects without a sign: FFFFFFFFh is no window (CiA 402); those of CiA 301."""
_INTEGERS = {(kind.bits, kind.signed): kind for kind in DATA_TYPES.values() if kind.kind == "int"}

_FASTEST, _FARTHEST, _THREE_TIMES = 0xFFFFFFFF, 0x7FFFFFFF, 3000
_BY_USER = (0x6060, 0x6502)
_OF_THE_DRIVE: Mapping[Key, int] = {
    row.key: row.absent for row in slots402.OBJECTS if row.absent and row.index > 0x5FFF and row.index not in _BY_USER
}
"""Values of a drive whose file lacks the object."""

_NO_TORQUE, _NO_MOTION = "would keep the drive from any torque", "would let it neither move nor arrive"
_BLOCKING: Mapping[Key, tuple[int, str]] = {
    **{(index, 0): (_THREE_TIMES, _NO_TORQUE) for index in (0x6072, 0x6073, 0x60E0, 0x60E1)},
    (0x6080, 0): (_FASTEST, _NO_TORQUE),
    (0x6087, 0): (1_000_000, _NO_TORQUE),
    (0x6065, 0): (_FASTEST, "would make each deviation a fault"),
    (0x6067, 0): (_FASTEST, _NO_MOTION),
    **{
        (index, subindex): (_OF_THE_DRIVE[index, subindex], _NO_MOTION)
        for index, subindex in (
            *((0x607F, 0), (0x6081, 0), (0x6083, 0), (0x6084, 0), (0x6085, 0)),
            *((0x6099, 1), (0x6099, 2), (0x609A, 0)),
        )
    },
}
"""Objects that disable a drive while they are 0, their replacement values, and why."""

_SERVO = 0x00020192

_POSITIONS = ((0x607D, 1), -_FARTHEST - 1), ((0x607D, 2), _FARTHEST)
_MODES: tuple[tuple[int, int], ...] = (
    (0x6071, 1 << 3 | 1 << 9),
    (0x607A, 1 << 0 | 1 << 7),
    (0x6098, 1 << 5),
    (0x60C1, 1 << 6),
    (0x60FF, 1 << 2 | 1 << 8),
)
"""Set-points, and the bits of 6502h of their modes: 4 and 10, 1 and 8, 6, 7, 3 and 9."""


@dataclass(frozen=True)
class Opened:
    """Relaxed description for a stand-in, and a line for each change."""

    description: Description
    remarks: tuple[str, ...] = ()


def opened(description: Description, profile: Profile, counts_rev: int = 0, axis: int = 1) -> Opened:
    """Return the relaxed description of a file that is simulated with `profile`.

    Parameters
    ----------
    counts_rev : counts of the position in one turn of the motor, for a file that does not state
        them; 0: unknown
    axis : of a drive of several axes
    """
    if profile is GENERIC or of_identity(identity_from_1018h(description)) is not GENERIC:
        return Opened(description)
    signed = _with_signs(description, profile)
    description = signed.description
    changed: dict[Key, Variable] = {}
    remarks = [*signed.remarks, *_limits(description, changed)]
    if profile.behaviour is DRIVE402.behaviour:
        remarks += _defaults(description, changed, axis)
        remarks += _encoder(description, changed, counts_rev, axis)
    return _changed(description, changed, remarks)


def completed(description: Description, profile: Profile) -> Opened:
    """Return the description of a device without a rig, with CiA's signs, and for a drive with the defaults that its
    file lacks: those of a drive without these objects. Nobody else writes them before it is used.
    """
    signed = _with_signs(description, profile)
    description, remarks = signed.description, [*signed.remarks]
    changed: dict[Key, Variable] = {}
    if profile.behaviour is DRIVE402.behaviour:
        for key, value in {(0x1000, 0): _SERVO, **_OF_THE_DRIVE}.items():
            variable = _variable(description, key)
            if variable is not None and variable.default is None and not variable.unreadable:
                changed[key] = _with(variable, value)
        labels = [f"{_label(variable)} as {variable.default!r}" for variable in changed.values()]
        if labels:
            text = "without a default in the file, served with the drive's own"
            remarks.append(f"{description.path}: {text}: {', '.join(labels)}")
    return _changed(description, changed, remarks)


def _changed(description: Description, changed: Mapping[Key, Variable], remarks: Sequence[str]) -> Opened:
    if not changed:
        return Opened(description, tuple(remarks))
    objects = dict(description.objects)
    for (index, subindex), variable in changed.items():
        entry: Object = objects[index]
        objects[index] = replace(entry, variables={**entry.variables, subindex: variable})
    return Opened(replace(description, objects=objects), tuple(remarks))


def _with_signs(description: Description, profile: Profile) -> Opened:
    """Give each integer of another maker's file the sign of CiA's type: the bytes on the bus stay."""
    if of_identity(identity_from_1018h(description)) is not GENERIC:
        return Opened(description)
    changed: dict[Key, Variable] = {}
    labels: dict[tuple[DataType, DataType], list[str]] = {}
    for index, entry in description.objects.items():
        number = first_axis_object(index) if profile.behaviour is DRIVE402.behaviour else 0
        signed = number in _SIGNED
        if not signed and number not in _WINDOWS and index not in _COMMUNICATION:
            continue
        for subindex, variable in entry.variables.items():
            kind, is_count = DATA_TYPES.get(variable.data_type), subindex == 0 and len(entry.variables) > 1
            if kind is None or kind.kind != "int" or kind.signed == signed or is_count:
                continue
            meant = _INTEGERS[kind.bits, signed]
            changed[index, subindex] = _of_type(variable, meant)
            labels.setdefault((kind, meant), []).append(_label(variable))
    remarks = [
        f"{description.path}: {_first_of(names)} {'is' if len(names) == 1 else 'are'} {kind.name} in the file, "
        f"{'signed' if meant.signed else 'unsigned'} at CiA; served as {meant.name}"
        for (kind, meant), names in labels.items()
    ]
    return _changed(description, changed, remarks)


def _of_type(variable: Variable, kind: DataType) -> Variable:
    """Return the variable with another integer type of the same width, and the limits that it can hold."""
    typed = replace(variable, data_type=kind.code)
    lowest, highest = typed.whole or (0, 0)
    low, high = variable.low, variable.high
    if isinstance(variable.default, int):
        typed = replace(typed, default=(variable.default - lowest) % (1 << kind.bits) + lowest)
    return replace(
        typed,
        low=low if low and lowest < low <= highest else None,
        high=high if high is not None and lowest <= high <= highest else None,
    )


def _limits(description: Description, changed: dict[Key, Variable]) -> Iterator[str]:
    for indices, subindices, needed, what in _RANGES:
        labels: list[str] = []
        highest: int | float = 0
        for index in indices:
            entry = description.objects.get(index)
            for subindex in subindices if entry is not None else ():
                variable = entry.variables.get(subindex) if entry is not None else None
                if variable is None or variable.high is None or variable.largest >= needed or variable.bits < 32:
                    continue
                changed[index, subindex] = replace(variable, high=None)
                labels.append(_label(variable))
                highest = variable.high
        if labels:
            yield (
                f"{description.path}: {_first_of(labels)} has the HighLimit {highest}, but is {what} (CiA 301); "
                "served without that limit"
            )


def _defaults(description: Description, changed: dict[Key, Variable], axis: int) -> Iterator[str]:
    positions = [((of_axis(index, axis), subindex), value) for (index, subindex), value in _POSITIONS]
    limits = [_variable(description, key) for key, _ in positions]
    lowest, highest = (limit.default if limit and isinstance(limit.default, int) else 0 for limit in limits)
    if lowest > highest or (any(limits) and lowest == highest == 0):
        for (key, value), variable in zip(positions, limits, strict=True):
            if variable is not None:
                changed[key] = _with(variable, value)
        yield _remark(
            description,
            f"{positions[0][0][0]:04X}h",
            "0 on both sides" if lowest == highest else f"{lowest} to {highest}",
            "the whole range",
            _NO_TORQUE,
        )
    for (index, subindex), (value, why) in _BLOCKING.items():
        key = of_axis(index, axis), subindex
        variable = _variable(description, key)
        if variable is not None and not variable.default and not variable.node_relative:
            changed[key] = _with(variable, value)
            served = str(changed[key].default)
            yield _remark(description, _label(variable), _stands(variable), served, why)
    supported = of_axis(0x6502, axis), 0
    modes = _variable(description, supported)
    if modes is not None and not modes.default:
        offered = sum(bits for index, bits in _MODES if description.has(of_axis(index, axis)))
        if offered:
            changed[supported] = _with(modes, offered)
            numbers = ", ".join(str(k + 1) for k in range(16) if offered >> k & 1)
            yield _remark(description, _label(modes), _stands(modes), f"the modes {numbers}", "would allow no mode")


def _encoder(description: Description, changed: dict[Key, Variable], counts_rev: int, axis: int) -> Iterator[str]:
    """Let 608Fh state the counts of the position if no object of the file does."""
    index = of_axis(0x608F, axis)
    increments, turns = (_variable(description, (index, sub)) for sub in (1, 2))
    if not counts_rev or increments is None or position_scale(defaults(description, axis)).counts_rev is not None:
        return
    changed[index, 1] = _with(increments, counts_rev)
    if turns is not None and turns.default != 1:
        changed[index, 2] = _with(turns, 1)
    served, why = str(changed[index, 1].default), "tells no encoder"
    yield _remark(description, _label(increments), _stands(increments), served, why)


def _variable(description: Description, key: Key) -> Variable | None:
    return description.variable(*key) if description.has(*key) else None


def _with(variable: Variable, value: int) -> Variable:
    """Return the variable with a default within its type and limits."""
    lowest, highest = variable.whole or (-_FARTHEST - 1, _FASTEST)
    lowest = max(lowest, int(variable.low)) if variable.low is not None else lowest
    return replace(variable, default=max(lowest, min(value, highest, int(min(variable.largest, 1 << 63)))))


def _stands(variable: Variable) -> str:
    return "without a default" if variable.default is None else str(variable.default)


def _remark(description: Description, label: str, stands: str, served: str, why: str) -> str:
    return f"{description.path}: {label} is {stands} in the file, which {why}; served as {served}"


def _first_of(labels: Sequence[str]) -> str:
    return labels[0] + (f" and {len(labels) - 1} more" if len(labels) > 1 else "")


def _label(variable: Variable) -> str:
    return f"{variable.index:04X}h" + (f":{variable.subindex:02X}" if variable.subindex else "")
