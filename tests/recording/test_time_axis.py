"""Stamps that are no time: back, still, differences, another clock's; said once, whichever command reads the log."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.recording.log_files import read_log
from coulombus.recording.logs.log import are_differences, time_remarks

PERIOD_US = 10_000


def clock(count, start_us=5_000_000, jitter=137):
    """Stamps of frames about 10 ms apart, in microseconds."""
    return [start_us + k * PERIOD_US + k * jitter % 300 for k in range(count)]


def candump(path, stamps_us, form="{:017.6f}"):
    rows = [
        f"({form.format(t / 1e6)}) can0 {('080', '181', '201')[k % 3]}#{k % 256:02X}\n" for k, t in enumerate(stamps_us)
    ]
    path.write_text("".join(rows))
    return path


def said(path):
    return [text.removeprefix(f"{path}: ") for text in read_log(path).remarks]


def test_a_clock_that_rises_is_not_remarked_on(tmp_path):
    assert said(candump(tmp_path / "a.log", clock(60))) == []


def test_stamps_that_go_back_are_counted_with_the_first_frame(tmp_path):
    stamps = clock(30) + clock(20, 1_000_000) + clock(10, 500_000)
    (text,) = said(candump(tmp_path / "a.log", stamps))
    back_s = (stamps[29] - stamps[30]) / 1e6
    assert text.startswith(f"2 stamps go back: that of frame 31 by {back_s:g} s; ")


@pytest.mark.parametrize(("row", "away_us"), [(17, 6_000_000), (17, -3_000_000), (1, 10**12)])
def test_a_frame_with_the_stamp_of_another_clock_is_named(tmp_path, row, away_us):
    stamps = clock(40)
    stamps[row] += away_us
    (text,) = said(candump(tmp_path / "a.log", stamps))
    assert text.startswith(f"1 frame has the stamp of another clock: frame {row + 1} is ")


def test_frames_of_two_channels_that_swap_by_a_little_go_back(tmp_path):
    stamps = clock(20)
    stamps[7], stamps[8] = stamps[7] + 100, stamps[7]
    (text,) = said(candump(tmp_path / "a.log", stamps))
    assert text.startswith("1 stamp goes back: that of frame 9 by 0.0001 s; ")


@pytest.mark.parametrize("stamp", [0, 7_250_000])
def test_stamps_that_stand_still_are_no_times(tmp_path, stamp):
    (text,) = said(candump(tmp_path / "a.log", [stamp] * 12))
    assert text == f"all 12 frames have the stamp {stamp / 1e6:g} s: it has no times; log with time stamps"


@pytest.mark.parametrize("jitter", [137, 0])
def test_differences_are_added_up(tmp_path, jitter):
    stamps = clock(50, jitter=jitter)
    steps = [0, *np.diff(stamps).tolist()]
    path = candump(tmp_path / "a.log", steps, "{:010.6f}")
    assert said(path) == ["its stamps are times since the frame before (candump -t d) and were added up"]
    assert (read_log(path).frames["t_ns"] // 1000).tolist() == np.cumsum(steps).tolist()


def test_the_time_of_a_row_left_out_is_added_up_too(tmp_path):
    path = tmp_path / "a.log"
    rows = [
        "(000.000000) can0 181#01",
        "(000.010000) can0 181##100",
        *["(000.010100) can0 181#02", "(000.009900) can0 181#03"] * 3,
    ]
    path.write_text("\n".join(rows) + "\n")
    assert (read_log(path).frames["t_ns"] // 1000).tolist()[:3] == [0, 20_100, 30_000]


def test_a_clock_from_zero_with_one_reset_is_no_difference():
    t_ns = np.array(clock(30, 0) + clock(30, 0)) * 1000
    assert not are_differences(t_ns)
    assert time_remarks(t_ns)[0].startswith("1 stamp goes back")


def test_wall_clock_stamps_are_never_differences(tmp_path):
    stamps = clock(30)
    stamps[1::2], stamps[::2] = stamps[::2], stamps[1::2]
    texts = said(candump(tmp_path / "a.log", stamps))
    assert texts
    assert not any("added up" in text for text in texts)


@pytest.mark.parametrize("command", [["explain"], ["decode"], ["hz"], ["export", "--to", "candump", "-o", "out.log"]])
def test_each_command_says_that_stamps_go_back(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    candump(tmp_path / "a.log", clock(30) + clock(30))
    done = CliRunner().invoke(main, [command[0], "a.log", *command[1:]])
    assert "1 stamp goes back: that of frame 31" in " ".join(done.output.split())


@pytest.mark.parametrize(("kind", "status"), [("asc", 2), ("blf", 0), ("candump", 0)])
def test_stamps_before_the_first_are_kept_or_refused(tmp_path, monkeypatch, kind, status):
    monkeypatch.chdir(tmp_path)
    path = candump(tmp_path / "a.log", clock(30) + clock(30, 1_000_000))
    done = CliRunner().invoke(main, ["export", "a.log", "--to", kind, "-o", f"out.{kind}"])
    assert done.exit_code == status, done.output
    if status:
        assert "30 frames have stamps before the first frame" in " ".join(done.output.split())
        assert not (tmp_path / "out.asc").exists()
    else:
        assert (read_log(tmp_path / f"out.{kind}").frames["t_ns"] == read_log(path).frames["t_ns"]).all()


def test_stamps_that_go_back_within_the_log_are_kept_in_asc(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stamps = clock(30) + clock(30, 5_100_000)
    candump(tmp_path / "a.log", stamps)
    assert CliRunner().invoke(main, ["export", "a.log", "--to", "asc", "-o", "out.asc"]).exit_code == 0
    assert (read_log(tmp_path / "out.asc").frames["t_ns"] // 1000).tolist() == [t - stamps[0] for t in stamps]


def test_a_blf_of_wall_clock_times_refuses_earlier_stamps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    candump(tmp_path / "a.log", clock(3, 1_700_000_000_000_000) + clock(3, 1_600_000_000_000_000))
    done = CliRunner().invoke(main, ["export", "a.log", "--to", "blf", "-o", "out.blf"])
    assert done.exit_code == 2
    assert "3 frames have stamps before the file's start" in " ".join(done.output.split())
