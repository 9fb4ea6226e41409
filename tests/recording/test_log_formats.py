"""Each text format of `logs.formats`: the same frames come back, under any name; other texts are refused."""

from __future__ import annotations

import random
import string

import can
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.cli.main import main
from coulombus.recording.log_files import LogError, is_log, read_log
from coulombus.recording.logs.formats import FORMATS
from coulombus.recording.logs.line_reader import LineReader, recognise
from coulombus.recording.logs.mf4 import ready
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_bytes
from log_texts import NO_CHANNEL, TEXTS, candump, frames_of, sent_frames, slcan
from places import ROOT

ENDINGS = (".log", ".asc", ".trc", ".csv", ".txt", ".blf", ".mf4", ".db", ".log.1", "")


def expected_id(frame):
    if frame.kind == "error":
        return CAN_ERR_FLAG | 0x80
    return frame.can_id | CAN_EFF_FLAG * frame.extended | CAN_RTR_FLAG * (frame.kind == "remote")


def written(path, name):
    path.write_bytes(TEXTS[name][0](frames_of(name)).encode())
    return path


def require_frames(log, name):
    """Compare the frames of a log with those that were written: all but the name of the channel and the start."""
    frames = frames_of(name)
    assert log.frames["can_id"].tolist() == [expected_id(frame) for frame in frames]
    assert log.frames["length"].tolist() == [frame.length for frame in frames]
    assert [data_bytes(row["word"], len(f.data)) for row, f in zip(log.frames, frames, strict=True)] == [
        f.data for f in frames
    ]
    steps_us = (log.frames["t_ns"] - log.frames["t_ns"][0]) / 1000
    assert steps_us.tolist() == pytest.approx([frame.t_us - frames[0].t_us for frame in frames], abs=0.01)
    channels = [log.buses[source].lstrip("can") for source in log.frames["source"]]
    assert channels == ["" if name in NO_CHANNEL else str(frame.channel) for frame in frames]


@pytest.mark.parametrize("row", FORMATS, ids=lambda row: row.name)
def test_the_example_of_a_format_is_a_frame_of_it(row):
    t_ns, can_id, length, data, _ = LineReader(row).row(row.example, ended=True)
    assert t_ns > 0
    assert can_id in (0x181, 0x123)
    assert length == len(data) >= 2


def test_each_format_has_a_text_of_frames_and_a_row_of_the_page():
    texts = {recognise(TEXTS[name][0](frames_of(name)).encode(), "").format.name for name in TEXTS}
    assert texts == {row.name for row in FORMATS}
    page = (ROOT / "docs/recording.md").read_text()
    makers = {row.name.partition(" ")[0].removesuffix("'s") for row in FORMATS}
    table = [line for line in page.splitlines() if line.startswith("|") and "| this project |" in line]
    assert {maker for maker in makers if not any(maker in line.split("|")[1] for line in table)} == set()


@pytest.mark.parametrize("name", TEXTS)
def test_the_same_frames_come_back_from_each_format(tmp_path, name):
    log = read_log(written(tmp_path / name, name))
    require_frames(log, name)
    summed = [text for text in log.remarks if "were added up" in text]
    assert (len(summed), len(log.remarks)) == ((1, 1) if name.startswith("steps") else (0, 0))


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", TEXTS)
def test_a_text_is_known_under_the_name_of_another_format(tmp_path, name, ending):
    require_frames(read_log(written(tmp_path / f"log{ending}", name)), name)


@pytest.mark.parametrize("ending", [".log", ".blf", ".csv"])
@pytest.mark.parametrize("kind", [".blf", ".db", ".mf4"])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_binary_log_is_known_under_another_name(tmp_path, kind, ending):
    if kind == ".mf4":
        pytest.importorskip("asammdf")
        ready()
    with can.Logger(tmp_path / f"run{kind}") as writer:
        for k in range(3):
            writer.on_message_received(can.Message(1.0 + k, 0x181, is_extended_id=False, data=[k], channel=1))
    path = (tmp_path / f"run{kind}").rename(tmp_path / f"other{ending}")
    assert read_log(path).frames["can_id"].tolist() == [0x181] * 3


def row_places(name, frames, end):
    """Return begin and end of each row of a text, without its head and foot."""
    content, places, at = TEXTS[name][0](frames).encode(), [], 0
    others = TEXTS[name][0]([]).encode().split(end)
    for line in content.split(end):
        if line not in others:
            places.append((at + len(line) - len(line.lstrip()), at + len(line)))
        at += len(line) + len(end)
    return content, places


@pytest.mark.thorough
@pytest.mark.parametrize("name", TEXTS)
def test_each_format_cut_anywhere_has_frames_and_counted_rows(tmp_path, name):
    path, frames = tmp_path / name, frames_of(name)[:4]
    content, places = row_places(name, frames, b"\r" if name == "slcan_cr.log" else b"\n")
    assert len(places) == len(frames)
    for cut in range(1, len(content) + 1):
        path.write_bytes(content[:cut])
        log = read_log(path)
        counted = sum(int(text.split(": ")[1].split()[0]) for text in log.remarks if "left out" in text)
        begun, whole = sum(begin < cut for begin, _ in places), sum(end < cut for _, end in places)
        assert whole <= len(log.frames) <= begun, content[:cut]
        assert not whole or len(log.frames) + counted == begun, (content[:cut], log.remarks)
        for row, frame in zip(log.frames, frames, strict=False):
            assert (row["can_id"], row["length"]) == (expected_id(frame), frame.length)
            assert data_bytes(row["word"], len(frame.data)) == frame.data


ALPHABET = string.ascii_letters + string.digits + " \t,.;:#()[]\"'-/"


def random_text(seed):
    """A text of words, numbers and tables: what lies in folders beside logs."""
    source = random.Random(seed)
    lines = []
    for _ in range(source.randrange(1, 30)):
        if source.random() < 0.5:
            cells = [
                source.choice((str(source.randrange(10**6)), f"{source.random():.4f}", "abc", "00 1F"))
                for _ in range(6)
            ]
            lines.append(source.choice((",", ";", "\t", " ")).join(cells[: source.randrange(1, 7)]))
        else:
            lines.append("".join(source.choice(ALPHABET) for _ in range(source.randrange(60))))
    return "\n".join(lines) + "\n"


@pytest.mark.thorough
@pytest.mark.parametrize("ending", [".log", ".asc", ".trc", ".csv", ".txt", ""])
def test_random_texts_give_no_frame(tmp_path, ending):
    path = tmp_path / f"text{ending}"
    for seed in range(200):
        path.write_text(random_text(seed))
        assert number_of_frames(path) == 0, random_text(seed)


def number_of_frames(path):
    """Return the number of frames; 0 for a file that is refused."""
    try:
        return len(read_log(path).frames)
    except LogError:
        return 0


@settings(max_examples=120, deadline=None, derandomize=True, database=None)
@given(text=st.text(max_size=400).filter(str.strip))
def test_any_unicode_text_gives_no_frame_and_no_other_error(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "unicode.log"
    path.write_text(text, encoding="utf-8")
    assert not is_log(path) or number_of_frames(path) == 0


@pytest.mark.parametrize("verb", ["explain", "decode", "hz"])
@pytest.mark.parametrize("name", ["table.csv", "notes.txt", "bare"])
def test_a_table_of_no_known_format_ends_with_2(tmp_path, verb, name):
    path = tmp_path / name
    path.write_text("Time;ID;DLC;Data\n0.001;181;2;37 02\n0.002;705;1;05\n")
    done = CliRunner().invoke(main, [verb, str(path)])
    assert done.exit_code == 2
    message = " ".join(done.stderr.split())
    assert f"{name}:1: 'Time;ID;DLC;Data' is no line of a log format that is known; the nearest is " in message


def test_the_refusal_names_the_nearest_format_and_the_first_line(tmp_path):
    path = tmp_path / "mixed.txt"
    lines = ["(1.0) can0 181#3706", *["(1.0) can0 181-3706"] * 5]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError, match=r"mixed\.txt:2: '\(1\.0\) can0 181-3706' is no line .* the nearest is candump"):
        read_log(path)


def test_lines_that_belong_to_a_format_only_behind_its_frames_are_no_log(tmp_path):
    path = tmp_path / "Makefile"
    path.write_text("all:\n\techo 1\n\techo 2\n")
    with pytest.raises(LogError, match="Makefile:1: 'all:' is no line of a log format"):
        read_log(path)


def test_a_few_malformed_rows_of_a_known_log_are_a_remark(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("(1.0) can0 181#3706\n(1.5) can0 oops\n(2.0) can0 181#3706\n")
    log = read_log(path)
    assert len(log.frames) == 2
    assert log.remarks == (f"{path}: 1 row was left out: no frame of this format (the first is line 2)",)


def test_the_clock_of_slcan_begins_again_every_minute(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("V1013\rt1811FFEA00\rz\rt1811FF0010\rt1811FFEA5F\rt1811FF0000\r")
    log = read_log(path)
    assert np.diff(log.frames["t_ns"]).tolist() == [112_000_000, 59_983_000_000, 1_000_000]
    assert [text.removeprefix(f"{path}: ")[:16] for text in log.remarks] == ["2 rows were left"]


def test_slcan_without_stamps_is_read_and_said(tmp_path):
    path = tmp_path / "a.log"
    frames = [f for f in sent_frames() if f.kind != "error"]
    path.write_text(slcan(frames, stamped=False))
    log = read_log(path)
    assert [data_bytes(row["word"], len(f.data)) for row, f in zip(log.frames, frames, strict=True)] == [
        f.data for f in frames
    ]
    assert log.remarks == (
        f"{path}: {len(frames)} frames have no time stamp and got the time 0: log with time stamps (candump -L)",
    )


def test_decimal_data_of_a_kvaser_csv_are_not_read_as_hexadecimal(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Time,Channel,ID,Flags,DLC,Data0,Data1\n1.5,1,385,2,2,55,16,,,,,,,1\n1.6,1,1A1,2,0,,,,,,,,,2\n")
    log = read_log(path)
    assert log.frames["can_id"].tolist() == [385]
    assert data_bytes(log.frames["word"][0], 2) == bytes([55, 16])
    assert "1 row was left out" in log.remarks[0]


def test_a_system_clock_of_busmaster_is_the_time_of_day(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(TEXTS["busmaster.log"][0](frames_of("busmaster.log")).encode())
    midnight_ns = 1_723_075_200 * 10**9  # 2024-08-08
    assert read_log(path).frames["t_ns"][0] == midnight_ns + 10**9


def test_candump_rows_of_one_file_may_have_both_forms(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(candump(sent_frames()[:2]) + " (0000000002.000000)  can0  705   [1]  7F\n")
    assert read_log(path).frames["can_id"].tolist()[-1] == 0x705


def test_a_byte_order_mark_is_no_part_of_the_first_row(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(TEXTS["gvret.csv"][0](frames_of("gvret.csv")), encoding="utf-8-sig")
    require_frames(read_log(path), "gvret.csv")
    assert read_log(path).remarks == ()
