"""Whole courses, mirrored: what the hand feels is the same in either sense, with every polarity,
and wherever counting began.
"""

from __future__ import annotations

import itertools

import pytest

from coulombus.host.cycle.records import Phase, SignResult, Trip
from host_bench import HostBench

POLARITIES = list(itertools.product((1, -1), repeat=3))
START = -123_456  # counts
KEYS = ("motor_polarity", "encoder_polarity", "transducer_polarity")


class Handle(HostBench):
    """The bench in the handle's own sense: position in counts, torques in Nm; `sign` mirrors all of
    it.
    """

    def __init__(self, mode, polarity=(1, 1, 1), sign=1, *overrides):
        super().__init__(mode, *(f"mechanics.{k}={p}" for k, p in zip(KEYS, polarity, strict=True)), *overrides)
        self.polarity, self.sign = polarity, sign

    def show(self, position, handle_Nm, torque_Nm=0.0, start=START):
        """One cycle with the handle at `position`; return what it is made to feel."""
        motor, encoder, _ = self.polarity
        self.counts = start + self.sign * encoder * position
        self.handle_Nm = self.sign * handle_Nm
        self.torque_pm = self.sign * torque_Nm / self.c.motor_Nm_raw
        self.cycle()
        return self.phase.name, round(self.sign * motor * self.motor_pm, 9), self.h.image[2], self.k.trip


def armed(handle, hand=-1):
    """Lead the handle through its arming, away from where counting began; return the course.

    The sign check tries the handle's positive sense first, so only the polarities are mirrored
    here.
    """
    assert handle.sign == 1
    course = [handle.show(5 * n, 0.0) for n in range(60)]  # it is moved first
    moved = 0
    for _ in range(3000):
        if handle.phase >= Phase.RUN:
            break
        torque = handle.motor_pm * handle.c.motor_Nm_raw
        moved = int(max(abs(torque) - 0.14, 0.0) / 5.0 / abs(handle.c.rad_count)) * (1 if torque > 0 else -1)
        course.append(handle.show(295 + moved, hand * 5.0 * moved * abs(handle.c.rad_count)))
    return course


REFERENCE = armed(Handle("active"))


@pytest.mark.parametrize("polarity", POLARITIES)
def test_arming_feels_the_same_with_every_polarity(polarity):
    handle = Handle("active", polarity)
    assert armed(handle) == REFERENCE
    assert handle.phase is Phase.RUN
    assert handle.k.sign_result is SignResult.AGREED
    assert handle.h.counts == polarity[1] * 295
    assert handle.k.state[0].x_stuck == pytest.approx(295 * abs(handle.c.rad_count))


@pytest.mark.parametrize("polarity", POLARITIES)
def test_a_transducer_that_is_reversed_is_found_with_every_polarity(polarity):
    handle = Handle("active", polarity)
    armed(handle, hand=1)
    assert handle.h.trip == Trip.SIGN_TRANSDUCER


def running(mode, polarity, sign):
    handle = Handle(mode, polarity, sign).enter(Phase.RUN)
    handle.enter(Phase.RUN, START)
    handle.h.counts = handle.h.reference_counts = 0
    handle.k.state[0].x_stuck = 0.0
    return handle


def strokes(handle):
    """Slip forth and back, stop, and slip again; the hand bears what is shown."""
    position, course = 0, []
    for speed, cycles in ((0, 3), (12, 12), (2, 3), (0, 3), (-12, 20), (0, 3), (30, 4), (1, 3)):
        for _ in range(cycles):
            position += speed
            course.append(handle.show(position, 1.0 * (speed > 0) - 1.0 * (speed < 0)))
    return course


@pytest.mark.parametrize("mode", ["active", "hybrid", "passive"])
def test_friction_feels_the_same_in_either_sense_and_with_every_polarity(mode):
    reference = strokes(running(mode, (1, 1, 1), 1))
    assert reference[-1][3] is None
    assert len({row[1] for row in reference}) >= {"active": 4, "hybrid": 3, "passive": 1}[mode]
    for polarity, sign in itertools.product(POLARITIES, (1, -1)):
        assert strokes(running(mode, polarity, sign)) == reference


@pytest.mark.parametrize(
    ("mode", "speed", "handle_Nm", "torque_Nm", "trip"),
    [
        ("passive", 0, 5.2, 0.0, Trip.HANDLE_TORQUE),  # stuck, more than the brake can hold
        ("passive", 20, 5.2, 0.0, Trip.HANDLE_TORQUE),
        ("passive", 20, -1.0, 0.0, Trip.HANDLE_TORQUE),  # the hand is not braked, but drawn
        ("active", 20, 0.0, 0.9, Trip.NET_WORK),
        ("active", 190, 0.0, 0.0, Trip.SPEED),
        ("hybrid", 501, 3.0, 0.0, Trip.ENCODER_JUMP),
    ],
)
def test_what_goes_wrong_trips_in_the_same_cycle_in_either_sense(mode, speed, handle_Nm, torque_Nm, trip):
    found = set()
    for polarity, sign in itertools.product(POLARITIES, (1, -1)):
        handle = running(mode, polarity, sign)
        if trip is Trip.NET_WORK:
            handle.c.motor_mismatch_Nm = 9.0
        for n in range(1, 400):
            handle.show(n * speed, handle_Nm, torque_Nm)
            if handle.phase >= Phase.SAFE:
                break
        assert handle.h.trip == trip
        assert handle.motor_pm == 0
        found.add(n)
    assert len(found) == 1


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("polarity", POLARITIES)
def test_a_loaded_handle_is_refused_in_either_sense(polarity, sign):
    handle = Handle("active", polarity, sign, "limits.still_timeout_s=0.3")
    for _ in range(400):
        handle.show(300, 0.3)
    assert handle.h.trip == Trip.HANDLE_LOADED
