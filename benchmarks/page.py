"""``python -m benchmarks page``: what the page's server costs, and how many frames a browser draws.

The bench rig runs at 1 kHz in real time: nine signals, and the velocity that the page makes of the
position. Beside the server python-can reads the same bus: what it costs on this machine, under this
load, is what the server is held against. The browser is a headless Chromium that draws by software,
on the same cores.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks.size import size
from coulombus.rigs.overrides import SHARED_MACHINE

BUS = "coulombus:benchmark-page"
SECONDS, WARM_S, PATIENCE_S = size(10.0, 1.0), size(5.0, 1.0), 240
TICK_S = 1 / os.sysconf("SC_CLK_TCK")
READER = """
import can
with can.Bus(interface="coulombus", channel="benchmark-page") as bus:
    while True:
        bus.recv()
"""


def processor_s(pid: int) -> float:
    """Return the processor time of a process so far, all threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICK_S


def started(stack: ExitStack, *words: str) -> subprocess.Popen[str]:
    """Start a Python process that ends with the stack."""
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def ready(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Return the line by which a process tells that it is there."""
    assert process.stdout is not None
    event: dict[str, Any] = json.loads(process.stdout.readline() or "{}")
    if event.get("event") != "ready":
        sys.exit(f"benchmarks: {process.args}: it did not start")
    return event


async def frames_per_s(url: str, over: Callable[[], None]) -> tuple[float, str]:
    """Return how many frames a browser draws in a second, and how; `over` is called between."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
    from chromium import Browser

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        async with Browser(url, profile) as browser:
            await browser.until("frames > 10 && one('phase').textContent === 'running'", PATIENCE_S)
            await asyncio.sleep(WARM_S)
            over()
            first, begin = await browser.evaluate("frames"), time.monotonic()
            await asyncio.sleep(SECONDS)
            rate = (await browser.evaluate("frames") - first) / (time.monotonic() - begin)
            over()
            drawing = await browser.evaluate(
                "(() => { const begin = performance.now(); for (let i = 0; i < 50; i++) draw();"
                " return ((performance.now() - begin) / 50).toFixed(1) })()"
            )
            return rate, f"{drawing} ms in JavaScript a frame"


def page(show: Callable[..., None]) -> None:
    """Measure the server beside python-can, and the browser's frames."""
    if not any(map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))):
        show("the page", "skipped", "no chromium: apt install chromium")
        return
    sets = [word for text in SHARED_MACHINE for word in ("--set", text)]
    with ExitStack() as stack:
        ready(started(stack, "-m", "coulombus", "emulate", "--bus", BUS, "--json", *sets))
        started(stack, "-m", "coulombus", "run", "--bus", BUS, "--mode", "hybrid", "--json", *sets)
        server = started(stack, "-m", "coulombus", "watch", "--bus", BUS, "--web", "--web-port", "0", "--json")
        url = str(ready(server)["url"])
        reader = started(stack, "-c", READER)
        times: list[tuple[float, float, float]] = []

        def sample() -> None:
            times.append((time.monotonic(), processor_s(server.pid), processor_s(reader.pid)))

        drawn, how = asyncio.run(frames_per_s(url, sample))
    (begin, served, read), (end, served_end, read_end) = times
    share, reference = (served_end - served) / (end - begin), (read_end - read) / (end - begin)
    load = os.getloadavg()[0]
    show("the page: server, one browser, 10 signals at 1 kHz", f"{100 * share:.1f} %", "at most 10 % of a core")
    show(
        "... python-can's recv() of the same bus beside it",
        f"{100 * reference:.1f} %",
        f"ours: {share / reference:.2f} x",
    )
    show("... frames a browser draws a second", f"{drawn:.1f}", f"30; {how}; load {load:.1f} of {os.cpu_count()} cores")
