"""`coulombus node --io`: a node on converters that are files, alive; what ends it leaves them safe."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import struct
import subprocess
import sys

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.wire.address import BusAddress
from coulombus.wire.handshake import connect
from fake_sysfs import BRAKE_IO, FakeSysfs
from places import ROOT

BRAKE, MOTOR = ROOT / "eds" / "mr_brake.eds", ROOT / "eds" / "motor.eds"
FRAME = struct.Struct("=IB3x8s")
SAFE, TIMEOUT_S, RESETS = 10, 60.0, 5


def wait_for(sysfs, count):
    """Wait until the DAC has a count; another process writes it."""
    beat = select.poll()
    for _ in range(int(TIMEOUT_S * 100)):
        if sysfs.get("dac/out_voltage0_raw") == str(count):
            return
        beat.poll(10)
    raise AssertionError(f"the DAC stands at {sysfs.dac}, expected {count}")


def write(bus, index, subindex, value, size):
    """Write an object of node 2 by SDO, and wait for the answer."""
    command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
    bus.send(FRAME.pack(0x602, 8, struct.pack("<BHBI", command, index, subindex, value)))
    answer = struct.pack("<BHB4x", 0x60, index, subindex)
    while not any(can_id == 0x582 and data == answer for can_id, _, data in FRAME.iter_unpack(bus.recv(1 << 16))):
        pass


@pytest.mark.real_time
@pytest.mark.patient
@pytest.mark.usefixtures("private_sockets")
def test_a_node_that_is_stopped_or_killed_has_a_safe_output(tmp_path):
    sysfs = FakeSysfs(tmp_path)
    io_file = sysfs.io_file(BRAKE_IO.replace("0.001", "0.005\nwatchdog_s = 1.0").replace("coil_A_Nm = 0.3", ""))
    words = ["node", str(BRAKE), "--node-id", "2", "--bus", "coulombus:io", "--io", str(io_file), "--json"]
    node = subprocess.Popen(
        [sys.executable, "-m", "coulombus", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert json.loads(node.stdout.readline())["event"] == "ready"
        assert sysfs.dac == SAFE
        with contextlib.closing(connect(BusAddress("coulombus", "io"))) as bus:
            bus.settimeout(TIMEOUT_S)

            def put_out(setpoint):
                bus.send(FRAME.pack(0x000, 2, b"\x01\x02"))
                write(bus, 0x2001, 0, 0, 4)  # a set-point stays
                write(bus, 0x7300, 1, setpoint, 2)

            put_out(2500)
            wait_for(sysfs, SAFE + 2000)
            node.send_signal(signal.SIGSTOP)  # it stands still: its watchdog acts
            wait_for(sysfs, SAFE)
            node.send_signal(signal.SIGCONT)
            line = json.loads(node.stdout.readline())
            assert (line["event"], line["ok"]) == ("hardware", False)
            assert "hung for" in line["text"]
            for _ in range(RESETS):  # a busy machine may let it stand still again
                bus.send(FRAME.pack(0x000, 2, b"\x81\x02"))
                line = json.loads(node.stdout.readline())
                if line["ok"]:
                    break
                assert "hung for" in line["text"]
            assert (line["event"], line["ok"]) == ("hardware", True)
            put_out(1250)
            wait_for(sysfs, SAFE + 1000)
            os.kill(node.pid, signal.SIGKILL)
            wait_for(sysfs, SAFE)
    finally:
        node.kill()
        node.communicate()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("safe = 0.0", "safe = 9.0"), "io.toml:17: output.0.safe: got '9.0', expected 0 to 4, the limits"),
        (("/dac", "/dax"), "dax: folder not found"),
        (("out_voltage0", "out_voltage7"), "it has no channel 'out_voltage7'; it has out_voltage0"),
        (("in_voltage1", "in_voltage9"), "it has no channel 'in_voltage9'; it has in_voltage0, in_voltage1"),
    ],
)
def test_a_file_or_a_converter_that_does_not_fit_is_refused(tmp_path, private_sockets, change, told):
    path = FakeSysfs(tmp_path).io_file(BRAKE_IO.replace(*change))
    result = CliRunner().invoke(
        main, ["node", str(BRAKE), "--node-id", "2", "--bus", "coulombus:io", "--io", str(path)]
    )
    assert result.exit_code == 3
    assert told in result.output


def test_one_file_is_for_one_node(tmp_path, private_sockets):
    path = FakeSysfs(tmp_path).io_file()
    words = ["node", str(BRAKE), str(MOTOR), "--node-id", "2", "--node-id", "1", "--bus", "coulombus:io"]
    result = CliRunner().invoke(main, [*words, "--io", str(path)])
    assert result.exit_code == 2
    assert "one file is for one node" in result.output
