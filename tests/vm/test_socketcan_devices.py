"""`scan`, `sdo` and `nmt` on Linux's own CAN."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.verbs.main import main

pytestmark = pytest.mark.real_time


def told(*words):
    result = CliRunner().invoke(main, [*map(str, words), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_devices_are_found_read_written_and_reset(start_sim, interface):
    start_sim()
    bus = ("--bus", f"socketcan:{interface}")
    slow = ("--timeout", 10)  # under emulation everything takes its time
    nodes = {one["node_id"]: one for one in told("scan", *bus)["nodes"]}
    assert [nodes[k]["device_type"] for k in (1, 2)] == [0x20192, 0xA0194]
    assert told("sdo", "set", 1, "1017h", 200, *bus, *slow)["raw"] == 200
    assert told("sdo", "get", 1, "1017h", *bus, *slow)["value"] == 200
    assert told("nmt", "reset", 1, *bus, *slow)["nodes"][0]["followed"]
