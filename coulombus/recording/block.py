"""Blocks of a recording: some seconds of it, decoded; and what every consumer of them takes, a `Source`.

`decode` makes a block of a file's content. `series` extracts single signals of a streamed recording.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import ItemsView, Iterator, Mapping, Sequence, ValuesView
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records
from coulombus.recording.file_content import UNSURE, Capture
from coulombus.recording.logs.stamps import WALL_CLOCK_NS
from coulombus.recording.pdo_columns import (
    PdoTable,
    Series,
    SignalsOfTables,
    are_texts,
    bare_tables,
    behind,
    one_signal,
    rig_tables,
    signal_of,
    table_of,
)
from coulombus.recording.unwrap import Turns
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import Rig, RigError
from coulombus.rigs.signals import RigPdo, Signal

__all__ = [
    "GIVE_RIG",
    "Block",
    "Overview",
    "SignalsOfBlocks",
    "Source",
    "decode",
    "epoch_of",
    "left_out_of",
    "markers_of",
    "series",
]

GIVE_RIG = "give one: read(path, rig=...), or --rig on the command line"
Floats: TypeAlias = npt.NDArray[np.float64]


class Source:
    """What figures, tables and pictures read: blocks in sequence, each with absolute times."""

    path: str
    known_rig: Rig | None
    """The rig; None: neither attached nor given."""
    inside: tuple[RigPdo, ...] = ()
    """The host's telemetry (`recording.host_telemetry`), as PDOs of a node "host"."""
    bare: tuple[RigPdo, ...] = ()
    """Without a rig: the PDOs with maps from the log or an EDS file (`recording.maps`)."""

    @property
    def rig(self) -> Rig:
        """The rig of these PDOs: attached or given.

        Raises
        ------
        coulombus.rigs.rig.RigError
            There is none; the error has the remedy.
        """
        if self.known_rig is None:
            raise RigError([f"{self.path}: no rig.toml is attached, and this needs one; {GIVE_RIG}"])
        return self.known_rig

    @property
    def pdos(self) -> tuple[RigPdo, ...]:
        """All PDOs with signals: the rig's, and the host's telemetry."""
        return (*(self.bare if self.known_rig is None else self.known_rig.pdos()), *self.inside)

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""
        raise NotImplementedError

    def seen_by(self, axis: str) -> Self:
        """Return the view of the axis of this name, with the signals' plain names.

        Markers of other axes are left out.
        """
        raise NotImplementedError

    def one_axis(self, name: str | None) -> Self:
        """Return the view of the axis `name`.

        Without a name the rig must have a single axis.

        Raises
        ------
        coulombus.rigs.rig.RigError
            see `Rig.one_axis`
        """
        self.rig.one_axis(name)
        return self.seen_by(name or "")

    @property
    def axes(self) -> tuple[Self, ...]:
        """The view of each axis of the rig, with the signals' plain names."""
        if self.known_rig is None or not self.known_rig.axis_names:
            return (self,)
        return tuple(self.seen_by(name) for name in self.rig.axis_names)

    def within(self, begin_s: float, end_s: float) -> Source:
        """Return a source whose blocks have all of this stretch of time, and perhaps more."""
        return self

    def extent(self) -> tuple[float, float] | None:
        """Return the times of the first and the last frame [s]; None without a frame."""
        times = [t for block in self if len(block.frames) for t in (block.t_s[0], block.t_s[-1])]
        return (float(min(times)), float(max(times))) if times else None

    def has(self, name: str) -> bool:
        """Return whether the signal exists: the signal of an absent role is in no PDO."""
        return any(signal.name == name for pdo in self.pdos for signal in pdo.signals)

    def __contains__(self, name: object) -> bool:
        """Return whether the signal exists: ``"motor.position_rad" in recording``."""
        return isinstance(name, str) and self.has(name)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all signals."""
        return tuple(dict.fromkeys(signal.name for pdo in self.pdos for signal in pdo.signals))

    @property
    def tables_of(self) -> dict[str, str]:
        """Signal's name -> its PDO's, as ``"motor.TPDO1"``."""
        return {signal.name: f"{pdo.node}.{pdo.name}" for pdo in self.pdos for signal in pdo.signals}

    def signal(self, name: str) -> Signal:
        """Return the definition of a signal: object, scale, offset, unit; `UnknownSignal` names the nearest ones."""
        return signal_of(self.pdos, name, self.path)

    def scale(self, name: str) -> float:
        """Return the SI value of one raw count of a signal."""
        return self.signal(name).scale


@dataclass(frozen=True, repr=False)
class Block(Source):
    """Some seconds of a recording, or a short one whole, decoded; ``block["motor.position_rad"]`` is a `Series`.

    Attributes
    ----------
    path
        The file.
    known_rig
        The rig of these PDOs, attached or given; None: there is none, and `rig` raises.
    capture
        The raw content: frames, comments, attachments, torn bytes.
    epoch_ns
        Time 0 of all `t_s`: 0 in virtual time, else the first frame's stamp.
    signals
        Name -> `Series`, in the order of the rig's PDOs; empty for a PDO that was never received.
    markers
        (time [s], text) of each line of the comments, in the file's order; then those that no frame follows.
    malformed
        "motor.TPDO1" -> frames of a wrong length, which are omitted from the signals.
    before
        Position before the first frame of each block after the first.
    """

    path: str
    known_rig: Rig | None
    capture: Capture
    epoch_ns: int
    tables: tuple[PdoTable, ...]
    signals: Mapping[str, Series]
    markers: list[tuple[float, str]]
    malformed: Mapping[str, int]
    before: Mapping[str, Turns]
    inside: tuple[RigPdo, ...] = ()
    bare: tuple[RigPdo, ...] = ()

    def __iter__(self) -> Iterator[Block]:
        """Yield the block itself."""
        yield self

    @property
    def frames(self) -> Records:
        """All frames, records of `wire.frame.Frame`."""
        return self.capture.frames

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attached files by name."""
        return self.capture.attachments

    @property
    def t_s(self) -> Floats:
        """Time of each frame [s]."""
        return (self.frames["t_ns"] - self.epoch_ns) / 1e9

    @property
    def turns(self) -> Mapping[str, Turns]:
        """The last value of each position."""
        return {name: turns for table in self.tables for name, turns in table.turns.items()}

    def __getitem__(self, name: str) -> Series:
        """Return a signal; `UnknownSignal`, a KeyError, names the nearest ones."""
        if not isinstance(name, str):
            raise WrongCall(one_signal(name))
        if name not in self.signals:
            self.signal(name)
        return self.signals[name]


@dataclass
class Overview:
    """What a pass through a recording gathers: markers and counts."""

    attachments: dict[str, bytes] = field(default_factory=dict)
    malformed: Counter[str] = field(default_factory=Counter)
    samples: Counter[str] = field(default_factory=Counter)
    """Number of frames of each PDO, by its name."""
    last_s: dict[str, float] = field(default_factory=dict)
    """Time of the last frame of each PDO."""
    markers: list[tuple[float, str]] = field(default_factory=list)
    ends_s: tuple[float, float] | None = None
    epoch_ns: int = 0
    before: Mapping[str, Turns] | None = None
    turns: dict[str, Turns] = field(default_factory=dict)
    count: int = 0
    remarks: tuple[str, ...] = ()

    def add(self, block: Block) -> None:
        """Add a block."""
        for table in block.tables:
            self.samples[table.name] += len(table.t_ns)
            if len(table.t_ns):
                self.last_s[table.name] = float((table.t_ns[-1] - block.epoch_ns) / 1e9)
        self.malformed.update(block.malformed)
        self.markers += block.markers
        self.count += len(block.frames)
        if len(block.frames):
            t_s, self.epoch_ns = block.t_s, block.epoch_ns
            ends = [float(t_s.min()), float(t_s.max()), *(self.ends_s or ())]
            self.ends_s = min(ends), max(ends)
        self.before = block.before if self.before is None else self.before
        self.turns |= block.turns


class SignalsOfBlocks(Mapping[str, Series]):
    """The signals of a source by name, each read in a pass when it is asked for, and kept then; a loop over
    all of them reads all in one pass.

    Parameters
    ----------
    samples : number of frames of each PDO, by its name
    """

    def __init__(self, source: Source, samples: Mapping[str, int]) -> None:
        self._source, self._samples = source, samples
        self._tables = source.tables_of
        self._series: dict[str, Series] = {}

    def __getitem__(self, name: str) -> Series:
        if name not in self._series:
            self._read((name,))
        return self._series[name]

    def __contains__(self, name: object) -> bool:
        return name in self._tables

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def items(self) -> ItemsView[str, Series]:
        """Return the names and signals."""
        self._read([name for name in self if name not in self._series])
        return super().items()

    def values(self) -> ValuesView[Series]:
        """Return the signals."""
        self.items()
        return super().values()

    def _read(self, names: Sequence[str]) -> None:
        """Gather signals in one pass; those of one PDO share their times."""
        times = {self._tables[name]: signal.t_s for name, signal in self._series.items()}
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
            self._series[name] = Series(times[self._tables[name]], values[name], units[name])


def markers_of(axis: str, rig: Rig, markers: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Return the markers of an axis of `rig`: its own phases by plain names, without those of other axes."""
    phases = f"{axis}.phase "
    others = tuple(f"{other}.phase " for other in rig.axis_names if other != axis)
    return [
        (t_s, text.removeprefix(f"{axis}.") if text.startswith(phases) else text)
        for t_s, text in markers
        if not text.startswith(others)
    ]


def series(source: Source, *names: str) -> tuple[Series, ...]:
    """Extract signals in one pass through the recording: 16 bytes per sample, at 1 kHz 16 kB per second and signal.

    Raises
    ------
    UnknownSignal
        A signal that the recording does not have.
    coulombus.rigs.arguments.WrongCall
        `source` is not a recording, or a name is not a string.
    """
    if not isinstance(source, Source):
        raise WrongCall(f"source is {source!r}: expected a recording, as in series(read('run.pcapng'), {names[:1]!r})")
    if any(not isinstance(name, str) for name in names):
        listed = names[0] if len(names) == 1 and are_texts(names[0]) else ("motor.position_rad",)
        call = ", ".join(map(repr, listed))
        raise WrongCall(f"the names are {names!r}: expected one text each, as in series(recording, {call})")
    blocks = [[block[name] for name in names] for block in source]
    return tuple(
        Series(
            np.concatenate([part.t_s for part in parts]), np.concatenate([part.values for part in parts]), parts[0].unit
        )
        for parts in zip(*blocks, strict=True)
    )


def epoch_of(frames: Records) -> int:
    """Return time 0 of a recording from its first frames."""
    return int(frames["t_ns"][0]) if len(frames) and frames["t_ns"][0] >= WALL_CLOCK_NS else 0


def decode(
    capture: Capture,
    rig: Rig | None,
    epoch_ns: int | None = None,
    before: Mapping[str, Turns] = MappingProxyType({}),
    inside: tuple[RigPdo, ...] = (),
    bare: tuple[RigPdo, ...] = (),
    begins: Mapping[int, int] = MappingProxyType({}),
) -> Block:
    """Return the capture with the signals of the rig's PDOs and of the host's telemetry (`inside`).

    For a stretch of a longer recording, `epoch_ns` and the positions `before` are given. Without a
    rig the PDOs are those of `bare`, each from the first row of its map (`begins`).
    """
    frames = capture.frames
    epoch_ns = epoch_of(frames) if epoch_ns is None else epoch_ns
    can_ids = np.ascontiguousarray(frames["can_id"])
    tables = tuple(
        rig_tables(capture, can_ids, rig, before) if rig is not None else bare_tables(frames, can_ids, bare, begins)
    )
    if inside:
        ids = np.ascontiguousarray(capture.inside["can_id"])
        telemetry = (table_of(pdo, capture.inside, ids, rig, before) for pdo in inside)
        tables += tuple(behind(table, frames["t_ns"]) for table in telemetry)

    def at_s(row: int) -> float:
        return float((frames["t_ns"][row] - epoch_ns) / 1e9)

    markers = [(at_s(row), line) for row, text in capture.comments for line in text.splitlines()]
    return Block(
        path=capture.path,
        known_rig=rig,
        capture=capture,
        epoch_ns=epoch_ns,
        tables=tables,
        signals=SignalsOfTables(tables, epoch_ns),
        markers=markers + [((t_ns - epoch_ns) / 1e9, text) for t_ns, text in capture.late],
        malformed=MappingProxyType({table.name: table.malformed for table in tables if not table.inside}),
        before=MappingProxyType(dict(before)),
        inside=inside,
        bare=bare,
    )


def left_out_of(block: Block) -> Counter[str]:
    """Return the amount of omitted data by reason."""
    doubts = {
        f"{UNSURE}{name}": turns.doubts - (block.before[name].doubts if name in block.before else 0)
        for name, turns in block.turns.items()
    }
    return Counter({"torn": block.capture.torn, "skipped": block.capture.skipped, **block.malformed, **doubts})
