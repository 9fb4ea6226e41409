"""On a system that is no Linux: what needs no live bus works, all else says so in one sentence."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys

import pytest

from places import ROOT

pytestmark = pytest.mark.slow

SWEEP = """
rig = "bench"
mode = "hybrid"
seconds = 0.1
seed = 1
design = "sobol"
runs = 2

[vary]
plant.brake_gain = { low = 0.9, high = 1.1 }
"""


def elsewhere(folder, *lines):
    """Yield each line with the exit status and the stderr of its process."""
    command = [sys.executable, str(ROOT / "tests" / "support" / "elsewhere.py"), *lines]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, timeout=600, check=True)
    for line, end in zip(lines, map(json.loads, done.stdout.splitlines()), strict=True):
        yield line, end["status"], end["stderr"]


@pytest.mark.thorough
def test_what_needs_no_live_bus_works_everywhere(tmp_path):
    (tmp_path / "still.toml").write_text(SWEEP)
    lines = (
        "--version",
        "simulate --seconds 0.3 --record run.pcapng",
        "demo --virtual --out shown",
        "decode run.pcapng",
        "export run.pcapng -o run.csv --to csv",
        "law karnopp --motion sine",
        "sweep still.toml -o swept",
        "analyse nyquist",
        "check",
        f"eds check {shlex.quote(str(ROOT / 'eds' / 'motor.eds'))}",
    )
    assert [(line, err) for line, status, err in elsewhere(tmp_path, *lines) if status != 0] == []


@pytest.mark.thorough
def test_what_needs_one_says_that_it_needs_linux(tmp_path):
    lines = (
        "sim --bus coulombus:elsewhere",
        "run --bus coulombus:elsewhere --mode passive",
        "watch --bus coulombus:elsewhere",
        "scan --bus socketcan:can0",
        "doctor",
    )
    for line, status, err in elsewhere(tmp_path, *lines):
        assert status == 4, f"{line}: {err}"
        (message,) = err.splitlines()
        assert "this needs Linux (there is no " in message, line
