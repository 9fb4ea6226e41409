"""Real-time rights: granted ones are in force, refused ones say what would grant them."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from coulombus.system.realtime import RealTime, Right, set_timer_slack
from places import ROOT

pytestmark = pytest.mark.real_time


def python(code):
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_what_is_granted_is_in_force():
    code = """
        import os, resource
        from coulombus.system.realtime import ask_for_real_time
        cpu = min(os.sched_getaffinity(0))
        given = {r.name: r.granted for r in ask_for_real_time(5, cpu).rights}
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        assert (policy == os.SCHED_FIFO) == given["SCHED_FIFO"]
        assert (os.sched_getaffinity(0) == {cpu}) == given[f"CPU {cpu}"]
        locked = int(next(l for l in open("/proc/self/status") if l.startswith("VmLck")).split()[1])
        assert (locked > 0) == given["locked memory"]
        assert open("/proc/self/timerslack_ns").read().strip() in ("0", "1")  # 0: SCHED_FIFO
        print(*sorted(given))
    """
    assert "SCHED_FIFO" in python(code)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give up its rights")
def test_a_plain_user_is_refused_and_told_the_command():
    code = """
        import os, resource
        from coulombus.system.realtime import ask_for_real_time
        resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        os.setuid(65534)
        refused = ask_for_real_time(5).refused
        for right in refused:
            assert right.remedy in str(right) and "refused" in str(right)
        print(*(r.name.replace(" ", "_") for r in refused))
    """
    refused = python(code)
    assert {"SCHED_FIFO", "locked_memory"} <= set(refused)


def test_a_child_ends_with_its_parent():
    child = (
        "import os, sys, time; from coulombus.system.realtime import die_with_parent; die_with_parent(int(sys.argv[1])); "
        "print(os.getpid(), flush=True); time.sleep(60)"
    )
    parent = f"import os, subprocess, sys; subprocess.Popen([sys.executable, '-c', {child!r}, str(os.getpid())]); sys.stdin.read()"
    process = subprocess.Popen(
        [sys.executable, "-c", parent], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    pid = int(process.stdout.readline())
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 10
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not alive(pid)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def test_the_report_as_values():
    report = RealTime((Right("a", True), Right("b", False, "no", "sudo b")))
    assert [right.name for right in report.refused] == ["b"]
    assert report.as_dict()[1] == {"name": "b", "granted": False, "detail": "no", "remedy": "sudo b"}
    assert set_timer_slack().granted
