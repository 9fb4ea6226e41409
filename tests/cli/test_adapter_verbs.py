"""The verbs of services and of listening over adapters of python-can, to a node of another implementation at the far
end of the bus.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from contextlib import contextmanager

import can
import canopen
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from far_ends import ADAPTERS, far_end
from places import EDS, ROOT

pytestmark = [pytest.mark.real_time, pytest.mark.patient, pytest.mark.slow, pytest.mark.usefixtures("private_sockets")]

NODE = 5
SYSTEM = ROOT / "tests" / "support" / "elsewhere.py"


@contextmanager
def node(interface):
    """Yield the address of an adapter with node 5 at the far end, which sends a SYNC and a PDO now and then."""
    with far_end(interface) as (text, far):
        network = canopen.Network(far)
        network.connect()
        made = network.create_node(NODE, str(EDS / "motor.eds"))
        tasks = [
            far.send_periodic(can.Message(arbitration_id=can_id, is_extended_id=False, data=data), 0.02)
            for can_id, data in ((0x181, bytes(8)), (0x700 + NODE, b"\x7f"))
        ]
        made.nmt.state = "PRE-OPERATIONAL"
        try:
            yield text, made
        finally:
            for task in tasks:
                task.stop()
            network.notifier.stop()


def call(*words, status=0):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert "Traceback" not in result.output
    assert result.exit_code == status, result.output
    return result


@pytest.mark.thorough
@pytest.mark.parametrize("interface", ADAPTERS)
def test_every_verb_of_services_and_of_listening_takes_an_adapter(interface, tmp_path):
    with node(interface) as (text, device):
        (found,) = json.loads(call("scan", "--bus", text, "--no-lss", "--json").stdout)["nodes"]
        assert (found["node_id"], found["vendor_id"], found["state"]) == (NODE, 0x4C0, "PRE_OPERATIONAL")
        assert found["eds"].endswith("motor.eds")
        bus = ("--bus", text)
        call("sdo", "set", NODE, "1017", 1000, *bus)
        assert device.sdo["Producer heartbeat time"].raw == 1000
        assert json.loads(call("sdo", "get", NODE, "1017", *bus, "--json").stdout)["value"] == 1000
        call("nmt", "start", NODE, *bus)
        assert device.nmt.state == "OPERATIONAL"
        assert json.loads(call("lss", *bus, "--json").stdout)["unconfigured"] == []
        listened = json.loads(call("hz", *bus, "--seconds", 0.5, "--json").stdout)
        assert {row["can_id"] for row in listened["identifiers"]} >= {0x181, 0x700 + NODE}
        assert "python-can" in listened["stamps"]
        line = json.loads(call("watch", *bus, "--seconds", 0.5, "--json").stdout.splitlines()[-1])
        assert line["bus"] == text.partition("?")[0]
        assert line["lost"] == 0
        explained = json.loads(call("explain", *bus, "--seconds", 0.5, "--json").stdout)
        assert explained["frames"] > 10
        call("watch", *bus, "--seconds", 0.5, "--pcapng", tmp_path / "run.pcapng")
        assert "705" in call("decode", tmp_path / "run.pcapng").stdout
        pdos = json.loads(call("pdo", *bus, "--seconds", 0.5, "--json").stdout)
        assert [pdo["now"]["data"] for pdo in pdos if pdo["can_id"] == 0x181] == [16 * "0"]
        report = json.loads(
            call(
                "conformance", *bus, "--node", NODE, "--eds", EDS / "motor.eds", "--case", "2.1", "--json", "--force"
            ).stdout
        )
        assert report["cases"][0]["result"] == "pass"


def test_options_of_the_adapter_come_from_the_command_line_too():
    with node("slcan") as (text, _):
        name, _, options = text.partition("?")
        words = [word for pair in options.split("&") for word in ("--bus-option", pair)]
        found = json.loads(call("scan", "--bus", name, *words, "--no-lss", "--json").stdout)["nodes"]
        assert [each["node_id"] for each in found] == [NODE]


def test_a_node_is_served_over_an_adapter_until_that_is_gone():
    with far_end("slcan") as (text, far):
        command = [sys.executable, "-m", "coulombus", "node", str(EDS / "motor.eds"), "--node-id", "7", "--json"]
        process = subprocess.Popen([*command, "--bus", text], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        ready = json.loads(process.stdout.readline())
        assert (ready["event"], ready["bus"], ready["serves_bus"]) == ("ready", text.partition("?")[0], False)
        network = canopen.Network(far)
        network.connect()
        node = network.add_node(7, str(EDS / "motor.eds"))
        assert node.sdo["Device type"].raw == 0x20192
        node.sdo["Producer heartbeat time"].raw = 10
        node.nmt.state = "OPERATIONAL"
        node.nmt.wait_for_heartbeat(20)
        network.notifier.stop()
    _, err = process.communicate(timeout=60)  # the adapter has gone with its block
    assert process.returncode == 4
    assert b"bus can:slcan:" in err
    assert b" is gone: " in err


def test_our_own_plugin_is_an_adapter_too(bus):
    result = call("scan", "--bus", "can:coulombus:bench", "--no-lss", "--timeout", 0.05, status=5)
    assert "no node on can:coulombus:bench answers" in result.stderr
    assert [can_id for can_id, _, _ in bus.frames] == [0x600 + node_id for node_id in range(1, 128)]


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ("run --bus can:virtual:x", 2, "a control cycle of 1 ms needs a bus of known latency"),
        ("emulate --bus can:virtual:x", 2, "a control cycle of 1 ms needs a bus of known latency"),
        ("set --bus can:virtual:x F_s_Nm=1", 2, "a control cycle of 1 ms needs a bus of known latency"),
        ("measure --bus can:virtual:x", 2, "a control cycle of 1 ms needs a bus of known latency"),
        ("scan --bus can:pcam:x", 4, "did you mean can:pcan:x?"),
        ("watch --bus can:slcan:/dev/no-such-port", 4, "is the channel right"),
        ("scan --bus can:", 2, "expected can:INTERFACE:CHANNEL"),
        ("scan --bus socketcand:127.0.0.1:1", 2, "can:socketcand:CHANNEL --bus-option host=HOST"),
        ("scan --bus can:virtual:x --bus-option bitrate", 2, "expected KEY=VALUE"),
        ("hz --bus coulombus:bench --bus-option bitrate=5", 2, "is of an adapter of python-can"),
        ("hz --bus-option bitrate=5", 2, "is of an adapter of python-can"),
        ("scan --bitrates --bus can:virtual:x", 2, "--bus-option bitrate=250000"),
    ],
)
def test_what_is_refused_says_why(words, status, said):
    assert said in " ".join(call(*words.split(), status=status).output.split())


@pytest.mark.thorough
def test_on_a_system_that_is_no_linux_they_work_over_an_adapter(tmp_path):
    with node("socketcand") as (text, _):
        lines = (
            f"scan --bus {text} --no-lss",
            f"sdo get {NODE} 1018:1 --bus {text}",
            f"watch --bus {text} --seconds 0.5",
            f"watch --bus {text} --seconds 0.5 --pcapng run.pcapng",
            f"hz --bus {text} --seconds 0.2",
            f"explain --bus {text} --seconds 0.2",
        )
        command = [sys.executable, str(SYSTEM), *lines]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, timeout=600, check=True)
        ends = dict(zip(lines, map(json.loads, done.stdout.splitlines()), strict=True))
        assert {line: end for line, end in ends.items() if end["status"]} == {}
        assert threading.active_count() > 1  # the far end was in this process
