"""Tests on Linux's own CAN: `.ci/run` runs them inside a virtual machine whose kernel has it.

COULOMBUS_TEST_CAN names the interface, ``vcan0``, or two on one bus, ``can0,can1``: the nodes are
on the last one, the test (or the host) on the first.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
from pathlib import Path

import pytest

from places import ROOT
from vm_host import on_buses
from vm_interfaces import INTERFACES, MISSING
from warm_start import Warm

READY_S = 300  # under emulation everything takes its time


def pytest_collection_modifyitems(items):
    reason = "COULOMBUS_TEST_CAN names no CAN interface"
    if MISSING:
        reason = f"no interface {', '.join(MISSING)}"
    if not INTERFACES or MISSING:
        for item in items:
            if Path(__file__).parent in item.path.parents:
                item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def interface():
    """Return the interface of the host, or of the test itself."""
    return INTERFACES[0]


class Sim:
    """``coulombus emulate`` on an interface; `end` ends it and returns what it told."""

    def __init__(self, interface, *options, buses=()):
        self.interface = interface
        self.process = Warm(
            ["emulate", *on_buses(interface, buses), "--json", *options],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.process.stderr.read()
        self.ready = json.loads(line)

    def end(self):
        """Ask for the end; return the last line's values and the exit status."""
        self.process.terminate()
        return self.wait()

    def wait(self):
        out, self.told = self.process.communicate(timeout=READY_S)
        return json.loads(out.splitlines()[-1]), self.process.returncode


@pytest.fixture(scope="module")
def start_sim():
    """Return a function that starts a sim on the nodes' interface (or a given one).

    What still runs after the module is killed.
    """
    with contextlib.ExitStack() as stack:

        def start(*options, interface=None, buses=()):
            sim = Sim(interface or INTERFACES[-1], *options, buses=buses)
            stack.callback(lambda: (sim.process.kill(), sim.process.communicate()))
            return sim

        yield start
