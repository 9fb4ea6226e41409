"""Rigs whose drive, brake and watches are other makers': the bench with small EDS files, one for
each class of drive, kind of brake and way to notice the host's loss.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from coulombus.rigs.rig import Rig, load_rig_text
from eds_edit import SENSOR, fixed, mapped
from foreign_eds import BRAKE, I16, I32, MOTOR, U8, another, edited, with_array, with_variable, without
from places import RIGS

BENCH, _, _ = (RIGS / "bench.toml").read_text().partition("# The operator's schedule")
SCHEDULE = """
[[phase]]
kind = "rest"
duration_s = 0.6

[[phase]]
kind = "stroke"
duration_s = 4.0
speed_rad_s = 2.0
move_s = 1.0
dwell_s = 1.0
"""
QUICK = ("limits.still_s=0.02", "limits.sign_check_rate_Nm_s=5", "law.gain_ramp_s=0.01")
"""Arming in 0.3 s instead of 1.1 s."""

VOLTS = [[0, 0.0], [2000, 1.0], [6000, 3.5], [9000, 5.0]]
"""A driver that takes 0 to 10 V in mV: its torque is not linear in that."""


@dataclass(frozen=True)
class Part:
    """A device's EDS file, and what the rig file says of it."""

    eds: str
    text: str = ""
    overrides: tuple[str, ...] = ()


def watching(eds: str, watch: str) -> str:
    """Leave a device one way only to notice the host's loss (and our own brake the age of its
    set-point); "all" leaves every one, "none" none.
    """
    if watch == "all":
        return eds
    gone = {
        "deadline": tuple(f"140{k}sub5" for k in range(4)),
        "heartbeat": ("1016",),
        "guarding": ("100C", "100D"),
        "sync": ("2002",),
    }
    return without(eds, *(section for name, sections in gone.items() if name != watch for section in sections))


def _maker(node: str, product: int) -> tuple[str, ...]:
    return (f"{node}.vendor_id=0x99", f"{node}.product_code={product:#x}")


def drive(kind: str, watch: str = "all") -> Part:
    """Return a drive of a class of docs/drives.md, "own" for ours."""
    if kind == "own":
        return Part(watching(MOTOR, watch))
    eds, text, overrides = without(another(MOTOR), "20"), "", _maker("motor", 0x402)
    if kind == "B":
        eds = fixed(eds, *(base + k for base in (0x1600, 0x1A00) for k in range(4)))
        eds = mapped(eds, 0x1600, 0x60600008, 0x60400010, 0x60710010)
        eds = mapped(eds, 0x1A00, 0x60610008, 0x60410010)
        eds = mapped(eds, 0x1A01, 0x606C0020)
        eds = mapped(eds, 0x1A02, 0x60640020, 0x60770010)
    elif kind == "C":
        eds = edited(eds, "6502", DefaultValue="0x8")
    elif kind == "D":
        eds = with_variable(edited(eds, "6502", DefaultValue="0x1"), "2030", I16, 0)
        text, overrides = '\n[role.torque_setpoint]\nobject = "2030"\nscale_Nm = 1e-4\n', (*overrides, "motor.mode=-3")
    return Part(watching(eds, watch), text, overrides)


def brake(kind: str, watch: str = "all") -> Part:
    """Return a brake: "own", "404" in volts with a table, "8ao" of eight outputs and no input,
    "401", "402" that feeds the coil with a current; the last three with the handle torque on
    another node.
    """
    if kind == "own":
        return Part(watching(BRAKE, watch))
    none = "".join(f'\n[role.{role}]\nobject = "none"\n' for role in ("coil_current", "coil_temperature"))
    if watch == "sync":  # a foreign brake has no such thing
        watch = "deadline"
    if kind == "404":
        eds = edited(without(another(BRAKE), "20"), "6301sub1", DefaultValue="0x00260000")
        eds = edited(eds, "7300sub1", HighLimit=10000)
        return Part(watching(eds, watch), f"\n[role.brake_setpoint]\ntable = {VOLTS}\n", _maker("brake", 0x404))
    if kind == "8ao":
        eds = without(another(BRAKE), "20", "61", "63", "71", "73")
        for index, data_type in (("7300", I16), ("6340", U8), ("7341", I16)):
            eds = with_array(eds, index, data_type, 8, "rww" if index == "7300" else "rw")
        text = '\n[role.brake_setpoint]\nobject = "7300:3"\nscale_Nm = 0.00025\n' + none + SENSOR
        return Part(watching(eds, watch), text, _maker("brake", 0x404))
    if kind == "401":
        eds = edited(without(another(BRAKE), "20", "61", "63", "71", "73"), "1000", DefaultValue="0x000F0191")
        eds = with_array(with_array(eds, "6411", I16, 2), "6443", U8, 2, "rw")
        eds = with_array(eds, "6444", I32, 2, "rw")
        text = '\n[role.brake_setpoint]\nobject = "6411:1"\nscale_Nm = 0.0005\n' + none + SENSOR
        return Part(watching(eds, watch), text, _maker("brake", 0x404))
    eds = with_variable(without(another(MOTOR), "20"), "2030", I16, 0)
    text = '\n[role.brake_setpoint]\nobject = "2030"\nscale_Nm = 0.002\n' + none + SENSOR
    return Part(watching(eds, watch), text, (*_maker("brake", 0x402), "brake.mode=-3"))


def rig_text(motor: Part, brake_: Part, text: str = "") -> str:
    """Return the rig file: the bench with these devices, and a hand that moves the handle."""
    return BENCH + SCHEDULE + motor.text + brake_.text + text


def written(folder: Path, motor: Part, brake_: Part, text: str = "", accept: str = "") -> tuple[Path, tuple[str, ...]]:
    """Write the rig file and the EDS files to a folder; return its path, and what is to be set."""
    said = rig_text(motor, brake_, text).replace("[host]\n", f"[host]\naccept = [{accept}]\n")
    files = {"rig.toml": said, "motor.eds": motor.eds, "mr_brake.eds": brake_.eds, "cell.eds": BRAKE}
    for name, content in files.items():
        (folder / name).write_text(content)
    return folder / "rig.toml", (*QUICK, *motor.overrides, *brake_.overrides)


def rig_of(motor: Part, brake_: Part, *overrides: str, text: str = "") -> Rig:
    """Return the rig itself, which arms quickly."""
    texts = {"motor.eds": motor.eds, "mr_brake.eds": brake_.eds, "cell.eds": BRAKE}
    options = (*QUICK, *motor.overrides, *brake_.overrides, *overrides)
    return load_rig_text(rig_text(motor, brake_, text), "rig.toml", texts, options)
