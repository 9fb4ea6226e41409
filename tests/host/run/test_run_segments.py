"""A run that goes on until it is stopped, recorded in segments."""

from __future__ import annotations

import json
import signal
import socket
import time

import pytest

from coulombus.host.run.control_socket import ask_status
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.recording.folders import segments
from coulombus.recording.reading import read
from coulombus.wire.address import parse_address
from real_bench import Observer, end, result, simulation, start

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS = "coulombus:m"


def test_a_run_without_seconds_goes_on_until_it_is_stopped(tmp_path):
    words = ("--record", tmp_path / "runs", "--rotate", "100kB", "--meta", "subject=S01", "--json")
    words += ("--status", tmp_path / "status")
    session = tmp_path / "session.pcapng"
    with simulation(BUS, "--record", session), Observer(BUS) as observer:
        run = start("run", "--bus", BUS, *words)
        try:
            observer.until_enabled(run)
            observer.watch(1.5)
            assert run.poll() is None
            told = ask_status(parse_address(BUS))
            assert told["axes"][0]["phase"] == "run"
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as reader:
                reader.connect(str(tmp_path / "status"))
                with reader.makefile() as file:
                    first, second = (json.loads(file.readline()) for _ in range(2))
            assert told["cycles"] < first["cycles"] < second["cycles"]
            run.send_signal(signal.SIGTERM)
            status, told, err = result(run)
        finally:
            end(run)
    assert (status, told["trip"], told["stopped_by"]) == (143, None, "SIGTERM"), err
    files = segments(tmp_path / "runs")
    assert not (tmp_path / "status").exists()
    assert len(files) >= 3
    assert told["recording"] == str(files[0].parent)
    whole = read(tmp_path / "runs")
    assert whole.markers[-1][1] == "safe"
    assert whole.meta == {"subject": "S01"}
    now = time.time_ns()
    for recording in (whole, read(files[-1]), read(session)):
        assert 0 < now - recording.clock["start_ns"] < 300e9
