"""Calls of the C library fail in the compiled loops, each once: the data plane ends safe, the bus
ends as documented and leaves nothing.

The calls fail in a process of their own, into which tests/support/libc_shim.c is preloaded;
tests/support/libc_faults.py is what runs there.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys

import pytest

from coulombus.kernels.decorator import JIT_DISABLED
from places import ROOT

SUPPORT = ROOT / "tests" / "support"
COMPILER = shutil.which("gcc") or shutil.which("cc")

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
    pytest.mark.skipif(COMPILER is None, reason="no C compiler"),
    pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the shim takes malloc by glibc's names"),
]


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    path = tmp_path_factory.mktemp("shim") / "shim.so"
    source = str(SUPPORT / "libc_shim.c")
    subprocess.run([COMPILER, "-O1", "-shared", "-fPIC", "-Wall", "-Werror", "-o", path, source, "-ldl"], check=True)
    return path


def faults(shim, which, numbers):
    """Return the lines of the process: what each fault came to."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore::ResourceWarning", str(SUPPORT / "libc_faults.py"), which, str(numbers)],
        cwd=ROOT,
        env={**os.environ, "LD_PRELOAD": str(shim), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=3600,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.parametrize(("which", "few", "many"), [("plane", 3, 12), ("sim", 2, 40)])
def test_whatever_call_of_a_compiled_loop_fails_the_end_is_safe(shim, pytestconfig, which, few, many):
    if which == "sim" and not pytestconfig.getoption("--every-fault"):
        pytest.skip("with --every-fault only: each case builds a world")
    found = faults(shim, which, many if pytestconfig.getoption("--every-fault") else few)
    cases = [one for one in found if "case" in one]
    assert sum(one["came"] for one in cases) > len(cases) / 2
    assert {tuple(one["case"]): one["wrong"] for one in cases if one["wrong"]} == {}
