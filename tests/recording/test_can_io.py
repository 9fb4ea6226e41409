import subprocess
import sys

import can
import pytest

from coulombus.recording.pcapng_blocks import PcapngError
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.reading import read

MESSAGES = [
    can.Message(timestamp=1_700_000_000.25, arbitration_id=0x181, data=b"\x37\x02\0\0\0\0\0\0", is_extended_id=False),
    can.Message(timestamp=1_700_000_000.5, arbitration_id=0x12345678, data=bytes(range(0xF8, 0x100))),
    can.Message(timestamp=1_700_000_000.75, arbitration_id=0x601, is_remote_frame=True, dlc=8, is_extended_id=False),
    can.Message(timestamp=1_700_000_001.0, arbitration_id=4, is_error_frame=True, dlc=8, data=bytes(8)),
]


def test_written_and_read_through_python_can(tmp_path):
    path = tmp_path / "a.pcapng"
    with can.Logger(path) as writer:
        for message in MESSAGES:
            writer(message)
    with can.LogReader(path) as reader:
        messages = list(reader)
    assert len(messages) == len(MESSAGES)
    for back, other in zip(messages, MESSAGES, strict=True):
        assert back.equals(other, timestamp_delta=1e-6, check_channel=False, check_direction=False)
    assert [message.is_error_frame for message in messages] == [False, False, False, True]


def test_our_own_reader_takes_it(tmp_path):
    path = tmp_path / "a.pcapng"
    with can.Logger(path, channel="bench") as writer:
        writer(MESSAGES[0])
        assert writer.file_size() > 0
    assert read(path, "bench")["motor.statusword"].values.tolist() == [0x0237]
    assert read_pcapng(path).application == "python-can"


def test_many_messages_keep_their_order_and_a_long_pause_hands_them_over(tmp_path):
    path = tmp_path / "a.pcapng"
    writer = can.Logger(path)
    for i in range(1000):
        writer(can.Message(timestamp=1e9 + i * 1e-4, arbitration_id=i, is_extended_id=False))
    writer(can.Message(timestamp=1e9 + 60, arbitration_id=1, is_extended_id=False))
    assert read_pcapng(path).frames["can_id"].tolist() == list(range(1000))
    writer.stop()
    writer.stop()
    assert len(read_pcapng(path).frames) == 1001


def test_can_fd_frames_are_left_out_and_counted(tmp_path):
    with can.Logger(tmp_path / "a.pcapng") as writer:
        writer(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
    assert writer.skipped == 1
    assert len(read_pcapng(tmp_path / "a.pcapng").frames) == 0


def test_an_old_recording_is_not_lost_to_append(tmp_path):
    path = tmp_path / "a.pcapng"
    with can.Logger(path) as writer:
        writer(MESSAGES[0])
    with pytest.raises(ValueError, match="mergecap"):
        can.Logger(path, append=True)
    assert len(read_pcapng(path).frames) == 1
    with pytest.raises(ValueError, match="gzip"):
        can.Logger(tmp_path / "a.pcapng.gz")


def test_a_file_of_another_kind_is_told(tmp_path):
    (tmp_path / "a.pcapng").write_text("hello")
    with pytest.raises(PcapngError, match="not a pcapng file"):
        can.LogReader(tmp_path / "a.pcapng")


@pytest.mark.thorough
def test_can_logconvert(tmp_path):
    with can.Logger(tmp_path / "a.pcapng") as writer:
        for message in MESSAGES:
            writer(message)
    command = [sys.executable, "-m", "can.logconvert", "a.pcapng", "b.log"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    assert (tmp_path / "b.log").read_text().splitlines()[:2] == [
        "(1700000000.250000) can0 181#3702000000000000 R",
        "(1700000000.500000) can0 12345678#F8F9FAFBFCFDFEFF R",
    ]
