"""Who gets a place at a virtual bus, how it is greeted, and what is left when it goes. No loop runs."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server import server as module
from coulombus.sim_bus.server.clients import MESSAGE_FRAMES, SLOTS, STATION, SlotState
from coulombus.sim_bus.server.records import PaceRecord, SlotRecord
from coulombus.sim_bus.server.server import LOSERS_TOLD, MUTE_S, SO_SNDBUFFORCE, BusServer, SimResult
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.frame import new_records
from coulombus.wire.handshake import MAX_FILTERS, SEND_BUFFER, Answer, BusStatus, Flags, Hello
from coulombus.wire.recvmsg import Mailbox

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
def server(monkeypatch):
    """Return a server whose loop never runs."""
    found = object.__new__(BusServer)
    found.address, found.bit_rate, found.result = ADDRESS, 500_000, SimResult("coulombus:desk")
    found.world = VirtualNetwork(500_000, capacity=1)
    found._pace, found._slots = new_records(PaceRecord), new_records(SlotRecord, SLOTS + 1)
    found._slots["fd"] = -1
    found._words = np.zeros((SLOTS + 1, 2 * MESSAGE_FRAMES), np.int64)
    found._boxes = new_records(Mailbox, SLOTS + 1)
    found._filters = np.zeros((SLOTS + 1, MAX_FILTERS, 2), np.int64)
    found._sockets, found._pids, found._since = {}, {}, {}
    found._listener = Listener()
    found._spare = os.open(os.devnull, os.O_RDONLY)
    found.clock = SimpleNamespace(s=100.0)
    found.ends = []
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: found.clock.s))
    yield found
    for one in [*found._sockets.values(), *found.ends]:
        one.close()
    os.close(found._spare)


def pair(server):
    """Return both ends of a connection: the server's, and the client's."""
    mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setblocking(False)
    server.ends.append(theirs)
    return mine, theirs


def admitted(server, i, state=SlotState.GREETING):
    mine, theirs = pair(server)
    server._admit(i, mine, state)
    return theirs


def greeted(server, i, message):
    """Let the client in slot `i` send a message that is no frames."""
    server._words[i].view(np.uint8)[: len(message)] = np.frombuffer(message, np.uint8)
    server._pace["message_bytes"] = len(message)
    server._greeted(i)


def answer(client):
    return Answer.unpack(client.recv(1 << 12))


def controller(server, i):
    return server.world.bus[0].stations[STATION + i]


# a place


def test_the_first_free_place_is_given(server):
    assert server._place() == 0
    admitted(server, 0)
    admitted(server, 2, SlotState.OPEN)
    assert server._place() == 1


def full(server, state=SlotState.OPEN, but=()):
    """Take all places for clients."""
    for i in range(SLOTS):
        admitted(server, i, SlotState.GREETING if i in but else state)


def test_where_all_places_are_taken_one_is_left_to_say_so(server):
    full(server)
    assert server._place() == SLOTS
    admitted(server, SLOTS, SlotState.OPEN)
    assert server._place() is None
    assert len(server._sockets) == SLOTS + 1


@pytest.mark.parametrize(("silent_s", "place"), [(MUTE_S, SLOTS), (MUTE_S + 0.5, 3)])
def test_who_says_nothing_for_two_seconds_loses_its_place(server, silent_s, place):
    full(server, but=(3, 5))
    server.clock.s += silent_s
    assert server._place() == place
    assert [i for i in range(SLOTS) if server._slots[i]["state"] == SlotState.FREE] == ([3, 5] if place == 3 else [])
    assert MUTE_S == 2.0


def test_who_says_nothing_stays_where_there_are_other_places(server):
    admitted(server, 0)
    server.clock.s += 10 * MUTE_S
    assert server._place() == 1
    assert 0 in server._sockets


def test_where_not_even_the_last_place_is_free_the_first_that_is_silent_goes(server):
    full(server, but=(5, 3))
    admitted(server, SLOTS)
    assert server._place() == 3
    assert sorted(set(range(SLOTS + 1)) - set(server._sockets)) == [3]
    admitted(server, 3)  # now it came last
    assert server._place() == 5


def test_the_place_of_the_one_that_is_told_goes_last(server):
    mine, _ = pair(server)
    server._admit(SLOTS, mine, SlotState.GREETING)
    full(server, but=(7,))
    assert server._place() == 7
    admitted(server, 7, SlotState.OPEN)
    assert server._place() == SLOTS


def test_a_client_begins_with_nothing_counted(server):
    server._slots[4]["lost"], server._boxes[4]["overflow"] = 9, 5
    mine, _ = pair(server)
    server._admit(4, mine, SlotState.GREETING)
    slot = server._slots[4]
    assert (slot["fd"], slot["state"], slot["lost"]) == (mine.fileno(), SlotState.GREETING, 0)
    assert server._boxes[4]["overflow"] == 0
    assert server._pids == {4: os.getpid()}
    assert server._since == {4: 100.0}
    admitted(server, 5, SlotState.JOINED)
    assert 5 not in server._pids


# a greeting


@pytest.mark.parametrize("flags", [Flags(0), Flags.OWN, Flags.LISTEN_ONLY, Flags.LISTEN_ONLY | Flags.ERRORS])
def test_who_greets_is_on_the_bus(server, flags):
    client = admitted(server, 2)
    filters = ((0x181, 0x7FF), (0x80, 0x7F0))
    greeted(server, 2, Hello(flags, filters).pack())
    slot = server._slots[2]
    assert (slot["state"], slot["greeted"], slot["filters"]) == (SlotState.OPEN, int(flags), 2)
    assert server._filters[2, :2].tolist() == [list(one) for one in filters]
    assert (controller(server, 2).attached, controller(server, 2).listen_only) == (1, int(Flags.LISTEN_ONLY in flags))
    told = answer(client)
    assert (told.status, told.bitrate_bit_s, told.station, told.lost) == (BusStatus.OK, 500_000, STATION + 2, 0)
    assert told.controller.state != module.state_of(controller(server, 3)).state  # that one is off the bus
    assert server.result.clients == 1


def test_a_second_greeting_changes_the_first_and_is_the_same_client(server):
    client = admitted(server, 0)
    greeted(server, 0, Hello(Flags.LISTEN_ONLY, ((1, 2),)).pack())
    server._slots[0]["lost"] = 6
    greeted(server, 0, Hello().pack())
    assert (server._slots[0]["filters"], server._slots[0]["greeted"], controller(server, 0).listen_only) == (0, 0, 0)
    assert [answer(client).lost for _ in range(2)] == [0, 6]
    assert server.result.clients == 1
    assert server._slots[0]["malformed"] == 0


def test_who_is_only_to_be_told_that_there_is_no_place_goes(server):
    client = admitted(server, SLOTS)
    greeted(server, SLOTS, Hello().pack())
    assert answer(client).status is BusStatus.FULL
    assert server._sockets == {}
    assert server.result.clients == 0


def test_who_does_not_greet_is_told_that_first(server):
    client = admitted(server, SLOTS)
    greeted(server, SLOTS, b"nonsense")
    assert answer(client).status is BusStatus.BAD_HELLO


def test_a_client_behind_a_cut_is_on_its_half_of_the_cable(server):
    bus = server.world.bus
    bus[0].stations[STATION + 2].half = 1
    client = admitted(server, 2)
    greeted(server, 2, Hello(Flags.LISTEN_ONLY).pack())
    halves = [half.stations[STATION + 2] for half in (bus[0], bus[1])]
    assert [(one.attached, one.listen_only) for one in halves] == [(0, 0), (1, 1)]
    assert answer(client).controller == module.state_of(halves[1])
    server._part(2)
    assert halves[1].attached == 0


@pytest.mark.parametrize("first", [True, False])
def test_who_does_not_greet_is_turned_away_and_who_has_greeted_stays(server, first):
    client = admitted(server, 1)
    if not first:
        greeted(server, 1, Hello().pack())
        answer(client)
    greeted(server, 1, b"nonsense")
    assert answer(client).status is BusStatus.BAD_HELLO
    assert (1 in server._sockets) is not first
    assert server._slots[1]["malformed"] == (not first)
    assert server.result.malformed == 0
    assert server.result.clients == (not first)


def test_a_client_that_has_gone_before_its_answer_is_left_to_the_loop(server):
    client = admitted(server, 1)
    client.close()
    greeted(server, 1, Hello().pack())
    assert server._slots[1]["state"] == SlotState.OPEN


# the end of a client


@pytest.mark.parametrize("state", [SlotState.OPEN, SlotState.GREETING])
@pytest.mark.parametrize("lost", [0, 4])
def test_what_a_client_lost_is_told_of_those_that_were_on_the_bus(server, state, lost):
    client = admitted(server, 3)
    if state is SlotState.OPEN:
        greeted(server, 3, Hello().pack())
        answer(client)
    slot = server._slots[3]
    slot["lost"], slot["delivered"], slot["malformed"] = lost, 8, 2
    server._pace["listener"] = -1
    server._part(3)
    opened = state is SlotState.OPEN
    assert (server.result.lost, server.result.malformed) == (lost if opened else 0, 2)
    told = {"pid": os.getpid(), "lost": lost, "delivered": 8}
    assert server.result.losers == ([told] if opened and lost else [])
    assert (slot["state"], slot["fd"], controller(server, 3).attached) == (SlotState.FREE, -1, 0)
    assert server._pids == {}
    assert client.recv(1) == b""
    assert server._pace["listener"] == 77  # there is a place again


def test_a_loser_of_no_known_process_is_told_as_such(server):
    admitted(server, 0, SlotState.OPEN)
    server._slots[0]["lost"] = 1
    server._part(0)
    assert server.result.losers == [{"pid": 0, "lost": 1, "delivered": 0}]


def test_twenty_losers_are_told(server):
    for _ in range(LOSERS_TOLD + 2):
        admitted(server, 0)
        server._slots[0]["state"], server._slots[0]["lost"] = SlotState.OPEN, 1
        server._part(0)
    assert (len(server.result.losers), server.result.lost, LOSERS_TOLD) == (20, 22, 20)


def test_without_a_listener_none_is_waited_for(server):
    server._listener = None
    server._pace["listener"] = -1
    admitted(server, 0)
    server._part(0)
    assert server._pace["listener"] == -1


@pytest.mark.parametrize(("gone", "status"), [(None, 0), ("gone", 4)])
def test_a_bus_that_ended_before_its_time_is_an_exit_status(gone, status):
    assert SimResult("x", gone=gone).exit_status == status


# a connection


def test_a_connection_is_taken_and_waits_for_its_greeting(server):
    mine, _ = pair(server)
    server._listener.waiting = [mine]
    server._accept()
    assert server._sockets == {0: mine}
    assert server._slots[0]["state"] == SlotState.GREETING
    assert not mine.getblocking()


@pytest.mark.parametrize("forced", [True, False])
def test_a_connection_gets_a_long_queue_where_that_is_allowed_and_stamps(server, monkeypatch, forced):
    log = []

    def setsockopt(*what):
        log.append(what)
        if what[1] == SO_SNDBUFFORCE and not forced:
            raise PermissionError

    client = SimpleNamespace(setblocking=lambda on: log.append(on), setsockopt=setsockopt)
    monkeypatch.setattr(module, "ask_for_stamps", lambda one: log.append(one))
    monkeypatch.setattr(server, "_admit", lambda *what: log.append(what))
    server._listener.waiting = [client]
    server._accept()
    sizes = [(socket.SOL_SOCKET, name, SEND_BUFFER) for name in (SO_SNDBUFFORCE, socket.SO_SNDBUF)]
    assert log == [False, *sizes[: 1 if forced else 2], client, (0, client, SlotState.GREETING)]


def test_without_a_place_a_connection_waits(server):
    full(server)
    admitted(server, SLOTS, SlotState.OPEN)
    server._pace["listener"] = 77
    server._listener.waiting = ["a client"]
    server._accept()
    assert server._pace["listener"] == -1
    assert server._listener.waiting == ["a client"]


@pytest.mark.parametrize("error", [BlockingIOError(), ConnectionAbortedError()])
def test_a_connection_that_has_gone_already_is_nobody(server, error):
    server._listener.waiting = [error]
    server._accept()
    assert server._sockets == {}


def test_a_connection_that_cannot_be_taken_ends_the_bus(server):
    server._listener.waiting = [OSError(errno.ENOMEM, "no memory")]
    text = "^bus coulombus:desk: no further client can be accepted: no memory$"
    with pytest.raises(BusUnavailable, match=text):
        server._accept()


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE])
def test_without_a_descriptor_a_client_is_let_in_and_out_again(server, number):
    mine, theirs = pair(server)
    server._listener.waiting = [OSError(number, "too many"), mine]
    server._accept()
    assert answer(theirs).status is BusStatus.FULL
    assert theirs.recv(1) == b""
    assert server._sockets == {}
    os.fstat(server._spare)  # there is one to spare again
    server._listener.waiting = [OSError(number, "too many")]
    server._accept()  # it has gone
    os.fstat(server._spare)
    server._listener.waiting = [OSError(number, "too many"), OSError(number, "too many")]
    with pytest.raises(BusUnavailable, match="no further client can be accepted: too many"):
        server._accept()
    os.fstat(server._spare)


def test_the_spare_descriptor_is_free_while_a_client_is_turned_away(server):
    def accept():
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(server._spare)
        raise BlockingIOError

    server._listener.accept = accept
    server._turn_away()
    os.fstat(server._spare)


@pytest.mark.parametrize("error", [OSError("gone"), ValueError("x")])
@pytest.mark.parametrize("late", [True, False])
def test_one_connection_that_cannot_be_set_up_costs_nobody_else_the_bus(server, monkeypatch, error, late):
    mine, theirs = pair(server)
    server._listener.waiting = [mine]
    admit = server._admit

    def failing(*what):
        if late:
            admit(*what)
        raise error

    monkeypatch.setattr(server, "_admit", failing)
    if isinstance(error, OSError):
        server._accept()
    else:
        with pytest.raises(ValueError, match="x"):
            server._accept()
    assert (server._sockets, mine.fileno()) == ({}, -1)
    assert theirs.recv(1) == b""
    assert server._slots[0]["state"] == SlotState.FREE


# the socket's file


def test_only_the_file_of_a_dead_process_is_replaced(tmp_path):
    path = tmp_path / "desk"
    assert module._refuse_live(path, ADDRESS) is False
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        assert module._refuse_live(path, ADDRESS) is True  # bound, and nobody listens
        listener.listen(0)
        text = r"^bus coulombus:desk is served already by another process \(.*desk\); stop that one, or choose"
        for _ in range(3):  # the second waits, the third finds the queue full
            with pytest.raises(BusUnavailable, match=text):
                module._refuse_live(path, ADDRESS)
    assert module._refuse_live(path, ADDRESS) is True


def test_only_the_server_s_own_file_is_removed(server, tmp_path):
    path = tmp_path / "desk"
    path.touch()
    server._inode = path.stat().st_ino + 1
    server._unlink(path)
    assert path.exists()
    server._inode = path.stat().st_ino
    server._unlink(path)
    assert not path.exists()
    server._unlink(path)


def test_two_servers_do_not_start_at_a_time_in_one_folder(tmp_path):
    other = os.open(tmp_path, os.O_RDONLY)
    with module._locked(tmp_path), pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(other)
