"""The trip is the last marker of a recording, whether or not a frame follows it."""

from __future__ import annotations

import json
import shutil

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.explain.explained import explain
from coulombus.explain.explanation_text import screen
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig

pytestmark = pytest.mark.slow
STUCK = '[[fault]]\nkind = "stuck_dominant"\nafter = "enabled"\nat_s = 2.4\n'
RIG = load_rig("bench")


@pytest.fixture(scope="module")
def stuck(tmp_path_factory):
    """A recording of a wire that stays dominant, and the result of its run."""
    folder = tmp_path_factory.mktemp("stuck")
    (folder / "stuck.toml").write_text(STUCK)
    result = simulate(RIG, "hybrid", 3.0, record=folder / "r.pcapng", faults=folder / "stuck.toml")
    return folder / "r.pcapng", result


def test_a_wire_that_stays_dominant_ends_with_the_trip_at_its_time(stuck):
    path, result = stuck
    recording = read(path)
    assert recording.markers[-2:] == [
        (result.trip_ns / 1e9, "phase end"),
        (result.trip_ns / 1e9, f"trip {result.trip}"),
    ]
    assert recording.ends_s[1] < recording.markers[-1][0]
    assert result.trip.startswith("TPDO_LOST")


def test_explain_names_that_trip_and_does_not_call_the_host_well(stuck):
    explanation = explain(stuck[0])
    text = "\n".join(screen(explanation, "r.pcapng"))
    assert f"the host tripped: {stuck[1].trip}" in text
    assert [node.number for node in explanation.nodes if node.well] == [1, 2]
    assert not [remark for remark in explanation.remarks if "not recorded" in remark]


def test_explain_leaves_a_marker_behind_the_span_out(stuck):
    end_s = stuck[1].trip_ns / 1e9
    for end, count in ((end_s - 1e-6, 0), (end_s + 1e-6, 1)):
        clues = [clue for incident in explain(stuck[0], span=(None, end)).incidents for clue in incident.clues]
        assert sum(clue.kind == "host_trip" for clue in clues) == count


def test_decode_prints_markers_that_no_frame_follows(stuck):
    path, result = stuck
    last = f"{result.trip_ns / 1e9:14.6f}         -  -      marker  # trip {result.trip}"
    assert CliRunner().invoke(main, ["decode", str(path)]).output.splitlines()[-1] == last
    row = json.loads(CliRunner().invoke(main, ["decode", str(path), "--json"]).output.splitlines()[-1])
    assert (row["t_s"], row["can_id"], row["marker"]) == (result.trip_ns / 1e9, None, f"trip {result.trip}")


@pytest.mark.parametrize("grid", [(), ("--grid", "1ms")])
def test_export_has_markers_that_no_frame_follows(stuck, tmp_path, grid):
    out = tmp_path / "r.csv"
    assert CliRunner().invoke(main, ["export", str(stuck[0]), "--to", "csv", "-o", str(out), *grid]).exit_code == 0
    assert [line for line in out.read_text().splitlines() if line.endswith(f" trip {stuck[1].trip}")]


@pytest.mark.thorough
def test_the_replay_of_that_trip_is_the_same(stuck):
    result = CliRunner().invoke(main, ["replay", "--host", str(stuck[0]), "--json"])
    replay = json.loads(result.stdout)
    assert replay["recorded_trip"] == replay["computed_trip"] == stuck[1].trip


def test_the_end_of_the_display_comes_before_the_trip(tmp_path):
    (tmp_path / "drop.toml").write_text(
        '[[fault]]\nkind = "drop"\nafter = "enabled"\nat_s = 2.4\n'
        'on = {frame = "TPDO1", node = 1, every = 1}\nlost_for = "host"\n'
    )
    result = simulate(RIG, "hybrid", 3.0, record=tmp_path / "r.pcapng", faults=tmp_path / "drop.toml")
    markers = [text for _, text in read(tmp_path / "r.pcapng").markers if not text.startswith("fault")]
    assert markers[-2:] == ["phase end", f"trip {result.trip}"]


def test_a_recording_that_is_removed_in_virtual_time_is_a_trip(tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    result = simulate(
        RIG,
        "hybrid",
        3.0,
        record=folder / "r.pcapng",
        progress=lambda t_s: shutil.rmtree(folder, ignore_errors=True) if t_s >= 0.5 else None,
    )
    assert (result.exit_status, result.recording_sha256) == (7, None)
    assert result.trip.startswith(f"RECORDING: {folder / 'r.pcapng'}")
    assert result.simulated_s < 2.0  # the display is cut short


def test_explain_says_that_the_end_of_the_hosts_run_is_missing(tmp_path):
    simulate(RIG, "hybrid", 0.5, record=tmp_path / "r.pcapng")
    whole = (tmp_path / "r.pcapng").read_bytes()
    assert not [remark for remark in explain(tmp_path / "r.pcapng").remarks if "not recorded" in remark]
    (tmp_path / "cut.pcapng").write_bytes(whole[: len(whole) // 2])
    explanation = explain(tmp_path / "cut.pcapng")
    assert [remark for remark in explanation.remarks if "the end of the host's run is not recorded" in remark]
    assert 127 not in [node.number for node in explanation.nodes if node.well]
