"""The page's server over HTTP and WebSocket, as a browser and as one who means no good."""

import asyncio
import dataclasses
import json
import random
import socket
import threading

import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError

from coulombus.host.run.changes import LOCK_NS, TRIES
from coulombus.monitor.web import WebError
from coulombus.monitor.web.batch import IN_FLIGHT, unpacked
from coulombus.monitor.web.page import QUESTIONS, RUBBISH, order_of
from coulombus.monitor.web.server import _last_word, listening
from web_bench import BEGIN_NS, MS, Door, answer_of, cycles, origin, page, served, socket_of


async def status(url, **options):
    try:
        return (await AsyncHTTPClient().fetch(HTTPRequest(url, **options))).code
    except HTTPClientError as error:
        return error.code


def test_all_is_forbidden_without_the_token():
    async def run():
        async with served(page()) as url:
            root = url.rpartition("/")[0].rpartition("/")[0]
            places = (
                "/",
                "/favicon.ico",
                "/data",
                "/x/",
                "/x/layout",
                "/x/static/page.js",
                f"/{'a' * 31}b/",
                "/static/page.js",
            )
            assert [await status(root + place) for place in places] == [403] * len(places)
            assert await status(root + "/x/stop", method="POST", body="", headers=origin(url)) == 403
            assert [await status(url + place) for place in ("", "layout", "static/page.js", "static/stop.js")] == [
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


@pytest.mark.parametrize("place", ["", "layout", "static/page.js", "stop", "data", "nowhere"])
def test_a_request_for_another_host_is_refused_with_the_reason(place):
    """A stranger's name that points here (DNS rebinding) has the right token and its own origin."""
    door = Door()

    async def run():
        async with served(page(door=door)) as url:
            port = url.split(":")[2].partition("/")[0]
            for host in (f"evil.example:{port}", "127.0.0.1", "127.0.0.1:1", f"127.0.0.1.evil.example:{port}"):
                headers = {"Host": host, "Origin": f"http://{host}"}
                how = {"method": "POST", "body": ""} if place == "stop" else {}
                if place == "data":
                    request = socket_of(url, **headers)
                else:
                    request = AsyncHTTPClient().fetch(HTTPRequest(url + place, headers=headers, **how))
                with pytest.raises(HTTPClientError) as refused:
                    await request
                assert refused.value.code == 421
                if place != "data":
                    assert b"open the URL that the command printed" in refused.value.response.body

    asyncio.run(run())
    assert door.stops == 0


def test_the_loopback_has_three_names():
    async def run():
        async with served(page()) as url:
            port = url.split(":")[2].partition("/")[0]
            for name in ("127.0.0.1", "localhost", "LOCALHOST", "[::1]"):
                host = f"{name}:{port}"
                assert await status(url, headers={"Host": host}) == 200
                (await socket_of(url, Host=host, Origin=f"http://{host}")).close()

    asyncio.run(run())


def test_a_page_that_takes_nothing_is_sent_two_batches_and_blocks_nobody():
    async def run():
        shown = page()
        async with served(shown) as url:
            sleeping, awake = await socket_of(url), await socket_of(url)
            for k in range(100):
                shown.capture.add_frames(cycles(33 * k, 33))
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
            while shown.control.holder is None:
                await asyncio.sleep(0)
            assert await told(3, second) == [(True, False)]
            second.close()

    asyncio.run(run())


def test_only_the_page_that_controls_changes_parameters_and_marks():
    door = Door()

    async def run():
        shown = page(door=door)
        async with served(shown) as url:
            first = await socket_of(url)
            order = 'set {"values": {"F_s_Nm": 3.2}}'
            assert await answer_of(shown, first, order, 1) == "set F_s_Nm 3.5 -> 3.2 Nm in 0.5 s"
            answer = await answer_of(shown, first, 'set {"values": {"F_s_Nm": 9}}', 2)
            assert answer.startswith("not changed: F_s_Nm=9: expected from 0 to 4.5 Nm")
            assert await answer_of(shown, first, "mark 7", 3) == "mark 7"
            assert [order["axis"] for order in door.orders] == ["", ""]
            first.close()
        door.orders.clear()
        shown = page(door=door)
        async with served(shown) as url:
            first, second = await socket_of(url), await socket_of(url)
            for k, message in enumerate((order, 'set {"undo": true}', "mark 5")):
                assert "this page is viewing; take control first" in await answer_of(shown, second, message, k + 1)
                head, _ = unpacked(await first.read_message())
                assert head["answer"] == ""
                await first.write_message(f"took {head['n']}")
            assert (door.orders, door.marks) == ([], ["7"])
            first.close()
            second.close()

    asyncio.run(run())


def test_what_the_host_answered_within_one_state_is_told_answer_by_answer():
    door = Door()

    async def run():
        shown, answers = page(door=door), []
        async with served(shown) as url:
            first = await socket_of(url)
            for message in ('set {"values": {"F_s_Nm": 9}}', "mark 7"):
                await first.write_message(message)
            while sum(len(session.answers) for session in shown.sessions) < 2:
                await asyncio.sleep(0.001)
            for k in range(3):
                shown.tick(BEGIN_NS + 1000 * (k + 1) * MS)
                head, _ = unpacked(await first.read_message())
                await first.write_message(f"took {head['n']}")
                answers.append(head["answer"])
                while not all(session.flow.free for session in shown.sessions):
                    await asyncio.sleep(0)
            first.close()
        refused, marked = sorted(answers[:2], key=lambda words: words == "mark 7")
        assert refused.startswith("not changed: F_s_Nm=9")
        assert (marked, answers[2]) == ("mark 7", "")

    asyncio.run(run())


def test_a_change_that_the_host_is_slow_to_answer_holds_up_no_stop():
    door, going = Door(), threading.Event()

    async def run():
        shown = page(door=door)
        async with served(shown) as url:
            first = await socket_of(url)
            for k in range(1, QUESTIONS + 1):
                await first.write_message(f"mark {k}")
            while shown.asking < QUESTIONS:
                await asyncio.sleep(0.001)
            assert "too many are under way" in await answer_of(shown, first, "mark 9", 1)
            request = HTTPRequest(url + "stop", method="POST", body="", headers=origin(url))
            assert json.loads((await AsyncHTTPClient().fetch(request)).body)["ok"]
            assert (door.stops, door.marks) == (1, [])
            going.set()
            while shown.asking:
                await asyncio.sleep(0.001)
            assert door.marks == ["1", "2", "3", "4"]
            first.close()

    mark = door.mark

    def slowly(text):
        going.wait()
        return mark(text)

    door.door = dataclasses.replace(door.door, mark=slowly)
    asyncio.run(run())


@pytest.mark.parametrize(
    "message",
    ["set", "set {", "set []", "set 3", 'set {"axis": "y"}', "mark 0", "mark 12", "mark x", "set" + " {" * 200],
)
def test_what_is_no_order_is_rubbish(message):
    assert order_of(message, "") is None


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
            shown.capture.add_frames(cycles(0, 33))
            shown.tick(BEGIN_NS + 40 * MS)
            assert unpacked(await good.read_message())[0]["state"]["rig"] == "bench"
            assert (door.stops, shown.stopping) == (0, 0)
            good.close()

    asyncio.run(run())


def test_the_pages_have_the_tries_of_the_arm_key_together_and_are_told_of_the_lock():
    door = Door(arm_key="004711")

    async def run():
        shown = page(door=door)
        async with served(shown) as url:
            for k in range(TRIES):  # a page each
                connection = await socket_of(url)
                assert "the arm key is wrong" in await answer_of(shown, connection, set_to("123456"), k)
                connection.close()
                while shown.sessions:
                    await asyncio.sleep(0)
            connection = await socket_of(url)
            door.now_ns = LOCK_NS - 1
            assert "none is taken for another 1 s" in await answer_of(shown, connection, set_to("004711"), TRIES)
            connection.close()

    asyncio.run(run())


def set_to(key):
    return "set " + json.dumps({"values": {"F_s_Nm": 3.2}, "key": key})


def test_an_arm_key_of_half_a_character_is_wrong():
    door = Door(arm_key="1234")
    answer = door.changes.answer('{"values": {"F_s_Nm": 3.2}, "key": "\\ud800"}', 0)
    assert answer["error"].startswith("the arm key is wrong")


@pytest.mark.thorough
def test_a_hundred_thousand_mutilated_orders_change_nothing_beyond_bounds():
    door, noise = Door(), random.Random(5)
    seeds = ['set {"values": {"F_s_Nm": 3.2}}', 'set {"undo": true}', "mark 7", "took 3", "control"]
    pieces = ["NaN", "1e999", "-9", '"', "{", "}", "[", ":", "null", "set ", "\0", "\ud800", "\N{SNOWMAN}", "9" * 400]

    def mutilated():
        text = noise.choice(seeds)
        for _ in range(noise.randrange(1, 4)):
            at, cut = noise.randrange(len(text) + 1), noise.randrange(4)
            text = text[:at] + noise.choice(pieces) + text[at + cut :]
        return text if noise.random() < 0.9 else text.encode("utf-8", "replace")

    async def run():
        shown = page(door=door)
        async with served(shown) as url:
            bad = await socket_of(url)
            session = next(iter(shown.sessions))
            rubbish = 0
            for k in range(100_000):
                session.on_message(mutilated())
                rubbish, session.rubbish = rubbish + session.rubbish, 0  # or else it ended after a hundred
                if k % 1000 == 0:
                    await asyncio.sleep(0)
            while shown.asking:
                await asyncio.sleep(0.001)
            assert rubbish > 50_000
            assert (door.stops, shown.stopping) == (0, 0)
            F_s_Nm = next(row for row in door.changes.rows()[0] if row["name"] == "F_s_Nm")
            assert F_s_Nm["low"] <= F_s_Nm["value"] <= F_s_Nm["high"]
            bad.close()
            good = await socket_of(url)
            shown.capture.add_frames(cycles(0, 33))
            shown.tick(BEGIN_NS + 40 * MS)
            assert unpacked(await good.read_message())[0]["state"]["rig"] == "bench"
            good.close()

    asyncio.run(run())


def test_a_port_in_use_is_told():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        port = server.getsockname()[1]
        with pytest.raises(WebError, match=f"port {port} of 127.0.0.1 is in use: choose another with --web-port"):
            listening("127.0.0.1", port)
    with pytest.raises(WebError, match="--web-host names an address of this machine"):
        listening("no.such.host.invalid", 0)


def test_a_bus_that_is_gone_leaves_the_host_time_for_its_last_word():
    asked = []

    def last():
        asked.append(1)
        return {"trip": "BUS_LOST"} if len(asked) == 3 else None

    async def run():
        await _last_word(dataclasses.replace(Door().door, last=last), asyncio.Event())
        over = asyncio.Event()
        over.set()
        await _last_word(dataclasses.replace(Door().door, last=last), over)  # the run is over: nothing more comes

    asyncio.run(run())
    assert len(asked) == 3
