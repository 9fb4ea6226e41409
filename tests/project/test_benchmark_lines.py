"""The lines of the benchmarks: goals, verdicts, and two results side by side."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from benchmarks import __main__ as benchmarks
from benchmarks.catalogue import BESIDE, SENTENCES
from benchmarks.compare import changes, compare
from benchmarks.report import keep, line_of, show, take_lines
from places import ROOT


@pytest.mark.parametrize(
    ("figure", "target", "verdict"),
    [
        ("410 x", "at least 300 x real time", "met"),
        ("300 x", "at least 300 x", "met"),
        ("1,203 x", "at least 1,504 x", "missed by 20%"),
        ("0.50", "at most 0.5", "met"),
        ("1.48 x", "at most 1.2 x", "missed by 23%"),
        ("-0.2 s", "at most 3 s", "met"),
        ("skipped", "at most 2 x", ""),
        ("12 x", "ours 1.2 s", ""),
        ("12 x", "", ""),
    ],
)
def test_a_figure_is_held_against_its_goal(figure, target, verdict):
    assert line_of("any", figure, target).verdict == verdict


def test_what_is_shown_is_printed_and_kept_once(capsys, tmp_path):
    take_lines()
    show("speed", "90 x", "at least 100 x", [80.0, 90.0, 95.0])
    show("memory", "2 MB")
    assert capsys.readouterr().out.split("\n")[0].endswith("90 x   at least 100 x: missed by 10%")
    path = keep("virtual", take_lines(), 1.26, tmp_path / "bench")
    kept = json.loads(path.read_text())
    assert (path.name, kept["benchmark"], kept["seconds"]) == ("virtual.json", "virtual", 1.3)
    assert kept["machine"].keys() == {"processor", "cores", "system", "python", "numba", "load"}
    assert [line["verdict"] for line in kept["lines"]] == ["missed by 10%", ""]
    assert take_lines() == []


def result(path, *lines):
    """Write a result with lines of (what, rounds, target)."""
    rows = [
        asdict(line_of(what, f"{sorted(rounds)[len(rounds) // 2]} x", target, rounds)) for what, rounds, target in lines
    ]
    path.write_text(json.dumps({"benchmark": "b", "lines": rows}))
    return path


SPEED, TIME = "at least 50 x", "at most 50 x"


@pytest.mark.parametrize(
    ("target", "before", "after", "verdict"),
    [
        (SPEED, [99, 100, 101], [89, 90, 91], "slower"),
        (SPEED, [99, 100, 101], [109, 110, 111], "faster"),
        (SPEED, [80, 100, 120], [70, 90, 110], ""),  # within the spreads
        (SPEED, [100, 100, 100], [99, 99, 99], ""),  # within 2 %
        (TIME, [99, 100, 101], [109, 110, 111], "slower"),
        (TIME, [99, 100, 101], [89, 90, 91], "faster"),
        (SPEED, [100], [91], ""),
        (SPEED, [100], [89], "slower"),
    ],
)
def test_a_change_counts_beyond_the_noise(tmp_path, target, before, after, verdict):
    a = result(tmp_path / "a.json", ("speed", before, target))
    b = result(tmp_path / "b.json", ("speed", after, target))
    (change,) = changes(a, b)
    assert change.verdict == verdict
    assert compare(a, b) == (verdict == "slower")


def test_figures_of_one_result_alone_and_those_without_a_goal_are_left_out(tmp_path):
    a = result(tmp_path / "a.json", ("old", [1], SPEED), ("plain", [1], ""), ("both", [2], SPEED))
    b = result(tmp_path / "b.json", ("new", [1], SPEED), ("plain", [9], ""), ("both", [2], SPEED))
    assert [change.what for change in changes(a, b)] == ["b: both"]


def test_folders_are_compared_file_by_file_the_worst_first(tmp_path, capsys):
    for folder, speed in (("a", 100), ("b", 50)):
        (tmp_path / folder).mkdir()
        result(tmp_path / folder / "one.json", ("steady", [100], SPEED), ("sinking", [speed], SPEED))
    assert compare(tmp_path / "a", tmp_path / "b") == 1
    lines = capsys.readouterr().out.splitlines()
    assert "sinking" in lines[0]
    assert "-50.0%" in lines[0]
    assert lines[0].endswith("slower")
    assert lines[-1] == "1 of 2 figures became slower beyond the noise"


def test_every_benchmark_is_one_sentence_of_the_document():
    page = (ROOT / "docs" / "performance.md").read_text()
    words = " ".join(page.split())
    for name, sentence in SENTENCES.items():
        assert f"`{name}`" in page
        assert sentence.count(". ") == 0
        assert sentence in words, name
    assert not set(SENTENCES) & set(BESIDE)


def test_after_the_time_the_rest_is_named_as_skipped(monkeypatch, capsys):
    monkeypatch.setattr(benchmarks, "MOST_S", 0.0)
    monkeypatch.setattr(benchmarks.subprocess, "Popen", None)
    assert benchmarks.run_all([]) == 0
    out = capsys.readouterr().out
    assert all(f"python -m benchmarks {name} runs it" in out for name in SENTENCES)


def test_a_benchmark_that_fails_does_not_end_the_others(monkeypatch, capsys):
    started = []

    class Process:
        def __init__(self, words):
            started.append(words[3])

        def wait(self, timeout):
            return 7 if started[-1] == "virtual" else 0

        def terminate(self):
            pass

    monkeypatch.setattr(benchmarks.subprocess, "Popen", Process)
    assert benchmarks.run_all(["--smallest"]) == 1
    assert started == list(SENTENCES)
    assert capsys.readouterr().err == "benchmarks: failed: virtual\n"
