"""Envelopes of the last ten seconds of chosen signals, for plots."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from coulombus.monitor.tracks import BIN_NS, ENVELOPE_BINS, Envelope
from coulombus.recording.pdo_columns import decode_field
from coulombus.recording.signal_names import signal_of
from coulombus.rigs.rig import Rig

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
        self._envelopes = {name: Envelope() for name in self.names}
        self._pdos = {
            pdo.layout.cob_id: pdo for pdo in rig.pdos() if any(signal.name in self.names for signal in pdo.signals)
        }
        self._units = {signal.name: signal.unit for pdo in self._pdos.values() for signal in pdo.signals}
        self._waiting: dict[int, list[tuple[int, bytes]]] = {can_id: [] for can_id in self._pdos}

    def take(self, received: Iterable[tuple[int, int, int, bytes]]) -> None:
        """Add frames: (stamp, identifier, length, eight data bytes) each."""
        waiting = self._waiting
        for t_ns, can_id, length, data in received:
            if can_id in waiting and length == self._pdos[can_id].layout.length:
                waiting[can_id].append((t_ns, data))

    def look(self, t_ns: int) -> tuple[Trace, ...]:
        """Return the envelopes of the ten seconds before `t_ns`."""
        for can_id, frames in self._waiting.items():
            if frames:
                self._decode(can_id, frames)
                self._waiting[can_id] = []
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

    def _decode(self, can_id: int, frames: list[tuple[int, bytes]]) -> None:
        pdo = self._pdos[can_id]
        t_ns = np.array([t for t, _ in frames], np.int64)
        words = np.frombuffer(b"".join(data for _, data in frames), "<i8").astype(np.int64)
        for signal, entry, start in zip(pdo.signals, pdo.layout.entries, pdo.layout.starts, strict=True):
            if signal.name in self._envelopes:
                raw = decode_field(words, start, entry)
                self._envelopes[signal.name].add(t_ns, raw * np.float64(signal.scale) + signal.offset)
