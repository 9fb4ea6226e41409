"""A recording as arrays: every signal of the rig's PDOs by name, in SI units.

::

    recording = read("hybrid.pcapng")
    angle = recording["motor.position_rad"]
    angle.t_s, angle.values, angle.unit          # two arrays and "rad"
    recording.markers                            # [(1.004, "phase hold"), ...]

`recording.reading` opens it. A loop over it gets its blocks (`recording.block`), some seconds each. A
position is unwrapped (`recording.unwrap`), so that its angle continues where a device's 16-bit
counter wraps; `frames` has the raw frames.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records, new_records
from coulombus.recording.block import (
    Block,
    Overview,
    SignalsOfBlocks,
    Source,
    decode,
    epoch_of,
    left_out_of,
    markers_of,
    series,
)
from coulombus.recording.bus_match import BusMatch
from coulombus.recording.captures import captures, parts_of
from coulombus.recording.file_content import HOST, Capture, joined, remarks_on
from coulombus.recording.host_telemetry import of_axis
from coulombus.recording.pdo_columns import PdoTable, Series, UnknownSignal, joined_table, one_signal, signal_of
from coulombus.recording.time_search import ALL, WHOLE, Span, Window
from coulombus.recording.unwrap import POSITION, Turns
from coulombus.recording.wall_clock import CLOCK, META, attached_object
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.wire.frame import Frame

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

__all__ = ["Recording", "Series", "Source", "UnknownSignal", "series", "signal_of"]

Array: TypeAlias = npt.NDArray[Any]
Floats: TypeAlias = npt.NDArray[np.float64]

LONG_COUNTER = 32
"""Bits of a counter that is taken not to overflow."""
LATEST_NS = 1 << 62


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Source):
    """A recording, read when something of it is asked for; ``recording["motor.position_rad"]`` is a `Series`.

    A loop over it reads its file and gets its blocks. Markers and counts are those of one pass. A
    signal is read in another pass, and kept then: 16 bytes for each sample. `frames`, `capture` and
    `tables` read and keep everything. Of a short recording the content is kept from the beginning.

    Attributes
    ----------
    path
        The file.
    known_rig
        The rig of these PDOs, attached or given; None: there is none, and `rig` raises.
    inside, bare
        PDOs of the host's telemetry; and without a rig those whose maps are known.
    channel
        Bus of the file, as `read` takes it.
    recorded
        The rig's bus that the recording names.
    first_rows
        Without a rig: the row at which the map of each PDO begins, by its identifier.
    span
        Begin and end [s], None: open.
    content
        The whole file, of a short recording; None: each pass reads the file.
    axis, file_rig
        Of a view of one axis: its name, and the rig of all axes.
    origin
        The recording of which this is a view: it gets the remarks, too.
    """

    path: str
    known_rig: Rig | None
    inside: tuple[RigPdo, ...] = ()
    bare: tuple[RigPdo, ...] = ()
    channel: tuple[str, ...] = ()
    recorded: str = ""
    first_rows: Mapping[int, int] = field(default_factory=dict)
    span: Span = WHOLE
    content: Capture | None = None
    axis: str = ""
    file_rig: Rig | None = None
    origin: Recording | None = None
    _remarks: list[tuple[str, ...]] = field(default_factory=list, init=False)
    """Of the last complete pass; empty before."""

    @property
    def is_streamed(self) -> bool:
        """Whether each pass reads the file."""
        return self.content is None

    def __iter__(self) -> Iterator[Block]:
        """Yield the blocks."""
        return self._decoded() if self.is_streamed else iter(self._blocks)

    @cached_property
    def _blocks(self) -> tuple[Block, ...]:
        """All blocks, which are kept; of a short recording there is one."""
        return tuple(self._decoded())

    def _stretches(self, window: Window = ALL) -> Iterator[Capture]:
        return captures(self.path, window) if self.content is None else iter((self.content,))

    def _decoded(self) -> Iterator[Block]:
        """Yield the blocks; after the last the remarks are known."""
        epoch_ns, left_out, warnings, turns = None, Counter[str](), list[str](), dict[str, Turns]()
        window, is_searched = self._window(), self._is_searched()
        match = self._match()
        row = 0
        for stretch in self._stretches(window if is_searched else ALL):
            if epoch_ns is None and len(stretch.frames):  # of any bus: all buses of a file have one time 0
                epoch_ns = epoch_of(stretch.frames)
            capture = match.select(stretch)
            for part, begin, is_in_window in parts_of(capture, window):
                if is_searched and not is_in_window:
                    continue
                begins = {cob_id: first - row - begin for cob_id, first in self.first_rows.items()}
                block = decode(part, self.known_rig, epoch_ns, turns, self.inside, self.bare, begins)
                turns |= block.turns
                if is_in_window:
                    if self.file_rig is not None:
                        block = replace(block, markers=markers_of(self.axis, self.file_rig, block.markers))
                    left_out.update(left_out_of(block))
                    yield block
            row += len(capture.frames)
            warnings += capture.warnings
        remarks = remarks_on(self.path, [*warnings, *match.remarks(), *self._remaps()], left_out)
        self._remarks[:] = [remarks]
        if self.origin is not None:
            earlier = (text for texts in self.origin._remarks for text in texts)
            self.origin._remarks[:] = [tuple(dict.fromkeys((*earlier, *remarks)))]

    def _match(self) -> BusMatch:
        """Return the match of the recording's buses with the rig's, or with one bus."""
        rig = self.file_rig or self.known_rig
        if rig is None:
            return BusMatch.without_rig(self.path, self.channel)
        return BusMatch(self.path, rig.channels, self.channel, self.recorded)

    def _remaps(self) -> Iterator[str]:
        """Yield sentences on PDOs with an earlier map, whose frames are in no signal."""
        for pdo in self.bare:
            row = self.first_rows[pdo.layout.cob_id]
            if row:
                yield f"{self.path}: {pdo.node}.{pdo.name} got another map at frame {row}: its signals begin there"

    def _window(self) -> Window:
        """Return the span in stamps."""
        if self.span == WHOLE:
            return ALL
        stamps = (capture.frames for capture in captures(self.path) if len(capture.frames))
        epoch_ns = next(map(epoch_of, stamps), 0)
        begin, end = self.span
        return Window(
            None if begin is None else epoch_ns + math.floor(begin * 1e9),
            None if end is None else epoch_ns + math.ceil(end * 1e9),
        )

    def _is_searched(self) -> bool:
        """Return whether frames before the span may be left out: no map is learned from them, and no
        counter overflows in them.
        """
        if self.known_rig is None:
            return False
        fields = ((e, s) for pdo in self.known_rig.pdos() for e, s in zip(pdo.layout.entries, pdo.signals, strict=True))
        return all(entry.bits >= LONG_COUNTER for entry, signal in fields if signal.key == POSITION)

    def within(self, begin_s: float, end_s: float) -> Recording:
        """Return the blocks of a stretch of time; frames before it are not read where that is possible."""
        if not self.is_streamed:
            return self
        return replace(self, span=(begin_s, end_s), origin=self)

    def extent(self) -> tuple[float, float] | None:
        """Return the times of the first and the last frame [s]; None without a frame.

        Of a recording of this project only its two ends are read, or decoded where it is compressed.
        """
        if not self.is_streamed or self.span != WHOLE or self.axis:
            return super().extent()
        firsts = (capture for capture in captures(self.path) if len(capture.frames))
        first = next(firsts, None)
        if first is None:
            return None
        epoch_ns, times = epoch_of(first.frames), list[int]()
        of_bus = (capture for capture in map(self._match().select, captures(self.path)) if len(capture.frames))
        ends = map(self._match().select, captures(self.path, Window(begin_ns=LATEST_NS)))
        for part in (*itertools.islice(of_bus, 1), *ends):
            if len(part.frames):
                times += part.frames["t_ns"][[0, -1]].tolist()
                times = [min(times), max(times)]
        return ((times[0] - epoch_ns) / 1e9, (times[1] - epoch_ns) / 1e9) if times else None

    def seen_by(self, axis: str) -> Recording:
        """Return the view of the axis of this name, with the signals' plain names.

        Markers of other axes are left out.
        """
        if not axis:
            return self
        rig, inside = self.rig, of_axis(self.inside, axis)
        return replace(self, known_rig=rig.alone(axis), inside=inside, axis=axis, file_rig=rig, origin=None)

    @cached_property
    def _overview(self) -> Overview:
        """Everything that is known after a pass."""
        overview = Overview()
        for block in self:
            overview.add(block)
            overview.attachments |= {
                name: data
                for name, data in block.attachments.items()
                if not self.is_streamed or not name.startswith(HOST)
            }
        (overview.remarks,) = self._remarks
        return overview

    def read_through(self) -> None:
        """Decode a short recording, gather markers and counts of a long one, so that errors of the file come now."""
        self._overview if self.is_streamed else self._blocks  # noqa: B018

    @property
    def markers(self) -> list[tuple[float, str]]:
        """(time [s], text) of each line of the comments, in the file's order; then those that no frame follows."""
        return self._overview.markers

    @property
    def malformed(self) -> Mapping[str, int]:
        """ "motor.TPDO1" -> frames of a wrong length, which are omitted from the signals."""
        return self._overview.malformed

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attached files by name; those of the host's replay are kept of a short recording only."""
        return self._overview.attachments

    @property
    def epoch_ns(self) -> int:
        """Time 0 of all `t_s`: 0 in virtual time, else the first frame's stamp."""
        return self._overview.epoch_ns

    @property
    def before(self) -> Mapping[str, Turns]:
        """Each position before the first frame."""
        return self._overview.before or {}

    @property
    def turns(self) -> Mapping[str, Turns]:
        """The last value of each position."""
        return self._overview.turns

    @property
    def count(self) -> int:
        """Number of frames."""
        return self._overview.count

    @property
    def ends_s(self) -> tuple[float, float] | None:
        """Least and largest time of a frame [s]; None without a frame."""
        return self._overview.ends_s

    @property
    def duration_s(self) -> float:
        """Time from the first to the last frame [s]."""
        begin_s, end_s = self.ends_s or (0.0, 0.0)
        return end_s - begin_s

    def samples(self, name: str) -> int:
        """Return the number of samples of a signal."""
        return self._overview.samples.get(self.tables_of[name], 0)

    def last_s(self, name: str) -> float | None:
        """Return the time of a signal's last sample [s]; None without a sample."""
        return self._overview.last_s.get(self.tables_of[name])

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on omitted data: a torn end, damaged attachments, other packets, malformed
        PDOs; and on gaps in which a position may have wrapped unseen.
        """
        if not self._remarks or "_overview" in vars(self):
            return self._overview.remarks
        return self._remarks[0]

    @cached_property
    def signals(self) -> Mapping[str, Series]:
        """Name -> `Series`, in the order of the rig's PDOs; empty for a PDO that was never received."""
        if not self.is_streamed:
            return self._blocks[0].signals
        return SignalsOfBlocks(self, self._overview.samples)

    @cached_property
    def capture(self) -> Capture:
        """The file's raw content."""
        if not self.is_streamed:
            return self._blocks[0].capture
        if not self._blocks:
            return Capture(self.path, new_records(Frame, 0), comments=[], attachments={})
        return joined(self.path, [block.capture for block in self._blocks])

    @cached_property
    def tables(self) -> tuple[PdoTable, ...]:
        """The frames of each PDO."""
        if not self.is_streamed:
            return self._blocks[0].tables
        firsts = np.cumsum([0, *(len(block.frames) for block in self._blocks)]).tolist()
        inside = np.cumsum([0, *(len(block.capture.inside) for block in self._blocks)]).tolist()
        of_each = zip(*(block.tables for block in self._blocks), strict=True)
        return tuple(joined_table(parts, inside if parts[0].inside else firsts, firsts) for parts in of_each)

    @property
    def frames(self) -> Records:
        """All frames, records of `wire.frame.Frame`."""
        return self.capture.frames

    @property
    def t_s(self) -> Floats:
        """Time of each frame [s]."""
        return (self.frames["t_ns"] - self.epoch_ns) / 1e9

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

    def __getitem__(self, name: str) -> Series:
        """Return a signal; `UnknownSignal`, a KeyError, names the nearest ones."""
        if not isinstance(name, str):
            raise WrongCall(one_signal(name))
        if name not in self.signals:
            self.signal(name)
        return self.signals[name]

    def __repr__(self) -> str:
        """Return it in one line."""
        return f"<recording {self.path} {self._rig_text()}: {self._summary()}>"

    def _repr_html_(self) -> str:
        """Return the signals as a table, for notebooks."""
        head = f"<p>{escape(self.path)} {escape(self._rig_text())}, {self._summary()}</p>"
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(signal.unit)}</td><td>{len(signal)}</td>"
            + "".join(f"<td>{value:.6g}</td>" for value in _range(signal.values))
            + "</tr>"
            for name, signal in self.signals.items()
        )
        columns = "".join(f"<th>{text}</th>" for text in ("signal", "unit", "samples", "least", "largest"))
        return f"{head}<table><tr>{columns}</tr>{rows}</table>"

    def _rig_text(self) -> str:
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
        from coulombus.recording.sample_groups import to_pandas

        return to_pandas(self, signals, grid_s)

    def to_xarray(self, signals: Sequence[str] | None = None, *, grid_s: float | None = None) -> xarray.Dataset:
        """Return a Dataset: a variable for each signal with the attribute ``units``.

        Signals of one PDO share a dimension, as ``t_s.motor.TPDO1`` [s]; with `grid_s` all share
        ``t_s``. Errors as `to_pandas`.
        """
        from coulombus.recording.sample_groups import to_xarray

        return to_xarray(self, signals, grid_s)

    def plot(self, signals: Sequence[str] | None = None, *, span: Span = WHOLE) -> Figure:
        """Return a figure of the signals (None: all but bit fields) over `span` [s]; dense samples
        are drawn as an envelope of least and largest values.

        Raises
        ------
        UnknownSignal
            A signal that the recording does not have.
        coulombus.rigs.arguments.WrongCall
            `signals` is no list of texts, or `span` no pair of times.
        coulombus.recording.time_search.SpanError
            There is no frame in the span.
        """
        from coulombus.recording.pictures.plot import plot

        return plot(self, signals, span)


def _range(values: Array) -> tuple[float, float]:
    """Return the least and the largest value; NaN without values."""
    return (float(values.min()), float(values.max())) if len(values) else (float("nan"), float("nan"))
