"""Batches for a browser: one every 33 ms, each acknowledged by the page.

A batch is a length (four bytes, little-endian), JSON of that length, and numbers as little-endian
float32. The JSON's ``parts`` describe the numbers in order::

    {"k": "envelope", "s": NAME, "first": BIN, "n": N}    N minima, N maxima
    {"k": "raw", "s": NAME, "n": N}                       N times before `now` [s], N values
    {"k": "friction", "n": N}                             N velocities, N torques, oldest first
    {"k": "tip", "n": N}                                  N times x, N times y of an arm's tip [m], oldest first;
                                                          likewise "tip_velocity" [m/s], "tip_force" [N]

After a trip there is one more batch, number 0, with ``trip_bin``, the bin of the trip: its raw samples
are those around the trip, with times since the trip.

A page that does not acknowledge, such as a sleeping tab, is sent nothing, so nothing accumulates.
When it wakes it gets the bins since its last batch, at most ten seconds.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coulombus.monitor.tracks import BIN_NS, Samples
from coulombus.monitor.web.capture import AFTER_NS, BEFORE_NS, RAW_NS, ROWS, LiveCapture
from coulombus.rigs.axis import Axis

__all__ = ["IN_FLIGHT", "Flow", "batch", "layout", "unpacked"]

IN_FLIGHT = 2
"""Maximum unacknowledged batches of a page."""
LENGTH = struct.Struct("<I")


@dataclass
class Flow:
    """State of a page: batches sent and acknowledged, and the next bin of each signal."""

    sent: int = 0
    acknowledged: int = 0
    bins: dict[str, int] = field(default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether it may be sent another batch."""
        return self.sent - self.acknowledged < IN_FLIGHT

    def acknowledge(self, number: int) -> bool:
        """Note the acknowledgement of batch `number`; False: it was never sent."""
        if not self.acknowledged < number <= self.sent:
            return False
        self.acknowledged = number
        return True


def batch(
    capture: LiveCapture,
    axis: Axis,
    flow: Flow,
    more: dict[str, Any],
    tip: Sequence[tuple[str, np.ndarray]] = (),
    trip_ns: int | None = None,
) -> bytes:
    """Return the next batch of a page, and note its content in `flow`.

    Parameters
    ----------
    more : further keys of the JSON
    tip : parts of an arm, shape (2, n) each
    trip_ns : the batch is that of a trip at this time
    """
    flow.sent += trip_ns is None
    parts: list[dict[str, Any]] = []
    numbers: list[np.ndarray] = []
    names = [name for some in capture.names(axis).values() for name in some]
    for name in names:
        first, low, high = capture.track(name).bins_since(flow.bins.get(name, 0))
        if len(low):
            parts.append({"k": "envelope", "s": name, "first": first, "n": len(low)})
            numbers += [low, high]
            flow.bins[name] = first + len(low) - 1  # the newest bin may still grow
    zero_ns, before_ns = (capture.newest_ns, RAW_NS) if trip_ns is None else (trip_ns, BEFORE_NS)
    pieces: dict[Samples, tuple[np.ndarray, np.ndarray]] = {}  # signals of one PDO share their times
    for name in names:
        track = capture.track(name)
        if track.samples not in pieces:
            t_ns, rows = track.samples.all_since(zero_ns - before_ns)
            n = int(t_ns.searchsorted(zero_ns + AFTER_NS, "right"))
            pieces[track.samples] = (t_ns[:n] - zero_ns) * 1e-9, rows[:, :n]
        times, rows = pieces[track.samples]
        parts.append({"k": "raw", "s": name, "n": len(times)})
        numbers += [times, rows[track.signal]]
    if trip_ns is not None:
        more = {**more, "trip_bin": trip_ns / BIN_NS}
    friction = capture.friction(axis)
    if friction is not None:
        parts.append({"k": "friction", "n": len(friction[0])})
        numbers += [*friction]
    for kind, pair in tip:
        parts.append({"k": kind, "n": pair.shape[1]})
        numbers += [*pair]
    head = {"n": flow.sent, "now_bin": capture.newest_ns / BIN_NS, "parts": parts, **more}
    text = json.dumps(head, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)  # the numbers begin at a multiple of four
    body = np.concatenate(numbers, dtype="<f4", casting="same_kind").tobytes() if numbers else b""
    return LENGTH.pack(len(text)) + text + body


def unpacked(message: bytes) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Return a batch's JSON and two rows of numbers for each of its parts, as the page does."""
    (length,) = LENGTH.unpack_from(message)
    head: dict[str, Any] = json.loads(message[LENGTH.size : LENGTH.size + length])
    numbers = np.frombuffer(message, "<f4", offset=LENGTH.size + length)
    rows, start = [], 0
    for part in head["parts"]:
        rows.append(numbers[start : start + 2 * part["n"]].reshape(2, -1))
        start += 2 * part["n"]
    return head, rows


def layout(capture: LiveCapture, axis: Axis) -> list[dict[str, Any]]:
    """Return the plots of an axis: title, unit, names of the signals."""
    names = capture.names(axis)
    return [{"title": title, "unit": unit, "signals": names[title]} for title, unit, _ in ROWS]
