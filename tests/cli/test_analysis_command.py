"""`coulombus analyse`: the machine-readable contract, the verbs, what is refused.

Figures are the same bytes twice.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.figures.frequency import loci, write_frequency_figures
from coulombus.analysis.figures.report import plain
from coulombus.analysis.figures.time import orbit_samples, write_fig10, write_orbit_figure
from coulombus.analysis.theory.absolute import absolute_stability
from coulombus.analysis.theory.crossings import crossings
from coulombus.analysis.theory.fig10 import figure_10
from coulombus.analysis.theory.orbits import orbits
from coulombus.analysis.theory.parameters import Parameters
from coulombus.cli.main import main


def run(*arguments, status=0):
    result = CliRunner().invoke(main, ["analyse", *arguments])
    assert result.exit_code == status, result.output
    return result.stdout if status == 0 else result.output


@pytest.fixture(scope="module")
def whole():
    return json.loads(run("--json"))


@pytest.mark.thorough
def test_contract_of_the_frequency_domain(whole):
    (crossing,) = whole["crossings"]
    assert crossing["frequency_Hz"] == pytest.approx(252.3, abs=0.05)
    assert crossing["amplitude_m_s"] == pytest.approx(-40 * crossing["h_real"] / np.pi)
    assert crossing["stable"] is True
    disk = {name: np.array(values) for name, values in whole["passive_disk"].items()}
    expected = np.exp(-2j * np.pi * disk["frequency_Hz"] * 1e-3)
    assert disk["center_re"] + 1j * disk["center_im"] == pytest.approx(expected)
    assert disk["radius"] == pytest.approx(np.ones(len(expected)))
    slopes = whole["certified_slope_Ns_m"]
    assert slopes["passive_set"] == pytest.approx(0.5)
    assert slopes["tsypkin"] < slopes["zames_falb"] < -1 / crossing["h_real"]


@pytest.mark.thorough
def test_contract_of_the_time_domain(whole):
    assert {orbit["pattern"] for orbit in whole["orbits"]} == {"++--", "++-", "+--", "+-"}
    for orbit in whole["orbits"]:
        assert orbit["period_samples"] == len(orbit["pattern"])
        assert {"velocity_peak_m_s", "stable"} <= set(orbit)
    for name in ("active", "passive"):
        found = whole["fig10"][name]
        trace = found["trace"]
        assert all(len(trace[key]) == 10_000 for key in ("t_s", "x_m", "v_m_s", "force_N"))
        force = np.array(trace["force_N"])
        signs = np.sign(force[force != 0])
        assert found["force_flips_per_s"] == pytest.approx(np.sum(signs[1:] != signs[:-1]) / 10)
        assert found["velocity_rms_above_20Hz_m_s"] > found["velocity_rms_above_100Hz_m_s"] > 0
        assert found["force_rms_above_20Hz_N"] > 0
    assert whole["fig10"]["active"]["stick_intervals_s"] == []
    assert len(whole["fig10"]["passive"]["stick_intervals_s"]) == 9


@pytest.mark.thorough
def test_contract_of_tables(whole):
    pairs = {(row["sample_rate_Hz"], row["delay_s"]) for row in whole["delay_table"]}
    assert pairs == {(r, d) for r in (250.0, 500.0, 1000.0, 2000.0, 4000.0) for d in (0.0, 0.5e-3, 1e-3, 2e-3)}
    for row in whole["delay_table"]:
        assert row["simulated_Hz"] == pytest.approx(row["predicted_Hz"], rel=0.3)
        assert row["simulated_amplitude_m_s"] == pytest.approx(row["predicted_amplitude_m_s"], rel=0.3)
    friction = whole["friction"]
    assert friction["coulomb_before_Nm"] == pytest.approx(0.14, abs=0.003)
    assert abs(friction["coulomb_after_Nm"]) <= 0.005
    assert {"actuation", "delay_s", "frequency_Hz"} <= set(whole["through_bus"][0])


def test_verbs_and_their_options():
    found = json.loads(run("nyquist", "--delay", "1e-3", "--json"))
    assert found["crossings"][0]["frequency_Hz"] == pytest.approx(127.1, abs=0.1)
    assert json.loads(run("nyquist", "--operator-rational", "1.287,29.33,178/1,0", "--json"))["crossings"]
    found = json.loads(run("fig10", "--window", "0.5", "--friction", "5", "--json"))
    assert max(found["fig10"]["active"]["trace"]["force_N"]) == 5.0
    found = json.loads(run("limit-cycle", "--no-table", "--starts", "0", "--json"))
    assert found["orbits"][0]["pattern"] == "++--"
    assert "no crossing" in run("nyquist", "--mass", "1e-6", "--damping", "50", "--operator", "0", "1", "0")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("nyquist", "--mass", "-1"), "negative"),
        (("fig10", "--mass", "nan"), "finite"),
        (("limit-cycle", "--delay", "11"), "not shorter than window_s"),
        (("nyquist", "--operator-rational", "1,0,0,0/1"), "improper"),
        (("nyquist", "--operator-rational", "1/1,-1"), "not passive"),
        (("nyquist", "--operator", "1", "-2", "3"), "passive"),
        (("--mass", "1", "nyquist"), "after the verb"),
    ],
)
def test_bad_input_is_refused_with_the_reason(arguments, reason):
    assert reason in run(*arguments, status=2)


def test_orbit_figure_shows_the_orbit():
    parameters = Parameters()
    found = orbits(parameters).found
    assert found
    for orbit in found:
        v, u = orbit_samples(orbit, parameters)
        assert np.min(u * v) == pytest.approx(orbit.margin_m_s)
        assert np.max(np.abs(v)) == pytest.approx(orbit.velocity_peak_m_s)


def test_loci_hold_what_is_drawn():
    data = loci(Parameters())
    assert np.all(np.abs(data.continuous - 1.0) <= 1.0)  # within the disk of Fig. 6
    assert data.disks is not None
    assert data.disks.frequency_Hz[-1] == 500.0


@pytest.mark.thorough
def test_figures_are_deterministic(tmp_path: Path):
    parameters = Parameters()
    found, absolute, runs, motions = (
        crossings(parameters),
        absolute_stability(parameters),
        figure_10(parameters),
        orbits(parameters),
    )
    sets = []
    for name in ("one", "two"):
        sets.append(write_fig10(tmp_path / name, runs) + write_orbit_figure(tmp_path / name, parameters, motions))
    assert len(write_frequency_figures(tmp_path, parameters, found, absolute)) == 8
    assert len(sets[0]) == 4
    for a, b in zip(*sets, strict=True):
        assert a.read_bytes() == b.read_bytes()


def test_plain_is_json():
    value = plain({"a": np.float64("nan"), "b": np.arange(2), "c": 1 + 2j, "d": crossings(Parameters())})
    text = json.dumps(value, allow_nan=False)
    assert json.loads(text)["a"] is None
    assert json.loads(text)["b"] == [0, 1]
