"""Clients that were not written here against our nodes on the real-time virtual bus: function,
never speed.
"""

from __future__ import annotations

import subprocess
import sys
import threading

import can
import canopen
import pytest

import canopen_clients
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.wire.address import parse_address

pytestmark = [pytest.mark.real_time, pytest.mark.patient]


@pytest.fixture(scope="module", autouse=True)
def server(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
        server = SimServer(load_rig("bench"), parse_address("coulombus:bench"))
        ready = threading.Event()
        thread = threading.Thread(target=server.run, kwargs={"ready": ready.set})
        thread.start()
        assert ready.wait(10)
        yield server
        server.stop()
        thread.join(10)
        server.close()
        assert not thread.is_alive()


@pytest.fixture
def network():
    network = canopen.Network()
    network.connect(interface="coulombus", channel="bench")
    yield network
    network.disconnect()


@pytest.mark.parametrize("use", ["transfers", "pdos", "drive", "layer_setting"])
def test_canopen(network, use):
    getattr(canopen_clients, use)(network)


def tool(name, *arguments):
    command = [sys.executable, "-u", "-m", name, "-i", "coulombus", "-c", "bench", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def line_with(process, text):
    """Read the tool's lines up to one that holds `text`."""
    lines = []
    for line in process.stdout:
        lines.append(line)
        if text in line:
            return line
    raise AssertionError("".join(lines))


def test_python_can_s_player_plays_and_its_logger_shows(tmp_path):
    record = tmp_path / "three.log"
    record.write_text("".join(f"(0.00{k}000) can0 123#0{k}02\n" for k in (1, 2, 3)))
    logger = tool("can.logger")
    try:
        line_with(logger, "Connected to CoulombusBus")
        player = tool("can.player", str(record))
        player.communicate(timeout=60)
        assert player.returncode == 0
        for k in (1, 2, 3):
            assert f"0{k} 02" in line_with(logger, "123  ")
    finally:
        logger.kill()
        logger.communicate()


def test_python_can_s_notifier_hears_a_node():
    with can.Bus(interface="coulombus", channel="bench") as bus:
        heard = can.BufferedReader()
        notifier = can.Notifier(bus, [heard])
        bus.send(can.Message(arbitration_id=0x601, data=b"\x40\x00\x10\x00\x00\x00\x00\x00", is_extended_id=False))
        answer = heard.get_message(60)
        notifier.stop()
    assert (answer.arbitration_id, bytes(answer.data)) == (0x581, b"\x43\x00\x10\x00\x92\x01\x02\x00")
