"""The host's control socket in virtual time: what is sent, how long an answer is waited for, and what
each failure is told as.
"""

from __future__ import annotations

import json
import socket
from types import SimpleNamespace

import pytest

from coulombus.host.errors import SafetyTrip
from coulombus.host.run import control_socket
from coulombus.host.run.control_socket import (
    ASKERS,
    STATUS_TIMEOUT_S,
    STOP_TIMEOUT_S,
    HostSocket,
    NoHost,
    NotChanged,
    NotMarked,
    StopRequest,
    ask_change,
    ask_mark,
    ask_status,
    control_path,
    host_runs,
    stop_host,
)
from coulombus.system import full_queue
from coulombus.wire.address import BusAddress, parse_address, socket_path

pytestmark = pytest.mark.usefixtures("private_sockets")

BUS = parse_address("coulombus:x")


class Clock:
    """`time` of the module: it passes by what is slept."""

    def __init__(self):
        self.now_s, self.slept = 100.0, []

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now_s += seconds


class Asker:
    """A socket whose answers are the test's: bytes, or an error to raise."""

    def __init__(self, *answers, connects=()):
        self.answers, self.connects = list(answers), list(connects)
        self.sent, self.timeouts, self.paths, self.sizes, self.closed = [], [], [], [], 0

    def connect(self, path):
        self.paths.append(path)
        if self.connects:
            error = self.connects.pop(0)
            if error is not None:
                raise error

    def send(self, message):
        self.sent.append(message)

    def settimeout(self, seconds):
        self.timeouts.append(seconds)

    def recv(self, size):
        self.sizes.append(size)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.closed += 1


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    for module in (control_socket, full_queue):
        monkeypatch.setattr(module, "time", clock)
    return clock


@pytest.fixture
def asker(monkeypatch):
    def made(*answers, **named):
        asker = Asker(*answers, **named)
        monkeypatch.setattr(control_socket, "_new", lambda: asker)
        return asker

    return made


# a question


@pytest.mark.parametrize(
    ("ask", "sent"),
    [
        (lambda: ask_status(BUS), b"status"),
        (lambda: ask_mark(BUS, "x\udc80"), b"mark x?"),
        (lambda: ask_change(BUS, {"F_s": 1}), b'set {"F_s": 1}'),
    ],
)
@pytest.mark.parametrize("full", [0, 3])
def test_a_question_has_three_seconds_and_returns_its_answer(clock, asker, ask, sent, full):
    """A full queue is tried again, and an answer has three seconds of its own."""
    one = asker(b'{"phase": "run"}', connects=[BlockingIOError()] * full)
    assert ask() == {"phase": "run"}
    assert (one.sent, one.paths, one.closed) == ([sent], [str(control_path(BUS))] * (full + 1), 1)
    assert one.timeouts == pytest.approx([*(3.0 - 0.01 * k for k in range(full + 1)), 3.0])
    assert one.sizes == [65536]


@pytest.mark.parametrize(
    ("answer", "connects", "told"),
    [
        (b"", [FileNotFoundError()], "no host runs on bus coulombus:x"),
        (b"", [ConnectionRefusedError()], "no host runs on bus coulombus:x"),
        (b"", [BlockingIOError()] * 302, "gives no answer: it starts, or it ends"),
        (TimeoutError(), [], "gives no answer: it starts, or it ends"),
        (ConnectionResetError(104, "Connection reset by peer"), [], "broke off: Connection reset by peer"),
        (OSError("odd"), [], "broke off: odd"),
        (b"", [], "gave no answer that is one"),
        (b"{}", [], "gave no answer that is one"),
        (b"[1]", [], "gave no answer that is one"),
        (b"[" * 60_000, [], "gave no answer that is one"),
    ],
)
def test_each_failure_of_a_question_has_its_words(clock, asker, answer, connects, told):
    asker(answer, connects=connects)
    with pytest.raises(NoHost, match=told):
        ask_status(BUS)


def test_a_marker_and_a_change_that_are_refused_have_their_reason(asker):
    asker(b'{"error": "it does not record"}')
    with pytest.raises(NotMarked, match="the host on bus coulombus:x: it does not record"):
        ask_mark(BUS, "x")
    asker(b'{"error": "too much"}')
    with pytest.raises(NotChanged, match="the host on bus coulombus:x: too much"):
        ask_change(BUS, {})
    assert NotMarked.exit_status == NotChanged.exit_status == 2


def test_a_change_that_is_to_be_asked_again_is_for_its_time(asker, clock):
    again = b'{"error": "wait", "again": true}'
    one = asker(again, again, b'{"changed": 1}')
    assert ask_change(BUS, {}) == {"changed": 1}
    assert (len(one.sent), clock.slept) == (3, [0.01, 0.01])
    one = asker(*[again] * 100)
    began_s = clock.now_s = 50.0
    with pytest.raises(NotChanged, match="wait"):
        ask_change(BUS, {}, 0.25)
    assert 0.25 < clock.now_s - began_s < 0.25 + 2 * 0.01


def test_a_change_at_its_last_moment_is_asked_once_more(asker, clock):
    clock.sleep = lambda seconds: setattr(clock, "now_s", 103.0)
    again = b'{"error": "wait", "again": true}'
    one = asker(again, again, b'{"changed": 1}')
    assert ask_change(BUS, {}, 3.0) == {"changed": 1}
    assert len(one.sent) == 3


# a stop


def test_a_stop_is_asked_for_and_its_end_waited_for_with_one_deadline(asker, clock):
    one = asker(b"accepted", b'{"trip": null, "cycles": 7, "mode": "passive"}')
    request = StopRequest(BUS)
    clock.now_s += 1.0
    assert request.result() == {"trip": None, "cycles": 7, "mode": "passive"}
    assert (one.sent, one.timeouts, one.closed) == ([b"stop"], [3.0, 2.0, 29.0], 1)


def test_a_wait_that_is_over_is_a_short_one_and_never_for_ever(asker, clock):
    one = asker(b"accepted", b"")
    request = StopRequest(BUS, 2.0)
    clock.now_s += 2.0
    assert request.result() == {}
    assert one.timeouts == [2.0, 1e-3, 1e-3]


def test_who_finds_no_room_tries_again_until_the_deadline(asker, clock):
    one = asker(b"accepted", b"", connects=[BlockingIOError()] * 3)
    assert stop_host(BUS, 1.0) == {}
    assert (len(one.paths), clock.slept) == (4, [0.01] * 3)
    one = asker(connects=[BlockingIOError()] * 1000)
    clock.now_s = began_s = 0.0
    with pytest.raises(NoHost, match=r"does not accept a connection within 1 s: .* may be armed still"):
        stop_host(BUS, 1.0)
    assert 1.0 <= clock.now_s - began_s < 1.0 + 2 * 0.01
    assert one.closed == 1


def test_the_deadline_itself_is_too_late(asker, clock):
    clock.sleep = lambda seconds: setattr(clock, "now_s", 101.0)
    one = asker(connects=[BlockingIOError()] * 3)
    StopRequest(BUS, 1.0)
    assert len(one.paths) == 2


@pytest.mark.parametrize(
    ("answers", "connects", "told"),
    [
        ((), [FileNotFoundError()], "^no host runs on bus coulombus:x$"),
        ((), [ConnectionRefusedError()], "^no host runs on bus coulombus:x$"),
        ((), [PermissionError(13, "Permission denied")], "cannot be asked to stop: Permission denied; it may be armed"),
        ((b"",), [], "closed the connection and did not take the request; it may be armed"),
        ((b"no",), [], "gave no answer that is one; it may be armed"),
        ((TimeoutError(),), [], "has not stopped within 3 s, nor taken the request: .* it may be armed"),
        ((b"accepted", TimeoutError()), [], "has not stopped within 30 s; it may be armed"),
        ((b"accepted", ConnectionResetError(104, "reset")), [], "broke off: reset; it may be armed"),
        ((b"accepted", b"x"), [], "what it told of its end cannot be read"),
        ((b"accepted", b"[]"), [], "what it told of its end cannot be read"),
        ((b"accepted", b'{"cycles": null}'), [], "what it told of its end cannot be read"),
        ((b"accepted", b'{"mode": null, "cycles": 1, "trip": null}'), [], "what it told of its end cannot be read"),
        ((b"accepted", b"{}"), [], "what it told of its end cannot be read"),
    ],
)
def test_each_failure_of_a_stop_has_its_words(asker, answers, connects, told):
    asker(*answers, connects=connects)
    with pytest.raises(NoHost, match=told):
        stop_host(BUS)


# the host's side


def connected():
    asker = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    asker.connect(str(control_path(BUS)))
    asker.settimeout(10)
    return asker


@pytest.fixture
def host(clock):
    host = HostSocket(BUS)
    yield host
    host.close()


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        (b"status", b"S"),
        (b"mark a b", b"M a b"),
        (b"set {}", b"C {}"),
        (b"mark \xff", "M \ufffd".encode()),
        (b"odd", b""),
    ],
)
def test_each_question_has_its_answer_and_an_end(host, message, answer):
    host.status = lambda: b"S"
    host.mark = lambda text: f"M {text}".encode()
    host.change = lambda text: f"C {text}".encode()
    with connected() as asker:
        asker.send(message)
        assert host.stop_wanted() is False
        assert asker.recv(100) == answer
        assert asker.recv(100) == b""
    assert host._askers == []


def test_what_nobody_has_set_is_answered_with_nothing(host):
    for message in (b"status", b"mark x", b"set x"):
        with connected() as asker:
            asker.send(message)
            assert not host.stop_wanted()
            assert asker.recv(100) == b"{}"


@pytest.mark.parametrize(("after_s", "stays"), [(0.0, 1), (0.99, 1), (1.0, 0), (1.5, 0)])
def test_who_says_nothing_for_a_second_is_let_go(host, clock, after_s, stays):
    with connected():
        assert not host.stop_wanted()
        clock.now_s += after_s
        assert not host.stop_wanted()
        assert len(host._askers) == stays


def test_who_asked_for_a_stop_may_be_silent_and_hears_of_the_end(host, clock):
    with connected() as asker, connected():
        asker.send(b"stop")
        assert host.stop_wanted() is True
        clock.now_s += 100.0
        assert host.stop_wanted() is False
        assert asker.recv(100) == b"accepted"
        host.close({"cycles": 1})
        assert json.loads(asker.recv(100)) == {"cycles": 1}
        assert asker.recv(100) == b""
    assert not control_path(BUS).exists()


def test_a_closed_host_leaves_the_path_to_the_next(host):
    host.close()
    assert not host_runs(BUS)
    control_path(BUS).write_text("the next one's")
    host.close()
    assert control_path(BUS).read_text() == "the next one's"
    control_path(BUS).unlink()


def test_a_host_is_there_while_it_listens(host):
    assert host_runs(BUS)
    assert not host_runs(parse_address("coulombus:y"))


def test_the_times_are_those_that_the_documentation_has():
    assert (STOP_TIMEOUT_S, STATUS_TIMEOUT_S, ASKERS) == (30.0, 3.0, 16)


def test_when_all_have_asked_for_a_stop_a_further_one_is_closed_at_once(host):
    askers = []
    for _ in range(16):
        askers.append(connected())
        askers[-1].send(b"stop")
        assert host.stop_wanted()
    askers.append(connected())
    assert not host.stop_wanted()
    assert askers[-1].recv(100) == b""
    assert len(host._askers) == 16
    assert not any(asker.connection.fileno() < 0 for asker in host._askers)
    for asker in askers:
        asker.close()


def test_who_has_not_asked_for_a_stop_hears_nothing_of_the_end(host):
    with connected() as asker:
        assert not host.stop_wanted()
        host.close({"cycles": 1})
        assert asker.recv(100) == b""
    assert host._askers == []


def test_a_path_that_a_dead_host_left_may_be_gone_meanwhile(monkeypatch):
    monkeypatch.setattr(control_socket, "_probe", lambda path: False)
    HostSocket(BUS).close()


def test_a_host_whose_standard_input_was_closed_lets_go_of_its_bus_too(host):
    ((path, real),), closed = host._listeners, []
    host._listeners = [(path, SimpleNamespace(fileno=lambda: 0, close=lambda: closed.append(True)))]
    host.close()
    assert closed
    assert not control_path(BUS).exists()
    real.close()


def test_a_host_that_has_let_go_of_its_bus_takes_no_more_requests(host, monkeypatch):
    services = []
    monkeypatch.setattr(host, "stop_wanted", lambda: services.append(1))
    host.close()
    host.close()
    assert services == [1]


def test_no_host_runs_on_an_adapter(monkeypatch):
    monkeypatch.setattr(control_socket, "_probe", lambda path: True)
    assert host_runs(BUS)
    assert not host_runs(BusAddress("can", "pcan:PCAN_USBBUS1"))


def test_a_host_of_two_buses_claims_and_leaves_both():
    other = parse_address("coulombus:other")
    both = HostSocket(BUS, other)
    with pytest.raises(SafetyTrip, match="another host runs on bus coulombus:other"):
        HostSocket(other)
    with connected() as asker:
        asker.send(control_socket.STOP)
        assert both.stop_wanted()
    both.close()
    assert not any(control_path(bus).exists() for bus in (BUS, other))


def test_a_host_whose_second_bus_has_another_host_takes_none():
    other = parse_address("coulombus:other")
    there = HostSocket(other)
    with pytest.raises(SafetyTrip, match="another host runs on bus coulombus:other"):
        HostSocket(BUS, other)
    assert not control_path(BUS).exists()
    there.close()


@pytest.mark.parametrize(
    ("kind", "name", "path"),
    [
        ("coulombus", "desk", "desk.host"),
        ("socketcan", "can0", "socketcan-can0.host"),
        ("socketcan", "a/b-_.1", "socketcan-a_b-_.1.host"),
    ],
)
def test_each_bus_has_a_door_of_its_own(kind, name, path):
    """A virtual bus and an interface may have one name."""
    assert control_socket.control_path(BusAddress(kind, name)) == socket_path(path)


@pytest.mark.parametrize("bus", ["coulombus:desk", "coulombus:a-b", "socketcan:can0", "socketcan:can-left-0"])
def test_a_door_tells_whose_it_is(bus):
    address = parse_address(bus)
    name = control_socket.control_path(address).name.removesuffix(control_socket.HOST_SUFFIX)
    assert control_socket.address_of(name) == address
