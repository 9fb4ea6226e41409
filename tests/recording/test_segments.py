"""Recordings in segments: each opens alone, together they are one, and little is lost."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.kernels.records import new_records
from coulombus.recording import segments as module
from coulombus.recording.file_content import append_late
from coulombus.recording.folders import runs, segments
from coulombus.recording.pcapng_blocks import PcapngError, RecordingError
from coulombus.recording.pcapng_reader import iter_pcapng
from coulombus.recording.reading import blocks, read
from coulombus.recording.recorder import About
from coulombus.recording.segments import Rotation, SegmentedRecorder, parse_rotation, parse_size, reserve
from coulombus.recording.wall_clock import attached_object, clock_state, utc, wall_clock
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame

STARTED_NS = 1_795_000_000 * 10**9
RIG = load_rig("bench")
BATCH = 500


def batch(number, count=BATCH):
    """TPDO1 of the motor, 1 ms apart: a position that rises."""
    frames = new_records(Frame, count)
    at = number * BATCH + np.arange(count)
    frames["t_ns"], frames["can_id"], frames["length"] = at * 1_000_000, 0x181, 8
    frames["word"] = at << 16
    return frames


def recorder(folder, rotation, **more):
    return SegmentedRecorder(folder, RIG, "hybrid", rotation, About(started_ns=STARTED_NS, **more))


def record(folder, rotation, batches=12):
    with recorder(folder, rotation) as made:
        for number in range(batches):
            if number == 7:
                made.mark(number * BATCH * 1_000_000, "phase hold")
            made.write(batch(number))
    return made


SMALL = Rotation(most_bytes=100_000)


def events(run):
    return [json.loads(line) for line in (run / "index.jsonl").read_text().splitlines()]


def test_segments_open_alone_and_together_they_are_the_run(tmp_path):
    run = record(tmp_path, SMALL).run
    files = segments(tmp_path)
    assert [path.name for path in files] == [f"{n:06d}.pcapng" for n in range(1, len(files) + 1)]
    assert len(files) >= 3
    each = [read(path) for path in files]
    assert all(block.rig.name == "bench" for block in each)
    assert all(len(path.read_bytes()) == path.stat().st_size < 250_000 for path in files)
    for place in (tmp_path, run):
        whole = read(place)
        assert whole.frames["t_ns"].tolist() == [n * 1_000_000 for n in range(12 * BATCH)]
        assert whole.markers == [(3.5, "phase hold")]
        assert sum(len(block.frames) for block in blocks(place)) == 12 * BATCH
    assert sum(len(block.frames) for block in each) == 12 * BATCH
    assert not whole.remarks


def test_the_index_tells_of_each_segment(tmp_path):
    lines = events(record(tmp_path, SMALL).run)
    begun, ended = ([line for line in lines if line["event"] == kind] for kind in ("begun", "ended"))
    assert [line["segment"] for line in begun] == [line["segment"] for line in ended]
    assert [line["segment"] for line in ended] == [path.name for path in segments(tmp_path)]
    assert sum(line["frames"] for line in ended) == 12 * BATCH
    assert [line["bytes"] for line in ended] == [path.stat().st_size for path in segments(tmp_path)]
    assert ended[-1]["last_ns"] == (12 * BATCH - 1) * 1_000_000
    assert begun[0]["utc"] == utc(STARTED_NS)


def test_a_segment_ends_after_its_time(tmp_path):
    record(tmp_path, Rotation(most_bytes=None, most_s=2.0))
    assert [len(read(path).frames) for path in segments(tmp_path)] == [4 * BATCH] * 3


def test_the_oldest_segments_of_all_runs_are_removed_and_nothing_else(tmp_path):
    first = record(tmp_path, SMALL).run
    (tmp_path / "mine.pcapng").write_text("mine")
    (tmp_path / "notes").mkdir()
    second = record(tmp_path, Rotation(100_000, None, keep_bytes=300_000)).run
    assert not first.exists()
    assert (tmp_path / "mine.pcapng").read_text() == "mine"
    assert (tmp_path / "notes").is_dir()
    kept = segments(second)
    assert sum(path.stat().st_size for path in kept) <= 300_000
    assert kept[-1].name > "000001.pcapng"
    assert read(second).frames["t_ns"][-1] == (12 * BATCH - 1) * 1_000_000
    removed = [line["segment"] for line in events(second) if line["event"] == "removed"]
    assert removed[0] == f"{first.name}/000001.pcapng"


def test_a_clock_that_is_set_back_changes_no_order(tmp_path):
    for seconds in (0, -86_400, -86_400):
        with SegmentedRecorder(tmp_path, RIG, "hybrid", SMALL, About(started_ns=STARTED_NS + seconds * 10**9)) as made:
            made.write(batch(0, 5))
    assert [run.name[:6] for run in runs(tmp_path)] == ["000001", "000002", "000003"]
    assert segments(tmp_path)[0].parent == made.run


def test_two_hosts_that_record_into_one_folder_have_a_run_each(tmp_path):
    with recorder(tmp_path, SMALL) as first, recorder(tmp_path, SMALL) as other:
        first.write(batch(0, 3))
        other.write(batch(0, 4))
    assert first.run != other.run
    assert [len(read(run).frames) for run in runs(tmp_path)] == [3, 4]


def test_what_another_host_writes_to_is_not_removed(tmp_path):
    with recorder(tmp_path, SMALL) as other:
        for number in range(4):
            other.write(batch(number))
        present = Path(other._writer.path)
        kept = record(tmp_path, Rotation(100_000, None, keep_bytes=200_000)).run
        assert segments(other.run) == [present]
        other.write(batch(4))
    assert len(read(present).frames) >= BATCH
    assert segments(kept)
    record(tmp_path, Rotation(100_000, None, keep_bytes=200_000))
    assert not other.run.exists()


def test_a_process_that_is_killed_loses_no_frame_that_was_written(tmp_path):
    code = (
        "import sys, os, signal; sys.path[:0] = sys.argv[2:]; from pathlib import Path\n"
        "from test_segments import *\n"
        "made = recorder(Path(sys.argv[1]), SMALL)\n"
        "[made.write(batch(number)) for number in range(9)]\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    here = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path), here], timeout=200, check=False)
    assert done.returncode == -signal.SIGKILL
    whole = read(tmp_path)
    assert len(whole.frames) == 9 * BATCH
    assert not whole.remarks
    assert events(segments(tmp_path)[0].parent)[-1]["event"] == "begun"
    with recorder(tmp_path, SMALL) as made:  # the next run is another one
        made.write(batch(0, 1))
    assert len(runs(tmp_path)) == 2


def test_a_segment_that_was_torn_is_read_to_its_last_whole_block(tmp_path):
    run = record(tmp_path, SMALL).run
    last = segments(run)[-1]
    os.truncate(last, last.stat().st_size - 7)
    whole = read(run)
    assert len(whole.frames) == 12 * BATCH - 1
    assert "unfinished" in " ".join(whole.remarks)


def test_a_disk_that_fills_up_makes_room_by_the_oldest_segments(tmp_path, monkeypatch):
    first = record(tmp_path, SMALL).run
    refused = [True, False]

    def full(fd, offset, length):
        if refused and refused.pop(0):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module, "reserve", full)
    with recorder(tmp_path, Rotation(150_000, None, keep_bytes=10**9)) as made:
        made.write(batch(0))
    assert segments(first)[0].name > "000001.pcapng"
    assert len(read(made.run).frames) == BATCH


def test_a_run_that_begins_on_a_full_disk_removes_old_segments_first(tmp_path, monkeypatch):
    first = record(tmp_path, SMALL).run
    free = os.statvfs(tmp_path)
    full = SimpleNamespace(f_bavail=0, f_frsize=free.f_frsize)
    monkeypatch.setattr(os, "statvfs", lambda path: full)
    made = record(tmp_path, Rotation(100_000, None, keep_bytes=10**9))
    assert segments(first)[0].name == "000003.pcapng"
    assert len(read(made.run).frames) == 12 * BATCH


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(module.Recorder, "__init__", lambda *given, **more: os.stat("/proc/nonexistent/x"))
    with pytest.raises(RecordingError):
        recorder(tmp_path, SMALL)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_ends_the_recording_and_keeps_what_is_there(tmp_path, monkeypatch):
    made = recorder(tmp_path, SMALL)
    made.write(batch(0))
    write = os.write

    def full(fd, data):
        if fd == made._writer.fileno():
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(fd, data)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(RecordingError, match="No space left"):
        made.write(batch(1))
    monkeypatch.undo()
    made.close()
    made.close()
    assert len(read(made.run).frames) == BATCH


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_folder_that_takes_nothing_is_told(tmp_path, monkeypatch, number):
    def refuse(*given, **more):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(RecordingError, match=os.strerror(number)):
        recorder(tmp_path / "runs", SMALL)


def test_room_is_reserved_without_a_change_of_the_length(tmp_path):
    with (tmp_path / "f").open("wb") as file:
        reserve(file.fileno(), 0, 1 << 20)
        assert os.fstat(file.fileno()).st_size == 0
    with pytest.raises(OSError, match=r"large|space"), (tmp_path / "g").open("wb") as file:
        reserve(file.fileno(), 0, 1 << 62)


def test_a_folder_without_a_recording_is_no_recording(tmp_path):
    (tmp_path / "000001-20261122T200412Z").mkdir()
    (tmp_path / "other").mkdir()
    with pytest.raises(PcapngError, match="no recording in this folder"):
        list(iter_pcapng(tmp_path))
    assert CliRunner().invoke(main, ["decode", str(tmp_path)]).exit_code == 2


def test_the_verbs_take_a_folder(tmp_path):
    record(tmp_path, SMALL, 4)
    done = CliRunner().invoke(main, ["decode", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert done.output.count("position_rad") + done.output.count("181") >= 4 * BATCH


@pytest.mark.parametrize(
    ("text", "bytes_", "seconds"),
    [
        ("100MB", 10**8, None),
        ("1.5 GB", 1_500_000_000, None),
        ("1h", None, 3600),
        ("90s", None, 90),
        ("2d", None, 172800),
    ],
)
def test_sizes_and_times_of_a_rotation(text, bytes_, seconds):
    assert parse_rotation(text) == Rotation(bytes_, seconds, None)


@pytest.mark.parametrize("text", ["", "100", "MB", "-1h", "0s", "1kB", "1e9MB", "nanMB", "1 year", "100MiB", "0.5s"])
def test_what_is_no_rotation_is_refused(text):
    with pytest.raises(ValueError, match="expected"):
        parse_rotation(text)
    with pytest.raises(ValueError, match="expected"):
        parse_size(text)


@pytest.mark.parametrize(
    "words",
    [
        "--rotate x --record DIR",
        "--keep 20 --record DIR",
        "--rotate 1h",
        "--keep 20GB",
        "--compress zstd",
        "--compress gzip --record DIR",
        "--rotate 1h --record DIR/f.pcapng",
        "--record DIR/none",
        "--rotate 100MB --keep 150MB --record DIR",
        "--meta subject=S01",
        "--meta subject --record DIR",
        "--meta =x --record DIR",
        "--meta a=1 --meta a=2 --record DIR",
    ],
)
def test_wrong_words_of_a_recording_are_usage_errors(tmp_path, words, private_sockets):
    words = words.replace("DIR", str(tmp_path))
    done = CliRunner().invoke(main, ["run", "--bus", "coulombus:none", *words.split()])
    assert done.exit_code == 2, done.output
    assert not runs(tmp_path)


def test_a_run_without_a_bus_leaves_no_folder(tmp_path, private_sockets):
    words = f"run --bus coulombus:none --record {tmp_path}/runs --rotate 1h --keep 20GB --meta subject=S01"
    assert CliRunner().invoke(main, words.split()).exit_code == 4
    assert not runs(tmp_path / "runs")


# the clock of the wall


def test_time_zero_is_told_in_utc(monkeypatch):
    monkeypatch.setattr("time.time_ns", lambda: STARTED_NS + 5_000_000_000)
    monkeypatch.setattr("time.monotonic_ns", lambda: 7_000_000_000)
    started, attachments, comment = wall_clock(2_000_000_000)
    clock = attached_object(attachments["clock.json"])
    assert started == clock["start_ns"] == STARTED_NS
    assert clock["start_utc"] == utc(STARTED_NS) == "2026-11-18T11:06:40.000000Z"
    assert clock["start_utc"] in comment
    assert clock["synchronised"] in (True, False, None)


def test_the_state_of_the_clock_is_told_or_not_known(monkeypatch):
    assert set(clock_state()) == {"synchronised", "max_error_us", "estimated_error_us", "ptp_clocks"}
    monkeypatch.setattr("ctypes.CDLL", lambda *given, **more: object())
    assert clock_state()["synchronised"] is None


@pytest.mark.parametrize("content", [None, b"", b"[]", b"{", b"\xff", b"[" * 99999])
def test_a_damaged_attachment_is_an_empty_one(content):
    assert attached_object(content) == {}


def test_a_marker_behind_the_last_frame_is_in_the_last_segment(tmp_path):
    with recorder(tmp_path, SMALL) as made:
        for number in range(12):
            made.write(batch(number))
        made.mark(7_000_000_000, "trip SPEED")
    assert read(made.run).markers == [(7.0, "trip SPEED")]
    append_late(made.run, [(8_000_000_000, "trip HOST")])
    assert read(segments(made.run)[-1]).markers == [(7.0, "trip SPEED"), (8.0, "trip HOST")]


def test_a_run_whose_folder_is_removed_is_an_error_at_the_next_write(tmp_path):
    made = recorder(tmp_path, SMALL)
    made.write(batch(0))
    shutil.rmtree(made.run)
    with pytest.raises(RecordingError, match="the file or its folder was removed"):
        made.write(batch(1))
    with pytest.raises(RecordingError):
        made.write(batch(2))
    made.close()
