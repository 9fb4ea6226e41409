"""The programs that measure how often the intervals of a study hold the truth."""

import numpy as np
import pytest

from benchmarks import observer_displays, observer_groups, observers
from coulombus.lab.study.observer import Observer

SHORT = 'kind = "constant"\nlevels = [1.2, 1.6, 2.4, 2.8]\nrepeats = 5\n'


@pytest.mark.long
def test_an_observer_judges_what_its_hand_felt_of_each_display(monkeypatch):
    monkeypatch.setitem(observer_displays.METHODS, "short", SHORT)
    judged = []

    class Listening(Observer):
        def answer(self, trial):
            judged.append((trial.levels, self._judged(trial)))
            return super().answer(trial)

    monkeypatch.setattr(observer_displays, "Observer", Listening)
    result = observer_displays.displayed("short", 1)
    assert len(judged) == result.felt["fit"]["trials"] == 20
    errors = [felt - level for levels, figures in judged for level, felt in zip(levels, figures, strict=True)]
    assert 0.0 < min(errors) < max(errors) < 0.1
    assert len({round(error, 6) for error in errors}) > 30  # no two displays feel alike
    assert result.felt["gain"] == pytest.approx(1.0, abs=0.02)
    assert result.felt["fit"]["pse"] - result.fit["pse"] == pytest.approx(0.04, abs=0.02)


def test_an_interval_holds_the_truth_as_felt_or_as_commanded():
    fit = {"jnd_95": (0.1, None), "pse_95": (1.9, 2.0)}
    felt = {"fit": {"jnd_95": (0.2, 0.3), "pse_95": (2.0, 2.1)}, "reference_Nm": 2.05}
    result = observer_displays.Chain(0.15, 0.01, fit, felt)
    assert [result.held("jnd", way) for way in (True, False)] == [False, True]
    assert [result.held("pse", way) for way in (True, False)] == [True, False]


def test_a_group_is_drawn_from_its_pool_and_no_observer_twice(monkeypatch):
    monkeypatch.setattr(observer_groups, "SIZE", 3)
    pool = [observer_groups.pooled("QUEST+, 80 trials", "ideal", subject) for subject in range(4)]
    groups = [observer_groups.group_fit(pool, number) for number in (0, 1, 2, 0)]
    assert groups[0] == groups[3]
    assert len({group.jnd for group in groups}) > 1
    for group in groups:
        assert len(set(group.subject_jnd.values())) == group.subjects == 3
        assert group.jnd_95[0] < np.exp(np.mean(np.log([jnd for jnd, _ in pool]))) < group.jnd_95[1]


def test_a_table_is_written_between_its_marks_alone(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- groups: begin -->\nold\n<!-- groups: end -->\nb\n<!-- displays: begin -->\n")
    observers.write_table(page, "groups", "Said:", [("x", "y"), ("1", "2")])
    table = "Said:\n\n| x | y |\n| --- | --- |\n| 1 | 2 |\n"
    text = f"a\n<!-- groups: begin -->\n{table}<!-- groups: end -->\nb\n<!-- displays: begin -->\n"
    assert page.read_text() == text
