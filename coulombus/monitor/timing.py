"""Timing of frames: rate and jitter of each identifier, and the delay of each PDO after SYNC.

The period of an identifier is the median of the times between its frames. The jitter of a frame is
the deviation of its interval from that. All times are the frames' own stamps. Intervals and delays
are counted, not kept, so that the memory does not grow with a recording.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import PDO_NAMES, CobId
from coulombus.recording.bus_match import Channel
from coulombus.recording.captures import captures_of_bus
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.maps.log_maps import LogMaps
from coulombus.recording.signals import Source
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.handshake import Flags, Hello

__all__ = [
    "Spread",
    "Stamps",
    "TimeCounts",
    "Timing",
    "as_dict",
    "as_lines",
    "listen",
    "recorded",
    "recorded_bare",
    "timing",
]

Integers = npt.NDArray[np.int64]
NONE = np.zeros(0, np.int64)
WAIT_S = 0.1
MOST_WAITING = 4096
"""Frames of a live bus that wait to be counted."""
UNCOUNTED = 1 << 16
"""Times that wait to be counted."""
NAMES = {int(service): service.name for service in CobId}
FUNCTION = 0x780
NODE_SERVICES = {
    int(CobId.EMCY): "EMCY",
    int(CobId.SDO_TX): "SDO tx",
    int(CobId.SDO_RX): "SDO rx",
    int(CobId.HEARTBEAT): "heartbeat",
}

UNITS = {"us": 1.0, "ms": 1e3, "s": 1e6}
"""Units of the table's times [us]."""
MOST = 99_999.5
"""Largest number that has five characters."""


class TimeCounts:
    """How often each time [ns] came, for exact quantiles: a cycle's times repeat, or differ by its jitter."""

    def __init__(self, times_ns: Integers = NONE, counts: Integers = NONE) -> None:
        self._times, self._counts = times_ns, counts
        self._waiting: list[Integers] = []
        self._size = 0

    def add(self, times_ns: Integers) -> None:
        """Count times."""
        self._waiting.append(times_ns)
        self._size += len(times_ns)
        if self._size >= UNCOUNTED:
            self._count()

    def _count(self) -> None:
        times, counts = np.unique(np.concatenate([NONE, *self._waiting]), return_counts=True)
        self._waiting, self._size = [], 0
        self._times, places = np.unique(np.concatenate((self._times, times)), return_inverse=True)
        sums = np.zeros(len(self._times), np.int64)
        np.add.at(sums, places, np.concatenate((self._counts, counts)))
        self._counts = sums

    def __len__(self) -> int:
        return int(self._counts.sum()) + self._size

    def at(self, place: float) -> float:
        """Return the time at a place of the sorted times, counted from 0, interpolated as `numpy.percentile` does."""
        self._count()
        ends = np.cumsum(self._counts)
        begin = int(place)
        rows = np.searchsorted(ends, [begin, min(begin + 1, int(ends[-1]) - 1)], "right")
        low, high = self._times[rows].tolist()
        share = place - begin
        return float(low + (high - low) * share if share < 0.5 else high - (high - low) * (1 - share))

    def percentiles(self, percents: Sequence[float]) -> list[float]:
        """Return percentiles [ns]."""
        return [self.at((len(self) - 1) * (percent / 100)) for percent in percents]

    def median(self) -> float:
        """Return the median [ns]; of an even number the mean of the middle two."""
        middle = (len(self) - 1) // 2
        return (self.at(middle) + self.at(len(self) // 2)) / 2

    def distances(self, from_ns: float) -> TimeCounts:
        """Return the distances from a time, in whole ns."""
        self._count()
        apart = TimeCounts(np.abs(self._times - from_ns).astype(np.int64), self._counts)
        apart._count()
        return apart


@dataclass(frozen=True)
class Spread:
    """Median, 99th percentile and maximum of times [us]."""

    p50_us: float
    p99_us: float
    max_us: float

    @classmethod
    def from_counts(cls, times_ns: TimeCounts) -> Spread | None:
        """Return the spread of the times; None without times."""
        if not len(times_ns):
            return None
        return cls(*(time_ns / 1e3 for time_ns in times_ns.percentiles((50, 99, 100))))


@dataclass(frozen=True)
class Timing:
    """One identifier: frames, mean rate, median period [ms], jitter, and delay after the last SYNC.

    Rate, period and jitter are None for a single frame; only the rig's PDOs have a delay. Remote frames
    are counted apart from the data frames of their identifier (`remote`).
    """

    can_id: int
    name: str
    remote: bool
    frames: int
    rate_per_s: float | None
    period_ms: float | None
    jitter: Spread | None
    from_sync: Spread | None


@dataclass
class _IdentifierStamps:
    """Stamps of one identifier: the first, the last, their number; intervals, and delays after the last SYNC."""

    first_ns: int
    last_ns: int
    frames: int = 0
    gaps: TimeCounts = field(default_factory=TimeCounts)
    delays: TimeCounts = field(default_factory=TimeCounts)


class Stamps:
    """The stamps [ns] of each identifier, in order of arrival; `source` is the clock that made them."""

    def __init__(self) -> None:
        self.source = "the recording's"
        self._by_id: dict[int, _IdentifierStamps] = {}
        self._sync_ns = np.zeros(0, np.int64)
        """The last SYNC so far, if any."""
        self._waiting: list[tuple[int, int]] = []

    @property
    def by_id(self) -> Mapping[int, _IdentifierStamps]:
        """The stamps of each identifier."""
        self._flush()
        return self._by_id

    def add_frames(self, received: Iterable[tuple[int, int, int, bytes]]) -> None:
        """Add frames of a live bus, as `wire.client.Client.receive` returns them."""
        self._waiting += [(t_ns, can_id) for t_ns, can_id, _, _ in received]
        if len(self._waiting) > MOST_WAITING:
            self._flush()

    def _flush(self) -> None:
        if self._waiting:
            t_ns, can_ids = np.array(self._waiting, np.int64).T
            self._waiting = []
            self.add_stamps(t_ns, can_ids)

    def add_stamps(self, t_ns: Integers, can_ids: Integers) -> None:
        """Add frames of a recording."""
        syncs = np.concatenate((self._sync_ns, t_ns[can_ids == CobId.SYNC]))
        self._sync_ns = syncs[-1:]
        for can_id in np.unique(can_ids).tolist():
            if not can_id & CAN_ERR_FLAG:
                times = t_ns[can_ids == can_id]
                line = self._by_id.setdefault(can_id, _IdentifierStamps(int(times[0]), int(times[0])))
                line.gaps.add(np.diff(times, prepend=line.last_ns)[0 if line.frames else 1 :])
                line.delays.add(_delays(times, syncs))
                line.frames += len(times)
                line.last_ns = int(times[-1])


def listen(address: BusAddress, seconds: float) -> tuple[Stamps, int]:
    """Listen to a bus for some time, or until a signal; return the stamps, and the number of frames
    lost in the receive queue.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it closed meanwhile.
    """
    stamps = Stamps()
    with open_bus(address, Hello(Flags.LISTEN_ONLY)) as client, StopSignals() as stop:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0 and not stop.wait(0):
            client.wait(min(left, WAIT_S))
            while frames := client.receive():
                stamps.add_frames(frames)
        client.ask()
        client.wait(WAIT_S)
        while frames := client.receive():
            stamps.add_frames(frames)
        stamps.source = client.stamps
        return stamps, client.lost


def recorded(source: Source) -> dict[str, Stamps]:
    """Return the stamps of a recording by the rig's buses."""
    channels = source.rig.channels
    stamps = {channel: Stamps() for channel in channels}
    for block in source:
        t_ns, can_ids = block.frames["t_ns"].astype(np.int64), block.frames["can_id"].astype(np.int64)
        for channel in channels:
            on_channel = block.capture.frames_on(channel)
            stamps[channel].add_stamps(t_ns[on_channel], can_ids[on_channel])
    return stamps


def recorded_bare(path: Path, channel: Channel, bus: KnownBus, remarks: list[str]) -> tuple[KnownBus, Stamps]:
    """Return what a log without a rig tells of one bus, and its stamps; add what was left out to `remarks`.

    Raises
    ------
    coulombus.recording.bus_match.ChannelError
        The file has several buses, and `channel` names none of them.
    coulombus.recording.log_files.LogError
        It has no frame.
    """
    stamps, maps = Stamps(), LogMaps(bus.eds)
    for capture in captures_of_bus(path, channel, remarks):
        frames = capture.frames
        maps.add_frames(frames)
        stamps.add_stamps(frames["t_ns"].astype(np.int64), frames["can_id"].astype(np.int64))
    return KnownBus(learned=maps.pdos()), stamps


def timing(bus: KnownBus, stamps: Stamps) -> tuple[Timing, ...]:
    """Return the timing of each identifier, the lowest first.

    A rig has all PDOs of its bus. Without one, an identifier of the predefined connection set is a PDO.
    """
    pdos = {pdo.layout.cob_id: f"{pdo.node} {pdo.name}" for pdo in bus.pdos}
    nodes = {} if bus.host is None else bus.names
    timings = []
    for can_id, line in sorted(stamps.by_id.items(), key=lambda item: (item[0] & ~CAN_RTR_FLAG, item[0])):
        period = line.gaps.median() if len(line.gaps) else None
        span_s = (line.last_ns - line.first_ns) / 1e9
        timings.append(
            Timing(
                can_id=can_id & ~(CAN_EFF_FLAG | CAN_RTR_FLAG),
                name=pdos.get(can_id) or _name(can_id, nodes),
                remote=bool(can_id & CAN_RTR_FLAG),
                frames=line.frames,
                rate_per_s=float(len(line.gaps) / span_s) if span_s > 0 else None,
                period_ms=None if period is None else period / 1e6,
                jitter=None if period is None else Spread.from_counts(line.gaps.distances(period)),
                from_sync=Spread.from_counts(line.delays)
                if can_id in pdos or (bus.host is None and can_id & (FUNCTION | CAN_RTR_FLAG) in PDO_NAMES)
                else None,
            )
        )
    return tuple(timings)


def _name(can_id: int, nodes: Mapping[int, str]) -> str:
    if can_id & CAN_RTR_FLAG:
        name = _name(can_id & ~CAN_RTR_FLAG, nodes)
        return name.replace("heartbeat", "guarding") if name.endswith("heartbeat") else f"{name} RTR"
    if can_id & CAN_EFF_FLAG:
        return "extended"
    if can_id in NAMES and not (can_id & 0x7F and can_id < CobId.LSS_TX):
        return NAMES[can_id]
    service = NODE_SERVICES.get(can_id & FUNCTION) or ("" if nodes else PDO_NAMES.get(can_id & FUNCTION))
    node = nodes.get(can_id & 0x7F, str(can_id & 0x7F))
    return f"{node} {service}" if service else "-"


def _delays(t_ns: Integers, syncs: Integers) -> Integers:
    """Return the delays of frames after the last SYNC."""
    last = np.searchsorted(syncs, t_ns, side="right") - 1
    return t_ns[last >= 0] - syncs[last[last >= 0]]


def as_dict(row: Timing) -> dict[str, object]:
    """Return a row for ``--json``."""

    def spread(quantiles: Spread | None) -> dict[str, float] | None:
        return (
            None
            if quantiles is None
            else {"p50_us": quantiles.p50_us, "p99_us": quantiles.p99_us, "max_us": quantiles.max_us}
        )

    return {
        "can_id": row.can_id,
        "name": row.name,
        "remote": row.remote,
        "frames": row.frames,
        "rate_per_s": row.rate_per_s,
        "period_ms": row.period_ms,
        "jitter": spread(row.jitter),
        "from_sync": spread(row.from_sync),
    }


def as_lines(rows: Iterable[Timing]) -> Iterator[str]:
    """Yield the table, at most 80 columns wide if names have at most 22 characters; a column has one unit."""
    rows = list(rows)
    wide = max((len(row.name) for row in rows), default=4)
    jitters = [(j.p50_us, j.p99_us, j.max_us) if (j := row.jitter) else (None, None, None) for row in rows]
    syncs = [(s.p50_us, s.max_us) if (s := row.from_sync) else (None, None) for row in rows]
    jitter_unit, sync_unit = _unit(jitters), _unit(syncs)
    jitter_head, sync_head = f"jitter [{jitter_unit}]", f"from SYNC [{sync_unit}]"
    yield f"{'':>3} {'':<{wide}} {'':>7} {'':>7} {'period':>7} {jitter_head:>14} {sync_head:>14}"
    heads = " ".join(f"{text:>5}" for text in ("p50", "p99", "max", "p50", "max"))
    yield f"{'id':>3} {'name':<{wide}} {'frames':>7} {'rate/s':>7} {'[ms]':>7} {heads}"
    for row, jitter, sync in zip(rows, jitters, syncs, strict=True):
        rate = "-" if row.rate_per_s is None else f"{row.rate_per_s:.1f}"
        period = "-" if row.period_ms is None else f"{row.period_ms:.3f}"
        times = [f"{_cell(t, jitter_unit):>5}" for t in jitter] + [f"{_cell(t, sync_unit):>5}" for t in sync]
        yield f"{row.can_id:03X} {row.name:<{wide}} {row.frames:>7} {rate:>7} {period:>7.7} {' '.join(times)}"


def _unit(cells: Iterable[Sequence[float | None]]) -> str:
    """Return the smallest unit in which the largest time has at most five characters."""
    largest = max((t for row in cells for t in row if t is not None), default=0.0)
    return next((unit for unit, size in UNITS.items() if largest / size < MOST), "s")


def _cell(value_us: float | None, unit: str) -> str:
    """Return a time in at most five characters, with tenths of a microsecond at most."""
    if value_us is None:
        return "-"
    value = value_us / UNITS[unit]
    decimals = 1 if unit == "us" else 3
    text = f"{value:.{decimals}f}"
    while len(text) > 5 and decimals:
        decimals -= 1
        text = f"{value:.{decimals}f}"
    return text
