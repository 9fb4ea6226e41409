"""Envelopes of the last ten seconds of chosen signals, for plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from coulombus.monitor.tracks import BIN_NS, ENVELOPE_BINS, LiveEnvelope
from coulombus.recording.pdo_columns import decode_field, signal_of
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.wire.frame_batches import Block

__all__ = ["Trace", "Traces"]

WINDOW_S = ENVELOPE_BINS * BIN_NS / 1e9
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """Minima and maxima of a signal in `unit` by bin, the newest last; NaN: no sample."""

    name: str
    unit: str
    low: Floats
    high: Floats


class Traces:
    """Keeps envelopes of the signals `names`.

    Raises
    ------
    coulombus.recording.signals.UnknownSignal
        The rig has no such signal; the text has the nearest names.
    """

    def __init__(self, rig: Rig, names: Sequence[str]) -> None:
        for name in names:
            signal_of(rig.pdos(), name, f"rig {rig.name}")
        self.names = tuple(dict.fromkeys(names))
        self._envelopes = {name: LiveEnvelope() for name in self.names}
        self._pdos = {
            pdo.layout.cob_id: pdo for pdo in rig.pdos() if any(signal.name in self.names for signal in pdo.signals)
        }
        self._units = {signal.name: signal.unit for pdo in self._pdos.values() for signal in pdo.signals}
        self._waiting: list[Block] = []

    def add_frames(self, block: Block) -> None:
        """Add frames; they are decoded at the next snapshot."""
        if self.names:
            self._waiting.append(block)

    def snapshot(self, t_ns: int) -> tuple[Trace, ...]:
        """Return the envelopes of the ten seconds before `t_ns`."""
        block, self._waiting = Block.joined(self._waiting), []
        for can_id, pdo in self._pdos.items():
            rows = np.flatnonzero((block.can_ids == can_id) & (block.lengths == pdo.layout.length))
            if len(rows):
                self._decode(pdo, block, rows)
        newest = t_ns // BIN_NS
        traces = []
        for name, envelope in self._envelopes.items():
            low, high = np.full(ENVELOPE_BINS, np.nan), np.full(ENVELOPE_BINS, np.nan)
            first, lows, highs = envelope.since(newest - ENVELOPE_BINS + 1)
            at = first - (newest - ENVELOPE_BINS + 1)
            end = min(ENVELOPE_BINS, at + len(lows))
            low[at:end], high[at:end] = lows[: end - at], highs[: end - at]
            traces.append(Trace(name, self._units[name], low, high))
        return tuple(traces)

    def _decode(self, pdo: RigPdo, block: Block, rows: npt.NDArray[np.int64]) -> None:
        for signal, entry, start in zip(pdo.signals, pdo.layout.entries, pdo.layout.starts, strict=True):
            if signal.name in self._envelopes:
                raw = decode_field(block.words[rows], start, entry)
                self._envelopes[signal.name].add(block.t_ns[rows], raw * np.float64(signal.scale) + signal.offset)
