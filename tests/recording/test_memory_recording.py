"""Figures of frames in memory are those of the recording."""

from __future__ import annotations

from dataclasses import asdict, fields

import pytest

from coulombus.kernels.records import new_records
from coulombus.lab.simulate import simulate
from coulombus.recording.measures import Measures, phases
from coulombus.recording.memory_recording import MeasuredFrames
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("rig", "mode", "seconds"), [("bench", "active", 8.0), ("two_axes", "hybrid", 3.0)])
def test_the_figures_are_those_of_the_recording(tmp_path, rig, mode, seconds):
    recorded = simulate(rig, mode, seconds, seed=2, record=tmp_path / "run.pcapng")
    measured = simulate(rig, mode, seconds, seed=2, measured=True)
    both = simulate(rig, mode, seconds, seed=2, measured=True, record=tmp_path / "both.pcapng")
    own = {"recording", "recording_sha256"}
    for result in (measured, both):
        figures, expected = asdict(result), asdict(recorded)
        for name in figures.keys() - own:
            exact = not isinstance(expected[name], float)
            assert figures[name] == (expected[name] if exact else pytest.approx(expected[name], rel=1e-12)), name
    assert recorded.hold_counts_p2p is not None
    assert recorded.axes is None or recorded.axes["left"]["hold_counts_p2p"] is not None
    assert (tmp_path / "run.pcapng").read_bytes() == (tmp_path / "both.pcapng").read_bytes()


def test_without_it_nothing_is_measured():
    result = asdict(simulate("bench", "hybrid", 0.1))
    assert all(result[field.name] is None for field in fields(Measures))


def test_a_run_that_is_never_armed_has_no_figures():
    result = simulate("bench", "hybrid", 0.1, overrides=("operator.tremor_Nm=0.5",), measured=True)
    assert result.trip is not None
    assert result.cycles == 0
    assert result.hold_counts_p2p is None


def test_a_marker_has_the_time_of_its_frame_and_a_torn_pdo_is_left_out():
    rig = load_rig("bench")
    pdo = next(pdo for pdo in rig.pdos() if any(signal.key == "motor.position_rad" for signal in pdo.signals))
    frames = new_records(Frame, 6)
    frames["t_ns"] = [10, 20, 30, 40, 50, 60]
    frames["can_id"] = [0x80, pdo.layout.cob_id, 0x80, pdo.layout.cob_id, pdo.layout.cob_id, 0x80]
    frames["length"] = pdo.layout.length
    frames["length"][3] -= 1
    kept = MeasuredFrames(rig)
    kept.mark(25, "phase rest")
    kept.mark(60, "phase hold")
    kept.mark(61, "phase stroke")
    kept.write(frames[:3])
    kept.write(frames[3:])
    (recording,) = kept.recordings()
    assert recording["motor.position_rad"].t_s.tolist() == [20e-9, 50e-9]
    assert recording.markers == [(30e-9, "phase rest"), (60e-9, "phase hold")]
    assert [phase.kind for phase in phases(recording)] == ["rest", "hold"]
