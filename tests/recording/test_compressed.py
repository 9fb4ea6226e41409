"""Recordings compressed with gzip or zstd: read as they are, and to the tear where they are torn."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
import zstandard
from click.testing import CliRunner
from hypothesis import example, given, settings
from hypothesis import strategies as st

from coulombus.cli.main import main
from coulombus.kernels.records import new_records
from coulombus.lab.replay.player import load_tape
from coulombus.recording.comparison import compare
from coulombus.recording.logs import content as module
from coulombus.recording.logs.content import Content
from coulombus.recording.output_file import named_after
from coulombus.recording.pcapng_blocks import PcapngError
from coulombus.recording.pcapng_reader import iter_pcapng, read_pcapng
from coulombus.recording.reading import blocks, read
from coulombus.recording.recorder import Recorder
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame

pytestmark = pytest.mark.slow  # in plain Python each packet takes some microseconds

PACKINGS = {".gz": gzip.compress, ".zst": zstandard.ZstdCompressor(write_checksum=True).compress}
COUNT = 30_000
each_packing = pytest.mark.parametrize("suffix", PACKINGS)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """Return a recording of 1.4 MB: two stretches, noisy values, a marker in the second."""
    path = tmp_path_factory.mktemp("compressed") / "run.pcapng"
    frames = new_records(Frame, COUNT)
    frames["t_ns"] = 1_000_000 * (1 + np.arange(COUNT) // 2)
    frames["can_id"], frames["length"] = np.where(np.arange(COUNT) % 2, 0x181, 0x080), np.arange(COUNT) % 2 * 8
    frames["word"] = np.random.default_rng(4).integers(0, 2**31, COUNT) * (frames["length"] > 0)
    with Recorder(path, load_rig("bench"), "hybrid", 4) as recorder:
        recorder.mark(14_000_000_000, "phase hold")
        recorder.write(frames)
    return path


def packed(plain: Path, folder: Path, suffix: str) -> Path:
    path = folder / f"{plain.name}{suffix}"
    path.write_bytes(PACKINGS[suffix](plain.read_bytes()))
    return path


@each_packing
def test_a_compressed_recording_reads_as_the_plain_one(plain, tmp_path, suffix):
    path = packed(plain, tmp_path, suffix)
    whole, same = read(plain), read(path)
    assert (whole.frames == same.frames).all()
    assert len(same.frames) == COUNT
    assert (same.markers, same.remarks) == ([(14.0, "phase hold")], ())
    assert [len(part.frames) for part in iter_pcapng(path)] == [len(part.frames) for part in iter_pcapng(plain)]
    assert sum(len(block["motor.position_rad"]) for block in blocks(path)) == COUNT // 2
    assert compare(plain, path).equal
    assert (load_tape(path).frames == whole.frames).all()


@pytest.mark.thorough
@each_packing
@pytest.mark.parametrize("verb", ["decode", "hz", "export --to csv -o OUT.csv", "export --to candump -o OUT.log"])
def test_the_verbs_print_the_same(plain, tmp_path, suffix, verb):
    texts = []
    for number, path in enumerate((plain, packed(plain, tmp_path, suffix))):
        words = verb.replace("OUT", str(tmp_path / str(number))).split()
        done = CliRunner().invoke(main, [words[0], str(path), *words[1:]])
        assert done.exit_code == 0, done.output
        made = sorted(tmp_path.glob(f"{number}.*"))
        text = done.stdout + "".join(file.read_text() for file in made)
        texts.append(text.replace(str(path), "FILE").replace(path.name, "FILE").replace(f"/{number}.", "/N."))
    assert texts[0] == texts[1]
    assert len(texts[0].splitlines()) > 4


@pytest.mark.thorough
@each_packing
@settings(max_examples=12, derandomize=True, deadline=None)
@given(part=st.floats(0.02, 0.999))
@example(part=0.0001)
def test_a_torn_file_gives_what_is_before_the_tear(plain, tmp_path_factory, suffix, part):
    path = packed(plain, tmp_path_factory.mktemp("torn"), suffix)
    data = path.read_bytes()
    path.write_bytes(data[: max(5, int(part * len(data)))])
    with Content(path) as content:
        empty = not content.read(1)
    if empty:  # zstd gives whole blocks of 128 KiB
        assert part < 0.3
        with pytest.raises(PcapngError, match=r"offset \d+: its \w+ data end too early: nothing of it can be unpacked"):
            read_pcapng(path)
        return
    torn = read_pcapng(path)
    assert (torn.frames == read_pcapng(plain).frames[: len(torn.frames)]).all()
    assert len(torn.frames) > COUNT * part - 7000
    assert torn.warnings[-1].startswith(f"{path}: offset {path.stat().st_size}: its ")
    assert torn.warnings[-1].endswith("data end too early: what stood behind is not known")


@each_packing
@pytest.mark.parametrize("part", [0.4, 0.9])
def test_a_damaged_file_is_told_with_its_offset(plain, tmp_path, suffix, part):
    path = packed(plain, tmp_path, suffix)
    content = bytearray(path.read_bytes())
    at = int(part * len(content))
    content[at : at + 64] = bytes(64)
    path.write_bytes(content)
    damaged = read_pcapng(path)
    assert 0 < len(damaged.frames) < COUNT
    told = [re.search(r"offset (\d+): its \w+ data are damaged", text) for text in damaged.warnings]
    assert at - 2048 <= int(next(match for match in told if match)[1])


@each_packing
def test_members_may_be_concatenated(plain, tmp_path, suffix):
    content, path = plain.read_bytes(), tmp_path / "two"
    path.write_bytes(PACKINGS[suffix](content[:70_001]) + PACKINGS[suffix](content[70_001:]))
    assert len(read(path).frames) == COUNT


@each_packing
def test_what_is_no_recording_is_refused(plain, tmp_path, suffix):
    path = tmp_path / f"run.pcapng{suffix}"
    other = {".gz": ".zst", ".zst": ".gz"}[suffix]
    for content, text in (
        (PACKINGS[suffix](b""), "the file is empty"),
        (PACKINGS[suffix](b"hello, no recording"), "not a pcapng file"),
        (PACKINGS[suffix](PACKINGS[other](plain.read_bytes())), "compressed twice"),
        (PACKINGS[suffix](b"x")[:4] + b"\xff" * 30, "nothing of it can be unpacked"),
    ):
        path.write_bytes(content)
        with pytest.raises(PcapngError, match=text) as caught:
            read_pcapng(path)
        assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.thorough
@each_packing
def test_it_is_unpacked_piece_by_piece(tmp_path, suffix, monkeypatch):
    monkeypatch.setattr(module, "FREE_BYTES", 1 << 28)
    path, size = tmp_path / "zeros", 1 << 28
    path.write_bytes(PACKINGS[suffix](bytes(size)))
    with Content(path) as content:
        pieces = [len(chunk) for chunk in content._chunks]
    assert sum(pieces) == size
    assert max(pieces) <= module.SLICE * (1 << 15)
    assert len(pieces) > 4


@pytest.mark.parametrize(
    ("name", "default"),
    [
        ("run.pcapng", "run.csv"),
        ("run.pcapng.zst", "run.csv"),
        ("run.pcapng.gz", "run.csv"),
        ("a.b.log.gz", "a.b.csv"),
        ("run.gz", "run.csv"),
    ],
)
def test_the_default_name_of_an_output(name, default):
    assert named_after(Path(name), ".csv").name == default


HEADS = {
    "a.log": b"(1700000000.000000) can0 181#0102\n" * 3,
    "a.pcapng": bytes.fromhex(
        "0a0d0d0a1c0000004d3c2b1a01000000ffffffffffffffff1c000000"  # a section
        "0100000014000000e30000000000000014000000"  # an interface
        "060000003000000000000000000000000100000010000000100000000000018102000000010200000000000030000000"  # a packet
    ),
}


@pytest.mark.thorough
@each_packing
@pytest.mark.parametrize("name", HEADS)
def test_a_file_that_unpacks_to_gigabytes_is_read_to_a_bound(tmp_path, suffix, name, monkeypatch):
    monkeypatch.setattr(module, "FREE_BYTES", 1 << 20)
    path = tmp_path / f"{name}{suffix}"
    path.write_bytes(PACKINGS[suffix](HEADS[name] + bytes(1 << 27)))
    recording = read(path, "bench")
    assert recording.frames["can_id"].tolist()[:1] == [0x181]
    (told,) = [text for text in recording.remarks if "it unpacks to" in text]
    bound = r"more than 1 MiB and 500 times its bytes, so that it is no log"
    size = re.search(rf"offset \d+: it unpacks to (\d+) MiB, {bound}", told)
    assert int(size[1]) <= 64


@each_packing
def test_a_log_of_equal_frames_is_read_whole(tmp_path, suffix, monkeypatch):
    monkeypatch.setattr(module, "FREE_BYTES", 1 << 12)
    path, count = tmp_path / f"a.log{suffix}", 40_000
    lines = [f"(17000{k // 1000:05d}.{k % 1000:03d}000) can0 181#0000000000000000\n" for k in range(count)]
    path.write_bytes(PACKINGS[suffix]("".join(lines).encode()))
    recording = read(path, "bench")
    assert (len(recording.frames), [text for text in recording.remarks if "unpacks" in text]) == (count, [])
