"""The tip of an arm from its joints' PDOs: path, speed, and the force on the hand by the transducers.

The joints' angles are `kinematics.start_rad` plus the positions since the host's start. The bus has
the drives' positions; the host's status has those since its start, and gives the difference while the
arm is still.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from coulombus.monitor.tracks import Floats, Integers, Samples, Track
from coulombus.monitor.web.capture import FADE_NS, HANDLE, POSITION, LiveCapture
from coulombus.rigs.axis import Axis
from coulombus.rigs.kinematics.load_mechanism import Mechanism, load_mechanism
from coulombus.rigs.rig import Rig

__all__ = ["TipTrack", "arm_points", "tip_track"]

STEP_NS = 10_000_000
"""Interval of the points of the path."""
STILL_NS = 1_000_000_000
"""Time for which the positions do not change where the host's positions are matched with the bus'."""
X, Y, VX, VY, FX, FY = range(6)


class TipTrack:
    """The last two seconds of an arm's tip, a point every `STEP_NS`.

    Parameters
    ----------
    capture : the bus
    mechanism : the rig's
    """

    def __init__(self, capture: LiveCapture, mechanism: Mechanism) -> None:
        rig = capture.rig
        assert rig.kinematics is not None
        self.rig, self._capture, self._mechanism = rig, capture, mechanism
        self._start_rad = np.array(rig.kinematics.start_rad)
        self._zero_rad = np.zeros(2)
        self._angles = [capture.track(axis.prefix + POSITION) for axis in rig.axes]
        measured = all(HANDLE in _keys(capture, axis) for axis in rig.axes)
        self._handles = [capture.track(axis.prefix + HANDLE) for axis in rig.axes] if measured else None
        self._points = Samples(FADE_NS // STEP_NS, 6)
        self._next_ns = 0
        self.q_rad: Floats | None = None
        """The joints' angles of the newest point; None before it."""

    def align(self, positions_rad: Mapping[str, float]) -> None:
        """Match the host's positions since its start, by axis, with those of the bus, if the arm has been still."""
        since = self._capture.newest_ns - STILL_NS
        zero = self._zero_rad.copy()
        for k, (axis, track) in enumerate(zip(self.rig.axes, self._angles, strict=True)):
            _, angles = track.since(since)
            position = positions_rad.get(axis.name)
            if position is None or len(angles) < 2 or np.ptp(angles) > 0.0:
                return
            zero[k] = angles[-1] - position
        self._zero_rad = zero

    def update(self) -> None:
        """Add the points of new samples."""
        newest = self._capture.newest_ns
        if newest <= 0:
            return
        first = max(self._next_ns, newest - FADE_NS)
        times = np.arange(first - first % STEP_NS + STEP_NS, newest - STEP_NS + 1, STEP_NS)
        if not len(times):
            return
        q = self._at(self._angles, times)
        if q is None:
            return
        self._next_ns = int(times[-1])
        q = q + (self._start_rad - self._zero_rad)[:, None]
        torque = None if self._handles is None else self._at(self._handles, times)
        rows = np.full((6, len(times)), np.nan)
        _, before = self._points.last(1, X)
        last = np.array([self._points.last(1, row)[1][0] for row in (X, Y)]) if len(before) else np.full(2, np.nan)
        for k in range(len(times)):
            pose = self._mechanism.pose(float(q[0, k]), float(q[1, k]))
            rows[X : Y + 1, k] = pose["x_m"]
            rows[VX : VY + 1, k] = (rows[:2, k] - last) / (STEP_NS * 1e-9)
            last = rows[:2, k].copy()
            if torque is not None and abs(np.linalg.det(pose["jacobian"])) > 1e-9:
                rows[FX : FY + 1, k] = -np.linalg.solve(pose["jacobian"].T, torque[:, k])
        self._points.add(times, rows)
        self.q_rad = q[:, -1].copy()

    @staticmethod
    def _at(tracks: Sequence[Track], times: Integers) -> Floats | None:
        """Return two signals' latest samples at the times, shape (2, n); None before both have some."""
        rows = []
        for track in tracks:
            t_ns, values = track.since(0)
            if not len(t_ns):
                return None
            rows.append(values[np.clip(np.searchsorted(t_ns, times, side="right") - 1, 0, len(t_ns) - 1)])
        return np.array(rows)

    def parts(self) -> list[tuple[str, Floats]]:
        """Return path [m], velocity [m/s] and force on the hand [N], by kind, shape (2, n), oldest first."""
        _, rows = self._points.all_since(self._capture.newest_ns - FADE_NS)
        kinds = (("tip", X), ("tip_velocity", VX), ("tip_force", FX))
        return [(kind, rows[first : first + 2]) for kind, first in kinds]

    def arm(self) -> list[list[float]]:
        """Return the arm's joints and tip at the newest point, from the base [m]."""
        if self.q_rad is None:
            return []
        tip = self._mechanism.pose(float(self.q_rad[0]), float(self.q_rad[1]))["x_m"].tolist()
        return [*arm_points(self.rig, self.q_rad), tip] if all(map(math.isfinite, tip)) else []


def arm_points(rig: Rig, q_rad: Floats) -> list[list[float]]:
    """Return base and elbow of two links in series [m]; of another mechanism nothing."""
    kinematics = rig.kinematics
    if kinematics is None or kinematics.kind != "serial_2r" or kinematics.l1_m is None:
        return []
    first = kinematics.signs[0] * float(q_rad[0]) + kinematics.offsets_rad[0]
    return [[0.0, 0.0], [kinematics.l1_m * math.cos(first), kinematics.l1_m * math.sin(first)]]


def _keys(capture: LiveCapture, axis: Axis) -> set[str]:
    """Return the keys of the signals of an axis that the page draws."""
    return {name.removeprefix(axis.prefix) for names in capture.names(axis).values() for name in names}


def tip_track(capture: LiveCapture) -> TipTrack | None:
    """Return the tip's track of a rig in the plane.

    None for other rigs, without the positions of both joints, and for a mechanism that only a recording names.

    Raises
    ------
    coulombus.rigs.kinematics.load_mechanism.MechanismMistake
        the mechanism is user-defined, and wrong
    """
    rig = capture.rig
    if rig.kinematics is None or any(POSITION not in _keys(capture, axis) for axis in rig.axes):
        return None
    if rig.origin.attached and rig.kinematics.function is not None:
        return None
    return TipTrack(capture, load_mechanism(rig.kinematics, rig.law_directory))
