"""A device of one's own: the example as it stands passes the conformance run; call-backs."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from coulombus import Device
from coulombus.sim_bus.server.own_device import MOST_WAITING
from places import ROOT

EXAMPLE, EDS = ROOT / "examples" / "own_device.py", ROOT / "examples" / "own_device.eds"
TIMEOUT_S = 300.0


class Server:
    """The bus' end of a device, in virtual time: the present is the world's."""

    def __init__(self, device):
        self.world = device._nodes.make_world(1_000_000, trial=False)
        self.tester = self.world.station({0x185, 0x585})
        device._begin(self)
        self.device = device
        self.world.power_on()

    def now_ns(self):
        return self.world.t_ns

    def pass_ms(self, milliseconds):
        self.world.wait_ns(milliseconds * 1_000_000)
        while not self.device._calls.empty():  # what the call-backs' thread does
            self.device._carry_out(self.device._calls.get())

    def write_lamp(self, value):
        self.tester.send(0x605, bytes.fromhex("2F006201") + value.to_bytes(4, "little"))
        self.pass_ms(25)


@pytest.fixture
def device():
    return Device(EDS, node_id=5)


def test_a_call_back_gets_what_an_sdo_and_a_pdo_have_written(device):
    values = []
    device.written("6200:01")(values.append)
    server = Server(device)
    server.write_lamp(1)
    assert values == [1]
    server.tester.send(0x000, b"\x01\x05")
    server.tester.send(0x205, b"\x07")
    server.pass_ms(25)
    assert values == [1, 7]
    server.tester.send(0x205, b"\x07")  # the same again is written, too
    server.pass_ms(25)
    assert values == [1, 7, 7]
    assert device["Lamp"] == 7


def test_a_synchronous_pdo_is_told_when_it_acts(device):
    values = []
    device.written("6200:01")(values.append)
    server = Server(device)
    server.tester.send(0x605, bytes.fromhex("2F00140201000000"))  # 1400h:02 = 1
    server.tester.send(0x000, b"\x01\x05")
    server.pass_ms(25)
    server.tester.send(0x205, b"\x03")
    server.pass_ms(25)
    assert values == []
    server.tester.send(0x080)
    server.pass_ms(25)
    assert values == [3]


def test_a_value_that_is_set_goes_out_with_the_next_pdo(device):
    calls = []

    @device.sync
    def measure():
        calls.append(1)
        device["Temperature"] = -2150

    server = Server(device)
    server.tester.send(0x000, b"\x01\x05")
    for _ in range(2):
        server.tester.send(0x080)
        server.pass_ms(25)  # the call-back is called ...
        server.pass_ms(25)  # ... and its value is taken over
    assert [frame.data for frame in server.tester.take(0x185)] == [
        b"\0\0",
        (-2150).to_bytes(2, "little", signed=True),
    ]
    assert len(calls) == 2
    assert device["6401:01"] == -2150


def test_a_call_back_that_raises_is_told_and_the_device_goes_on(device, capsys):
    values = []

    @device.written("Lamp")
    def fails(value):
        values.append(value)
        raise RuntimeError("the lamp is broken")

    server = Server(device)
    server.write_lamp(1)
    server.write_lamp(0)
    assert values == [1, 0]
    assert capsys.readouterr().err.count("RuntimeError: the lamp is broken") == 2


def test_call_backs_that_do_not_keep_up_are_left_out_and_counted(device):
    for _ in range(MOST_WAITING + 5):
        device._call(lambda: None)
    assert device.missed == 5


def test_what_an_object_does_not_hold_is_refused(device):
    with pytest.raises(KeyError, match="did you mean 'Lamp'"):
        device.written("Lanp")
    with pytest.raises(ValueError, match="got 40000, expected -32768 to 32767"):
        device["6401:01"] = 40000
    with pytest.raises(TypeError, match="expected an integer"):
        device["6401:01"] = 21.5
    device["6401:01"] = 21
    assert device["6401:01"] == 21
    assert device["Lamp"] == 0


def test_the_page_shows_the_words_that_there_are(device):
    text = (ROOT / "docs" / "own-device.md").read_text()
    code = re.search(r"```python\n(from coulombus.*?)```", text, re.DOTALL)[1]
    scope = {}
    exec(code.replace("examples/own_device.eds", str(EDS)), scope)
    assert set(scope["device"]._written) == {(0x6200, 1)}
    assert scope["device"]._sync == [scope["measure"]]
    assert len(EXAMPLE.read_text().splitlines()) <= 40


@pytest.mark.thorough
@pytest.mark.real_time
@pytest.mark.patient
def test_the_example_passes_the_conformance_run(private_sockets):
    process = subprocess.Popen(
        [sys.executable, str(EXAMPLE), "coulombus:own"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert "is on bus coulombus:own" in process.stdout.readline()
        words = ["conformance", "--bus", "coulombus:own", "--node", "5", "--eds", str(EDS), "--timeout", "5"]
        done = subprocess.run(
            [sys.executable, "-m", "coulombus", *words], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert done.returncode == 0, done.stdout
        assert ", 0 failed," in done.stdout
    finally:
        process.terminate()
        process.communicate(timeout=60)
    assert process.returncode == 0
