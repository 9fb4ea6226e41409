"""What bring-up does to one device, and why it would be refused: judged before anything is sent.

`coulombus check` tells what `host.setup.bringup` executes, so that both say the same. The objects 2000h to 5FFFh are written where 1018h of the
EDS file is our own device's only (and, in `host.setup.bringup`, of the device as well): elsewhere they mean what another maker says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from coulombus.eds.cia402 import OPERATION_MODE_CST
from coulombus.eds.own_devices import MANUFACTURER, is_own, told_identity
from coulombus.eds.reader import Description, Variable
from coulombus.host.setup.settings import Role, Setting, settings_of
from coulombus.rigs.axis import Axis
from coulombus.rigs.devices import Brake, Motor

__all__ = ["DevicePlan", "device_plans", "names_modes_without_cst"]

READ_ONLY = ("ro", "const")

LOSSES: Mapping[tuple[Role, int], str] = {
    (
        "motor",
        0x2001,
    ): "no set-point becomes 0 after motor.setpoint_zero_cycles; only the RPDO deadline 1400h:05 ends an old one",
    ("motor", 0x2002): "the drive does not notice the loss of SYNC (motor.sync_timeout_s)",
    ("brake", 0x2001): "without set-points the brake does not hold for brake.hold_s and then ramp down by itself",
    ("brake", 0x2002): "the brake does not notice the loss of SYNC (brake.sync_timeout_s)",
    ("brake", 0x2005): "the brake's own ramp does not take brake.ramp_s",
}
"""What the host loses where it cannot write an object of our own devices."""


@dataclass(frozen=True)
class DevicePlan:
    """What bring-up does to one device.

    Attributes
    ----------
    name, node_id, role, part, description : which device it is
    writes : settings in their order; an object may be written more than once
    read_backs : ((index, sub-index), value) that each object must have afterwards; some are not written, as they cannot be
    problems : why bring-up would be refused, each with what to do; empty when it may begin
    questions : what the EDS file does not tell, and the device itself is asked
    losses : what is not written, and what the host loses by that
    """

    name: str
    node_id: int
    role: Role
    part: Motor | Brake
    description: Description
    writes: tuple[Setting, ...]
    read_backs: tuple[tuple[tuple[int, int], int], ...]
    problems: tuple[str, ...]
    questions: tuple[str, ...]
    losses: tuple[str, ...]


def device_plans(axis: Axis, mode: str, limit_pm: int) -> tuple[DevicePlan, DevicePlan]:
    """Return the plans of drive and brake of one axis.

    Parameters
    ----------
    limit_pm : the drive's torque limit 6072h in this mode [per mille of the rated torque]
    """
    return _plan(axis, "motor", mode, limit_pm), _plan(axis, "brake", mode, limit_pm)


def _plan(axis: Axis, role: Role, mode: str, limit_pm: int) -> DevicePlan:
    part = axis.motor if role == "motor" else axis.brake
    name, description = axis.prefix + role, axis.description(role)
    who = f"{name} (node {part.node_id})"
    ours = is_own(role, told_identity(description))
    there: list[Setting] = []
    problems = [*_identity_problems(who, role, part, description)]
    losses = []
    for setting in settings_of(axis, role, mode, limit_pm):
        meant = ours or setting.index not in MANUFACTURER
        if meant and description.has(setting.index, setting.subindex):
            there.append(setting)
        elif not setting.optional:
            problems.append(
                f"{_where(who, description, setting)} is needed, but {description.path} does not have it; "
                "take the EDS file of this very device, or a device that has the object"
            )
        elif loss := LOSSES.get((role, setting.index)):
            why = "is not described" if meant else "is the maker's own object: 1018h of the EDS file is not ours"
            losses.append(f"{who}: {setting.index:04X}h is not written, it {why}; {loss}")
    final = {(s.index, s.subindex): s.value for s in there}  # the last value of an object counts
    for setting in there:
        variable = description.variable(setting.index, setting.subindex)
        locked = _locked(description, setting)
        if problem := _misfit(variable, setting) or _other(variable, final, part.node_id, locked):
            problems.append(f"{_where(who, description, setting)}: {problem}")
    writable = tuple(s for s in there if not _locked(description, s))
    questions = [*_identity_questions(who, description)]
    if role == "motor":
        modes, questions_of_modes = _modes(who, description, part.node_id)
        problems += modes
        questions += questions_of_modes
    told = (tuple(dict.fromkeys(map(axis.said, texts))) for texts in (problems, questions, losses))
    return DevicePlan(name, part.node_id, role, part, description, writable, tuple(final.items()), *told)


def _where(who: str, description: Description, setting: Setting) -> str:
    label = ""
    if description.has(setting.index, setting.subindex):
        label = f" {description.variable(setting.index, setting.subindex).name}"
    return f"{who}, object {setting.index:04X}h:{setting.subindex:02X}{label}"


def _misfit(variable: Variable, setting: Setting) -> str:
    """Return why a value cannot be sent and read back whole, and what to do; "" when it can."""
    value, limits = setting.value, variable.whole
    shown = f"{value} ({value:#x})" if abs(value) > 9 else f"{value}"
    change = f"change {setting.key}" if setting.key else "take another device"
    if limits is None:
        told = f"0x{variable.data_type:04X}"
        return (
            f"{shown} is to be set, but its DataType is {told}; expected an integer, correct the EDS file if it is one"
        )
    if not limits[0] <= value <= limits[1]:
        return f"{shown} does not fit into its type, which holds {limits[0]} to {limits[1]}; {change}"
    if not variable.admits(value):
        low = "any" if variable.low is None else f"{variable.low}"
        high = "any" if variable.high is None else f"{variable.high}"
        return (
            f"{shown} is outside the EDS file's LowLimit {low} and HighLimit {high}; {change}, "
            "or correct the limits in a copy of the file where the device takes the value"
        )
    if variable.access == "wo":
        return f"{shown} is to be set, but a write-only object cannot be read back; take another device"
    return ""


def _locked(description: Description, setting: Setting) -> str:
    """Return why an object cannot be written, "" where it can: it is read-only, or belongs to a PDO that cannot be made invalid for it."""
    access = description.variable(setting.index, setting.subindex).access
    if access in READ_ONLY:
        return f"AccessType is {access}"
    mapping = setting.index & ~0x1FF in (0x1600, 0x1A00)
    if not mapping and not (setting.index & ~0x1FF == 0x1800 and setting.subindex in (3, 6)):
        return ""
    cob_id = setting.index - 0x200 * mapping
    valid = description.has(cob_id, 1) and description.variable(cob_id, 1).access in READ_ONLY
    return f"the PDO cannot be made invalid for it, {cob_id:04X}h:01 is read-only," if valid else ""


def _other(variable: Variable, final: Mapping[tuple[int, int], int], node_id: int, locked: str) -> str:
    """Return why an object that cannot be written will not have its value; "" where it can, or has it already."""
    if not locked:
        return ""
    wanted, default = final[variable.index, variable.subindex], variable.default
    if isinstance(default, int) and variable.node_relative:
        default += node_id
    if default == wanted:
        return ""
    has = "tells no value" if default is None else f"says {default!r}"
    return (
        f"{wanted} ({wanted:#x}) is to be set, but {locked} and the EDS file {has}; "
        "correct the file where the device lets it be written, or take another device"
    )


def _identity_problems(who: str, role: Role, part: Motor | Brake, description: Description) -> Iterator[str]:
    """Yield what the EDS file lacks of 1000h and 1018h, or has otherwise than the rig file."""
    told = dict(zip((1, 2), told_identity(description), strict=True))
    wanted = {1: ("vendor id", "vendor_id", part.vendor_id), 2: ("product code", "product_code", part.product_code)}
    for index, subindex in ((0x1000, 0), (0x1018, 1), (0x1018, 2)):
        if not description.has(index, subindex):
            yield (
                f"{who}, object {index:04X}h:{subindex:02X} is needed to know the device, but {description.path} does not have it; "
                "take the EDS file of this very device"
            )
    for subindex, (what, key, value) in wanted.items():
        if told[subindex] not in (0, value):
            yield (
                f"{who}: {what} 1018h:{subindex:02X} is {told[subindex]:#010x} in {description.path}, the rig file says {value:#010x} "
                f"({role}.{key}); take the EDS file of this very device, or correct the key"
            )


def _identity_questions(who: str, description: Description) -> Iterator[str]:
    for subindex, told in enumerate(told_identity(description), 1):
        if not told and description.has(0x1018, subindex):
            yield f"{who}: {description.path} does not tell 1018h:{subindex:02X}; bring-up asks the device"


def names_modes_without_cst(modes: int) -> bool:
    """Tell whether 6502h names modes, and cyclic synchronous torque is none of them."""
    return not modes >> (OPERATION_MODE_CST - 1) & 1


def _modes(who: str, description: Description, node_id: int) -> tuple[list[str], list[str]]:
    """Return (problems, questions) of the supported drive modes 6502h."""
    if not description.has(0x6502):
        return [], []
    modes = description.default(0x6502, 0, node_id) if description.has(0x6502, 0) else None
    if not isinstance(modes, int) or modes == 0:
        return [], [
            f"{who}: {description.path} does not tell the supported drive modes 6502h; bring-up asks the device"
        ]
    if names_modes_without_cst(modes):
        return [
            f"{who}: supported drive modes 6502h = {modes:#010x} in {description.path} do not include cyclic synchronous torque; "
            "take a drive that has it, or correct the file where this one does"
        ], []
    return [], []
