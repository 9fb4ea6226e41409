"""Angle and torque of anybody: the same friction from CSV, Parquet and MAT, units and names given
in the header or by option.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.recording.friction.columns import TableError, TorqueTable, is_table, read_table
from coulombus.recording.friction.sliding import IdentifyError
from coulombus.recording.friction.table_identify import identify_table, table_lines

C, B, J, BIAS, T = 0.12, 0.01, 2e-3, 0.01, 1e-3


def recorded(x, period=T, count=0.0, c=C, seed=1):
    """Return a table of the angle x and the torque that moves it."""
    rng = np.random.default_rng(seed)
    v = np.gradient(x, period)
    torque = J * np.gradient(v, period) + (c + B * np.abs(v)) * np.sign(np.where(np.abs(v) < 1e-9, 0.0, v)) + BIAS
    torque += rng.normal(0.0, 2e-3, len(x))
    seen = np.rint(x / count) * count if count else x
    return TorqueTable("table", np.arange(len(x)) * period, seen, torque)


def chirp():
    t = np.arange(0, 15, T)
    return 0.5 * np.sin(2 * np.pi * (0.2 * t + 0.06 * t**2))


def strokes():
    t = np.arange(0, 16, T)
    speed = np.clip(20 * np.sin(np.pi * t), -1, 1) * np.where(t > 8, 1.5, 0.5)
    return np.cumsum(speed) * T


@pytest.mark.parametrize("x", [chirp(), strokes()], ids=["chirp", "strokes"])
@pytest.mark.parametrize("count", [0.0, 2 * math.pi / 20000])
def test_chirps_and_strokes_tell_friction(x, count):
    fit = identify_table(recorded(x, count=count)).identification.felt
    assert fit.coulomb_Nm.value == pytest.approx(C, rel=0.01)
    assert fit.viscous_Nms_rad.value == pytest.approx(B, rel=0.05)
    assert fit.offset_Nm.value == pytest.approx(BIAS, abs=1e-3)
    assert fit.coulomb_Nm.reach < 0.05 * C


def test_a_chirp_tells_the_inertia():
    fit = identify_table(recorded(chirp())).identification.felt
    assert fit.inertia_kg_m2.value == pytest.approx(J, rel=0.02)


def test_a_slow_ramp_of_ten_samples_a_second_tells_one_friction():
    t = np.arange(0, 400, 0.1)
    x = 0.6 / np.pi * np.arcsin(np.sin(2 * np.pi * t / 80))
    result = identify_table(recorded(x, period=0.1)).identification
    assert result.felt.coulomb_Nm.value == pytest.approx(C + B * 0.015, rel=0.01)
    assert any("one speed only" in remark for remark in result.remarks)


def test_break_away_from_rest_has_an_interval():
    x, torque, rng = [], [], np.random.default_rng(5)
    for k in range(8):
        sign, peak = (-1) ** k, 0.3 + rng.normal(0.0, 0.005)
        x += [np.full(400, x[-1][-1] if x else 0.0)]
        torque += [sign * np.linspace(0.0, peak, 400)]
        x += [x[-1][-1] + sign * 0.5 * np.arange(1, 601) * T]
        torque += [np.full(600, sign * 0.2)]
    angle, force = np.concatenate(x), np.concatenate(torque) + rng.normal(0.0, 1e-3, 8000)
    result = identify_table(TorqueTable("table", np.arange(8000) * T, angle, force))
    assert result.breakaway_Nm is not None
    assert result.breakaway_Nm.low < 0.3 < result.breakaway_Nm.high
    assert result.identification.felt.coulomb_Nm.value == pytest.approx(0.2, rel=0.01)
    assert any(line.startswith("  break-away") for line in table_lines(result))


def test_samples_with_the_brake_on_are_left_out():
    table = recorded(strokes())
    brake = np.where((table.t_s > 4) & (table.t_s < 8), 1.0, 0.0)
    torque = table.torque_Nm + 0.5 * brake * np.sign(np.gradient(table.angle_rad))
    fit = identify_table(TorqueTable("table", table.t_s, table.angle_rad, torque, brake)).identification.felt
    assert fit.coulomb_Nm.value == pytest.approx(C, rel=0.01)


def test_rows_that_come_unevenly_are_interpolated():
    table = recorded(strokes())
    rng = np.random.default_rng(2)
    kept = np.sort(rng.choice(len(table.t_s), len(table.t_s) - 300, replace=False))
    result = identify_table(TorqueTable("table", table.t_s[kept], table.angle_rad[kept], table.torque_Nm[kept]))
    assert result.identification.felt.coulomb_Nm.value == pytest.approx(C, rel=0.02)
    assert any("unevenly" in remark for remark in result.identification.remarks)


def test_cogging_of_a_table_is_found_with_the_ratio():
    table = recorded(chirp())
    waved = table.torque_Nm + 0.02 * np.sin(12 * 9.5 * table.angle_rad + 0.4)
    cogged = TorqueTable("table", table.t_s, table.angle_rad, waved)
    assert identify_table(cogged).identification.cogging is None
    result = identify_table(cogged, ratio=9.5).identification
    assert result.cogging.periods == 12
    assert result.felt.coulomb_Nm.value == pytest.approx(C, rel=0.01)


def test_a_column_of_the_load_tells_the_friction_that_grows_with_it(tmp_path):
    table = recorded(strokes())
    load_Nm = 0.8 * np.sin(2.0 * table.angle_rad)
    torque_Nm = table.torque_Nm - load_Nm + 0.1 * np.abs(load_Nm) * np.sign(np.gradient(table.angle_rad))
    rows = zip(table.t_s, table.angle_rad, torque_Nm, 1e3 * load_Nm, strict=True)
    path = tmp_path / "geared.csv"
    path.write_text(
        "t_s,angle_rad,torque_Nm,load_mNm\n" + "\n".join(",".join(map(repr, map(float, row))) for row in rows)
    )
    result = CliRunner().invoke(main, ["identify", str(path), "--json"])
    assert result.exit_code == 0, result.output
    fit = json.loads(result.stdout)
    low, high = fit["load_share_ci95"]
    assert low < 0.1 < high
    assert high - low < 0.01
    assert fit["coulomb_Nm"] == pytest.approx(C, rel=0.02)
    assert fit["viscous_Nms_rad"] == pytest.approx(B, rel=0.1)
    assert "share of the load" in CliRunner().invoke(main, ["identify", str(path)]).stdout


def test_a_handle_that_never_moves_is_refused():
    with pytest.raises(IdentifyError, match="never moves"):
        identify_table(TorqueTable("table", np.arange(500) * T, np.zeros(500), np.zeros(500)))


# files


def written(path, table, names=("t_s", "angle_rad", "torque_Nm"), factors=(1.0, 1.0, 1.0), delimiter=","):
    columns = [c * f for c, f in zip((table.t_s, table.angle_rad, table.torque_Nm), factors, strict=True)]
    lines = [delimiter.join(names), *(delimiter.join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True))]
    path.write_text("# made by a test\n" + "\n".join(lines) + "\n")
    return path


UNITS = [
    (("t_s", "angle_rad", "torque_Nm"), (1, 1, 1), ()),
    (("time [ms]", "theta [deg]", "tau [mNm]"), (1e3, 180 / math.pi, 1e3), ()),
    (("time(us)", "x(mrad)", "M(Ncm)"), (1e6, 1e3, 1e2), ("--column", "torque=M(Ncm)")),
    (
        ("a", "b", "c"),
        (1, 180 / math.pi, 1),
        ["--column", "t=a", "--column", "angle=b", "--column", "torque=c", "--unit", "angle=deg"],
    ),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("names", "factors", "options"), UNITS)
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_units_stand_in_the_header_or_in_an_option(tmp_path, names, factors, options, delimiter):
    path = written(tmp_path / "bench.csv", recorded(strokes()), names, factors, delimiter)
    result = CliRunner().invoke(main, ["identify", str(path), "--json", *options])
    assert result.exit_code == 0, result.output
    fit = json.loads(result.stdout)
    assert fit["coulomb_Nm"] == pytest.approx(C, rel=0.01)
    assert fit["viscous_Nms_rad"] == pytest.approx(B, rel=0.05)
    low, high = fit["coulomb_Nm_ci95"]
    assert low < fit["coulomb_Nm"] < high


def test_a_mat_file_has_vectors_or_a_structure(tmp_path):
    from scipy.io import savemat

    table = recorded(strokes())
    vectors = {"time": table.t_s, "phi_deg": np.degrees(table.angle_rad), "torque": table.torque_Nm, "note": "rig A"}
    savemat(tmp_path / "plain.mat", vectors)
    savemat(tmp_path / "inside.mat", {"log": vectors})
    for name in ("plain.mat", "inside.mat"):
        assert is_table(tmp_path / name)
        read = read_table(tmp_path / name)
        assert read.angle_rad == pytest.approx(table.angle_rad)
        assert read.torque_Nm == pytest.approx(table.torque_Nm)
        assert read.brake is None


def test_a_parquet_file_has_columns(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = recorded(strokes())
    columns = {"t_ms": 1e3 * table.t_s, "position_rad": table.angle_rad, "torque_Nm": table.torque_Nm}
    columns["brake_A"] = np.zeros(len(table.t_s))
    parquet.write_table(pa.table(columns), tmp_path / "bench.parquet")
    read = read_table(tmp_path / "bench.parquet")
    assert read.t_s == pytest.approx(table.t_s)
    assert read.brake == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        ("t_s,angle_rad\n" + "0,0\n" * 200, {}, "no column for torque"),
        ("t_s,angle_rad,torque_Nm\n0,0,x\n", {}, "could not convert"),
        ("t_s,angle_rad,torque_Nm\n0,0\n", {}, "expected 3 numbers"),
        ("t_s,angle_rad,torque_Nm\n0,0,0\n", {}, "1 rows; expected at least 100"),
        ("t_s,angle_rad,torque_Nm\n" + "0,0,0\n" * 200, {}, "does not grow at row 2"),
        ("t_s,angle_inch,torque [lbf]\n" + "0,0,0\n" * 200, {"columns": ("angle=angle_inch",)}, "unit 'lbf' of torque"),
        ("t_s,angle_rad,torque_Nm\n", {"columns": ("mass=m",)}, "expected one of t, angle"),
        ("", {}, "the file is empty"),
    ],
)
def test_a_table_that_cannot_be_used_says_why(tmp_path, text, options, says):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(TableError, match=says):
        read_table(path, **options)


def test_a_log_of_frames_is_no_table(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("timestamp,arbitration_id,extended,remote,error,dlc,data\n")
    assert not is_table(path)
    assert not is_table(tmp_path / "run.pcapng")


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("a.csv", "--rig bench", "a.csv is a table; --rig is for a recording"),
        ("a.csv", "--law dahl --axis x", "a.csv is a table; --axis is for a recording"),
        ("a.csv", "--iron", "a.csv is a table; --iron is for a recording"),
        ("a.csv", "--channel can0", "a.csv is a table; --channel is for a recording"),
        ("a.pcapng", "--column angle=phi", "a.pcapng is a recording; --column is for a table"),
        ("a.log", "--unit angle=deg", "a.log is a recording; --unit is for a table"),
        ("a.log", "--law dahl --ratio 9.5", "a.log is a recording; --ratio is for a table"),
    ],
)
def test_an_option_of_the_other_kind_of_file_is_refused(tmp_path, monkeypatch, name, options, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("t,angle,torque\n")
    done = CliRunner().invoke(main, ["identify", name, *options.split()])
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())
