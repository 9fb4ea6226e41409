"""``python -m benchmarks world``: how soon a program outside has the states, and how soon it is heard.

A display runs at 1 kHz on the virtual bus. A state's latency is the time from the cycle's end
(`State.sent_ns`) to the program; beside it a process sends as many bytes each millisecond through an
AF_UNIX stream, and the same program takes both in turns. Runs with and without programs take turns,
too: their wake-ups and processor time are those that the host reports.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from statistics import median
from typing import Any

import numpy as np

from benchmarks.page import ready, started
from benchmarks.size import size
from coulombus.host.world.hand import Hand, NoWorld, connect
from coulombus.host.world.model_parts import Wall
from coulombus.host.world.protocol import SIZES, Kind
from coulombus.host.world.state import RUN
from coulombus.rigs.overrides import SHARED_MACHINE

__all__ = ["world"]

BUS = "coulombus:benchmark-world"
PATIENCE_S = 240.0
TURNS, TURN = size(10, 1), size(1000, 100)
"""Turns of states and pings, and the number of each in a turn."""
COMMANDS = size(500, 10)
GATEWAY_S, MODELS_S = size(10.0, 1.0), 200
"""Time of a WebSocket client, and the models that it sends in a second."""
WALL = Wall(x_rad=-10.0, K_Nm_rad=2.0, B_Nms_rad=0.05)
SETS = [word for text in SHARED_MACHINE for word in ("--set", text)]

PING = f"""
import socket, sys, time
out = socket.socket(fileno=int(sys.argv[1]))
while out.recv(1):
    begin = time.monotonic_ns() // 1_000_000 * 1_000_000
    for k in range(1, {TURN} + 1):
        time.sleep(max(0, begin + k * 1_000_000 - time.monotonic_ns()) * 1e-9)
        out.sendall(time.monotonic_ns().to_bytes(8, "little") + bytes({SIZES[Kind.STATE] - 8}))
"""
PROGRAMS = {
    "reads all": "for state in hand: pass",
    "is asleep": "time.sleep(1000)",
    "sends rubbish": f"""
while True:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.connect(str(world_path(parse_address({BUS!r}))))
        other.sendall(random.randbytes(random.randrange(1, 2000)))
    time.sleep(0.005)
""",
    "controls": f"""
while True:
    hand.render(Wall(x_rad=random.uniform(-11.0, -10.0), K_Nm_rad=2.0, B_Nms_rad=0.05), law=0.5)
    _ = hand.state
    time.sleep({1 / MODELS_S})
""",
}
PROGRAM = f"""
import random, socket, time
from coulombus import Wall, connect
from coulombus.host.world.hand import world_path
from coulombus.wire.address import parse_address
with connect({BUS!r}, timeout_s={PATIENCE_S}) as hand:
    while hand.state.phase != {RUN}:
        pass
    print('{{"event": "ready"}}', flush=True)
"""


def host(stack: ExitStack, seconds: float) -> subprocess.Popen[str]:
    """Start a display that runs for so long."""
    words = ("--bus", BUS, "--mode", "hybrid", "--world", "--json", "--seconds", str(seconds))
    return started(stack, "-m", "coulombus", "run", *words, *SETS)


def connected() -> Hand:
    """Return a hand at the display, as soon as that runs."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            hand = connect(BUS, timeout_s=PATIENCE_S)
            break
        except NoWorld:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)
    while hand.next().phase != RUN:
        pass
    return hand


def finished(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Wait for a display's end; return what it has printed."""
    out, _ = process.communicate(timeout=PATIENCE_S)
    if process.returncode != 0:
        sys.exit(f"benchmarks: coulombus run: exit status {process.returncode}")
    figures: dict[str, Any] = json.loads(out)
    return figures


def p(values: list[int], share: float) -> float:
    """Return a quantile of times in nanoseconds, in milliseconds."""
    return float(np.quantile(values, share)) * 1e-6


@contextmanager
def pings() -> Iterator[socket.socket]:
    """Start a process that sends pings; yield the stream on which a byte orders those of a turn."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    words = [sys.executable, "-c", PING, str(its.fileno())]
    with ours, subprocess.Popen(words, pass_fds=[its.fileno()]) as process:
        its.close()
        try:
            yield ours
        finally:
            process.kill()


def ping_latencies(stream: socket.socket) -> list[int]:
    """Take the pings of a turn; return their times on the way [ns]."""
    stream.send(b"g")
    latencies = []
    for _ in range(TURN):
        select.select([stream], [], [])
        data = stream.recv(SIZES[Kind.STATE], socket.MSG_WAITALL)
        latencies.append(time.monotonic_ns() - int.from_bytes(data[:8], "little"))
    return latencies


def state_latencies() -> list[int]:
    """Take the states of a turn; return their times on the way [ns]."""
    latencies = []
    with connected() as hand:
        for _ in range(TURN):
            state = hand.next()
            latencies.append(time.monotonic_ns() - state.sent_ns)
    return latencies


def latency(show: Callable[..., None]) -> None:
    """Show the states' latency beside that of a bare socket."""
    states, bare, above = [], [], []
    with ExitStack() as stack:
        process = host(stack, 1000.0)
        connected().close()
        stream = stack.enter_context(pings())
        for _ in range(TURNS):
            bare.append(ping_latencies(stream))
            states.append(state_latencies())
            above.append(p(states[-1], 0.99) - p(bare[-1], 0.99))
        process.terminate()
    ours, reference = ([value for turn in turns for value in turn] for turns in (states, bare))
    show(
        "state from the cycle's end to a program, p50",
        f"{p(ours, 0.5):.3f} ms",
        f"bare socket {p(reference, 0.5):.3f} ms",
    )
    show("... p99", f"{p(ours, 0.99):.3f} ms", f"bare socket {p(reference, 0.99):.3f} ms")
    show("... p99 above the bare socket's, median of the turns", f"{median(above):.3f} ms", "at most 0.3 ms", above)


def none_lost(show: Callable[..., None], seconds: float) -> None:
    """Show how many states a program has read, of those that were sent."""
    with ExitStack() as stack:
        process = host(stack, seconds + 2.0)
        with connected() as hand:
            states = [(state.sequence, state.lost, state.t_ns) for state in hand]
        figures = finished(process)
    (first, _, begin_ns), (last, lost, end_ns) = states[0], states[-1]
    share = 100 * len(states) / (last - first + 1)
    remark = f"{lost} lost; {figures['missed_deadlines']} periods missed by the host"
    show(f"states that a program has read, of {last - first + 1}", f"{share:.4f} %", f"at least 100 %; {remark}")
    show("... states a second", f"{(len(states) - 1) / (end_ns - begin_ns) * 1e9:.1f}")


def first_effect(show: Callable[..., None]) -> None:
    """Show in which cycle after a model its first effect is."""
    lottery, cycles = random.Random(1), []
    with ExitStack() as stack:
        process = host(stack, 1000.0)
        with connected() as hand:
            for _ in range(COMMANDS):
                for _ in range(lottery.randrange(5, 15)):
                    hand.next()
                end = time.monotonic_ns() + lottery.randrange(1_000_000)
                while time.monotonic_ns() < end:
                    pass
                begin, number, count = time.monotonic_ns(), hand.render(WALL, law=0.0, life_s=1.0), 0
                while (state := hand.next()).model != number:
                    count += state.t_ns > begin
                cycles.append(count + (state.t_ns > begin))
        process.terminate()
    remark = f"p50 {np.quantile(cycles, 0.5):.0f}; in the next one {100 * np.mean(np.array(cycles) <= 1):.1f} %"
    figure = f"{np.quantile(cycles, 0.99, method='higher'):.0f}"
    show("cycles from a model to its first effect, p99", figure, f"at most 1 (the next cycle); {remark}")


def cycle_figures(seconds: float, programs: dict[str, str]) -> tuple[float, float]:
    """Return the wake-up p99 and the processor time of a cycle [us] in a run beside these programs."""
    with ExitStack() as stack:
        process = host(stack, seconds + 2.0)
        connected().close()
        for code in programs.values():
            body = "\n".join("    " + line for line in code.strip().splitlines())
            started(stack, "-c", PROGRAM + body)
        figures = finished(process)
    return float(figures["wakeup_us"]["p99"]), float(figures["cpu_us_per_cycle"])


def beside_programs(show: Callable[..., None], seconds: float, rounds: int) -> None:
    """Show what four programs cost the cycle."""
    wakeups, times = [], []
    for number in range(rounds):
        turns = [{}, PROGRAMS] if number % 2 == 0 else [PROGRAMS, {}]
        by_programs = {len(programs): cycle_figures(seconds, programs) for programs in turns}
        (wakeup, cpu), (wakeup_beside, cpu_beside) = by_programs[0], by_programs[len(PROGRAMS)]
        wakeups.append(wakeup_beside / wakeup)
        times.append(cpu_beside / cpu)
    show("the cycle's wake-up p99 beside four programs", f"{median(wakeups):.2f} x", "at most 1.05 x", wakeups)
    show("... its processor time", f"{median(times):.2f} x", "at most 1.05 x", times)


async def _browser(url: str) -> tuple[float, float, int]:
    """Return states and models a second of a WebSocket client, and the states that it lost."""
    from tornado.websocket import websocket_connect

    client = await websocket_connect(url)
    await client.write_message('{"type": "hello"}')
    model = json.dumps({"type": "model", "law": 0.5, "wall": {"x_rad": -10.0, "K_Nm_rad": 2.0}, "life_s": 0.5})
    states = models = lost = 0
    begin, sending = time.monotonic(), True

    async def send() -> None:
        nonlocal models
        while sending:
            await client.write_message(model)
            models += 1
            await asyncio.sleep(max(0.0, begin + models / MODELS_S - time.monotonic()))

    sender = asyncio.create_task(send())
    while time.monotonic() - begin < GATEWAY_S:
        fields = json.loads(await client.read_message() or "{}")
        if fields.get("type") == "states":
            states += len(fields["sequence"])
            lost = fields["lost"][-1]
        elif fields.get("type") == "refused":
            models -= 1
    passed, sending = time.monotonic() - begin, False
    await sender
    client.close()
    return states / passed, models / passed, lost


def gateway(show: Callable[..., None]) -> None:
    """Show what a WebSocket client reads and sends."""
    with ExitStack() as stack:
        host(stack, 1000.0)
        connected().close()
        served = ready(started(stack, "-m", "coulombus", "world", "--bus", BUS, "--web-port", "0", "--json"))
        states, models, lost = asyncio.run(_browser(str(served["websocket"])))
    show("WebSocket, JSON: states a second", f"{states:.0f}", f"at least 990; {lost} lost")
    show("... models a second", f"{models:.0f}", f"at least {0.98 * MODELS_S:.0f}; load {os.getloadavg()[0]:.1f}")


def world(show: Callable[..., None], seconds: float, rounds: int, minutes: float) -> None:
    """Show all figures; `seconds` and `rounds` are of the runs with and without programs."""
    with ExitStack() as stack:
        ready(started(stack, "-m", "coulombus", "emulate", "--bus", BUS, "--mode", "hybrid", "--json", *SETS))
        latency(show)
        none_lost(show, 60 * minutes)
        first_effect(show)
        beside_programs(show, seconds, rounds)
        gateway(show)
