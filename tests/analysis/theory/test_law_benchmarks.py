"""The laws against the literature, and the tables of docs/laws.md against what is computed."""

from __future__ import annotations

import cmath
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.figures.law import write_literature_figures
from coulombus.analysis.theory import law_benchmarks, published_curves
from coulombus.analysis.theory.describing import LawParameters, regularised_psi
from coulombus.analysis.theory.law_benchmarks import (
    CANUDAS,
    benchmarks,
    break_away,
    describing_function,
    energy,
    lines,
    sweep,
)
from coulombus.analysis.theory.published_curves import lines as published_lines
from coulombus.analysis.theory.published_curves import literature_curves
from coulombus.cli.main import main
from coulombus.host.laws.along import given_law
from coulombus.host.laws.laws import BUILTIN_LAWS
from documented import plain_formulas
from places import ROOT

pytestmark = pytest.mark.slow

DOCS = ROOT / "docs" / "laws.md"


@pytest.fixture(scope="module")
def computed():
    return benchmarks(), sweep()


@pytest.mark.thorough
def test_every_benchmark_is_met(computed):
    found, _ = computed
    assert [one.what for one in found if not one.ok] == []
    assert {one.law for one in found} == {"lugre", "dahl", "gms", "elastoplastic", "kikuuwe", "bliman_sorine", "leuven"}


@pytest.mark.thorough
def test_a_wrong_law_misses_its_benchmark(computed):
    law = given_law("lugre", [f"{key}={value!r}" for key, value in {**CANUDAS, "F_s_Nm": 1.4}.items()])
    expected = {benchmark.what: benchmark for benchmark in computed[0]}["break-away at 1 N/s (1995, Fig. 4)"].expected
    assert abs(break_away(law, 1.0) - expected) > 0.05


def test_the_document_has_the_tables(computed):
    text = plain_formulas(DOCS.read_text())
    missing = [line for line in lines(*computed) if line and line not in text]
    assert missing == []


def test_the_document_has_every_law_with_its_source():
    text = DOCS.read_text()
    for name, law in BUILTIN_LAWS.items():
        assert re.search(rf"^\| `{name}` \|", text, re.M) or f"## `{name}`" in text, name
        assert not [doi for doi in law.dois if doi not in text], name


def test_describing_functions_that_are_known(computed):
    psi = {one.law: one.psi for one in computed[1]}
    w = 2 * math.pi
    assert psi["coulomb"] == pytest.approx(4 / math.pi, abs=1e-3)
    assert psi["viscous"] == pytest.approx(0.05, abs=1e-4)
    assert psi["inertia"] == pytest.approx(1j * w * 1e-3 / (1 + 1j * w * 0.02), abs=1e-5)
    saturated = regularised_psi(1.0, 1.0, LawParameters(F_d=1.0, band_v=0.2))
    assert psi["regularised"] == pytest.approx(saturated, abs=1e-3)
    assert cmath.isfinite(sum(psi.values()))
    A = 1 / w  # of the angle; the loss of a turn is the real part
    loss = 4 * (A - 0.01 * math.tanh(100 * A))
    assert psi["dahl"].real == pytest.approx(2 * loss, abs=1e-3)


def test_a_spring_lags_by_a_quarter_and_an_amplitude_counts():
    wall = given_law("wall", ["K_Nm_rad=2", "B_Nms_rad=0", "most_Nm=100"])
    # the motion is wholly within: x = A (1 - cos)
    assert describing_function(wall, 1.0, 2.0) == pytest.approx(2 / (4j * math.pi), abs=1e-4)
    stribeck = given_law("stribeck", ["F_s_Nm=1", "sigma_2_Nms_rad=0.3"])
    assert describing_function(stribeck, 4.0, 1.0) == pytest.approx(1 / math.pi + 0.3, abs=1e-3)


def test_no_law_gives_more_than_it_took(computed, tmp_path):
    assert [one.law for one in computed[1] if not one.passive] == []
    (tmp_path / "own.py").write_text("def drives(motion, law, state):\n    return -0.01 * motion.v_rad_s\n")
    least, turned = energy(given_law("own.py:drives", (), tmp_path))
    assert least == pytest.approx(-turned)


@pytest.fixture(scope="module")
def published():
    return literature_curves()


@pytest.mark.thorough
def test_the_curves_of_the_literature_are_met(published):
    assert {curve.law for curve in published} == {"lugre", "dahl", "kikuuwe"}
    for curve in published:
        assert curve.deviation < 0.01, curve.name  # sampled at 1 kHz
    by_name = {curve.name: curve for curve in published}
    lag = [line.deviation for line in by_name["lugre-lag"].lines]
    assert lag == sorted(lag)  # the faster, the more a sample matters
    assert max(line.deviation for line in by_name["dahl-loops"].lines) < 1e-7
    force = by_name["lugre-break-away"].lines[0].published
    assert list(force) == sorted(force, reverse=True)
    assert force[0] == pytest.approx(1.432, abs=2e-3)


@pytest.mark.thorough
def test_a_published_curve_is_that_of_its_parameters(published):
    """Pre-sliding: to 0.95 F_s the bristles bend by more than 0.95 F_s/sigma_0, and some of it stays."""
    (line,) = {curve.name: curve for curve in published}["lugre-presliding"].lines
    assert line.published.max() == pytest.approx(1.425, abs=5e-3)  # the mass stops
    assert line.x.max() > 1e6 * 1.425 / 1e5
    assert line.x[-1] == pytest.approx(line.x.max(), rel=0.05)


def test_another_law_deviates_from_the_published_curve(published):
    (line,) = {curve.name: curve for curve in published}["lugre-presliding"].lines
    stiffer = given_law("lugre", [f"{key}={value!r}" for key, value in {**CANUDAS, "sigma_0_Nm_rad": 1.1e5}.items()])
    law = stiffer.along(np.arange(len(line.x)) * 1e-3, line.x * 1e-6, 1e-12).samples["torque_Nm"]
    assert replace(line, law=law).deviation > 0.02


def test_the_document_has_the_curves_with_their_sources(published):
    text = DOCS.read_text()
    assert [line for line in published_lines(published) if line not in text] == []


@pytest.mark.thorough
def test_each_curve_is_drawn_twice_the_same(published, tmp_path):
    first, second = (write_literature_figures(tmp_path / name, published) for name in "ab")
    assert [path.name for path in first] == [f"{curve.name}.{end}" for curve in published for end in ("png", "svg")]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


@pytest.mark.thorough
def test_the_verb_prints_the_tables_and_json(computed, published, monkeypatch, tmp_path):
    monkeypatch.setattr(published_curves, "literature_curves", lambda: published)
    monkeypatch.setattr(law_benchmarks, "benchmarks", lambda: computed[0])
    monkeypatch.setattr(law_benchmarks, "sweep", lambda: computed[1])
    done = CliRunner().invoke(main, ["analyse", "laws"])
    assert done.exit_code == 0
    assert done.stdout.splitlines() == [*lines(*computed), "", *published_lines(published)]
    told = json.loads(CliRunner().invoke(main, ["analyse", "laws", "--json", "--figures", str(tmp_path)]).stdout)
    assert [curve["curve"] for curve in told["curves"]] == [curve.name for curve in published]
    assert (tmp_path / "lugre-lag.svg").exists()
    assert [one["law"] for one in told["laws"]] == list(BUILTIN_LAWS)
    assert all(one["ok"] for one in told["benchmarks"])
    wrong = (replace(computed[0][0], found=0.0), *computed[0][1:])
    monkeypatch.setattr(law_benchmarks, "benchmarks", lambda: wrong)
    assert CliRunner().invoke(main, ["analyse", "laws"]).exit_code == 1
