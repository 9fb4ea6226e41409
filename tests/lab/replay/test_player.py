"""Recordings played onto a bus: what is sent, in which order and when.

Files that cannot be played.
"""

from __future__ import annotations

import json
import time

import can
import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.replay.player import NOTHING, load_tape, play
from coulombus.recording.frame_sender import senders
from coulombus.recording.log_files import LogError
from coulombus.recording.pcapng_blocks import PcapngError
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.recorder import Recorder
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import parse_address
from coulombus.wire.bits import frame_bits
from coulombus.wire.client import BusFull, Client
from coulombus.wire.frame import CAN_RTR_FLAG, FRAME, data_word
from coulombus.wire.handshake import Hello
from coulombus.wire.identifiers import IdentifierError, among, parse_identifiers

pytestmark = pytest.mark.usefixtures("private_sockets")

EFF, RTR, ERR = 0x80000000, 0x40000000, 0x20000000
ROWS = [  # (ms, identifier, data): host, motor, brake, host's heartbeat, extended, remote, error frame
    (1.0, 0x080, b""),
    (1.2, 0x181, bytes(8)),
    (1.4, 0x182, b"abc"),
    (1.6, 0x201, b"12"),
    (2.0, 0x77F, b"\5"),
    (2.2, EFF | 0x12345, b"x"),
    (2.4, RTR | 0x701, b""),
    (2.6, ERR | 4, bytes(8)),
    (3.0, 0x080, b""),
]
GOOD = [row for row in ROWS if not row[1] & ERR]


def frames(rows=ROWS):
    found = np.zeros(len(rows), FRAME).view(np.recarray)
    found[:] = [(round(ms * 1e6), can_id, len(data), data_word(data), 0) for ms, can_id, data in rows]
    return found


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "a.pcapng"
    with Recorder(path, load_rig("bench"), "hybrid", 0) as recorder:
        recorder.write(frames())
    return path


def arrived(bus, count):
    """Wait until so many frames are on the bus; return them."""
    deadline = time.monotonic() + 20
    while len(bus.frames) < count and time.monotonic() < deadline:
        time.sleep(1e-3)
    return bus.frames


class Clock:
    """Time that passes only where somebody waits.

    Stands in for `time` and for what stops a playing.
    """

    def __init__(self, stop_after=None):
        self.now_ns, self.waits, self.stop_after = 1_000_000_000, [], stop_after

    def monotonic_ns(self):
        return self.now_ns

    def wait(self, seconds):
        self.waits.append(self.now_ns)
        self.now_ns += max(0, round(seconds * 1e9))
        return self.stop_after is not None and len(self.waits) > self.stop_after

    def sleep(self, seconds):
        self.wait(seconds)


class Ears:
    """A client that notes what is sent when; refuses the first `full` messages."""

    def __init__(self, clock, bitrate=0, full=0):
        self.clock, self.bitrate_bit_s, self.full, self.heard = clock, bitrate, full, []

    def send(self, message):
        if self.full:
            self.full -= 1
            raise BusFull(parse_address("coulombus:x"))
        self.heard.append((self.clock.now_ns, int.from_bytes(message[:4], "little")))


def played(monkeypatch, tape, *, bitrate=0, full=0, stop_after=None, **options):
    clock = Clock(stop_after)
    monkeypatch.setattr("coulombus.lab.replay.player.time", clock)
    ears = Ears(clock, bitrate, full)
    result = play(tape, ears, clock, **options)
    begin = ears.heard[0][0] if ears.heard else 0
    return result, [((t - begin) / 1e6, can_id) for t, can_id in ears.heard]


def test_original_timing(monkeypatch, file):
    result, heard = played(monkeypatch, load_tape(file))
    assert heard == [(pytest.approx(ms - 1.0), can_id) for ms, can_id, _ in GOOD]
    assert (result.frames, result.loops, result.complete) == (len(GOOD), 1, True)
    assert result.late_us == {"p50": 0, "p99": 0, "max": 0}


def test_speed_and_loops_without_drift(monkeypatch, file):
    result, heard = played(monkeypatch, load_tape(file), speed=4.0, loops=3)
    length = 2.0 / 4
    gap = length / (len(GOOD) - 1)
    expected = [(ms - 1.0) / 4 + loop * (length + gap) for loop in range(3) for ms, _, _ in GOOD]
    assert [t for t, _ in heard] == pytest.approx(expected, abs=1e-4)
    assert result.loops == 3


def test_a_frame_ends_when_it_ended(monkeypatch, file):
    """On a bus that tells its bit rate a frame is sent its own length earlier."""
    _, heard = played(monkeypatch, load_tape(file), bitrate=1_000_000)
    lengths = [frame_bits(can_id & 0x7FF, data) / 1000 for _, can_id, data in (ROWS[0], ROWS[3])]
    assert heard[3][0] == pytest.approx(0.6 - (lengths[1] - lengths[0]), abs=1e-4)


def test_a_full_bus_is_waited_for_and_the_rest_is_not_late(monkeypatch, file):
    result, heard = played(monkeypatch, load_tape(file), full=1)
    assert result.full == 1
    assert result.late_us["max"] == pytest.approx(500)
    assert heard[-1][0] == pytest.approx(2.0 - 0.5)  # counted from the first, which was late


def test_a_bus_that_takes_nothing_ends_it(monkeypatch, file):
    with pytest.raises(OSError, match="no frame for 2 s") as caught:
        played(monkeypatch, load_tape(file), full=10**9)
    assert caught.value.exit_status == 4


def test_stopped_in_the_midst(monkeypatch, file):
    result, heard = played(monkeypatch, load_tape(file), stop_after=3)
    assert not result.complete
    assert result.frames == len(heard) == 3


def test_onto_a_bus(bus, file):
    with Client(parse_address("coulombus:bench"), Hello(filters=NOTHING)) as client:
        assert bus.greetings[-1][1] == list(NOTHING)
        play(load_tape(file), client, Clock())
    done = CliRunner().invoke(
        main, ["replay", str(file), "--bus", "coulombus:bench", "--json", "--ids", "80,181", "--priority", "0"]
    )
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert (told["frames"], told["complete"]) == (3, True)
    assert set(told["late_us"]) == {"p50", "p99", "max"}
    sent = [(can_id, data[:length]) for can_id, length, data in arrived(bus, len(GOOD) + 3)]
    everything = [(can_id, data) for _, can_id, data in GOOD]
    assert sent == everything + [one for one in everything if one[0] in (0x80, 0x181)]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--only-host"], [0x080, 0x201, 0x77F, RTR | 0x701, 0x080]),
        (["--node", "1"], [0x181]),
        (["--node", "1", "--node", "2"], [0x181, 0x182]),
        (["--from-s", "0.0012", "--to-s", "0.0016"], [0x181, 0x182, 0x201]),
        (["--ids", "180-1FF,00012345"], [0x181, 0x182, EFF | 0x12345]),
        (["--ids", "181", "--loop", "2"], [0x181, 0x181]),
    ],
)
def test_a_part_of_it(bus, file, options, expected):
    done = CliRunner().invoke(main, ["replay", str(file), "--bus", "coulombus:bench", "--priority", "0", *options])
    assert done.exit_code == 0, done.output
    assert [can_id for can_id, _, _ in arrived(bus, len(expected))] == expected


def test_who_sent_what_without_a_rig():
    found = senders(np.array([0x000, 0x080, 0x081, 0x185, 0x205, 0x585, 0x605, 0x705, EFF | 0x181, 0x7E4, 0x7E5]))
    assert found.tolist() == [0, 0, 1, 5, 0, 5, 0, 5, -1, -1, 0]


def test_a_remote_frame_is_the_hosts_request():
    found = senders(np.array([CAN_RTR_FLAG | 0x705, CAN_RTR_FLAG | 0x185, EFF | CAN_RTR_FLAG | 0x705]))
    assert found.tolist() == [0, 0, -1]


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc", ".log.gz"])
def test_the_files_of_other_tools(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a{suffix}"
    messages = [
        can.Message(timestamp=10.0, arbitration_id=0x181, data=b"abc", is_extended_id=False, channel=1),
        can.Message(timestamp=10.002, arbitration_id=0x12345678, data=bytes(range(8)), channel=1),
    ]
    with can.Logger(path) as logger:
        for message in messages:
            logger(message)
    tape = load_tape(path)
    assert tape.frames["can_id"].tolist() == [0x181, EFF | 0x12345678]
    assert tape.frames["word"].tolist() == [data_word(b"abc"), data_word(bytes(range(8)))]
    assert np.diff(tape.t_ns) == pytest.approx(2e6, abs=1e4)


def test_stamps_of_a_clock_are_the_microseconds_that_the_file_has(tmp_path):
    """python-can's stamps are floats, good to 0.2 us in our days."""
    path = tmp_path / "a.log"
    path.write_text("".join(f"(1700000000.{us:06d}) can0 080#\n" for us in (1, 1001, 999_999)), encoding="utf-8")
    assert load_tape(path).t_ns.tolist() == [0, 1_000_000, 999_998_000]


def test_a_log_that_breaks_off_is_told(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.000000) can0 181#0102\n(1.100000) can0 181#01", encoding="utf-8")
    tape = load_tape(path)
    assert len(tape.frames) == 1
    assert tape.remarks == (f"{path}: 1 row was left out: the file ends within it (the first is line 2)",)


def test_stamps_that_go_back_or_leap_are_told(tmp_path):
    path = tmp_path / "a.log"
    seconds = (1_700_000_000, 1_700_000_002, 1_699_999_990, 1_700_000_001, 1_700_100_000)
    path.write_text("".join(f"({t}.000000) can0 080#\n" for t in seconds), encoding="utf-8")
    tape = load_tape(path)
    assert (tape.t_ns // 10**9).tolist() == [0, 2, 2, 2, 100_000]
    assert tape.remarks[0].startswith(f"{path}: 1 stamp goes back: that of frame 3 by 12 s; ")
    assert tape.remarks[1:] == (
        f"{path}: 2 stamps go back, that of frame 3 by 12 s: such frames follow the one before them at once",
        f"{path}: frame 5 comes 99998 s after the one before it; --from-s and --to-s play a part",
    )


def test_a_torn_file_is_played_to_its_last_whole_block(file, bus):
    file.write_bytes(file.read_bytes()[:-7])
    done = CliRunner().invoke(main, ["replay", str(file), "--bus", "coulombus:bench", "--priority", "0"])
    assert done.exit_code == 0
    assert "the last block is unfinished: 41 bytes were left out" in done.stderr
    assert "1 error frames were left out" in done.stderr
    assert len(arrived(bus, len(GOOD) - 1)) == len(GOOD) - 1


@pytest.mark.parametrize(
    ("name", "content", "error", "text"),
    [
        ("a.pcapng", b"", PcapngError, "empty"),
        ("a.pcapng", b"\xa1\xb2\xc3\xd4" * 9, PcapngError, "classic pcap"),
        ("a.csv", b"rubbish\n" * 9, LogError, "no line of a log format that is known"),
        ("a.xyz", b"rubbish", LogError, "expected a pcapng file, or another tool's log"),
        ("a.log", b"", LogError, "the file is empty"),
    ],
)
def test_files_that_cannot_be_played(tmp_path, name, content, error, text):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(error, match=text) as caught:
        load_tape(path)
    assert str(path) in str(caught.value)
    assert caught.value.exit_status == 2


def test_wrong_options_and_no_bus(file, bus):
    def status(*arguments):
        return CliRunner().invoke(main, ["replay", str(file), *arguments]).exit_code

    assert status() == 2
    assert status("--bus", "coulombus:bench", "--law", "a:b") == 2
    assert status("--bus", "coulombus:bench", "--ids", "999") == 2
    assert status("--bus", "coulombus:bench", "--ids", "111") == 2  # nothing left to play
    assert status("--bus", "nonsense") == 2
    assert status("--bus", "coulombus:nobody") == 4
    assert status("--bus", "socketcan:nocan0") == 7  # the host's frames, and it may be a rig
    assert status("--bus", "socketcan:nocan0", "--to-rig") == 4
    assert bus.frames == []


def test_identifiers():
    assert parse_identifiers("181, 200-27F,00000123,5x") == (
        (0x181, 0x181),
        (0x200, 0x27F),
        (EFF | 0x123, EFF | 0x123),
        (EFF | 5, EFF | 5),
    )
    found = among([0x181, RTR | 0x181, EFF | 0x181, 0x27F, 0x280], parse_identifiers("181,200-27F"))
    assert found.tolist() == [True, True, False, True, False]
    for text in ("", "xyz", "200-100", "800", "20000000x", "7F-00000100", "1,,2"):
        with pytest.raises(IdentifierError):
            parse_identifiers(text)


def test_an_empty_recording_has_nothing_to_play(tmp_path):
    path = tmp_path / "a.pcapng"
    with PcapngWriter(path, attachments={}) as writer:
        writer.write(frames()[:0])
    assert len(load_tape(path).frames) == 0
