"""Compare two recordings: two runs, or a simulated run and the rig's.

They are aligned by phase: time counts from the beginning of each phase, and the comparison ends
with the shorter one. A value of the other recording at a sample's time is interpolated linearly; a
word of bits is held. Without a tolerance everything must be equal: phases, numbers of samples, and
the parts before the first phase and after the last. With tolerances only the phases are compared,
and only signals with a tolerance are judged.
"""

from __future__ import annotations

import filecmp
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.bus_match import Channel
from coulombus.recording.difference import Comparison, Difference, Pair
from coulombus.recording.reading import read
from coulombus.recording.signal_names import UnknownSignal
from coulombus.recording.signals import Recording, Series
from coulombus.rigs.arguments import WrongCall, path_text
from coulombus.rigs.rig import Rig

__all__ = ["compare", "only_in"]

Floats: TypeAlias = npt.NDArray[np.float64]
NO_TOLERANCES: Mapping[str, float] = MappingProxyType({})
ALL = ""
"""Key of the tolerance for every signal with a unit."""
NAMED = 4
"""Signals that a sentence names; the others are counted."""


@dataclass(frozen=True)
class _Span:
    """A common stretch: its time 0 in each recording, and its begin and end from there."""

    name: str
    zero: tuple[float, float]
    begin_s: float
    end_s: float


def compare(
    a: str | os.PathLike[str],
    b: str | os.PathLike[str],
    *,
    tolerances: Mapping[str, float] = NO_TOLERANCES,
    rig: Rig | str | os.PathLike[str] | None = None,
    channel: Channel = None,
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

    Raises
    ------
    coulombus.recording.signals.UnknownSignal
        A tolerance names neither a signal nor a unit of the recordings.
    coulombus.rigs.rig.RigError, coulombus.recording.pcapng_blocks.PcapngError
        See `read`.
    coulombus.rigs.arguments.WrongCall
        An argument has the wrong type.
    """
    a, b = (path_text(path, name, 'compare("a.pcapng", "b.pcapng")') for name, path in (("a", a), ("b", b)))
    _check_types(tolerances)
    first, second = read(a, rig, channel), read(b, rig, channel)
    common = [name for name in first.signals if name in second.signals]
    units = {name: first.signals[name].unit for name in common}
    inside = {signal.name for pdo in first.inside for signal in pdo.signals}
    _check_tolerances(first, tolerances, units)
    texts = (*first.remarks, *second.remarks)
    same = not Path(a).is_dir() and not Path(b).is_dir() and filecmp.cmp(a, b, shallow=False)
    spans, phase_remarks, lengths = _spans(first, second, exact=not tolerances)
    wanting = _only_in(first, second) + _only_in(second, first)
    if bool(first.inside) != bool(second.inside):
        lengths = [*lengths, f"only {(first if first.inside else second).path} has what the host told of itself"]
    differences, pairs = [], {}
    for name in common:
        pair, labels, whole = _pair(first.signals[name], second.signals[name], spans)
        tolerance = _tolerance(name, "" if name in inside else units[name], tolerances)
        pairs[name] = pair
        if tolerances:  # runs of different length are compared over the shorter one
            whole = bool(len(pair.t_s)) or not len(first.signals[name]) + len(second.signals[name])
        differences.append(_difference(name, units[name], pair, labels, tolerance, whole))
    equal = same or (
        all(difference.equal for difference in differences)
        and not phase_remarks
        and not wanting
        and not (lengths and not tolerances)
    )
    remarks = (*texts, *_different(first, second), *wanting, *phase_remarks, *lengths)
    return Comparison(str(a), str(b), same, equal, tuple(differences), remarks, MappingProxyType(pairs))


def _check_types(tolerances: Mapping[str, float]) -> None:
    """Raise unless it is a mapping of names to numbers."""
    if isinstance(tolerances, Mapping):
        wrong = next(((key, value) for key, value in tolerances.items() if not _is_number(value)), None)
        if wrong is None:
            return
        raise WrongCall(f'tolerances[{wrong[0]!r}] is {wrong[1]!r}: expected a number, as in tolerances={{"Nm": 0.1}}')
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
                known = ", ".join(sorted({unit for unit in units.values() if unit}))
                raise UnknownSignal(f"a tolerance for {name!r}: {error}; or a unit: {known}") from None


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
    if first.rig.name != second.rig.name:
        remarks.append(f"recordings of different rigs: {first.rig.name} and {second.rig.name}")
    elif first.rig.effective() != second.rig.effective():
        remarks.append(f"the rig {first.rig.name} has other values in the second recording")
    modes = [recording.capture.attachments.get("mode", b"").decode(errors="replace") for recording in (first, second)]
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


def _spans(first: Recording, second: Recording, *, exact: bool) -> tuple[list[_Span], list[str], list[str]]:
    """Return the common stretches, and sentences on differing phases and lengths."""
    marks = _phases(first), _phases(second)
    ends = [float(r.t_s.max(initial=0.0)) + 1.5e-9 for r in (first, second)]
    starts = [float(r.t_s.min(initial=np.inf)) for r in (first, second)]
    if not all(map(len, ends_of := [r.frames for r in (first, second)])):
        empty = [r.path for r, frames in zip((first, second), ends_of, strict=True) if not len(frames)]
        return [], [f"{path}: it has no frame" for path in empty], []
    if not marks[0] or not marks[1]:
        lengths = [end - start for end, start in zip(ends, starts, strict=True)]
        remarks = [] if marks[0] == marks[1] else ["only one of the recordings has phases"]
        return [_Span("whole", (starts[0], starts[1]), 0.0, min(lengths))], remarks, []
    names = [[text for _, text in phases] for phases in marks]
    count = next((k for k, (x, y) in enumerate(zip(*names, strict=False)) if x != y), min(map(len, names)))
    remarks = []
    if names[0] != names[1]:
        there = [texts[count] if count < len(texts) else "none" for texts in names]
        remarks = [
            f"the phases differ from number {count + 1} on: {there[0]!r} and {there[1]!r}; nothing behind is compared"
        ]
    spans, length_remarks = [], []
    if exact:
        zeros = marks[0][0][0], marks[1][0][0]
        spans.append(_Span("before", zeros, -min(z - s for z, s in zip(zeros, starts, strict=True)), 0.0))
    for k in range(count):
        zeros, name = (marks[0][k][0], marks[1][k][0]), marks[0][k][1].replace("phase ", "")
        after = [phases[k + 1][0] if k + 1 < len(phases) else end for phases, end in zip(marks, ends, strict=True)]
        lengths = [end - zero for end, zero in zip(after, zeros, strict=True)]
        if abs(lengths[0] - lengths[1]) > 0.5 * first.rig.axes[0].bus.period_s:
            length_remarks.append(f"phase {name}: {lengths[0]:.4f} s and {lengths[1]:.4f} s")
        if exact or name != "end":
            spans.append(_Span(name, zeros, 0.0, min(lengths)))
    return spans, remarks, length_remarks


def _pair(a: Series, b: Series, spans: list[_Span]) -> tuple[Pair, list[tuple[int, str]], bool]:
    """Return both signals at the first one's times, the beginning of each span in them, and whether
    both have the same number of samples in each span.
    """
    parts, labels, whole, at = [], [], True, 0
    for span in spans:
        # in whole ns, so that the same sample has the same time in both
        times = [np.rint((signal.t_s - zero) * 1e9) for signal, zero in zip((a, b), span.zero, strict=True)]
        begin, end = np.rint((span.begin_s * 1e9, span.end_s * 1e9))
        inside = [(t >= begin) & (t < end) for t in times]
        whole = whole and int(inside[0].sum()) == int(inside[1].sum())
        t_s, t_ns = a.t_s[inside[0]], times[0][inside[0]]
        if not len(t_s) or not inside[1].any():
            continue
        values = b.values.astype(np.float64)
        if b.unit:
            other = np.interp(t_ns, times[1], values)
        else:
            other = values[np.maximum(np.searchsorted(times[1], t_ns, "right") - 1, 0)]
        parts.append((t_s, a.values[inside[0]].astype(np.float64), other))
        labels.append((at, span.name))
        at += len(t_s)
    t_s, mine, theirs = (
        (np.concatenate([np.zeros(0), *columns]) for columns in zip(*parts, strict=True))
        if parts
        else (np.zeros(0),) * 3
    )
    return Pair(t_s, mine, theirs), labels, whole


def _difference(
    name: str, unit: str, pair: Pair, labels: list[tuple[int, str]], tolerance: float | None, whole: bool
) -> Difference:
    apart = np.abs(pair.difference)
    if not len(apart):
        return Difference(name, unit, 0, 0.0, 0.0, None, "", tolerance, tolerance is None or whole)
    apart = np.where(np.isnan(apart), np.inf, apart)
    at = int(np.argmax(apart))
    largest, rms = float(apart[at]), float(np.sqrt(np.mean(apart**2)))
    phase = next(label for begin, label in reversed(labels) if begin <= at)
    equal = tolerance is None or (largest <= tolerance and whole)
    when = float(pair.t_s[at]) if largest else None
    return Difference(name, unit, len(apart), largest, rms, when, phase if largest else "", tolerance, equal)
