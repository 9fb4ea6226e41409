"""Recordings of the bench rig, made by hand."""

import json
import struct
from pathlib import Path

import numpy as np

from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, FRAME, data_word

MS = 1_000_000
CYCLES = 400
STRANGE = [
    (0x18FF_1234 | CAN_EFF_FLAG, 3, b"\x01\x02\x03"),
    (0x123 | CAN_RTR_FLAG, 4, b""),
    (0x7FF, 0, b""),
    (0x004 | CAN_ERR_FLAG, 8, b"\x00\x04\x00\x00\x00\x00\x60\x00"),
]


def frames_of(cycles: int, late: int = 0, push: int = 0) -> tuple[np.ndarray, dict[int, str]]:
    """Return cycles of the bench rig, with strange frames in their midst, and markers.

    All comes `late` ns later, and the brake's set-point is `push` mNm higher in cycle 150.
    """
    rows: list[tuple[int, int, int, bytes]] = []
    for k in range(cycles):
        t = (k + 3) * MS + late
        rows += [
            (t, 0x080, 0, b""),
            (t + 100_001, 0x201, 4, struct.pack("<Hh", 0x000F, k % 50 - 7)),
            (t + 200_007, 0x202, 2, struct.pack("<h", 3 * k + (push if k == 150 else 0))),
            (t + 300_000, 0x181, 8, struct.pack("<Hih", 0x0237 + k % 2, -100 * k, 77)),
            (t + 400_000, 0x182, 6, struct.pack("<hhh", -k, 640, 221)),
        ]
        if cycles > 100 and k == cycles // 2:
            rows += [(t + 500_000 + j, *strange) for j, strange in enumerate(STRANGE)]
    frames = np.zeros(len(rows), FRAME)
    for record, (t_ns, can_id, length, data) in zip(frames, rows, strict=True):
        record["t_ns"], record["can_id"], record["length"], record["word"] = t_ns, can_id, length, data_word(data)
    markers = {3: "run hybrid", 11: "phase hold\nsaid by hand"}
    return frames, {row: text for row, text in markers.items() if row < len(frames)}


def record(
    path: Path,
    cycles: int = CYCLES,
    start_ns: int = 0,
    late: int = 0,
    push: int = 0,
    mode: str = "hybrid",
    rig: str = "bench",
) -> Path:
    """Write a recording of them, with rig and EDS files attached, and the clock where it began."""
    loaded = load_rig(rig)
    attachments = {"rig.toml": loaded.effective().encode(), "mode": mode.encode()}
    attachments |= {name: text.encode() for name, text in loaded.eds_texts.items()}
    if start_ns:
        clock = {"start_utc": "2026-11-22T20:04:12.000000Z", "start_ns": start_ns}
        attachments |= {"clock.json": json.dumps(clock).encode(), "meta.json": b'{"subject": "S01"}'}
    with PcapngWriter(path, attachments=attachments) as writer:
        if cycles:
            writer.write(*frames_of(cycles, late, push))
    return path
