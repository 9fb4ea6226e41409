"""``coulombus bridge`` between a virtual bus of ours and an interface of Linux."""

from __future__ import annotations

import json
import signal
import socket
import struct
import subprocess

import pytest

from coulombus.wire.address import parse_address
from coulombus.wire.client import Client, pack_frame
from places import ROOT
from tiny_bus import tiny_bus
from warm_start import Warm

pytestmark = pytest.mark.real_time

FRAME = struct.Struct("=IB3x8s")
TIMEOUT_S = 60.0


def test_both_ways_and_nothing_goes_round(tmp_path, monkeypatch, interface):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with tiny_bus("ours") as bus, socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        exact = struct.pack("=IIII", 0x123, 0xC00007FF, 0x80000005, 0xDFFFFFFF)  # whatever else is on it
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, exact)
        raw.bind((interface,))
        raw.settimeout(TIMEOUT_S)
        command = ["bridge", "coulombus:ours", f"socketcan:{interface}", "--json", "--ids", "100-1FF,00000005"]
        process = Warm(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        try:
            assert json.loads(process.stdout.readline())["event"] == "ready"
            with Client(parse_address("coulombus:ours")) as client:
                client.send(pack_frame(0x200) + pack_frame(0x123, b"there") + pack_frame(0x80000005, b"far"))
                assert FRAME.unpack(raw.recv(16)) == (0x123, 5, b"there".ljust(8, b"\0"))
                assert FRAME.unpack(raw.recv(16)) == (0x80000005, 3, b"far".ljust(8, b"\0"))
                raw.send(FRAME.pack(0x124, 4, b"back".ljust(8, b"\0")))
                assert client.wait(TIMEOUT_S)
                assert [one[1:] for one in client.receive()] == [(0x124, 4, b"back".ljust(8, b"\0"))]
            process.send_signal(signal.SIGTERM)
            out, _ = process.communicate(timeout=TIMEOUT_S)
        finally:
            process.kill()
        assert process.returncode == 0
        ways = json.loads(out)["ways"]
        assert ways["coulombus:ours -> socketcan:" + interface]["forwarded"] == 2
        assert ways["socketcan:" + interface + " -> coulombus:ours"]["forwarded"] == 1
        assert len(bus.frames) == 4
