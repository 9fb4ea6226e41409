"""The dead man's switch in virtual time: for how long a stroke, a byte or a level counts as held."""

from __future__ import annotations

import os
import pty
import termios

import pytest

from coulombus.host.errors import SafetyTrip
from coulombus.host.run import deadman
from coulombus.host.run.deadman import HeldKey, deadman_of
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import parse_address

MS = 1_000_000
RELEASE_NS = 300 * MS


class Clock:
    """CLOCK_MONOTONIC, as the test sets it."""

    def __init__(self):
        self.now_ns = 0

    def monotonic_ns(self):
        return self.now_ns


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(deadman, "time", clock)
    return clock


@pytest.fixture
def terminal(monkeypatch):
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as file:
        monkeypatch.setattr("sys.stdin", file)
        yield ours
    os.close(ours)


class Key:
    """A space bar, and what it told."""

    def __init__(self, clock):
        self.clock, self.told, self.others = clock, [], []
        self.switch = HeldKey(self.told.append, self.others.append)

    def strike(self, at_ns, strokes=b" "):
        self.clock.now_ns = at_ns
        self.switch._struck(strokes)

    def held(self, at_ns):
        self.clock.now_ns = at_ns
        return self.switch.held


@pytest.fixture
def key(clock, terminal):
    return Key(clock)


# the space bar


def test_one_stroke_holds_nothing_and_the_next_holds_for_the_release_time(key):
    key.strike(1000 * MS)
    assert key.told == []
    key.strike(1200 * MS)
    assert key.told == [1200 * MS + RELEASE_NS]
    assert type(key.told[0]) is int  # it goes into the loop's memory as it is
    assert key.held(1200 * MS)
    assert key.held(1200 * MS + RELEASE_NS - 1)
    assert not key.held(1200 * MS + RELEASE_NS)


@pytest.mark.parametrize(("gap_ns", "held"), [(1, True), (RELEASE_NS - 1, True), (RELEASE_NS, False)])
def test_two_strokes_hold_when_less_than_the_release_time_is_between_them(key, gap_ns, held):
    key.strike(5000 * MS)
    key.strike(5000 * MS + gap_ns)
    assert key.told == [5000 * MS + gap_ns + RELEASE_NS] * held


def test_each_stroke_is_compared_with_the_one_before_it(key):
    for at_ms in (1000, 1299, 1598, 1898, 2197):
        key.strike(at_ms * MS)
    assert key.told == [at_ms * MS + RELEASE_NS for at_ms in (1299, 1598, 2197)]


def test_no_other_key_holds_and_none_is_lost(key):
    key.strike(1000 * MS, b"1")
    key.strike(1010 * MS, b"2")
    assert (key.told, key.others) == ([], [b"1", b"2"])
    key.strike(1020 * MS, b" 3")
    key.strike(1030 * MS)
    assert key.told == [1030 * MS + RELEASE_NS]
    assert key.others == [b"1", b"2", b"3"]  # and no empty one for the space bar


@pytest.mark.parametrize("at_ns", [0, 1])
def test_a_switch_is_not_held_before_anything_was_heard_of_it(key, at_ns):
    assert not key.held(at_ns)


def test_a_switch_that_is_let_go_is_not_held_at_once(key):
    key.strike(1000 * MS)
    key.strike(1001 * MS)
    key.switch._let_go()
    assert key.told[-1] == 0
    assert not key.held(0)
    assert not key.held(1001 * MS)


def test_the_terminal_is_watched_within_the_context_only(terminal):
    before = termios.tcgetattr(terminal)[3]
    told = []
    switch = HeldKey(told.append)
    with switch as entered:
        assert entered is switch
        assert termios.tcgetattr(terminal)[3] != before
    assert termios.tcgetattr(terminal)[3] == before
    assert told == [0]


def test_without_a_terminal_there_is_no_key(monkeypatch):
    with open(os.devnull) as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        with pytest.raises(SafetyTrip, match="needs a terminal"):
            HeldKey([].append)


# where one is needed


@pytest.mark.parametrize("bus", ["socketcan:can0", "coulombus:bench"])
@pytest.mark.parametrize("said", ["none", "key"])
def test_what_the_rig_file_says_counts_everywhere(bus, said):
    rig = load_rig("bench", [f"host.deadman={said}"])
    assert deadman_of(rig, "active", parse_address(bus)) == said


@pytest.mark.parametrize(
    ("bus", "limit_Nm", "needed"),
    [
        ("socketcan:can0", 1.5, True),
        ("socketcan:can0", 0.1, True),
        ("socketcan:can0", 0, False),
        ("coulombus:bench", 1.5, False),
        ("coulombus:bench", 0, False),
    ],
)
def test_a_motor_with_torque_needs_one_on_an_interface_of_linux(bus, limit_Nm, needed):
    rig = load_rig("bench", [f"mode.active.motor_limit_Nm={limit_Nm}"])
    if needed:
        with pytest.raises(SafetyTrip, match=r"mode active gives the motor torque on .*set host\.deadman to"):
            deadman_of(rig, "active", parse_address(bus))
    else:
        assert deadman_of(rig, "active", parse_address(bus)) == "none"


def test_every_motor_with_torque_is_named():
    with pytest.raises(SafetyTrip, match=r"gives left\.motor, right\.motor torque"):
        deadman_of(load_rig("two_axes"), "hybrid", parse_address("socketcan:can0"))
