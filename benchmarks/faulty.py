"""``python -m benchmarks faulty``: when a bus in real time delivers while 1 % of the frames are
destroyed, against cyclictest's wake-ups.

A client sends bursts of frames and knows when each ends. Of these frames the bus destroys each
101st in its 60th bit, so all places in a burst are hit: error flags, delimiter, and the frame once
more. How long that takes is asked of the same bus in virtual time. So the frame's end is known to
the nanosecond, and what is left of the kernel's stamp on it is how late it was handed out.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks import contestants as c
from benchmarks.contestants import Bus, quantile
from benchmarks.realtime import compiled, ratio, skipped, take_turns
from benchmarks.report import show
from coulombus.kernels.records import Records
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import read_faults
from coulombus.sim_bus.faults.injection import Injection
from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["disturbance_ns", "faulty"]

EVERY, BIT = 101, 60
FAULTS = f'[[fault]]\nkind = "flip"\non = {{ can_id = {c.PROBE_ID}, nth = {EVERY}, every = {EVERY} }}\nbit = {BIT}\n'


def disturbance_ns(file: Path) -> int:
    """Return by how much the bus's first fault of `file` delays the frame that it destroys."""
    ends: list[int] = []

    def keep(frames: Records) -> None:
        ends.extend(int(frame["t_ns"]) for frame in frames if frame["can_id"] == c.PROBE_ID)

    world = VirtualRig(load_rig("bench"), c.MODE, on_frames=keep)
    Injection(world, read_faults(file), 0)
    sender = world.station(())
    world.power_on()
    world.wait_ns(10_000_000)
    while len(ends) < EVERY:
        for _ in range(c.PROBE_FRAMES):
            sender.send(c.PROBE_ID, c.PROBE_DATA)
        world.wait_ns(2_000_000)
        world.flush()
    burst = (EVERY - 1) // c.PROBE_FRAMES * c.PROBE_FRAMES
    return (ends[EVERY - 1] - ends[burst - c.PROBE_FRAMES + (EVERY - 1) % c.PROBE_FRAMES]) - 2_000_000


def faulty(seconds: float, rounds: int) -> None:
    """Run it, in turns with cyclictest at the bus's priority, and with the same bus without
    faults.
    """
    what = "1 % of frames destroyed: delivery after end of frame, p99 against cyclictest's"
    with tempfile.TemporaryDirectory() as directory:
        program, file = compiled(Path(directory)), Path(directory) / "faults.toml"
        reason = program if isinstance(program, str) else c.has_cyclictest()
        if reason is not None:
            skipped(what, reason)
            return
        assert isinstance(program, Path)
        file.write_text(FAULTS)
        extra_ns = disturbance_ns(file)
        with Bus(faults=file) as noisy, Bus() as quiet:
            runs = take_turns(
                {
                    "noisy": lambda: c.delivery(program, noisy, seconds, every=EVERY, extra_ns=extra_ns),
                    "quiet": lambda: c.delivery(program, quiet, seconds)[0],
                    "reference": lambda: c.cyclictest(seconds, priority=c.BUS_PRIORITY, cpu=c.BUS_CPU).p(0.99),
                },
                rounds,
            )
    p99 = [quantile(every, 0.99) for every, _ in runs["noisy"]]
    show(what, ratio(p99, runs["reference"]), "at most 2 x")
    show("... the same without faults", ratio([quantile(one, 0.99) for one in runs["quiet"]], runs["reference"]))
    destroyed = sum(hit for _, hit in runs["noisy"])
    every = sum(one for one, _ in runs["noisy"])
    text = f"{quantile(destroyed, 0.5) / quantile(every, 0.5):.2f} x"
    counts = f"{int(destroyed.sum())} of {int(every.sum())} frames, {extra_ns / 1000:g} us each"
    show("... median of the frames that were destroyed once, against that of all", text, counts)
