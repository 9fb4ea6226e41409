"""On a system that is no Linux: what needs no live bus works, all else says so in one sentence."""

from __future__ import annotations

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
seconds = 0.5
seed = 1
design = "sobol"
runs = 2

[vary]
plant.brake_gain = { low = 0.9, high = 1.1 }
"""


def elsewhere(line, folder):
    command = [sys.executable, str(ROOT / "tests" / "support" / "elsewhere.py"), *shlex.split(line)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600, check=False
    )


def test_what_needs_no_live_bus_works_everywhere(tmp_path):
    (tmp_path / "still.toml").write_text(SWEEP)
    for line in (
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
    ):
        done = elsewhere(line, tmp_path)
        assert done.returncode == 0, f"{line}: {done.returncode} {done.stderr}"


@pytest.mark.parametrize(
    "line",
    [
        "sim --bus coulombus:elsewhere",
        "run --bus coulombus:elsewhere --mode passive",
        "watch --bus coulombus:elsewhere",
        "scan --bus socketcan:can0",
        "doctor",
    ],
)
def test_what_needs_one_says_that_it_needs_linux(line, tmp_path):
    done = elsewhere(line, tmp_path)
    assert done.returncode == 4, done.stderr
    (message,) = done.stderr.splitlines()
    assert "this needs Linux (there is no " in message
