"""Draft [motor]: mode, set-point and scales of a drive, each guess with its reason."""

from __future__ import annotations

import math
from typing import NamedTuple

from coulombus.eds.cia402 import OPERATION_MODE_CST as CST
from coulombus.eds.cia402 import OPERATION_MODE_PROFILE_TORQUE as PROFILE_TORQUE
from coulombus.eds.drive_scale import (
    POLARITY,
    SCALE_OBJECTS,
    PositionScale,
    polarity,
    position_scale,
    resolution,
)
from coulombus.rigs.draft.device import DraftDevice, Place
from coulombus.rigs.draft.draft_text import CHECK, RigText
from coulombus.rigs.draft.makers import AMPERES, NEWTON_METRES, MakerMode, maker_mode, rated_unit, unit_of
from coulombus.rigs.errors import Problem, RigError
from coulombus.rigs.pdo_records import mapping_sentence

__all__ = ["TorqueCommand", "command_of", "describe_mode", "describe_motor"]

TARGET_TORQUE: Place = (0x6071, 0)
SUPPORTED_MODES: Place = (0x6502, 0)
RATED_TORQUE: Place = (0x6076, 0)
SLOPE, TORQUE_OFFSET, INTERPOLATION = 0x6087, 0x60B2, 0x60C2
WITNESS = "bring-up holds it against the drive; commissioning and the travel of the sign check prove it"
LEAST_TORQUE_Nm, MOST_TORQUE_Nm = 1e-3, 1000.0
"""Plausible rated torque of a motor; other values are in another unit."""
MILLI = "taken for mNm, as CiA 402 has it; if it is another unit, the host pushes less than it assumes"
MICRO = "taken for uNm, as it is too large for mNm"
READINGS = "drives count the set-point in per mille of 6076h in mNm, of 6076h in uNm, or of the rated current"
GUESSED_mA = 1000
"""Assumed rated current if the drive does not state it: small, so that the torque per mA is large."""


class TorqueCommand(NamedTuple):
    """Torque command of a drive: mode of operation, the manufacturer-specific mode if it is such, and why it is a
    guess.
    """

    mode: int
    maker: MakerMode | None
    why: str


def command_of(device: DraftDevice) -> TorqueCommand:
    """Return the torque command of a drive.

    Raises
    ------
    RigError
        no PDO can carry a torque or current set-point, or no mode follows one
    """
    offered = device.value(0x6502)
    modes = device.label(SUPPORTED_MODES)
    says = f"{modes} = 0x{offered:X} of {device.source(0x6502)}" if offered else f"{modes} tells nothing"
    if device.entry(TARGET_TORQUE, "rpdo"):
        if not offered:
            slope_only = device.has(SLOPE) and not (device.has(TORQUE_OFFSET) or device.has(INTERPOLATION))
            mode = PROFILE_TORQUE if slope_only else CST
            return TorqueCommand(
                mode,
                None,
                f"{says}. 10 is cyclic synchronous torque, 4 profile torque; bring-up asks the drive",
            )
        for mode in (CST, PROFILE_TORQUE):
            if offered >> (mode - 1) & 1:
                return TorqueCommand(mode, None, "")
    lacking = f"{device.label(TARGET_TORQUE)} is not " + ("mappable" if device.has(*TARGET_TORQUE) else "described")
    if device.entry(TARGET_TORQUE, "rpdo"):
        lacking = f"{says} offers neither cyclic synchronous torque (10) nor profile torque (4)"
    maker = maker_mode(device) if device.axis == 1 else None
    if maker is not None:
        by_name = "" if maker.sure else ", by its objects' names: find its number in the manual"
        return TorqueCommand(maker.mode, maker, f"{lacking}; this is {maker.name}{by_name}")
    text = f"{_where(device)}: no torque or current set-point that a PDO can carry: {lacking}"
    remedy = _way(device)
    role = f"{'brake' if device.node == 'brake' else 'torque'}_setpoint"
    problem = Problem(role, device.node, device.label(TARGET_TORQUE), text, remedy)
    raise RigError([f"{device.node}: {problem}"], [problem])


def _where(device: DraftDevice) -> str:
    """Return the file, with the line of 6071h if the file has it."""
    line = f":{device.variable(*TARGET_TORQUE).line}" if device.has(*TARGET_TORQUE) else ""
    return f"{device.description.path}{line}"


def _way(device: DraftDevice) -> str:
    """Return the remedy for a drive whose file has no torque set-point."""
    ways = []
    if device.has(*TARGET_TORQUE) and not device.variable(*TARGET_TORQUE).pdo_mappable:
        sentence = mapping_sentence(device.node, device.at(TARGET_TORQUE[0]), TARGET_TORQUE[1])
        ways.append(
            f'where the drive maps it all the same, acknowledge it (init --accept "{sentence}", host.accept in the rig file): '
            "bring-up tries, and the drive's answer decides"
        )
    ways.append(
        f"where its maker has a torque or current mode of its own, name it ({device.node}.mode) and its set-point "
        "([role.torque_setpoint] object and scale_Nm) in the rig file: class D of docs/drives.md"
    )
    return f"{'; '.join(ways)}; else take a drive that has one: a drive for positions or speeds cannot display friction"


def describe_mode(text: RigText, device: DraftDevice, command: TorqueCommand) -> None:
    """Set the mode of operation of a drive, and the objects that a manufacturer-specific mode needs."""
    text.put(f"{device.node}.mode", command.mode, command.why)
    if command.maker is not None and command.maker.sdo:
        rows = [
            {"index": index, "sub": sub, "type": kind, "value": value, "when": "after", "verify": True}
            for (index, sub), kind, value in command.maker.sdo
        ]
        text.put(f"{device.node}.sdo", rows, f"objects that {command.maker.name} needs")


def describe_motor(text: RigText, device: DraftDevice) -> None:
    """Set [motor], and the roles of a third-party drive."""
    command = command_of(device)
    if device.axis > 1:
        text.put(f"{device.node}.drive_axis", device.axis)
    describe_mode(text, device, command)
    rated_Nm = _rated_torque(text, device)
    _position(text, device)
    if command.maker is not None:
        _own_units(text, device, command.maker, rated_Nm)
    else:
        _named_unit(text, device)
    _limits(text, device, command, rated_Nm)


def _limits(text: RigText, device: DraftDevice, command: TorqueCommand, rated_Nm: float) -> None:
    """Lower the limits of the modes to the drive's capability, and the friction of mode active with them. Nothing is
    raised, and no ratio is chosen, to make a guess of the rated torque fit.
    """
    text.note("mechanics.ratio", "the rig is your own: measure it, or calculate; the polarities as well", CHECK)
    ratio = text.get("mechanics.ratio")
    most_Nm = rated_Nm * ratio * _most_per_mille(device, command) / 1000
    for name, mode in text.get("mode").items():
        limit_Nm = mode["motor_limit_Nm"]
        if limit_Nm <= most_Nm or command.maker is not None:
            continue
        why = f"the drive gives at most {most_Nm:.3g} Nm at the handle, by its rated torque and its limits"
        text.put(f"mode.{name}.motor_limit_Nm", _down(most_Nm), why)
        friction_Nm = text.get("mechanics.friction_Nm")
        if mode["compensation"] * friction_Nm > most_Nm:
            text.put(f"mode.{name}.compensation", _down(most_Nm / friction_Nm), why)
        if name == "active" and mode["F_s_Nm"] > most_Nm:
            share = _down(most_Nm) / mode["F_s_Nm"]
            text.put(f"mode.{name}.F_s_Nm", _down(most_Nm), why)
            text.put(f"mode.{name}.F_d_Nm", _down(mode["F_d_Nm"] * share), why)
    count_Nm = rated_Nm * ratio / 1000
    weakest = min(
        (mode["motor_limit_Nm"] for mode in text.get("mode").values() if mode["motor_limit_Nm"]), default=count_Nm
    )
    if command.maker is None and count_Nm > weakest:
        coarse = (
            f"one per mille of it is {count_Nm:.3g} Nm at the handle, more than a mode's motor_limit_Nm ({weakest:.3g})"
        )
        text.note("motor.rated_torque_Nm", f"{coarse}: the host then commands no torque", CHECK)


def _most_per_mille(device: DraftDevice, command: TorqueCommand) -> int:
    """Return the largest set-point that 6071h and 6072h take, at most the rated torque."""
    ends = [1000]
    for index in (TARGET_TORQUE[0], 0x6072):
        if device.has(index, 0):
            variable = device.variable(index, 0)
            ends.append(int(variable.largest))
            if variable.low is not None and variable.low < 0:
                ends.append(int(-variable.low))
    return max(1, min(ends))


def _down(value: float) -> float:
    """Round to three digits, never upwards."""
    if value <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / step + 1e-9) * step:.3g}")


def _rated_torque(text: RigText, device: DraftDevice) -> float:
    """Set the torque of 1000 per mille; return it [Nm].

    CiA 402 has 6076h in mNm. Another unit counts if the object's name or the maker's manual states it; otherwise the
    larger torque is safe, because the host then pushes less.
    """
    rated, like_Nm = device.value(0x6076), float(text.get("motor.rated_torque_Nm"))
    unit, whence = rated_unit(device)
    if rated:
        for scale, unit_text in ((unit, whence),) if whence else ((1e-3, MILLI), (1e-6, MICRO)):
            rated_Nm = float(f"{rated * scale:.6g}")
            if LEAST_TORQUE_Nm <= rated_Nm <= MOST_TORQUE_Nm:
                source = f"{device.source(0x6076)} has {device.label(RATED_TORQUE)} = {rated}, {unit_text}"
                text.put("motor.rated_torque_Nm", rated_Nm, f"{source}; {READINGS}")
                return rated_Nm
    text.put(
        "motor.rated_torque_Nm",
        like_Nm,
        f"{device.label(RATED_TORQUE)} tells nothing, see the motor's data sheet; {READINGS}",
    )
    return like_Nm


def _position(text: RigText, device: DraftDevice) -> None:
    by_increments = not device.entry((0x6064, 0), "tpdo") and device.entry((0x6063, 0), "tpdo")
    key, scale = "motor.encoder_counts_rev", position_scale(device.value, device.axis)
    if by_increments:
        increments = resolution(device.value)
        scale = PositionScale(None if increments is None else float(increments), device.label((0x608F, 0)))
        why = f"{device.label((0x6064, 0))} cannot be mapped; {device.label((0x6063, 0))} counts increments of the encoder"
        text.put("role.position.object", _spelled(device, (0x6063, 0)), why)
    if scale.counts_rev is None:
        like, what = text.get(key), "counts of the position in one turn of the motor"
        text.put(key, like, f"{scale.by}: {what}. Commissioning and the travel of the sign check prove it")
    else:
        lines = (
            "; some drives tell the lines there, which are a quarter of it"
            if scale.by.startswith(device.label((0x608F, 0)))
            else ""
        )
        from_device = any((device.at(index), sub) in device.answers for index, sub in SCALE_OBJECTS)
        whence = f"{scale.by} of {'the device' if from_device else 'the EDS file'}: {scale.counts_rev:.9g} counts of the position"
        text.put(key, scale.whole, f"{whence} in one turn of the motor{lines}. {WITNESS}")
    _sense(text, device)


def _sense(text: RigText, device: DraftDevice) -> None:
    """Make bring-up write the drive's polarity, so that the measured signs of [mechanics] stay valid."""
    code = device.value(*POLARITY)
    if code is None or not 0 <= code <= 0xFF or not device.has(*POLARITY):
        return
    sense = polarity(code)
    inverted = [name for name, sign in sense._asdict().items() if sign < 0]
    source = f"{device.label(POLARITY)} = 0x{code:02X} of {device.source(*POLARITY)} inverts {' and '.join(inverted) or 'nothing'}"
    variable = device.variable(*POLARITY)
    for key, sign in (("encoder_polarity", sense.position), ("motor_polarity", sense.torque)):
        if sign < 0:
            text.put(f"mechanics.{key}", -text.get(f"mechanics.{key}"), f"{source}; the sign check proves it")
    if variable.bits == 8 and variable.access not in ("ro", "const", "wo"):
        row = {
            "index": device.at(POLARITY[0]),
            "sub": 0,
            "type": "UNSIGNED8",
            "value": code,
            "when": "before",
            "verify": True,
        }
        why = f"{source}; bring-up writes it, as the polarities of [mechanics] go with it"
        text.append(f"{device.node}.sdo", row, why)


def _own_units(text: RigText, device: DraftDevice, maker: MakerMode, rated_Nm: float) -> None:
    """Set the scales of a set-point and an actual torque that are not in per mille of the rated torque."""
    text.put("role.torque_setpoint.object", _spelled(device, maker.setpoint))
    unit = unit_of(device, maker.setpoint)
    if unit in NEWTON_METRES:
        scale, why = NEWTON_METRES[unit], f"the name of {device.label(maker.setpoint)} says {unit}"
    elif maker.unit == "mA" or unit in AMPERES:
        mA = AMPERES.get(unit, 1.0)
        current_mA = device.value(*maker.continuous_mA) if maker.continuous_mA else device.value(0x6075)
        named = device.label(maker.continuous_mA) if maker.continuous_mA else device.label((0x6075, 0))
        whence = f"{named} says {current_mA} mA" if current_mA else f"{GUESSED_mA} mA is a guess"
        scale = float(f"{rated_Nm / (current_mA or GUESSED_mA) * mA:.4g}")
        why = f"Nm for 1 {unit or 'mA'} is the motor's torque constant, see its data sheet; here the rated torque at the rated current ({whence})"
    else:
        scale = float(f"{rated_Nm / 1000:.4g}")
        why = (
            f"the maker's own unit: Nm at the shaft for one count of {device.label(maker.setpoint)}; here a per mille of the rated torque. "
            "If a count is less, the host pushes less than it assumes"
        )
    text.put("role.torque_setpoint.scale_Nm", scale, why)
    if maker.actual is not None and device.entry(maker.actual, "tpdo"):
        text.put("role.torque.object", _spelled(device, maker.actual))
        text.put("role.torque.scale_Nm", scale, "it counts as the set-point does")
    elif place := next((at for at in ((0x6077, 0), (0x6078, 0)) if device.entry(at, "tpdo")), None):
        text.put("role.torque.object", _spelled(device, place))
        text.put(
            "role.torque.scale_Nm", float(f"{rated_Nm / 1000:.4g}"), "per mille of the rated torque, as CiA 402 has it"
        )


def _named_unit(text: RigText, device: DraftDevice) -> None:
    """Set the scale of 6071h and 6077h if their names state a unit other than per mille."""
    for role, index in (("torque_setpoint", 0x6071), ("torque", 0x6077)):
        unit = unit_of(device, (index, 0))
        if unit in NEWTON_METRES:
            text.put(f"role.{role}.object", _spelled(device, (index, 0)))
            text.put(
                f"role.{role}.scale_Nm", NEWTON_METRES[unit], f"the name of {device.label((index, 0))} says {unit}"
            )


def _spelled(device: DraftDevice, place: Place) -> str:
    """Return an object in the rig file's notation."""
    index, subindex = device.at(place[0]), place[1]
    return f"{index:04X}:{subindex:X}" if subindex else f"{index:04X}"
