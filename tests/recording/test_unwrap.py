"""A position followed across the wraps of its counter: by hand, over lost frames, block by block,
and in a rig whose 16 bits wrap within each stroke.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.pdo import Entry
from coulombus.lab.replay.host_replay import host_replay
from coulombus.lab.simulate import simulate
from coulombus.recording import pcapng_reader
from coulombus.recording.measures import measure
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import blocks, read
from coulombus.recording.signals import series
from coulombus.recording.unwrap import Turns, follow
from foreign_eds import I16, edited
from foreign_rigs import Part, brake, drive, rig_of

pytestmark = pytest.mark.slow

MS = 1_000_000
EVERY = 500 / MS  # counts a ns: the host lets 500 pass in a cycle
BOTH = pytest.mark.parametrize("sign", [1, -1])
ANGLE = "motor.position_rad"


def entry(bits, signed=True):
    return Entry(0x6064, 0, bits, signed=signed, kind="int", name="position")


def counter(true, bits, signed=True):
    """What a counter of so many bits tells."""
    half = 1 << bits - 1
    return (true + half) % (2 * half) - half if signed else true % (2 * half)


@BOTH
@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("bits", [16, 32])
def test_it_goes_on_where_the_counter_begins_anew(sign, signed, bits):
    true = sign * ((1 << bits - 1) - 30_000 + np.cumsum(np.full(1000, 97)))
    raw, t_ns = counter(true, bits, signed), np.arange(1000) * MS
    counts, last = follow(raw, t_ns, entry(bits, signed), None, EVERY)
    assert np.array_equal(np.diff(counts), np.diff(true))
    assert counts[0] == raw[0]
    assert last == Turns(int(raw[-1]), 999 * MS, int(counts[-1] - raw[-1]), 0)


@BOTH
def test_lost_samples_are_bridged_and_a_gap_that_is_too_long_is_counted(sign):
    true, t_ns = sign * 300 * np.arange(1000), np.arange(1000) * MS
    kept = np.ones(1000, bool)
    kept[100:160] = False  # 61 cycles: 18,300 counts, and at most 30,500
    counts, last = follow(counter(true, 16)[kept], t_ns[kept], entry(16), None, EVERY)
    assert np.array_equal(counts, true[kept])
    assert last.doubts == 0
    kept[500:566] = False  # 67 cycles: up to 33,500 counts, more than half the counter
    assert follow(counter(true, 16)[kept], t_ns[kept], entry(16), None, EVERY).last.doubts == 1


def test_a_jump_that_no_handle_makes_is_no_wrap():
    raw, t_ns = np.array([0, 30_000, 30_010, -12_000]), np.arange(4) * MS
    assert list(follow(raw, t_ns, entry(16), None, EVERY).counts) == [0, 30_000, 30_010, -12_000]


@BOTH
def test_parts_come_to_the_same_as_the_whole(sign):
    true, t_ns = sign * 450 * np.arange(700), np.arange(700) * MS
    raw, last, parts = counter(true, 16), None, []
    for at in (0, 1, 1, 300, 301):
        stop = {0: 1, 1: 300, 300: 301, 301: 700}[at] if len(parts) != 1 else 1
        counts, last = follow(raw[at:stop], t_ns[at:stop], entry(16), last, EVERY)
        parts.append(counts)
    assert np.array_equal(np.concatenate(parts), true)


def test_what_does_not_wrap_stays():
    real = Entry(0x2000, 0, 32, signed=True, kind="real", name="position")
    values = np.array([1e9, -1e9])
    assert follow(values, np.arange(2), real, None, EVERY) == (pytest.approx(values), None)
    assert len(follow(values[:0], np.arange(0), entry(16), None, EVERY).counts) == 0


# a rig


def narrow(sign=1):
    """The bench with a position of 16 bits and 65,536 counts a turn of the motor: it wraps every
    0.66 rad of the handle.
    """
    eds = edited(drive("own").eds, "6064", DataType=I16, LowLimit="", HighLimit="")
    keys = [f"{part}.encoder_polarity={sign}" for part in ("mechanics", "plant")]
    keys += [f"{part}.encoder_counts_rev=65536" for part in ("motor", "plant")]
    return rig_of(Part(eds), brake("own"), *keys, "limits.encoder_jump_counts=2000", "operator.tremor_Nm=0")


LOSSES = """
[[fault]]
kind = "drop"
on = "every 7th TPDO1 of node 1"
at_s = 0.6
after = "enabled"
"""


@pytest.mark.thorough
@pytest.mark.parametrize(("losses", "sign"), [("", 1), (LOSSES, -1)], ids=["whole", "lost frames"])
def test_a_recording_of_16_bits_has_the_handles_angle(tmp_path, monkeypatch, sign, losses):
    record, file = tmp_path / "r.pcapng", tmp_path / "faults.toml"
    file.write_text(losses)
    faults = file if losses else None
    result = simulate(narrow(sign), "hybrid", 3.0, record=record, truth=tmp_path / "t.npz", faults=faults)
    assert result.trip is None
    recording = read(record)
    angle = recording[ANGLE]
    raw = angle.values / recording.scale(ANGLE)
    assert np.ptp(raw) > 1.5 * 65536
    with np.load(tmp_path / "t.npz") as truth:
        true = np.interp(angle.t_s, truth["t_s"], truth["angle_rad"])
        assert np.max(np.abs(angle.values - true)) < 0.01
    assert not [text for text in recording.remarks if ANGLE in text]

    monkeypatch.setattr(pcapng_reader, "CHUNK", 1 << 16)  # in many blocks, as a long recording comes
    parts = blocks(record)
    assert len(list(parts)) > 5
    assert np.array_equal(series(parts, ANGLE)[0].values, angle.values)
    assert measure(parts) == measure(recording)

    rows = [json.loads(line) for line in told_by("decode", record, "--json").splitlines()]
    assert [row[ANGLE] for row in rows if ANGLE in row] == pytest.approx(list(angle.values))
    again = host_replay(record)
    assert (again.difference, again.unchecked) == (None, 0)


def told_by(*arguments):
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_gap_in_which_it_may_have_wrapped_is_told(tmp_path):
    record = tmp_path / "r.pcapng"
    simulate(narrow(), "hybrid", 1.0, record=record)
    whole = read(record)
    frames = whole.frames
    kept = frames[(frames["t_ns"] < 0.6e9) | (frames["t_ns"] > 0.7e9)]
    with PcapngWriter(tmp_path / "gap.pcapng", attachments=whole.capture.attachments) as writer:
        writer.write(kept)
    (remark,) = (text for text in read(tmp_path / "gap.pcapng").remarks if ANGLE in text)
    assert "motor.position_rad has 1 gaps that are longer than its counter can be followed" in remark
