"""Velocity estimate of slow motion, compiled: a first-order adaptive window over the last positions.

    c : the CONTROL record of an axis        h : its HOST record

A backward difference is 0 or 1 count while the handle slides by less than a count a cycle. The
first-order adaptive window is the longest window of at most ``velocity_window_cycles`` in which the
straight line between its ends is within one count of every sample. It is long when the handle creeps,
and one cycle when it starts. Source: F. Janabi-Sharifi, V. Hayward, C.-S. J. Chen, IEEE Trans. Control
Systems Technology 8(6), 2000, doi:10.1109/87.880606.
"""

from __future__ import annotations

from coulombus.host.cycle.records import TRACK, ControlRecord, HostRecord
from coulombus.kernels.decorator import kernel

__all__ = ["slide_velocity"]


@kernel
def slide_velocity(c: ControlRecord, h: HostRecord) -> None:
    """Set ``slide_counts`` [counts a cycle] from the last positions; call it once a cycle, after
    `monitors.measure`.
    """
    h.slide_counts = h.v_counts
    if c.window_cycles <= 1 or not h.fresh:
        h.track_length = 0  # the window must not span a gap
        return
    newest = h.counts
    low, high = -1e300, 1e300
    for k in range(1, min(h.track_length, c.window_cycles) + 1):
        moved = float(newest - h.track[(h.track_row - k) % TRACK])
        slope = moved / k
        if slope < low or slope > high:
            break
        h.slide_counts = slope
        low = max(low, (moved - 1.0) / k)
        high = min(high, (moved + 1.0) / k)
    h.track[h.track_row] = newest
    h.track_row = (h.track_row + 1) % TRACK
    h.track_length = min(h.track_length + 1, TRACK)
