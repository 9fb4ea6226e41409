"""Exports of a recording, beside python-can's own converter: processor time of a second at 1 kHz.

python-can takes a message at a time; the same recording goes from pcapng to its writers.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.size import size

__all__ = ["exports"]

CYCLES, TIMES, THEIRS = size(20_000, 1000), size(30, 1), 1
"""Of a stretch; how often ours goes on with it (ten minutes), and python-can with it."""


def stretch(path: Path, times: int) -> Path:
    """Write so many stretches of the bench rig's frames, and return the path."""
    from coulombus.recording.pcapng_writer import PcapngWriter
    from coulombus.rigs.rig import load_rig
    from coulombus.wire.frame import FRAME

    rig = load_rig("bench")
    frames = np.zeros(5 * CYCLES, FRAME)
    cycle = np.arange(CYCLES)
    for k, (can_id, length) in enumerate(((0x080, 0), (0x201, 4), (0x202, 2), (0x181, 8), (0x182, 6))):
        frames["t_ns"][k::5], frames["can_id"][k::5] = cycle * 1_000_000 + 100_000 * k, can_id
        frames["length"][k::5] = length
        frames["word"][k::5] = (cycle * 977 % 4001) & (1 << 8 * length) - 1 if length < 8 else cycle * 977 % 4001
    attachments = {"rig.toml": rig.effective().encode()}
    attachments |= {name: text.encode() for name, text in rig.eds_texts.items()}
    with PcapngWriter(path, attachments=attachments, force=True) as writer:
        for _ in range(times):
            writer.write(frames)
            frames["t_ns"] += CYCLES * 1_000_000
    return path


def exports(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    import can

    from coulombus.recording.can_io import PcapngMessageReader
    from coulombus.recording.export.export import KINDS, export

    with tempfile.TemporaryDirectory() as folder:
        short, long = stretch(Path(folder, "short.pcapng"), THEIRS), stretch(Path(folder, "long.pcapng"), TIMES)
        export(short, Path(folder, "warm.csv"), "csv")
        for kind, suffix in KINDS.items():
            begin = time.process_time()
            export(long, Path(folder, f"long{suffix}"), kind)
            ours_s = (time.process_time() - begin) / (TIMES * CYCLES * 1e-3)
            ratio = ""
            if kind in ("candump", "asc", "blf"):
                begin = time.process_time()
                with can.Logger(Path(folder, f"theirs{suffix}")) as writer:
                    for message in PcapngMessageReader(short):
                        writer(message)
                theirs_s = (time.process_time() - begin) / (THEIRS * CYCLES * 1e-3)
                ratio = f"; python-can takes {theirs_s / ours_s:.0f} times as long"
            text = f"export to {kind}, recorded at 1 kHz, time of the recording to processor time"
            show(text, f"{1 / ours_s:.0f} x", f"at least 600 x{ratio}")
