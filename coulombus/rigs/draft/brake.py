"""Draft [brake] and the sensors: CiA 404, 401, or a drive in a torque or current mode."""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.eds.units import BLOCK_UNITS
from coulombus.rigs.draft.device import DraftDevice, Place, label
from coulombus.rigs.draft.draft_text import RigText
from coulombus.rigs.draft.motor import command_of, describe_mode
from coulombus.rigs.errors import Problem, RigError
from coulombus.rigs.roles import CIA401, CIA402, CIA404, UNITS, profile_of

__all__ = ["describe_brake", "describe_sensors"]

VOLT = 0x26
"""Notation index of CiA 303-2."""
FULL_SCALE_V = 10.0
OUTPUTS: dict[int, tuple[Place, ...]] = {CIA404: ((0x7300, 1), (0x9300, 1)), CIA401: ((0x6411, 1),)}
INPUTS: tuple[Place, ...] = ((0x7130, 1), (0x9130, 1), (0x6401, 1))
"""Objects in which a torque transducer's amplifier may have its value: CiA 404 in 16 and in 32 bits, CiA 401.
"""


def describe_brake(text: RigText, device: DraftDevice) -> None:
    """Set [brake], and the roles of a third-party driver."""
    text.note(
        "brake.coil_A_Nm", "of your brake's data sheet; so are its continuous current and its time constant", "CHECK"
    )
    text.note("brake.rated_torque_Nm", "of your brake's data sheet", "CHECK")
    if profile_of(device.description, "brake") == CIA402:
        _drive(text, device)
        return
    places = OUTPUTS[profile_of(device.description, "brake")]
    place = next((at for at in places if device.entry(at, "rpdo")), None)
    if place is None:
        raise _no_output(device, places)
    if place != places[0]:
        text.put("role.brake_setpoint.object", f"{place[0]:04X}:{place[1]:X}")
    unit, step = _unit(device, place)
    if unit == UNITS["Nm"]:
        return
    rated_Nm = text.get("brake.rated_torque_Nm")
    largest = _largest(device, place)
    if unit == UNITS["A"]:
        amperes = rated_Nm * text.get("brake.coil_A_Nm")
        full, why = amperes / step, f"{amperes:g} A, by brake.coil_A_Nm"
    elif unit == VOLT:
        full, why = FULL_SCALE_V / step, f"{FULL_SCALE_V:g} V"
    else:
        full, why = largest, "the largest count, in a unit that the EDS file does not tell"
    full = max(1, round(min(full, largest)))
    text.put(
        "role.brake_setpoint.table",
        [[0, 0.0], [full, float(rated_Nm)]],
        f"{label(place)} counts up to {full} ({why}), taken for the whole torque. Measure your brake: up to 16 points [raw, Nm]",
    )


def _no_output(device: DraftDevice, places: Sequence[Place]) -> RigError:
    objects = " or ".join(map(label, places))
    text = f"{device.description.path}: no analogue output that a PDO can carry: {objects} is not described, or not mappable"
    remedy = "take a driver with one (CiA 404, CiA 401), or a CiA 402 drive with a torque or current set-point"
    problem = Problem("brake_setpoint", device.node, label(places[0]), text, remedy)
    return RigError([f"{device.node}: {problem}"], [problem])


def _drive(text: RigText, device: DraftDevice) -> None:
    """Describe a brake whose coil is fed by a CiA 402 drive."""
    command = command_of(device)
    describe_mode(text, device, command)
    coil_A_Nm, rated_Nm = text.get("brake.coil_A_Nm"), text.get("brake.rated_torque_Nm")
    if command.maker is not None and command.maker.unit == "mA":
        scale, why = 1e-3 / coil_A_Nm, "the set-point is in mA: 0.001 / brake.coil_A_Nm"
    elif command.maker is None and (rated_mA := device.value(0x6075)):
        scale, why = rated_mA * 1e-6 / coil_A_Nm, f"per mille of 6075h = {rated_mA} mA, over brake.coil_A_Nm"
    else:
        scale, why = (
            rated_Nm / 1000,
            "1000 counts are taken for the whole braking torque: see the drive's rated current",
        )
    if command.maker is not None:
        index, subindex = command.maker.setpoint
        text.put("role.brake_setpoint.object", f"{index:04X}:{subindex:X}" if subindex else f"{index:04X}")
    text.put("role.brake_setpoint.scale_Nm", float(f"{scale:.4g}"), why)


def describe_sensors(text: RigText, devices: Sequence[DraftDevice]) -> None:
    """Bind the handle torque to the first sensor that has an analogue input.

    The others are only monitored.
    """
    for device in devices:
        place = next((at for at in INPUTS if device.entry(at, "tpdo")), None)
        if place is None or text.get("role.handle_torque.node"):
            text.note(
                f"sensor.{device.node}",
                "no role is bound to this node: name one in [role.NAME], or take it out",
                "CHECK",
            )
            continue
        text.put("role.handle_torque.node", device.node)
        text.put("role.handle_torque.object", f"{place[0]:04X}:{place[1]:X}")
        unit, step = _unit(device, place)
        if unit == UNITS["Nm"] and place[0] == INPUTS[0][0]:
            continue
        full = FULL_SCALE_V / step if unit == VOLT else _largest(device, place)
        if unit == UNITS["Nm"]:
            full = text.get("brake.rated_torque_Nm") / step
        scale = float(f"{text.get('brake.rated_torque_Nm') / full:.4g}")
        range_ = f"{FULL_SCALE_V:g} V" if unit == VOLT else f"{full:g} counts"
        why = f"Nm for one count of {label(place)}: {range_} taken for brake.rated_torque_Nm; see the transducer's data sheet"
        text.put("role.handle_torque.scale_Nm", scale, why)


def _unit(device: DraftDevice, place: Place) -> tuple[int, float]:
    """Return the notation index of an object's unit, and the value of one count; (0, 1) if unknown."""
    index, subindex = place
    if index not in BLOCK_UNITS:
        return 0, 1.0
    code, digits = (device.value(object_, subindex) for object_ in BLOCK_UNITS[index])
    if code is None or code >> 8 & 0xFF:  # with a denominator
        return 0, 1.0
    prefix = (code >> 24 & 0xFF) - (0x100 if code >> 31 & 1 else 0)
    return code >> 16 & 0xFF, 10.0 ** (prefix - min(max(digits or 0, 0), 9))


def _largest(device: DraftDevice, place: Place) -> float:
    """Return the largest value of an object, within the host's number range."""
    return min(device.description.variable(*place).largest, 2.0**31 - 1)
