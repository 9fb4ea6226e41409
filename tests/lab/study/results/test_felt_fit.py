"""Fits in the torque that a hand felt: what is judged is not what was commanded."""

import re

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.special import ndtri

from coulombus.cli.main import main
from coulombus.lab.study.observer import Faults, Observer
from coulombus.lab.study.results import report as report_module
from coulombus.lab.study.results.felt_fit import fit_felt
from coulombus.lab.study.results.report import report
from coulombus.lab.study.results.report_text import page
from coulombus.lab.study.session import People, SubjectSession, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import StudyFolderError, SubjectFolder
from study_text import TEXT

REFERENCE, GAIN, OFFSET_NM = 2.0, 0.5, 0.3


class Result:
    exit_status, trip, stopped_by, recording = 0, None, None, None


class HalfDisplays:
    """Leaves instead of a recording the torque that is felt: half the level and an offset."""

    def __call__(self, display):
        level = display.rig.one_axis().mode["hybrid"].F_s_Nm
        display.outputs.record.write_text(f"{GAIN * level + OFFSET_NM}")
        return Result()

    def stop(self):
        pass


def number_in(path):
    return float(path.read_text())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A study of an observer of JND 0.1 Nm, PSE 0.08 Nm off, that judges what it feels."""
    monkeypatch.setattr(report_module, "felt_Nm", number_in)
    levels = "levels = [1.2, 1.5, 1.8, 2.2, 2.5, 2.8]\nrepeats = 30"
    (tmp_path / "study.toml").write_text(TEXT.replace("levels = [1.6, 2.4]\nrepeats = 2", levels))
    with SubjectFolder(read_study(tmp_path / "study.toml"), tmp_path / "out", "S01", {}) as kept:

        def judged(trial):
            return [number_in(kept.recording(trial, number)) for number in (1, 2)]

        observer = Observer(0.1, 3, kept.number, judged, Faults(shift=0.08))
        people = People(tell=lambda text: None, ask=observer.answer, go_on=lambda text: True)
        assert run_session(SubjectSession(kept, HalfDisplays()), people).complete
    return tmp_path / "out"


def test_a_report_as_felt_is_in_the_torque_that_was_judged(folder):
    condition = report(folder, felt=True)["subjects"]["S01"]["a"]
    felt, fit = condition["felt"], condition["felt"]["fit"]
    assert (felt["reference_Nm"], felt["gain"]) == pytest.approx((GAIN * REFERENCE + OFFSET_NM, GAIN))
    assert felt["spread_Nm"] == pytest.approx(0.0, abs=1e-9)
    assert fit["jnd_95"][0] < 0.1 < fit["jnd_95"][1]
    assert fit["pse_95"][0] < 1.38 < fit["pse_95"][1]
    assert not fit["pse_95"][0] < 1.3 < fit["pse_95"][1]  # 180 answers tell the shift
    assert condition["fit"]["jnd"] == pytest.approx(fit["jnd"] / GAIN, rel=0.02)
    assert report(folder)["subjects"]["S01"]["a"]["felt"] is None


@pytest.mark.thorough
def test_thresholds_as_felt_are_printed(folder):
    came = CliRunner().invoke(main, ["analyse", "study", str(folder), "--felt"])
    assert came.exit_code == 0, came.output
    assert re.search(r"as felt: JND 0\.\d+ Nm \(0\.\d+ to 0\.\d+\), PSE 1\.\d+ Nm", came.output)
    assert "reference 1.3 Nm, 0.5 Nm for each Nm of the level, spread" in came.output
    assert "| JND felt [Nm] | PSE felt [Nm] | reference felt [Nm] |" in page(report(folder, felt=True))


def test_a_recording_that_is_gone_is_named(folder):
    next((folder / "sub-S01" / "recordings").iterdir()).unlink()
    with pytest.raises(StudyFolderError, match=r"trial-\d{4}_display-\d\.pcapng: cannot be read .* leave --felt out"):
        report(folder, felt=True)


@pytest.mark.thorough
def test_what_differs_between_two_displays_of_a_level_is_in_the_fit():
    rng = np.random.default_rng(6)
    levels = np.tile([1.4, 1.7, 2.3, 2.6], 60)
    felt = np.stack([levels, np.full(240, REFERENCE)], axis=1) + rng.normal(0, 0.3, (240, 2))
    sigma = 0.1 / ndtri(0.75)
    larger = felt[:, 0] + rng.normal(0, sigma, 240) > felt[:, 1]
    result = fit_felt(levels, felt, list(larger), REFERENCE, [True, False] * 120)
    assert result.spread_Nm == pytest.approx(0.3, rel=0.1)
    assert result.fit.jnd_95[0] < 0.1 < result.fit.jnd_95[1]
    assert result.fit.jnd_95[1] < 0.2  # by level the spread of 0.3 Nm would count as the observer's noise
    above = levels > REFERENCE
    assert not result.fit.one_sided
    assert fit_felt(levels[above], felt[above], list(larger[above]), REFERENCE, [True, False] * 60).fit.one_sided


def test_no_level_beside_the_reference_is_no_fit():
    with pytest.raises(ValueError, match="no level differs"):
        fit_felt([2.0, 2.0], [[2.0, 2.1], [2.1, 2.0]], [True, False], REFERENCE, [True, False])
