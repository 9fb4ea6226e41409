"""The gateway for worlds, by Tornado's WebSocket client and a browser, at a server with a fake display."""

import asyncio
import json
import socket
from contextlib import asynccontextmanager

import numpy as np
import pytest

pytest.importorskip("tornado")

import tornado.httpserver
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from chromium import CHROMIUM, Browser
from coulombus.host.world.hand import world_path
from coulombus.host.world.model_parts import Model, Wall
from coulombus.host.world.protocol import Greeting, Named, read_refusal, read_welcome
from coulombus.host.world.records import STATE
from coulombus.host.world.relay import Relay
from coulombus.monitor.web.server import listening
from coulombus.monitor.web.world_gateway import MALFORMED, Gateway, gateway_application
from places import ROOT
from world_bench import BUS, PATIENCE_S, Bench

pytestmark = pytest.mark.usefixtures("private_sockets")
TOKEN = "t" * 32
MODEL_TEXT = json.dumps({"type": "model", "wall": {"x_rad": 0.0, "K_Nm_rad": 2.0}, "law": 0.0})


class Served:
    """A gateway that is served, and its port."""

    def __init__(self, gateway, port):
        self.gateway, self.port, self.clients = gateway, port, []

    def url(self, path="world", token=TOKEN, scheme="ws"):
        return f"{scheme}://127.0.0.1:{self.port}/{token}/{path}"

    async def connect(self, **headers):
        client = await websocket_connect(HTTPRequest(self.url(), headers=headers))
        self.clients.append(client)
        return client

    async def client(self, hello='{"type": "hello"}', **headers):
        """Return a client that has been welcomed."""
        client = await self.connect(**headers)
        await client.write_message(hello, binary=isinstance(hello, bytes))
        await message(client)
        return client


async def message(client):
    return await asyncio.wait_for(client.read_message(), PATIENCE_S)


async def text(client, kind):
    """Return the next JSON message of a kind."""
    while True:
        fields = json.loads(await message(client))
        if fields["type"] == kind:
            return fields


async def until(condition):
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0)


@asynccontextmanager
async def served(page=None):
    gateway = Gateway(world_path(BUS), Relay, TOKEN, page=page)
    sockets = listening("127.0.0.1", 0)
    server = tornado.httpserver.HTTPServer(gateway_application(gateway))
    server.add_sockets(sockets)
    at = Served(gateway, sockets[0].getsockname()[1])
    try:
        yield at
    finally:
        server.stop()
        for client in at.clients:
            client.close()
        for client in list(gateway.clients):
            client.close()
        await until(lambda: not gateway.clients)
        await server.close_all_connections()


def test_a_json_client_reads_batches_of_states_and_renders():
    async def run():
        with Bench() as bench:
            async with served() as at:
                client = await at.client()
                bench.cycle(50)
                numbers = []
                while len(numbers) < 50:
                    states = await text(client, "states")
                    numbers += states["sequence"]
                assert numbers == list(range(1, 51))
                assert states["x_rad"][-1] == 25.0
                for _ in range(3):
                    await client.write_message(MODEL_TEXT)
                await until(lambda: len(bench.display.models) == 3)
                assert [int(model["sequence"]) for model in bench.display.models] == [1, 2, 3]
                assert bench.display.models[0]["wall_K_Nm_rad"] == 2.0
                client.close()
                await until(lambda: not bench.server.controlled)

    asyncio.run(run())


def test_a_binary_client_speaks_the_records_of_the_socket():
    async def run():
        with Bench() as bench:
            async with served() as at:
                client = await at.connect()
                await client.write_message(Greeting().record(), binary=True)
                assert read_welcome((await message(client))[:64]) == bench.display.welcome()
                bench.cycle(3)
                data = b""
                while len(data) < 3 * STATE.itemsize:
                    data += await message(client)
                assert np.frombuffer(data, STATE)["sequence"].tolist() == [1, 2, 3]
                record = Model(wall=Wall(0.0, 3.0)).record({})
                record["sequence"] = 4
                await client.write_message(record.tobytes(), binary=True)
                await client.write_message(b"rubbish", binary=True)
                assert "malformed message 1" in read_refusal(await message(client)).reason
                await until(lambda: bench.display.models)
                assert bench.display.models[0]["wall_K_Nm_rad"] == 3.0

    asyncio.run(run())


def test_one_client_has_control_and_the_others_read():
    async def run():
        with Bench() as bench:
            async with served() as at:
                first, second = await at.client(), await at.client()
                await first.write_message(MODEL_TEXT)
                await until(lambda: bench.server.controlled)
                await second.write_message(MODEL_TEXT)
                assert (await text(second, "refused"))["reason"] == "another program has control"
                bench.cycle()
                assert (await text(second, "states"))["sequence"] == [1]
                first.close()
                await until(lambda: not bench.server.controlled)
                await second.write_message(MODEL_TEXT)
                await until(lambda: len(bench.display.models) == 2)

    asyncio.run(run())


def test_rubbish_is_counted_and_ends_its_sender_alone():
    async def run():
        with Bench() as bench:
            async with served() as at:
                good, bad = await at.client(), await at.client()
                for _ in range(MALFORMED):
                    await bad.write_message("{")
                while await message(bad) is not None:
                    pass
                assert (bad.close_code, bad.close_reason) == (1008, "100 malformed messages")
                bench.cycle()
                assert (await text(good, "states"))["sequence"] == [1]

    asyncio.run(run())


def test_a_client_that_does_not_read_slows_nobody_and_is_told_its_losses():
    async def run():
        with Bench() as bench:
            async with served() as at:
                quick = await at.client(Greeting().record())
                slow = await at.connect()
                await slow.write_message(Greeting().record(), binary=True)
                await until(lambda: bench.server.readers == 2)
                slow.protocol.stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
                seen = 0
                relays = [client.relay for client in at.gateway.clients]
                while not any(relay.lost for relay in relays):
                    bench.cycle(200)
                    while seen < bench.sequence:
                        states = np.frombuffer(await message(quick), STATE)
                        assert states["lost"][-1] == 0
                        seen += len(states)
                assert seen == bench.sequence
                await message(slow)  # WELCOME
                states = np.frombuffer(await message(slow), STATE)
                while states["lost"][-1] == 0:
                    states = np.frombuffer(await message(slow), STATE)
                assert states["sequence"][-1] <= bench.sequence

    asyncio.run(run())


@pytest.mark.parametrize(
    ("path", "token", "headers", "status"),
    [
        ("world", "x" * 32, {}, 403),
        ("world", TOKEN, {"Origin": "http://example.org"}, 403),
        ("world", TOKEN, {"Origin": "null"}, 403),
        ("world", TOKEN, {"Host": "example.org"}, 421),
        ("world?batch_s=nan", TOKEN, {}, 400),
        ("other", TOKEN, {}, 403),
    ],
)
def test_the_gateway_refuses_whom_the_page_refuses(path, token, headers, status):
    async def run():
        async with served() as at:
            with pytest.raises(HTTPClientError) as refused:
                await websocket_connect(HTTPRequest(at.url(path, token), headers=headers))
            assert refused.value.code == status

    asyncio.run(run())


def test_without_a_host_and_at_its_end_the_client_is_told_the_reason():
    async def run():
        async with served() as at:
            client = await at.connect()
            assert await message(client) is None
            assert (client.close_code, "run --world" in client.close_reason) == (1013, True)
            with Bench() as bench:
                client = await at.client(Origin=f"http://127.0.0.1:{at.port}")
                bench.server.close()
                assert await message(client) is None
                assert (client.close_code, "ended" in client.close_reason) == (1001, True)

    asyncio.run(run())


def test_the_page_is_served_if_one_is_given(tmp_path):
    async def run():
        page = tmp_path / "p.html"
        page.write_text("<p>hello")
        async with served(page) as at:
            answer = await AsyncHTTPClient().fetch(at.url("", scheme="http"))
            assert answer.body == b"<p>hello"
            assert "connect-src 'self'" in answer.headers["Content-Security-Policy"]
        async with served() as at:
            with pytest.raises(HTTPClientError, match="404"):
                await AsyncHTTPClient().fetch(at.url("", scheme="http"))

    asyncio.run(run())


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_browser_example_renders_its_wall_and_draws_the_handle(tmp_path):
    async def run():
        with Bench() as bench:
            async with (
                served(ROOT / "examples/worlds/wall.html") as at,
                Browser(at.url("", scheme="http"), str(tmp_path)) as browser,
            ):
                await until(lambda: len(bench.display.models) > 2)
                assert bench.display.models[-1]["wall_K_Nm_rad"] == 2.0
                bench.cycle(20)
                await browser.until("shown.states === 20 && shown.x_rad === 10")
                assert browser.errors == []
                assert {address.partition("/t")[0] for address in browser.requested} <= {
                    f"{scheme}://127.0.0.1:{at.port}" for scheme in ("http", "ws")
                }

    asyncio.run(run())


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_block_of_the_browser_sets_the_levels_and_shows_whether_it_slides(tmp_path):
    levels = (
        Named(0, 0, 0.0, 4.5, 3.5, "F_s_Nm"),
        Named(0, 1, 0.0, 4.0, 3.0, "F_d_Nm"),
        Named(0, -1, 1.5, 1.5, 1.5, "x"),
    )
    moved = "slider('F_s_Nm').value = 1.5, slider('F_s_Nm').dispatchEvent(new Event('input', { bubbles: true }))"

    async def run():
        with Bench() as bench:
            bench.display.parameters = lambda: levels
            async with (
                served(ROOT / "examples/worlds/stick_slip_block.html") as at,
                Browser(at.url("", scheme="http"), str(tmp_path)) as browser,
            ):
                await until(lambda: len(bench.display.models) > 2)
                model = bench.display.models[-1]
                assert (model["spring_K_Nm_rad"], model["law"], model["parameters"]) == (1.0, 1.0, 0b11)
                assert model["parameter"][:2].tolist() == [3.5, 3.0]
                await browser.evaluate(moved)
                await until(lambda: bench.display.models[-1]["parameter"][:2].tolist() == [1.5, 1.5])
                bench.cycle(20)
                await browser.until("shown.states === 20 && shown.x_rad === 10 && !shown.slides")
                bench.cycle(v_rad_s=-0.5)
                await browser.until("shown.slides")
                assert browser.errors == []

    asyncio.run(run())
