"""Allocate roles to PDOs, within the mappings that each device's EDS file allows.

1. A PDO that can be neither remapped nor made invalid, and carries only roles, is used as it is.
2. Remappable PDOs take the remaining roles in the order of their numbers, those that cannot be made
   invalid last: at most 64 bits, and as many entries as the EDS file has sub-indices. Statusword and
   position stay together if they fit, and so do a controlword and its set-point.
3. The rest is searched in the PDOs that cannot be remapped. Further entries of a TPDO are ignored;
   those of an RPDO are sent with the value that bring-up set, or the EDS file's default.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from coulombus.eds.cia402 import OPERATION_MODE_CST as CST
from coulombus.eds.cia402 import OPERATION_MODE_PROFILE_TORQUE as PROFILE_TORQUE
from coulombus.eds.drive_axis import of_axis
from coulombus.eds.pdo import COMMUNICATION, PDO_BITS, Entry, PdoLayout
from coulombus.eds.reader import Description
from coulombus.rigs.deadman_object import bind_switch
from coulombus.rigs.devices import Brake, Motor, drive_axis_of
from coulombus.rigs.errors import Problem
from coulombus.rigs.model import to_ns
from coulombus.rigs.pdo_records import ON_SYNC, PdoParameters, records_of, writable
from coulombus.rigs.roles import Binding, Bound, bind
from coulombus.rigs.signals import ConstantEntry, Direction, Node, Parts, RigPdo, Signal

__all__ = ["MOST_CONSTANTS", "MOST_PDOS", "AxisPdos", "allocate", "mode_of", "writable"]

MODE, SUPPORTED_MODES = 0x6060, 0x6502
MOST_PDOS, MOST_CONSTANTS = 8, 16
"""Sizes of the host's tables: PDOs of an axis in each direction, entries of RPDOs that it does not command."""
TOGETHER = (("controlword", "torque_setpoint"), ("statusword", "position"), ("brake_controlword", "brake_setpoint"))
"""Roles that are read or commanded together, and stay in one PDO where they fit."""


@dataclass(frozen=True)
class AxisPdos:
    """The PDOs of an axis, its bound roles, and the problems with them."""

    bound: Bound
    pdos: tuple[RigPdo, ...]
    losses: tuple[str, ...]
    problems: tuple[Problem, ...]


def allocate(parts: Parts, prefix: str = "") -> AxisPdos:
    """Return the PDOs of an axis; incomplete if there are `problems`.

    Parameters
    ----------
    prefix : of the axis' node and signal names
    """
    bound = bind(parts)
    problems, losses, bindings = [*bound.problems], [*bound.losses], [*bound.bindings]
    try:
        switch = bind_switch(parts, bindings)
    except ValueError as error:
        problems.append(Problem("deadman", "host", "", f"an input that a device can send, but {error}", ""))
    else:
        bindings += [switch] if switch is not None else []
    pdos: list[RigPdo] = []
    absent: set[str] = set()
    for node in parts.devices:
        for direction in ("rpdo", "tpdo"):
            of_node = [binding for binding in bindings if binding.node == node and binding.kind.direction == direction]
            device = _DevicePdos(parts, node, direction, prefix)
            pdos += device.fill(of_node)
            absent |= device.absent
            problems += device.problems
            losses += device.losses
    problems += [*_shared(pdos), *_too_many(pdos), *_ambiguous(parts, bound)]
    mapped = tuple(binding for binding in bound.bindings if binding.kind.name not in absent)
    return AxisPdos(replace(bound, bindings=mapped), tuple(pdos), tuple(losses), tuple(problems))


def _too_many(pdos: Sequence[RigPdo]) -> Iterator[Problem]:
    for direction in ("rpdo", "tpdo"):
        number = sum(pdo.layout.direction == direction for pdo in pdos)
        if number > MOST_PDOS:
            text = f"the roles need {number} {direction.upper()}s of an axis; the host has room for {MOST_PDOS}"
            yield Problem("", pdos[0].device, "", text, "take devices whose PDOs can be mapped anew, or fewer roles")
    constants = sum(len(pdo.constants) for pdo in pdos)
    if constants > MOST_CONSTANTS:
        text = f"the RPDOs carry {constants} objects beside the roles; the host has room for {MOST_CONSTANTS}"
        yield Problem("", pdos[0].device, "", text, "take devices whose PDOs can be mapped anew")


def _shared(pdos: Sequence[RigPdo]) -> Iterator[Problem]:
    owners: dict[int, RigPdo] = {}
    for pdo in pdos:
        first = owners.setdefault(pdo.layout.cob_id, pdo)
        if first is not pdo and first.node_id != pdo.node_id:  # duplicate node ids are reported elsewhere
            text = (
                f"{pdo.name} of {pdo.node} has the identifier {pdo.layout.cob_id:03X}h of {first.name} of {first.node}"
            )
            yield Problem("", pdo.device, "", text, "give one of the devices another node id")


def _ambiguous(parts: Parts, bound: Bound) -> Iterator[Problem]:
    """Refuse an encoder whose counts wrap too soon to tell a jump from a wrap."""
    position = bound.get("position")
    if position is None or position.entry.bits > 31:
        return
    half, limits = 1 << (position.entry.bits - 1), parts.limits
    if limits.encoder_jump_counts * limits.missed_tpdo_cycles >= half:
        text = (
            f"a position of {position.entry.bits} bits wraps after {2 * half} counts, and limits.encoder_jump_counts x "
            f"limits.missed_tpdo_cycles is {limits.encoder_jump_counts * limits.missed_tpdo_cycles}"
        )
        yield Problem("position", position.node, "", text, f"expected less than {half}: lower one of them")


class _DevicePdos:
    """The PDOs of one device in one direction, while they are filled."""

    def __init__(self, parts: Parts, node: Node, direction: Direction, prefix: str) -> None:
        self.parts, self.node, self.direction, self.prefix = parts, node, direction, prefix
        self.part, self.description = parts.part(node), parts.description(node)
        self.problems: list[Problem] = []
        self.losses: list[str] = []
        self.absent: set[str] = set()
        """Optional roles without a place in a PDO."""

    def fill(self, bindings: Sequence[Binding]) -> list[RigPdo]:
        """Return the PDOs that carry `bindings`, by their numbers.

        Entries without a place are noted in `problems`.
        """
        if not bindings:
            return []
        transmission = ON_SYNC if self.direction == "tpdo" else self.parts.bus.transmission
        period_ns = self.parts.bus.period_ns
        records = records_of(
            self.description, self.part.node_id, self.direction, period_ns, transmission, drive_axis_of(self.part)
        )
        standing = [record for record in records if record.entries and not (record.room and record.settable)]
        left = {binding.place[1:]: binding for binding in bindings}
        filled: dict[int, tuple[PdoParameters, tuple[Entry, ...]]] = {}

        def take(record: PdoParameters, entries: Iterable[Entry]) -> None:
            filled[record.number] = record, tuple(entries)
            for entry in filled[record.number][1]:
                left.pop((entry.index, entry.subindex), None)

        for record in standing:
            if all(_carries(entry, left) for entry in record.entries):
                take(record, record.entries)
        free = [record for record in records if record.room and record.number not in filled]
        free.sort(key=lambda record: not record.settable)
        for record, entries in _first_fit(free, _groups(left.values())):
            take(record, entries)
        others = [record for record in standing if not record.room and record.number not in filled]
        while left and others:
            best = max(others, key=lambda record: sum(_carries(entry, left) for entry in record.entries))
            others.remove(best)
            if any(_carries(entry, left) for entry in best.entries):
                take(best, best.entries)
        for binding in left.values():
            self._no_place(binding, bool(records))
        roles = {binding.place[1:]: binding for binding in bindings}
        return [self._pdo(*filled[number], roles) for number in sorted(filled)]

    def _no_place(self, binding: Binding, any_pdo: bool) -> None:
        way = "an RPDO" if self.direction == "rpdo" else "a TPDO"
        label = f"{binding.entry.index:04X}h:{binding.entry.subindex:X}"
        reason = f"no PDO can be mapped with it, and none has it by default, in {binding.entry.bits} bits"
        if not any_pdo:
            reason = f"the file describes no {self.direction.upper()} that can be used"
        if not binding.kind.needed and getattr(self.parts.role, binding.kind.name, None) is None:
            self.absent.add(binding.kind.name)
            self.losses.append(f"{binding.kind.lost} ({label} of {self.prefix}{self.node} finds no place in {way})")
            return
        where = f"{self.description.path}:{self.description.variable(*binding.place[1:]).line}"
        text = f"{where}: {label} finds no place in {way}: {reason}"
        optional = "" if binding.kind.needed else f', or leave the role out: [role.{binding.kind.name}] object = "none"'
        self.problems.append(
            Problem(binding.kind.name, self.node, label, text, f"take a device that can send it{optional}")
        )

    def _pdo(
        self, record: PdoParameters, entries: tuple[Entry, ...], roles: Mapping[tuple[int, int], Binding]
    ) -> RigPdo:
        receive = self.direction == "rpdo"
        event_ns = record.event_ns
        if receive:
            event_ns = (
                to_ns(self.part.setpoint_fault_s) if isinstance(self.part, Motor | Brake) and record.deadline else 0
            )
        name = f"{self.direction.upper()}{record.number}"
        layout = PdoLayout(
            number=record.number,
            direction=self.direction,
            cob_id=record.identifier,
            transmission=record.transmission,
            inhibit_ns=0,
            event_ns=event_ns,
            sync_start=0,
            rtr_allowed=not record.no_rtr,
            entries=entries,
        )
        mine = [roles[entry.index, entry.subindex] for entry in entries if (entry.index, entry.subindex) in roles]
        if not receive and record.transmission != ON_SYNC:
            self._timed(record, name, mine)
        constants = tuple(self._constants(name, entries, roles)) if receive else ()
        signals = tuple(self._signal(entry, place, roles) for place, entry in enumerate(entries))
        stands = not record.room or (not record.settable and entries == record.entries)
        if not stands and not record.settable:
            self.losses.append(
                f"{self.prefix}{self.node}: {name} is mapped while it is valid, as its identifier is read-only"
            )
        return RigPdo(self.prefix + self.node, self.part.node_id, layout, signals, fixed=stands, constants=constants)

    def _where(self, record: PdoParameters) -> str:
        """Return the place of a PDO's transmission type in the EDS file."""
        index = COMMUNICATION[self.direction] + record.number - 1
        subindex = 2 if self.description.has(index, 2) else 1
        return f"{self.description.path}:{self.description.variable(index, subindex).line}"

    def _timed(self, record: PdoParameters, name: str, mine: Sequence[Binding]) -> None:
        """Note that a TPDO does not follow SYNC.

        Refuse it if it is too rare for its roles.
        """
        cycles = record.transmission if 0 < record.transmission <= 240 else 0
        every_ns = cycles * self.parts.bus.period_ns if cycles else record.event_ns
        what = f"transmission type {record.transmission}"
        longest = self.parts.limits.missed_tpdo_cycles * self.parts.bus.period_ns
        if not 0 < every_ns <= longest:
            often = f"every {every_ns / 1e6:g} ms" if every_ns else "only when something changes"
            text = (
                f"{self._where(record)}: {name} of the {self.node} cannot follow each SYNC ({what}) and is sent {often}; "
                f"limits.missed_tpdo_cycles allow {longest / 1e6:g} ms"
            )
            self.problems.append(
                Problem(
                    mine[0].kind.name, self.node, "", text, "raise limits.missed_tpdo_cycles, or take another device"
                )
            )
            return
        self.losses.append(
            f"{self.prefix}{self.node}: {name} does not follow SYNC ({what}); it is sent every {every_ns / 1e6:g} ms by the device's own "
            f"clock, and lost after limits.missed_tpdo_cycles"
        )

    def _constants(
        self, name: str, entries: Sequence[Entry], roles: Mapping[tuple[int, int], Binding]
    ) -> Iterator[ConstantEntry]:
        for entry in entries:
            place = (entry.index, entry.subindex)
            if entry.dummy or place in roles:
                continue
            value, why = self._standing(*place)
            label = f"{entry.index:04X}h:{entry.subindex:X}"
            self.losses.append(
                f"{self.prefix}{self.node}: {name} carries {label} too, which is sent as {value} ({why})"
            )
            yield ConstantEntry(*place, value)

    def _standing(self, index: int, subindex: int) -> tuple[int, str]:
        """Return the constant value of an RPDO entry, and the reason."""
        written = [write.value for write in self.part.sdo if (write.index, write.sub) == (index, subindex)]
        if written:
            return written[-1], f"[[{self.node}.sdo]]"
        mode = of_axis(MODE, drive_axis_of(self.part)), 0
        if (index, subindex) == mode and isinstance(self.part, Motor | Brake):
            return mode_of(self.part, self.description), "the mode of operation"
        default = self.description.default(index, subindex, self.part.node_id)
        return (default, "the EDS file's default") if isinstance(default, int) else (0, "the EDS file has no default")

    def _signal(self, entry: Entry, place: int, roles: Mapping[tuple[int, int], Binding]) -> Signal:
        binding = roles.get((entry.index, entry.subindex))
        if binding is None:
            label = f"gap{place}" if entry.dummy else f"{entry.index:04X}h_{entry.subindex}"
            return Signal(f"{self.prefix}{self.node}.{label}", entry.index, entry.subindex, 1.0, 0.0, "")
        signal = self.prefix + binding.kind.signal
        return Signal(signal, entry.index, entry.subindex, binding.scale, binding.offset, binding.kind.unit)


def mode_of(part: Motor | Brake, description: Description) -> int:
    """Return the mode of operation of a CiA 402 drive: the rig file's, else CST if 6502h offers it or is absent, else
    profile torque.
    """
    if part.mode is not None:
        return part.mode
    index = of_axis(SUPPORTED_MODES, drive_axis_of(part))
    modes = description.variable(index, 0).default if description.has(index, 0) else None
    if not isinstance(modes, int) or modes == 0 or modes >> (CST - 1) & 1:
        return CST
    return PROFILE_TORQUE if modes >> (PROFILE_TORQUE - 1) & 1 else CST


def _carries(entry: Entry, left: Mapping[tuple[int, int], Binding]) -> bool:
    binding = left.get((entry.index, entry.subindex))
    return binding is not None and binding.entry.bits == entry.bits


def _groups(left: Iterable[Binding]) -> list[list[Entry]]:
    """Return the entries to place, in order; those of `TOGETHER` form one group."""
    groups: list[list[Entry]] = []
    names: list[str] = []
    for binding in left:
        partner = next((pair for pair in TOGETHER if binding.kind.name in pair), ())
        if groups and names[-1] in partner:
            groups[-1].append(binding.entry)
        else:
            groups.append([binding.entry])
        names.append(binding.kind.name)
    return groups


def _first_fit(
    free: Sequence[PdoParameters], groups: Sequence[list[Entry]]
) -> Iterator[tuple[PdoParameters, list[Entry]]]:
    """Put each group into the first PDO with room for it.

    A group that fits nowhere is placed entry by entry.
    """
    placed: dict[int, list[Entry]] = {record.number: [] for record in free}

    def put(group: list[Entry]) -> bool:
        for record in free:
            both = placed[record.number] + group
            if len(both) <= record.room and sum(entry.bits for entry in both) <= PDO_BITS:
                placed[record.number] = both
                return True
        return False

    for group in groups:
        if not put(group):
            for entry in group:
                put([entry])
    for record in free:
        if placed[record.number]:
            yield record, placed[record.number]
