"""Compare two recordings, a piece at a time: two runs, or a simulated run and the rig's.

They are aligned by phase: time counts from the beginning of each phase, and the comparison ends
with the shorter one. A value of the other recording at a sample's time is interpolated linearly; a
word of bits is held. Without a tolerance everything must be equal: phases, numbers of samples, and
the parts before the first phase and after the last. With tolerances only the phases are compared,
and only signals with a tolerance are judged.
"""

from __future__ import annotations

import filecmp
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.eds.eds_folder import EdsFiles
from coulombus.recording.bus_match import Channel
from coulombus.recording.difference import Comparison, Difference, Pair
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording, Series, UnknownSignal
from coulombus.rigs.arguments import WrongCall, path_text
from coulombus.rigs.rig import Rig

__all__ = ["CommonSpan", "Tally", "compare", "only_in", "pieces"]

Floats: TypeAlias = npt.NDArray[np.float64]
NO_TOLERANCES: Mapping[str, float] = MappingProxyType({})
ALL = ""
"""Key of the tolerance for every signal with a unit."""
PERIOD_S = 1e-3
"""Period of a bus without a rig: phases that differ by less than half of it are of one length."""
NAMED = 4
"""Signals that a sentence names; the others are counted."""
PIECE_NS = 60_000_000_000
"""Length of a piece of long recordings."""
SUMMED = 1 << 18
"""Squares that are summed at a time."""


def compare(
    a: str | os.PathLike[str],
    b: str | os.PathLike[str],
    *,
    tolerances: Mapping[str, float] = NO_TOLERANCES,
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
    eds: Iterable[str] | EdsFiles = (),
) -> Comparison:
    """Compare two recordings.

    Parameters
    ----------
    a, b
        Recordings, as `read` takes them.
    tolerances
        Signal's name or unit -> largest difference that counts as equal; "": for every signal with
        a unit. Empty mapping: everything must be equal.
    rig
        Decode with this rig instead of the attached ones.
    channel
        Which of the files' buses, as `read` takes it.
    eds
        EDS files, as `read` takes them.

    Raises
    ------
    coulombus.recording.signals.UnknownSignal
        A tolerance names neither a signal nor a unit of the recordings.
    coulombus.rigs.rig.RigError, coulombus.recording.pcapng_blocks.PcapngError
        See `read`.
    coulombus.rigs.arguments.WrongCall
        An argument has the invalid type.
    """
    a, b = (path_text(path, name, 'compare("a.pcapng", "b.pcapng")') for name, path in (("a", a), ("b", b)))
    _check_types(tolerances)
    first, second = (read(path, rig, channel, eds=eds) for path in (a, b))
    common = [name for name in first.signals if name in second.signals]
    units = {name: first.signal(name).unit for name in common}
    inside = {signal.name for pdo in first.inside for signal in pdo.signals}
    _check_tolerances(first, tolerances, units)
    texts = (*first.remarks, *second.remarks)
    same = not Path(a).is_dir() and not Path(b).is_dir() and filecmp.cmp(a, b, shallow=False)
    spans, phase_remarks, lengths = _spans(first, second, exact=not tolerances)
    wanting = _only_in(first, second) + _only_in(second, first)
    if bool(first.inside) != bool(second.inside):
        lengths = [*lengths, f"only {(first if first.inside else second).path} has what the host told of itself"]
    tallies = _tallies(first, second, common, spans)
    differences = []
    for name, tally in tallies.items():
        tolerance = _tolerance(name, "" if name in inside else units[name], tolerances)
        whole = tally.whole
        if tolerances:  # runs of different length are compared over the shorter one
            whole = bool(tally.samples) or not first.samples(name) + second.samples(name)
        differences.append(_difference(name, units[name], tally, tolerance, whole))
    equal = same or (
        all(difference.equal for difference in differences)
        and not phase_remarks
        and not wanting
        and not (lengths and not tolerances)
    )
    remarks = (*texts, *_different(first, second), *wanting, *phase_remarks, *lengths)
    return Comparison(str(a), str(b), same, equal, tuple(differences), remarks, _Pairs(first, second, common, spans))


def _check_types(tolerances: Mapping[str, float]) -> None:
    """Raise unless it is a mapping of names to numbers."""
    if isinstance(tolerances, Mapping):
        invalid = next(((key, value) for key, value in tolerances.items() if not _is_number(value)), None)
        if invalid is None:
            return
        raise WrongCall(
            f'tolerances[{invalid[0]!r}] is {invalid[1]!r}: expected a number, as in tolerances={{"Nm": 0.1}}'
        )
    meant = tolerances if _is_number(tolerances) else 0.1
    raise WrongCall(
        f"tolerances is {tolerances!r}: expected signals' names or units with a number each, as in "
        f'tolerances={{"Nm": {meant!r}}}; tolerances={{"": {meant!r}}} is for every signal that has a unit'
    )


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check_tolerances(recording: Recording, tolerances: Mapping[str, float], units: Mapping[str, str]) -> None:
    for name in tolerances:
        if name != ALL and name not in units and name not in units.values():
            try:
                recording.signal(name)
            except UnknownSignal as error:
                unit_names = ", ".join(sorted({unit for unit in units.values() if unit}))
                raise UnknownSignal(f"a tolerance for {name!r}: {error}; or a unit: {unit_names}") from None


def _tolerance(name: str, unit: str, tolerances: Mapping[str, float]) -> float | None:
    if not tolerances:
        return 0.0
    keys = (name, unit, ALL) if unit else (name,)
    return next((tolerances[key] for key in keys if key in tolerances), None)


def _only_in(recording: Recording, other: Recording) -> list[str]:
    inside = {signal.name for pdo in recording.inside if not other.inside for signal in pdo.signals}
    names = [name for name in recording.signals if name not in other.signals and name not in inside]
    return [only_in(str(recording.path), names)] if names else []


def only_in(path: str, names: Sequence[str]) -> str:
    """Return a sentence on signals of only one recording: the first few, and their number."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"only in {path}: {', '.join(names[:NAMED])}{more}"


def _different(first: Recording, second: Recording) -> list[str]:
    """Return sentences on other differences: rig, mode."""
    remarks = []
    if first.known_rig is None and second.known_rig is None and first.pdos:
        pass  # logs without a rig, with maps of EDS files or of their own
    elif first.rig.name != second.rig.name:
        remarks.append(f"recordings of different rigs: {first.rig.name} and {second.rig.name}")
    elif first.rig.effective() != second.rig.effective():
        remarks.append(f"the rig {first.rig.name} has other values in the second recording")
    modes = [recording.attachments.get("mode", b"").decode(errors="replace") for recording in (first, second)]
    if modes[0] != modes[1] and all(modes):
        remarks.append(f"recordings of different modes: {modes[0]} and {modes[1]}")
    return remarks


def _phases(recording: Recording) -> list[tuple[float, str]]:
    """Return the beginnings of the phases of all axes."""
    return [
        (t, text)
        for t, text in recording.markers
        if text.startswith("phase ") or ".phase " in text.partition(" ")[0] + " "
    ]


def _spans(first: Recording, second: Recording, *, exact: bool) -> tuple[list[CommonSpan], list[str], list[str]]:
    """Return the common stretches, and sentences on differing phases and lengths."""
    marks = _phases(first), _phases(second)
    empty = [r.path for r in (first, second) if not r.count]
    if empty:
        return [], [f"{path}: it has no frame" for path in empty], []
    times = [r.ends_s or (0.0, 0.0) for r in (first, second)]
    starts, ends = [begin for begin, _ in times], [max(end, 0.0) + 1.5e-9 for _, end in times]
    if not marks[0] or not marks[1]:
        lengths = [end - start for end, start in zip(ends, starts, strict=True)]
        remarks = [] if marks[0] == marks[1] else ["only one of the recordings has phases"]
        return [CommonSpan("whole", (starts[0], starts[1]), 0.0, min(lengths))], remarks, []
    names = [[text for _, text in phases] for phases in marks]
    count = next((k for k, (x, y) in enumerate(zip(*names, strict=False)) if x != y), min(map(len, names)))
    remarks = []
    if names[0] != names[1]:
        first_others = [texts[count] if count < len(texts) else "none" for texts in names]
        remarks = [
            f"the phases differ from number {count + 1} on: {first_others[0]!r} and {first_others[1]!r}; nothing behind is compared"
        ]
    spans, length_remarks = [], []
    if exact:
        zeros = marks[0][0][0], marks[1][0][0]
        spans.append(CommonSpan("before", zeros, -min(z - s for z, s in zip(zeros, starts, strict=True)), 0.0))
    for k in range(count):
        zeros, name = (marks[0][k][0], marks[1][k][0]), marks[0][k][1].replace("phase ", "")
        after = [phases[k + 1][0] if k + 1 < len(phases) else end for phases, end in zip(marks, ends, strict=True)]
        lengths = [end - zero for end, zero in zip(after, zeros, strict=True)]
        if abs(lengths[0] - lengths[1]) > 0.5 * (
            PERIOD_S if first.known_rig is None else first.rig.axes[0].bus.period_s
        ):
            length_remarks.append(f"phase {name}: {lengths[0]:.4f} s and {lengths[1]:.4f} s")
        if exact or name != "end":
            spans.append(CommonSpan(name, zeros, 0.0, min(lengths)))
    return spans, remarks, length_remarks


def _tallies(first: Recording, second: Recording, names: Sequence[str], spans: list[CommonSpan]) -> dict[str, Tally]:
    """Return what the differences of each signal come to, in one pass through both recordings."""
    is_long = first.is_streamed or second.is_streamed
    cursors = _Cursor(first, names), _Cursor(second, names)
    tallies = {name: Tally() for name in names}
    for span in spans:
        for ends_ns in pieces(span, is_long=is_long):
            begin_s, end_s = (time_ns / 1e9 for time_ns in ends_ns)
            a, b = (
                cursor.around(zero + begin_s, zero + end_s) for cursor, zero in zip(cursors, span.zero, strict=True)
            )
            for name, tally in tallies.items():
                tally.add(*_pair_in(a[name], b[name], span.zero, ends_ns), span.name)
        for tally in tallies.values():
            tally.end()
    return tallies


@dataclass(frozen=True)
class CommonSpan:
    """A common stretch: its time 0 in each recording, and its begin and end from there."""

    name: str
    zero: tuple[float, float]
    begin_s: float
    end_s: float

    @property
    def ends_ns(self) -> tuple[float, float]:
        """Begin and end in whole ns, so that the same sample has the same time in both."""
        begin, end = np.rint((self.begin_s * 1e9, self.end_s * 1e9))
        return float(begin), float(end)


def pieces(span: CommonSpan, *, is_long: bool) -> Iterator[tuple[float, float]]:
    """Yield begin and end [ns] of the pieces of a span."""
    begin, end = span.ends_ns
    while is_long and end - begin > PIECE_NS:
        yield begin, begin + PIECE_NS
        begin += PIECE_NS
    yield begin, end


def _pair_in(a: Series, b: Series, zero: tuple[float, float], ends_ns: tuple[float, float]) -> tuple[Pair, int]:
    """Return both signals at the first one's times between two times from `zero`, and the number of
    the second one's samples there; without them the values of the second are those around.
    """
    times = [np.rint((signal.t_s - at) * 1e9) for signal, at in zip((a, b), zero, strict=True)]
    inside, others = ((t >= ends_ns[0]) & (t < ends_ns[1]) for t in times)
    t_s, t_ns = a.t_s[inside], times[0][inside]
    values = b.values.astype(np.float64)
    if not len(values) or not len(t_s):
        other = np.full(len(t_s), np.nan)
    elif b.unit:
        other = np.interp(t_ns, times[1], values)
    else:
        other = values[np.maximum(np.searchsorted(times[1], t_ns, "right") - 1, 0)]
    return Pair(t_s, a.values[inside].astype(np.float64), other), int(np.count_nonzero(others))


class _Cursor:
    """The signals of a recording around a stretch of time that moves on; a short recording is given whole."""

    def __init__(self, recording: Recording, names: Collection[str]) -> None:
        self._names = names
        self._is_long = recording.is_streamed
        self._last_s = {name: recording.last_s(name) for name in names}
        self._blocks = iter(recording)
        self._parts: dict[str, Series] = {}

    def around(self, begin_s: float, end_s: float) -> dict[str, Series]:
        """Return each signal from a sample before a stretch to one behind it."""
        added: dict[str, list[Series]] = {name: [] for name in self._names}
        reached = {name: part.t_s[-1] for name, part in self._parts.items() if len(part)}
        while any(self._lacks(name, reached.get(name), end_s) for name in self._names):
            block = next(self._blocks, None)
            if block is None:
                break
            for name in self._names:
                part = block.signals[name]
                if len(part) or not self._is_long:
                    added[name].append(part)
                    reached[name] = part.t_s[-1] if len(part) else -np.inf
        for name, parts in added.items():
            here = [part for part in (self._parts.get(name), *parts) if part is not None]
            if not here:
                self._parts[name] = Series(np.zeros(0), np.zeros(0), "")
                continue
            first = here[0] if len(here) == 1 else _joined(here)
            begin = max(int(np.searchsorted(first.t_s, begin_s)) - 2, 0) if self._is_long else 0
            self._parts[name] = Series(first.t_s[begin:], first.values[begin:], first.unit)
        return self._parts

    def _lacks(self, name: str, reached_s: float | None, end_s: float) -> bool:
        last_s = self._last_s[name]
        return last_s is not None and (reached_s is None or (reached_s <= end_s and reached_s < last_s))


def _joined(parts: list[Series]) -> Series:
    t_s, values = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_s", "values"))
    return Series(t_s, values, parts[-1].unit)


@dataclass
class Tally:
    """What the differences of one signal come to."""

    samples: int = 0
    largest: float = 0.0
    at_s: float = 0.0
    phase: str = ""
    whole: bool = True
    """Whether both have the same number of samples in each span."""
    _squares: list[Floats] = field(default_factory=list)
    _sum: float | None = None
    """Of squares that are no longer kept."""
    _waiting: list[Pair] = field(default_factory=list)
    """Pieces of a span in which the second signal has no sample so far."""
    _counts: tuple[int, int] = (0, 0)
    """Samples of both in the span."""

    def add(self, pair: Pair, others: int, phase: str) -> None:
        """Add a piece of a span, in which the second signal has `others` samples."""
        self._counts = (self._counts[0] + len(pair.t_s), self._counts[1] + others)
        self._waiting.append(pair)
        if self._counts[1]:
            for part in self._waiting:
                if len(part.t_s):
                    self._add_part(part, phase)
            self._waiting = []

    def end(self) -> None:
        """End a span; it counts if both have samples in it."""
        self.whole = self.whole and self._counts[0] == self._counts[1]
        self._waiting, self._counts = [], (0, 0)

    def _add_part(self, pair: Pair, phase: str) -> None:
        apart = np.abs(pair.difference)
        apart = np.where(np.isnan(apart), np.inf, apart)
        at = int(np.argmax(apart))
        if not self.samples or apart[at] > self.largest:
            self.largest, self.at_s, self.phase = float(apart[at]), float(pair.t_s[at]), phase
        self.samples += len(apart)
        self._squares.append(apart**2)
        if sum(map(len, self._squares)) > SUMMED:
            self._sum = (self._sum or 0.0) + float(np.sum(np.concatenate(self._squares)))
            self._squares = []

    @property
    def rms(self) -> float:
        """Root mean square of the differences."""
        rest = np.concatenate([np.zeros(0), *self._squares])
        if self._sum is None:
            return float(np.sqrt(np.mean(rest)))
        return float(np.sqrt((self._sum + float(np.sum(rest))) / self.samples))


class _Pairs(Mapping[str, Pair]):
    """Each signal of both recordings at the same times, made when it is asked for."""

    def __init__(self, first: Recording, second: Recording, names: Sequence[str], spans: list[CommonSpan]) -> None:
        self._first, self._second, self._names, self._spans = first, second, names, spans

    def __getitem__(self, name: str) -> Pair:
        if name not in self._names:
            raise KeyError(name)
        a, b = self._first[name], self._second[name]
        parts = [pair for span in self._spans for pair, others in [_pair_in(a, b, span.zero, span.ends_ns)] if others]
        columns = [np.concatenate([np.zeros(0), *(getattr(part, key) for part in parts)]) for key in ("t_s", "a", "b")]
        return Pair(*columns)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _difference(name: str, unit: str, tally: Tally, tolerance: float | None, whole: bool) -> Difference:
    if not tally.samples:
        return Difference(name, unit, 0, 0.0, 0.0, None, "", tolerance, tolerance is None or whole)
    largest = tally.largest
    equal = tolerance is None or (largest <= tolerance and whole)
    when = tally.at_s if largest else None
    phase = tally.phase if largest else ""
    return Difference(name, unit, tally.samples, largest, tally.rms, when, phase, tolerance, equal)
