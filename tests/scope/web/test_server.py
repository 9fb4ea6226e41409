"""The page's server over HTTP and WebSocket, as a browser and as one who means no good."""

import asyncio
import json
import random
import socket

import pytest

pytest.importorskip("bokeh", reason="the page needs Bokeh: pip install 'coulombus[web]'")

from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

from coulombus.scope.web import WebError
from coulombus.scope.web.batch import IN_FLIGHT, unpacked
from coulombus.scope.web.server import RUBBISH, listening
from web_bench import BEGIN_NS, MS, Door, cycles, page, served


async def status(url, **options):
    try:
        return (await AsyncHTTPClient().fetch(HTTPRequest(url, **options))).code
    except HTTPClientError as error:
        return error.code


def origin(url):
    return {"Origin": url.rpartition("/")[0].rpartition("/")[0]}


async def socket_of(url, **headers):
    return await websocket_connect(HTTPRequest(url.replace("http", "ws") + "data", headers=headers or origin(url)))


def test_all_is_forbidden_without_the_token():
    async def run():
        async with served(page()) as url:
            root = url.rpartition("/")[0].rpartition("/")[0]
            places = (
                "/",
                "/favicon.ico",
                "/data",
                "/x/",
                "/x/plots",
                "/x/static/page.js",
                f"/{'a' * 31}b/",
                "/static/page.js",
            )
            assert [await status(root + place) for place in places] == [403] * len(places)
            assert await status(root + "/x/stop", method="POST", body="", headers=origin(url)) == 403
            assert [await status(url + place) for place in ("", "plots", "static/page.js", "static/bokeh.min.js")] == [
                200
            ] * 4
            assert await status(url + "static/page.html") == 404
            assert await status(url + "static/..%2fserver.py") in (403, 404)

    asyncio.run(run())


def test_stop_asks_the_host_and_only_from_the_page_itself():
    door = Door()

    async def run():
        async with served(page(door=door)) as url:
            for headers in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
                assert await status(url + "stop", method="POST", body="", headers=headers) == 403
            assert await status(url + "stop", headers=origin(url)) == 405
            assert door.stops == 0
            request = HTTPRequest(url + "stop", method="POST", body="", headers=origin(url))
            answer = json.loads((await AsyncHTTPClient().fetch(request)).body)
            assert (door.stops, answer) == (1, {"ok": True, "text": "the host stopped safely"})

    asyncio.run(run())


def test_a_socket_from_another_page_is_refused():
    async def run():
        async with served(page()) as url:
            with pytest.raises(HTTPClientError, match="403"):
                await socket_of(url, Origin="http://evil.example")

    asyncio.run(run())


def test_a_page_that_takes_nothing_is_sent_two_batches_and_blocks_nobody():
    async def run():
        shown = page()
        async with served(shown) as url:
            sleeping, awake = await socket_of(url), await socket_of(url)
            for k in range(100):
                shown.capture.take(cycles(33 * k, 33))
                shown.tick(BEGIN_NS + 33 * (k + 1) * MS)
                head, _ = unpacked(await awake.read_message())
                await awake.write_message(f"took {head['n']}")
                while not all(s.flow.free for s in shown.sessions if s.number == 2):
                    await asyncio.sleep(0)
            sent = {session.number: session.flow.sent for session in shown.sessions}
            assert sent == {1: IN_FLIGHT, 2: 100}
            for _ in range(IN_FLIGHT):
                head, _ = unpacked(await sleeping.read_message())
            await sleeping.write_message(f"took {head['n']}")
            while not all(s.flow.free for s in shown.sessions):
                await asyncio.sleep(0)
            shown.tick(BEGIN_NS + 4000 * MS)
            head, _ = unpacked(await sleeping.read_message())
            bins = max(part["n"] for part in head["parts"] if part["k"] == "envelope")
            assert bins > 150  # all that it slept through
            sleeping.close()
            awake.close()

    asyncio.run(run())


def test_a_second_page_looks_on_until_the_first_has_gone():
    async def run():
        shown = page()
        async with served(shown) as url:

            async def told(k, *connections):
                shown.tick(BEGIN_NS + 1000 * k * MS)
                heads = []
                for connection in connections:
                    head, _ = unpacked(await connection.read_message())
                    await connection.write_message(f"took {head['n']}")
                    heads.append((head["controls"], head["refused"]))
                while not all(s.flow.free for s in shown.sessions):
                    await asyncio.sleep(0)
                return heads

            first, second = await socket_of(url), await socket_of(url)
            assert await told(1, first, second) == [(True, False), (False, False)]
            await second.write_message("control")
            while not any(session.refused for session in shown.sessions):
                await asyncio.sleep(0)
            assert await told(2, first, second) == [(True, False), (False, True)]
            first.close()
            while len(shown.sessions) == 2:
                await asyncio.sleep(0.001)
            await second.write_message("control")
            while shown.seat.holder is None:
                await asyncio.sleep(0)
            assert await told(3, second) == [(True, False)]
            second.close()

    asyncio.run(run())


def test_rubbish_ends_its_session_and_nothing_else():
    door, noise = Door(), random.Random(3)

    async def run():
        shown = page(door=door)
        async with served(shown) as url:
            for _ in range(20):
                bad = await socket_of(url)
                try:
                    for _ in range(2 * RUBBISH):
                        await bad.write_message(noise.randbytes(noise.randrange(60)), binary=True)
                        if noise.random() < 0.1:
                            await bad.write_message(f"took {noise.randrange(10**15)}")
                except (WebSocketClosedError, UnicodeDecodeError):
                    pass
                while await bad.read_message() is not None:
                    pass
                bad.close()
            for _ in range(200):
                _, writer = await asyncio.open_connection("127.0.0.1", int(url.split(":")[2].split("/")[0]))
                writer.write(noise.choice([b"", b"GET / HTTP/1.1\r\n", b"POST "]) + noise.randbytes(200) + b"\r\n\r\n")
                writer.close()
            good = await socket_of(url)
            shown.capture.take(cycles(0, 33))
            shown.tick(BEGIN_NS + 40 * MS)
            assert unpacked(await good.read_message())[0]["state"]["rig"] == "bench"
            assert (door.stops, shown.stopping) == (0, 0)
            good.close()

    asyncio.run(run())


def test_a_port_in_use_is_told():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(WebError, match=f"port {port} of 127.0.0.1 is in use: choose another with --web-port"):
            listening("127.0.0.1", port)
    with pytest.raises(WebError, match="--web-host names an address of this machine"):
        listening("no.such.host.invalid", 0)
