"""``coulombus run`` on a CAN interface, and who looks on: for the tests in tests/vm."""

from __future__ import annotations

import json
import os
import subprocess
import time
from contextlib import contextmanager

import pytest

from coulombus.wire.address import parse_address
from coulombus.wire.client import Client
from coulombus.wire.handshake import Hello
from places import ROOT
from warm_start import Warm

PATIENCE_S = 300
NO_SWITCH = ("--set", 'host.deadman="none"')
"""No hand is on a simulated handle."""
STEADY = pytest.mark.skipif(
    os.environ.get("COULOMBUS_TEST_STEADY") != "1", reason="this machine's clock is not steady (COULOMBUS_TEST_STEADY)"
)


def on_buses(interface, buses=()):
    """Return the options for one interface, or for a rig of several buses: ``a=socketcan:vcan0``."""
    return [word for bus in buses or [f"socketcan:{interface}"] for word in ("--bus", bus)]


@contextmanager
def host(interface, *arguments, mode="passive", seconds=2.0, buses=()):
    """Run the host on `interface`, or on the buses of an arm; kill it if it is still there at the end."""
    process = Warm(
        [
            *("run", *on_buses(interface, buses), "--mode", mode, "--json"),
            *("--seconds", str(seconds), *map(str, arguments)),
        ],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def result(process):
    """Return exit status, what was printed as JSON, and the text on stderr."""
    out, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, json.loads(out) if out.strip() else None, err


@contextmanager
def observer(interface):
    """Open a client of the interface, which hears all."""
    with Client(parse_address(f"socketcan:{interface}"), Hello()) as client:
        yield client


def until(client, condition, run=None):
    """Read until `condition(can_id, data)` holds for a frame; return its stamp [s].

    A `run` that ends before says what came of it.
    """
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        assert run is None or run.poll() is None, result(run)
        client.wait(0.1)
        for stamp, can_id, length, data in client.receive():
            if condition(can_id, data[:length]):
                return stamp * 1e-9
    raise AssertionError("it did not come")


def enabled(can_id, data):
    """Tell whether a frame says that the drive is in Operation Enabled."""
    return can_id == 0x181 and data[0] & 0x6F == 0x27
