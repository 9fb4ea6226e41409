"""Rate, jitter and delay behind SYNC of what is on a bus, against numbers that were put there; and
the PDO table. Counted times have the quantiles of kept ones, to the last bit.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.cli.main import main
from coulombus.kernels.records import new_records
from coulombus.monitor import timing as module
from coulombus.monitor.pdo_text import as_lines as pdo_lines
from coulombus.monitor.timing import Spread, Stamps, TimeCounts, Timing, as_lines, listen, recorded_bare, timing
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.rig import load_rig
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.address import parse_address
from coulombus.wire.frame import CAN_ERR_FLAG, Frame
from tiny_bus import tiny_bus

MS = 1_000_000
PERCENTS = (50, 99, 100)
times_of = st.lists(st.integers(-(10**12), 10**12) | st.integers(999_990, 1_000_010), min_size=1, max_size=200)


def stamped():
    """SYNC each 1 ms; TPDO1 120 us behind it, of a hundred once 170 us; an error frame."""
    stamps = Stamps()
    frames = []
    for k in range(1000):
        frames += [(k * MS, 0x080, 0, b""), (k * MS + (170_000 if k % 100 == 50 else 120_000), 0x181, 8, bytes(8))]
    stamps.add_frames([*frames, (5, CAN_ERR_FLAG | 1, 8, bytes(8))])
    return stamps


def test_rate_jitter_and_delay():
    sync, motor = timing(KnownBus(load_rig("bench")), stamped())
    assert (sync.can_id, sync.name, sync.frames, sync.from_sync) == (0x080, "SYNC", 1000, None)
    assert sync.rate_per_s == pytest.approx(1000)
    assert sync.jitter.max_us == 0
    assert (motor.name, motor.period_ms) == ("motor TPDO1", 1.0)
    assert (motor.jitter.p50_us, motor.jitter.max_us) == (0, 50)
    assert (motor.from_sync.p50_us, motor.from_sync.max_us) == (120, 170)
    assert motor.jitter.p99_us == pytest.approx(50, abs=1)  # 20 of 999 gaps


def test_what_needs_two_frames_is_none_of_one():
    stamps = Stamps()
    stamps.add_frames([(7, 0x701, 1, b"\x05"), (9, 0x181, 8, bytes(8))])
    motor, beat = timing(KnownBus(load_rig("bench")), stamps)
    assert (beat.name, beat.rate_per_s, beat.period_ms, beat.jitter) == ("motor heartbeat", None, None, None)
    assert motor.from_sync is None  # it came before any SYNC
    assert "-" in list(as_lines([beat]))[-1]


def test_names_of_services():
    stamps = Stamps()
    ids = (0x000, 0x080, 0x082, 0x100, 0x185, 0x582, 0x601, 0x77F, 0x7E5)
    stamps.add_frames([(1, can_id, 0, b"") for can_id in ids])
    names = [row.name for row in timing(KnownBus(load_rig("bench")), stamps)]
    assert names == [
        "NMT", "SYNC", "brake EMCY", "TIME", "-", "brake SDO tx", "motor SDO rx", "host heartbeat", "LSS_RX",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("largest_us", "head", "cells"),
    [
        (99_999.0, "jitter [us]", ["5.6", "999.9", "99999"]),
        (145_900.0, "jitter [ms]", ["0.006", "1.000", "145.9"]),
        (2.5e8, "jitter [s]", ["0.000", "0.001", "250.0"]),
    ],
)
def test_a_column_has_one_unit(largest_us, head, cells):
    rows = [Timing(0x181, "a", False, 9, 1.0, 1.0, Spread(5.6, 999.9, largest_us), Spread(1.0, 2.0, 9900.0))]
    rows.append(Timing(0x182, "b", False, 1, None, None, None, None))
    first, _, line, other = as_lines(rows)
    assert head in first
    assert "from SYNC [us]" in first
    assert line.split()[5:] == [*cells, "1.0", "9900"]
    assert other.split()[-5:] == ["-"] * 5
    assert max(map(len, line.split()[5:])) <= 5


@pytest.mark.parametrize("rig", ["bench", "two_axes"])
def test_no_line_is_wider_than_80_columns(rig):
    rig = load_rig(rig)
    stamps = Stamps()
    ids = [0x080, *(pdo.layout.cob_id for pdo in rig.pdos()), *(0x700 + node.node_id for node in rig.nodes)]
    random = np.random.default_rng(3)
    stamps.add_frames(
        [(int(t), can_id, 8, bytes(8)) for can_id in ids for t in np.cumsum(random.integers(1, 10**11, 500))]
    )
    lines = [*as_lines(timing(KnownBus(rig), stamps)), *(line for pdo in rig.pdos() for line in pdo_lines(pdo))]
    assert max(map(len, lines)) <= 80


def test_command_reads_a_recording(tmp_path):
    frames = new_records(Frame, 300)
    frames["t_ns"] = 10**9 + np.arange(300) * MS
    frames["can_id"] = 0x080
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        writer.write(frames)
    call = ["hz", str(tmp_path / "a.pcapng"), "--rig", "bench"]
    rows = json.loads(CliRunner().invoke(main, [*call, "--json"]).stdout)
    assert (rows["lost"], rows["stamps"]) == (None, "the recording's")
    assert rows["identifiers"][0]["rate_per_s"] == pytest.approx(1000)
    lines = CliRunner().invoke(main, call).stdout.splitlines()
    assert lines[-1].split()[:5] == ["080", "SYNC", "300", "1000.0", "1.000"]
    assert CliRunner().invoke(main, [*call, "--bus", "coulombus:x"]).exit_code == 2


def test_pdo_table_has_objects_scales_and_bits():
    done = CliRunner().invoke(main, ["pdo"])
    assert done.exit_code == 0
    lines = [line.split() for line in done.output.splitlines()]
    assert ["0-15", "6041h:0", "motor.statusword"] in lines
    assert ["9", ".remote"] in lines
    assert ["16-47", "6064h:0", "motor.position_rad", "rad", "8.00032e-05"] in lines
    pdos = json.loads(CliRunner().invoke(main, ["pdo", "--json"]).stdout)
    status = next(e for pdo in pdos for e in pdo["entries"] if e["signal"] == "motor.statusword")
    assert (status["object"], status["start"], status["fields"]["state"]) == ("6041:00", 0, [0, 7])


def test_listening_to_a_bus(private_sockets, monkeypatch):
    with tiny_bus("t") as bus:

        class Heard(StopSignals):
            def __enter__(self):  # the client is there
                for _ in range(20):
                    bus.deliver((0x080, b""), (0x181, bytes(8)))
                bus.lost = 3
                return super().__enter__()

        monkeypatch.setattr("coulombus.monitor.timing.StopSignals", Heard)
        stamps, lost = listen(parse_address("coulombus:t"), 0.05)
    assert {can_id: line.frames for can_id, line in stamps.by_id.items()} == {0x080: 20, 0x181: 20}
    assert lost == 3


def test_remote_frames_are_counted_beside_the_data_frames(tmp_path):
    path = tmp_path / "guarding.log"
    rows = [
        f"({1 + k / 10:.6f}) can0 705#R1\n" + (f"({1.001 + k / 10:.6f}) can0 705#05\n" if k < 4 else "")
        for k in range(9)
    ]
    path.write_text("".join(rows) + "(2.5) can0 181#R8\n")
    counted = {
        (row.can_id, row.remote): (row.name, row.frames) for row in timing(*recorded_bare(path, None, KnownBus(), []))
    }
    assert counted == {
        (0x181, True): ("1 TPDO1 RTR", 1),
        (0x705, False): ("5 heartbeat", 4),
        (0x705, True): ("5 guarding", 9),
    }


def counted(times, parts):
    counts = TimeCounts()
    for part in np.array_split(np.array(times, np.int64), parts):
        counts.add(part)
    return counts


@settings(max_examples=80, derandomize=True, deadline=None)
@given(times=times_of, parts=st.integers(1, 5))
def test_quantiles_are_those_of_numpy(times, parts):
    counts = counted(times, parts)
    assert len(counts) == len(times)
    assert counts.percentiles(PERCENTS) == np.percentile(np.array(times), PERCENTS).tolist()
    assert counts.median() == np.median(times)
    apart = np.abs(np.array(times) - counts.median()).astype(np.int64)
    assert counts.distances(counts.median()).percentiles(PERCENTS) == np.percentile(apart, PERCENTS).tolist()


def test_the_memory_is_that_of_the_different_times(monkeypatch):
    monkeypatch.setattr(module, "UNCOUNTED", 1000)
    counts, chance = TimeCounts(), np.random.default_rng(5)
    for _ in range(300):
        counts.add(1_000_000 + chance.integers(-50, 50, 100))
    assert len(counts) == 30_000
    assert len(counts._times) <= 100
    assert counts._size < 1000


@pytest.mark.parametrize("parts", [1, 7, 100])
def test_the_timing_does_not_depend_on_the_stretches(parts):
    chance = np.random.default_rng(6)
    t_ns = np.sort(chance.integers(0, 10**9, 3000))
    can_ids = chance.choice([0x80, 0x181, 0x182, 0x701], 3000)
    stamps = Stamps()
    for rows in np.array_split(np.arange(3000), parts):
        stamps.add_stamps(t_ns[rows], can_ids[rows])
    syncs = t_ns[can_ids == 0x80]
    for row in timing(KnownBus(), stamps):
        own = t_ns[can_ids == row.can_id]
        gaps = np.diff(own)
        assert (row.frames, row.period_ms) == (len(own), np.median(gaps) / 1e6)
        jitter = np.percentile(np.abs(gaps - np.median(gaps)).astype(np.int64), PERCENTS) / 1e3
        assert [row.jitter.p50_us, row.jitter.p99_us, row.jitter.max_us] == jitter.tolist()
        if row.can_id in (0x181, 0x182):
            last = np.searchsorted(syncs, own, "right") - 1
            delays = np.percentile((own - syncs[last])[last >= 0], PERCENTS) / 1e3
            assert [row.from_sync.p50_us, row.from_sync.p99_us, row.from_sync.max_us] == delays.tolist()
