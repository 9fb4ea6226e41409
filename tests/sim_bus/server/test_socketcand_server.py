"""The server for other programs: socketcand's protocol, byte by byte; clients that send rubbish, or do not read;
and python-can's own client through a bridge.
"""

from __future__ import annotations

import json
import random
import re
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress

import can
import pytest

from coulombus.sim_bus.server import socketcand_server as module
from coulombus.sim_bus.server.bridge import _Way, faults
from coulombus.sim_bus.server.socketcand_server import MOST_CLIENTS, SocketcandServer, element, sent_frame
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.client import pack_frame
from places import ROOT
from tiny_bus import tiny_bus

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

PATIENCE_S = 20.0
EFF, RTR = 0x80000000, 0x40000000
STAMP_NS = 1_700_000_000_123_456_789


class Remote:
    """A client, and the server that a test serves itself."""

    def __init__(self, server):
        self.server, self.text = server, b""
        host, _, port = server.address.name.rpartition(":")
        self.socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self.socket.setblocking(False)

    def send(self, text):
        self.socket.sendall(text)
        return self

    def expect(self, text):
        """Serve until exactly `text` has come."""
        while len(self.text) < len(text):
            self.serve()
            try:
                self.text += self.socket.recv(len(text) - len(self.text))
            except BlockingIOError:
                continue
        assert self.text == text
        self.text = b""
        return self

    def serve(self):
        self.server.wait(0.01)
        frames = self.server.receive()
        self.server.ask()
        return [frame[1:] for frame in frames]

    def frames(self, count):
        """Serve until so many frames have come from clients."""
        frames = []
        while len(frames) < count:
            frames += self.serve()
        assert len(frames) == count
        return frames

    def raw(self):
        return self.expect(b"< hi >").send(b"< open can0 >").expect(b"< ok >").send(b"< rawmode >").expect(b"< ok >")


@contextmanager
def server(name="127.0.0.1:0"):
    lines = []
    with SocketcandServer(parse_address(f"socketcand:{name}", ("socketcand",)), lines.append) as made:
        made.lines, remotes = lines, []
        made.join = lambda: remotes.append(Remote(made)) or remotes[-1]
        yield made
        for remote in remotes:
            remote.socket.close()


def test_the_words_of_a_client_and_their_answers():
    with server() as made:
        remote = made.join().raw().send(b"< echo >").expect(b"< echo >")
        remote.send(b"< send 123 2 11 f1 ><send 00000005 0 ><  sendrtr\t701   1 >\n< send 7FF 8 1 2 3 4 5 6 7 8 >")
        assert remote.frames(4) == [
            (0x123, 2, b"\x11\xf1\0\0\0\0\0\0"),
            (0x5 | EFF, 0, bytes(8)),
            (0x701 | RTR, 1, bytes(8)),
            (0x7FF, 8, bytes(range(1, 9))),
        ]
        remote.send(b"< bcmmode >").expect(b"< error unknown command >")
        assert made.malformed == 1


def test_a_frame_has_the_stamp_of_the_bus():
    """An empty frame keeps both spaces: python-can's client takes what is between them for the data."""
    with server() as made:
        remote = made.join().raw()
        for can_id, data, length in ((0x123, b"\x11\x22", None), (0x80, b"", None), (0x12345 | EFF, b"\xab", None)):
            made.send(pack_frame(can_id, data, length), STAMP_NS)
        made.send(pack_frame(0x701 | RTR, length=8), STAMP_NS)
        remote.expect(
            b"< frame 123 1700000000.123456 1122 >< frame 080 1700000000.123456  >"
            b"< frame 00012345 1700000000.123456 AB >< rtr 701 1700000000.123456 8 >"
        )


def test_a_client_hears_the_others_and_not_itself_nor_before_rawmode():
    with server() as made:
        one, other, third = made.join().raw(), made.join().raw(), made.join().expect(b"< hi >")
        one.send(b"< send 181 1 aa >").frames(1)
        other.send(b"< send 182 1 bb >").frames(1)
        third.send(b"< echo >").expect(b"< echo >")
        for remote, pattern in ((one, rb"< frame 182 \d+\.\d{6} BB >"), (other, rb"< frame 181 \d+\.\d{6} AA >")):
            while not remote.text.endswith(b">"):
                remote.serve()
                try:
                    remote.text += remote.socket.recv(4096)
                except BlockingIOError:
                    continue
            assert re.fullmatch(pattern, remote.text)


@pytest.mark.parametrize(
    "text",
    [
        b"< send >",
        b"< send 123 >",
        b"< send 123 2 11 >",
        b"< send 123 1 11 22 >",
        b"< send 123 9 1 2 3 4 5 6 7 8 9 >",
        b"< send 123 -1 >",
        b"< send 800 0 >",
        b"< send 20000000 0 >",
        b"< send -5 0 >",
        b"< send xyz 0 >",
        b"< send 123 1 100 >",
        b"< send 123 1 -1 >",
        b"< sendrtr 123 1 0 >",
        b"< >",
        b">",
        b"rubbish < send 123 0 >",
        b"\xff\xfe >",
        b"< " + b"x" * 300 + b" >",
    ],
)
def test_what_is_no_element_is_counted_and_the_next_is_taken(text):
    with server() as made:
        remote = made.join().raw().send(text + b"< send 181 0 >")
        assert remote.frames(1) == [(0x181, 0, bytes(8))]
        assert made.malformed == 1


@pytest.mark.parametrize("seed", range(3))
def test_rubbish_ends_nothing_and_no_buffer_grows(seed):
    dice = random.Random(seed)
    letters = b"<> send123\xff\0fdopenrawmode\n"
    with server() as made:
        remote = made.join().raw()
        for _ in range(40):
            remote.send(bytes(dice.choice(letters) for _ in range(dice.randrange(1, 2000))))
            remote.serve()
            assert all(len(each.coming) <= module.ELEMENT_BYTES for each in made._remotes.values())
        other = made.join().raw().send(b"< send 181 0 >")
        while (0x181, 0, bytes(8)) not in other.serve():
            pass
        assert made.malformed > 10


def test_a_client_that_does_not_read_is_dropped_and_the_others_are_served(monkeypatch):
    monkeypatch.setattr(module, "BACKLOG_BYTES", 1 << 16)
    monkeypatch.setattr(module, "SETTLE_S", 0.0)
    with server() as made:
        deaf, other = made.join().raw(), made.join().raw()
        count = 0
        while "was dropped: it does not read" not in made.lines[-1]:
            for _ in range(100):
                made.send(pack_frame(0x181, bytes(8)), STAMP_NS)
            count += 100
            with suppress(BlockingIOError):
                other.text += other.socket.recv(1 << 20)
            made.receive()
        assert len(made._remotes) == 1
        while other.text.count(b">") < count:
            other.serve()
            try:
                other.text += other.socket.recv(1 << 16)
            except BlockingIOError:
                continue
        assert other.text == element(STAMP_NS, 0x181, 8, bytes(8)) * count
        assert deaf.server is made


def test_a_client_that_is_dropped_while_another_is_served_ends_nothing():
    with server() as made:
        remotes = made.join().raw(), made.join().raw()
        for slow in made._remotes.values():
            slow.frames_from_s, slow.going = float("inf"), bytearray(module.BACKLOG_BYTES)
        for remote in remotes:  # both are ready in one round
            remote.send(b"< send 181 0 >")
        assert remotes[0].frames(1) == [(0x181, 0, bytes(8))]
        assert len(made._remotes) == 1
        assert "was dropped" in made.lines[-1]


def test_clients_come_and_go():
    with server() as made:
        remotes = [made.join().expect(b"< hi >") for _ in range(MOST_CLIENTS)]
        late = made.join()
        while not made.lines[-1].endswith(f"was refused: {MOST_CLIENTS} clients are connected"):
            late.serve()
        remotes[3].socket.close()
        while not made.lines[-1].endswith("has left"):
            late.serve()
        made.join().expect(b"< hi >")
        assert len(made._remotes) == MOST_CLIENTS


def test_clients_wait_while_the_bus_is_slower():
    """A bus that takes nothing: the bridge's queue fills to its half, the rest waits in the clients."""

    class Full:
        address, lost, malformed = parse_address("socketcan:can0"), 0, 0

    with server() as made:
        remote = made.join().raw()
        way = _Way(made, Full(), faults(), (), 40)
        remote.send(b"< send 181 0 >" * 1000)
        while way.counts.received <= 20:
            made.wait(PATIENCE_S)
            way.receive(0)
        received = way.counts.received
        for _ in range(20):
            assert not made.wait(0)
            way.receive(0)
        assert way.counts.received == received
        assert received <= 20 + module.READ_BYTES // len(b"< send 181 0 >") + 1
        made.hold(False)
        assert made.wait(PATIENCE_S)


def test_one_line_of_warning_where_the_port_is_not_the_loopbacks():
    with server() as made:
        assert made.lines == []
    with server("localhost:0") as made:
        assert made.lines == []
    with server("0.0.0.0:0") as made:
        (line,) = made.lines
        assert re.fullmatch(
            r"warning: socketcand:0\.0\.0\.0:\d+ has no password: a program that reaches this port .*", line
        )


def test_a_port_that_is_taken_and_a_host_that_is_not_here():
    with server() as made:
        for name in (made.address.name, "192.0.2.1:0", "no-such-host.invalid:0"):
            with (
                pytest.raises(BusUnavailable, match=r"cannot be served: .*; choose another port") as error,
                server(name),
            ):
                pass
            assert error.value.exit_status == 4


def test_an_identifier_of_eight_digits_is_extended():
    assert sent_frame([b"send", b"00000123", b"0"]) == (0x123 | EFF, 0, bytes(8))
    assert sent_frame([b"send", b"123", b"0"]) == (0x123, 0, bytes(8))
    assert sent_frame([b"send", b"1FFFFFFF", b"0"]) == (0x1FFFFFFF | EFF, 0, bytes(8))


# through a bridge


@contextmanager
def bridged(*options):
    """Yield a virtual bus, the lines of a bridge that serves it at a free port, and that port."""
    command = [sys.executable, "-m", "coulombus", "bridge", "coulombus:a", "socketcand:127.0.0.1:0", "--json", *options]
    with tiny_bus("a") as bus:
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            ready = json.loads(process.stdout.readline())
            yield bus, process, int(ready["b"].rpartition(":")[2])
        finally:
            process.terminate()
            process.communicate(timeout=PATIENCE_S)


@pytest.mark.usefixtures("private_sockets")
def test_python_cans_client_loses_none_of_1000_frames_each_way():
    with bridged() as (_, process, port):
        ours = can.Bus(interface="socketcand", channel="a", host="127.0.0.1", port=port)
        messages = [
            can.Message(arbitration_id=n, is_extended_id=n % 3 == 0, data=n.to_bytes(8, "little")[: n % 9])
            for n in range(1000)
        ]
        with ours, can.Bus(interface="coulombus", channel="a") as far:
            for source, sink in ((ours, far), (far, ours)):
                for begin in range(0, len(messages), 100):  # the tiny bus keeps some 270 messages for a client
                    for message in messages[begin : begin + 100]:
                        source.send(message, timeout=PATIENCE_S)
                    for message in messages[begin : begin + 100]:
                        assert sink.recv(PATIENCE_S).equals(message, None, check_channel=False)
        process.terminate()
        out, _ = process.communicate(timeout=PATIENCE_S)
        ways = json.loads(out.splitlines()[-1])["ways"]
        assert [(way["received"], way["forwarded"]) for way in ways.values()] == [(1000, 1000)] * 2
        assert [way["malformed"] + way["overflow"] + way["lost"] for way in ways.values()] == [0, 0]


@pytest.mark.usefixtures("private_sockets")
def test_python_cans_client_joins_a_busy_bus():
    """It expects the answer to rawmode alone in a packet; frames begin a little later, and none is lost."""
    with bridged() as (bus, _, port):
        for _ in range(2):
            bus.deliver((0x80, b""))
            with can.Bus(interface="socketcand", channel="a", host="127.0.0.1", port=port) as ours:
                for n in range(20):
                    bus.deliver((0x181, bytes((n,))))
                assert [ours.recv(PATIENCE_S).data[0] for _ in range(20)] == list(range(20))


@pytest.mark.usefixtures("private_sockets")
def test_one_way_shows_the_bus_and_takes_nothing_from_clients():
    with bridged("--one-way") as (bus, process, port):
        with can.Bus(interface="socketcand", channel="a", host="127.0.0.1", port=port) as ours:
            ours.send(can.Message(arbitration_id=0x181, is_extended_id=False))
            bus.deliver((0x182, b"a"))
            assert ours.recv(PATIENCE_S).arbitration_id == 0x182
        process.terminate()
        out, err = process.communicate(timeout=PATIENCE_S)
        assert bus.frames == []
        assert "has joined" in err
        assert list(json.loads(out.splitlines()[-1])["ways"]) == [f"coulombus:a -> socketcand:127.0.0.1:{port}"]
