"""Finished segments are compressed by another process: nothing is lost or counted twice, whatever ends it."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.recording import segment_compressor as module
from coulombus.recording.folders import INDEX, PACKED, files_of, segments_of
from coulombus.recording.pcapng_reader import iter_pcapng
from coulombus.recording.reading import blocks, read
from coulombus.recording.recorder import About
from coulombus.recording.segment_compressor import compress, main, tidy
from coulombus.recording.segments import Rotation, SegmentedRecorder
from coulombus.rigs.rig import load_rig
from coulombus.system.unfinished_file import unfinished
from coulombus.wire.frame import Frame

BATCH, BATCHES = 500, 12
RIG = load_rig("bench")
COMPRESSED = Rotation(100_000, None, None, compress=True)


def batch(number):
    frames = new_records(Frame, BATCH)
    at = number * BATCH + np.arange(BATCH)
    frames["t_ns"], frames["can_id"], frames["length"], frames["word"] = at * 1_000_000, 0x181, 8, at << 16
    return frames


def recorded(folder, rotation=COMPRESSED):
    """Record a run, and wait for its compressor."""
    about = About(started_ns=1_795_000_000 * 10**9)
    with SegmentedRecorder(folder, RIG, "hybrid", rotation, about) as recorder:
        for number in range(BATCHES):
            recorder.write(batch(number))
            assert Path(recorder._writer.path).suffix == ".pcapng"
            assert segments_of(recorder.run)[-1] == Path(recorder._writer.path)
    if recorder._compressor is not None:
        recorder._compressor._process.wait(200)
    return recorder.run


def is_whole(run):
    whole = read(run)
    assert whole.frames["t_ns"].tolist() == [n * 1_000_000 for n in range(BATCH * BATCHES)]
    assert not whole.remarks
    assert sum(len(block.frames) for block in blocks(run)) == BATCH * BATCHES


def events(run):
    return [json.loads(line) for line in (run / INDEX).read_text().splitlines()]


def test_each_finished_segment_is_compressed_and_opens_alone(tmp_path):
    run = recorded(tmp_path)
    files = files_of(run)
    assert len(files) >= 3
    assert [path.name for path in files] == [f"{n:06d}.pcapng.zst" for n in range(1, len(files) + 1)]
    assert sum(len(read(path).frames) for path in files) == BATCH * BATCHES
    is_whole(run)
    told = {line["segment"]: line["bytes"] for line in events(run) if line["event"] == "compressed"}
    assert told == {path.name: path.stat().st_size for path in files}
    plain = {line["segment"]: line["bytes"] for line in events(run) if line["event"] == "ended"}
    assert all(told[name + PACKED] < plain[name] / 2 for name in plain)


def test_without_compression_the_segments_stay_plain(tmp_path):
    run = recorded(tmp_path, Rotation(100_000))
    assert {path.suffix for path in files_of(run)} == {".pcapng"}


KILL = "os.kill(os.getpid(), signal.SIGKILL)"
STEPS = {
    "within the file": f"os.fsync = lambda fd: {KILL}",
    "before it has its name": f"os.replace = lambda *names: {KILL}",
    "before the plain file is removed": f"module._sync = lambda folder: {KILL}",
}


@pytest.mark.parametrize("step", STEPS)
def test_a_killed_compressor_loses_nothing_and_doubles_nothing(tmp_path, step):
    run = recorded(tmp_path, Rotation(100_000))
    first = files_of(run)[0]
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from coulombus.recording import segment_compressor as module\n"
        f"{STEPS[step]}\n"
        "module.compress(Path(sys.argv[1]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(first)], timeout=200, check=False)
    assert done.returncode == -signal.SIGKILL
    count = len(segments_of(run))
    assert len(list(run.iterdir())) == count + 2  # and the index, and what was left
    is_whole(run)
    tidy(tmp_path)
    assert len(list(run.iterdir())) == count + 1
    is_whole(run)
    for path in files_of(run):
        if path.suffix != PACKED:
            compress(path)
    assert {path.suffix for path in files_of(run)} == {PACKED}
    is_whole(run)


def test_a_recorder_removes_what_a_killed_compressor_left(tmp_path):
    old = recorded(tmp_path, Rotation(100_000))
    first = files_of(old)[0]
    content = first.read_bytes()
    compress(first)
    first.write_bytes(content)
    recorded(tmp_path)
    assert first not in files_of(old)
    is_whole(old)


def test_a_full_disk_leaves_the_segment_plain(tmp_path, monkeypatch, capsys):
    run = recorded(tmp_path, Rotation(100_000))
    first, count = files_of(run)[0], len(list(run.iterdir()))

    def full(fd):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(module.os, "fsync", full)
    monkeypatch.setattr(module.sys, "stdin", [json.dumps(str(first)), json.dumps(str(run / "000099.pcapng"))])
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    main(str(tmp_path))
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before  # a later child of this process would inherit it
    assert len(list(run.iterdir())) == count
    assert events(run)[-1] == {
        "event": "not compressed",
        "segment": first.name,
        "reason": "No space left on device",
    }
    is_whole(run)


def test_a_segment_removed_while_it_is_compressed_does_not_come_back(tmp_path, monkeypatch):
    run = recorded(tmp_path, Rotation(100_000))
    first, count = files_of(run)[0], len(list(run.iterdir()))
    monkeypatch.setattr(module.os, "fsync", lambda fd: first.unlink())
    assert compress(first) is None
    assert len(list(run.iterdir())) == count - 1


def test_a_segment_compressed_while_the_run_is_read_is_found(tmp_path):
    run = recorded(tmp_path, Rotation(100_000))
    stretches = iter_pcapng(run)
    frames = len(next(stretches).frames)
    for path in files_of(run)[1:]:
        compress(path)
    assert frames + sum(len(part.frames) for part in stretches) == BATCH * BATCHES


def test_keep_counts_the_compressed_bytes(tmp_path):
    old = recorded(tmp_path)
    kept = files_of(old)
    size = sum(path.stat().st_size for path in kept)
    plain = sum(line["bytes"] for line in events(old) if line["event"] == "ended")
    limit = 2 * plain + size  # of which the new run, still plain, takes one and leaves room for one more
    recorded(tmp_path, Rotation(100_000, None, keep_bytes=limit))
    assert files_of(old) == kept
    twin = kept[0].with_suffix("")
    twin.write_bytes(bytes(limit))  # it is on the disk, so it counts, and goes first
    recorded(tmp_path, Rotation(100_000, None, keep_bytes=limit))
    assert not twin.exists()


def test_the_process_gives_way_to_all_others_and_outlives_the_signals_of_the_host(tmp_path):
    run = recorded(tmp_path, Rotation(100_000))
    first = files_of(run)[0]
    code = (
        "import os, signal, sys\n"
        "from coulombus.recording import segment_compressor as module\n"
        "module.tidy = lambda folder: [os.kill(os.getpid(), number) for number in module.ENDING]\n"
        "module._give_way()\n"
        "module.main(sys.argv[1])\n"
        "print(os.sched_getscheduler(0) == os.SCHED_IDLE, os.nice(0))\n"
    )
    words = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(words, input=f"{json.dumps(str(first))}\n", text=True, capture_output=True, timeout=200)
    assert done.stdout.split() == ["True", "19"], done.stderr
    assert not first.exists()
    is_whole(run)


def test_a_recording_goes_on_without_the_process(tmp_path, monkeypatch):
    monkeypatch.setattr(module.sys, "executable", str(tmp_path / "none"))
    run = SegmentedRecorder(tmp_path, RIG, "hybrid", COMPRESSED, About(started_ns=1_795_000_000 * 10**9))
    for number in range(BATCHES):
        run.write(batch(number))
    run.close()
    is_whole(run.run)
    monkeypatch.undo()
    ended = SegmentedRecorder(tmp_path, RIG, "hybrid", COMPRESSED, About(started_ns=1_795_000_000 * 10**9))
    ended._compressor._process.kill()
    ended._compressor._process.wait(200)
    for number in range(BATCHES):
        ended.write(batch(number))
    ended.close()
    is_whole(ended.run)


def test_an_unfinished_file_is_no_segment(tmp_path):
    run = recorded(tmp_path)
    unfinished(run / f"000001.pcapng{PACKED}").write_bytes(b"x")
    is_whole(run)
