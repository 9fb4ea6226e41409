"""The report of a folder: a simulated observer goes through the whole chain."""

from collections.abc import Callable

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.special import ndtr, ndtri

from coulombus.cli.main import main
from coulombus.lab.study.methods import Mirrored, Staircase
from coulombus.lab.study.observer import Observer, levels
from coulombus.lab.study.results.fit import LEAST_TRIALS
from coulombus.lab.study.results.pictures import write_figures
from coulombus.lab.study.results.report import _mixed, _study_of, report
from coulombus.lab.study.results.report_text import lines, page
from coulombus.lab.study.results.staircase import staircases
from coulombus.lab.study.session import People, SubjectSession, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import StudyFolderError, SubjectFolder
from study_text import TEXT

STAIRS = 'kind = "staircase"\nstart = 2.1\nlow = 2.0\nhigh = 3.2\nsteps = [0.05]\ntrials = 80\n'
CONSTANT = TEXT.replace("[1.6, 2.4]", "[1.6, 1.8, 1.9, 2.1, 2.2, 2.4]").replace("repeats = 2", "repeats = 20")
TWO = TEXT[: TEXT.index("kind =")] + STAIRS + '[[condition]]\nname = "a"\n[[condition]]\nname = "b"\nmode = "passive"\n'

PAIRS = ((0.10, 0.16), (0.12, 0.17), (0.15, 0.22), (0.18, 0.28), (0.20, 0.29))


class Nothing:
    exit_status, trip, stopped_by, recording = 0, None, None, None


class Nowhere:
    def __call__(self, display):
        return Nothing()

    def stop(self):
        pass


@pytest.fixture
def keep(tmp_path) -> Callable[..., None]:
    def run(text: str, *jnds: float) -> None:
        (tmp_path / "study.toml").write_text(text)
        study = read_study(tmp_path / "study.toml")
        for number, jnd in enumerate(jnds, 1):
            with SubjectFolder(study, tmp_path / "out", f"S{number:02d}", {}) as own:
                observer = Observer(jnd, 3, own.number)
                people = People(tell=lambda text: None, ask=observer.answer, go_on=lambda text: True)
                assert run_session(SubjectSession(own, Nowhere()), people).complete

    return run


@pytest.mark.thorough
def test_staircases_come_to_the_observers_thresholds(keep, tmp_path):
    jnds = (0.13, 0.17)
    keep(TWO, *jnds)
    found = report(tmp_path / "out")
    held = []
    for jnd, conditions in zip(jnds, found["subjects"].values(), strict=True):
        for one in conditions.values():
            assert one["fit"]["trials"] == one["trials"] == 80
            held.append(one["fit"]["jnd_95"][0] < jnd < one["fit"]["jnd_95"][1])
            assert one["fit"]["right"] == pytest.approx(0.7071, abs=0.08)
            assert one["staircase"]["right"] == pytest.approx(0.7071, abs=0.1)
            at_707 = 2.0 + jnd / ndtri(0.75) * ndtri(0.7071)
            assert one["staircase"]["threshold"] == pytest.approx(at_707, abs=0.06)
    assert sum(held) >= 3  # of four intervals of 95 %
    low, high = found["conditions"]["a"]["jnd_95"]
    assert low < 0.15 < high
    assert "2 subjects" in "\n".join(lines(found))
    assert f"JND {found['conditions']['a']['jnd']:.4g} Nm (" in "\n".join(lines(found))
    assert [found["conditions"]["a"][key] for key in ("subjects", "left_out")] == [2, {}]
    assert found["conditions"]["a"]["hierarchical"]["subjects"] == 2
    told = page(found)
    assert "The level is F_s [Nm]." in told
    assert "| JND [Nm] | PSE [Nm] |" in told
    assert "exponent" not in told  # a column that is empty
    names = {path.name for path in write_figures(found, tmp_path / "figures")}
    assert {"sub-S01_track.png", "sub-S02_psychometric.svg", "conditions.png", "report.md"} <= names


@pytest.mark.parametrize(
    ("level", "told"),
    [
        ('"law.texture.depth_Nm" = 0.5\n"law.texture.period_rad" = 1.0', ("period", "rad")),
        ('"mode.hybrid.compensation" = 1.0', ("compensation", "")),
        ('"law.lugre.sigma_1_Nms_rad" = 2.0', ("sigma_1", "Nm s/rad")),
    ],
)
def test_the_level_is_the_key_that_it_is_set_to(tmp_path, level, told):
    (tmp_path / "study.toml").write_text(f'name = "n"\n[level]\n{level}\n[method]\nkind = "free"\n')
    assert _study_of(tmp_path)["level"] == dict(zip(("quantity", "unit"), told, strict=True))
    (tmp_path / "study.toml").write_text("[level]\nx = 'a'\n")
    assert _study_of(tmp_path)["level"] == {"quantity": "", "unit": ""}


@pytest.mark.thorough
def test_pictures_are_the_same_for_the_same_answers(keep, tmp_path):
    keep(TEXT.replace("repeats = 2", "repeats = 15"), 0.15)
    first, second = (write_figures(report(tmp_path / "out"), tmp_path / name) for name in ("one", "two"))
    assert [path.name for path in first] == ["sub-S01_psychometric.png", "sub-S01_psychometric.svg", "report.md"]
    assert "JND" in first[-1].read_text()
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_magnitudes_come_to_their_exponent(keep, tmp_path):
    text = (
        TEXT.replace("reference = 2.0\n", "")
        .replace('"constant"', '"magnitude"')
        .replace("repeats = 2", "repeats = 30")
    )
    keep(text, 0.05)
    told = report(tmp_path / "out")["subjects"]["S01"]["a"]["magnitudes"]
    assert told["exponent_95"][0] < 1.0 < told["exponent_95"][1]


def test_conditions_are_compared_by_a_mixed_model():
    pytest.importorskip("statsmodels")
    fits = {f"S{k}": {"a": {"fit": {"jnd": a}}, "b": {"fit": {"jnd": b}}} for k, (a, b) in enumerate(PAIRS)}
    model, why_not = _mixed(fits)
    assert why_not is None
    low, high = model["jnd_ratio"]["b"]["ratio_95"]
    assert model["against"] == "a"
    assert 1.2 < low < 1.5 < high < 1.9  # b is 1.5 times a, but for a few per cent


@pytest.mark.thorough
def test_the_mixed_models_interval_holds_a_known_effect_in_90_to_99_of_100_studies(recwarn):
    pytest.importorskip("statsmodels")
    draw, held = np.random.default_rng(0), 0
    for _ in range(100):
        own, left = draw.normal(0.0, 0.3, 6), draw.normal(0.0, 0.12, (6, 2))
        fits = {
            f"S{k}": {
                name: {"fit": {"jnd": float(np.exp(own[k] + effect + left[k, c]))}}
                for c, (name, effect) in enumerate((("a", 0.0), ("b", 0.4)))
            }
            for k in range(6)
        }
        model, why_not = _mixed(fits)
        assert why_not is None
        low, high = model["jnd_ratio"]["b"]["ratio_95"]
        held += low <= np.exp(0.4) <= high
    assert 90 <= held <= 99
    assert not recwarn.list  # what statsmodels thinks of its search concerns no reader


def test_a_folder_of_no_study_and_a_broken_row_are_told(keep, tmp_path):
    result = CliRunner().invoke(main, ["analyse", "study", str(tmp_path)])
    assert result.exit_code == 2
    assert "holds no study" in result.output
    keep(TEXT, 0.15)
    path = tmp_path / "out" / "sub-S01" / "sub-S01_task-jnd_events.tsv"
    path.write_text(path.read_text().replace("\t2.4\t", "\tx\t"))
    with pytest.raises(StudyFolderError, match="is not a number"):
        report(tmp_path / "out")


@pytest.mark.thorough
def test_a_mean_counts_who_entered_it_and_names_who_did_not(keep, tmp_path):
    keep(TWO, 0.13, 0.17, 1e-4, 0.15)
    events = sorted((tmp_path / "out").glob("sub-*/*_events.tsv"))
    few = events[3].read_text().splitlines(keepends=True)
    events[3].write_text("".join(few[: 1 + LEAST_TRIALS - 1]))
    results = report(tmp_path / "out")
    condition = results["conditions"]["a"]
    assert condition["subjects"] == 2
    assert condition["left_out"] == {
        "S03": "its answers bound the JND on one side only, or on none",
        "S04": "no trial",
    }
    jnds = [results["subjects"][subject]["a"]["fit"]["jnd"] for subject in ("S01", "S02")]
    assert condition["jnd"] == pytest.approx(np.sqrt(jnds[0] * jnds[1]))
    assert results["subjects"]["S04"]["b"]["fit"] is None  # the first block of S04
    assert condition["hierarchical"]["subjects"] == 3
    text = "\n".join(lines(results))
    assert "geometric mean of 2 subjects; left out: S03: its answers bound" in text
    assert f"S04 b: {LEAST_TRIALS - 1} trials, not fitted" in text
    assert results["conditions"]["b"]["left_out"]["S04"] == f"{LEAST_TRIALS - 1} answers; a fit needs {LEAST_TRIALS}"
    assert "not fitted" in page(results)


@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_two_staircases_come_to_one_threshold_and_a_shift_cancels(shift):
    rng = np.random.default_rng(3)
    both = Mirrored(2.0, *(Staircase(2.6, (2.0, 3.2), [0.1, 0.05], 2, 1.0, 400) for _ in range(2)), rng)
    levels, larger = [], []
    while not both.done:
        levels.append(both.level())
        larger.append(bool(rng.random() < ndtr((levels[-1] - 2.0 - shift) / 0.3)))
        both.update(levels[-1], larger[-1] if levels[-1] >= 2.0 else not larger[-1])
    turned = staircases(levels, larger, 2.0)
    assert turned["threshold"] == pytest.approx(2.0 + 0.3 * ndtri(0.7071), abs=0.04)
    assert turned["right"] == pytest.approx(0.7071, abs=0.05)
    folded = staircases(
        [x for x in levels if x > 2.0], [took for x, took in zip(levels, larger, strict=True) if x > 2.0], 2.0
    )
    assert folded["turns"] < turned["turns"]


@pytest.mark.thorough
def test_a_pse_that_drifts_is_named(tmp_path):
    (tmp_path / "study.toml").write_text(CONSTANT)
    study = read_study(tmp_path / "study.toml")

    def drifting(trial):
        own = trial.first - 1
        return [level - (k == own) * (trial.number - 60) / 120 for k, level in enumerate(trial.levels)]

    for folder, judged in (("still", levels), ("drifts", drifting)):
        with SubjectFolder(study, tmp_path / folder, "S01", {}) as own:
            people = People(
                tell=lambda text: None, ask=Observer(0.15, 3, own.number, judged).answer, go_on=lambda text: True
            )
            assert run_session(SubjectSession(own, Nowhere()), people).complete
    assert "drifts" not in "\n".join(lines(report(tmp_path / "still")))
    text = "\n".join(lines(report(tmp_path / "drifts")))
    assert "; the PSE drifts by " in text
    assert "which widens the JND" in text
