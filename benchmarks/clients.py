"""``python -m benchmarks clients``: what our own clients cost at 10,000 frames/s, and what they lose.

A bus without time carries ten frames each millisecond, PDOs of the bench rig, for some seconds.
Each client hears it in a process of its own, alone beside the bus and the sender, and python-can's
``recv`` does the same in its turn. What a client has cost is its processor time while the frames
came; what it lost is what it says itself, and what is missing of the frames that were sent.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from benchmarks.page import processor_s, ready, started
from benchmarks.size import size

__all__ = ["clients"]

CHANNEL = "benchmark-clients"
BUS = f"coulombus:{CHANNEL}"
SECONDS, BURST, PERIOD_S = size(10.0, 1.0), 10, 0.001
SETTLE_S = 1.0
"""Of a client: it has joined, and has taken the last frames."""

SENDER = f"""
import struct, time
from coulombus.wire.address import parse_address
from coulombus.wire.client import BusFull, Client, pack_frame
bursts = [b"".join(pack_frame(*frame) for _ in range(5) for frame in (
    (0x181, struct.pack("<Hih", 0x1237, k, k)), (0x202, struct.pack("<h", k)))) for k in range(1000)]
with Client(parse_address({BUS!r})) as client:
    begin = time.monotonic()
    for k in range(round({SECONDS} / {PERIOD_S})):
        time.sleep(max(0.0, begin + k * {PERIOD_S} - time.monotonic()))
        while True:
            try:
                client.send(bursts[k % 1000])
                break
            except BusFull:
                time.sleep(0.0005)
        while client.wait(0) and client.receive():
            pass
    client.wait(0.5)
"""

GOALS = {"live(...).on(two signals, f)": 1.5, "watch --json": 0.5, "watch --pcapng FILE": 1.0}
"""Of python-can's processor time for the same frames."""
READERS = {
    "python-can's recv()": f"""
import can, json, signal, sys
count = 0
def end(*_):
    print(json.dumps({{"frames": count, "lost": 0}}), flush=True)
    sys.exit()
signal.signal(signal.SIGTERM, end)
with can.Bus(interface="coulombus", channel={CHANNEL!r}) as bus:
    print(json.dumps({{"event": "ready"}}), flush=True)
    while True:
        message = bus.recv(0.1)
        if message is not None and message.arbitration_id in (0x181, 0x202):
            count += 1
""",
    "live(...).on(two signals, f)": f"""
import json, signal, sys
from coulombus import live
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])  # of all threads
seen = [0, 0]
def take(t_s, position, torque):
    seen[0] += 1
def take_setpoint(t_s, setpoint):
    seen[1] += 1
with live({BUS!r}, "bench") as bus:
    bus.on(["motor.position_rad", "motor.torque_Nm"], take)
    bus.on("brake.setpoint_Nm", take_setpoint)
    print(json.dumps({{"event": "ready"}}), flush=True)
    signal.sigwait([signal.SIGTERM])
    print(json.dumps({{"frames": sum(seen), "lost": bus.lost}}), flush=True)
""",
}
REFERENCE = next(iter(READERS))


def send() -> int:
    """Send all frames; return how many."""
    subprocess.run([sys.executable, "-c", SENDER], check=True)
    return round(SECONDS / PERIOD_S) * BURST


def heard(client: subprocess.Popen[str]) -> tuple[float, int]:
    """Let a client that has joined hear all frames; return its processor time [s], and how many
    were sent.
    """
    begin = processor_s(client.pid)
    sent = send()
    time.sleep(SETTLE_S)
    return processor_s(client.pid) - begin, sent


def reader(code: str) -> tuple[float, int, int]:
    """Return what a reading program cost [s], what it has missed and what it says that it lost."""
    with ExitStack() as stack:
        client = started(stack, "-c", code)
        ready(client)
        cost, sent = heard(client)
        client.terminate()
        report = json.loads(client.communicate()[0].splitlines()[-1])
    return cost, sent - report["frames"], report["lost"]


def watch() -> tuple[float, int, int]:
    """Return the same of ``watch``, which says each second what it has."""
    with ExitStack() as stack:
        client = started(stack, "-m", "coulombus", "watch", "--bus", BUS, "--rig", "bench", "--json")
        assert client.stdout is not None
        client.stdout.readline()
        cost, sent = heard(client)
        client.terminate()
        lines = client.communicate()[0].splitlines()
    report = json.loads(lines[-1])
    return cost, sent - sum(one["frames"] for one in report["pdos"].values()), report["lost"]


def record() -> tuple[float, int, int]:
    """Return the same of ``watch --pcapng``; what it lost it says in a sentence, so the file is read."""
    from coulombus.recording.reading import blocks

    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        path = Path(folder, "all.pcapng")
        client = started(stack, "-m", "coulombus", "watch", "--bus", BUS, "--rig", "bench", "--pcapng", str(path))
        while not path.exists():
            time.sleep(0.05)
        time.sleep(SETTLE_S)
        cost, sent = heard(client)
        client.terminate()
        client.wait()
        ids = [frames["can_id"] for block in blocks(path) if len(frames := block.frames)]
    return cost, sent - sum(int(((one == 0x181) | (one == 0x202)).sum()) for one in ids), 0


def clients(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    with ExitStack() as stack:
        ready(started(stack, "-m", "coulombus", "emulate", "--bus", BUS, "--unpaced", "--json"))
        rows: dict[str, Callable[[], tuple[float, int, int]]] = {
            name: lambda code=code: reader(code)  # type: ignore[misc]
            for name, code in READERS.items()
        }
        rows |= {"watch --json": watch, "watch --pcapng FILE": record}
        reference = 0.0
        for name, measure in rows.items():
            cost, missing, lost = measure()
            reference = cost if name == REFERENCE else reference
            load = os.getloadavg()[0]
            text = f"{missing} missing, {lost} lost of {SECONDS:g} s; load {load:.0f}"
            show(f"10,000 frames/s: {name}", f"{100 * cost / SECONDS:.0f} % of a core", text)
            if name in GOALS:
                show(f"... {name}, of python-can's time", f"{cost / reference:.2f} x", f"at most {GOALS[name]} x")
