"""The bus in Foxglove and PlotJuggler: read back by clients of their protocols."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
from typing import Any

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.monitor.callbacks import LiveBus
from coulombus.monitor.forward import Foxglove, PlotJuggler, PortError, forward
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import BusUnavailable, parse_address
from coulombus.wire.client import Client
from coulombus.wire.handshake import Flags, Hello
from tiny_bus import tiny_bus

BENCH = parse_address("coulombus:bench")
COUNTS = 250
DATA = struct.pack("<Hih", 0x0237, COUNTS, 0)


@pytest.fixture
def bus(private_sockets):
    with tiny_bus("bench") as served:
        yield served


@pytest.fixture
def rig():
    return load_rig("bench")


def position(rig):
    return next(s.si(COUNTS) for pdo in rig.pdos() for s in pdo.signals if s.name == "motor.position_rad")


class Fed:
    """A sink that is fed until `wanted` PDOs came; then the bus is taken away."""

    url = "test:"

    def __init__(self, inner: Any, bus: Any, count: int) -> None:
        self.inner, self.bus, self.left = inner, bus, count

    def send(self, pdo, t_ns, values):
        self.inner.send(pdo, t_ns, values)
        self.left -= 1
        if self.left == 0:
            self.bus.close()

    def close(self):
        self.inner.close()


def test_plotjuggler_gets_a_datagram_for_each_pdo(bus, rig):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs:
        theirs.bind(("127.0.0.1", 0))
        theirs.settimeout(10)
        sink = PlotJuggler(theirs.getsockname()[1])
        with pytest.raises(BusUnavailable):
            forward(
                rig, BENCH, Fed(sink, bus, 2), seconds=60, ready=lambda url: bus.deliver((0x181, DATA), (0x181, DATA))
            )
        datagrams = [json.loads(theirs.recv(4096)) for _ in range(2)]
    assert [sorted(datagram) for datagram in datagrams] == [
        sorted(("timestamp", "motor.position_rad", "motor.statusword", "motor.torque_Nm"))
    ] * 2
    assert datagrams[0]["motor.position_rad"] == pytest.approx(position(rig))
    assert sink.unheard == 0
    sink.close()


def test_where_nobody_listens_it_is_counted_and_goes_on(rig):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        nobody.bind(("127.0.0.1", 0))
        port = nobody.getsockname()[1]
    sink = PlotJuggler(port)
    for _ in range(4):
        sink.send(rig.pdos()[0], 1, {"a": None})
    assert sink.unheard >= 1
    sink.close()


def test_foxglove_serves_each_pdo_as_a_topic(rig):
    websocket = pytest.importorskip("tornado.websocket")
    pytest.importorskip("foxglove")
    sink = Foxglove(rig, 0)
    pdo = next(pdo for pdo in rig.pdos() if pdo.layout.cob_id == 0x181)

    async def client() -> tuple[dict[str, Any], bytes]:
        connection = await websocket.websocket_connect(sink.url, subprotocols=["foxglove.sdk.v1"])
        channel: dict[str, Any] = {}
        while not channel:
            message = await connection.read_message()
            assert message is not None
            if isinstance(message, str) and json.loads(message)["op"] == "advertise":
                channel = next((c for c in json.loads(message)["channels"] if c["topic"] == "/motor/TPDO1"), {})
        await connection.write_message(
            json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": channel["id"]}]})
        )
        read = asyncio.ensure_future(connection.read_message())
        while not read.done() or not isinstance(read.result(), bytes):
            if read.done():
                read = asyncio.ensure_future(connection.read_message())
            sink.send(pdo, 123, {"motor.position_rad": 0.5, "motor.statusword": None})  # unheard until it subscribed
            await asyncio.wait({read}, timeout=0.2)
        messages = read.result()
        connection.close()
        return channel, messages

    try:
        channel, messages = asyncio.run(asyncio.wait_for(client(), 60))
    finally:
        sink.close()
    assert channel["encoding"] == "json"
    schema = json.loads(channel["schema"])["properties"]["motor"]["properties"]
    assert schema["position_rad"] == {"type": "number", "description": "[rad]"}
    op, subscription, stamp = struct.unpack_from("<BIQ", messages)
    assert (op, subscription, stamp) == (1, 7, 123)
    assert json.loads(messages[13:]) == {"motor": {"position_rad": 0.5, "statusword": None}}


def test_a_port_that_is_taken_is_told(rig):
    pytest.importorskip("foxglove")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        with pytest.raises(PortError, match="cannot be served"):
            Foxglove(rig, server.getsockname()[1])


def test_the_verb_says_where_and_how_much(bus):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs:
        theirs.bind(("127.0.0.1", 0))
        port = theirs.getsockname()[1]
        words = ["watch", "--bus", "coulombus:bench", "--plotjuggler", str(port), "--seconds", "0.2", "--json"]
        result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    ready, end = map(json.loads, result.stdout.splitlines())
    assert ready == {"event": "ready", "url": f"udp://127.0.0.1:{port}"}
    assert end == {"event": "end", "pdos": 0, "unheard": 0, "lost": 0, "malformed": 0}


@pytest.mark.parametrize(
    ("words", "mistake"),
    [
        ("--foxglove --plotjuggler", "--foxglove and --plotjuggler: choose one of them"),
        ("--web --foxglove", "--web and --foxglove: choose one of them"),
        ("--scope motor.position_rad --json", "--scope draws in a terminal"),
        ("--scope motor.position_rad --foxglove", "leave --foxglove out"),
        ("--foxglove 99999", "99999 is not in the range"),
    ],
)
def test_ways_that_exclude_each_other(words, mistake):
    result = CliRunner().invoke(main, ["watch", "--bus", "coulombus:bench", *words.split()])
    assert result.exit_code == 2
    assert mistake in " ".join(result.output.split())


def test_a_listener_tells_what_it_lost(bus, rig):
    bus.lost = 4
    done = threading.Event()
    with LiveBus(Client(BENCH, Hello(Flags.LISTEN_ONLY)), rig) as heard:
        heard.on("motor.position_rad", lambda t_s, value: done.set())
        bus.deliver((0x181, DATA))
        assert done.wait(10)
        assert heard.lost == 4
