"""The example's sweep over arms and hands in the plane, with fewer points."""

from __future__ import annotations

import pandas
import pytest

from coulombus.lab.sweep.sweep import run_sweep
from coulombus.lab.sweep.sweep_file import read_sweep
from places import ROOT

EXAMPLE = ROOT / "examples" / "sweep_plane.toml"


def test_the_example_has_two_hundred_points_in_both_modes():
    sweep = read_sweep(EXAMPLE)
    assert (sweep.runs, tuple(sweep.modes)) == (400, ("active", "hybrid"))


@pytest.mark.slow
@pytest.mark.long
def test_motors_alone_oscillate_and_brakes_with_motors_hold(tmp_path):
    path = tmp_path / "few.toml"
    path.write_text(EXAMPLE.read_text().replace("runs = 200", "runs = 4"))
    swept = run_sweep(read_sweep(path), tmp_path / "out", processes=1)
    assert (swept.runs, swept.failed) == (8, 0)
    assert (swept.rates["active.still"].count, swept.rates["hybrid.still"].count) == (0, 4)
    table = pandas.read_parquet(swept.table)
    counts = table.set_index("mode")[["axes.shoulder.hold_counts_p2p", "axes.elbow.hold_counts_p2p"]].max(axis=1)
    assert counts["active"].min() > 20
    assert counts["hybrid"].max() <= 2
