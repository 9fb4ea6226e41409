"""What the host tells of itself: on a second interface of a recording, as signals by name."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest

from bench_recording import record
from coulombus.host.cycle.records import Phase
from coulombus.kernels.records import new_records
from coulombus.lab.simulate import simulate
from coulombus.monitor.tools.tool_files import tool_files
from coulombus.recording.comparison import compare
from coulombus.recording.export.export import export
from coulombus.recording.host_telemetry import (
    FIRST,
    HOST_INTERFACE,
    NAME,
    OF_WORLD,
    PER_AXIS,
    PHASE_RUN,
    SOURCE_INSIDE,
    inside_pdos,
    of_axis,
)
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.pictures.plot import traces_of
from coulombus.recording.reading import blocks, read
from coulombus.recording.recorder import About, Recorder
from coulombus.recording.signals import series
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame

pytestmark = pytest.mark.slow  # in plain Python each packet takes some microseconds

NAMES = [
    *("host.phase", "host.trip", "host.limits", "host.gain", "host.stuck", "host.position_age"),
    *("host.law_Nm", "host.law_brake_Nm", "host.velocity_rad_s", "host.x_stuck_rad"),
]


def test_a_damaged_attachment_tells_of_nothing():
    rig = load_rig("bench")
    assert inside_pdos(rig, None) == ()
    assert inside_pdos(rig, b"\xff{") == ()
    assert inside_pdos(rig, b"7") == ()
    assert len(inside_pdos(rig, json.dumps(["a"] * 99).encode())) == OF_WORLD


def test_an_axis_sees_its_own():
    pdos = inside_pdos(load_rig("two_axes"), b"[]")
    left, right = load_rig("two_axes").axis_names
    assert [signal.name for pdo in of_axis(pdos, right) for signal in pdo.signals] == NAMES
    assert {pdo.layout.cob_id for pdo in of_axis(pdos, right)} == {FIRST + PER_AXIS + k for k in range(3)}
    assert {pdo.layout.cob_id for pdo in of_axis(pdos, left)} == {FIRST + k for k in range(3)}


# in a file


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("inside") / "run.pcapng"
    simulate("bench", mode="hybrid", seconds=1.0, record=path)
    return path


def test_a_simulated_run_has_them_once_a_cycle_behind_their_frames(simulated):
    recording = read(simulated)
    assert [name for name in recording.signals if name.startswith("host.")] == NAMES
    cycles = np.count_nonzero(recording.frames["can_id"] == 0x80)
    assert {len(recording[name]) for name in NAMES} == {cycles}
    phases = recording["host.phase"].values
    assert phases[0] == Phase.STILL
    assert (np.diff(phases) >= 0).all()
    assert Phase.RUN in phases
    assert Phase.RUN == PHASE_RUN
    gain = recording["host.gain"]
    assert 0.1 < gain.values.max() <= 1.0
    run = recording["host.phase"].values == Phase.RUN
    expected = gain.values * recording["host.law_brake_Nm"].values
    assert recording["brake.setpoint_Nm"].values[run] == pytest.approx(expected[run], abs=0.002)


def test_the_frames_of_the_bus_are_those_without_it(simulated):
    capture = read_pcapng(simulated)
    assert not (capture.frames["can_id"] >= FIRST).any()
    assert (capture.inside["can_id"] >= FIRST).all()
    assert next(text for _, text in read(simulated).markers) == "run hybrid"
    assert (np.diff(capture.inside["t_ns"]) >= 0).all()


def test_blocks_have_the_same_signals(simulated):
    whole = read(simulated)
    for name in NAMES:
        (signal,) = series(blocks(simulated), name)
        assert np.array_equal(signal.values, whole[name].values)
        assert np.array_equal(signal.t_s, whole[name].t_s)


def test_exports_and_plots_know_them(simulated, tmp_path):
    export(simulated, tmp_path / "run.csv", "csv", signals=["host.phase", "motor.position_rad"])
    lines = [line for line in (tmp_path / "run.csv").read_text().splitlines() if not line.startswith("#")]
    assert lines[0] == "t_s,motor.position_rad,host.phase"
    times = [float(line.split(",")[0]) for line in lines[1:]]
    assert times == sorted(times)
    assert len(times) == 2 * len(read(simulated)["host.phase"])
    shown = traces_of(read(simulated), ["host.gain", "host.law_brake_Nm"])
    assert [trace.name for trace in shown.traces] == ["host.gain", "host.law_brake_Nm"]
    assert not [trace for trace in traces_of(read(simulated)).traces if trace.name.startswith("host.")]


def test_a_log_of_frames_has_none_of_them(simulated, tmp_path):
    made = export(simulated, tmp_path / "run.log", "candump").path
    assert len(made.read_text().splitlines()) == len(read(simulated).frames)


def test_runs_that_differ_inside_alone_differ(simulated, tmp_path):
    capture = read_pcapng(simulated)
    merged = np.concatenate((capture.frames, capture.inside)).view(np.recarray)
    merged["source"][len(capture.frames) :] = SOURCE_INSIDE
    merged = merged[np.argsort(merged["t_ns"], kind="stable")]
    changed = np.flatnonzero(merged["can_id"] == FIRST + 1)[500]
    merged["word"][changed] ^= 1 << 62
    with PcapngWriter(tmp_path / "b.pcapng", attachments=capture.attachments, second=HOST_INTERFACE) as writer:
        writer.write(merged)
    comparison = compare(simulated, tmp_path / "b.pcapng")
    assert [signal.name for signal in comparison.signals if not signal.equal] == ["host.law_brake_Nm"]
    assert compare(simulated, tmp_path / "b.pcapng", tolerances={"rad": 0.0}).equal is False  # no phases are in it


def test_a_recording_without_them_is_compared_by_the_others(simulated, tmp_path):
    capture = read_pcapng(simulated)
    with PcapngWriter(tmp_path / "b.pcapng", attachments=capture.attachments) as writer:
        comments: dict[int, str] = {}
        for row, text in capture.comments:
            comments[row] = f"{comments[row]}\n{text}" if row in comments else text
        writer.write(capture.frames, comments)
    bare = tmp_path / "bare.pcapng"
    others = {name: content for name, content in capture.attachments.items() if name != NAME}
    with PcapngWriter(bare, attachments=others) as writer:
        writer.write(capture.frames, comments)
    assert compare(simulated, bare, tolerances={"": 0.0}).equal
    comparison = compare(simulated, bare)
    assert not comparison.equal
    assert any("what the host told of itself" in text for text in comparison.remarks)


def test_markers_stand_at_frames_of_the_bus(tmp_path):
    rig = load_rig("bench")
    frames = new_records(Frame, 4)
    frames["t_ns"], frames["can_id"] = [1, 2, 3, 4], [0x80, FIRST, FIRST + 1, 0x181]
    frames["source"] = [0, SOURCE_INSIDE, SOURCE_INSIDE, 0]
    with Recorder(tmp_path / "a.pcapng", rig, "hybrid", about=About(law_state=())) as recorder:
        recorder.mark(2, "here")
        recorder.write(frames[1:3])
        recorder.write(frames)
    capture = read_pcapng(tmp_path / "a.pcapng")
    assert capture.comments == [(1, "here")]
    assert capture.frames["can_id"].tolist() == [0x80, 0x181]
    assert capture.inside["can_id"].tolist() == [FIRST, FIRST + 1, FIRST, FIRST + 1]


def test_a_comment_on_a_frame_that_was_on_no_bus_goes_to_the_one_behind(tmp_path):
    frames = new_records(Frame, 3)
    frames["t_ns"], frames["can_id"], frames["source"] = [1, 2, 3], [0x80, FIRST, 0x181], [0, SOURCE_INSIDE, 0]
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}, second=HOST_INTERFACE) as writer:
        writer.write(frames, {1: "by hand"})
    assert read_pcapng(tmp_path / "a.pcapng").comments == [(1, "by hand")]


def test_the_bus_own_recording_has_no_second_interface(tmp_path):
    path = record(tmp_path / "a.pcapng")
    assert HOST_INTERFACE.encode() not in path.read_bytes()
    assert not [name for name in read(path).signals if name.startswith("host.")]


@pytest.mark.thorough
@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_the_dissector_has_the_numbers_of_read(simulated, tmp_path):
    rig = load_rig("bench")
    (tmp_path / "bench.lua").write_text(tool_files(KnownBus(rig))["bench.lua"])
    keys = ["host.phase", "host.gain", "host.law_brake", "host.x_stuck"]
    shown = ["-T", "fields", "-E", "separator=,", *(word for key in keys for word in ("-e", f"coulombus.{key}"))]
    command = ["tshark", "-X", f"lua_script:{tmp_path / 'bench.lua'}", "-r", os.fspath(simulated)]
    done = subprocess.run([*command, *shown], capture_output=True, text=True, check=True)
    columns = zip(*(line.split(",") for line in done.stdout.splitlines()), strict=True)
    recording = read(simulated)
    names = ["host.phase", "host.gain", "host.law_brake_Nm", "host.x_stuck_rad"]
    for name, column in zip(names, columns, strict=True):
        values = [float(text) for text in column if text]
        np.testing.assert_allclose(values, recording[name].values, rtol=1e-12, atol=1e-12)
    least = [*command, "-Y", "coulombus.host.phase == 5", "-T", "fields", "-e", "frame.number"]
    run = subprocess.run(least, capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(run) == np.count_nonzero(recording["host.phase"].values == Phase.RUN)


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_wireshark_names_the_second_interface(simulated):
    command = ["tshark", "-r", os.fspath(simulated), "-T", "fields", "-e", "frame.interface_name", "-e", "can.id"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert lines.count(f"{HOST_INTERFACE}\t{0x1FC00000}") == len(read(simulated)["host.phase"])
