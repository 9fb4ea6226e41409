"""``python -m benchmarks loss``: a long run on a noisy bus, every frame of which is accounted for.

Three witnesses that know nothing of each other: what a recording is made of; a station on the bus
that hears every frame; and the stations' counters of what they sent again. Each frame stands in the
recording once and as it was heard, each error frame has its cause, and the host and the nodes have
sent so many frames as they had cycles.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from coulombus.cli.tables import progress
from coulombus.host.run.result import RunResult
from coulombus.lab.simulate import simulate
from coulombus.sim_bus.network.network import Heard
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.frame import CAN_ERR_FLAG, data_word

NOISE = 'seed = 3\n[[fault]]\nkind = "noise"\nrate = 1e-4\n'
"""One bit in 10,000: of a hundred frames, one is destroyed."""
BUS_ERROR, OVERLOAD, SENDING, STUFF = 0x80, 0x20, 0x80, 0x04  # linux/can/error.h: class; type in data[2]
END_OF_FRAME = 0x1A  # place in data[3]
FALSE_START_NS = 9_000
"""A dominant third bit of intermission is a start of frame.

Nobody sends, and with the sixth recessive bit each receiver finds a stuff error.
"""


@dataclass
class Account:
    """What became of the frames of a run at 1 Mbit/s, as its recording tells it."""

    frames: int = 0
    errors: int = 0
    """Error frames of disturbed frames."""
    overloads: int = 0
    false_starts: int = 0
    """A disturbed bit of intermission, or of an idle wire: all take it for a start of frame."""
    twice: Counter[int] = field(default_factory=Counter)
    """By identifier: disturbed in the last bit, so that the receivers had them and the sender sent
    them again.
    """
    carried: Counter[int] = field(default_factory=Counter)
    differ: int = 0
    """Frames that the witness heard otherwise than the recording has them."""
    heard: list[tuple[int, int, int, int]] = field(default_factory=list)
    _last: tuple[int, int, int] = (0, 0, 0)
    _idle: set[int] = field(default_factory=set)

    def expected(self, cycles: int) -> dict[int, int]:
        """Return how many of each cyclic frame so many cycles make; a SYNC that the nodes have
        twice asks for TPDOs twice.
        """
        by_host = {can_id: cycles + self.twice[can_id] for can_id in (0x080, 0x201, 0x202)}
        return by_host | {can_id: cycles + self.twice[0x080] + self.twice[can_id] for can_id in (0x181, 0x182)}

    def strike(self, t_ns: int, text: str) -> None:
        """Take a disturbance of the wire: without an identifier nobody was sending."""
        if text.startswith("fault noise (") and t_ns not in self._idle:
            self._idle.add(t_ns)
            self.false_starts += 1

    def hear(self, frame: Heard) -> None:
        """Take a frame that the witness has heard."""
        self.heard.append((frame.t_ns, frame.can_id, frame.length, data_word(frame.data)))

    def compare(self, rows: Any) -> None:
        """Compare with a batch of the recording, up to the same instant."""
        recorded = [row[:4] for row in rows.tolist()]
        good = [row for row in recorded if not row[1] & CAN_ERR_FLAG]
        self.differ += sum(a != b for a, b in zip(good, self.heard, strict=False)) + abs(len(good) - len(self.heard))
        self.heard.clear()
        self.frames += len(good)
        self.carried.update(row[1] for row in good)
        for t_ns, can_id, _, word in recorded:
            kind, place = word >> 16 & 0xFF, word >> 24 & 0xFF
            last_t, last_id, last_kind = self._last
            if not can_id & CAN_ERR_FLAG:
                if last_id & CAN_ERR_FLAG and last_t == t_ns and last_kind == (SENDING | END_OF_FRAME << 8):
                    self.twice[can_id] += 1
            elif can_id & BUS_ERROR:
                self.errors += 1
                self.false_starts -= t_ns in self._idle  # in the first bit of an error flag: the wire was not idle
                self.overloads += kind & OVERLOAD != 0
                self.false_starts += kind == STUFF and not last_id & CAN_ERR_FLAG and t_ns - last_t == FALSE_START_NS
            self._last = t_ns, can_id, kind & SENDING | place << 8


def account(
    seconds: float, directory: Path, record: Path | None = None, progress: Callable[[float], None] | None = None
) -> tuple[Account, RunResult, VirtualRig]:
    """Run the bench on a noisy bus and account for its frames; `progress` is called with the
    display's time in s.
    """
    ledger, worlds = Account(), []

    def watch(world: VirtualRig) -> None:
        worlds.append(world)
        world.station(None, ledger.hear)
        assert world.injection is not None
        mark = world.injection._on_fault

        def strike(t_ns: int, text: str) -> None:
            ledger.strike(t_ns, text)
            if mark is not None:
                mark(t_ns, text)

        world.injection._on_fault = strike
        write: Callable[[Any], None] | None = world.on_frames

        def compare(rows: Any) -> None:
            ledger.compare(rows)
            if write is not None:
                write(rows)

        world.on_frames = compare

    faults = directory / "noise.toml"
    faults.write_text(NOISE, encoding="utf-8")
    result = simulate("bench", "hybrid", seconds, faults=faults, script=watch, record=record, progress=progress)
    return ledger, result, worlds[0]


def loss(show: Callable[..., None], minutes: float) -> None:
    """Print the account of so many minutes of bus time."""
    begin = time.perf_counter()
    seconds = 60.0 * minutes
    with tempfile.TemporaryDirectory() as directory, progress(enabled=True) as report:
        ledger, result, world = account(seconds, Path(directory), progress=lambda t_s: report("loss", t_s, seconds))
    spent = time.perf_counter() - begin
    cycles = int(world.controllers.host["cycle"][0])
    sent_again = int(world.bus["retransmissions"].sum())
    show(f"frames of {minutes:g} min on a noisy bus; frames destroyed", f"{ledger.frames:,}; {sent_again:,}")
    show("frames that recording and witness have otherwise", f"{ledger.differ}", "0")
    show(
        "error frames without a cause: not sent again, no overload, no false start",
        f"{ledger.errors - sent_again - ledger.overloads - ledger.false_starts}",
        "0",
    )
    missing = sum(abs(ledger.carried[can_id] - count) for can_id, count in ledger.expected(cycles).items())
    show("cyclic frames too few or too many, besides those disturbed in the last bit", f"{missing}", "0")
    show("trip; simulated to real time, witness in Python included", f"{result.trip}; {seconds / spent:.0f} x")
