"""The rig file: what is read, what is refused and in which words, overrides, the effective
configuration, the document.
"""

from __future__ import annotations

import copy
import pickle
import re
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, fields, is_dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.rigs.axis import Sections
from coulombus.rigs.devices import Roles, Sdo, Sensor
from coulombus.rigs.field_help import accepted_range, fields_of, kinds_of, unit_of
from coulombus.rigs.frozen_map import FrozenMap
from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
EDS = {name: (ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds")}


def errors(text: str, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(RigError) as caught:
        load_rig_text(text, "r.toml", EDS, overrides)
    assert str(caught.value) == "\n".join(caught.value.errors)
    return caught.value.errors


def line(text: str, needle: str) -> int:
    assert text.count(needle) == 1, f"the needle {needle!r} must stand once"
    return text[: text.index(needle)].count("\n") + 1


def changed(*pairs: tuple[str, str]) -> str:
    text = BENCH
    for old, new in pairs:
        assert text.count(old) == 1, f"{old!r} must stand once"
        text = text.replace(old, new)
    return text


# What is read.


def test_bench_is_what_its_file_says() -> None:
    rig = load_rig("bench")
    axis = rig.one_axis()
    assert (rig.host.node_id, axis.motor.node_id, axis.brake.node_id) == (127, 1, 2)
    assert rig.bus.bitrate_bit_s == 1_000_000
    assert rig.bus.period_ns == 1_000_000
    assert axis.simulation.plant.step_ns == 50_000
    assert rig.bus.transmission == 1
    assert axis.motor.vendor_id == 0x4C0
    assert axis.mechanics.ratio == 9.587
    assert axis.mode["active"].F_s_Nm == 1.2
    assert list(rig.modes) == ["active", "passive", "hybrid"]
    assert [phase.kind for phase in axis.phases] == ["rest", "hold", "stroke"]
    assert axis.phases[1].taps_s == (0.6, 2.1)
    assert axis.limits.travel_limit_rad == np.inf
    assert rig.text == BENCH
    assert rig.overrides == ()
    assert rig.warnings == ()
    assert rig.name == "bench"
    assert Path(rig.path).name == "bench.toml"
    assert axis.description("brake").has(0x7300, 1)


def test_paper_is_section_4() -> None:
    rig = load_rig("paper")
    axis = rig.one_axis()
    plant = axis.simulation.plant
    assert (plant.inertia_kg_m2, plant.viscous_Nms_rad) == (0.1, 0.5)
    assert (
        axis.simulation.operator.inertia_kg_m2,
        axis.simulation.operator.damping_Nms_rad,
        axis.simulation.operator.stiffness_Nm_rad,
    ) == (
        1.287,
        29.33,
        178,
    )
    plant, hand = plant, axis.simulation.operator
    nothing = (plant.coulomb_Nm, plant.motor_lag_s, plant.brake_coil_lag_s, plant.brake_fluid_lag_s, hand.tremor_Nm)
    assert nothing == (0, 0, 0, 0, 0)
    assert (plant.brake_off_state_Nm, plant.transducer_noise_Nm, axis.mechanics.friction_Nm) == (0, 0, 0)
    assert 2 * np.pi / (plant.encoder_counts_rev * plant.ratio) <= 1e-6, "1 um or finer"
    assert plant.motor_rated_torque_Nm * plant.ratio * min(plant.motor_peak_ratio, 32.767) >= 10
    for mode in rig.modes:
        assert (axis.mode[mode].F_s_Nm, axis.mode[mode].F_d_Nm, axis.mode[mode].compensation) == (10, 10, 0)
    assert axis.law.function == "coulomb"
    assert [(phase.kind, phase.duration_s) for phase in axis.phases] == [("rest", 2), ("paper", 10)]
    assert rig.warnings == ()


def test_paper_limits_do_not_trip_where_nothing_resists() -> None:
    """Without friction the motion is largest: semi-implicit steps of (m + 1.287) v' + 29.83 v + 178
    x = f_h.
    """
    rig = load_rig("paper")
    axis = rig.one_axis()
    x = v = 0.0
    h, far, fast = 1e-4, 0.0, 0.0
    for k in range(100_000):
        t = k * h
        force = 40 * np.sin(np.pi**2 / 4 * t) + np.sin(np.pi / 8 * t) + 2 * (1 - np.cos(np.pi / 2 * t))
        v += h * (force - 29.83 * v - 178 * x) / 1.387
        x += h * v
        far, fast = max(far, abs(x)), max(fast, abs(v))
    assert 0.2 < far < 0.3
    assert 3 * far < axis.limits.travel_limit_rad
    assert 3 * fast < axis.limits.speed_rad_s
    assert 3 * fast * 1e-3 * axis.motor.encoder_counts_rev / (2 * np.pi) < axis.limits.encoder_jump_counts


def mutable(value: object, where: str) -> Iterator[str]:
    """Yield where in a value something can be changed."""
    if isinstance(value, BaseModel):
        parts = [(key, getattr(value, key)) for key in type(value).model_fields]
        changeable = not value.model_config.get("frozen")
    elif is_dataclass(value):
        parts = [(attribute.name, getattr(value, attribute.name)) for attribute in fields(value)]
        changeable = not type(value).__dataclass_params__.frozen  # type: ignore[attr-defined]
    elif isinstance(value, FrozenMap):
        with pytest.raises(AttributeError, match="cannot be changed"):
            value.pairs = ()
        parts, changeable = list(value.items()), False
    elif isinstance(value, tuple | MappingProxyType):
        items = value if isinstance(value, tuple) else [*value.values(), *value]
        parts, changeable = [(str(n), item) for n, item in enumerate(items)], False
    else:
        parts = []
        array = isinstance(value, np.ndarray) and not value.flags.writeable
        changeable = not (value is None or array or isinstance(value, str | int | float | bytes | frozenset))
    if changeable:
        yield f"{where}: {type(value).__name__}"
    for name, part in parts:
        yield from mutable(part, f"{where}.{name}")


@pytest.mark.parametrize("name", ["bench", "two_axes"])
def test_nothing_of_a_rig_can_be_changed(name: str) -> None:
    rig = load_rig(name, ['phase=[{kind="file", duration_s=1.0, t_s=[0.0, 1.0], torque_Nm=[0.0, 1.0]}]'])
    assert list(mutable(rig, "rig")) == []
    with pytest.raises(FrozenInstanceError):
        rig.axes = ()  # type: ignore[misc]
    with pytest.raises(ValidationError):
        rig.axes[0].name = "other"


def test_a_rig_is_frozen_hashable_and_survives_pickle() -> None:
    rig = load_rig("bench")
    axis = rig.one_axis()
    with pytest.raises(ValidationError):
        axis.simulation.plant.step_s = 1e-5  # type: ignore[misc]
    with pytest.raises(ValidationError):
        axis.mode["active"].F_s_Nm = 2.0  # type: ignore[misc]
    again = pickle.loads(pickle.dumps(rig))
    assert again == rig
    assert hash(again) == hash(rig)
    assert again.pdos() == rig.pdos()
    assert copy.deepcopy(rig) is rig
    assert rig != load_rig("paper")
    assert "nonsense" not in rig.modes
    with pytest.raises(KeyError, match="no mode 'nonsense'; it has active, passive, hybrid"):
        axis.mode["nonsense"]


def test_motor_limit_by_mode() -> None:
    rig = load_rig("bench", ["mode.hybrid.motor_limit_Nm=1.0"])
    axis = rig.one_axis()
    assert motor_limit_Nm(axis, "active") == 1.5
    assert motor_limit_Nm(axis, "hybrid") == pytest.approx(0.168)
    assert motor_limit_Nm(axis, "passive") == 0


def test_defaults_are_there_only_where_they_are_harmless() -> None:
    text = re.sub(
        r"(?m)^(description|sdo_timeout_s|gain_ramp_s|user|tremor_\w+|transducer_noise_Nm|taps_s) *=.*$", "", BENCH
    )
    rig = load_rig_text(text, "r.toml", EDS)
    axis = rig.one_axis()
    assert (rig.host.sdo_timeout_s, axis.law.user, axis.simulation.operator.tremor_Nm, axis.phases[1].taps_s) == (
        0.5,
        (),
        0.0,
        (),
    )
    for key in ("motor_polarity", "encoder_polarity", "transducer_polarity"):
        for section in ("mechanics", "plant"):
            head = re.escape(f"[{section}]")
            without = re.sub(rf"(?s)({head}.*?)\n{key} = 1[^\n]*", r"\1", BENCH)
            assert len(without) < len(BENCH)
            (error,) = errors(without)
            assert f"{section}.{key}: missing in [{section}]; expected 1 or -1" in error


def test_a_schedule_may_be_absent_and_one_mode_is_enough() -> None:
    text = BENCH[: BENCH.index("[[phase]]")]
    text = re.sub(r"(?s)\[mode\.passive\].*?\[limits\]", "[limits]", text)
    rig = load_rig_text(text, "r.toml", EDS)
    assert rig.one_axis().phases == ()
    assert list(rig.modes) == ["active"]
    (error,) = errors(re.sub(r"(?s)\[mode\.active\].*?\[limits\]", "[mode]\n[limits]", text))
    assert "mode: no mode is given; expected at least one of [mode.active]" in error


def test_windows_line_ends_and_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_bytes(b"\xef\xbb\xbf" + BENCH.replace("\n", "\r\n").encode())
    assert load_rig(str(path)) == load_rig("bench")
    path.write_bytes(b"\xef\xbb\xbf" + changed(("period_s = 0.001 ", "period_s = -1 ")).replace("\n", "\r\n").encode())
    with pytest.raises(RigError) as caught:
        load_rig(str(path))
    assert caught.value.errors[0].startswith(f"{path}:{line(BENCH, 'period_s = 0.001 ')}: bus.period_s: got '-1'")


# EDS files.


def test_eds_files_are_looked_for_beside_the_rig_file_first(tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text(BENCH, encoding="utf-8")
    assert load_rig(str(path)).eds_texts == EDS
    own = EDS["motor.eds"].replace("ProductName=", "ProductName=Own ", 1)
    (tmp_path / "motor.eds").write_text(own, encoding="utf-8")
    rig = load_rig(str(path))
    assert rig.one_axis().description("motor").path == str(tmp_path / "motor.eds")
    assert rig.eds_texts == {"motor.eds": own, "mr_brake.eds": EDS["mr_brake.eds"]}
    assert rig != load_rig("bench"), "another drive is another rig"


def test_eds_mistakes(tmp_path: Path) -> None:
    number = line(BENCH, 'eds = "motor.eds"')
    (error,) = errors(changed(('"motor.eds"', '"motr.eds"')))
    assert error.startswith(f"r.toml:{number}: motor.eds: got 'motr.eds', but its text is not given; expected one of")
    path = tmp_path / "r.toml"
    path.write_text(changed(('"motor.eds"', '"motr.eds"'), ('"mr_brake.eds"', '"empty.eds"')), encoding="utf-8")
    (tmp_path / "empty.eds").write_text("; nothing\n", encoding="utf-8")
    with pytest.raises(RigError) as caught:
        load_rig(str(path))
    missing, empty = caught.value.errors
    assert missing.startswith(
        f"{path}:{number}: motor.eds: got 'motr.eds', but there is no such file; looked for {tmp_path}"
    )
    assert missing.endswith("did you mean 'motor.eds'?")
    assert f"brake.eds: got 'empty.eds', but {tmp_path / 'empty.eds'}:1: " in empty


def test_a_recording_needs_no_files() -> None:
    rig = load_rig("bench", ["motor.node_id=9"])
    again = load_rig_text(rig.effective(), "in a recording", rig.eds_texts)
    assert again == rig
    assert again.one_axis().description("brake").path == "mr_brake.eds"
    assert again.pdos() == rig.pdos()


# Overrides.


def test_overrides_set_any_key() -> None:
    given = [
        "mode.active.F_s_Nm=1.0",
        "phase.1.duration_s=2",
        "bus.actuation=on_reception",
        'rig.name="x y"',
        "law.user=[1, 2]",
        "law.user.1=3",
        "limits.travel_rad=2",
        "plant.motor_polarity=-1",
        "plant.motor_polarity=1",
    ]
    rig = load_rig("bench", given)
    axis = rig.one_axis()
    assert axis.mode["active"].F_s_Nm == 1.0
    assert axis.phases[1].duration_s == 2.0
    assert rig.bus.transmission == 255
    assert rig.name == "x y"
    assert axis.law.user == (1.0, 3.0)
    assert axis.limits.travel_limit_rad == 2.0
    assert axis.simulation.plant.motor_polarity == 1
    assert rig.overrides == tuple(given)
    assert rig.text == BENCH
    assert rig.variant("mode.active.F_s_Nm=1.1").one_axis().mode["active"].F_s_Nm == 1.1


def test_a_mistake_in_a_variant_stands_where_it_was_given():
    """It was said to stand in a line of the file, where something else stands."""
    given = ("law.function=a.py:f",)
    rig = load_rig("bench", given)
    for variant in (rig, rig.variant(), rig.variant("mode.active.F_s_Nm=1.1"), load_rig("bench").variant(*given)):
        assert "--set law.function=a.py:f: law.function: " in str(variant.one_axis().mistake("law.function", "a law"))
    two = load_rig("two_axes").variant(*given)
    assert all("--set law.function=a.py:f: " in str(axis.mistake("law.function", "a law")) for axis in two.axes)
    variant = load_rig("bench").variant("mode.active.F_s_Nm=1.1")
    assert str(variant.one_axis().mistake("law.function", "a law")) == str(
        load_rig("bench").one_axis().mistake("law.function", "a law")
    )


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("bus.period_s=1ms", "bus.period_s: got '\"1ms\"', expected a number from 0.0001 to 1, in s"),
        ("mode.active.F_s=1", "mode.active.F_s: unknown key; expected one of the keys of [mode.active]"),
        ("mode.activ.F_s_Nm=1", "mode.activ: unknown key; expected one of the keys of [mode]: active, passive, hybrid; did you mean 'active'?"),
        ("phase.3.duration_s=1", "phase.3: there are 3 entries in phase; expected phase.0 to phase.2"),
        ("phase.hold.duration_s=1", "phase.hold: there are 3 entries"),
        ("period_s=1", "period_s: unknown section; expected one of the sections: "),
        ("bus.period_s.x=1", "bus.period_s.x: bus.period_s is a value, no section"),
        ("bus.period_s", "cannot be read; expected SECTION.KEY=VALUE, such as mode.active.F_s_Nm=1.0"),
        ("bus.period_s=", "cannot be read; expected SECTION.KEY=VALUE"),
        ("=1", "cannot be read; expected SECTION.KEY=VALUE"),
        ("bus.period_s=0.001\nx = 1", "bus.period_s: "),
        ("law.user=[" + "[" * 3000, "law.user: "),
        ("plant.ratio=" + "9" * 5000, "plant.ratio: "),
    ],
)  # fmt: skip
def test_an_override_that_is_wrong_shows_as_it_was_given(override: str, expected: str) -> None:
    (error,) = errors(BENCH, override)
    assert error.startswith(f"--set {override}: {expected}")


@pytest.mark.parametrize(
    ("override", "other"),
    [("motor.node_id=2", "motor.node_id, which is 2"), ("plant.step_s=7e-6", "plant.step_s, which is 7e-06")],
)
def test_a_mistake_between_two_keys_is_shown_at_the_key_that_the_rule_is_about(override: str, other: str) -> None:
    (error,) = errors(BENCH, override)
    assert error.startswith("r.toml:")
    assert other in error


# The effective configuration.


@pytest.mark.parametrize("name", ["bench", "paper"])
def test_effective_configuration_gives_an_equal_rig(name: str) -> None:
    rig = load_rig(
        name,
        [
            "plant.coulomb_Nm=0.1",
            'rig.description="quotes \\" \\\\ \N{MICRO SIGN}"',
            'host.accept=["\\u007f \\n"]',
            "limits.travel_rad=1",
        ],
    )
    again = load_rig_text(rig.effective(), name, rig.eds_texts)
    assert again == rig
    assert again.one_axis().model_dump() == rig.one_axis().model_dump()
    assert again.effective() == rig.effective()
    assert again.one_axis().simulation.plant.coulomb_Nm == 0.1
    assert again.about.description == 'quotes " \\ \N{MICRO SIGN}'
    assert again.host.accept == ("\x7f \n",)


# Schedules from CSV files.


def _with_schedule(folder: Path, content: str, extra: str = "") -> Path:
    path = folder / "r.toml"
    path.write_text(BENCH + f'\n[[phase]]\nkind = "file"\npath = "push.csv"\n{extra}', encoding="utf-8")
    (folder / "push.csv").write_text(content, encoding="utf-8")
    return path


def test_schedule_from_a_file(tmp_path: Path) -> None:
    path = _with_schedule(tmp_path, "# by hand\nt_s, torque_Nm\n0,0\n0.5,1.5\n\n2,-1e-3\n")
    rig = load_rig(str(path))
    phase = rig.one_axis().phases[-1]
    assert phase.kind == "file"
    assert phase.duration_s == 2.0
    np.testing.assert_array_equal(phase.t_s, [0, 0.5, 2])
    np.testing.assert_array_equal(phase.torque_Nm, [0, 1.5, -1e-3])
    assert not phase.t_s.flags.writeable
    again = load_rig_text(rig.effective(), "in a recording", rig.eds_texts)
    assert again == rig
    assert hash(again) == hash(rig)
    assert (
        load_rig(str(_with_schedule(tmp_path, "t_s,torque_Nm\n0,0\n1,1\n", "duration_s = 5")))
        .one_axis()
        .phases[-1]
        .duration_s
        == 5
    )
    assert load_rig(str(path)) != rig


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", ["push.csv:1: got '', expected the header t_s,torque_Nm"]),
        ("t_s;torque_Nm\n", ["push.csv:1: got 't_s;torque_Nm', expected the header t_s,torque_Nm"]),
        ("t_s,torque_Nm\n0,0\n", ["push.csv:2: the file has 1 rows; expected at least two"]),
        ("t_s,torque_Nm\n0,0\n1,x\n#\n2\n2,nan\n3,1,1\n", [f"push.csv:{n}: got '{row}', expected two finite numbers"
                                                       for n, row in ((3, "1,x"), (5, "2"), (6, "2,nan"), (7, "3,1,1"))]),
        ("t_s,torque_Nm\n0,0\n1,1\n1,2\n0.5,1\n", ["push.csv:4: t_s: got '1', expected times that grow, from 0 on",
                                                  "push.csv:5: t_s: got '0.5'"]),
        ("t_s,torque_Nm\n-1,0\n1,1\n", ["push.csv:2: t_s: got '-1'"]),
        ("t_s,torque_Nm\n" + "x\n" * 30, ["push.csv:2: got 'x'"] * 10 + ["push.csv: 20 further lines cannot be read"]),
    ],
)  # fmt: skip
def test_schedule_mistakes_have_the_line_of_the_csv_file(tmp_path: Path, content: str, expected: list[str]) -> None:
    with pytest.raises(RigError) as caught:
        load_rig(str(_with_schedule(tmp_path, content)))
    assert len(caught.value.errors) == len(expected)
    for error, text in zip(caught.value.errors, expected, strict=True):
        assert re.sub(r":\d+", "", text) in re.sub(r":\d+", "", error.replace(f"{tmp_path}/", ""))
    assert expected[0] in caught.value.errors[0]


def test_schedule_without_a_file_and_given_in_place() -> None:
    lines = BENCH.count("\n")
    (error,) = errors(BENCH + '[[phase]]\nkind = "file"\n')
    assert error.startswith(f"r.toml:{lines + 1}: phase.3.path: missing in [[phase]]; expected a CSV file")
    (error,) = errors(BENCH + '[[phase]]\nkind = "file"\npath = "no.csv"\n')
    assert error.startswith(f"r.toml:{lines + 3}: phase.3.path: got '\"no.csv\"', expected a CSV file")
    head = BENCH + '[[phase]]\nkind = "file"\n'
    rig = load_rig_text(head + "t_s = [0, 1]\ntorque_Nm = [1, 2.5]\n", "r.toml", EDS)
    assert rig.one_axis().phases[-1].torque_Nm.tolist() == [1.0, 2.5]
    for rows, expected in (
        ("t_s = [0, 1]\ntorque_Nm = [1]\n", "phase.3.torque_Nm: got 1 values where t_s has 2"),
        ("t_s = [1, 1]\ntorque_Nm = [1, 2]\n", "phase.3.t_s: got '[1, 1]', expected times that grow"),
        (
            "t_s = [0, nan]\ntorque_Nm = [1, 2]\nduration_s = 1\n",
            "phase.3.t_s: got '[0, nan]', expected a list of numbers",
        ),
        ("t_s = [0, true]\ntorque_Nm = [1, 2]\nduration_s = 1\n", "phase.3.t_s: got '[0, true]'"),
        ("t_s = [0, 1]\n", "phase.3.torque_Nm: missing in [phase.3]"),
    ):
        (error,) = errors(head + rows)
        assert expected in error


# Warnings.


def test_what_is_allowed_but_may_not_be_meant() -> None:
    given = [
        "plant.motor_polarity=-1",
        "bus.bitrate_bit_s=2000000",
        "phase.1.duration_s=2",
    ]
    warnings = load_rig("bench", given).warnings
    assert [re.sub(r"^.*?bench\.toml:\d+", "FILE", text).split(": ")[:2] for text in warnings] == [
        ["--set bus.bitrate_bit_s=2000000", "bus.bitrate_bit_s"],
        ["--set plant.motor_polarity=-1", "plant.motor_polarity"],
        ["FILE", "phase.1.taps_s"],
    ]


# The document.


def _tables() -> dict[str, dict[str, list[str]]]:
    """Return docs/rig-file.md's tables of keys by heading: key -> the row's cells."""
    tables: dict[str, dict[str, list[str]]] = {}
    heading = ""
    for row in (ROOT / "docs" / "rig-file.md").read_text(encoding="utf-8").splitlines():
        if row.startswith("#"):
            heading = row.lstrip("# ")
        elif row.startswith("| `") and heading:
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", row.strip("|"))]
            tables.setdefault(heading, {})[cells[0].strip("`")] = cells
    return tables


def _sections() -> list[tuple[str, type[BaseModel]]]:
    fields = fields_of(Sections)
    others = ("mode", "phase", "sensor", "role")
    kinds = [(f"`[{name}]`", kinds_of(info)[""]) for name, info in fields.items() if name not in others]
    kinds += [("`[sensor.NAME]`", Sensor), ("`[[motor.sdo]]`", Sdo)]
    roles = {kinds_of(info)[""]: name for name, info in reversed(Roles.model_fields.items())}
    kinds += [(f"`[role.{name}]`", model) for model, name in roles.items()]
    plant = kinds_of(fields["plant"])[""]
    kinds += [(f"`[plant.{name}]`", kinds_of(info)[""]) for name, info in fields_of(plant).items() if kinds_of(info)]
    modes = kinds_of(fields["mode"])[""]
    kinds.append(("`[mode.active]`", kinds_of(fields_of(modes)["active"])[""]))
    return kinds + [(f'`kind = "{kind}"`', model) for kind, model in kinds_of(fields["phase"]).items()]


@pytest.mark.parametrize(("heading", "model"), _sections(), ids=lambda value: value if isinstance(value, str) else "")
def test_every_key_is_documented(heading: str, model: type[BaseModel]) -> None:
    (table,) = [rows for name, rows in _tables().items() if name.startswith(heading)]
    assert table.keys() == fields_of(model).keys()
    for name, info in fields_of(model).items():
        _, unit, accepted, default, meaning = table[name]
        assert unit == unit_of(name)
        if accepted_range(info):
            assert accepted == accepted_range(info)
        assert len(meaning) > 8
        if info.is_required() and model.__name__ not in ("FilePhase", "MotionPhase"):
            assert default == "required"
        elif not info.is_required() and name != "path":
            assert default.strip("`") in (str(info.default), f'"{info.default}"', "[]" if info.default == () else "")
