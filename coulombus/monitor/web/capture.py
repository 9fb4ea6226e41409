"""Data of the page: batches of frames become samples, envelopes and figures of each PDO.

A batch is decoded by NumPy, PDO by PDO. Time is an argument: nanoseconds since 1970, as the frames'
stamps. No bus content raises.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coulombus.monitor.live import Live
from coulombus.monitor.snapshot import Event, Snapshot
from coulombus.monitor.tracks import Integers, LiveEnvelope, Samples, Track, velocity
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.pdo_columns import decode_field
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo
from coulombus.wire.bits import frame_bits
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.client import Received
from coulombus.wire.frame_batches import Block

__all__ = ["AFTER_NS", "BEFORE_NS", "ROWS", "VELOCITY", "Curve", "LiveCapture", "Period"]

WINDOW_NS = 1_000_000_000
RAW_NS = 200_000_000
"""Drawn time of the raw samples."""
BEFORE_NS, AFTER_NS = 500_000_000, 200_000_000
"""Drawn time of the raw samples before a trip, and after it."""
FADE_NS = 2_000_000_000
"""Drawn time of the phase plot."""
VELOCITY_CYCLES = 5
POSITION, HANDLE = "motor.position_rad", "brake.handle_torque_Nm"
VELOCITY = "handle.velocity_rad_s"
"""Velocity computed from the position if no PDO carries one."""
ROWS = (
    ("torque", "Nm", (HANDLE, "brake.setpoint_Nm", "motor.torque_Nm", "motor.target_torque_Nm")),
    ("position", "rad", (POSITION,)),
    ("velocity", "rad/s", ("motor.velocity_rad_s", VELOCITY)),
)
"""The plots: title, unit, and possible signals (`Signal.key`)."""
SHOWN = frozenset(key for _, _, keys in ROWS for key in keys)
EVENTS = 200
BITS_NS, BITS_IDS = 100_000_000, 256
"""Interval, and number of identifiers, after which the bits on the wire are counted."""


@dataclass(frozen=True)
class Period:
    """The interval between frames of a PDO in the last second [ms]; `jitter_ms` is the larger
    deviation of its extremes from the mean.
    """

    least_ms: float
    mean_ms: float
    most_ms: float

    @property
    def jitter_ms(self) -> float:
        """The larger deviation of the extremes from the mean."""
        return max(self.most_ms - self.mean_ms, self.mean_ms - self.least_ms)


@dataclass(frozen=True)
class Curve:
    """The displayed friction of a law over the velocity."""

    velocity_rad_s: tuple[float, ...]
    friction_Nm: tuple[float, ...]


class _DrawnPdo:
    """Kept data of a PDO."""

    def __init__(self, pdo: RigPdo, capacity: int) -> None:
        self.pdo = pdo
        starts, entries = pdo.layout.starts, pdo.layout.entries
        self.fields = tuple(zip(pdo.signals, entries, starts, strict=True))
        ends = (start + entry.bits - 1 for start, entry in zip(starts, entries, strict=True))
        self.places = tuple(f"{a}-{b}" if b > a else str(a) for a, b in zip(starts, ends, strict=True))
        self.data: bytes | None = None
        self.drawn = tuple(field for field in self.fields if field[0].key in SHOWN)
        self.samples, self.envelope = Samples(capacity, len(self.drawn)), LiveEnvelope(len(self.drawn))
        tracks = (Track(self.samples, self.envelope, k) for k in range(len(self.drawn)))
        self.tracks = {field[0].name: track for field, track in zip(self.drawn, tracks, strict=True)}

    def add_samples(self, t_ns: Integers, words: Integers) -> None:
        """Process the frames of a batch that have this PDO's length."""
        values = np.empty((len(self.drawn), len(t_ns)))
        for row, (signal, entry, start) in zip(values, self.drawn, strict=True):
            row[:] = decode_field(words, start, entry) * signal.scale + signal.offset
        self.samples.add(t_ns, values)
        if self.drawn:
            self.envelope.add(t_ns, values)

    def period(self, now_ns: int) -> Period | None:
        """Return the figures of the last second; None with fewer than two frames."""
        t_ns, _ = self.samples.all_since(now_ns - WINDOW_NS)
        if len(t_ns) < 2:
            return None
        steps = (t_ns[1:] - t_ns[:-1]) * 1e-6
        return Period(float(steps.min()), float(steps.mean()), float(steps.max()))


class LiveCapture:
    """Processes batches of frames of one bus (`take`); `snapshot`, `period` and `track` return the results.

    Attributes
    ----------
    events : the last `EVENTS` of them
    begin_ns, newest_ns : the first stamp, and the newest; 0: no frame has come
    """

    def __init__(self, rig: Rig) -> None:
        self.rig, self.live = rig, Live(KnownBus(rig))
        period_ns = rig.bus.period_ns
        self._capacity = max(64, 2 * FADE_NS // period_ns)
        self._pdos = {pdo.layout.cob_id: _DrawnPdo(pdo, self._capacity) for pdo in rig.pdos()}
        self._tracks = {name: track for pdo in self._pdos.values() for name, track in pdo.tracks.items()}
        self._differences: list[tuple[Track, Track]] = []
        for axis in rig.axes:
            position = self._tracks.get(axis.prefix + POSITION)
            if position is not None and axis.prefix + "motor.velocity_rad_s" not in self._tracks:
                velocity_track = self._tracks[axis.prefix + VELOCITY] = Track(
                    Samples(self._capacity), LiveEnvelope(), 0
                )
                self._differences.append((velocity_track, position))
        self._names = {
            axis.name: {
                title: [n for n in (axis.prefix + key for key in keys) if n in self._tracks] for title, _, keys in ROWS
            }
            for axis in rig.axes
        }
        self._counted = [0] * len(self._differences)
        self._bits: deque[tuple[int, int]] = deque()
        self._bits_sum = self._bits_ns = 0
        self._counts: dict[int, int] = {}
        self._last: dict[int, tuple[int, bytes]] = {}
        frame_bits(0)  # compile or load now, not with the first frames
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self.begin_ns = self.newest_ns = 0

    def names(self, axis: Axis) -> dict[str, list[str]]:
        """Return the signals of each plot of an axis, by the plot's title."""
        return self._names[axis.name]

    def add_frames(self, received: Block | Sequence[Received]) -> None:
        """Process the frames of some milliseconds."""
        block = received if isinstance(received, Block) else Block.from_frames(received)
        if not len(block):
            return
        self.live.add_frames(block)
        self.newest_ns = max(self.newest_ns, int(block.t_ns.max()))
        self.begin_ns = self.begin_ns or int(block.t_ns.min())
        for can_id, rows in block.rows.items():
            self._counts[can_id] = self._counts.get(can_id, 0) + len(rows)
            self._last[can_id] = int(block.lengths[rows[-1]]), block.data(rows[-1])
            line = self._pdos.get(can_id)
            if line is None:
                continue
            rows = rows[block.lengths[rows] == line.pdo.layout.length]
            if len(rows):
                line.add_samples(block.t_ns[rows], block.words[rows])
                line.data = block.data(rows[-1])[: line.pdo.layout.length]
        for k in range(len(self._differences)):
            self._difference(k)
        if self.newest_ns - self._bits_ns >= BITS_NS or len(self._counts) > BITS_IDS:
            self._count_bits()

    def _difference(self, k: int) -> None:
        """Add the velocity of new positions."""
        velocity_track, position = self._differences[k]
        t_ns, angle = position.last(position.samples.count - self._counted[k] + VELOCITY_CYCLES)
        self._counted[k] = position.samples.count
        times, speeds = velocity(t_ns, angle, self.rig.bus.period_ns, VELOCITY_CYCLES)
        velocity_track.samples.add(times, speeds)
        velocity_track.bins.add(times, speeds)

    def _count_bits(self) -> None:
        """Count the bits of the frames on the wire: each identifier by its last frame."""
        for can_id, count in self._counts.items():
            if can_id & CAN_ERR_FLAG:
                continue
            length, data = self._last[can_id]
            remote = bool(can_id & CAN_RTR_FLAG)
            extended = bool(can_id & CAN_EFF_FLAG)
            number = can_id & (0x1FFFFFFF if extended else 0x7FF)
            bits = frame_bits(number, length if remote else data[:length], extended=extended, remote=remote)
            self._bits_sum += bits * count
        self._counts.clear()
        self._last.clear()
        self._bits_ns = self.newest_ns
        self._bits.append((self.newest_ns, self._bits_sum))
        while len(self._bits) > 2 and self._bits[1][0] <= self.newest_ns - WINDOW_NS:
            self._bits.popleft()

    def load(self, now_ns: int, bitrate_bit_s: int) -> float:
        """Return the busy share of the last second, 0 to 1.

        A late batch counts over its own time span.
        """
        if len(self._bits) < 2 or now_ns - self._bits[-1][0] > WINDOW_NS:
            return 0.0
        (first_ns, before), (last_ns, after) = self._bits[0], self._bits[-1]
        return (after - before) / (bitrate_bit_s * max(last_ns - first_ns, 1) * 1e-9)

    def add_event(self, t_ns: int, text: str, grave: bool = False) -> None:
        """Add an event detected elsewhere."""
        self.live.add_event(t_ns, text, grave)

    def snapshot(self, now_ns: int) -> Snapshot:
        """Return the present snapshot, and keep the new events."""
        snapshot = self.live.snapshot(now_ns)
        self.events.extend(snapshot.events)
        return snapshot

    def last_data(self, can_id: int) -> bytes | None:
        """Return the data of the last valid frame of a PDO."""
        return self._pdos[can_id].data

    def places(self, can_id: int) -> tuple[str, ...]:
        """Return the bits of each signal in a PDO: "0-15"."""
        return self._pdos[can_id].places

    def period(self, can_id: int, now_ns: int) -> Period | None:
        """Return the figures of a PDO's period in the last second."""
        return self._pdos[can_id].period(now_ns)

    def track(self, name: str) -> Track:
        """Return the kept data of a signal."""
        return self._tracks[name]

    def friction(self, axis: Axis, points: int = 200) -> tuple[np.ndarray, np.ndarray] | None:
        """Return velocity [rad/s] and handle torque [Nm] of the last two seconds, oldest first.

        None if the axis has no transducer or no position.
        """
        speed = next((n for n in (axis.prefix + k for k in ROWS[2][2]) if n in self._tracks), None)
        torque = axis.prefix + HANDLE
        if speed is None or torque not in self._tracks:
            return None
        t_v, v = self._tracks[speed].since(self.newest_ns - FADE_NS)
        t_f, f = self._tracks[torque].since(self.newest_ns - FADE_NS)
        step = max(1, self._capacity // 2 // points)
        t_v, v = t_v[::-step][::-1], v[::-step][::-1]
        if not len(t_f):
            return None
        return v, f[np.clip(np.searchsorted(t_f, t_v), 0, len(t_f) - 1)]
