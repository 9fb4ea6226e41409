"""The host on a recording's inputs: the same outputs again, or the first one that differs."""

from __future__ import annotations

import hashlib
import json
import pickle
import struct
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.replay.host_replay import ReplayError, host_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read
from coulombus.recording.trace import EVENT, TRACE, Event, Moment, pack, pack_sent, unpack, unpack_sent
from coulombus.rigs.rig import RigError, load_rig
from coulombus.wire.frame import FRAME

SECONDS = 0.9
PUSHED = (
    'phase=[{kind = "rest", duration_s = 0.5}, {kind = "hold", duration_s = 20.0, push_F_s = 0.6, frequency_Hz = 2.0, '
    "taps_s = [], tap_Nm = 0.6, tap_s = 0.01}]"
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "active.pcapng"
    result = simulate("bench", "active", SECONDS, record=path, seed=3, overrides=(PUSHED,))
    assert result.trip is None
    return path


def rewritten(recorded, path, change=lambda frames: None, keep=lambda name: True):
    """Write a recording anew: with other frames, or without some attachments."""
    capture = read_pcapng(recorded)
    frames = capture.frames.copy()
    change(frames)
    attachments = {name: content for name, content in capture.attachments.items() if keep(name)}
    with PcapngWriter(path, attachments=attachments) as writer:
        writer.write(frames, dict(capture.comments))
    return path


def test_the_same_inputs_give_the_same_outputs(recorded):
    found = host_replay(recorded)
    assert (found.difference, found.exit_status, found.unchecked, found.refused) == (None, 0, 0, 0)
    identifiers = read_pcapng(recorded).frames["can_id"]
    # counted in the file itself: each frame that the host sent in its cycle came out
    for can_id, name in ((0x80, "SYNC"), (0x77F, "heartbeat"), (0x201, "motor.RPDO1"), (0x202, "brake.RPDO1")):
        assert found.frames[name] == np.count_nonzero(identifiers == can_id) > 0
    assert found.cycles == found.frames["SYNC"]
    assert (found.recorded_trip, found.computed_trip) == (None, None)


@pytest.mark.thorough
def test_it_does_not_matter_how_many_are_taken_at_a_time(recorded, monkeypatch):
    whole = host_replay(recorded)
    monkeypatch.setattr("coulombus.host.cycle.replay.AHEAD", 3)
    assert host_replay(recorded) == whole


@pytest.mark.thorough
def test_frames_that_were_disturbed_in_their_last_bit_were_sent_once(tmp_path):
    """Receivers have such a frame twice, and so has the recording.

    The host has sent it once (ISO 11898-1).
    """
    file, path = tmp_path / "faults.toml", tmp_path / "r.pcapng"
    strikes = [
        ("50th SYNC", "all"),
        ("60th RPDO1 of node 1", "all"),
        ("70th RPDO1 of node 2", "host"),
        ("80th TPDO1 of node 1", "all"),
    ]
    file.write_text(
        "\n".join(
            f'[[fault]]\nkind = "flip"\non = "{on}"\nbit = "eof7"\n'
            + ("" if whom == "all" else f'seen_by = "{whom}"\n')
            for on, whom in strikes
        )
        # the motor alone refuses it, and its error flag hits the last bit of it for all others
        + '[[fault]]\nkind = "flip"\non = "90th RPDO1 of node 2"\nbit = "eof6"\nseen_by = "motor"\n'
        # overload: nothing is sent again
        + '[[fault]]\nkind = "flip"\non = "100th SYNC"\nbit = "intermission1"\n',
        encoding="utf-8",
    )
    result = simulate("bench", "active", SECONDS, record=path, seed=3, overrides=(PUSHED,), faults=file)
    assert [one["times"] for one in result.faults] == [1] * 6
    found = host_replay(path)
    assert (found.difference, found.exit_status) == (None, 0)
    frames = read_pcapng(path).frames
    for can_id, name, twice in ((0x80, "SYNC", 1), (0x201, "motor.RPDO1", 1), (0x202, "brake.RPDO1", 2)):
        assert np.count_nonzero(frames["can_id"] == can_id) == found.frames[name] + twice


FAULTS = {
    "the host in bus-off": 'kind = "corrupt_crc"\non = { frame = "RPDO1", node = 1, every = 1 }\nduration_s = 0.2',
    "a node in bus-off": 'kind = "flip"\non = { frame = "TPDO1", node = 1, every = 1 }\nbit = 60\nduration_s = 0.2',
    "the cable cut beside the host": 'kind = "cut"\nhalves = [["motor", "brake"], ["host"]]\nduration_s = 0.1',
    "the cable cut behind the host": 'kind = "cut"\nhalves = [["host", "brake"], ["motor"]]\nduration_s = 0.1',
    "a host that is slow": 'kind = "drift"\nnode = "host"\nppm = -900\nduration_s = 0.2',
    "a host that is fast": 'kind = "drift"\nnode = "host"\nppm = 900',
    "frames that the host does not get": 'kind = "drop"\non = "every 10th TPDO1 of node 1"\nlost_for = "host"',
    "frames of the host that nobody gets": 'kind = "drop"\non = "every 10th RPDO1 of node 2"\nmost = 3',
    "frames of the host that come late": 'kind = "delay"\non = "every 10th RPDO1 of node 2"\ndelay_us = 1500',
    "a SYNC that comes twice": 'kind = "duplicate"\non = "500th SYNC"',
    "somebody else who sends as the host": 'kind = "babble"\nnode = "motor"\ncan_id = 0x202\ndata = "0100"\nperiod_us = 9000',
    "noise": 'kind = "noise"\nrate = 2e-4',
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", FAULTS)
def test_what_a_fault_did_to_the_host_is_in_the_recording(tmp_path, name):
    """Which frames the host had, what it asked for, and how its clock ran."""
    file, path = tmp_path / "faults.toml", tmp_path / "r.pcapng"
    when = "" if "[n" in FAULTS[name] else 'after = "enabled"\nat_s = 0.3\n'
    file.write_text(f"[[fault]]\n{FAULTS[name]}\n{when}", encoding="utf-8")
    result = simulate("bench", "active", SECONDS, record=path, seed=3, overrides=(PUSHED,), faults=file)
    assert result.faults[0]["times"] > 0
    if "host in bus-off" in name:
        assert result.controllers["host"]["bus_offs"] > 0
    found = host_replay(path)
    assert (found.difference, found.exit_status, found.unchecked) == (None, 0, 0)
    assert found.computed_trip == found.recorded_trip == result.trip
    assert found.frames["SYNC"] == found.cycles > 500
    # and what was kept is what was computed: a difference is still found
    capture = read_pcapng(path)
    sent = unpack_sent(capture.attachments)
    sent["word"][np.flatnonzero(sent["can_id"] == 0x201)[200]] ^= 1 << 16
    others = {one: content for one, content in capture.attachments.items() if not one.startswith("host.sent.")}
    with PcapngWriter(path, attachments=others | {"host.sent.0": pack_sent(sent)}, force=True) as writer:
        writer.write(capture.frames, dict(capture.comments))
    assert (host_replay(path).difference.name, host_replay(path).difference.cycle) == ("motor.RPDO1", 201)


@pytest.mark.thorough
def test_the_trip_of_another_bus_is_an_input(tmp_path):
    """Where one bus of a rig trips, the hosts of the others are stopped at that instant: which no
    frame tells.
    """

    def stumble(world):
        if world.rig.axes[0].name == "right":
            world.at(1_500_000_000, lambda world: world.power_off(0))

    buses = ("axis.left.bus.channel=a", "axis.right.bus.channel=b")
    simulate("two_axes", "passive", 1.5, record=tmp_path / "r.pcapng", overrides=buses, script=stumble)
    found = {channel: host_replay(tmp_path / f"r.{channel}.pcapng") for channel in "ab"}
    assert [one.difference for one in found.values()] == [None, None]
    assert "OTHER_AXIS" in found["a"].computed_trip
    assert found["a"].recorded_trip == found["a"].computed_trip


def test_one_bit_of_an_output_is_found_and_told(recorded, tmp_path):
    def flip(frames):
        rows = np.flatnonzero(frames["can_id"] == 0x201)
        frames["word"][rows[200]] ^= 1 << 16  # target torque, lowest bit

    found = host_replay(rewritten(recorded, tmp_path / "a.pcapng", flip))
    one = found.difference
    assert found.exit_status == 1
    assert (one.cycle, one.name) == (201, "motor.RPDO1")
    assert one.recorded != one.computed
    (recorded_Nm, computed_Nm) = one.signals["motor.target_torque_Nm"]
    assert abs(recorded_Nm - computed_Nm) == pytest.approx(abs(load_rig("bench").pdos()[0].signals[1].scale))
    assert one.signals["motor.controlword"][0] == one.signals["motor.controlword"][1]


def test_one_bit_of_an_input_shows_in_an_output(recorded, tmp_path):
    def jump(frames):
        rows = np.flatnonzero(frames["can_id"] == 0x181)
        frames["word"][rows[len(rows) // 2]] ^= 1 << 30  # position

    found = host_replay(rewritten(recorded, tmp_path / "a.pcapng", jump))
    assert found.difference is not None
    assert found.computed_trip.startswith("ENCODER_JUMP")


def test_a_missing_output_is_a_difference(recorded, tmp_path):
    capture = read_pcapng(recorded)
    rows = np.flatnonzero(capture.frames["can_id"] == 0x202)
    path = tmp_path / "a.pcapng"
    with PcapngWriter(path, attachments=capture.attachments) as writer:
        writer.write(np.delete(capture.frames, rows[-1]), {})
    assert host_replay(path).difference.name == "brake.RPDO1"


@pytest.mark.thorough
def test_another_law_is_measured_not_judged(recorded):
    found = host_replay(recorded, ["law.function=coulomb"])
    assert found.exit_status == 0
    assert found.rms["motor.target_torque_Nm"] > 0
    assert found.rms["brake.setpoint_Nm"] < 0.6  # mode active leaves the brake alone until it takes over at the end
    same = host_replay(recorded, ["law.function=karnopp"])
    assert same.rms["motor.target_torque_Nm"] == 0
    assert same.difference is None


def test_other_pdos_are_refused(recorded):
    with pytest.raises(ReplayError, match="overrides change the PDOs"):
        host_replay(recorded, ["motor.node_id=9"])


def test_what_a_recording_lacks_is_told(recorded, tmp_path):
    foreign = rewritten(recorded, tmp_path / "a.pcapng", keep=lambda name: not name.startswith("host."))
    with pytest.raises(ReplayError, match="no trace of the host"):
        host_replay(foreign)
    foreign = rewritten(recorded, tmp_path / "b.pcapng", keep=lambda name: name != "mode")
    with pytest.raises(ReplayError, match="does not tell the host's mode"):
        host_replay(foreign)


def test_a_recording_that_ends_in_the_midst_is_checked_to_its_end(recorded, tmp_path):
    whole = recorded.read_bytes()
    path = tmp_path / "a.pcapng"
    path.write_bytes(whole[: len(whole) * 2 // 3 + 5])
    found = host_replay(path)
    assert found.difference is None
    assert 0 < found.cycles < host_replay(recorded).cycles
    assert any("unfinished" in text for text in found.remarks)
    assert found.exit_status == 0


@pytest.mark.thorough
def test_the_command(recorded, tmp_path):
    run = CliRunner().invoke
    done = run(main, ["replay", str(recorded), "--host", "--json"])
    assert (done.exit_code, json.loads(done.stdout)["identical"]) == (0, True)
    done = run(main, ["replay", str(recorded), "--host", "--law", "coulomb"])
    assert (done.exit_code, "RMS difference of motor.target_torque_Nm" in done.stdout) == (0, True)
    done = run(main, ["replay", str(recorded), "--host", "--bus", "coulombus:x"])
    assert done.exit_code == 2
    other = rewritten(
        recorded, tmp_path / "a.pcapng", lambda frames: frames["word"].__iadd__(frames["can_id"] == 0x202)
    )
    done = run(main, ["replay", str(other), "--host"])
    assert done.exit_code == 1
    assert "FAIL at" in done.stdout
    assert "brake.setpoint_Nm" in done.stdout


def test_trace_and_own_frames_as_attachments():
    rows = np.zeros(5, TRACE)
    rows["kind"] = [Moment.START, Moment.BEGIN, Moment.ARRIVED, Moment.WINDOW, Moment.END]
    rows["t_ns"] = -(2**40) + np.arange(5)
    own = np.arange(19) % 3 == 0
    attached = {"host.trace.0": pack(own[:8], rows[:3]), "host.trace.1": pack(own[8:], rows[3:]), "mode": b"hybrid"}
    found_own, found = unpack(attached)
    assert found_own.tolist() == own.tolist()
    assert found.tolist() == rows.tolist()
    assert unpack({"mode": b"hybrid"}) is None
    # from a damaged one on nothing counts
    damaged = attached | {"host.trace.1": attached["host.trace.1"][:-1]}
    assert len(unpack(damaged)[1]) == 3
    assert unpack({"host.trace.0": struct.pack("<I", 1)}) is None


def test_events_and_what_was_sent_as_attachments():
    rows = np.array([(5, 0, 0, Event.START, 0), (9, 7, 1000, Event.CLOCK, -900)], EVENT)
    own, found = unpack({"host.trace.0": pack(np.zeros(3, bool), rows)}, EVENT)
    assert (own.tolist(), found.tolist()) == ([False] * 3, rows.tolist())
    sent = np.zeros(3, FRAME)
    sent["t_ns"], sent["can_id"], sent["length"], sent["word"] = [1, 2, 3], [0x80, 0x201, 0x77F], [0, 4, 1], [0, -5, 5]
    attached = {"host.sent.0": pack_sent(sent[:2]), "host.sent.1": pack_sent(sent[2:])}
    assert unpack_sent(attached).tolist() == sent.tolist()
    assert unpack_sent({"mode": b"hybrid"}) is None


STRANGE = """from pathlib import Path

Path({witness!r}).touch()


def law(motion, law, state):
    return 0.0
"""


@pytest.fixture
def strangers(recorded, tmp_path, monkeypatch):
    """Return a recording whose rig names a law, by its name.

    What the law's file leaves behind when it is run.
    """
    witness = tmp_path / "it-ran"
    (tmp_path / "evil.py").write_text(STRANGE.format(witness=str(witness)))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def make(name):
        capture = read_pcapng(recorded)
        rig = capture.attachments["rig.toml"].decode().replace("karnopp", name)
        assert name in rig
        with PcapngWriter(
            tmp_path / "theirs.pcapng", attachments=capture.attachments | {"rig.toml": rig.encode()}
        ) as writer:
            writer.write(capture.frames, dict(capture.comments))
        return tmp_path / "theirs.pcapng", witness

    return make


@pytest.mark.parametrize("name", ["evil.py:law", "HERE/evil.py:law", "evil:law", "os:system", "load_law"])
def test_a_law_that_only_a_recording_names_is_not_run(strangers, tmp_path, name):
    path, witness = strangers(name.replace("HERE", str(tmp_path)))
    done = CliRunner().invoke(main, ["replay", str(path), "--host"])
    assert done.exit_code == 3, done.output
    assert "name it yourself: --law" in done.output
    with pytest.raises(RigError, match="--law"):  # nor in a run of its rig
        simulate(read(path).rig, "active", 0.01)
    with pytest.raises(RigError, match="--law"):
        simulate(pickle.loads(pickle.dumps(read(path).rig.variant("limits.still_s=0.2"))), "active", 0.01)
    assert CliRunner().invoke(main, ["decode", str(path)]).exit_code == 0
    assert CliRunner().invoke(main, ["identify", str(path)]).exit_code == 1  # no strokes in it
    assert not witness.exists()
    assert "evil" not in sys.modules


@pytest.mark.thorough
def test_the_law_that_the_user_names_runs_and_not_the_one_beside_the_recording(strangers, tmp_path, monkeypatch):
    path, witness = strangers("evil.py:law")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "evil.py").write_text(STRANGE.format(witness=str(tmp_path / "mine-ran")))
    monkeypatch.chdir(tmp_path / "mine")
    for given in (("--law", "evil.py:law"), ("--set", "law.function=evil.py:law")):
        done = CliRunner().invoke(main, ["replay", str(path), "--host", *given])
        assert done.exit_code == 0, done.output
        assert (tmp_path / "mine-ran").exists()
        (tmp_path / "mine-ran").unlink()
    assert not witness.exists()


def test_a_schedule_that_a_recording_names_is_not_read(recorded, tmp_path):
    capture = read_pcapng(recorded)
    (tmp_path / "secret").write_text("a secret line\n")
    rig = capture.attachments["rig.toml"].decode() + f'\n[[phase]]\nkind = "file"\npath = "{tmp_path}/secret"\n'
    with PcapngWriter(tmp_path / "a.pcapng", attachments=capture.attachments | {"rig.toml": rig.encode()}) as writer:
        writer.write(capture.frames, {})
    with pytest.raises(RigError, match="the schedule's values are not attached") as refused:
        read(tmp_path / "a.pcapng")
    assert "a secret line" not in str(refused.value)


OWN = "def law(motion, law, state):\n    state.brake_Nm = law.F_d\n    return {} * motion.v_rad_s\n"


@pytest.mark.thorough
def test_a_law_of_the_user_is_attached_and_a_changed_one_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own, path = tmp_path / "own.py", tmp_path / "own.pcapng"
    own.write_text(OWN.format("0.2"))
    simulate("bench", "active", 0.05, record=path, overrides=("law.function=own.py:law",))
    attachments = read_pcapng(path).attachments
    assert attachments["host.law.py"] == own.read_bytes()
    assert attachments["host.law.sha256"].decode() == hashlib.sha256(own.read_bytes()).hexdigest()
    assert host_replay_by_law(path, "own.py:law") == (0, "", True)
    own.write_text(OWN.format("0.3"))
    status, told, judged = host_replay_by_law(path, "own.py:law")
    assert (status, judged) == (0, False)
    assert hashlib.sha256(own.read_bytes()).hexdigest() in told
    assert attachments["host.law.sha256"].decode() in told


def host_replay_by_law(path, law):
    done = CliRunner().invoke(main, ["replay", str(path), "--host", "--json", "--law", law])
    return done.exit_code, done.stderr, json.loads(done.stdout)["judged"]


@pytest.mark.thorough
def test_another_version_of_our_own_law_is_told(recorded, tmp_path):
    assert not host_replay(recorded).remarks
    capture = read_pcapng(recorded)
    other = capture.attachments | {"host.law.sha256": b"0" * 64}
    with PcapngWriter(tmp_path / "a.pcapng", attachments=other) as writer:
        writer.write(capture.frames, dict(capture.comments))
    (told,) = host_replay(tmp_path / "a.pcapng").remarks
    assert "karnopp" in told
    assert "0" * 64 in told
