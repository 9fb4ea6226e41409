"""Every kind of mistake in a rig file: its line, its key, what stands there, what is expected, the
nearest name.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from coulombus.rigs.rig import RigError, known_rigs, load_rig, load_rig_text
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
EDS = {name: (ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds")}


def errors(text: str, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(RigError) as caught:
        load_rig_text(text, "r.toml", EDS, overrides)
    assert str(caught.value) == "\n".join(caught.value.errors)
    return caught.value.errors


def changed(*pairs: tuple[str, str]) -> str:
    text = BENCH
    for old, new in pairs:
        assert text.count(old) == 1, f"{old!r} must stand once"
        text = text.replace(old, new)
    return text


def line(text: str, needle: str) -> int:
    assert text.count(needle) == 1, f"{needle!r} must stand once"
    return text[: text.index(needle)].count("\n") + 1


# The mistake: the text in bench.toml and what replaces it; the error behind "r.toml:LINE: ", where
# LINE is the changed one.

WRONG_VALUES = {
    "a text for a number": (
        ("period_s = 0.001 ", 'period_s = "1 ms" '),
        "bus.period_s: got '\"1 ms\"', expected a number from 0.0001 to 1, in s, a whole number of microseconds",
    ),
    "a bool for a number": (
        ("ratio = 9.587       ", "ratio = true"),
        "mechanics.ratio: got 'true', expected a number above 0, at most 10000 (motor revolutions",
    ),
    "a bool for an integer": (
        ("node_id = 127", "node_id = true"),
        "host.node_id: got 'true', expected an integer from 1 to 127",
    ),
    "a bool for a polarity": (
        ("transducer_polarity = 1          #", "transducer_polarity = true #"),
        "mechanics.transducer_polarity: got 'true', expected 1 or -1 (+1: the hand's torque",
    ),
    "a float for a polarity": (
        ("motor_polarity = 1               #", "motor_polarity = 1.0 #"),
        "mechanics.motor_polarity: got '1.0', expected 1 or -1",
    ),
    "polarity 0": (
        ("motor_polarity = 1               #", "motor_polarity = 0 #"),
        "mechanics.motor_polarity: got '0', expected 1 or -1",
    ),
    "a float for an integer": (("node_id = 127", "node_id = 127.0"), "host.node_id: got '127.0', expected an integer"),
    "a number for a text": (('name = "bench"', "name = 3"), "rig.name: got '3', expected a text in double quotes"),
    "an empty text": (('name = "bench"', 'name = ""'), "rig.name: got '\"\"', expected a text in double quotes"),
    "nan": (("coil_A_Nm = 0.2 ", "coil_A_Nm = nan "), "brake.coil_A_Nm: got 'nan', expected a number above 0"),
    "inf": (("speed_rad_s = 15.0", "speed_rad_s = inf"), "limits.speed_rad_s: got 'inf', expected a number above 0"),
    "no float": (("speed_rad_s = 15.0", "speed_rad_s = 1e999"), "limits.speed_rad_s: got 'inf', expected"),
    "a huge integer": (("speed_rad_s = 15.0", f"speed_rad_s = 1{'0' * 400}"), "limits.speed_rad_s: got '1000"),
    "a date": (("hold_s = 0.100 ", "hold_s = 2020-01-01 "), "brake.hold_s: got '2020-01-01', expected a number"),
    "negative": (
        ("inertia_kg_m2 = 5e-4", "inertia_kg_m2 = -5e-4"),
        "operator.inertia_kg_m2: got '-0.0005', expected a number from 0 to 1000, in kg m2",
    ),
    "no mass": (
        ("inertia_kg_m2 = 2.5e-3\nfriction", "inertia_kg_m2 = 0\nfriction"),
        "mechanics.inertia_kg_m2: got '0', expected a number above 0",
    ),
    "node id 0": (("node_id = 127", "node_id = 0"), "host.node_id: got '0', expected an integer from 1 to 127"),
    "node id 128": (("node_id = 127", "node_id = 128"), "host.node_id: got '128', expected an integer from 1 to 127"),
    "compensation": (
        ("compensation = 0.97              # share of", "compensation = 0.98 # of"),
        "mode.active.compensation: got '0.98', expected a number from 0 to 0.97 (share of friction_Nm that the motor compensates)",
    ),
    "a word": (
        ('actuation = "next_sync"', 'actuation = "next_sink"'),
        'bus.actuation: got \'"next_sink"\', expected one of "next_sync", "on_reception" (when the nodes act on an RPDO); '
        "did you mean 'next_sync'?",
    ),
    "parts of a millisecond": (
        ("heartbeat_s = 0.05\nsdo", "heartbeat_s = 0.0505\nsdo"),
        "host.heartbeat_s: got '0.0505', expected a number from 0.001 to 65.535, in s, a whole number of milliseconds",
    ),
    "bit rate": (
        ("bitrate_bit_s = 1_000_000", "bitrate_bit_s = 30_000_000"),
        "bus.bitrate_bit_s: got '30000000', expected an integer from 10000 to 20000000, in bit/s",
    ),
    "travel": (
        ('travel_rad = "unlimited"', 'travel_rad = "free"'),
        'limits.travel_rad: got \'"free"\', expected a number above 0, at most 1e6, in rad, or "unlimited"',
    ),
    "law": (
        ('"karnopp"', '"laws.karnopp"'),
        'law.function: got \'"laws.karnopp"\', expected a law of the project, as "karnopp", "file.py:function" or "module:function"',
    ),
    "law with a digit": (('"karnopp"', '"laws:2nd"'), "law.function: got '\"laws:2nd\"', expected"),
    "too many numbers": (("user = []", f"user = {[0] * 17}"), "law.user: got '[0, 0, 0"),
    "a bool in a list": (
        ("user = []", "user = [1, true]"),
        "law.user: got '[1, true]', expected a list of at most 16 numbers",
    ),
    "a negative tap": (
        ("taps_s = [0.6, 2.1]", "taps_s = [-0.6]"),
        "phase.1.taps_s: got '[-0.6]', expected a list of at most 1000 numbers from 0 on, in s",
    ),
    "a kind": (
        ('kind = "stroke"', 'kind = "strok"'),
        'phase.2.kind: got \'"strok"\', expected one of "rest", "hold", "stroke", "paper", "file", "motion", '
        '"tip_hold", "tip_line", "tip_circle", "tip_eight"; did you mean \'stroke\'?',
    ),
}
WRONG_KEYS = {
    "a key": (
        ("sdo_timeout_s", "sdo_timeot_s"),
        "host.sdo_timeot_s: unknown key; expected one of the keys of [host]: node_id, heartbeat_s, sdo_timeout_s, compute_s, deadman, "
        "loss_limit, accept; did you mean 'sdo_timeout_s'?",
    ),
    "a key of another section": (
        ("sdo_timeout_s = 0.5", "step_s = 0.5"),
        "host.step_s: unknown key; expected one of the keys of [host]: node_id, heartbeat_s, sdo_timeout_s, compute_s, deadman, loss_limit, accept; "
        "did you mean 'plant.step_s'?",
    ),
    "a key of two other sections": (
        ("sdo_timeout_s = 0.5", "ratio = 0.5"),
        "host.ratio: unknown key; expected one of the keys of [host]: node_id, heartbeat_s, sdo_timeout_s, compute_s, deadman, loss_limit, accept; "
        "did you mean 'mechanics.ratio' or 'plant.ratio'?",
    ),
    "a key of another kind": (
        ("dwell_s = 1.0\n", "dwell_s = 1.0\npush_F_s = 1\n"),
        "phase.2.push_F_s: unknown key; expected one of the keys of [phase.2]: ",
    ),
    "a key in another mode": (
        ("F_d_Nm = 1.0", "F_d_Nm = 1.0\nF_c_Nm = 1.0"),
        "mode.active.F_c_Nm: unknown key; expected one of the keys of [mode.active]: K_p_Nm_rad, F_s_Nm, F_d_Nm, ",
    ),
    "a key twice": (
        ("coil_continuous_A = 0.8 ", "coil_A_Nm = 0.2\ncoil_continuous_A = 0.8 "),
        "brake.coil_A_Nm: is in line 38 already; expected each key once",
    ),
    "a section twice": (("[law]\n", "[bus]\nx = 1\n[law]\n"), "[bus]: is in line 8 already; expected it once"),
}
WRONG_TOML = {
    "a decimal comma": (
        ("hold_s = 0.100 ", "hold_s = 0,1 "),
        "brake.hold_s: '0,1' ",
        "a decimal point instead of the comma",
    ),
    "a unit": (
        ("hold_s = 0.100 ", "hold_s = 100ms "),
        "brake.hold_s: '100ms' ",
        "a number alone: leave the unit off, which stands in the key's name",
    ),
    "no digit before the point": (
        ("hold_s = 0.100 ", "hold_s = .1 "),
        "brake.hold_s: '.1' ",
        "digits on both sides of the decimal point",
    ),
    "no digit behind the point": (
        ("hold_s = 0.100 ", "hold_s = 1. "),
        "brake.hold_s: '1.' ",
        "digits on both sides of the decimal point",
    ),
    "a leading zero": (("hold_s = 0.100 ", "hold_s = 01 "), "brake.hold_s: '01' ", "a number without leading zeros"),
    "no value": (("hold_s = 0.100 ", "hold_s = "), "brake.hold_s: '' ", "a value behind the ="),
    "no quotes": (
        ('actuation = "next_sync"', "actuation = next_sync"),
        "bus.actuation: 'next_sync' ",
        "a text in double quotes",
    ),
    "a capital": (("hold_s = 0.100 ", "hold_s = True "), "brake.hold_s: 'True' ", "true or false, in small letters"),
    "no closing bracket": (
        ("user = []", "user = [1, 2"),
        "law.user: '[1, 2' ",
        "a list of values with commas between them and a closing ]",
    ),
    "no comma": (
        ("user = []", "user = [1 2]"),
        "law.user: '[1 2]' ",
        "a list of values with commas between them and a closing ]",
    ),
    "no closing quote": (('name = "bench"', 'name = "bench'), "rig.name: '\"bench' ", "a text with a closing quote"),
    "no equals sign": (
        ("ramp_s = 0.500", "ramp_s 0.500"),
        "'ramp_s 0.500' ",
        "key = value, [section] or a comment after #",
    ),
    "no bracket at the end": (("[limits]", "[limits"), "'[limits' ", "[section]"),
    "no bracket at the start": (("[limits]", "limits]"), "'limits]' ", "[section]"),
    "no section's name": (("[limits]", "[]"), "'[]' ", "[section]"),
}
BETWEEN_KEYS = {
    "node ids": (
        ("node_id = 2\n", "node_id = 1\n"),
        "brake.node_id: got '1', expected another id than motor.node_id, which is 1",
    ),
    "passive with a motor": (
        ("motor_limit_Nm = 0.0", "motor_limit_Nm = 0.1"),
        "mode.passive.motor_limit_Nm: got '0.1', expected 0: the motor has no part in this mode",
    ),
    "beyond 6071": (
        ("motor_limit_Nm = 1.5 ", "motor_limit_Nm = 60 "),
        "mode.active.motor_limit_Nm: got '60', expected at most 32.767 x motor.rated_torque_Nm x mechanics.ratio",
    ),
    "deadline and period": (
        ("setpoint_fault_s = 0.010         # RPDO deadline: fault", "setpoint_fault_s = 0.001 # fault"),
        "motor.setpoint_fault_s: got '0.001', expected more than bus.period_s, which is 0.001",
    ),
    "window and period": (
        ("tpdo_window_s = 740e-6", "tpdo_window_s = 2e-3"),
        "bus.tpdo_window_s: got '0.002', expected less than bus.period_s, which is 0.001",
    ),
    "off-state and maximum": (
        ("brake_off_state_Nm = 0.08", "brake_off_state_Nm = 8"),
        "plant.brake_off_state_Nm: got '8', expected at most plant.brake_max_Nm, which is 5.0",
    ),
    "period and step": (
        ("period_s = 0.001 ", "period_s = 0.001010 "),
        "bus.period_s: got '0.00101', expected a whole multiple of plant.step_s, which is 5e-05",
    ),
}


def changed_line(text: str) -> int:
    return next(i for i, (a, b) in enumerate(zip(text.split("\n"), BENCH.split("\n"), strict=False), 1) if a != b)


@pytest.mark.parametrize(
    ("change", "expected"),
    [*WRONG_VALUES.values(), *WRONG_KEYS.values(), *BETWEEN_KEYS.values()],
    ids=[*WRONG_VALUES, *WRONG_KEYS, *BETWEEN_KEYS],
)
def test_one_mistake_gives_one_error_with_its_line(change: tuple[str, str], expected: str) -> None:
    text = changed(change)
    (error,) = errors(text)
    assert error.startswith(f"r.toml:{changed_line(text)}: {expected}")
    assert " expected " in error


@pytest.mark.parametrize(("change", "what", "hint"), WRONG_TOML.values(), ids=WRONG_TOML)
def test_what_is_no_toml_gives_one_error_with_a_hint(change: tuple[str, str], what: str, hint: str) -> None:
    text = changed(change)
    (error,) = errors(text)
    assert error.startswith(f"r.toml:{changed_line(text)}: {what}cannot be read")
    assert error.endswith(f"; expected {hint}")


@pytest.mark.parametrize(
    ("change", "needle", "expected"),
    [
        (
            ("step_s = 50e-6", "step_s = 30e-6"),
            "period_s = 0.001 ",
            "bus.period_s: got '0.001', expected a whole multiple of plant.step_s, which is 3e-05",
        ),
        (
            ("viscous_Nms_rad = 0.005\n\n[law]", "\n[law]"),
            "[mechanics]",
            "mechanics.viscous_Nms_rad: missing in [mechanics]; expected a number from 0 to 1000, in Nm s/rad (identified",
        ),
        (
            ('kind = "stroke"\n', ""),
            "[[phase]]\nduration_s = 8",
            'phase.2.kind: missing in [[phase]]; expected one of "rest", "hold", "stroke", "paper", "file", "motion"',
        ),
    ],
)
def test_a_mistake_is_shown_where_its_key_or_section_stands(
    change: tuple[str, str], needle: str, expected: str
) -> None:
    text = changed(change)
    (error,) = errors(text)
    assert error.startswith(f"r.toml:{line(text, needle)}: {expected}")


def test_a_misspelt_section() -> None:
    text = changed(("[law]\n", "[lw]\n"))
    assert errors(text) == (f"r.toml:{line(text, '[lw]')}: lw: unknown section; did you mean [law]?",)
    missing, unknown = errors(changed(("[law]\n", "[friction]\n")))
    assert missing == "r.toml:1: law: the section is missing; expected [law] (the friction law)"
    assert unknown.startswith(f"r.toml:{line(text, '[lw]')}: friction: unknown section; expected one of the sections: ")


def test_heartbeats_are_faster_than_what_watches_them() -> None:
    text = changed(("heartbeat_s = 0.05\nsdo", "heartbeat_s = 0.2\nsdo"))
    number = line(text, "heartbeat_s = 0.2")
    assert errors(text) == tuple(
        f"r.toml:{number}: host.heartbeat_s: got '0.2', expected less than {node}.heartbeat_timeout_s, which is 0.15"
        for node in ("motor", "brake")
    )


def test_all_mistakes_at_once_in_the_order_of_the_lines() -> None:
    text = changed(
        ('name = "bench"', "name = bench"),
        ("bitrate_bit_s", "bitrat_bit_s"),
        ("ratio = 9.587       ", "ratio = 0"),
        ("user = []", "user = [1,"),
        ("[mode.passive]", "[mode.pasive]"),
        ("net_work_J = 0.15", "net_work_J = 0.15 J"),
        ("dwell_s = 1.0", ""),
    )
    mistakes = errors(text, "plant.coulomb_Nm=-1", "operator.inerta_kg_m2=1")
    assert [error.split(": ")[1] for error in mistakes] == [
        "rig.name",
        "bus.bitrate_bit_s",
        "bus.bitrat_bit_s",
        "mechanics.ratio",
        "law.user",
        "mode.pasive",
        "limits.net_work_J",
        "phase.2.dwell_s",
        "plant.coulomb_Nm",
        "operator.inerta_kg_m2",
    ]
    assert mistakes[-1].startswith("--set operator.inerta_kg_m2=1: operator.inerta_kg_m2: unknown key; ")


def test_an_empty_file_misses_every_section() -> None:
    mistakes = errors("")
    assert len(mistakes) == 9
    assert not any(name in text for text in mistakes for name in ("plant", "operator"))  # the host needs none of them
    assert mistakes[0] == "r.toml:1: rig: the section is missing; expected [rig] (what the rig is called)"


def test_sections_of_the_wrong_shape() -> None:
    text = BENCH[: BENCH.index("[[phase]]")]
    assert "expected [[phase]] in double brackets" in errors(text + '[phase]\nkind = "rest"\nduration_s = 1\n')[0]
    assert "phase.0: got '3', expected" in errors("phase = [3]\n" + text)[0]
    assert "bus: got '3', expected a section" in errors("bus = 3\n" + text.replace("[bus]", "[host.bus]"))[0]


def test_a_file_that_is_no_utf8(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_bytes(
        changed(("740e-6", "740e-6 # 740 \N{MICRO SIGN}s"), ("node_id = 127", "node_id = 128")).encode("cp1252")
    )
    with pytest.raises(RigError) as caught:
        load_rig(str(path))
    number = line(BENCH, "740e-6")
    assert caught.value.errors[0] == f"{path}:{number}: the byte 0xB5 is not UTF-8; save the file as UTF-8"
    assert "host.node_id: got '128'" in caught.value.errors[1]


def test_names_and_paths(tmp_path: Path) -> None:
    assert {"bench", "paper"} <= set(known_rigs())
    with pytest.raises(RigError) as caught:
        load_rig("benhc")
    expected = f"expected one of {', '.join(known_rigs())}, or a path such as ./benhc.toml; did you mean 'bench'?"
    assert str(caught.value) == f"--rig benhc: no rig of this name; {expected}"
    with pytest.raises(
        RigError, match=r"nowhere\.toml: cannot be read \(No such file or directory\); expected a rig file"
    ):
        load_rig("nowhere.toml")
    with pytest.raises(RigError, match=r"cannot be read \(is a directory, not a regular file\)"):
        load_rig(f"{tmp_path}/")


def test_what_is_no_regular_file_is_refused_at_once_and_not_waited_for(tmp_path: Path) -> None:
    """Nobody writes to these FIFOs: reading one would never end."""
    rig = tmp_path / "rig.toml"
    for name in ("fifo.toml", "fifo.eds", "fifo.csv"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(RigError, match=r"fifo\.toml: cannot be read \(is a FIFO, not a regular file\)"):
        load_rig(str(tmp_path / "fifo.toml"))
    with pytest.raises(RigError, match=r"cannot be read \(is a device, not a regular file\)"):
        load_rig("/dev/zero")
    for name, kind in (("fifo.eds", "a FIFO"), ("/dev/zero", "a device"), (str(tmp_path), "a directory")):
        rig.write_text(changed(('eds = "motor.eds" ', f'eds = "{name}" ')))
        with pytest.raises(RigError, match=f"motor.eds: .* is {kind}, not a regular file; expected an EDS or DCF file"):
            load_rig(str(rig))
    rig.write_text(BENCH + '\n[[phase]]\nkind = "file"\npath = "fifo.csv"\n')
    with pytest.raises(RigError, match=r"fifo\.csv:1: cannot be read \(is a FIFO, not a regular file\)"):
        load_rig(str(rig))


@pytest.mark.parametrize(
    "header", sorted(set(re.findall(r"^\[+([a-z_.]+)\]+", (RIGS / "bench.toml").read_text(), re.M)))
)
def test_a_misspelt_section_is_one_mistake_in_its_line(tmp_path, header):
    text = (RIGS / "bench.toml").read_text()
    place = re.search(rf"^\[+{re.escape(header)}\]+", text, re.M).start()
    wrong = header.replace(header[1], header[1] * 2, 1)
    path = tmp_path / "rig.toml"
    path.write_text(text[:place] + text[place:].replace(header, wrong, 1))
    with pytest.raises(RigError) as caught:
        load_rig(str(path))
    (error,) = caught.value.errors
    assert error.startswith(f"{path}:{text.count(chr(10), 0, place) + 1}: {wrong.partition('.')[0]}")
