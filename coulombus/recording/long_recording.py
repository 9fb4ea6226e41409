"""A recording that is too long to be kept: its signals are read from the file when they are asked for."""

from __future__ import annotations

from collections.abc import ItemsView, Iterator, Mapping, Sequence, ValuesView
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from coulombus.recording.block_source import HOST, Blocks
from coulombus.recording.file_content import Capture, joined
from coulombus.recording.pdo_columns import PdoTable, joined_table
from coulombus.recording.signals import Recording, Series
from coulombus.recording.unwrap import Turns
from coulombus.wire.frame import Frame, new_records

__all__ = ["LongRecording"]


class LongRecording(Recording):
    """A `Recording` of which one pass has gathered markers and counts.

    A signal is read in another pass, and kept then: 16 bytes for each sample. A loop over the
    recording itself gets its blocks. `frames`, `capture` and `tables` read and keep everything.
    """

    def __init__(self, source: Blocks) -> None:
        attachments: dict[str, bytes] = {}
        malformed: dict[str, int] = {}
        samples: dict[str, int] = {}
        last_s: dict[str, float] = {}
        markers: list[tuple[float, str]] = []
        ends: list[float] = []
        epoch_ns, before, turns, count = 0, None, dict[str, Turns](), 0
        for block in source:
            attachments |= {name: data for name, data in block.attachments.items() if not name.startswith(HOST)}
            for table in block.tables:
                samples[table.name] = samples.get(table.name, 0) + len(table.t_ns)
                if len(table.t_ns):
                    last_s[table.name] = float((table.t_ns[-1] - block.epoch_ns) / 1e9)
            for name, number in block.malformed.items():
                malformed[name] = malformed.get(name, 0) + number
            markers += block.markers
            count += len(block.frames)
            if len(block.frames):
                t_s, epoch_ns = block.t_s, block.epoch_ns
                ends += [float(t_s.min()), float(t_s.max())]
                ends = [min(ends), max(ends)]
            before = block.before if before is None else before
            turns |= block.turns
        # fields of a frozen class
        vars(self).update(
            path=source.path,
            known_rig=source.known_rig,
            epoch_ns=epoch_ns,
            signals=(signals := _SignalsOfFile(source, samples)),
            markers=markers,
            malformed=MappingProxyType(malformed),
            before=before or {},
            inside=source.inside,
            bare=source.bare,
        )
        vars(self).update(_source=source, _attachments=attachments, _count=count, _ends=ends, _turns=turns)
        vars(self).update(_remarks=source.remarks, _last_s=last_s, _of_file=signals)

    _source: Blocks
    _attachments: Mapping[str, bytes]
    _count: int
    _ends: Sequence[float]
    _turns: Mapping[str, Turns]
    _remarks: tuple[str, ...]
    _last_s: Mapping[str, float]
    _of_file: _SignalsOfFile

    def __iter__(self) -> Iterator[Recording]:
        """Yield the blocks."""
        return iter(self._source)

    @cached_property
    def _blocks(self) -> list[Recording]:
        return list(self._source)

    @cached_property
    def capture(self) -> Capture:
        """The file's raw content."""
        if not self._blocks:
            return Capture(self.path, new_records(Frame, 0), comments=[], attachments={})
        return joined(self.path, [block.capture for block in self._blocks])

    @cached_property
    def tables(self) -> tuple[PdoTable, ...]:
        """The frames of each PDO."""
        firsts = np.cumsum([0, *(len(block.frames) for block in self._blocks)]).tolist()
        inside = np.cumsum([0, *(len(block.capture.inside) for block in self._blocks)]).tolist()
        of_each = zip(*(block.tables for block in self._blocks), strict=True)
        return tuple(joined_table(parts, inside if parts[0].inside else firsts, firsts) for parts in of_each)

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attached files by name, without those of the host's replay."""
        return self._attachments

    @property
    def count(self) -> int:
        """Number of frames."""
        return self._count

    def samples(self, name: str) -> int:
        """Return the number of samples of a signal."""
        return self._of_file.samples(name)

    def last_s(self, name: str) -> float | None:
        """Return the time of a signal's last sample [s]; None without a sample."""
        return self._last_s.get(self._of_file.table(name))

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame [s]."""
        return self._ends[1] - self._ends[0] if self._ends else 0.0

    @property
    def ends_s(self) -> tuple[float, float] | None:
        """Least and largest time of a frame [s]; None without a frame."""
        return (self._ends[0], self._ends[1]) if self._ends else None

    @property
    def turns(self) -> Mapping[str, Turns]:
        """The last value of each position."""
        return self._turns

    @property
    def remarks(self) -> tuple[str, ...]:
        """As `Recording.remarks`."""
        return self._remarks

    def within(self, begin_s: float, end_s: float) -> Blocks:
        """Return the blocks of a stretch of time."""
        return self._source.within(begin_s, end_s)

    def extent(self) -> tuple[float, float] | None:
        """Return the times of the first and the last frame [s]; None without a frame."""
        return self._source.extent()

    def seen_by(self, axis: str) -> LongRecording:
        """Return the view of the axis of this name, with the signals' plain names."""
        return LongRecording(self._source.seen_by(axis)) if axis else self


class _SignalsOfFile(Mapping[str, Series]):
    """The signals by name, each read when it is asked for; a loop over all of them reads all in one pass."""

    def __init__(self, source: Blocks, samples: Mapping[str, int]) -> None:
        self._source, self._samples = source, samples
        self._tables = {signal.name: f"{pdo.node}.{pdo.name}" for pdo in source.pdos for signal in pdo.signals}
        self._kept: dict[str, Series] = {}

    def __getitem__(self, name: str) -> Series:
        if name not in self._kept:
            self._read((name,))
        return self._kept[name]

    def __contains__(self, name: object) -> bool:
        return name in self._tables

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def table(self, name: str) -> str:
        """Return the name of a signal's PDO."""
        return self._tables[name]

    def samples(self, name: str) -> int:
        """Return the number of samples of a signal."""
        return self._samples.get(self._tables[name], 0)

    def items(self) -> ItemsView[str, Series]:
        """Return the names and signals."""
        self._read([name for name in self if name not in self._kept])
        return super().items()

    def values(self) -> ValuesView[Series]:
        """Return the signals."""
        self.items()
        return super().values()

    def _read(self, names: Sequence[str]) -> None:
        """Gather signals in one pass; those of one PDO share their times."""
        times = {self._tables[name]: signal.t_s for name, signal in self._kept.items()}
        values: dict[str, Any] = {}
        units: dict[str, str] = {}
        filled = dict.fromkeys((self._tables[name] for name in names), 0)
        missing = [table for table in filled if table not in times]
        times |= {table: np.zeros(self._samples.get(table, 0)) for table in missing}
        for block in self._source:
            ends = {}
            for name in names:
                table, signal = self._tables[name], block.signals[name]
                begin, end = filled[table], min(filled[table] + len(signal), len(times[table]))
                if name not in values:
                    values[name] = np.zeros(len(times[table]), signal.values.dtype)
                    units[name] = signal.unit
                values[name][begin:end] = signal.values[: end - begin]
                if table in missing:
                    times[table][begin:end] = signal.t_s[: end - begin]
                ends[table] = end
            filled |= ends
        for name in names:
            if name not in values:
                raise KeyError(name)
            self._kept[name] = Series(times[self._tables[name]], values[name], units[name])
