"""``coulombus run --web`` against ``coulombus emulate``, in real time: a page changes the law, marks and
stops. What they do, never how fast.
"""

import asyncio
import json
import re
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

from coulombus.host.run.control_socket import NoHost, ask_status, host_runs
from coulombus.host.run.last_word import last_page
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.monitor.web.batch import unpacked
from coulombus.monitor.web.last_page import LastPage
from coulombus.recording.reading import read
from coulombus.wire.address import parse_address
from real_bench import HOLD, PATIENCE_S, host, result, simulation

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.patient,
    pytest.mark.usefixtures("private_sockets"),
    pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop"),
]
BUS, OVERRIDES = "coulombus:page", (f"phase={HOLD}",)


class Page:
    """What a browser does with the server's address."""

    def __init__(self, url):
        self.trips = []
        self.url, self.origin = url, url.rpartition("/")[0].rpartition("/")[0]

    async def __aenter__(self):
        request = HTTPRequest(self.url.replace("http", "ws") + "data", headers={"Origin": self.origin})
        self.socket = await websocket_connect(request)
        return self

    async def __aexit__(self, *_):
        self.socket.close()
        while await self.socket.read_message() is not None:
            pass  # it is closed when the server has answered

    async def until(self, condition):
        """Take batches until one has a state for which the condition holds; return its head."""
        while True:
            message = await self.socket.read_message()
            assert message is not None, "the server has closed"
            head, _ = unpacked(message)
            if "trip_bin" in head:
                self.trips.append(head["trip_bin"])
                continue
            await self.socket.write_message(f"took {head['n']}")
            if "state" in head and condition(head):
                return head

    async def ask(self, what, answer):
        """Say something; return the head of the batch whose answer has this in it."""
        await self.socket.write_message(what)
        return await self.until(lambda head: answer in head["answer"])

    async def stop(self):
        """Press STOP; return what the server says."""
        response = await AsyncHTTPClient().fetch(
            self.url + "stop", method="POST", body="", headers={"Origin": self.origin}, request_timeout=PATIENCE_S
        )
        return json.loads(response.body)


def parameter(head, name):
    return next(row for row in head["state"]["host"]["parameters"] if row["name"] == name)


ADDRESS = r"page: (http://127\.0\.0\.1:\d+/[\w-]{32,}/)$"


def said(run, pattern):
    """Return the match of the next line on stderr that has the pattern."""
    lines = []
    for line in run.stderr:
        lines.append(line)
        if match := re.match(pattern, line):
            return match
    raise AssertionError(lines)


def test_a_page_changes_the_law_of_a_run_marks_it_and_stops_it(tmp_path):
    async def course(url):
        async with Page(url) as page:
            head = await page.until(lambda head: head["state"]["host"]["phase"] == "running" and head["controls"])
            assert head["state"]["arm"] == "armed"
            assert parameter(head, "F_s_Nm")["now"] == 3.5
            await page.ask('set {"values": {"F_s_Nm": 99.0}}', "F_s_Nm=99: expected from 0 to 4.5 Nm")
            await page.ask('set {"values": {"F_s_Nm": 3.125}}', "F_s_Nm 3.5 -> 3.125 Nm")
            await page.until(lambda head: parameter(head, "F_s_Nm")["now"] == 3.125)
            await page.ask("mark 4", "mark 4")
            assert await page.stop() == {"ok": True, "text": "the host stopped safely"}

    record = tmp_path / "r.pcapng"
    arguments = ("--web", "--web-port", 0, "--record", record)
    with simulation(BUS, overrides=OVERRIDES), host(BUS, *arguments, seconds=PATIENCE_S, overrides=OVERRIDES) as run:
        asyncio.run(asyncio.wait_for(course(said(run, ADDRESS)[1]), PATIENCE_S))
        status, data, err = result(run)
    assert status == 0, err
    assert data["trip"] is None
    markers = [text for _, text in read(record).markers]
    assert any(text.startswith("set F_s_Nm 3.5 -> 3.125 Nm") for text in markers), markers
    assert "mark 4" in markers
    assert markers[-1] == "safe"


def phases_until_the_end():
    """Yield the phases that the host tells until it runs no longer."""
    while host_runs(parse_address(BUS)):
        with suppress(NoHost):
            yield ask_status(parse_address(BUS), 1.0)["axes"][0]["phase"]


def test_after_a_trip_the_page_stays_and_tells_who_comes_now():
    async def armed(url):
        async with Page(url) as page:
            await page.until(lambda head: head["state"]["host"]["phase"] == "running")

    async def later(url):
        async with Page(url) as page:
            told = (await page.until(lambda head: head["state"]["host"]["trip"]))["state"]["host"]
            await page.until(lambda head: page.trips)
            await page.until(lambda head: last_page(address) is not None)
            return told

    address = parse_address(BUS)
    arguments = ("--web", "--web-port", 0)
    with simulation(BUS, overrides=OVERRIDES), host(BUS, *arguments, seconds=PATIENCE_S, overrides=OVERRIDES) as run:
        url = said(run, ADDRESS)[1]
        asyncio.run(asyncio.wait_for(armed(url), PATIENCE_S))
        nmt = [sys.executable, "-m", "coulombus", "nmt", "stop", "1", "--bus", BUS, "--beside-host"]
        subprocess.run(nmt, check=True, timeout=PATIENCE_S)
        phases = list(phases_until_the_end())
        said(run, "coulombus: the page stays for 60 s; Ctrl-C ends it")
        told = asyncio.run(asyncio.wait_for(later(url), PATIENCE_S))
        assert told["entry"]
        assert phases.count("safe") > 3  # it answers while the brake is ramped off
        run.send_signal(signal.SIGINT)
        status, data, err = result(run)
    assert status == 7, err
    assert data["trip"] == told["trip"]
    assert any(trip in data["trip"] for trip in ("NMT_STATE", "TPDO_LOST"))  # whichever is noticed first
    last = LastPage.from_file(last_page(address), "token")
    assert last.rig_name == "bench"
    head, rows = unpacked(last.batches[""][0])
    raw = {part["s"]: row for part, row in zip(head["parts"], rows, strict=True) if part["k"] == "raw"}
    times = raw["brake.handle_torque_Nm"][0]
    assert times[0] < -0.45
    assert times[-1] > 0.15
