"""``coulombus law``: the laws listed, told of, and driven along a motion."""

from __future__ import annotations

import csv
import json
import math

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.host.laws.plane.plane_laws import PLANE_LAWS


def run(*words):
    return CliRunner().invoke(main, ["law", *map(str, words)])


def rows(path):
    with path.open() as file:
        found = list(csv.reader(file))
    return found[0], [list(map(float, row)) for row in found[1:]]


def test_the_laws_are_listed():
    done = run()
    assert done.exit_code == 0
    of_one_axis, in_the_plane, _ = done.stdout.split("\n\n")
    assert [line.split()[0] for line in of_one_axis.splitlines()] == list(BUILTIN_LAWS)
    assert [line.split()[0] for line in in_the_plane.splitlines()[1:]] == list(PLANE_LAWS)
    assert max(map(len, done.stdout.splitlines())) <= 100
    assert [one["law"] for one in json.loads(run("--json").stdout)["plane_laws"]] == list(PLANE_LAWS)
    listed = json.loads(run("--json").stdout)["laws"]
    assert [one["law"] for one in listed] == list(BUILTIN_LAWS)
    assert {one["section"] for one in listed} >= {"law.lugre", "law.dahl", "mode.NAME and law"}


def test_a_law_tells_of_its_parameters():
    done = run("lugre")
    assert done.exit_code == 0
    assert "doi:10.1109/9.376053" in done.stdout
    (F_s,) = [line for line in done.stdout.splitlines() if line.startswith("F_s_Nm")]
    assert F_s.split()[:3] == ["F_s_Nm", "1.2", "Nm"]


@pytest.mark.parametrize("name", PLANE_LAWS)
def test_a_law_in_the_plane_tells_of_its_parameters(name):
    done = run(name)
    assert done.exit_code == 0
    assert "docs/plane.md" in done.stdout
    parameters = [line.split()[0] for line in done.stdout.splitlines()]
    assert set(PLANE_LAWS[name].names) < set(parameters)


@pytest.mark.parametrize("words", [("--motion", "sine"), ("--set", "F_s_N=3")])
def test_a_law_in_the_plane_names_what_drives_it(words):
    done = run("plane_karnopp", *words)
    assert done.exit_code == 2
    text = " ".join(done.stderr.split())
    assert "is a law in the plane" in text
    assert "coulombus simulate --rig plane --law plane_karnopp" in text


def test_a_law_is_driven_along_a_file(tmp_path):
    motion, out = tmp_path / "motion.csv", tmp_path / "out.csv"
    motion.write_text("# a comment\nremark,t_s,x_rad\na,0,0\nb,0.001,0.01\n\nc,0.003,0.005\n")
    done = run("dahl", "--motion", motion, "--set", "sigma_Nm_rad=200", "--csv", out, "--json")
    assert done.exit_code == 0, done.stderr
    head, found = rows(out)
    assert head == ["t_s", "x_rad", "v_rad_s", "torque_Nm"]
    up = 1 - math.exp(-2)
    down = -1 + (up + 1) * math.exp(-1)
    expected = [[0, 0, 0, 0], [0.001, 0.01, 10, up], [0.003, 0.005, -2.5, down]]
    assert found == [pytest.approx(row, rel=1e-12) for row in expected]
    told = json.loads(done.stdout)
    assert told["parameters"] == {"F_c_Nm": 1.0, "sigma_Nm_rad": 200.0, "alpha": 1.0}
    assert (told["samples"], told["csv"]) == (3, str(out))


@pytest.mark.parametrize("name", BUILTIN_LAWS)
def test_every_law_runs_with_its_defaults(name, tmp_path):
    out = tmp_path / "out.csv"
    assert run(name, "--motion", "sine", "--csv", out).exit_code == 0
    _, found = rows(out)
    assert len(found) == 2001
    assert any(row[3] for row in found)
    assert run(name, "--motion", "ramp", "--speed", "-2", "--seconds", "0.1").exit_code == 0


def test_a_picture_names_the_law_and_its_parameters():
    from coulombus.analysis.figures.law import draw_law
    from coulombus.host.laws.along import given_law
    from coulombus.host.laws.path import sine

    given = given_law("dahl", ("sigma_Nm_rad=150",))
    made = draw_law(given, given.along(*sine(0.05, 1.0, 0.1, 1000.0)))
    assert made._suptitle.get_text() == "law dahl\nF_c_Nm = 1, sigma_Nm_rad = 150, alpha = 1"


@pytest.mark.thorough
def test_a_picture_is_drawn_and_no_file_replaced(tmp_path):
    picture = tmp_path / "loop.svg"
    words = ("lugre", "--motion", "sine", "--seconds", "0.1", "--plot", picture)
    assert run(*words).exit_code == 0
    first = picture.read_bytes()
    assert b"<svg" in first
    assert b"torque [Nm]" in first
    assert run(*words).exit_code == 2
    assert run(*words, "--force").exit_code == 0
    assert picture.read_bytes() == first


FILES = {
    "empty": (b"", ":1: the file is empty; expected a CSV file with the columns t_s,x_rad"),
    "only a head": (b"t_s,x_rad\n", ":1: 0 samples; expected two or more"),
    "one sample": (b"t_s,x_rad\n0,0\n", ":2: 1 samples; expected two or more"),
    "other columns": (b"time,angle\n0,0\n1,1\n", ":1: got 'time,angle', expected a header with the columns t_s,x_rad"),
    "no head": (b"0,0\n1,1\n", ":1: got '0,0', expected a header with the columns t_s,x_rad"),
    "torn": (b"t_s,x_rad\n0,0\n1,1\n2", ":4: got '2', expected finite numbers in 2 columns"),
    "nan": (b"t_s,x_rad\n0,0\n1,nan\n2,0\n", ":3: got '1,nan', expected finite numbers in 2 columns"),
    "too large": (b"t_s,x_rad\n0,0\n1,1e101\n2,0\n", ":3: got '1,1e101', expected finite numbers in 2 columns, within"),
    "too fast": (
        b"t_s,x_rad\n0,0\n1e-320,1\n2,0\n",
        ":3: x_rad: got 1 after 0 in 9.99989e-321 s, expected a speed within +-1e+100 rad/s",
    ),
    "back in time": (b"t_s,x_rad\n0,0\n2,1\n1,0\n", ":4: t_s: got 1 after 2, expected times that grow"),
    "twice the time": (b"t_s,x_rad\n0,0\n2,1\n2,0\n", ":4: t_s: got 2 after 2, expected times that grow"),
    "no text": (b"\xff\xfe\x00", ":1: no UTF-8; expected a CSV file with the columns t_s,x_rad"),
}


@pytest.mark.parametrize("case", FILES)
def test_a_motion_that_is_none_is_refused_with_its_line(case, tmp_path):
    raw, told = FILES[case]
    path = tmp_path / "motion.csv"
    path.write_bytes(raw)
    done = run("lugre", "--motion", path)
    assert done.exit_code == 3
    assert f"{path}{told}" in done.stderr


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        ("lugr --motion sine", 3, "did you mean 'lugre'?"),
        ("nothing.py:law --motion sine", 3, "there is no file nothing.py"),
        ("lugre --motion none.csv", 3, "none.csv: cannot be read (No such file or directory)"),
        ("lugre --motion .", 3, "is a directory, not a regular file"),
        ("lugre --motion sin", 2, "expected a CSV file, sine or ramp; did you mean 'sine'?"),
        ("lugre --set F_s=2", 3, "--set F_s=2: law.lugre.F_s: unknown key; expected one of the keys of [law.lugre]"),
        ("lugre --set F_s_Nm=0.5", 3, "got '0.5', expected at least F_c_Nm, which is 1.0"),
        ("lugre --set sigma_0_Nm_rad=-1", 3, "expected a number above 0, at most 1e9, in Nm/rad"),
        ("lugre --set sigma_0_Nm_rad=nan", 3, "got 'nan', expected a number above 0"),
        ("lugre --set F_s_Nm", 3, "--set F_s_Nm: cannot be read; expected KEY=VALUE, such as F_c_Nm=1.0"),
        ("karnopp --set K_p_Nm_rad=0", 3, "got '0', expected a number above 0"),
        ("--motion sine", 2, "give its NAME"),
        ("lugre --csv OUT", 2, "give --motion, too"),
        ("lugre --motion ramp --speed nan", 2, "--speed"),
        ("lugre --motion sine --rate 1e9 --seconds 100", 2, "expected 1 to 10000000 samples"),
        ("lugre --motion sine --amplitude 0", 2, "--amplitude"),
    ],
)
def test_mistakes_say_what_to_do(words, status, told, tmp_path):
    done = run(*words.replace("OUT", str(tmp_path / "out.csv")).split())
    assert done.exit_code == status, done.stderr
    assert told in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.stderr


def test_a_law_that_returns_no_number_is_told_with_its_place(tmp_path):
    path = tmp_path / "own.py"
    path.write_text("def f(motion, law, state):\n    return motion.v_rad_s / (motion.x_rad - 1.0) ** 0.5\n")
    done = run(f"{path}:f", "--motion", "sine")
    assert done.exit_code == 3
    assert "returned nan Nm and 0 Nm for the brake at t_s=0, x_rad=0" in done.stderr


def test_a_law_without_parameters_sees_those_of_a_mode(tmp_path):
    (tmp_path / "my.py").write_text(
        "def f(motion, law, state):\n    return law.F_d if motion.v_rad_s > 0 else -law.F_s\n"
    )
    words = ["law", f"{tmp_path}/my.py:f", "--motion", "sine", "--set", "F_d_Nm=0.7", "--set", "F_s_Nm=0.9"]
    shown = CliRunner().invoke(main, words).output
    assert "largest torque  0.9 Nm" in shown
    assert "F_s_Nm = 0.9, F_d_Nm = 0.7" in " ".join(shown.split())
    told = json.loads(CliRunner().invoke(main, [*words, "--json"]).stdout)
    assert (told["parameters"]["F_s_Nm"], told["parameters"]["F_d_Nm"], told["peak_Nm"]) == (0.9, 0.7, 0.9)
