"""The sweep file: what it means, and what is said of each mistake, with its line."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from coulombus.lab.sweep.ranges import seed_of
from coulombus.lab.sweep.sweep_file import SweepError, read_sweep
from coulombus.rigs.rig import RigError, packaged_rig
from mutilated import mutilated
from places import ROOT

GOOD = """\
rig = "bench"
mode = "hybrid"
seconds = 3.0
seed = 5
design = "random"
runs = 4
[vary]
operator.inertia_kg_m2 = { low = 1e-4, high = 0.1, scale = "log" }
[rates]
still = "hold_counts_p2p <= 2"
"""


@pytest.fixture
def write(tmp_path):
    def written(text):
        path = tmp_path / "sweep.toml"
        path.write_text(text)
        return path

    return written


def vary_of(write, design, table, runs="runs = 8"):
    return read_sweep(write(f'design = "{design}"\n{runs}\n[vary]\n{table}'))


def test_a_file_says_what_is_run(write):
    sweep = read_sweep(write(GOOD))
    assert (sweep.rig.name, sweep.modes, sweep.seconds, sweep.seed, sweep.runs) == ("bench", ("hybrid",), 3.0, 5, 4)
    assert [one.key for one in sweep.vary] == ["operator.inertia_kg_m2"]
    assert all(1e-4 <= value <= 0.1 for (value,) in sweep.points)
    assert sweep.vary[0].own == 5e-4


def test_a_key_may_be_quoted_dotted_or_below_a_header(write):
    spelled = (
        "[vary]\noperator.tremor_Hz = { low = 8.0, high = 12.0 }",
        '[vary]\n"operator.tremor_Hz" = { low = 8.0, high = 12.0 }',
        "[vary.operator]\ntremor_Hz = { low = 8.0, high = 12.0 }",
        "[vary.operator.tremor_Hz]\nlow = 8.0\nhigh = 12.0",
    )
    found = [read_sweep(write(f'design = "sobol"\nruns = 3\n{text}')) for text in spelled]
    assert len({one.points for one in found}) == 1
    assert {one.vary[0].key for one in found} == {"operator.tremor_Hz"}


def test_a_rig_is_found_beside_the_file(write, tmp_path):
    (tmp_path / "mine.toml").write_text(
        packaged_rig("bench").read_text().replace("coulomb_Nm = 0.06", "coulomb_Nm = 0.05")
    )
    assert read_sweep(write('rig = "mine.toml"\n' + GOOD.partition("\n")[2])).rig.one_axis().plant.coulomb_Nm == 0.05


def test_a_grid_is_every_combination_with_the_ends_of_its_ranges(write):
    sweep = vary_of(
        write,
        "grid",
        'operator.inertia_kg_m2 = { low = 1e-4, high = 1e-2, scale = "log", count = 3 }\n'
        "mode.hybrid.F_s_Nm = { values = [1.5, 3.5] }",
        runs="",
    )
    assert [point[1] for point in sweep.points] == [1.5, 3.5] * 3
    assert [point[0] for point in sweep.points[::2]] == pytest.approx([1e-4, 1e-3, 1e-2])
    assert (sweep.points[0][0], sweep.points[-1][0]) == (1e-4, 1e-2)


def test_a_latin_hypercube_has_one_point_in_each_part_of_each_key(write):
    table = "plant.coulomb_Nm = { low = 0.0, high = 0.1 }\noperator.tremor_Hz = { low = 5.0, high = 15.0 }"
    sweep = vary_of(write, "latin_hypercube", table, runs="runs = 50")
    for k, (low, width) in enumerate(((0.0, 0.1), (5.0, 10.0))):
        parts = [math.floor((point[k] - low) / width * 50) for point in sweep.points]
        assert sorted(parts) == list(range(50))
    first = [point[0] for point in sweep.points]
    assert abs(np.corrcoef(first, [point[1] for point in sweep.points])[0, 1]) < 0.5


@pytest.mark.parametrize("seed", range(4))
def test_each_elementary_interval_of_a_sobol_design_has_its_share(write, seed):
    table = "plant.coulomb_Nm = { low = 0.0, high = 0.1 }\noperator.tremor_Hz = { low = 5.0, high = 15.0 }"
    points = vary_of(write, "sobol", table, runs=f"runs = 64\nseed = {seed}").points
    x, y = (np.array([point[k] for point in points]) for k in (0, 1))
    for m in range(7):
        shape = (2**m, 2 ** (6 - m))
        counts = np.histogram2d(x, y, shape, [(0.0, 0.1), (5.0, 15.0)])[0]
        assert (counts == 1).all(), shape


def test_a_sobol_design_follows_from_its_seed_and_more_runs_change_none_of_the_first(write):
    table = "plant.coulomb_Nm = { low = 0.0, high = 0.1 }\noperator.tremor_Hz = { low = 5.0, high = 15.0 }"

    def points(runs, seed):
        return vary_of(write, "sobol", table, runs=f"runs = {runs}\nseed = {seed}").points

    assert points(50, 1) == points(50, 1)
    assert points(50, 1)[:10] == points(10, 1)
    assert points(50, 1) != points(50, 2)


def test_more_random_runs_change_none_of_the_first(write):
    table = "plant.coulomb_Nm = { low = 0.0, high = 0.1 }"
    few, many = (vary_of(write, "random", table, runs=f"runs = {n}").points for n in (5, 50))
    assert many[:5] == few


@pytest.mark.parametrize("design", ["random", "latin_hypercube", "sobol"])
def test_the_points_are_the_seeds(write, design):
    def points(seed):
        return read_sweep(write(GOOD.replace('"random"', f'"{design}"').replace("seed = 5", f"seed = {seed}"))).points

    assert points(5) == points(5)
    assert points(5) != points(6)


def test_each_point_has_a_seed_of_its_own():
    seeds = [seed_of(1, point) for point in range(1000)] + [seed_of(2, point) for point in range(1000)]
    assert len(set(seeds)) == 2000


def test_a_range_of_a_key_with_integers_is_one_of_integers(write):
    sweep = vary_of(write, "random", "motor.encoder_counts_rev = { low = 4095.5, high = 4098.2 }", runs="runs = 60")
    assert {point[0] for point in sweep.points} == {4096, 4097, 4098}
    assert all(type(point[0]) is int for point in sweep.points)


def test_a_range_on_a_logarithmic_scale_has_its_median_between(write):
    sweep = vary_of(
        write, "sobol", 'operator.inertia_kg_m2 = { low = 1e-4, high = 1e-2, scale = "log" }', runs="runs = 512"
    )
    values = sorted(point[0] for point in sweep.points)
    assert values[256] == pytest.approx(1e-3, rel=0.02)
    assert all(a <= b for a, b in pairwise(values))


@pytest.mark.parametrize(
    ("old", "new", "line", "text"),
    [
        ("runs = 4", "runs = 0", 6, "runs: expected a number of at least 1, not 0"),
        ("runs = 4", "", 1, "runs is missing"),
        ("runs = 4", "rums = 4", 6, "rums: no such key here; did you mean 'runs'?"),
        ("seconds = 3.0", "seconds = -1.0", 3, "seconds: expected a number above 0, not -1.0"),
        ("seconds = 3.0", "seconds = nan", 3, "seconds: expected a finite number"),
        ("seconds = 3.0", 'seconds = "long"', 3, 'seconds: expected a number, not "long"'),
        ("seed = 5", "seed = -5", 4, "seed: expected a number of at least 0"),
        ('design = "random"', 'design = "sobel"', 5, "did you mean 'sobol'?"),
        ('design = "random"\nruns = 4', 'design = "grid"\nruns = 4', 6, "a grid has as many runs as its values make"),
        ('design = "random"\nruns = 4', 'design = "grid"', 7, "of a grid; expected count = N, or values"),
        (
            'scale = "log" }',
            'scale = "log", count = 3 }',
            8,
            'count: is of a grid; take it out, or choose design = "grid"',
        ),
        ('mode = "hybrid"', 'mode = "turbo"', 2, "mode: expected"),
        (
            'mode = "hybrid"',
            'mode = "hybrid"\nmodes = ["active"]',
            3,
            "modes: mode is given there, too; expected either",
        ),
        ('mode = "hybrid"', 'modes = ["hybrid", "hybrid"]', 2, "a mode is given twice"),
        ('mode = "hybrid"', "modes = []", 2, "expected one value or more"),
        ('rig = "bench"', 'rig = "bensh"', 1, "rig: no rig of this name"),
        ('rig = "bench"', 'rig = "none.toml"', 1, "rig: there is no file"),
        ("low = 1e-4", "low = 0.2", 8, "low = 0.2 is not below high = 0.1"),
        ("low = 1e-4", "low = 0.0", 8, 'low = 0; scale = "log" wants it above 0'),
        ("low = 1e-4", "lo = 1e-4", 8, "lo: no such key here; did you mean 'low'?"),
        ('{ low = 1e-4, high = 0.1, scale = "log" }', "{ low = 1e-4 }", 8, "high: is missing"),
        ('{ low = 1e-4, high = 0.1, scale = "log" }', "{ values = [] }", 8, "values: expected one value or more"),
        ('{ low = 1e-4, high = 0.1, scale = "log" }', "{ values = [1e-3, 1e-3] }", 8, "one is given twice"),
        ('{ low = 1e-4, high = 0.1, scale = "log" }', "{ values = [1e-3], low = 1 }", 8, "values, and low and high"),
        (
            '{ low = 1e-4, high = 0.1, scale = "log" }',
            "3",
            8,
            "expected { values = [...] } or { low = ..., high = ... }",
        ),
        ("operator.inertia_kg_m2", "operator.inertia_kgm2", 8, "the rig refuses it: operator.inertia_kgm2"),
        ("operator.inertia_kg_m2", "operator", 8, "the rig refuses it"),
        ("low = 1e-4, high = 0.1", "low = 1e4, high = 1e5", 8, "the rig refuses it"),
        (
            "hold_counts_p2p <= 2",
            "hold_count_p2p <= 2",
            10,
            "still: no figure 'hold_count_p2p'; did you mean 'hold_counts_p2p'?",
        ),
        ("hold_counts_p2p <= 2", "hold_counts <= 2", 10, "did you mean 'hold_counts_p2p'?"),
        ("hold_counts_p2p <= 2", "", 10, "cannot be read"),
        ("still", '"still in"', 10, "expected a name of letters, digits, _ and -"),
        ("[vary]", "[vary", 7, "cannot be read"),
    ],
)
def test_a_mistake_is_told_with_its_line(write, old, new, line, text):
    assert old in GOOD
    with pytest.raises(SweepError) as caught:
        read_sweep(write(GOOD.replace(old, new)))
    told = str(caught.value)
    assert f"sweep.toml:{line}: " in told, told
    assert text in told
    assert caught.value.exit_status == 3


@pytest.mark.parametrize("design", ["grid", "latin_hypercube", "sobol"])
def test_a_design_of_nothing_is_refused(write, design):
    runs = "" if design == "grid" else "runs = 3"
    with pytest.raises(SweepError, match=r"sweep.toml:1: design: .*expected \[vary\]"):
        read_sweep(write(f'design = "{design}"\n{runs}'))


def test_random_runs_may_differ_by_their_seed_alone(write):
    assert read_sweep(write('design = "random"\nruns = 3')).points == ((), (), ())


def test_all_mistakes_are_told_at_once(write):
    with pytest.raises(SweepError) as caught:
        read_sweep(write(GOOD.replace("seconds = 3.0", "seconds = 0").replace("runs = 4", "runs = 0")))
    assert [line.split(":")[1] for line in str(caught.value).splitlines()] == ["3", "6"]


def test_a_file_that_is_none_is_told(tmp_path):
    with pytest.raises(SweepError, match=r"none.toml: the sweep file cannot be read \(No such file"):
        read_sweep(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b'rig = "bench"\n# \xe9\n')
    with pytest.raises(SweepError, match=r"latin.toml:2: byte E9h is not UTF-8"):
        read_sweep(tmp_path / "latin.toml")


def test_a_fingerprint_knows_the_source_of_a_law(write, tmp_path):
    law = tmp_path / "law.py"
    law.write_text((ROOT / "examples" / "own_law.py").read_text())
    rig = packaged_rig("bench").read_text().replace('"karnopp"', '"law.py:stribeck"')
    (tmp_path / "mine.toml").write_text(rig.replace("user = []", "user = [0.5]"))
    sweep = read_sweep(write('rig = "mine.toml"\n' + GOOD.partition("\n")[2]))
    before = sweep.fingerprint()
    law.write_text(law.read_text() + "\n# another one\n")
    assert sweep.fingerprint() != before


def test_a_fingerprint_knows_what_the_runs_depend_on_and_no_comment(write):
    def fingerprint(old="", new=""):
        return read_sweep(write(GOOD.replace(old, new))).fingerprint()

    same = fingerprint()
    assert fingerprint("seed = 5", "seed = 5  # as ever") == same
    for old, new in (
        ("seed = 5", "seed = 6"),
        ("runs = 4", "runs = 5"),
        ("high = 0.1", "high = 0.2"),
        ("3.0", "4.0"),
        ("<= 2", "<= 1"),
        ('rig = "bench"', 'rig = "paper"'),
    ):
        assert fingerprint(old, new) != same, new


CABLE = GOOD.replace(
    "[vary]", 'set = ["plant.cable.motor_inertia_kg_m2=2e-4", "plant.cable.stiffness_Nm_rad=200"]\n[vary]'
).replace(
    "operator.inertia_kg_m2 = { low = 1e-4, high = 0.1", "plant.cable.stiffness_Nm_rad = { low = 50.0, high = 500.0"
)


def test_what_a_varied_section_needs_besides_is_set(write):
    sweep = read_sweep(write(CABLE))
    cable = sweep.rig.one_axis().plant.cable
    assert (cable.motor_inertia_kg_m2, cable.stiffness_Nm_rad) == (2e-4, 200.0)
    assert sweep.vary[0].own == 200.0
    assert sweep.fingerprint() != read_sweep(write(CABLE.replace("2e-4", "3e-4"))).fingerprint()


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "set = ",
            "# ",
            'beside [vary]: set = ["plant.cable.stiffness_Nm_rad=...", "plant.cable.motor_inertia_kg_m2=..."]',
        ),
        ('"plant.cable.motor_inertia_kg_m2=2e-4", ', "", ":7: set: the rig refuses it: "),
        ("motor_inertia_kg_m2=2e-4", "motor_nertia=2", ":7: set: the rig refuses it: plant.cable.motor_nertia"),
        ("set = [", "set = [3, ", ":7: set.0: expected a text"),
        ("=2e-4", "", "set: the rig refuses it: "),
    ],
)
def test_a_setting_that_the_rig_refuses_is_told_with_its_line(write, old, new, text):
    assert old in CABLE
    with pytest.raises(SweepError) as error:
        read_sweep(write(CABLE.replace(old, new)))
    assert text in str(error.value)
    assert "sweep.toml:" in str(error.value)


def test_a_mutilated_file_is_read_or_refused_with_its_place(write):
    refused = []
    for text in mutilated(CABLE, 150):
        try:
            assert read_sweep(write(text)).runs > 0
        except (SweepError, RigError) as error:
            refused.append(str(error))
    assert len(refused) > 50
    assert [text for text in refused if ".toml" not in text and "rig" not in text] == []
