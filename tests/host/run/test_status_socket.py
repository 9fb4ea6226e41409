"""The status socket: a line for who reads, no wait for who does not, and nothing for the rig to
fear.
"""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.run.client_requests import axis_state
from coulombus.host.run.control_socket import HostSocket, NoHost, ask_status, control_path
from coulombus.host.run.status_socket import PERIOD_NS, READERS, SLOW_S, StatusError, StatusSocket, encoded
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import parse_address

BUS = parse_address("coulombus:x")
STATE = {
    "rig": "bench",
    "bus": "coulombus:x",
    "mode": "hybrid",
    "cycles": 7,
    "display_s": 1.5,
    "axes": [{"phase": "run"}],
}


class Teller:
    """A status socket, and a clock that goes when it is told to."""

    def __init__(self, path, document=lambda: {"cycles": 7}):
        self.socket, self.now_ns = StatusSocket(path, document), 1

    def tick(self, times=1):
        for _ in range(times):
            self.now_ns += PERIOD_NS
            self.socket.serve(self.now_ns)

    def reader(self):
        found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        found.connect(str(self.socket.path))
        found.settimeout(5)
        return found


@pytest.fixture
def teller(short_path):
    made = Teller(short_path / "status")
    yield made
    made.socket.close()


def lines(reader, count):
    with reader.makefile() as file:
        return [json.loads(file.readline()) for _ in range(count)]


def test_every_reader_gets_a_line_each_time(teller):
    with teller.reader() as one, teller.reader() as other:
        teller.tick(3)
        for reader in (one, other):
            assert [line["cycles"] for line in lines(reader, 3)] == [7, 7, 7]
        teller.tick()
        assert lines(one, 1) == [{"cycles": 7, "readers": 2, "lines_left_out": 0}]


def test_lines_come_ten_times_a_second_however_often_it_is_looked(teller):
    with teller.reader() as reader:
        for _ in range(50):
            teller.now_ns += PERIOD_NS // 10
            teller.socket.serve(teller.now_ns)
        teller.socket.close()
        with reader.makefile() as file:
            assert len(file.readlines()) == 5


def test_nothing_is_made_where_nobody_reads(short_path):
    made = Teller(short_path / "s", lambda: pytest.fail("nobody reads"))
    made.tick(3)
    made.socket.close()


def test_a_slow_reader_is_not_waited_for_and_counted_and_let_go(short_path):
    made = Teller(short_path / "s", lambda: {"text": "x" * 50_000})
    with made.reader() as slow, made.reader() as quick:
        for _ in range(round(SLOW_S * 1e9 / PERIOD_NS) + 20):
            made.tick()
            assert lines(quick, 1)[0]["text"]
        assert made.socket.left_out > 10
        assert made.socket.let_go == 1
        with slow.makefile() as file:  # what it got are whole lines, but for the last one
            told = file.readlines()
        assert all(json.loads(line) for line in told[:-1])
    made.socket.close()


def test_a_reader_that_was_slow_goes_on_with_whole_lines(short_path):
    made = Teller(short_path / "s", lambda: {"text": "x" * 100_000})
    with made.reader() as reader:
        made.tick(6)
        assert made.socket.left_out > 0
        for _ in range(20):
            reader.recv(1 << 20)
            made.tick()
        made.socket.close()
        rest = b""
        while part := reader.recv(1 << 20):
            rest += part
        whole = rest.split(b"\n")[1:-1]
        assert all(json.loads(line)["text"] for line in whole)


def test_rubbish_is_thrown_away_and_a_flood_ends_the_reader(teller):
    with teller.reader() as polite, teller.reader() as flood:
        polite.sendall(b"\x00\xff GET / HTTP/1.1\r\n")
        flood.setblocking(False)
        teller.tick()
        sent = 0
        try:
            while sent < 1 << 24:
                sent += flood.send(b"x" * 65536)
        except BlockingIOError:
            pass
        teller.tick(2)
        assert len(lines(polite, 2)) == 2
        assert len(teller.socket._readers) == 1


def test_a_reader_that_goes_away_is_forgotten(teller):
    for _ in range(3):
        with teller.reader():
            teller.tick()
    teller.tick()
    assert teller.socket._readers == []


def test_so_many_readers_and_no_more(teller):
    readers = []
    for _ in range(READERS + 3):
        readers.append(teller.reader())
        teller.tick()
    assert len(teller.socket._readers) == READERS
    for reader in readers:
        reader.close()


def test_two_hosts_on_one_socket_are_not(teller, short_path):
    with pytest.raises(StatusError, match="another host"):
        StatusSocket(teller.socket.path, dict)
    with teller.reader() as reader:
        teller.tick()
        assert lines(reader, 1)


def test_the_socket_of_a_killed_host_is_taken_over_and_other_files_are_not(short_path):
    path = short_path / "s"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    StatusSocket(path, dict).close()
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(StatusError, match="not a socket"):
        StatusSocket(path, dict)
    assert path.read_text() == "mine"


@pytest.mark.parametrize("path", ["/proc/nonexistent/s", "/dev/null/s", "/tmp/" + "x" * 200])
def test_a_place_that_takes_no_socket_is_told(path):
    with pytest.raises((StatusError, OSError)) as caught:
        StatusSocket(Path(path), dict)
    assert caught.value.exit_status == 2


def test_a_socket_that_was_replaced_is_not_removed(teller):
    path = teller.socket.path
    other = path.with_name("other")
    other.write_text("mine")
    os.replace(other, path)
    teller.socket.close()
    teller.socket.close()
    assert path.read_text() == "mine"


def test_what_is_no_number_is_null():
    assert json.loads(encoded({"a": float("nan"), "b": [float("inf"), {"c": 1.0}], "d": "x"})) == {
        "a": None,
        "b": [None, {"c": 1.0}],
        "d": "x",
    }


def test_an_axis_state_is_si_at_the_handle():
    k = Controllers(load_rig("bench"), "hybrid")
    (controller,) = k.each
    k.host["counts"], k.host["v_counts"] = 1000, 2.0
    k.host["brake_Nm"] = 0.5
    state = axis_state(controller)
    count = float(k.control["rad_count"][0])
    assert state["phase"] == "off"
    assert state["position_rad"] == pytest.approx(1000 * count)
    assert state["velocity_rad_s"] == pytest.approx(2000 * count)
    assert state["brake_torque_Nm"] == 0.5
    json.dumps(state)


# at the host's door


@pytest.mark.usefixtures("private_sockets")
def test_who_asks_for_the_state_gets_it_and_stops_nobody():
    door = HostSocket(BUS)
    door.status = lambda: encoded(STATE)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asker:
        asker.connect(str(control_path(BUS)))
        asker.send(b"status")
        assert door.stop_wanted() is False
        assert json.loads(asker.recv(1 << 16)) == STATE
        assert door._askers == []
    door.close()


@pytest.mark.usefixtures("private_sockets")
def test_a_host_that_does_not_answer_is_told_as_such():
    with pytest.raises(NoHost, match="no host runs"):
        ask_status(BUS)
    door = HostSocket(BUS)
    with pytest.raises(NoHost, match="gives no answer"):
        ask_status(BUS, timeout_s=0.05)
    door.close()


@pytest.mark.usefixtures("private_sockets")
@pytest.mark.parametrize("answer", [b"", b"{", b"[]", b"{}", b"[" * 60000, b"\xff"])
def test_an_answer_that_is_none_is_told_as_such(monkeypatch, answer):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as ours:
        ours.bind(str(control_path(BUS)))
        ours.listen(1)
        connect = socket.socket.connect

        def connected(self, path):
            connect(self, path)
            visitor, _ = ours.accept()
            visitor.send(answer)
            visitor.close()

        monkeypatch.setattr("coulombus.host.run.control_socket.socket.socket.connect", connected)
        with pytest.raises(NoHost):
            ask_status(BUS)


def test_the_state_for_people_and_for_programs(monkeypatch):
    more = {"wakeup_us": {"p50": 12.0}, "counters": {"tx_full": 3, "rx_frames": 9}, "trip": "SPEED \x1b[2J"}
    monkeypatch.setattr("coulombus.host.run.control_socket.ask_status", lambda address: STATE | more)
    done = CliRunner().invoke(main, ["status"])
    assert done.exit_code == 0, done.output
    for text in ("mode hybrid", "7 cycles", "p50 12", "tx_full 3", "SPEED \\x1b"):
        assert text in done.output
    assert json.loads(CliRunner().invoke(main, ["status", "--json"]).output) == STATE | more
    monkeypatch.setattr("coulombus.host.run.control_socket.ask_status", lambda address: {"error": "x"})
    assert CliRunner().invoke(main, ["status"]).exit_code == 0
