"""The host's door and who comes there: a stop that stopped nothing is never told as a success, and
no asker holds the host up.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from contextlib import contextmanager

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.errors import SafetyTrip
from coulombus.host.run import control_socket
from coulombus.host.run.control_socket import (
    ASKERS,
    HostSocket,
    NoHost,
    StopRequest,
    control_path,
    hosts_here,
    stop_host,
)
from coulombus.wire.address import parse_address

pytestmark = pytest.mark.usefixtures("private_sockets")

BUS = parse_address("coulombus:x")
RESULT = {"trip": None, "cycles": 7, "mode": "passive"}
SHORT_S = 0.05  # a time-out that is waited for: nobody answers


def connected():
    asker = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    asker.connect(str(control_path(BUS)))
    asker.settimeout(10)
    return asker


@contextmanager
def listener(backlog=8):
    """Something at the door that is no host."""
    path = str(control_path(BUS))
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as found:
        found.bind(path)
        found.listen(backlog)
        yield found
    os.unlink(path)


def refused(request):
    with pytest.raises(NoHost) as caught:
        request.result()
    assert caught.value.exit_status == 4
    return str(caught.value)


def test_one_host_a_bus_and_a_dead_one_does_not_count():
    door = HostSocket(BUS)
    with pytest.raises(SafetyTrip, match="another host runs"):
        HostSocket(BUS)
    HostSocket(parse_address("socketcan:x")).close()  # another bus
    door._listeners[0][1].close()  # as a killed process leaves it
    assert control_path(BUS).exists()
    again = HostSocket(BUS)
    again.close()
    assert not control_path(BUS).exists()
    again.close()


def test_a_host_that_starts_meanwhile_keeps_its_door(monkeypatch):
    """It was taken away, and two hosts had the bus."""
    heard_at, first = control_socket._probe, []

    def then_another_starts(path):
        found = heard_at(path)
        monkeypatch.setattr(control_socket, "_probe", heard_at)
        first.append(HostSocket(BUS))
        return found

    monkeypatch.setattr(control_socket, "_probe", then_another_starts)
    with pytest.raises(SafetyTrip, match="another host starts"):
        HostSocket(BUS)
    assert control_socket.host_runs(BUS)
    first.pop().close()


def test_a_host_whose_door_is_crowded_is_another_host_too():
    """connect() waited for ever."""
    with listener(backlog=0), connected(), pytest.raises(SafetyTrip, match="another host runs"):
        HostSocket(BUS)


def test_who_asks_for_a_stop_hears_what_came_of_it():
    door = HostSocket(BUS)
    assert not door.stop_wanted()
    requests = [StopRequest(BUS), StopRequest(BUS)]
    assert door.stop_wanted()
    assert not door.stop_wanted()
    last = StopRequest(BUS)  # at the last moment
    door.close(RESULT)
    assert [request.result() for request in (*requests, last)] == [RESULT] * 3
    assert "no host runs" in refused(StopRequest(BUS))


def test_the_end_of_a_host_that_has_taken_the_request_is_an_end():
    door = HostSocket(BUS)
    request = StopRequest(BUS)
    assert door.stop_wanted()
    door.close(None)
    assert request.result() == {}


def test_a_socket_file_without_a_process_is_no_host():
    with listener():
        pass
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(control_path(BUS)))
    assert "no host runs" in refused(StopRequest(BUS))


def test_a_listener_that_never_accepts_is_no_success():
    with listener():
        assert "has not stopped within" in refused(StopRequest(BUS, SHORT_S))


def test_a_full_backlog_does_not_hold_the_asker_for_ever():
    with listener(backlog=0), connected():
        assert "does not accept a connection" in refused(StopRequest(BUS, SHORT_S))


@pytest.fixture
def clock(monkeypatch):
    """Time that goes on by waiting alone; yields what was waited for."""
    waited = []

    class Patient(socket.socket):
        def settimeout(self, seconds):
            self.patience = seconds

        def recv(self, size):
            try:
                return super().recv(size)
            except BlockingIOError:
                waited.append(self.patience)
                raise TimeoutError from None

    monkeypatch.setattr(control_socket.time, "monotonic", lambda: sum(waited))
    monkeypatch.setattr(control_socket.time, "sleep", waited.append)
    kind = socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK
    monkeypatch.setattr(control_socket, "_new", lambda: Patient(socket.AF_UNIX, kind))
    return waited


@pytest.mark.parametrize("backlog", [0, 8])
def test_a_stop_that_nobody_lets_in_gives_up_after_three_seconds(clock, backlog):
    with listener(backlog), connected():
        text = refused(StopRequest(BUS))
    assert "within 3 s" in text
    assert 2.9 < sum(clock) < 3.1


def test_a_stop_that_is_taken_has_its_thirty_seconds(clock):
    with listener() as door:
        request = StopRequest(BUS)
        connection, _ = door.accept()
        connection.send(b"accepted")
        assert "has not stopped within 30 s" in refused(request)
        connection.close()
    assert sum(clock) == 30


def closes(connection):
    connection.recv(100)


def resets(connection):
    """Closed with the request unread: ECONNRESET at the other side."""


def answers_half(connection):
    connection.recv(100)
    connection.send(b"accept")


def answers_no_result(connection):
    connection.recv(100)
    connection.send(b"accepted")
    connection.send(b'{"trip": nul')


def answers_another_result(connection):
    connection.recv(100)
    connection.send(b"accepted")
    connection.send(b'{"ok": true}')


def answers_brackets(connection):
    connection.recv(100)
    connection.send(b"accepted")
    connection.send(b"[" * 60000)


def answers_other_types(connection):
    connection.recv(100)
    connection.send(b"accepted")
    connection.send(b'{"trip": null, "cycles": null, "mode": null}')


def accepts_and_resets(connection):
    connection.send(b"accepted")


@pytest.mark.parametrize(
    ("behaviour", "text"),
    [
        (closes, "did not take the request"),
        (resets, "broke off"),
        (answers_half, "no answer that is one"),
        (answers_no_result, "cannot be read"),
        (answers_another_result, "cannot be read"),
        (answers_brackets, "cannot be read"),
        (answers_other_types, "cannot be read"),
        (accepts_and_resets, "broke off"),
    ],
)
def test_what_is_no_orderly_end_is_no_success(behaviour, text):
    with listener() as door:
        request = StopRequest(BUS)
        connection, _ = door.accept()
        with connection:
            behaviour(connection)
        found = refused(request)
    assert text in found
    assert "may be armed still" in found


def test_a_door_that_may_not_be_opened_is_no_success(monkeypatch):
    def refuse(self, path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(control_socket, "_new", lambda: type("Shut", (socket.socket,), {"connect": refuse})())
    assert "Permission denied" in refused(StopRequest(BUS))


def test_nonsense_at_the_door_stops_nothing():
    door = HostSocket(BUS)
    with connected() as asker:
        asker.send(b"go faster")
        for _ in range(3):
            assert not door.stop_wanted()
        assert asker.recv(100) == b""
    door.close()


def test_silent_connections_are_few_and_do_not_keep_a_stop_out():
    """253 of them took the host's last descriptor."""
    door = HostSocket(BUS)
    silent = []
    for _ in range(4 * ASKERS):
        silent.append(connected())
        assert not door.stop_wanted()
        assert len(door._askers) <= ASKERS
    request = StopRequest(BUS)
    assert door.stop_wanted()
    door.close(RESULT)
    assert request.result() == RESULT
    assert silent[0].recv(100) == b""  # turned away
    for asker in silent:
        asker.close()


def test_who_says_nothing_is_turned_away_in_time(monkeypatch):
    door = HostSocket(BUS)
    now = [0.0]
    monkeypatch.setattr(control_socket.time, "monotonic", lambda: now[0])
    with connected() as silent:
        assert not door.stop_wanted()
        assert len(door._askers) == 1
        now[0] = 1.5
        assert not door.stop_wanted()
        assert silent.recv(100) == b""
    door.close()


def test_the_verb_ends_with_4_unless_every_host_has_ended(monkeypatch):
    def stop(*buses):
        return CliRunner().invoke(main, ["stop", *(word for bus in buses for word in ("--bus", bus))])

    done = stop("coulombus:x")
    assert done.exit_code == 4
    assert "no host runs on bus coulombus:x" in done.output

    door, answer = HostSocket(BUS), json.dumps(RESULT)

    def serve():
        while not door.stop_wanted():
            pass
        door.close(json.loads(answer))

    host = threading.Thread(target=serve)
    host.start()
    done = stop("coulombus:none", "coulombus:x")  # the first one's failure does not keep the second from its stop
    host.join()
    assert done.exit_code == 4
    assert "no host runs on bus coulombus:none" in done.output
    assert "stopped safely after 7 cycles" in done.output

    door, answer = HostSocket(BUS), json.dumps({**RESULT, "trip": "SPEED: too fast"})
    host = threading.Thread(target=serve)
    host.start()
    done = stop("coulombus:x")
    host.join()
    assert (done.exit_code, done.output) == (0, "the host on coulombus:x had tripped: SPEED: too fast\n")


def test_asking_is_one_call_for_a_script():
    with pytest.raises(NoHost):
        stop_host(BUS)


def looked_after(door, asked):
    """Let the host look at its door until `asked` has its answer; return that."""
    found = []
    asker = threading.Thread(target=lambda: found.append(asked()))
    asker.start()
    while asker.is_alive():
        door.stop_wanted()
    return found[0]


def test_who_asks_for_a_marker_has_it_set():
    marked = []
    door = HostSocket(BUS)
    door.mark = lambda text: marked.append(text) or json.dumps({"marker": f"mark {text}", "recording": "r"}).encode()
    result = looked_after(door, lambda: CliRunner().invoke(main, ["mark", "héld: a=b", "--bus", str(BUS)]))
    door.close()
    assert (result.exit_code, result.output) == (0, "r: mark héld: a=b\n")
    assert marked == ["héld: a=b"]


def test_a_marker_that_is_refused_is_a_usage_error():
    door = HostSocket(BUS)
    door.mark = lambda text: b'{"error": "it does not record; start it with --record"}'
    result = looked_after(door, lambda: CliRunner().invoke(main, ["mark", "x", "--bus", str(BUS)]))
    door.close()
    assert result.exit_code == 2
    assert "start it with --record" in result.output


def test_a_host_that_knows_no_markers_is_told():
    door = HostSocket(BUS)
    result = looked_after(door, lambda: CliRunner().invoke(main, ["mark", "x", "--bus", str(BUS)]))
    door.close()
    assert result.exit_code == 4
    assert "gave no answer that is one" in result.output


@contextmanager
def displaying(*buses):
    """Hosts of these buses that end when they are asked to."""
    doors = [HostSocket(parse_address(bus)) for bus in buses]
    over = threading.Event()

    def serve():
        waiting = list(doors)
        while waiting and not over.is_set():
            for door in [door for door in waiting if door.stop_wanted()]:
                door.close(RESULT)
                waiting.remove(door)
            over.wait(0.001)
        for door in waiting:
            door.close(RESULT)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(10)


@pytest.mark.parametrize(
    "bus",
    ["coulombus:elsewhere", "socketcan:can7", "coulombus:two-words", "coulombus:socketcan", "coulombus:coulombus-x"],
)
def test_the_one_host_of_this_machine_is_found_on_whatever_bus(bus):
    """`stop` asked coulombus:bench and ended with 4 while the host went on."""
    with displaying(bus):
        assert hosts_here() == [parse_address(bus)]
        done = CliRunner().invoke(main, ["stop"])
        assert (done.exit_code, done.stdout) == (
            0,
            f"the host on {bus} stopped safely after 7 cycles in mode passive\n",
        )
    assert hosts_here() == []


@pytest.mark.parametrize("verb", [["stop"], ["status"], ["mark", "x"], ["set"]])
def test_of_several_hosts_one_has_to_be_named(verb):
    with displaying("coulombus:a", "socketcan:can0"):
        done = CliRunner().invoke(main, verb)
        assert done.exit_code == 2
        assert "2 hosts run on this machine: coulombus:a, socketcan:can0; name one with --bus" in done.output
        assert ("--all" in done.output) is (verb == ["stop"])


def test_all_hosts_are_stopped_or_the_one_of_the_environment():
    with displaying("coulombus:a", "coulombus:b", "coulombus:c"):
        done = CliRunner().invoke(main, ["stop"], env={"COULOMBUS_BUS": "coulombus:b"})
        assert (done.exit_code, done.stdout.split()[3]) == (0, "coulombus:b")
        done = CliRunner().invoke(main, ["stop", "--all"])
        assert (done.exit_code, [line.split()[3] for line in done.stdout.splitlines()]) == (
            0,
            ["coulombus:a", "coulombus:c"],
        )


def test_a_rig_that_is_named_is_not_replaced_by_the_host_that_runs():
    with displaying("coulombus:x"):
        for words, env in ((["stop", "--rig", "bench"], {}), (["stop"], {"COULOMBUS_RIG": "bench"})):
            done = CliRunner().invoke(main, words, env=env)
            assert done.exit_code == 4
            assert "coulombus:bench" in done.output
