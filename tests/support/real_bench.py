"""A bench in real time: ``coulombus emulate`` and ``coulombus run`` as processes on a bus of their own,
and an observer that counts for itself.
"""

from __future__ import annotations

import json
import select
import struct
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from coulombus.rigs.overrides import SHARED_MACHINE
from coulombus.wire.address import parse_address
from coulombus.wire.client import BusUnavailable, Client, pack_frame
from coulombus.wire.handshake import Hello
from places import ROOT
from warm_start import InBackground, Warm

PATIENCE_S = 240  # never reached where all is well; the first start compiles
REST = '{kind = "rest", duration_s = 1.0}'
HOLD = f"""[{REST}, {{kind = "hold", duration_s = 20.0, push_F_s = 0.6, frequency_Hz = 0.5, \
taps_s = [0.2, 0.5], tap_Nm = 0.6, tap_s = 0.01}}]"""
STROKE = f"""[{REST}, {{kind = "stroke", duration_s = 20.0, speed_rad_s = 2.0, move_s = 1.0, dwell_s = 1.0}}]"""


def words(verb, *arguments, overrides=()):
    """Return what stands behind ``coulombus``."""
    sets = [part for text in (*SHARED_MACHINE, *overrides) for part in ("--set", text)]
    return [verb, *map(str, arguments), *(sets if verb in ("run", "emulate") else ())]


def command(verb, *arguments, overrides=()):
    """Return the whole command, as a shell starts it."""
    return [sys.executable, "-m", "coulombus", *words(verb, *arguments, overrides=overrides)]


def start(verb, *arguments, overrides=(), background=False, **options):
    """Start a command; with `background` as a shell's job that goes on behind the prompt."""
    cold = "preexec_fn" in options  # what is forked from a process that runs already cannot have one
    kind = subprocess.Popen if cold else InBackground if background else Warm
    return kind(
        (command if cold else words)(verb, *arguments, overrides=overrides),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


@contextmanager
def simulation(bus, *arguments, overrides=(), mode="hybrid"):
    """A ``coulombus emulate`` that is ready; killed at the end if it still lives."""
    process = start("emulate", "--bus", bus, "--mode", mode, "--json", *arguments, overrides=overrides)
    try:
        ready, _, _ = select.select([process.stdout], [], [], PATIENCE_S)
        line = process.stdout.readline() if ready else ""
        if not line:
            process.kill()
            raise AssertionError(process.communicate()[1])
        assert json.loads(line)["event"] == "ready"
        yield process
    finally:
        end(process)


@contextmanager
def host(bus, *arguments, overrides=(), mode="hybrid", seconds=30, **options):
    """A ``coulombus run``; killed at the end if it still lives."""
    process = start(
        "run",
        *("--bus", bus, "--mode", mode, "--seconds", seconds, "--json", *arguments),
        overrides=overrides,
        **options,
    )
    try:
        yield process
    finally:
        end(process)


def end(process):
    if process.poll() is None:
        process.kill()
    process.communicate()


def result(process):
    """Wait for a host's end.

    Return its exit status, what it printed as JSON (None: nothing), and its stderr.
    """
    out, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, json.loads(out) if out.strip() else None, err


def children(pid):
    """Process ids of the children of a process."""
    found = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(text) for text in found.read_text().split()] if found.exists() else []


def gone(pid):
    """Whether a process has ended (a zombie has)."""
    with suppress(OSError, IndexError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    return True


class Observer:
    """A client of the bus with a log: (stamp [s], can_id, data)."""

    def __init__(self, bus):
        self.client = Client(parse_address(bus), Hello())
        self.log = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.client.close()

    def look(self, timeout_s=0.0):
        """Take what has come; return the new part of the log."""
        before = len(self.log)
        if timeout_s:
            self.client.wait(timeout_s)
        with suppress(BusUnavailable):
            while True:
                found = self.client.receive()
                if not found:
                    break
                self.log += [(stamp * 1e-9, can_id, data[:length]) for stamp, can_id, length, data in found]
        return self.log[before:]

    def until(self, run, condition, seconds=PATIENCE_S):
        """Look until `condition(can_id, data)` holds for a frame; return its stamp [s].

        A `run` that ends before says what came of it.
        """
        deadline = time.monotonic() + seconds
        ended = False
        while time.monotonic() < deadline and not ended:
            ended = run is not None and run.poll() is not None  # before the look: what it sent last counts
            for stamp, can_id, data in self.look(0.05):
                if condition(can_id, data):
                    return stamp
        raise AssertionError(f"it did not come; the host ended with {result(run)}" if ended else "it did not come")

    def until_enabled(self, run):
        """Look until the drive's statusword (TPDO1) says Operation Enabled."""
        return self.until(run, lambda can_id, data: can_id == 0x181 and data[0] & 0x6F == 0x27)

    def until_cycling(self, run):
        """Look until the host sends SYNC."""
        return self.until(run, lambda can_id, data: can_id == 0x080)

    def watch(self, seconds):
        """Look for so long, on the stamps' clock."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self.look(min(left, 0.05))

    def last(self, can_id):
        """Stamp of the last frame of an identifier."""
        return max(stamp for stamp, one, _ in self.log if one == can_id)

    def upload(self, node, index, subindex=0, fmt="<h"):
        """Read an object by SDO; return the response's stamp and the value."""
        begin = len(self.log)
        self.client.send(pack_frame(0x600 + node, struct.pack("<BHBxxxx", 0x40, index, subindex)))
        deadline = time.monotonic() + 5
        while time.monotonic() < deadline:
            self.look(0.02)
            for stamp, can_id, data in self.log[begin:]:
                if can_id == 0x580 + node and struct.unpack_from("<HB", data, 1) == (index, subindex):
                    assert data[0] & 0xE0 == 0x40, data.hex()
                    return stamp, struct.unpack_from(fmt, data, 4)[0]
        raise AssertionError(f"node {node} does not answer")

    def emcys(self, node):
        """(stamp, error code) of the emergencies of a node that are no "error reset"."""
        found = [
            (stamp, struct.unpack_from("<H", data)[0]) for stamp, can_id, data in self.log if can_id == 0x80 + node
        ]
        return [(stamp, code) for stamp, code in found if code]
