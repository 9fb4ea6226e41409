"""Draws docs/trip.png, the live page at a trip, as a PNG of several frames.

    .venv/bin/python scripts/trip_picture.py

A simulated run whose drive restarts is played into the page, in steps of virtual time, and a headless
Chromium shows it. The file is committed, because the site is built without a browser: run this after a
change of the page.
"""

from __future__ import annotations

import asyncio
import io
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from chromium import Browser  # noqa: E402
from coulombus.host.run.runbook import entry  # noqa: E402
from coulombus.lab.simulate import simulate  # noqa: E402
from coulombus.monitor.live_incidents import IncidentReader  # noqa: E402
from coulombus.monitor.web.capture import Curve  # noqa: E402
from coulombus.monitor.web.page import Page  # noqa: E402
from coulombus.recording.reading import read  # noqa: E402
from coulombus.recording.signals import Recording  # noqa: E402
from coulombus.recording.wall_clock import utc  # noqa: E402
from coulombus.wire.frame_batches import Block  # noqa: E402
from web_bench import BEGIN_NS, Door, page, served  # noqa: E402

FAULT = '[[fault]]\nkind = "reset"\nnode = "motor"\nafter = "enabled"\nat_s = 6.2\n'
SIZE = (1280, 720)
STEP_NS = 200_000_000
BEFORE_NS, AFTER_NS = 2_000_000_000, 2_400_000_000
"""Time of the animation before the trip, and after it."""
SHOWN_MS, HELD_MS, COLOURS = 200, 4000, 128
NO_TIMES = {"edges": [], "counts": []}
"""Virtual time has no delays of a machine."""


def recorded(folder: Path) -> Recording:
    """Return a run of the bench rig whose drive restarts."""
    (folder / "faults.toml").write_text(FAULT)
    simulate("bench", "hybrid", 8.0, faults=folder / "faults.toml", record=folder / "run.pcapng")
    return read(folder / "run.pcapng")


class Scene:
    """The page of a recorded run, with its time as an argument.

    Attributes
    ----------
    trip_ns : time of the trip
    """

    def __init__(self, recording: Recording) -> None:
        frames = recording.frames
        self._block = Block(*(np.asarray(frames[name]) for name in ("t_ns", "can_id", "length", "word")))
        self._next = 0
        t_s, self._trip = next((t_s, text.removeprefix("trip ")) for t_s, text in recording.markers if "trip " in text)
        enabled_s = next(t_s for t_s, text in recording.markers if text.startswith("phase "))
        self.trip_ns, self._enabled_ns = (BEGIN_NS + round(1e9 * at_s) for at_s in (t_s, enabled_s))
        self.door = Door()
        self.page: Page = page(door=self.door)
        self.page.host.__init__(entry)  # type: ignore[misc]  # the runbook of the program
        self.incidents = IncidentReader(self.page.capture.rig)
        self.page.incidents = lambda: self.incidents.rows
        curve = self.door.door.curve(self.page.capture.rig.one_axis(), "hybrid", {})
        self.page.curves = {"": None if curve is None else Curve(*curve)}

    def play(self, until_ns: int) -> None:
        """Show the run as it is at `until_ns`."""
        stop = int(self._block.t_ns.searchsorted(until_ns - BEGIN_NS))
        rows = slice(self._next, stop)
        table = self._block
        block = Block(table.t_ns[rows] + BEGIN_NS, table.can_ids[rows], table.lengths[rows], table.words[rows])
        self._next = stop
        with self.page.lock:
            self.page.capture.add_frames(block)
            self.incidents.add_frames(block)
            self.incidents.update(until_ns)
            self.page.host.update(self._status(until_ns))
        self.page.tick(until_ns)

    def _status(self, now_ns: int) -> dict[str, Any]:
        tripped = now_ns >= self.trip_ns
        status = {**self.door.status(), "recording": "run.pcapng", "display_s": (now_ns - self._enabled_ns) / 1e9}
        status |= {"wakeup_us": None, "histograms_us": {"wakeup": NO_TIMES, "sync_to_rpdo": NO_TIMES}}
        status |= {"counters": {"missed_deadlines": 0}}
        status["axes"][0] |= {"phase": "safe" if tripped else "run", "lost_pdos": 0}
        return status | ({"trip": self._trip, "tripped": utc(self.trip_ns)} if tripped else {})


async def pictures(scene: Scene, folder: Path) -> AsyncIterator[bytes]:
    """Yield pictures of the page, from `BEFORE_NS` before the trip."""
    begin_ns, end_ns = scene.trip_ns - BEFORE_NS, scene.trip_ns + AFTER_NS
    async with served(scene.page) as url, Browser(url, str(folder / "profile"), SIZE) as browser:
        await browser.until("plots.length === 7")
        for until_ns in [*range(BEGIN_NS, begin_ns, STEP_NS // 3), *range(begin_ns, end_ns, STEP_NS)]:
            frames = int(await browser.evaluate("frames"))
            scene.play(until_ns)
            await browser.until(f"frames > {frames}")
            if until_ns >= begin_ns:
                path = folder / "shot.png"
                await browser.screenshot(str(path))
                yield path.read_bytes()


def animation(shots: list[bytes]) -> bytes:
    """Return the pictures as one PNG that shows them one after the other, the last for longer."""
    size = (SIZE[0] * 3 // 4, SIZE[1] * 3 // 4)
    images = [Image.open(io.BytesIO(shot)).convert("RGB").resize(size, Image.Resampling.LANCZOS) for shot in shots]
    palette = images[-1].quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    out = io.BytesIO()
    times = [SHOWN_MS] * (len(images) - 1) + [HELD_MS]
    images[0].save(out, "PNG", save_all=True, append_images=images[1:], duration=times, loop=0, optimize=True)
    return out.getvalue()


async def draw() -> None:
    """Draw the picture into docs."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as name:
        scene = Scene(recorded(Path(name)))
        shots = [shot async for shot in pictures(scene, Path(name))]
    content = animation(shots)
    (ROOT / "docs" / "trip.png").write_bytes(content)
    print(f"docs/trip.png: {len(shots)} pictures, {len(content) // 1000} kB")


if __name__ == "__main__":
    asyncio.run(draw())
