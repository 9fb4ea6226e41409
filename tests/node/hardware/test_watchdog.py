"""The process that makes outputs safe when the node cannot: at its end, by whatever means, and when
it stands still.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys

import pytest

from coulombus.node.hardware.channels import HardwareError, SafeWrite
from coulombus.node.hardware.watchdog import READY, Guard, carry_out, guard_outputs

NODE = """
import json, os, sys
from coulombus.node.hardware.channels import Claim, SafeWrite
from coulombus.node.hardware.watchdog import Guard
claim = Claim(sys.argv[1])
guard = Guard(float(sys.argv[2]), [SafeWrite(sys.argv[1], "10\\n")], [claim.descriptor])
guard.feed()
with open(sys.argv[1], "w") as file:
    file.write("3000\\n")
print(guard.pid, flush=True)
sys.stdin.read()
"""


@pytest.fixture
def dac(tmp_path):
    path = tmp_path / "out_voltage0_raw"
    path.write_text("4095\n")
    return path


def test_the_end_of_its_input_makes_the_outputs_safe(dac):
    feed, feeding = os.pipe()
    answers, answering = os.pipe()
    os.close(feeding)
    assert guard_outputs(10.0, [[str(dac), "10\n"]], feed, answering) == []
    assert dac.read_text() == "10\n"
    assert os.read(answers, 9) == READY
    for one in (feed, answers, answering):
        os.close(one)


def test_one_output_that_fails_does_not_keep_the_others(dac, tmp_path):
    failed = carry_out([[str(tmp_path / "none"), "0\n"], ["no_module:Board", '{"coil": 0}'], [str(dac), "10\n"]])
    assert [text.partition(":")[2][:20] for text in failed] == [" No such file or dir", "Board: it cannot be "]
    assert dac.read_text() == "10\n"


def test_a_python_class_is_made_anew_to_be_safe(tmp_path):
    kept = tmp_path / "kept"
    source = f"""
from pathlib import Path

class Board:
    def read(self): ...

    def write(self, values):
        Path({str(kept)!r}).write_text(str(values))
"""
    (tmp_path / "board.py").write_text(source)
    assert carry_out([[f"{tmp_path}/board.py:Board", '{"coil": 0.5}']]) == []
    assert kept.read_text() == "{'coil': 0.5}"


def start(dac, watchdog_s):
    words = [sys.executable, "-c", NODE, str(dac), str(watchdog_s)]
    node = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    return node, int(node.stdout.readline())


def wait_for_end(watchdog):
    """Wait until a process that is not ours has ended."""
    try:
        descriptor = os.pidfd_open(watchdog)
    except ProcessLookupError:
        return
    assert select.select([descriptor], [], [], 20.0)[0]
    os.close(descriptor)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_node_leaves_safe_outputs(dac, number):
    node, watchdog = start(dac, 30.0)
    assert dac.read_text() == "3000\n"
    if number != signal.SIGKILL:  # as a terminal sends it to all
        os.kill(watchdog, number)
    node.send_signal(number)
    node.communicate(timeout=20)
    wait_for_end(watchdog)
    assert dac.read_text() == "10\n"


def test_a_node_that_stands_still_is_found_and_told(dac):
    guard = Guard(0.05, [SafeWrite(str(dac), "10\n")])
    guard.feed()
    assert select.select([guard._answers], [], [], 20.0)[0]  # nobody feeds it: it acts
    assert dac.read_text() == "10\n"
    with pytest.raises(HardwareError, match=r"hung for 0.05 s"):
        guard.feed()
    guard.close()


def test_a_watchdog_that_is_gone_is_found():
    guard = Guard(30.0, [])
    guard.feed()
    os.kill(guard.pid, signal.SIGKILL)
    wait_for_end(guard.pid)
    with pytest.raises(HardwareError, match="the watchdog process is gone"):
        guard.feed()
    guard.close()
