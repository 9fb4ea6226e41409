import os
import socket
import struct
import threading
import time
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coulombus.rigs.buses import one_bus
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import parse_address, socket_path
from coulombus.wire.controller_state import STATES, ControllerState
from coulombus.wire.handshake import Answer, BusStatus, BusUnavailable, Flags, Hello, connect, greet, is_greeting
from tiny_bus import tiny_bus

pytestmark = pytest.mark.usefixtures("private_sockets")

BENCH = parse_address("coulombus:bench")
words = st.integers(0, 2**32 - 1)


def test_bytes_of_a_hello():
    hello = Hello(Flags.OWN | Flags.ERRORS, ((0x181, 0x7FF),))
    assert hello.pack() == bytes.fromhex("434c4253 0100 0500 0100 81010000 ff070000 000000000000")


def test_bytes_of_an_answer():
    answer = Answer(BusStatus.FULL, 1_000_000, 17, 3)
    assert answer.pack() == bytes.fromhex("434c4253 0100 0300 40420f00 11000000 0300000000000000")


@given(st.integers(0, 7), st.lists(st.tuples(words, words), max_size=40))
def test_hello_is_read_as_written_and_is_no_message_of_frames(flags, filters):
    hello = Hello(Flags(flags), tuple(filters))
    message = hello.pack()
    assert len(message) % 16 == 8
    assert Hello.unpack(message) == hello


@given(words, words, st.integers(0, 2**64 - 1))
def test_answer_is_read_as_written(bitrate, station, lost):
    answer = Answer(BusStatus.OK, bitrate, station, lost)
    assert len(answer.pack()) % 16 == 8
    assert Answer.unpack(answer.pack()) == answer


@given(st.binary(max_size=80))
def test_whatever_is_read_never_raises(message):
    assert isinstance(Hello.unpack(message), Hello | BusStatus)
    assert isinstance(Hello.unpack(struct.pack("<IH", 0x53424C43, 1) + message), Hello | BusStatus)
    Answer.unpack(message)


def test_hellos_that_a_bus_refuses():
    good = bytearray(Hello(Flags(0), ((1, 2),)).pack())
    assert Hello.unpack(b"\x44" + good[1:]) is BusStatus.BAD_HELLO
    assert Hello.unpack(good[:4] + b"\x02\x00" + good[6:]) is BusStatus.WRONG_VERSION
    assert Hello.unpack(good[:8] + b"\x02\x00" + good[10:]) is BusStatus.BAD_HELLO
    assert Hello.unpack(good[:8] + b"\xff\xff" + good[10:]) is BusStatus.BAD_HELLO
    assert Hello.unpack(good[:-1]) is BusStatus.BAD_HELLO


def test_more_filters_than_a_bus_takes():
    with pytest.raises(ValueError, match="513 filters"):
        Hello(Flags(0), ((1, 2),) * 513).pack()


def test_connect_greets_and_returns_a_blocking_socket():
    with tiny_bus(bitrate=500_000) as bus:
        connection = greet(BENCH, Hello(Flags.OWN, ((0x80, 0x7FF),)))
        assert connection.answer == Answer(BusStatus.OK, 500_000, 17)
        assert bus.greetings == [(1, [(0x80, 0x7FF)])]
        assert connection.socket.gettimeout() is None
        bus.deliver((0x80, b"\x07"), (0x81, b""))
        assert connection.socket.recv(100) == struct.pack("=IB3x8s", 0x80, 1, b"\x07")
        connection.socket.close()


def test_what_a_client_sent_that_read_nothing_is_on_the_small_bus():
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with tiny_bus() as bus, its:
        bus._clients[its] = (0, [])
        with ours:
            ours.send(struct.pack("=IB3x8s", 0x80, 0, b""))
            its.send(bytes(16))
        bus._receive(its)
        bus._receive(its)
        assert bus.frames == [(0x80, 0, bytes(8))]


def test_a_client_that_goes_in_the_middle_of_a_greeting_leaves_the_small_bus_standing(monkeypatch):
    failed = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    with tiny_bus():
        for _ in range(200):
            client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            client.setblocking(False)
            while client.connect_ex(str(socket_path("bench"))):  # its queue is full
                assert failed == []
                os.sched_yield()
            for _ in range(4):
                client.send(Hello().pack())
            client.close()
        connect(BENCH, timeout=5).close()
    assert failed == []


def test_no_bus_says_how_to_start_one():
    with pytest.raises(BusUnavailable, match="coulombus emulate --bus coulombus:bench") as caught:
        connect(BENCH)
    assert caught.value.exit_status == 4


@pytest.mark.parametrize(
    ("rig", "bus", "command"),
    [
        ("two_axes", None, "`coulombus emulate --rig two_axes`"),
        ("bench", "coulombus:desk", "`coulombus emulate --rig bench --bus coulombus:desk`"),
    ],
)
def test_no_bus_of_a_rig_says_how_to_start_one_with_that_rig(rig, bus, command):
    """Whatever verb it is: the address knows."""
    _, address = one_bus(load_rig(rig), bus, None)
    with pytest.raises(BusUnavailable) as caught:
        connect(address)
    assert str(caught.value).endswith(command)


def test_the_socket_of_a_dead_process_is_no_bus():
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    dead.bind(str(socket_path("bench")))
    dead.listen()
    dead.close()
    with pytest.raises(BusUnavailable, match="coulombus emulate"):
        connect(BENCH)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"version": 2}, "another version than 1"),
        ({"status": 2}, "does not understand"),
        ({"status": 3}, "places for clients are taken"),
    ],
)
def test_refusals(options, text):
    with tiny_bus(**options), pytest.raises(BusUnavailable, match=text) as caught:
        connect(BENCH)
    assert caught.value.exit_status == 4


def test_a_stopped_bus_is_not_waited_for_longer_than_the_timeout():
    with tiny_bus(mute=True), pytest.raises(BusUnavailable, match="is its process stopped"):
        connect(BENCH, timeout=0.05)


def test_a_bus_that_accepts_nobody_is_not_waited_for_longer_than_the_timeout():
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(socket_path("bench")))
    listener.listen(0)
    first = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    first.connect(str(socket_path("bench")))
    with pytest.raises(BusUnavailable, match="is its process stopped"):
        connect(BENCH, timeout=0.05)
    first.close()
    listener.close()


def test_frames_before_the_answer_are_no_answer():
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(socket_path("bench")))
    listener.listen()

    def serve():
        client, _ = listener.accept()
        client.recv(100)
        client.send(bytes(16))
        client.send(bytes(24))
        client.send(Answer(BusStatus.OK, 125_000, 2).pack())
        client.recv(100)
        client.close()

    thread = threading.Thread(target=serve)
    thread.start()
    connection = greet(BENCH, Hello())
    assert connection.answer.bitrate_bit_s == 125_000
    connection.socket.close()
    thread.join(5)
    listener.close()


def test_a_bus_that_ends_while_it_is_greeted():
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(socket_path("bench")))
    listener.listen()
    thread = threading.Thread(target=lambda: listener.accept()[0].close())
    thread.start()
    begin = time.monotonic()
    with pytest.raises(BusUnavailable, match="cannot be reached"):
        connect(BENCH, timeout=5)
    assert time.monotonic() - begin < 4
    thread.join(5)
    listener.close()


def test_socketcan_is_not_greeted():
    with pytest.raises(ValueError, match="socketcan:can0"):
        connect(parse_address("socketcan:can0"))


@given(st.integers(0, 4), st.integers(0, 7), st.integers(0, 2**40))
def test_the_state_of_a_controller_goes_with_the_answer(state, modes, count):
    controller = ControllerState(state=state, modes=modes, tec=7, rec=9, restart_ms=100, bus_offs=count)
    message = Answer(BusStatus.OK, 500_000, 3, 1, controller).pack()
    assert is_greeting(message)
    answered = Answer.unpack(message).controller
    assert answered == replace(controller, bus_offs=min(count, 2**32 - 1))
    assert f"state {STATES[state]} (berr-counter tx 7 rx 9) restart-ms 100" in str(answered)
