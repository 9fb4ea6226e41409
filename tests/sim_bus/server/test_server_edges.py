"""Who gets a place at a virtual bus, how it is greeted, and what is left when it goes. No loop runs."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.sim_bus.can_bus.fault_confinement import state_of
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server import admission as module
from coulombus.sim_bus.server import socket_file
from coulombus.sim_bus.server.admission import LOSERS_TOLD, MUTE_S, SO_SNDBUFFORCE, Admission
from coulombus.sim_bus.server.clients import SLOTS, STATION, SlotState
from coulombus.sim_bus.server.records import PaceRecord
from coulombus.sim_bus.server.sim_result import SimResult
from coulombus.sim_bus.server.socket_file import locked, refuse_live, unlink_own
from coulombus.system.file_lock import lock_file
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.handshake import SEND_BUFFER, Answer, BusStatus, Flags, Hello

ADDRESS = parse_address("coulombus:desk")


class Listener:
    """A listening socket: what it gives next, a client or an error."""

    def __init__(self):
        self.waiting = []

    def accept(self):
        found = self.waiting.pop(0) if self.waiting else BlockingIOError()
        if isinstance(found, Exception):
            raise found
        return found, None

    def fileno(self):
        return 77


@pytest.fixture
def admission(monkeypatch):
    """Return the places of a bus whose loop never runs."""
    pace, result = new_records(PaceRecord), SimResult("coulombus:desk")
    admission = Admission(str(ADDRESS), 500_000, VirtualNetwork(500_000, capacity=1), pace, result)
    admission.listen(Listener())
    admission.clock = SimpleNamespace(s=100.0)
    admission.ends = []
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: admission.clock.s))
    yield admission
    for end in [*admission.sockets.values(), *admission.ends]:
        end.close()
    os.close(admission._spare)


def pair(admission):
    """Return both ends of a connection: the server's, and the client's."""
    mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setblocking(False)
    admission.ends.append(theirs)
    return mine, theirs


def admitted(admission, i, state=SlotState.GREETING):
    mine, theirs = pair(admission)
    admission.admit(i, mine, state)
    return theirs


def greeted(admission, i, message):
    """Let the client in slot `i` send a message that is no frames."""
    admission._words[i].view(np.uint8)[: len(message)] = np.frombuffer(message, np.uint8)
    admission._pace["message_bytes"] = len(message)
    admission.greeted(i)


def answer(client):
    return Answer.unpack(client.recv(1 << 12))


def controller(admission, i):
    return admission._world.bus[0].stations[STATION + i]


# a place


def test_the_first_free_place_is_given(admission):
    assert admission._place() == 0
    admitted(admission, 0)
    admitted(admission, 2, SlotState.OPEN)
    assert admission._place() == 1


def full(admission, state=SlotState.OPEN, but=()):
    """Take all places for clients."""
    for i in range(SLOTS):
        admitted(admission, i, SlotState.GREETING if i in but else state)


def test_where_all_places_are_taken_one_is_left_to_say_so(admission):
    full(admission)
    assert admission._place() == SLOTS
    admitted(admission, SLOTS, SlotState.OPEN)
    assert admission._place() is None
    assert len(admission.sockets) == SLOTS + 1


@pytest.mark.parametrize(("silent_s", "place"), [(MUTE_S, SLOTS), (MUTE_S + 0.5, 3)])
def test_who_says_nothing_for_two_seconds_loses_its_place(admission, silent_s, place):
    full(admission, but=(3, 5))
    admission.clock.s += silent_s
    assert admission._place() == place
    assert [i for i in range(SLOTS) if admission.slots[i]["state"] == SlotState.FREE] == ([3, 5] if place == 3 else [])
    assert MUTE_S == 2.0


def test_who_says_nothing_stays_where_there_are_other_places(admission):
    admitted(admission, 0)
    admission.clock.s += 10 * MUTE_S
    assert admission._place() == 1
    assert 0 in admission.sockets


def test_where_not_even_the_last_place_is_free_the_first_that_is_silent_goes(admission):
    full(admission, but=(5, 3))
    admitted(admission, SLOTS)
    assert admission._place() == 3
    assert sorted(set(range(SLOTS + 1)) - set(admission.sockets)) == [3]
    admitted(admission, 3)  # now it came last
    assert admission._place() == 5


def test_the_place_of_the_one_that_is_told_goes_last(admission):
    mine, _ = pair(admission)
    admission.admit(SLOTS, mine, SlotState.GREETING)
    full(admission, but=(7,))
    assert admission._place() == 7
    admitted(admission, 7, SlotState.OPEN)
    assert admission._place() == SLOTS


def test_a_client_begins_with_nothing_counted(admission):
    admission.slots[4]["lost"], admission._boxes[4]["overflow"] = 9, 5
    mine, _ = pair(admission)
    admission.admit(4, mine, SlotState.GREETING)
    slot = admission.slots[4]
    assert (slot["fd"], slot["state"], slot["lost"]) == (mine.fileno(), SlotState.GREETING, 0)
    assert admission._boxes[4]["overflow"] == 0
    assert admission._pids == {4: os.getpid()}
    assert admission._since == {4: 100.0}
    admitted(admission, 5, SlotState.JOINED)
    assert 5 not in admission._pids


# a greeting


@pytest.mark.parametrize("flags", [Flags(0), Flags.OWN, Flags.LISTEN_ONLY, Flags.LISTEN_ONLY | Flags.ERRORS])
def test_who_greets_is_on_the_bus(admission, flags):
    client = admitted(admission, 2)
    filters = ((0x181, 0x7FF), (0x80, 0x7F0))
    greeted(admission, 2, Hello(flags, filters).pack())
    slot = admission.slots[2]
    assert (slot["state"], slot["greeted"], slot["filters"]) == (SlotState.OPEN, int(flags), 2)
    assert admission._filters[2, :2].tolist() == [list(one) for one in filters]
    c = controller(admission, 2)
    assert (c.attached, c.listen_only) == (1, int(Flags.LISTEN_ONLY in flags))
    told = answer(client)
    assert (told.status, told.bitrate_bit_s, told.station, told.lost) == (BusStatus.OK, 500_000, STATION + 2, 0)
    assert told.controller.state != state_of(controller(admission, 3)).state  # that one is off the bus
    assert admission._result.clients == 1


def test_a_second_greeting_changes_the_first_and_is_the_same_client(admission):
    client = admitted(admission, 0)
    greeted(admission, 0, Hello(Flags.LISTEN_ONLY, ((1, 2),)).pack())
    admission.slots[0]["lost"] = 6
    greeted(admission, 0, Hello().pack())
    slot = admission.slots[0]
    assert (slot["filters"], slot["greeted"], controller(admission, 0).listen_only) == (0, 0, 0)
    assert [answer(client).lost for _ in range(2)] == [0, 6]
    assert admission._result.clients == 1
    assert admission.slots[0]["malformed"] == 0


def test_who_is_only_to_be_told_that_there_is_no_place_goes(admission):
    client = admitted(admission, SLOTS)
    greeted(admission, SLOTS, Hello().pack())
    assert answer(client).status is BusStatus.FULL
    assert admission.sockets == {}
    assert admission._result.clients == 0


def test_who_does_not_greet_is_told_that_first(admission):
    client = admitted(admission, SLOTS)
    greeted(admission, SLOTS, b"nonsense")
    assert answer(client).status is BusStatus.BAD_HELLO


def test_a_client_behind_a_cut_is_on_its_half_of_the_cable(admission):
    bus = admission._world.bus
    bus[0].stations[STATION + 2].half = 1
    client = admitted(admission, 2)
    greeted(admission, 2, Hello(Flags.LISTEN_ONLY).pack())
    halves = [half.stations[STATION + 2] for half in (bus[0], bus[1])]
    assert [(one.attached, one.listen_only) for one in halves] == [(0, 0), (1, 1)]
    assert answer(client).controller == state_of(halves[1])
    admission.part(2)
    assert halves[1].attached == 0


@pytest.mark.parametrize("first", [True, False])
def test_who_does_not_greet_is_turned_away_and_who_has_greeted_stays(admission, first):
    client = admitted(admission, 1)
    if not first:
        greeted(admission, 1, Hello().pack())
        answer(client)
    greeted(admission, 1, b"nonsense")
    assert answer(client).status is BusStatus.BAD_HELLO
    assert (1 in admission.sockets) is not first
    assert admission.slots[1]["malformed"] == (not first)
    assert admission._result.malformed == 0
    assert admission._result.clients == (not first)


def test_a_client_that_has_gone_before_its_answer_is_left_to_the_loop(admission):
    client = admitted(admission, 1)
    client.close()
    greeted(admission, 1, Hello().pack())
    assert admission.slots[1]["state"] == SlotState.OPEN


# the end of a client


@pytest.mark.parametrize("state", [SlotState.OPEN, SlotState.GREETING])
@pytest.mark.parametrize("lost", [0, 4])
def test_what_a_client_lost_is_told_of_those_that_were_on_the_bus(admission, state, lost):
    client = admitted(admission, 3)
    if state is SlotState.OPEN:
        greeted(admission, 3, Hello().pack())
        answer(client)
    slot = admission.slots[3]
    slot["lost"], slot["delivered"], slot["malformed"] = lost, 8, 2
    admission._pace["listener"] = -1
    admission.part(3)
    opened = state is SlotState.OPEN
    assert (admission._result.lost, admission._result.malformed) == (lost if opened else 0, 2)
    told = {"pid": os.getpid(), "lost": lost, "delivered": 8}
    assert admission._result.losers == ([told] if opened and lost else [])
    assert (slot["state"], slot["fd"], controller(admission, 3).attached) == (SlotState.FREE, -1, 0)
    assert admission._pids == {}
    assert client.recv(1) == b""
    assert admission._pace["listener"] == 77  # there is a place again


def test_a_loser_of_no_known_process_is_told_as_such(admission):
    admitted(admission, 0, SlotState.OPEN)
    admission.slots[0]["lost"] = 1
    admission.part(0)
    assert admission._result.losers == [{"pid": 0, "lost": 1, "delivered": 0}]


def test_twenty_losers_are_told(admission):
    for _ in range(LOSERS_TOLD + 2):
        admitted(admission, 0)
        admission.slots[0]["state"], admission.slots[0]["lost"] = SlotState.OPEN, 1
        admission.part(0)
    assert (len(admission._result.losers), admission._result.lost, LOSERS_TOLD) == (20, 22, 20)


def test_without_a_listener_none_is_waited_for(admission):
    admission._door, admission._pace["listener"] = None, -1
    admitted(admission, 0)
    admission.part(0)
    assert admission._pace["listener"] == -1


@pytest.mark.parametrize(("gone", "status"), [(None, 0), ("gone", 4)])
def test_a_bus_that_ended_before_its_time_is_an_exit_status(gone, status):
    assert SimResult("x", gone=gone).exit_status == status


# a connection


def test_a_connection_is_taken_and_waits_for_its_greeting(admission):
    mine, _ = pair(admission)
    admission.listeners[0].waiting = [mine]
    admission.accept()
    assert admission.sockets == {0: mine}
    assert admission.slots[0]["state"] == SlotState.GREETING
    assert not mine.getblocking()


@pytest.mark.parametrize("buses", [(0,), (1,), (0, 1), ()])
def test_a_connection_is_on_the_bus_whose_listener_it_came_to(admission, tmp_path, monkeypatch, buses):
    listeners, accepted = [], []
    for k in range(2):
        listeners.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK))
        listeners[k].bind(str(tmp_path / str(k)))
        listeners[k].listen(1)
    several = Admission("desk", 0, VirtualNetwork((500_000, 250_000), capacity=1), admission._pace, admission._result)
    several.listen(*listeners)
    stations = several._world.bus["stations"]["half"]
    stations[:] = 9
    clients = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in buses]
    for client, bus in zip(clients, buses, strict=True):
        client.connect(str(tmp_path / str(bus)))
    accept = several._accept
    monkeypatch.setattr(several, "_accept", lambda bus: accepted.append(bus) or accept(bus))
    several.accept()
    assert accepted == list(buses)  # no other listener costs a silent client its place
    assert list(several.sockets) == list(range(len(buses)))
    for i, bus in enumerate(buses):
        assert stations[:, STATION + i].tolist() == [bus, bus]
    assert (stations == 9).sum() == stations.size - 2 * len(buses)
    for end in (*listeners, *clients, *several.sockets.values(), several._door):
        end.close()
    os.close(several._spare)


@pytest.mark.parametrize("forced", [True, False])
def test_a_connection_gets_a_long_queue_where_that_is_allowed_and_stamps(admission, monkeypatch, forced):
    log = []

    def setsockopt(*what):
        log.append(what)
        if what[1] == SO_SNDBUFFORCE and not forced:
            raise PermissionError

    client = SimpleNamespace(setblocking=lambda on: log.append(on), setsockopt=setsockopt)
    monkeypatch.setattr(module, "ask_for_stamps", lambda one: log.append(one))
    monkeypatch.setattr(admission, "admit", lambda *what: log.append(what))
    admission.listeners[0].waiting = [client]
    admission.accept()
    sizes = [(socket.SOL_SOCKET, name, SEND_BUFFER) for name in (SO_SNDBUFFORCE, socket.SO_SNDBUF)]
    assert log == [False, *sizes[: 1 if forced else 2], client, (0, client, SlotState.GREETING, 0)]


def test_without_a_place_a_connection_waits(admission):
    full(admission)
    admitted(admission, SLOTS, SlotState.OPEN)
    admission._pace["listener"] = 77
    admission.listeners[0].waiting = ["a client"]
    admission.accept()
    assert admission._pace["listener"] == -1
    assert admission.listeners[0].waiting == ["a client"]


@pytest.mark.parametrize("error", [BlockingIOError(), ConnectionAbortedError()])
def test_a_connection_that_has_gone_already_is_nobody(admission, error):
    admission.listeners[0].waiting = [error]
    admission.accept()
    assert admission.sockets == {}


def test_a_connection_that_cannot_be_taken_ends_the_bus(admission):
    admission.listeners[0].waiting = [OSError(errno.ENOMEM, "no memory")]
    text = "^bus coulombus:desk: no further client can be accepted: no memory$"
    with pytest.raises(BusUnavailable, match=text):
        admission.accept()


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE])
def test_without_a_descriptor_a_client_is_let_in_and_out_again(admission, number):
    mine, theirs = pair(admission)
    admission.listeners[0].waiting = [OSError(number, "too many"), mine]
    admission.accept()
    assert answer(theirs).status is BusStatus.FULL
    assert theirs.recv(1) == b""
    assert admission.sockets == {}
    os.fstat(admission._spare)  # there is one to spare again
    admission.listeners[0].waiting = [OSError(number, "too many")]
    admission.accept()  # it has gone
    os.fstat(admission._spare)
    admission.listeners[0].waiting = [OSError(number, "too many"), OSError(number, "too many")]
    with pytest.raises(BusUnavailable, match="no further client can be accepted: too many"):
        admission.accept()
    os.fstat(admission._spare)


def test_the_spare_descriptor_is_free_while_a_client_is_turned_away(admission):
    def accept():
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(admission._spare)
        raise BlockingIOError

    admission.listeners[0].accept = accept
    admission._turn_away(admission.listeners[0])
    os.fstat(admission._spare)


@pytest.mark.parametrize("error", [OSError("gone"), ValueError("x")])
@pytest.mark.parametrize("late", [True, False])
def test_one_connection_that_cannot_be_set_up_costs_nobody_else_the_bus(admission, monkeypatch, error, late):
    mine, theirs = pair(admission)
    admission.listeners[0].waiting = [mine]
    admit = admission.admit

    def failing(*what):
        if late:
            admit(*what)
        raise error

    monkeypatch.setattr(admission, "admit", failing)
    if isinstance(error, OSError):
        admission.accept()
    else:
        with pytest.raises(ValueError, match="x"):
            admission.accept()
    assert (admission.sockets, mine.fileno()) == ({}, -1)
    assert theirs.recv(1) == b""
    assert admission.slots[0]["state"] == SlotState.FREE


# the socket's file


def test_only_the_file_of_a_dead_process_is_replaced(tmp_path):
    path = tmp_path / "desk"
    assert refuse_live(path, ADDRESS) is False
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        assert refuse_live(path, ADDRESS) is True  # bound, and nobody listens
        listener.listen(0)
        text = r"^bus coulombus:desk is served already by another process \(.*desk\); stop that one, or choose"
        for _ in range(3):  # the second waits, the third finds the queue full
            with pytest.raises(BusUnavailable, match=text):
                refuse_live(path, ADDRESS)
    assert refuse_live(path, ADDRESS) is True


def test_only_the_server_s_own_file_is_removed(tmp_path):
    path = tmp_path / "desk"
    path.touch()
    inode = path.stat().st_ino
    unlink_own(path, inode + 1)
    assert path.exists()
    unlink_own(path, inode)
    assert not path.exists()
    unlink_own(path, inode)


def test_two_servers_do_not_start_at_a_time_in_one_folder(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError), locked(tmp_path / "file"):
        pass
    waits = []
    monkeypatch.setattr(socket_file, "lock_file", lambda fd, *, wait: waits.append(wait) or lock_file(fd, wait=wait))
    other = os.open(tmp_path, os.O_RDONLY)
    with locked(tmp_path), pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(other)
    assert waits == [True]
