"""A bus as a pcapng stream: on a pipe, frame by frame, for Wireshark and its like."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time

import pytest

from coulombus.recording.reading import read
from coulombus.recording.stream import stream
from coulombus.rigs.rig import load_rig
from coulombus.wire import frame_batches
from coulombus.wire.address import parse_address
from coulombus.wire.client import BusGone
from coulombus.wire.frame_batches import BlockReader
from places import ROOT

pytestmark = [pytest.mark.real_time, pytest.mark.patient, pytest.mark.usefixtures("private_sockets")]

BENCH = parse_address("coulombus:bench")
PATIENCE_S = 60.0
SENT = [(0x181, bytes(range(8))), (0x80000123, b"x"), (0x20000004, bytes(8)), (0x080, b"")]


def watching(**options):
    command = [sys.executable, "-m", "coulombus", "watch", "--bus", str(BENCH), "--pcapng", "-"]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def greeted(bus):
    deadline = time.monotonic() + PATIENCE_S
    while not bus.greetings and time.monotonic() < deadline:
        time.sleep(0.01)
    assert bus.greetings[0][0] == 2 | 4  # listens only, takes error frames


def take_block(pipe):
    """Read one block; return its type and body."""
    kind, length = struct.unpack("<II", pipe.read(8))
    return kind, pipe.read(length - 8)[:-4]


def test_each_frame_is_on_the_pipe_as_soon_as_it_came(bus):
    process = watching()
    try:
        greeted(bus)
        packets = []
        while len(packets) < len(SENT):  # asked for one by one: the next is sent when the last was read
            bus.deliver(SENT[len(packets)])
            while (block := take_block(process.stdout))[0] != 6:
                pass
            packets.append(block[1])
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.communicate()
    for packet, (can_id, data) in zip(packets, SENT, strict=True):
        high, low = struct.unpack_from("<4xII", packet)
        assert abs((high << 32 | low) / 1e9 - time.time()) < 600
        assert struct.unpack_from(">IB", packet, 20) == (can_id, len(data))
        assert packet[28 : 28 + len(data)] == data
    assert bus.frames == []


def test_a_reader_that_goes_away_ends_it_quietly(bus):
    process = watching()
    try:
        greeted(bus)
        take_block(process.stdout)
        process.stdout.close()
        deadline = time.monotonic() + PATIENCE_S
        while process.poll() is None and time.monotonic() < deadline:
            bus.deliver(SENT[0])
            time.sleep(0.01)
        assert process.wait(PATIENCE_S) == 0
        assert process.stderr.read() == b""
    finally:
        process.kill()
        process.stderr.close()
        process.wait()


def test_a_named_pipe_and_a_bus_that_goes_away(bus, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    content, failures = [], []

    def run():
        try:
            stream(load_rig("bench"), BENCH, str(pipe))
        except BusGone as error:
            failures.append(error)

    reader = threading.Thread(target=lambda: content.append(pipe.read_bytes()))
    reader.start()
    deliverer = threading.Thread(target=lambda: (greeted(bus), bus.deliver(*SENT), bus.close()))
    deliverer.start()
    run()  # signals are the main thread's
    deliverer.join(PATIENCE_S)
    reader.join(PATIENCE_S)
    (tmp_path / "a.pcapng").write_bytes(content[0])
    recording = read(tmp_path / "a.pcapng")
    assert recording.frames["can_id"].tolist() == [can_id for can_id, _ in SENT]
    assert recording.rig.name == "bench"
    assert failures[0].exit_status == 4


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed (Debian: apt install tshark)")
def test_tshark_reads_it_from_the_pipe(bus):
    process = watching()
    fields = ["-T", "fields", "-e", "can.id", "-e", "can.len"]
    reader = subprocess.Popen(
        ["tshark", "-l", "-r", "-", *fields],
        stdin=process.stdout,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        process.stdout.close()
        greeted(bus)
        bus.deliver(SENT[0], SENT[3])
        lines = [reader.stdout.readline().split() for _ in range(2)]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        reader.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        reader.kill()
        reader.wait()
        process.stderr.close()
        process.wait()
    assert [(int(can_id, 0), int(length)) for can_id, length in lines] == [(0x181, 8), (0x080, 0)]


def test_what_came_just_before_the_bus_went_is_kept(bus, tmp_path, monkeypatch):
    """The frames and the end of the bus in one look: the frames are written, then the end
    is told.
    """
    received = BlockReader._call
    came = []

    def receive(reader):
        if came:
            raise BusGone("it went")
        if count := received(reader):
            came.append(count)
        return count

    monkeypatch.setattr(frame_batches, "MESSAGES", 1)
    monkeypatch.setattr(BlockReader, "_call", receive)
    path = tmp_path / "a.pcapng"
    deliverer = threading.Thread(target=lambda: (greeted(bus), bus.deliver(*SENT)))
    deliverer.start()
    with pytest.raises(BusGone):
        stream(load_rig("bench"), BENCH, str(path))
    deliverer.join(PATIENCE_S)
    assert read(path).frames["can_id"].tolist() == [can_id for can_id, _ in SENT]
