"""The brake's hysteresis from a recording: found, not found where there is none, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.rig.display_errors import broke_away, felt_control, iron_of
from coulombus.cli.main import main
from coulombus.lab.simulate import simulate
from coulombus.recording.friction.hysteresis_fit import identify_iron, iron_lines, play
from coulombus.recording.friction.sliding import IdentifyError
from coulombus.recording.reading import blocks
from coulombus.rigs.rig import load_rig

pytestmark = pytest.mark.slow  # in plain Python six minutes
IRON = [0.1, 0.4], [0.2, 0.2]


def strokes(seconds=8.0, *more):
    """Return the bench with strokes of changing speed against a damper: the set-point goes up and down."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, seconds, round(100 * seconds) + 1)
    size = np.interp(t, np.arange(0.0, seconds + 0.5, 0.5), rng.uniform(0.15, 1.0, round(2 * seconds) + 1))
    x = size * np.sin(2 * np.pi * 0.8 * t)
    course = f"t_s={[round(float(value), 4) for value in t]}, x_rad={[round(float(value), 6) for value in x]}"
    return load_rig("bench").variant(
        f'phase=[{{kind="rest", duration_s=1.0}}, {{kind="motion", duration_s={seconds}, {course}}}]',
        'law.function="viscous"',
        "law.viscous.B_Nms_rad=0.6",
        "law.viscous.most_Nm=4.0",
        "brake.coil_lag_s=0.003",
        "operator.stiffness_Nm_rad=60.0",
        "operator.damping_Nms_rad=2.0",
        "limits.sign_check_counts=4",
        "limits.speed_rad_s=50.0",
        *more,
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("iron") / "damper.pcapng"
    assert simulate(strokes(8.0, *iron_of("plant", *IRON)), "passive", 9.0, record=path).trip is None
    return path


def test_a_play_follows_at_its_distance_and_remembers():
    assert play(np.array([0.0, 0.05, 1.0, 0.95, 0.5, 0.0]), 0.1).tolist() == pytest.approx([0, 0, 0.9, 0.9, 0.6, 0.1])


def test_plays_weights_and_lag_are_found(recording):
    fit = identify_iron(blocks(recording).one_axis(None))
    assert fit.play_Nm == pytest.approx(IRON[0], rel=0.1)
    assert fit.weights == pytest.approx(IRON[1], rel=0.1)
    assert fit.fluid_lag_s == pytest.approx(0.0155, abs=1e-3)  # half a cycle more: the set-point acts on the next SYNC
    assert fit.gain == pytest.approx(1.0, abs=0.02)
    assert fit.residual_rms_Nm < 0.1 * fit.residual_without_Nm


def test_with_what_was_found_the_handle_breaks_away_at_F_s(recording):
    fit = identify_iron(blocks(recording).one_axis(None))
    known = felt_control(load_rig("bench").variant(*iron_of("plant", *IRON))).variant(
        *iron_of("brake", fit.play_Nm, fit.weights)
    )
    assert broke_away(known, 1.0, -30.0, mode="passive") == pytest.approx(1.0, rel=0.02)


def test_no_hysteresis_is_found_where_there_is_none(tmp_path):
    simulate(strokes(4.0), "passive", 5.0, record=tmp_path / "plain.pcapng")
    fit = identify_iron(blocks(tmp_path / "plain.pcapng").one_axis(None))
    assert fit.play_Nm == ()
    assert iron_lines(fit)[-1] == "no hysteresis is seen: no [brake.iron] is needed"


@pytest.mark.thorough
def test_the_verb_prints_the_section_and_its_json(recording):
    result = CliRunner().invoke(main, ["identify", str(recording), "--iron"])
    assert result.exit_code == 0
    section = result.stdout.partition("[brake.iron]")[2].split("\n")
    assert section[1].startswith("play_Nm = [0.1")
    document = json.loads(CliRunner().invoke(main, ["identify", str(recording), "--iron", "--json"]).stdout)
    load_rig("bench", [f"brake.iron.{key}={value}" for key, value in document["iron"].items()])


def test_a_recording_without_changing_set_points_is_refused_with_what_to_record(tmp_path):
    simulate("bench", "active", 1.0, record=tmp_path / "active.pcapng")
    with pytest.raises(
        IdentifyError, match=r"samples slide, and the brake's set-point goes from 0 to 0 Nm .* --law viscous"
    ):
        identify_iron(blocks(tmp_path / "active.pcapng").one_axis(None))


@pytest.mark.parametrize("more", [["--law", "lugre"], ["--set", "a=1"], ["--figure", "a.png"]])
def test_the_fit_of_the_iron_goes_alone(recording, more):
    result = CliRunner().invoke(main, ["identify", str(recording), "--iron", *more])
    assert result.exit_code == 2
    assert "--iron goes with none of" in result.stderr
