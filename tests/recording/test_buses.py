"""A bus is part of a frame's key: files of two buses, read with rigs of one and of two."""

from __future__ import annotations

import json

import can
import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.explain.explained import explain
from coulombus.kernels.records import new_records
from coulombus.lab.replay.player import load_tape
from coulombus.lab.simulate import simulate
from coulombus.monitor.decode import bare_rows
from coulombus.recording.bus_match import ChannelError
from coulombus.recording.export.export import export
from coulombus.recording.log_files import read_log
from coulombus.recording.logs.mf4 import ready
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.pcapng_reader import iter_pcapng, read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter, SectionTexts
from coulombus.recording.reading import blocks, read
from coulombus.rigs.rig import load_rig, load_rig_text
from coulombus.wire.can_flags import CAN_ERR_FLAG
from coulombus.wire.frame import Frame

TPDO1, SYNC = 0x181, 0x80
CYCLES = 20
WORDS = {"can0": 0x0250, "can1": 0x0637}
"""What the statusword is on each bus."""
PHASES = 'phase=[{kind = "rest", duration_s = 0.1}]'
NAMES = {".log": ("can0", "can1"), ".pcapng": ("can0", "can1")}  # of others numbers
KINDS = ("two.log", "two.pcapng", "two.asc", "two.blf", "two.trc", "two.mf4")


@pytest.fixture(scope="module")
def two_buses():
    """Return a rig with the axes left on the bus a and right on the bus b."""
    rig = load_rig("two_axes")
    text = rig.text.replace("[axis.left]", '[axis.left]\nbus.channel = "a"', 1)
    text = text.replace("[axis.right]", '[axis.right]\nbus.channel = "b"', 1)
    for node, own in ((3, 1), (4, 2)):
        text = text.replace(f"node_id = {node}\n", f"node_id = {own}\n")
    rig = load_rig_text(text, "two.toml", dict(rig.eds_texts))
    assert rig.channels == ("a", "b")
    return rig


def messages():
    """SYNC on the first bus alone; the same identifier on both with another content."""
    for k in range(CYCLES):
        at_s = 1_700_000_000 + k / 1000
        yield can.Message(at_s, SYNC, is_extended_id=False, channel=0)
        for number, word in enumerate(WORDS.values()):
            data = word.to_bytes(2, "little") + bytes(6)
            yield can.Message(at_s + 1e-4 * (1 + number), TPDO1, is_extended_id=False, channel=number, data=data)


@pytest.fixture(params=KINDS)
def two(request, tmp_path):
    if request.param.endswith("mf4"):
        pytest.importorskip("asammdf")
        ready()
    path = tmp_path / request.param
    with can.Logger(path) as log:
        for message in messages():
            log.on_message_received(message)
    return path


def buses_of(path):
    read_by = read_pcapng if path.suffix == ".pcapng" else read_log
    return tuple(name for name in read_by(path).buses if name)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_rig_of_one_bus_asks_which(two):
    first, second = buses_of(two)
    for read_it in (lambda: read(two, "bench"), lambda: list(blocks(two, "bench")), lambda: load_tape(two)):
        with pytest.raises(ChannelError, match=f"the file has the buses {first}, {second}, and .*--channel {first}"):
            read_it()
    with pytest.raises(ChannelError, match=f"--channel can7: the file has the buses {first}, {second}"):
        read(two, "bench", channel="can7")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("number", [0, 1])
def test_the_named_bus_alone_is_read(two, number):
    names = buses_of(two)
    recording = read(two, "bench", channel=names[number])
    assert recording["motor.statusword"].values.tolist() == [list(WORDS.values())[number]] * CYCLES
    assert len(recording.frames) == (2 if number == 0 else 1) * CYCLES
    assert f"{(1 if number == 0 else 2) * CYCLES} frames of the bus {names[1 - number]} were left out" in " ".join(
        recording.remarks
    )
    source = blocks(two, "bench", names[number])
    parts = [block["motor.statusword"].values for block in source]
    assert np.concatenate(parts).tolist() == recording["motor.statusword"].values.tolist()
    assert source.remarks == recording.remarks
    tape = load_tape(two, names[number])
    assert (tape.frames["can_id"] == recording.frames["can_id"]).all()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_frames_of_other_buses_are_counted_over_all_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr("coulombus.recording.pcapng_reader.CHUNK", 500)
    path, remarks = tmp_path / "two.pcapng", []
    with can.Logger(path) as log:
        for message in messages():
            log.on_message_received(message)
    first, second = buses_of(path)
    assert sum(1 for _ in iter_pcapng(path)) > 2
    list(bare_rows(path, first, KnownBus(), remarks))
    assert remarks == [f"{path}: {CYCLES} frames of the bus {second} were left out"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_rig_of_two_buses_gets_each_axis_its_own(two, two_buses):
    first, second = buses_of(two)
    left, right = WORDS.values()
    for channel, expected in ((None, (left, right)), ((f"a={second}", f"b={first}"), (right, left))):
        recording = read(two, two_buses, channel)
        words = [set(recording[f"{axis}.motor.statusword"].values.tolist()) for axis in ("left", "right")]
        assert words == [{expected[0]}, {expected[1]}]
        seen = [axis["motor.statusword"].values.tolist() for axis in recording.axes]
        assert seen == [[word] * CYCLES for word in expected]
    in_order = f"{first} is a, {second} is b of the rig"
    assert any(in_order in text for text in read(two, two_buses).remarks)
    alone = read(two, two_buses, f"b={first}")
    assert len(alone["left.motor.statusword"]) == 0
    assert alone["right.motor.statusword"].values.tolist() == [left] * CYCLES


def test_foreign_buses_are_matched_in_the_order_of_their_names(tmp_path, two_buses):
    """Which of them has the first frame is chance."""
    path = tmp_path / "two.log"
    path.write_text("(1.0) can10 181#5002000000000000\n(1.1) can2 181#3706000000000000\n")
    recording = read(path, two_buses)
    assert any("can2 is a, can10 is b of the rig" in text for text in recording.remarks)
    assert recording["left.motor.statusword"].values.tolist() == [0x0637]


def test_one_foreign_bus_of_a_rig_with_two_is_asked_for(tmp_path, two_buses):
    path = tmp_path / "one.log"
    path.write_text("(1.0) can0 181#5002000000000000\n")
    with pytest.raises(ChannelError, match=r"the file has the bus can0, and the rig has the buses a, b; .*a=can0"):
        read(path, two_buses)
    with pytest.raises(ChannelError, match="say which: --channel a=can0"):
        read(path, two_buses, "can0")
    path.write_text("(1.0) b 181#5002000000000000\n")
    assert len(read(path, two_buses)["right.motor.statusword"]) == 1


@pytest.fixture(scope="module")
def own(two_buses, tmp_path_factory):
    """Return the recordings of a run, one of each bus."""
    path = tmp_path_factory.mktemp("own") / "two.pcapng"
    simulate(two_buses.variant(PHASES), "hybrid", 0.1, record=path)
    return {channel: path.with_name(f"two.{channel}.pcapng") for channel in "ab"}


@pytest.mark.parametrize(("channel", "axis", "other"), [("a", "left", "right"), ("b", "right", "left")])
def test_our_recording_knows_its_bus(own, two_buses, channel, axis, other):
    path = own[channel]
    assert read_pcapng(path).buses[0] == channel
    recording = read(path, two_buses)
    attached = read(path)
    for name, signal in recording.signals.items():
        if name.startswith(f"{other}."):
            assert len(signal) == 0, name
        else:
            assert name.startswith(f"{axis}.")
            assert np.array_equal(signal.values, attached[name].values), name
    assert len(recording[f"{axis}.host.phase"]) > 10
    assert recording.frames.tolist() == attached.frames.tolist()


def test_our_recording_without_its_rig_is_known_by_its_interface(own, two_buses, tmp_path):
    path = tmp_path / "rewritten.pcapng"
    frames = read_pcapng(own["b"]).frames
    with PcapngWriter(path, attachments={}, texts=SectionTexts(application="editcap"), interface="b") as writer:
        writer.write(frames)
    recording = read(path, two_buses)
    assert len(recording["left.motor.statusword"]) == 0
    assert len(recording["right.motor.statusword"]) > 10


def test_an_old_recording_is_known_by_its_rig(own, two_buses, tmp_path):
    path = tmp_path / "old.pcapng"
    capture = read_pcapng(own["b"])
    with PcapngWriter(path, attachments=capture.attachments) as writer:
        writer.write(capture.frames)
    recording = read(path, two_buses)
    assert len(recording["left.motor.statusword"]) == 0
    assert len(recording["right.motor.statusword"]) > 10


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("kind", ["candump", "asc", "blf"])
def test_an_exported_log_keeps_the_buses(two, tmp_path, kind):
    suffix = {"candump": ".log", "asc": ".asc", "blf": ".blf"}[kind]
    out = tmp_path / f"out{suffix}"
    assert export(two, out, kind).rows == 3 * CYCLES
    log = read_log(out)
    assert np.bincount(log.frames["source"]).tolist() == [2 * CYCLES, CYCLES]
    assert log.frames["word"][log.frames["source"] == 1].tolist() == [WORDS["can1"]] * CYCLES
    second = buses_of(two)[1]
    assert export(two, out, kind, channel=second, force=True).rows == CYCLES


def test_converted_files_keep_the_buses(two, tmp_path):
    if two.suffix == ".mf4":
        return  # python-can numbers its channels otherwise
    out = tmp_path / "out.pcapng"
    with can.LogReader(two) as reader, can.Logger(out) as log:
        for message in reader:
            log.on_message_received(message)
    capture = read_pcapng(out)
    assert len(capture.buses) == 2
    assert np.bincount(capture.frames["source"]).tolist() == [2 * CYCLES, CYCLES]


def test_verbs_end_with_the_names_or_take_one(tmp_path, two_buses):
    log, rig = tmp_path / "two.log", tmp_path / "two.toml"
    with can.Logger(log) as writer:
        for message in messages():
            writer.on_message_received(message)
    rig.write_text(two_buses.effective())

    def call(words, status):
        done = CliRunner().invoke(main, words.split())
        assert done.exit_code == status, done.output
        return done.output

    for verb in ("decode", "hz", "plot", "export --to csv", "identify", f"diff {log}"):
        assert "can0, can1" in call(f"{verb} {log} --rig bench", 2), verb
    assert "can0, can1" in call(f"replay {log} --bus coulombus:nowhere", 2)
    assert call(f"decode {log} --rig bench --channel can1", 0).count("statusword=0x0637") == CYCLES
    told = call(f"hz {log} --rig bench --channel can1 --json", 0)
    (timing,) = json.loads(told[told.index("{") :])["identifiers"]
    assert (timing["frames"], timing["rate_per_s"]) == (CYCLES, pytest.approx(1000))


def test_rows_of_a_rig_with_two_buses_name_the_bus(two, two_buses, tmp_path):
    if two.suffix != ".log":
        return
    from coulombus.monitor.decode import rows
    from coulombus.monitor.timing import recorded

    told = list(rows(blocks(two, two_buses)))
    assert [row["bus"] for row in told] == ["a", "a", "b"] * CYCLES
    assert [row["node"] for row in told if row["pdo"]] == ["left.motor", "right.motor"] * CYCLES
    stamps = recorded(blocks(two, two_buses))
    assert {channel: {i: line.frames for i, line in of.by_id.items()} for channel, of in stamps.items()} == {
        "a": {SYNC: CYCLES, TPDO1: CYCLES},
        "b": {TPDO1: CYCLES},
    }


def test_error_frames_of_candump_come_back_with_their_words(tmp_path):
    from coulombus.monitor.decode import rows

    path, out = tmp_path / "noisy.pcapng", tmp_path / "noisy.log"
    frames = new_records(Frame, 0x1FF + 1)
    frames[:] = [
        (k * 1000, CAN_ERR_FLAG | k if k else SYNC, 8, 0x0A08_0000_0108_2005 * (k % 3), 0) for k in range(0x200)
    ]
    with PcapngWriter(path, attachments={}) as writer:
        writer.write(frames)
    export(path, out, "candump")

    def words(file):
        return [(row["service"], row.get("text"), row["data"]) for row in rows(blocks(file, "bench"))]

    assert words(out) == words(path)
    assert sum(service == "error" for service, *_ in words(out)) == 0x1FF
    tape = load_tape(out)
    assert tape.frames["can_id"].tolist() == [SYNC]
    assert "511 error frames were left out" in tape.remarks[0]


def test_a_line_names_the_first_of_many_buses_and_the_begin_of_each(tmp_path):
    path = tmp_path / "many.log"
    names = [f"can{number}{'x' * 300}" for number in range(2000)]
    path.write_text("".join(f"(1700000000.{number:06d}) {name} 181#01\n" for number, name in enumerate(names)))
    with pytest.raises(ChannelError, match=r"buses can0x+, .*can9x+ and 1990 more, and .*--channel can0x+$") as refused:
        read(path, "bench")
    assert len(str(refused.value)) - len(str(path)) < 1000
    remarks = [text for text in read(path, "bench", channel=names[3]).remarks if "bus" in text]
    assert len(remarks) == 11
    assert remarks[-1] == f"{path}: 1989 frames of 1989 further buses were left out"
    assert max(map(len, remarks)) - len(str(path)) < 200


def test_all_buses_of_a_log_have_one_time_zero(tmp_path):
    path = tmp_path / "two.log"
    path.write_text(
        "(1700000000.0) can0 701#05\n(1700000005.0) can1 702#05\n(1700000005.5) can1 702#05\n(1700000006.0) can0 701#05\n"
    )
    told = explain(path, channel="can1")
    assert told.at_s(told.end_ns) == 5.5
    assert [row["t_s"] for row in bare_rows(path, "can1", KnownBus(), [])] == [5.0, 5.5]
    assert read(path, channel="can1").t_s.tolist() == [5.0, 5.5]
    assert blocks(path, channel="can1").extent() == (5.0, 5.5)
