"""What a drive can be in a rig: its mode, its set-point and its scales, each guess with its
reason.
"""

from __future__ import annotations

from typing import NamedTuple

from coulombus.eds.cia402 import OPERATION_MODE_CST as CST
from coulombus.eds.cia402 import OPERATION_MODE_PROFILE_TORQUE as PROFILE_TORQUE
from coulombus.rigs.draft.device import DraftDevice, Place, label
from coulombus.rigs.draft.draft_text import CHECK, RigText
from coulombus.rigs.draft.makers import MakerMode, maker_mode
from coulombus.rigs.errors import RigError
from coulombus.rigs.problem import Problem

__all__ = ["TorqueCommand", "command_of", "describe_mode", "describe_motor"]

TARGET_TORQUE: Place = (0x6071, 0)
SLOPE, TORQUE_OFFSET, INTERPOLATION = 0x6087, 0x60B2, 0x60C2
LEAST_COUNTS = 16
"""Counts of an encoder in one turn: 608Fh says 1 where nobody has set it."""
LEAST_TORQUE_Nm, MOST_TORQUE_Nm = 1e-3, 50.0
"""Rated torque that a drive for a handle may have: what says something else counts in another unit.
"""
MOST_AT_HANDLE_Nm = 14.0
"""Rated torque at the handle: with more, a per mille is a tenth of the device's own friction."""


class TorqueCommand(NamedTuple):
    """How a drive is commanded a torque: the mode of operation, the maker's own mode if it is one,
    and why it is a guess.
    """

    mode: int
    maker: MakerMode | None
    why: str


def command_of(device: DraftDevice) -> TorqueCommand:
    """Return how a drive is commanded.

    Raises
    ------
    RigError
        no PDO can carry a torque or current set-point, or no mode follows one
    """
    offered = device.value(0x6502)
    says = f"6502h = 0x{offered:X} of {device.source(0x6502)}" if offered else "6502h tells nothing"
    if device.entry(TARGET_TORQUE, "rpdo"):
        if not offered:
            slope_only = device.description.has(SLOPE) and not (
                device.description.has(TORQUE_OFFSET) or device.description.has(INTERPOLATION)
            )
            mode = PROFILE_TORQUE if slope_only else CST
            return TorqueCommand(
                mode,
                None,
                f"{says}. 10 is cyclic synchronous torque, 4 profile torque; bring-up asks the drive",
            )
        for mode in (CST, PROFILE_TORQUE):
            if offered >> (mode - 1) & 1:
                return TorqueCommand(mode, None, "")
    lacking = f"{label(TARGET_TORQUE)} is not " + (
        "mappable" if device.description.has(*TARGET_TORQUE) else "described"
    )
    if device.entry(TARGET_TORQUE, "rpdo"):
        lacking = f"{says} offers neither cyclic synchronous torque (10) nor profile torque (4)"
    maker = maker_mode(device)
    if maker is not None:
        known = "" if maker.sure else ", by its objects' names: find its number in the manual"
        return TorqueCommand(maker.mode, maker, f"{lacking}; this is {maker.name}{known}")
    text = f"{device.description.path}: no torque or current set-point that a PDO can carry: {lacking}"
    remedy = "take a drive that has one; a drive for positions or speeds cannot display friction"
    role = f"{'brake' if device.node == 'brake' else 'torque'}_setpoint"
    problem = Problem(role, device.node, label(TARGET_TORQUE), text, remedy)
    raise RigError([f"{device.node}: {problem}"], [problem])


def describe_mode(text: RigText, device: DraftDevice, command: TorqueCommand) -> None:
    """Set the mode of operation of a drive, and the objects that a maker's mode needs."""
    text.put(f"{device.node}.mode", command.mode, command.why)
    if command.maker is not None and command.maker.sdo:
        rows = [
            {"index": index, "sub": sub, "type": kind, "value": value, "when": "after", "verify": True}
            for (index, sub), kind, value in command.maker.sdo
        ]
        text.put(f"{device.node}.sdo", rows, f"objects that {command.maker.name} needs")


def describe_motor(text: RigText, device: DraftDevice) -> None:
    """Set [motor], and the roles of a drive that is not ours."""
    command = command_of(device)
    describe_mode(text, device, command)
    rated_Nm = _rated_torque(text, device)
    _position(text, device)
    if command.maker is not None:
        _own_units(text, device, command.maker, rated_Nm)
    _ratio(text, device, rated_Nm)


def _ratio(text: RigText, device: DraftDevice, rated_Nm: float) -> None:
    """Set the transmission's ratio, with which the drive's torque can be limited as each mode wants
    it.
    """
    ratio, modes = text.get("mechanics.ratio"), text.get("mode")
    limits = [mode["motor_limit_Nm"] for mode in modes.values() if mode["motor_limit_Nm"]]
    limit = device.description.variable(0x6072, 0) if device.description.has(0x6072, 0) else None
    low_pm, high_pm = (limit.low or 0, min(limit.largest, 1000)) if limit else (0, 1000)
    least = max(limits, default=0) * 1000 / max(high_pm, 1)
    most = min(MOST_AT_HANDLE_Nm, min(limits, default=MOST_AT_HANDLE_Nm) * 1000 / max(low_pm, 1))
    measure = "the rig is your own: measure it, or calculate; the polarities as well"
    if least <= rated_Nm * ratio <= most:
        text.note("mechanics.ratio", measure, CHECK)
        return
    near = least if rated_Nm * ratio < least else most
    near *= 1.001 if near == least else 0.999  # of rounding
    why = f"{measure}. Here the rated torque becomes {near:.3g} Nm at the handle, which suits the limits of the modes"
    text.put("mechanics.ratio", float(f"{near / rated_Nm:.4g}"), why)


def _rated_torque(text: RigText, device: DraftDevice) -> float:
    """Set what 1000 per mille are; return it [Nm]."""
    rated, like_Nm = device.value(0x6076), float(text.get("motor.rated_torque_Nm"))
    readings = "drives count the set-point in per mille of 6076h in mNm, of 6076h in uNm, or of the rated current"
    for unit, name in ((1e-3, "mNm"), (1e-6, "uNm")):
        if rated and LEAST_TORQUE_Nm <= rated * unit <= MOST_TORQUE_Nm:
            rated_Nm = float(f"{rated * unit:.6g}")
            why = f"{device.source(0x6076)} has 6076h = {rated}, taken for {name}; {readings}"
            text.put("motor.rated_torque_Nm", rated_Nm, why)
            return rated_Nm
    text.put("motor.rated_torque_Nm", like_Nm, f"6076h tells nothing, see the motor's data sheet; {readings}")
    return like_Nm


def _position(text: RigText, device: DraftDevice) -> None:
    counts, turns = device.value(0x608F, 1), device.value(0x608F, 2) or 1
    like = text.get("motor.encoder_counts_rev")
    if counts and counts // turns >= LEAST_COUNTS:
        text.put(
            "motor.encoder_counts_rev",
            counts // turns,
            f"608Fh of {device.source(0x608F, 1)}; some drives tell the lines there, which are a quarter of it",
        )
    else:
        text.put(
            "motor.encoder_counts_rev", like, "608Fh tells nothing: counts of the position in one turn of the motor"
        )
    if not device.entry((0x6064, 0), "tpdo") and device.entry((0x6063, 0), "tpdo"):
        text.put("role.position.object", "6063", "6064h cannot be mapped; 6063h counts increments of the encoder")


def _own_units(text: RigText, device: DraftDevice, maker: MakerMode, rated_Nm: float) -> None:
    """Set the scale of a set-point that is not in per mille of the rated torque, and of the torque
    that flows.
    """
    setpoint = device.entry(maker.setpoint, "rpdo")
    assert setpoint is not None
    text.put("role.torque_setpoint.object", _spelled(maker.setpoint))
    if maker.unit == "mA":
        current_mA = device.value(*maker.continuous_mA) if maker.continuous_mA else None
        rated_mA = current_mA or 5000
        whence = (
            f"{label(maker.continuous_mA)} says {current_mA} mA"
            if maker.continuous_mA and current_mA
            else "5000 mA is a guess"
        )
        scale = float(f"{rated_Nm / rated_mA:.4g}")
        why = f"Nm for 1 mA is the motor's torque constant / 1000, see its data sheet; here the rated torque at the continuous current ({whence})"
    else:
        scale = float(f"{rated_Nm / 2 ** (setpoint.bits - 3):.4g}")
        why = f"the maker's own unit: Nm at the shaft for one count of {label(maker.setpoint)}; here the rated torque at a quarter of its range"
    text.put("role.torque_setpoint.scale_Nm", scale, why)
    if maker.actual is not None and device.entry(maker.actual, "tpdo"):
        text.put("role.torque.object", _spelled(maker.actual))
        text.put("role.torque.scale_Nm", scale, "it counts as the set-point does")
    elif place := next((at for at in ((0x6077, 0), (0x6078, 0)) if device.entry(at, "tpdo")), None):
        text.put("role.torque.object", _spelled(place))
        text.put(
            "role.torque.scale_Nm", float(f"{rated_Nm / 1000:.4g}"), "per mille of the rated torque, as CiA 402 has it"
        )


def _spelled(place: Place) -> str:
    """Return an object as the rig file has it."""
    index, subindex = place
    return f"{index:04X}:{subindex:X}" if subindex else f"{index:04X}"
