"""Tools of can-utils on what this project writes."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.wire.can_flags import CAN_EFF_FLAG
from coulombus.wire.frame import Frame
from places import ROOT
from warm_start import Warm

pytestmark = pytest.mark.real_time

CAN_FRAME = struct.Struct("=IB3x8s")
TIMEOUT_S = 60.0
COUNT = 200


@pytest.mark.skipif(shutil.which("canplayer") is None, reason="no canplayer (Debian: can-utils)")
def test_canplayer_plays_an_exported_log(tmp_path, interface):
    random = np.random.default_rng(5)
    frames = new_records(Frame, COUNT)
    frames["t_ns"] = np.arange(COUNT) * 1_000_000
    frames["can_id"] = np.where(
        random.random(COUNT) < 0.1, 0x12345 | CAN_EFF_FLAG, random.integers(0x100, 0x700, COUNT)
    )
    frames["length"] = random.integers(0, 9, COUNT)
    for frame in frames:
        frame["word"] = int.from_bytes(random.bytes(int(frame["length"])), "little", signed=frame["length"] == 8)
    with PcapngWriter(tmp_path / "run.pcapng", attachments={}) as writer:
        writer.write(frames)
    command = [
        "export",
        str(tmp_path / "run.pcapng"),
        "--to",
        "candump",
        "--rig",
        "bench",
        "-o",
        str(tmp_path / "run.log"),
    ]
    exported = Warm(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    _, told = exported.communicate(timeout=TIMEOUT_S)
    assert exported.returncode == 0, told
    name = (tmp_path / "run.log").read_text().split()[1]
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        raw.bind((interface,))
        raw.settimeout(TIMEOUT_S)
        subprocess.run(["canplayer", "-I", tmp_path / "run.log", f"{interface}={name}"], check=True, timeout=TIMEOUT_S)
        played = [CAN_FRAME.unpack(raw.recv(16)) for _ in range(COUNT)]
    expected = [(int(f["can_id"]), int(f["length"]), int(f["word"]).to_bytes(8, "little", signed=True)) for f in frames]
    assert played == expected
