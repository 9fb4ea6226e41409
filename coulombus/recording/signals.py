"""A recording as arrays: every signal of the rig's PDOs by name, in SI units.

::

    recording = read("hybrid.pcapng")
    angle = recording["motor.position_rad"]
    angle.t_s, angle.values, angle.unit          # two arrays and "rad"
    recording.markers                            # [(1.004, "phase hold"), ...]

`recording.reading` reads it from a file. A position is unwrapped (`recording.unwrap`), so that its
angle continues where a device's 16-bit counter wraps; `frames` has the raw frames. `series`
extracts single signals of a streamed recording.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.file_content import Capture
from coulombus.recording.host_telemetry import of_axis
from coulombus.recording.log_files import WALL_CLOCK_NS
from coulombus.recording.pdo_columns import PdoTable, bare_tables, behind, rig_tables, table_of
from coulombus.recording.remarks import UNSURE, remarks_on
from coulombus.recording.signal_names import UnknownSignal, are_texts, one_signal, signal_of
from coulombus.recording.signal_series import Series, SignalsOfTables
from coulombus.recording.unwrap import Turns
from coulombus.recording.wall_clock import CLOCK, META, attached_object
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import Rig, RigError
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.wire.frame import Records

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

__all__ = [
    "Recording",
    "Series",
    "Source",
    "UnknownSignal",
    "decode",
    "epoch_of",
    "left_out_of",
    "markers_of",
    "remarks_on",
    "series",
    "signal_of",
]

GIVE_RIG = "give one: read(path, rig=...), or --rig on the command line"
Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]


class Source:
    """A source of figures: the recording's blocks in sequence, each a `Recording` with absolute times."""

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

    def __iter__(self) -> Iterator[Recording]:
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

    def signal(self, name: str) -> Signal:
        """Return the definition of a signal: object, scale, offset, unit; `UnknownSignal` names the nearest ones."""
        return signal_of(self.pdos, name, self.path)

    def scale(self, name: str) -> float:
        """Return the SI value of one raw count of a signal."""
        return self.signal(name).scale


@dataclass(frozen=True, repr=False)
class Recording(Source):
    """A recording, decoded; ``recording["motor.position_rad"]`` is a `Series`.

    Attributes
    ----------
    path
        The file.
    known_rig
        The rig of these PDOs, attached or given; None: there is none, and `rig` raises.
    capture
        The file's raw content: frames, comments, attachments, torn bytes.
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

    def __iter__(self) -> Iterator[Recording]:
        """Yield the recording itself as a single block."""
        yield self

    def seen_by(self, axis: str) -> Recording:
        """Return the view of the axis of this name, with the signals' plain names.

        Markers of other axes are left out.
        """
        if not axis:
            return self
        plain = {name.removeprefix(f"{axis}."): turns for name, turns in self.before.items()}
        seen = decode(self.capture, self.rig.alone(axis), self.epoch_ns, plain, of_axis(self.inside, axis))
        return replace(seen, markers=markers_of(axis, self.rig, seen.markers))

    @property
    def frames(self) -> Records:
        """All frames, records of `wire.frame.Frame`."""
        return self.capture.frames

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attached files by name."""
        return self.capture.attachments

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def samples(self, name: str) -> int:
        """Return the number of samples of a signal."""
        return len(self.signals[name])

    def last_s(self, name: str) -> float | None:
        """Return the time of a signal's last sample [s]; None without a sample."""
        return float(self.signals[name].t_s[-1]) if self.samples(name) else None

    @property
    def ends_s(self) -> tuple[float, float] | None:
        """Least and largest time of a frame [s]; None without a frame."""
        return (float(self.t_s.min()), float(self.t_s.max())) if self.count else None

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame [s]."""
        return float(np.ptp(self.t_s)) if len(self.frames) else 0.0

    @property
    def clock(self) -> Mapping[str, Any]:
        """Wall-clock time of time 0, and the synchronisation of that clock
        (`recording.wall_clock`); empty in virtual time.
        """
        return attached_object(self.attachments.get(CLOCK))

    @property
    def meta(self) -> Mapping[str, Any]:
        """The user's notes on the recording (``run --meta``)."""
        return attached_object(self.attachments.get(META))

    @property
    def t_s(self) -> Floats:
        """Time of each frame [s]."""
        return (self.frames["t_ns"] - self.epoch_ns) / 1e9

    @property
    def turns(self) -> Mapping[str, Turns]:
        """The last value of each position."""
        return {name: turns for table in self.tables for name, turns in table.turns.items()}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on omitted data: a torn end, damaged attachments, other packets, malformed
        PDOs; and on gaps in which a position may have wrapped unseen.
        """
        return remarks_on(self.path, self.capture.warnings, left_out_of(self))

    def __getitem__(self, name: str) -> Series:
        """Return a signal; `UnknownSignal`, a KeyError, names the nearest ones."""
        if not isinstance(name, str):
            raise WrongCall(one_signal(name))
        if name not in self.signals:
            self.signal(name)
        return self.signals[name]

    def __repr__(self) -> str:
        """Return it in one line."""
        return f"<recording {self.path} {self._of()}: {self._summary()}>"

    def _repr_html_(self) -> str:
        """Return the signals as a table, for notebooks."""
        head = f"<p>{escape(self.path)} {escape(self._of())}, {self._summary()}</p>"
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(signal.unit)}</td><td>{len(signal)}</td>"
            + "".join(f"<td>{value:.6g}</td>" for value in _range(signal.values))
            + "</tr>"
            for name, signal in self.signals.items()
        )
        columns = "".join(f"<th>{text}</th>" for text in ("signal", "unit", "samples", "least", "largest"))
        return f"{head}<table><tr>{columns}</tr>{rows}</table>"

    def _of(self) -> str:
        return "without a rig" if self.known_rig is None else f"of rig {self.known_rig.name}"

    def _summary(self) -> str:
        """Return its length and content as a text."""
        return f"{self.duration_s:.3f} s, {self.count} frames, {len(self.signals)} signals, {len(self.markers)} markers"

    def to_pandas(self, signals: Sequence[str] | None = None, *, grid_s: float | None = None) -> pandas.DataFrame:
        """Return a DataFrame: a column for each signal, indexed by the time ``t_s`` [s].

        Without a grid each frame of a PDO is a row, with NaN in the columns of the other PDOs:
        ``table["motor.position_rad"].dropna()`` is that signal's `Series`, and ``table.ffill()``
        holds the values. With `grid_s` there is a row for each of its multiples, with the last
        values received by then. ``table.attrs["units"]`` has the units.

        Raises
        ------
        UnknownSignal
            A signal that the recording does not have.
        coulombus.rigs.arguments.WrongCall
            `signals` is no list of texts.
        coulombus.recording.extras.MissingExtra
            pandas is not installed.
        """
        from coulombus.recording.frames_table import to_pandas

        return to_pandas(self, signals, grid_s)

    def to_xarray(self, signals: Sequence[str] | None = None, *, grid_s: float | None = None) -> xarray.Dataset:
        """Return a Dataset: a variable for each signal with the attribute ``units``.

        Signals of one PDO share a dimension, as ``t_s.motor.TPDO1`` [s]; with `grid_s` all share
        ``t_s``. Errors as `to_pandas`.
        """
        from coulombus.recording.frames_table import to_xarray

        return to_xarray(self, signals, grid_s)

    def plot(
        self, signals: Sequence[str] | None = None, *, span: tuple[float | None, float | None] = (None, None)
    ) -> Figure:
        """Return a figure of the signals (None: all but bit fields) over `span` [s]; dense samples
        are drawn as an envelope of least and largest values.

        Raises
        ------
        UnknownSignal
            A signal that the recording does not have.
        coulombus.rigs.arguments.WrongCall
            `signals` is no list of texts, or `span` no pair of times.
        coulombus.recording.span.SpanError
            There is no frame in the span.
        """
        from coulombus.recording.pictures.plot import plot

        return plot(self, signals, span)


def _range(values: Array) -> tuple[float, float]:
    """Return the least and the largest value; NaN without values."""
    return (float(values.min()), float(values.max())) if len(values) else (float("nan"), float("nan"))


def markers_of(axis: str, rig: Rig, markers: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Return the markers of an axis of `rig`: its own phases by plain names, without those of other axes."""
    own = f"{axis}.phase "
    others = tuple(f"{other}.phase " for other in rig.axis_names if other != axis)
    return [
        (t_s, text.removeprefix(f"{axis}.") if text.startswith(own) else text)
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
    gathered = [[block[name] for name in names] for block in source]
    return tuple(
        Series(
            np.concatenate([part.t_s for part in parts]), np.concatenate([part.values for part in parts]), parts[0].unit
        )
        for parts in zip(*gathered, strict=True)
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
) -> Recording:
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
    return Recording(
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


def left_out_of(block: Recording) -> Counter[str]:
    """Return the amount of omitted data by reason."""
    doubts = {
        f"{UNSURE}{name}": turns.doubts - (block.before[name].doubts if name in block.before else 0)
        for name, turns in block.turns.items()
    }
    return Counter({"torn": block.capture.torn, "skipped": block.capture.skipped, **block.malformed, **doubts})
