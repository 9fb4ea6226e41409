"""Signals of PDOs from recorded frames: a row per frame, a column per signal in SI units; and each signal by name."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.eds.pdo import Entry
from coulombus.kernels.records import Records
from coulombus.recording.file_content import Capture
from coulombus.recording.unwrap import POSITION, Turns, fastest, follow
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.system.errors import CoulombusError

__all__ = [
    "PdoTable",
    "Series",
    "SignalsOfTables",
    "UnknownSignal",
    "are_texts",
    "bare_tables",
    "behind",
    "decode_field",
    "joined_table",
    "one_signal",
    "rig_tables",
    "signal_of",
    "signals_of",
    "table_of",
]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]

MOST_NAMED = 6
"""Number of signals in an error if none is similar to the requested name."""


@dataclass(frozen=True)
class PdoTable:
    """The frames of one PDO: their rows in `Recording.frames`, their stamps, their places in the
    file's order, and their data words. Rows of the host's telemetry (`inside`) are rows in
    `Capture.inside`.

    A column is decoded when it is asked for; only that of a position, which continues, is always.
    """

    pdo: RigPdo
    name: str
    rows: Integers
    t_ns: Integers
    order: Integers
    words: Integers
    malformed: int
    positions: Mapping[str, Array]
    """The unwrapped column of a position, by its name."""
    turns: Mapping[str, Turns]
    inside: bool = False

    def column(self, signal: Signal) -> Array:
        """Return the SI values of one of the PDO's signals."""
        if signal.name in self.positions:
            return self.positions[signal.name]
        place = self.pdo.signals.index(signal)
        return _si(decode_field(self.words, self.pdo.layout.starts[place], self.pdo.layout.entries[place]), signal)

    @cached_property
    def columns(self) -> tuple[Array, ...]:
        """One column of SI values per signal."""
        return tuple(map(self.column, self.pdo.signals))


def table_of(pdo: RigPdo, frames: Records, can_ids: Integers, rig: Rig | None, before: Mapping[str, Turns]) -> PdoTable:
    """Return the signals of a PDO in the frames; positions continue from `before`."""
    layout = pdo.layout
    came = np.flatnonzero(can_ids == layout.cob_id)
    rows = came[frames["length"][came] == layout.length]
    words, stamps = frames["word"][rows], frames["t_ns"][rows]
    signals, turns = signals_of(pdo, words, stamps, rig, before, () if rig is None else (POSITION,))
    positions = {signal.name: values for signal, values in signals}
    name, malformed = f"{pdo.node}.{pdo.name}", len(came) - len(rows)
    return PdoTable(pdo, name, rows, stamps, 2 * rows, words, malformed, positions, turns)


def joined_table(parts: Sequence[PdoTable], rows: Sequence[int], frames: Sequence[int]) -> PdoTable:
    """Return the table of one PDO from those of a file's stretches.

    Parameters
    ----------
    rows, frames : for each stretch the number of rows, and of bus frames, before it
    """
    positions = {name: np.concatenate([part.positions[name] for part in parts]) for name in parts[0].positions}
    return replace(
        parts[-1],
        rows=np.concatenate([part.rows + first for part, first in zip(parts, rows, strict=False)]),
        t_ns=np.concatenate([part.t_ns for part in parts]),
        order=np.concatenate([part.order + 2 * first for part, first in zip(parts, frames, strict=False)]),
        words=np.concatenate([part.words for part in parts]),
        malformed=sum(part.malformed for part in parts),
        positions=positions,
    )


def rig_tables(capture: Capture, can_ids: Integers, rig: Rig, before: Mapping[str, Turns]) -> Iterator[PdoTable]:
    """Yield the signals of each PDO of a rig."""
    ids_on = dict.fromkeys(rig.channels, can_ids)
    if capture.channels is not None:
        ids_on = {channel: np.where(capture.frames_on(channel), can_ids, -1) for channel in rig.channels}
    for axis in rig.axes:
        for pdo in axis.pdos():
            yield table_of(pdo, capture.frames, ids_on[axis.bus.channel], rig, before)


def bare_tables(
    frames: Records, can_ids: Integers, pdos: tuple[RigPdo, ...], begins: Mapping[int, int]
) -> Iterator[PdoTable]:
    """Yield the signals of PDOs without a rig, each from the first row of its map."""
    for pdo in pdos:
        ids = can_ids.copy()
        ids[: max(begins.get(pdo.layout.cob_id, 0), 0)] = -1
        yield table_of(pdo, frames, ids, None, {})


def signals_of(
    pdo: RigPdo,
    words: Integers,
    t_ns: Integers,
    rig: Rig | None,
    before: Mapping[str, Turns],
    keys: Collection[str] | None = None,
) -> tuple[list[tuple[Signal, Array]], dict[str, Turns]]:
    """Return a PDO's signals with the values of the data words received at `t_ns`, and its last
    position; `keys`: only these signals.
    """
    columns, turns = [], {}
    for entry, start, signal in zip(pdo.layout.entries, pdo.layout.starts, pdo.signals, strict=True):
        if keys is not None and signal.key not in keys:
            continue
        raw, name = decode_field(words, start, entry), signal.name
        if signal.key == POSITION and rig is not None:
            raw, last = follow(raw, t_ns, entry, before.get(name), fastest(rig, name))
            if last is not None:
                turns[name] = last
        columns.append((signal, _si(raw, signal)))
    return columns, turns


def behind(table: PdoTable, bus_ns: Integers) -> PdoTable:
    """Return a table of the host's telemetry: each row follows the last bus frame before it."""
    places: Integers = 2 * np.searchsorted(bus_ns, table.t_ns, "right") - 1
    return replace(table, order=places, inside=True)


def _si(raw: Array, signal: Signal) -> Array:
    if not signal.unit and (signal.scale, signal.offset) == (1.0, 0.0):
        return raw
    return raw * signal.scale + signal.offset


def decode_field(words: Integers, start: int, entry: Entry) -> Array:
    """Return the field at bit `start` of each data word: integers, or IEEE 754 numbers."""
    left, right = 64 - start - entry.bits, 64 - entry.bits
    if entry.kind == "real":
        pattern = words.view(np.uint64) << np.uint64(left) >> np.uint64(right)
        with np.errstate(invalid="ignore"):  # of a signalling NaN
            return pattern.astype(f"u{entry.bits // 8}").view(f"f{entry.bits // 8}").astype(np.float64)
    if entry.signed:
        return words << left >> right
    field = words.view(np.uint64) << np.uint64(left) >> np.uint64(right)
    return field if entry.bits == 64 else field.view(np.int64)


@dataclass(frozen=True)
class Series:
    """One signal: times [s], values in `unit`.

    Bit fields (unit "") are integers, the rest is float64.
    """

    t_s: Floats
    values: Array
    unit: str

    def __len__(self) -> int:
        return len(self.t_s)

    def held(self, t_s: Floats, before: float) -> Floats:
        """Return the last value at or before each of the times `t_s` [s]; `before` if there is none."""
        last = np.searchsorted(self.t_s, t_s, "right") - 1
        return np.append(self.values.astype(np.float64), before)[last]  # -1: the appended value


class SignalsOfTables(Mapping[str, Series]):
    """The signals of PDOs by name, each decoded when it is asked for."""

    def __init__(self, tables: Sequence[PdoTable], epoch_ns: int) -> None:
        self._places = {signal.name: (table, signal) for table in tables for signal in table.pdo.signals}
        self._epoch_ns = epoch_ns
        self._times: dict[str, Floats] = {}
        self._series: dict[str, Series] = {}

    def __getitem__(self, name: str) -> Series:
        if name not in self._series:
            table, signal = self._places[name]
            if table.name not in self._times:
                self._times[table.name] = (table.t_ns - self._epoch_ns) / 1e9
            self._series[name] = Series(self._times[table.name], table.column(signal), signal.unit)
        return self._series[name]

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class UnknownSignal(CoulombusError, KeyError):
    """A recording has no signal of this name; the text names the nearest ones."""

    exit_status = 2

    def __str__(self) -> str:
        return str(self.args[0])


def signal_of(pdos: Iterable[RigPdo], name: str, where: str) -> Signal:
    """Return the definition of a signal in a rig's PDOs; `UnknownSignal` says that there is none
    `where`, and names the nearest ones.
    """
    signals = {signal.name: signal for pdo in pdos for signal in pdo.signals}
    if name not in signals:
        near = difflib.get_close_matches(name, signals, 3, 0.4)
        some = near or list(signals)[:MOST_NAMED]
        more = 0 if near else len(signals) - len(some)
        others = f" and {more} others; coulombus pdo lists those of a bus" if more else ""
        raise UnknownSignal(f"no signal {name!r} in {where}; there is {', '.join(some)}{others}")
    return signals[name]


def one_signal(name: Any) -> str:
    """Return the correct indexing of a recording, for an invalid `name`."""
    several = f"; of several: series(recording, {', '.join(map(repr, name))})" if are_texts(name) else ""
    return f"recording[{name!r}]: expected a signal's name, as in recording['motor.position_rad']{several}"


def are_texts(names: Any) -> bool:
    """Return whether `names` is a non-empty list of strings."""
    return isinstance(names, (list, tuple)) and bool(names) and all(isinstance(name, str) for name in names)
