"""Signals drawn in a terminal: their envelopes, and the dots."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from rich.console import Console

from coulombus.monitor.live import Live
from coulombus.monitor.screen import DOTS, Screen, drawn
from coulombus.monitor.traces import Traces
from coulombus.monitor.tracks import BIN_NS, ENVELOPE_BINS
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.signals import UnknownSignal
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame_batches import Block

NAME = "motor.position_rad"
NOW = 1_700_000_000 * 10**9


def dots(lines: list[str]) -> Iterator[tuple[int, int]]:
    """Yield each dot's column and row, from the lower left."""
    for down, line in enumerate(lines):
        for across, character in enumerate(line):
            cell = 0 if character == " " else ord(character) - 0x2800
            for row, bits in enumerate(DOTS):
                for column, bit in enumerate(bits):
                    if cell & bit:
                        yield 2 * across + column, 4 * (len(lines) - down) - 1 - row


def test_a_ramp_is_a_diagonal() -> None:
    ramp = np.arange(8.0)
    lines, least, most = drawn(ramp, ramp, 4, 2)
    assert (least, most) == (0.0, 7.0)
    assert sorted(dots(lines)) == [(k, k) for k in range(8)]


def test_a_column_is_filled_from_its_least_to_its_greatest() -> None:
    low, high = np.array([0.0, 3.0]), np.array([7.0, 3.0])
    lines, _, _ = drawn(low, high, 1, 2)
    assert sorted(dots(lines)) == [(0, row) for row in range(8)] + [(1, 3)]


def test_what_was_not_seen_is_blank_and_the_newest_is_at_the_right() -> None:
    values = np.array([np.nan, 5.0])
    lines, least, most = drawn(values, values, 3, 1)
    assert (least, most) == (5.0, 5.0)
    assert list(dots(lines)) == [(5, 0)]
    assert drawn(values[:1], values[:1], 3, 2) == (["   "] * 2, 0.0, 0.0)
    assert drawn(values[:0], values[:0], 3, 1) == (["   "], 0.0, 0.0)


def frames(positions: list[int], step_ns: int) -> Block:
    """Return TPDO1s of the bench's motor, the last of them at NOW."""
    first = NOW - (len(positions) - 1) * step_ns
    return Block.from_frames(
        [(first + k * step_ns, 0x181, 8, struct.pack("<Hih", 0x0237, counts, 0)) for k, counts in enumerate(positions)]
    )


def test_the_envelope_has_what_came_in_the_last_ten_seconds() -> None:
    rig = load_rig("bench")
    traces = Traces(rig, [NAME])
    scale = next(s.scale for pdo in rig.pdos() for s in pdo.signals if s.name == NAME)
    traces.add_frames(frames([100, -50, 7], BIN_NS // 4))
    traces.add_frames(
        Block.from_frames([(NOW, 0x181, 3, bytes(8)), (NOW, 0x999, 8, bytes(8))])
    )  # of another length, another frame
    (trace,) = traces.snapshot(NOW)
    assert len(trace.low) == ENVELOPE_BINS
    assert trace.unit == "rad"
    assert np.nanmin(trace.low) == pytest.approx(-50 * scale)
    assert np.nanmax(trace.high) == pytest.approx(100 * scale)
    (later,) = traces.snapshot(NOW + 11 * 10**9)
    assert not np.isfinite(later.low).any()


def test_a_signal_that_is_none_is_told() -> None:
    with pytest.raises(UnknownSignal, match=r"no signal 'motor.positoin' in rig bench; there is motor.position_rad"):
        Traces(load_rig("bench"), ["motor.positoin"])


@pytest.mark.parametrize("height", [12, 24, 60])
@pytest.mark.parametrize("width", [40, 80, 120])
def test_the_picture_fits_the_window(width: int, height: int) -> None:
    rig = load_rig("bench")
    live, traces = Live(KnownBus(rig)), Traces(rig, [NAME, "brake.handle_torque_Nm"])
    live.snapshot(NOW - 10**9)
    came = frames(list(range(500)), BIN_NS)
    live.add_frames(came)
    traces.add_frames(came)
    facts = {"bus": "coulombus:bench", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}
    console = Console(file=io.StringIO(), force_terminal=True, width=width, height=height, color_system=None)
    console.print(Screen(live.snapshot(NOW), facts, [], NOW - 10**9, traces=traces.snapshot(NOW)))
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert len(lines) < height
    assert all(len(line) <= width for line in lines)
    assert any(line.startswith(f"{NAME}  +0 to ") for line in lines)
    assert any(line.startswith("brake.handle_torque_Nm  none came") for line in lines)
    assert any(0x2800 < ord(character) < 0x2900 for line in lines for character in line)
