"""Plan of bring-up for one device: the objects to write and read back, and the reasons for a refusal.

The plan is made before anything is sent. `coulombus check` prints the same steps that
`host.setup.bringup` executes (`steps_of`). The objects 2000h to 5FFFh are written only if 1018h of the EDS
file is that of this project's device (`host.setup.bringup` also checks 1018h of the device), or if the rig
file lists them. In other devices these objects have another meaning.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from coulombus.eds.cia301 import CobId
from coulombus.eds.cia402 import MODE_NAMES, OPERATION_MODE_CST, OPERATION_MODE_PROFILE_TORQUE
from coulombus.eds.drive_axis import axis_of, first_axis_object, of_axis
from coulombus.eds.own_devices import MANUFACTURER, identity_from_1018h, is_own
from coulombus.eds.reader import Description, Variable
from coulombus.eds.sections import number_of
from coulombus.host.cycle.controller import Controller
from coulombus.host.setup.host_loss import NO_REACTION, Reaction, reactions_of
from coulombus.host.setup.position_scale import BelievedScale, believed_scale, early_wrap, remark_of
from coulombus.host.setup.settings import Setting, settings_of, torque_limits
from coulombus.rigs.axis import Axis
from coulombus.rigs.device_services import beats, emcy_default
from coulombus.rigs.devices import Brake, DeviceSection, Motor, drive_axis_of
from coulombus.rigs.errors import Problem
from coulombus.rigs.pdo_maps import mode_of, writable
from coulombus.rigs.roles import CIA402, profile_of

__all__ = ["MODE_DISPLAY", "NOT_SHOWN", "SUPPORTED_MODES", "DevicePlan", "device_plans", "missing_mode", "steps_of"]

READ_ONLY = ("ro", "const")
TARGET_TORQUE, MAX_TORQUE, SUPPORTED_MODES, MODE_DISPLAY = 0x6071, 0x6072, 0x6502, 0x6061
NOT_SHOWN = "6061h does not show the mode"
"""Text in host.accept, after the drive's name, that acknowledges a drive without a display of its mode."""
NO_TORQUE_LIMIT = "no torque limit of its own"


@dataclass(frozen=True)
class DevicePlan:
    """Plan of bring-up for one device.

    Attributes
    ----------
    name, node_id, role, part, description : the device
    mode : mode of operation of a CiA 402 drive; None for any other device
    writes : settings in their order; an object may be written more than once
    read_backs : ((index, sub-index), value) that each object must have afterwards, including objects
        that cannot be written
    problems : reasons for a refusal of bring-up, each with a remedy; empty if it may begin
    questions : values that the EDS file lacks, and that bring-up reads from the device
    losses : settings that are not written, each with the protection that the host loses
    reactions : the device's reactions to the loss of the host
    shows_mode : whether bring-up compares the drive's mode with 6061h
    position : the scale of the drive's position, which bring-up compares with the drive's own; None
        if there is nothing to compare
    """

    name: str
    node_id: int
    role: str
    part: DeviceSection
    description: Description
    mode: int | None
    writes: tuple[Setting, ...]
    read_backs: tuple[tuple[tuple[int, int], int], ...]
    problems: tuple[Problem, ...]
    questions: tuple[str, ...]
    losses: tuple[str, ...]
    reactions: tuple[Reaction, ...]
    shows_mode: bool = False
    position: BelievedScale | None = None

    @property
    def identity(self) -> tuple[tuple[int, str, int], ...]:
        """The compared entries of 1018h: (sub-index, name, value in the rig file)."""
        numbers = ((1, "vendor id", self.part.vendor_id), (2, "product code", self.part.product_code))
        return tuple((sub, what, value) for sub, what, value in numbers if value is not None and self.has_identity(sub))

    def has_identity(self, subindex: int) -> bool:
        """Return whether the device has 1018h with this sub-index."""
        return self.description.has(0x1018, subindex)


def device_plans(controller: Controller) -> tuple[DevicePlan, ...]:
    """Return the plans of the devices of one axis in the controller's mode: drive, brake, sensors."""
    axis, limit_pm = controller.axis, controller.drive_limit_pm()
    plans = [_Planner(axis, node, controller.mode, limit_pm).plan() for node in axis.devices]
    of_roles = tuple(f"{axis.prefix}{text}" for text in axis.allocation.losses)
    plans[0] = replace(plans[0], losses=(*of_roles, *plans[0].losses))
    return tuple(plans)


class _Planner:
    """Makes the plan of one device."""

    def __init__(self, axis: Axis, node: str, mode: str, limit_pm: int) -> None:
        self.axis, self.node, self.mode, self.limit_pm = axis, node, mode, limit_pm
        self.part, self.description = axis.part(node), axis.description(node)
        self.name = axis.prefix + node
        self.who = f"{self.name} (node {self.part.node_id})"
        self.ours = is_own(node, identity_from_1018h(self.description))
        self.problems: list[Problem] = []
        self.questions: list[str] = []
        self.losses: list[str] = []

    def plan(self) -> DevicePlan:
        """Return the plan."""
        self._identity()
        self._emergency()
        settings = self._described()
        final = {(s.index, s.subindex): s.value for s in settings}  # the last value of an object counts
        settable = [setting for setting in settings if self._can_be_set(setting, final)]
        written = tuple(s for s in settable if not _locked(self.description, s))
        self._granularity(written)
        unread = {(s.index, s.subindex) for s in settings if not s.verify}
        left_out = {(s.index, s.subindex) for s in settings} - {(s.index, s.subindex) for s in settable}
        read_backs = tuple((at, value) for at, value in final.items() if at not in unread | left_out)
        operation_mode = self._modes() if self._is_drive else None
        shows_mode = self._is_drive and self._shows_mode()
        position = None
        if self.node == "motor":
            self._limits()
            self._further_axis()
            position = self._position()
        self._silent()
        reactions = reactions_of(self.axis, self.node, settable) if self.node in ("motor", "brake") else ()
        if reactions and not any(reaction.who for reaction in reactions):
            self._acknowledge(NO_REACTION, "its last set-point acts on after the loss of the host", self._acts)
        spelled = self.axis.spell_keys
        return DevicePlan(
            name=self.name,
            node_id=self.part.node_id,
            role=self.node,
            part=self.part,
            description=self.description,
            mode=operation_mode,
            writes=written,
            read_backs=read_backs,
            problems=tuple(
                problem._replace(text=spelled(problem.text), remedy=spelled(problem.remedy))
                for problem in self.problems
            ),
            questions=tuple(map(spelled, self.questions)),
            losses=tuple(map(spelled, self.losses)),
            reactions=reactions,
            shows_mode=shows_mode,
            position=position,
        )

    @property
    def _is_drive(self) -> bool:
        return self.node == "motor" or (self.node == "brake" and profile_of(self.description, "brake") == CIA402)

    @property
    def _acts(self) -> bool:
        """Whether the device has torque in this mode."""
        return self.limit_pm > 0 if self.node == "motor" else self.mode != "active"

    def _problem(self, text: str, remedy: str, place: str = "", accept: str = "") -> None:
        self.problems.append(Problem("", self.node, place, f"{self.who}{text}", remedy, accept))

    def _acknowledge(self, what: str, why: str, needed: bool) -> None:
        """Add a problem for a missing capability, unless host.accept acknowledges it."""
        sentence = f"{self.name}: {what}"
        if sentence in self.axis.host.accept:
            self.losses.append(f"{sentence}: {why} (host.accept)")
        elif needed:
            remedy = f'take another device, or acknowledge it: host.accept = ["{sentence}"]'
            self._problem(f": {what}: {why}", remedy, accept=sentence)

    def _described(self) -> list[Setting]:
        """Return the settings whose objects the device has; each other setting is a loss or a problem."""
        settings = []
        for setting in settings_of(self.axis, self.node, self.mode, self.limit_pm):
            meant = self.ours or setting.listed or setting.index not in MANUFACTURER
            has = self.description.has(setting.index, setting.subindex) or setting.type
            if meant and has:
                settings.append(setting)
                if setting.told:
                    self.losses.append(f"{self.who}: {setting.told}")
            elif not setting.optional:
                self._problem(
                    f", object {_label(self.description, setting)} is needed, but {self.description.path} does not have it",
                    "take the EDS file of this very device, or a device that has the object",
                    _place(setting),
                )
            elif setting.lost:
                why = "is not described" if meant else "is the maker's own object: 1018h of the EDS file is not ours"
                place = _place(setting) if setting.subindex else f"{setting.index:04X}h"
                self.losses.append(f"{self.who}: {place} is not written, it {why}; {setting.lost}")
        return settings

    def _can_be_set(self, setting: Setting, final: Mapping[tuple[int, int], int]) -> bool:
        """Return whether a setting stays in the plan; else add the reason as a loss or a problem."""
        variable = setting.variable(self.description)
        locked = _locked(self.description, setting)
        misfit, remedy = _misfit(variable, setting) or _other(variable, final, self.part.node_id, locked) or ("", "")
        if misfit and setting.soft:
            self.losses.append(f"{self.who}: {_place(setting)} is not set ({misfit}); {setting.lost or setting.why}")
            return False
        if misfit:
            has = self.description.has(setting.index, setting.subindex)
            stands = f" ({self.description.path}:{variable.line})" if has else ""
            self._problem(f", object {_label(self.description, setting)}: {misfit}{stands}", remedy, _place(setting))
        elif _opened(variable, setting):
            self.questions.append(
                f"{self.who}: {self.description.path} limits 1016h:01 to {variable.high}, where no node id has room; it is written all the same"
            )
        if not setting.verify and not setting.listed:
            self.losses.append(f"{self.who}: {_place(setting)} is write-only and cannot be read back")
        return True

    def _granularity(self, written: Sequence[Setting]) -> None:
        """Add a question for an EDS file with Granularity=0, whose PDOs are mapped nevertheless."""
        info = {name.lower(): text for name, text in self.description.info.items()}
        number = number_of(info.get("granularity", ""))
        maps = any(setting.index & ~0x1FF in (0x1600, 0x1A00) for setting in written)
        if number is not None and number.value == 0 and maps:
            text = "has Granularity=0, as if no PDO could be mapped; bring-up maps them all the same, and reads the maps back"
            self.questions.append(f"{self.who}: {self.description.path} {text}")

    def _emergency(self) -> None:
        """Refuse a device whose EMCYs always have SYNC's identifier: they cannot be assigned to the device."""
        default = emcy_default(self.description, self.part.node_id)
        if default == CobId.SYNC and not writable(self.description.variable(0x1014, 0)):
            where = f"{self.description.path}:{self.description.variable(0x1014, 0).line}"
            text = f", object 1014h:00 is {default:X}h, the identifier of SYNC, and read-only ({where})"
            self._problem(
                text, "correct the EDS file where the device has another one, or take another device", "1014h:00"
            )

    def _identity(self) -> None:
        """Check 1000h and 1018h: entries that the EDS file lacks, or that differ from the rig file."""
        description, rig_numbers = self.description, (self.part.vendor_id, self.part.product_code)
        keys = ("vendor_id", "product_code")
        if not description.has(0x1000, 0):
            text = f", object 1000h:00 is needed to know the device, but {description.path} does not have it"
            self._problem(text, "take the EDS file of this very device", "1000h:00")
        for subindex, (number, value) in enumerate(zip(identity_from_1018h(description), rig_numbers, strict=True), 1):
            what, key = (
                f"{keys[subindex - 1].replace('_', ' ')} 1018h:{subindex:02X}",
                f"{self.node}.{keys[subindex - 1]}",
            )
            if not description.has(0x1018, subindex):
                self.losses.append(
                    f"{self.who}: {description.path} has no 1018h:{subindex:02X}, so the {keys[subindex - 1].replace('_', ' ')} is not compared"
                )
            elif value is None:
                remedy = f"give {key}" + (f" = {number:#x}, if the file is of this very device" if number else "")
                self._problem(f": the rig file does not tell the {what}", remedy, f"1018h:{subindex:02X}")
            elif not number:
                self.questions.append(
                    f"{self.who}: {description.path} does not tell 1018h:{subindex:02X}; bring-up asks the device"
                )
            elif number != value:
                where = f"{description.path}:{description.variable(0x1018, subindex).line}"
                text = f": {what} is {number:#010x} in {where}, the rig file says {value:#010x} ({key})"
                self._problem(
                    text, "take the EDS file of this very device, or correct the key", f"1018h:{subindex:02X}"
                )

    def _modes(self) -> int:
        """Return the mode of operation, and check it against 6502h."""
        assert isinstance(self.part, Motor | Brake)
        mode, description = mode_of(self.part, self.description), self.description
        index = of_axis(SUPPORTED_MODES, drive_axis_of(self.part))
        if not description.has(index):
            return mode
        modes = description.default(index, 0, self.part.node_id) if description.has(index, 0) else None
        if not isinstance(modes, int) or modes == 0:
            text = f"{self.who}: {description.path} does not tell the supported drive modes {index:04X}h; bring-up asks the device"
            self.questions.append(text)
        elif lacking := missing_mode(modes, mode):
            where = f"{description.path}:{description.variable(index, 0).line}"
            text = f": supported drive modes {index:04X}h = {modes:#010x} in {where} do not include {lacking}"
            remedy = (
                "take a drive that has it, correct the file where this one does, or name the maker's own torque or current mode "
                f"({self.node}.mode) and its set-point ([role.torque_setpoint])"
            )
            self._problem(text, remedy, f"{index:04X}h:00")
        return mode

    def _shows_mode(self) -> bool:
        """Return whether bring-up compares the mode with 6061h; this project's drive always displays it."""
        sentence = f"{self.name}: {NOT_SHOWN}"
        if sentence in self.axis.host.accept:
            self.losses.append(f"{sentence} (host.accept)")
            return False
        index = of_axis(MODE_DISPLAY, drive_axis_of(self.part))
        return not self.ours and self.description.has(index, 0) and self.description.variable(index, 0).access != "wo"

    def _further_axis(self) -> None:
        """Refuse a set-point of an axis of the drive that bring-up does not configure."""
        entry, drive_axis = self.axis.allocation.bound["torque_setpoint"].entry, drive_axis_of(self.axis.motor)
        number = axis_of(entry.index)
        if number != drive_axis and first_axis_object(entry.index) == TARGET_TORQUE:
            objects = ", ".join(f"{of_axis(index, number):04X}h" for index in (0x6060, MAX_TORQUE, 0x605A))
            why = (
                f"bring-up sets mode, limits and reactions of axis {drive_axis}; set motor.drive_axis = {number}, "
                f"or list those of axis {number} ({objects}) in [[motor.sdo]]"
            )
            self._acknowledge(f"its set-point is axis {number}'s", why, True)

    def _position(self) -> BelievedScale | None:
        """Return the scale that bring-up compares with the drive's; add questions and losses for gaps of the
        EDS file.
        """
        scale = believed_scale(self.axis, self.who, self.name)
        question, loss = ("", "") if scale is None else remark_of(self.axis, scale)
        self.questions += [question] if question else []
        self.losses += [text for text in (loss, early_wrap(self.axis, self.who)) if text]
        return scale

    def _silent(self) -> None:
        """Add a loss for a device without a TPDO: the host detects its failure late, by the heartbeat alone."""
        if beats(self.description) and not any(
            pdo.node == self.name and pdo.layout.direction == "tpdo" for pdo in self.axis.pdos()
        ):
            late = f"the host notices its loss by its heartbeat alone, within {self.part.heartbeat_timeout_s:g} s"
            self.losses.append(f"{self.who} sends no TPDO; {late}")

    def _limits(self) -> None:
        """Require a torque limit in the drive itself."""
        number = drive_axis_of(self.axis.motor)
        indices, max_torque = torque_limits(self.description, number), of_axis(MAX_TORQUE, number)
        if not indices:
            names = [f"{of_axis(index, number):04X}h" for index in (MAX_TORQUE, 0x60E0, 0x60E1, 0x6073)]
            self._acknowledge(
                NO_TORQUE_LIMIT,
                f"{names[0]}, {names[1]} and {names[2]}, {names[3]} cannot be written; only the host limits",
                self.limit_pm > 0,
            )
        elif max_torque not in indices:
            others = " and ".join(f"{index:04X}h" for index in indices)
            self.losses.append(
                f"{self.who}: {max_torque:04X}h is not written, it is not described; {others} limit the torque"
            )


def _place(setting: Setting) -> str:
    return f"{setting.index:04X}h:{setting.subindex:02X}"


def _label(description: Description, setting: Setting) -> str:
    if not description.has(setting.index, setting.subindex):
        return _place(setting)
    return f"{_place(setting)} {description.variable(setting.index, setting.subindex).name}"


def _opened(variable: Variable, setting: Setting) -> bool:
    """Return whether the file's limits contradict CiA 301: 1016h has the node id above bit 16."""
    return setting.index == 0x1016 and variable.high is not None and 0 < variable.high <= 0xFFFF and variable.bits == 32


def _misfit(variable: Variable, setting: Setting) -> tuple[str, str] | None:
    """Return the reason why a value cannot be written and read back, with a remedy; None if it can."""
    value, limits = setting.value, variable.whole
    shown = f"{value} ({value:#x})" if abs(value) > 9 else f"{value}"
    change = f"change {setting.key}" if setting.key else "take another device"
    if limits is None:
        data_type = f"0x{variable.data_type:04X}"
        return (
            f"{shown} is to be set, but its DataType is {data_type}",
            "expected an integer, correct the EDS file if it is one",
        )
    if setting.type and variable.bits != setting.variable_bits:
        return f"the rig file says {setting.type}, and the EDS file says {variable.bits} bits", change
    if not limits[0] <= value <= limits[1]:
        return f"{shown} does not fit into its type, which holds {limits[0]} to {limits[1]}", change
    if not variable.admits(value) and not _opened(variable, setting):
        low = "any" if variable.low is None else f"{variable.low}"
        high = "any" if variable.high is None else f"{variable.high}"
        return (
            f"{shown} is outside the EDS file's LowLimit {low} and HighLimit {high}",
            f"{change}, or correct the limits in a copy of the file where the device takes the value",
        )
    if variable.access == "wo" and setting.verify:
        return f"{shown} is to be set, but a write-only object cannot be read back", "take another device"
    return None


def _locked(description: Description, setting: Setting) -> str:
    """Return the reason why an object cannot be written, or "".

    It is read-only, or it belongs to a PDO that cannot be made invalid for the write.
    """
    access = setting.variable(description).access
    if access in READ_ONLY:
        return f"AccessType is {access}"
    if setting.while_valid:
        return ""
    mapping = setting.index & ~0x1FF in (0x1600, 0x1A00)
    if not mapping and not (setting.index & ~0x1FF == 0x1800 and setting.subindex in (3, 6)):
        return ""
    cob_id = setting.index - 0x200 * mapping
    valid = description.has(cob_id, 1) and description.variable(cob_id, 1).access in READ_ONLY
    return f"the PDO cannot be made invalid for it, {cob_id:04X}h:01 is read-only," if valid else ""


def _other(
    variable: Variable, final: Mapping[tuple[int, int], int], node_id: int, locked: str
) -> tuple[str, str] | None:
    """Return the reason why an object will not have its value, with a remedy; None if it can be written, or
    has the value already.
    """
    if not locked:
        return None
    value, default = final[variable.index, variable.subindex], variable.default
    if isinstance(default, int) and variable.node_relative:
        default += node_id
    if default == value:
        return None
    has = "tells no value" if default is None else f"says {default!r}"
    return (
        f"{value} ({value:#x}) is to be set, but {locked} and the EDS file {has}",
        "correct the file where the device lets it be written, or take another device",
    )


def missing_mode(modes: int, mode: int) -> str:
    """Return the name of a mode that 6502h lacks; "" if it has the mode, or for a manufacturer-specific
    mode.
    """
    if mode not in (OPERATION_MODE_CST, OPERATION_MODE_PROFILE_TORQUE) or modes >> (mode - 1) & 1:
        return ""
    return MODE_NAMES[mode]


def steps_of(plans: Sequence[DevicePlan]) -> Iterator[tuple[DevicePlan, Setting]]:
    """Yield every step of bring-up in its order, device by device."""
    for plan in plans:
        for setting in plan.writes:
            yield plan, setting
