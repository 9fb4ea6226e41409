"""``coulombus run`` on an interface of Linux, and what is seen beside it."""

from __future__ import annotations

import json
import struct
import subprocess
import time
from contextlib import contextmanager

from coulombus.wire.address import parse_address
from coulombus.wire.client import Client
from coulombus.wire.hello import Hello
from vm_interfaces import ROOT
from warm_start import Warm

PATIENCE_S = 300


@contextmanager
def running(interface, *arguments, mode, seconds):
    process = Warm(
        [
            *("run", "--bus", f"socketcan:{interface}", "--mode", mode, "--json"),
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
    out, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, json.loads(out) if out.strip() else None, err


@contextmanager
def observer(interface):
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
    return can_id == 0x181 and data[0] & 0x6F == 0x27


def emergencies(client):
    """Wait until motor and brake have told of an error; return the codes by identifier."""
    told = {}

    def emergency(can_id, data):
        if can_id in (0x81, 0x82) and struct.unpack_from("<H", data)[0]:
            told[can_id] = struct.unpack_from("<H", data)[0]
        return len(told) == 2

    until(client, emergency)
    return told
