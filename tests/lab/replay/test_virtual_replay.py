"""Nodes and bus in virtual time on a recording's host: the same frames again, to the nanosecond."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.replay.host_replay import ReplayError, host_replay
from coulombus.lab.replay.virtual_replay import virtual_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import parse_address
from coulombus.wire.client import Client, pack_frame

PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "hybrid.pcapng"
    simulate("bench", "hybrid", 0.1, record=path, seed=5)
    return path


def test_every_frame_comes_out_again(recorded):
    found = virtual_replay(recorded)
    frames = read_pcapng(recorded).frames
    assert (found.identical, found.same, found.frames) == (True, len(frames), len(frames))
    of_nodes = np.isin(frames["can_id"], [0x181, 0x182, 0x581, 0x582, 0x701, 0x702])
    assert found.asked == len(frames) - np.count_nonzero(of_nodes)
    assert np.count_nonzero(of_nodes) > 700


@pytest.mark.parametrize("field", ["word", "t_ns"])
def test_a_frame_that_no_node_sent_so_is_found(recorded, tmp_path, field):
    capture = read_pcapng(recorded)
    row = int(np.flatnonzero(capture.frames["can_id"] == 0x182)[100])
    capture.frames[field][row] += 1
    path = tmp_path / "a.pcapng"
    with PcapngWriter(path, attachments=capture.attachments) as writer:
        writer.write(capture.frames, dict(capture.comments))
    found = virtual_replay(path)
    assert (found.exit_status, found.same) == (1, row)
    assert "182h" in found.recorded
    assert "182h" in found.computed
    done = CliRunner().invoke(main, ["replay", str(path), "--virtual"])
    assert done.exit_code == 1
    assert "FAIL at" in done.stdout


def test_another_seed_gives_another_noise(recorded, tmp_path):
    capture = read_pcapng(recorded)
    path = tmp_path / "a.pcapng"
    with PcapngWriter(path, attachments=capture.attachments | {"seed": b"6"}) as writer:
        writer.write(capture.frames, dict(capture.comments))
    assert 0 < virtual_replay(path).same < len(capture.frames)


def test_a_recording_of_a_clock_is_refused(recorded, tmp_path):
    capture = read_pcapng(recorded)
    path = tmp_path / "a.pcapng"
    attachments = {name: text for name, text in capture.attachments.items() if name != "seed"}
    with PcapngWriter(path, attachments=attachments) as writer:
        writer.write(capture.frames)
    with pytest.raises(ReplayError, match="not the bus's own time"):
        virtual_replay(path)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"seed": b"xyz"}, "'seed' and 'mode' are 'xyz' and 'hybrid', expected a number"),
        ({"mode": b"\xff"}, "a mode of its rig"),
        ({"mode": b""}, "a mode of its rig"),
    ],
)
def test_attachments_that_tell_nothing_are_refused(recorded, tmp_path, changed, text):
    capture = read_pcapng(recorded)
    path = tmp_path / "a.pcapng"
    with PcapngWriter(path, attachments=capture.attachments | changed) as writer:
        writer.write(capture.frames)
    with pytest.raises(ReplayError, match=text):
        virtual_replay(path)
    assert CliRunner().invoke(main, ["replay", str(path), "--virtual"]).exit_code == 2


def test_stamps_that_no_run_has_end_it_at_once(recorded, tmp_path):
    """Half a century of virtual time is not computed to find that a frame of another day does not
    come out.
    """
    capture = read_pcapng(recorded)
    path = tmp_path / "a.pcapng"
    for shift, first in ((1_700_000_000 * 10**9, 0), (10**17, len(capture.frames) // 2)):
        frames = capture.frames.copy()
        frames["t_ns"][first:] += shift
        with PcapngWriter(path, attachments=capture.attachments, force=True) as writer:
            writer.write(frames, dict(capture.comments))
        if first:
            assert virtual_replay(path).same == first
        else:
            with pytest.raises(ReplayError, match="its stamps are a clock's"):
                virtual_replay(path)
    with PcapngWriter(path, attachments=capture.attachments, force=True) as writer:
        writer.write(frames[:0])
    for check in (virtual_replay, host_replay):
        with pytest.raises(ReplayError, match="has no frame"):
            check(path)


def test_a_recording_with_faults_is_refused(tmp_path):
    file, path = tmp_path / "faults.toml", tmp_path / "a.pcapng"
    file.write_text('[[fault]]\nkind = "flip"\non = "20th SYNC"\nbit = 5\n', encoding="utf-8")
    simulate("bench", "hybrid", 0.1, record=path, seed=5, faults=file)
    with pytest.raises(ReplayError, match=r"fault flip 80h \(line 1\).*not in a recording"):
        virtual_replay(path)
    assert CliRunner().invoke(main, ["replay", str(path), "--virtual"]).exit_code == 2


def test_a_session_in_real_time_comes_out_again_in_virtual_time(tmp_path, monkeypatch):
    """Whatever the machine did meanwhile: what was asked when is in the recording, and all else
    follows from it.
    """
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "session.pcapng"
    server = SimServer(load_rig("bench"), parse_address("coulombus:s"), seed=4, record=path)
    ready = threading.Event()
    thread = threading.Thread(target=server.run, kwargs={"ready": ready.set})
    thread.start()
    try:
        assert ready.wait(30)
        with Client(parse_address("coulombus:s")) as client:
            client.send(pack_frame(0x000, b"\1\0"))
            client.send(pack_frame(0x601, bytes.fromhex("4000100000000000")) + pack_frame(0x123, b"nobody's"))
            syncs = 0
            while syncs < 50:  # each answer brings the next
                client.send(pack_frame(0x080))
                found = []
                while 0x182 not in [one[1] for one in found]:
                    assert client.wait(30)
                    found += client.receive()
                syncs += 1
    finally:
        server.stop()
        thread.join(30)
        server.close()
    found = virtual_replay(path)
    assert found.identical, found.lines()
    assert found.asked == 53
    assert found.frames > 53 + 3 * 50
    with pytest.raises(ReplayError, match="no trace of the host"):
        host_replay(path)


def test_frames_are_recorded_by_their_age_too(tmp_path, monkeypatch):
    """A bus on which nothing more happens than two boot-ups: they do not wait for further
    frames.
    """
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path = tmp_path / "idle.pcapng"
    server = SimServer(load_rig("bench"), parse_address("coulombus:idle"), record=path)
    hand_over, whole = server.world.hand_over, []

    def handed_over(count: int) -> None:
        hand_over(count)
        whole.append(len(read_pcapng(path).frames))
        if whole[-1]:
            server.stop()

    monkeypatch.setattr(server.world, "hand_over", handed_over)
    try:
        result = server.run(PATIENCE_S)
    finally:
        server.close()
    assert whole[0] == 2
    assert result.seconds < PATIENCE_S  # it was not the end that wrote them


def test_a_law_that_the_recording_names_is_not_run(recorded, tmp_path):
    """The frames of the host are the recorded ones: nodes and bus need no law."""
    (tmp_path / "evil.py").write_text(
        f"open({str(tmp_path / 'it-ran')!r}, 'w')\ndef law(motion, law, state):\n    return 0.0\n"
    )
    capture = read_pcapng(recorded)
    rig = capture.attachments["rig.toml"].decode().replace("karnopp", "evil.py:law")
    with PcapngWriter(tmp_path / "a.pcapng", attachments=capture.attachments | {"rig.toml": rig.encode()}) as writer:
        writer.write(capture.frames, dict(capture.comments))
    assert virtual_replay(tmp_path / "a.pcapng").identical
    assert not (tmp_path / "it-ran").exists()
