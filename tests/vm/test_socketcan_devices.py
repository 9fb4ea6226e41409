"""`scan`, `lss`, `sdo` and `nmt` on Linux's own CAN, with a device that was not written here:
canopen's LocalNode.
"""

from __future__ import annotations

import json

import canopen
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from places import ROOT
from vm_interfaces import INTERFACES

pytestmark = pytest.mark.real_time

MOTOR = ROOT / "eds" / "motor.eds"
SLOW = ("--timeout", "10")
"""Under emulation everything takes its time."""


@pytest.fixture
def device():
    network = canopen.Network()
    network.connect(interface="socketcan", channel=INTERFACES[-1])
    network.add_node(canopen.LocalNode(5, str(MOTOR)))
    try:
        yield
    finally:
        network.disconnect()


def test_a_device_is_found_read_configured_and_started(device, interface, tmp_path):
    bus = ("--bus", f"socketcan:{interface}")

    def told(*words):
        result = CliRunner().invoke(main, [*map(str, words), *bus, "--json"])
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    (found,) = told("scan")["nodes"]
    assert (found["node_id"], found["device_type"], found["vendor_id"]) == (5, 0x20192, 0x4C0)
    assert told("lss")["unconfigured"] == []
    assert told("sdo", "set", 5, "1017h", 100, *SLOW)["raw"] == 100
    dcf = tmp_path / "motor.dcf"
    assert told("sdo", "dump", 5, dcf, *SLOW)["values"] > 100
    assert told("sdo", "set", 5, "1017h", 200, *SLOW)["value"] == 200
    assert told("sdo", "restore", 5, dcf, "--yes", *SLOW)["written"] == 1
    assert told("sdo", "get", 5, "1017h", *SLOW)["raw"] == 100
    assert told("nmt", "start", 5, *SLOW)["nodes"] == [{"node_id": 5, "state": "OPERATIONAL", "followed": True}]
