"""The demo in the plane: its runs, its verdict, and the numbers of its picture."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.figures.plane_runs import arrows, draw_plane_demo
from coulombus.cli.main import main
from coulombus.lab.demo.plane_demo import directional_force, run_plane_demo
from coulombus.lab.plane_figures import TipSamples
from coulombus.rigs.rig import RigError, load_rig

HOLD = 'kind="tip_hold", duration_s=1.6, push_F_s=0.6, frequency_Hz=0.5, direction_rad=0.8'
CIRCLE = 'kind="tip_circle", duration_s=2.0, radius_m=0.05, frequency_Hz=1.0, approach_s=0.4'
SCHEDULE = f'phase=[{{kind="rest", duration_s=1.2}}, {{{HOLD}}}, {{{CIRCLE}}}]'


def on_a_circle(turn_deg=0.0, size=1.0, count=3600):
    """Return samples of a circle against the clock whose displayed force is turned and scaled."""
    angle = 2 * math.pi * np.arange(count) / count
    x_m = 0.05 * np.stack((np.cos(angle), -np.sin(angle)), axis=1) + (0.2, -0.1)
    v_m_s = 0.3 * np.stack((-np.sin(angle), -np.cos(angle)), axis=1)
    wanted_N = -10.0 * v_m_s
    turn = math.radians(turn_deg)
    shown_N = size * wanted_N @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return TipSamples(angle, x_m, v_m_s, shown_N, wanted_N, -shown_N, shown_N, np.ones(count, bool))


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plane")
    return run_plane_demo(load_rig("plane", (SCHEDULE,)), folder), folder


@pytest.mark.thorough
@pytest.mark.slow
def test_motors_alone_oscillate_and_brakes_alone_miss_the_direction(shown):
    demo, _ = shown
    assert list(demo.runs) == ["active", "passive", "hybrid"]
    assert demo.passed, demo.criteria
    assert demo.runs["hybrid"].hold_counts == demo.runs["passive"].hold_counts == {"shoulder": 0, "elbow": 0}
    assert demo.runs["active"].hold_rms_m_s > 0.005 > demo.runs["hybrid"].hold_rms_m_s
    push = [run.hold_push_N for run in demo.runs.values()]
    assert push[1:] == pytest.approx([0.6 * 3.3] * 2, rel=0.03)


@pytest.mark.slow
def test_its_files_have_what_the_run_had(shown):
    demo, folder = shown
    written = json.loads((folder / "demo.json").read_text())
    assert written["passed"] is True
    assert written["hybrid"]["plane"] == demo.runs["hybrid"].result.plane
    assert written["hybrid"]["hold_tip_push_N"] == demo.runs["hybrid"].hold_push_N
    assert {path.name for path in folder.iterdir()} == {
        *("active.pcapng", "passive.pcapng", "hybrid.pcapng", "demo.json")
    }


@pytest.mark.thorough
@pytest.mark.slow
def test_a_display_that_misses_the_law_fails(shown, tmp_path):
    rig = load_rig("plane", (SCHEDULE, "brake.fluid_lag_s=0.001", "brake.coil_lag_s=0"))  # the host is wrong
    demo = run_plane_demo(rig, tmp_path)
    wrong = [criterion.text for criterion in demo.criteria if criterion.holds is False]
    assert wrong
    assert all(text.startswith("hybrid motion") for text in wrong)
    assert not demo.passed


def test_the_mean_force_is_that_of_its_direction():
    samples = on_a_circle(turn_deg=25.0, size=1.2)
    force = directional_force(samples, 36)
    motion = np.radians(5.0 + 10.0 * np.arange(36))
    expected = motion + math.pi + math.radians(25.0)
    mean = 3.6 * math.sin(math.radians(5)) / math.radians(5)  # over a sector of 10 degrees
    assert force == pytest.approx(mean * np.stack((np.cos(expected), np.sin(expected)), axis=1), abs=0.02)
    half = replace(samples, compared=samples.v_m_s[:, 1] > 0)
    assert np.isnan(directional_force(half, 36)[18:]).all()
    assert np.isfinite(directional_force(half, 36)[:18]).all()


def test_arrows_are_spread_over_the_directions_of_motion():
    samples = on_a_circle(turn_deg=-40.0)
    drawn = arrows(samples, 12)
    assert len(drawn.x_m) == 12
    cosine = (drawn.shown_N * drawn.wanted_N).sum(axis=1) / 9.0
    assert cosine == pytest.approx(math.cos(math.radians(40)))
    off_deg = np.sort(np.degrees(np.arctan2(drawn.wanted_N[:, 1], drawn.wanted_N[:, 0])) % 360)
    assert off_deg == pytest.approx(15 + 30 * np.arange(12), abs=3.5)
    assert samples.off_deg == pytest.approx(40.0)


@pytest.mark.slow
def test_the_picture_shows_each_mode_over_the_directions(shown):
    demo, _ = shown
    made = draw_plane_demo(demo)
    titles = [axes.get_title(loc="left") for axes in made.axes]
    assert [title.split(":")[0] for title in titles[:3]] == ["active", "passive", "hybrid"]
    (curve,) = (line for line in made.axes[3].lines if line.get_label() == "hybrid")
    size = np.hypot(curve.get_xdata(), curve.get_ydata())
    assert size == pytest.approx(3.0, rel=0.1)
    brakes = next(line for line in made.axes[3].lines if line.get_label() == "passive")
    assert np.nanmax(np.hypot(brakes.get_xdata(), brakes.get_ydata())) > 3.6


@pytest.mark.slow
def test_a_rig_without_the_brakes_alone_is_shown_without_them(tmp_path):
    text = re.sub(r"\[mode\.passive\]\n(?:[^\[\n]+\n)+", "", load_rig("plane").text)
    (tmp_path / "rig.toml").write_text(text)
    rig = load_rig(tmp_path / "rig.toml", (SCHEDULE,))
    demo = run_plane_demo(rig, tmp_path / "out")
    assert list(demo.runs) == ["active", "hybrid"]
    assert len(draw_plane_demo(demo).axes) == 4


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (("bench",), r"has no \[kinematics\]"),
        (("plane", (f'phase=[{{kind="rest", duration_s=1.0}}, {{{CIRCLE}}}]',)), "no .* of kind 'tip_hold'"),
    ],
)
def test_a_rig_that_cannot_show_it_is_refused(rig, words, tmp_path):
    with pytest.raises(RigError, match=words):
        run_plane_demo(load_rig(*rig), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
@pytest.mark.slow
def test_the_verb_takes_the_rig_plane_and_prints_a_column_a_mode(tmp_path):
    result = CliRunner().invoke(main, ["demo", "--plane", "--set", SCHEDULE, "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0].split() == ["active", "passive", "hybrid"]
    assert next(line for line in lines if "elbow peak to peak" in line).endswith("0 counts  0 counts")
    assert (tmp_path / "out" / "demo.png").read_bytes().startswith(b"\x89PNG")
    refused = CliRunner().invoke(main, ["demo", "--plane", "--rig", "bench", "--out", str(tmp_path / "b")])
    assert refused.exit_code == 3
    assert "[kinematics]" in refused.stderr
