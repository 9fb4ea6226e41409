"""The dead man's switch in virtual time: for how long a stroke, a byte or a level counts as held."""

from __future__ import annotations

import os
import socket
import termios
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from coulombus.host.errors import SafetyTrip
from coulombus.host.run import deadman
from coulombus.host.run.deadman import (
    GET_LINE,
    GET_VALUES,
    LINE,
    VALUES,
    HeldKey,
    HeldLine,
    HeldSocket,
    deadman_of,
    switch_of,
)
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


# a line and a socket


class Ready:
    """The switch's thread in the test's own: `found` has what is ready, one wait after the other."""

    def __init__(self, *found):
        self.found, self.asked = list(found), []

    def ready(self, sources, timeout_s=None):
        self.asked.append((len(sources), timeout_s))
        found = self.found.pop(0)
        return None if found is None else [sources[k] for k in found]


class Chip:
    """A GPIO chip in the kernel's place, which looks at descriptor, request and structure."""

    def __init__(self, path):
        self.path, self.bits, self.device, self.line, self.asked = path, 1, -1, -1, None
        path.write_bytes(b"")

    def ioctl(self, descriptor, request, given):
        if request == 3 << 30 | LINE.size << 16 | 0xB4 << 8 | 0x07:  # _IOWR(0xB4, 0x07, struct gpio_v2_line_request)
            assert os.path.samestat(os.fstat(descriptor), self.path.stat())
            self.device, self.asked = descriptor, LINE.unpack(given)
            self.line = os.open(os.devnull, os.O_RDONLY)
            return LINE.pack(*self.asked[:-1], self.line)
        assert request == 3 << 30 | VALUES.size << 16 | 0xB4 << 8 | 0x0E  # GPIO_V2_LINE_GET_VALUES_IOCTL
        assert descriptor == self.line
        assert given == VALUES.pack(0, 1)
        return VALUES.pack(self.bits, 1)


@pytest.fixture
def chip(tmp_path):
    return Chip(tmp_path / "gpiochip0")


def is_open(descriptor, path):
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except OSError:
        return False


def test_the_requests_are_the_kernels():
    assert (GET_LINE, GET_VALUES) == (0xC250B407, 0xC010B40E)


def watcher():
    """Return the thread that watches a switch, if there is thread."""
    return next((thread for thread in threading.enumerate() if thread.name == "dead man's switch"), None)


@pytest.mark.parametrize(("low", "flags"), [(False, 1 << 2 | 1 << 9), (True, 1 << 1 | 1 << 2 | 1 << 8)])
def test_one_line_is_asked_for_and_nothing_stays_open(chip, low, flags):
    with HeldLine([].append, chip.path, 17, low=low, ioctl=chip.ioctl) as switch:
        offsets = (17).to_bytes(4, "little").ljust(256, b"\0")
        name = b"coulombus dead man".ljust(32, b"\0")
        assert chip.asked == (offsets, name, flags, 0, b"\0" * 20, b"\0" * 240, 1, 0, b"\0" * 20, -1)
        assert not is_open(chip.device, chip.path)
        assert is_open(chip.line, os.devnull)
        assert switch.name == "the switch at the GPIO line"
        assert watcher() is not None
    assert not is_open(chip.line, os.devnull)
    assert watcher() is None


@pytest.mark.parametrize(("bits", "held"), [(1, True), (3, True), (0, False), (2, False)])
def test_a_level_counts_for_30_ms_and_is_looked_at_every_2_ms(chip, clock, bits, held):
    told = []
    switch = HeldLine(told.append, chip.path, 17, ioctl=chip.ioctl)
    switch._lookout = Ready([], [], None)
    chip.bits, clock.now_ns = bits, 5000 * MS
    switch._watch()
    assert told == [5030 * MS if held else 0] * 2
    assert switch._lookout.asked == [(0, 0.002)] * 3
    os.close(chip.line)


@pytest.fixture
def clients(monkeypatch):
    """The clients that come to a socket, None for one that has gone again."""
    waiting = []
    monkeypatch.setattr(deadman, "_accepted", lambda listener: waiting.pop(0))
    return waiting


class Client:
    """A client that has said these bytes, and then went."""

    def __init__(self, *said):
        self.said, self.closed = list(said), False

    def fileno(self):
        return 1000

    def recv(self, size):
        return self.said.pop(0)

    def close(self):
        self.closed = True


@pytest.fixture
def held(clock, short_path):
    told = []
    switch = HeldSocket(told.append, short_path / "hand")
    clock.now_ns = 5000 * MS
    yield SimpleNamespace(switch=switch, told=told)
    switch._listener.close()


def test_a_byte_counts_for_100_ms(held, clients):
    clients.append(client := Client(b"x", b"y", b""))
    held.switch._lookout = Ready([0], [1], [], [1], [1], None)
    held.switch._watch()
    assert held.told == [5100 * MS, 5100 * MS, 0]
    assert held.switch._lookout.asked == [(1, 0.1), (2, 0.1), (2, 0.1), (2, 0.1), (2, 0.1), (1, 0.1)]
    assert client.closed


def test_a_second_client_that_has_gone_again_lets_nothing_go(held, clients):
    clients += [client := Client(b"x"), None]
    held.switch._lookout = Ready([0], [0], [1], None)
    held.switch._watch()
    assert held.told == [5100 * MS]
    assert client.closed


def test_a_client_never_blocks_the_watcher(short_path):
    with HeldSocket([].append, short_path / "hand") as switch:
        pass
    assert switch._listener.fileno() == -1
    listener = socket.socket(socket.AF_UNIX)
    with listener, socket.socket(socket.AF_UNIX) as client:
        listener.bind(str(short_path / "other"))
        listener.listen()
        client.connect(str(short_path / "other"))
        with deadman._accepted(listener) as accepted:
            assert not accepted.getblocking()


def test_each_kind_of_switch_is_made_of_its_text(terminal, short_path, monkeypatch):
    others = []
    key = switch_of("key", [].append, others.append)
    assert isinstance(key, HeldKey)
    key._struck(b"5")
    assert others == [b"5"]
    with switch_of(f"socket:{short_path}/hand", [].append) as made:
        assert isinstance(made, HeldSocket)
        assert made.path == Path(f"{short_path}/hand")
    lines = []
    monkeypatch.setattr(deadman, "HeldLine", lambda hold, chip, number, *, low: lines.append((chip, number, low)))
    switch_of("gpio:gpiochip1:3", [].append)
    switch_of("gpio:gpiochip1:4:low", [].append)
    assert lines == [(Path("/dev/gpiochip1"), 3, False), (Path("/dev/gpiochip1"), 4, True)]
