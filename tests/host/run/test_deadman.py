"""Dead man's switches outside of the bus: held while they are held, and let go by whatever befalls
them.
"""

from __future__ import annotations

import errno
import os
import socket
import sys
import threading
import time

import pytest

from coulombus.host.errors import SafetyTrip
from coulombus.host.run import deadman
from coulombus.host.run.deadman import GET_LINE, GET_VALUES, LINE, VALUES, HeldLine, HeldSocket, switch_of
from coulombus.rigs.rig import RigError, load_rig

PATIENCE_S = 10


class Plane:
    """What the data plane is told."""

    def __init__(self):
        self.until_ns, self.told = -1, threading.Condition()

    def hold(self, until_ns):
        with self.told:
            self.until_ns = until_ns
            self.told.notify_all()

    def wait(self, held):
        """Wait until the switch is told to be held, or let go by a word (not by silence)."""
        with self.told:
            assert self.told.wait_for(lambda: (self.until_ns > time.monotonic_ns()) is held, PATIENCE_S)

    def wait_word(self):
        with self.told:
            assert self.told.wait_for(lambda: self.until_ns == 0, PATIENCE_S)


@pytest.fixture
def plane():
    return Plane()


# a socket


@pytest.fixture
def switch(tmp_path, plane, monkeypatch):
    monkeypatch.setattr(deadman, "SILENCE_S", 2.0)  # a machine that is busy lets nothing go by itself
    with HeldSocket(plane.hold, tmp_path / "hand") as switch:
        yield switch


def connect(switch):
    client = socket.socket(socket.AF_UNIX)
    client.connect(str(switch.path))
    return client


def test_a_socket_is_held_by_a_byte_and_let_go_by_its_end(switch, plane):
    assert not switch.held
    with connect(switch) as client:
        assert not switch.held
        client.send(b"x")
        plane.wait(True)
        assert switch.held
        assert plane.until_ns <= time.monotonic_ns() + 2e9
    plane.wait_word()
    assert not switch.held


def test_silence_lets_a_socket_go(tmp_path, plane, monkeypatch):
    monkeypatch.setattr(deadman, "SILENCE_S", 0.05)
    with HeldSocket(plane.hold, tmp_path / "hand") as switch, connect(switch) as client:
        client.send(b"x")
        plane.wait(True)
        while switch.held:
            switch._lookout._thread.join(0.005)
        assert plane.until_ns != 0  # no word was needed: the time was over


def test_a_second_client_lets_go_and_ends_both(switch, plane):
    with connect(switch) as one:
        one.send(b"x")
        plane.wait(True)
        with connect(switch) as other:
            plane.wait_word()
            assert (one.recv(1), other.recv(1)) == (b"", b"")
    with connect(switch) as third:  # before arming a hand may come again
        third.send(b"x")
        plane.wait(True)


def test_a_socket_is_for_its_user_and_goes_with_its_run(tmp_path, plane):
    with HeldSocket(plane.hold, tmp_path / "hand") as switch:
        assert switch.path.stat().st_mode & 0o777 == 0o600
    assert not switch.path.exists()
    assert plane.until_ns == 0


def test_an_abandoned_socket_is_replaced_and_anything_else_is_refused(tmp_path, plane):
    path = tmp_path / "hand"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    with HeldSocket(plane.hold, path), pytest.raises(SafetyTrip, match="another host listens on it"):
        HeldSocket(plane.hold, path)
    path.write_text("mine")
    with pytest.raises(SafetyTrip, match="something else is there"):
        HeldSocket(plane.hold, path)
    assert path.read_text() == "mine"
    with pytest.raises(SafetyTrip, match="No such file or directory"):
        HeldSocket(plane.hold, tmp_path / "none" / "hand")


# a line


class Chip:
    """A GPIO chip of one free line, in the kernel's place: each call is refused that the kernel
    refuses, of a wrong descriptor, a wrong request, or a structure that it does not take.
    """

    def __init__(self, folder):
        self.path, self.level, self.error, self.flags = folder / "gpiochip0", 0, None, 0
        self.path.write_bytes(b"")
        self.line_path, self.line = folder / "line", -1
        self.line_path.write_bytes(b"")

    def ioctl(self, fd, request, given):
        number = self.error or self._why_not(fd, request, given)
        if number is not None:
            raise OSError(number, os.strerror(number))
        if request == GET_LINE:
            *same, _ = LINE.unpack(given)
            self.flags = same[2]
            self.line = os.open(self.line_path, os.O_RDONLY)
            return LINE.pack(*same, self.line)
        active = self.level ^ (self.flags >> 1 & 1)
        return VALUES.pack(active, 1)

    def _why_not(self, fd, request, given):
        try:
            here = os.fstat(fd)
        except OSError as error:  # no descriptor at all
            return error.errno
        wanted = {GET_LINE: self.path, GET_VALUES: self.line_path}.get(request)
        if wanted is None or not os.path.samestat(here, wanted.stat()):
            return errno.ENOTTY
        if request == GET_VALUES:
            return None if given == VALUES.pack(0, 1) else errno.EINVAL
        offsets, name, flags, *rest = LINE.unpack(given)
        right = offsets == (17).to_bytes(4, sys.byteorder) + bytes(252)
        right = right and name.rstrip(b"\0") == b"coulombus dead man" and flags in (0x204, 0x106)
        return None if right and rest == [0, bytes(20), bytes(240), 1, 0, bytes(20), -1] else errno.EINVAL


@pytest.fixture
def chip(tmp_path):
    return Chip(tmp_path)


def line(chip, plane, **options):
    return HeldLine(plane.hold, chip.path, 17, ioctl=chip.ioctl, **options)


def test_the_kernel_s_structures_have_their_sizes():
    assert (LINE.size, VALUES.size) == (GET_LINE >> 16 & 0x3FFF, GET_VALUES >> 16 & 0x3FFF)


@pytest.mark.parametrize(("low", "held", "pull"), [(False, 1, 1 << 9), (True, 0, 1 << 8)])
def test_a_line_is_held_at_its_level_and_a_broken_cable_lets_go(chip, plane, monkeypatch, low, held, pull):
    monkeypatch.setattr(deadman, "LEVEL_S", 5.0)
    chip.level = 1 - held
    with line(chip, plane, low=low):
        plane.wait_word()
        chip.level = held
        plane.wait(True)
        chip.level = 1 - held  # the pull resistor does that to a cable that is open
        plane.wait_word()
    assert chip.flags & 0x304 == pull | 1 << 2
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(chip.line)  # given back


def test_a_line_that_is_unplugged_is_let_go(chip, plane, monkeypatch):
    monkeypatch.setattr(deadman, "LEVEL_S", 5.0)
    chip.level = 1
    with line(chip, plane) as switch:
        plane.wait(True)
        chip.error = errno.ENODEV
        plane.wait_word()
        assert not switch.held


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (errno.EBUSY, "another program has this line"),
        (errno.EINVAL, "no such line"),
        (errno.ENOTTY, "not a GPIO device"),
    ],
)
def test_a_line_that_cannot_be_had_is_refused_with_its_reason(chip, plane, error, text):
    chip.error = error
    with pytest.raises(SafetyTrip, match=f"line 17 of .*gpiochip0 cannot be had: .*{text}"):
        line(chip, plane)
    chip.path.unlink()
    with pytest.raises(SafetyTrip, match="there is no such device"):
        line(chip, plane)


# the rig file


@pytest.mark.parametrize("text", ["gpio:gpiochip0:17", "gpio:gpiochip1:3:low", "socket:/run/coulombus/deadman"])
def test_a_rig_file_names_a_switch(text):
    assert load_rig("bench", [f"host.deadman={text}"]).host.deadman == text


@pytest.mark.parametrize("text", ["gpio:0:17", "gpio:gpiochip0", "gpio:gpiochip0:17:high", "socket:here", "socket:"])
def test_a_rig_file_that_names_no_switch_is_refused_with_the_forms(text):
    with pytest.raises(RigError, match='gpio:gpiochipN:LINE:low" or "socket:/PATH"'):
        load_rig("bench", [f"host.deadman={text}"])


def test_what_the_cycle_looks_at_itself_has_no_watcher(plane):
    assert switch_of("none", plane.hold) is None
    assert switch_of("object:60FD:0:0x00010000", plane.hold) is None
    with pytest.raises(SafetyTrip, match="/dev/gpiochip99"):
        switch_of("gpio:gpiochip99:0", plane.hold)
