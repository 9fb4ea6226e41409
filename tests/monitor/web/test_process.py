"""``coulombus watch --web`` as a process on a bus: its first line, what it says to the bus, and how it
lives with those who mean no good.
"""

import asyncio
import base64
import json
import os
import random
import re
import signal
import socket
import struct
import subprocess
import sys
from contextlib import contextmanager, suppress

import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

from chromium import CHROMIUM, Browser
from coulombus.monitor.web.batch import unpacked
from coulombus.monitor.web.page import RUBBISH
from coulombus.monitor.web.server import CONNECTIONS
from warm_start import Warm

pytestmark = pytest.mark.slow


@contextmanager
def page_of(*words, port=0):
    """A server that is ready, as a process; yields it and its URL."""
    command = ["watch", "--bus", "coulombus:bench", "--web", "--json"]
    with Warm(
        [*command, "--web-port", str(port), *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            ready = json.loads(line)
            assert ready.keys() == {"event", "url"}, line
            assert ready["event"] == "ready"
            yield process, ready["url"]
        finally:
            process.kill()


def place(url):
    """Return host, port and token of a URL."""
    host, port, token = re.fullmatch(r"http://([\d.]+):(\d+)/([\w-]{32,})/", url).groups()
    return host, int(port), token


async def batch_of(url):
    """Return the first batch that a page gets which has the state."""
    headers = {"Origin": url.rpartition("/")[0].rpartition("/")[0]}
    connection = await websocket_connect(HTTPRequest(url.replace("http", "ws") + "data", headers=headers))
    try:
        while True:
            head, numbers = unpacked(await asyncio.wait_for(connection.read_message(), 60))
            if "state" in head:
                return head, numbers
            await connection.write_message(f"took {head['n']}")
    finally:
        connection.close()
        while await asyncio.wait_for(connection.read_message(), 60) is not None:
            pass  # the socket is closed when the server has answered


def masked(opcode, data, noise, final=True):
    """Return a WebSocket frame as a browser sends it."""
    mask = noise.randbytes(4)
    length = bytes([0x80 | len(data)]) if len(data) < 126 else bytes([0xFE]) + struct.pack(">H", len(data))
    return bytes([final << 7 | opcode]) + length + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(data))


def upgrade(url):
    """Return what a browser asks to open the socket."""
    host, port, token = place(url)
    key = base64.b64encode(os.urandom(16)).decode()
    lines = (
        f"GET /{token}/data HTTP/1.1",
        f"Host: {host}:{port}",
        f"Origin: http://{host}:{port}",
        "Upgrade: websocket",
    )
    lines += ("Connection: Upgrade", f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", "")
    return "\r\n".join(lines).encode()


async def said(url, message, upgraded=False):
    """Say something to the server and leave when it has closed, or answers no more."""
    host, port, _ = place(url)
    reader, writer = await asyncio.open_connection(host, port)
    try:
        if upgraded:
            writer.write(upgrade(url))
            assert (await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60)).startswith(b"HTTP/1.1 101")
        writer.write(message)
        writer.write_eof()
        await asyncio.wait_for(reader.read(), 60)
    except (OSError, asyncio.IncompleteReadError):  # the server has closed, perhaps before the last word
        pass
    finally:
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()


async def stays(url, process):
    """The page is served as ever."""
    assert process.poll() is None
    assert (await AsyncHTTPClient().fetch(url)).code == 200
    head, _ = await batch_of(url)
    assert head["state"]["rig"] == "bench"


def test_the_first_line_has_the_address_and_a_signal_ends_it(bus):
    with page_of() as (process, url):
        host, _, token = place(url)
        assert host == "127.0.0.1"
        bus.deliver((0x182, struct.pack("<hhh", -1200, 250, 221)))
        head, _ = asyncio.run(batch_of(url))
        assert head["axis"] == ""
        assert head["controls"] is True
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
        assert token not in process.stderr.read()
    assert bus.frames == []


def test_a_page_at_all_addresses_is_served_under_its_printed_name(bus):
    with page_of("--web-host", "0.0.0.0") as (_, url):
        name, port, token = re.fullmatch(r"http://([^:]+):(\d+)/([\w-]{32,})/", url).groups()
        assert name == socket.gethostname()
        here = f"http://127.0.0.1:{port}/{token}/"
        for host, status in ((f"{name}:{port}", 200), (f"127.0.0.1:{port}", 200), (f"evil.example:{port}", 421)):
            request = HTTPRequest(here, headers={"Host": host})
            assert asyncio.run(fetched(request)).code == status


async def fetched(request):
    return await AsyncHTTPClient().fetch(request, raise_error=False)


@pytest.mark.thorough
def test_a_new_start_has_the_same_token_and_a_port_in_use_ends_with_words(bus):
    with page_of() as (_, url):
        _, port, token = place(url)
        command = [sys.executable, "-m", "coulombus", "watch", "--bus", "coulombus:bench", "--web"]
        second = subprocess.run([*command, "--web-port", str(port)], capture_output=True, text=True, timeout=120)
        assert second.returncode == 2
        assert f"port {port} of 127.0.0.1 is in use: choose another with --web-port" in second.stderr
        assert "Traceback" not in second.stderr
    with page_of(port=port) as (_, url):
        assert place(url)[1:] == (port, token)


@pytest.mark.thorough
def test_a_hundred_thousand_messages_of_rubbish_reach_no_bus_and_end_no_server(bus):
    noise = random.Random(11)
    texts = [
        b"took -1",
        b"took 999999999999999",
        b"control!",
        b"mark 0",
        b"set",
        b"set {",
        b"set []",
        b"\xff\xfe",
        b"{}",
    ]

    def messages():
        """A session's rubbish: whole frames, binary ones too, some with what the page understands."""
        parts = []
        for _ in range(RUBBISH + 100):
            data = (
                noise.choice(texts) + noise.randbytes(noise.randrange(20))
                if noise.random() < 0.5
                else noise.randbytes(30)
            )
            parts.append(masked(2 if noise.random() < 0.8 else 9, data, noise))
        return b"".join(parts)

    def broken():
        """What is no WebSocket frame: unmasked, reserved bits, fragments without a beginning, huge, torn."""
        kinds = (
            b"\x81\x03abc",
            bytes([0xF1, 0x83]) + noise.randbytes(7),
            masked(0, b"tail", noise),
            masked(1, b"a" * 5000, noise),
            b"\x81\xff" + struct.pack(">Q", 1 << 62) + noise.randbytes(40),
            masked(1, b"\xc3\x28", noise),
            masked(8, noise.randbytes(3), noise),
            noise.randbytes(64),
        )
        return noise.choice(kinds)

    def requests():
        """HTTP that is none, many to a connection."""
        _, _, token = place(url)
        kinds = (
            lambda: noise.randbytes(200) + b"\r\n\r\n",
            lambda: b"GET /" + noise.randbytes(9).hex().encode() + b"/ HTTP/1.1\r\nHost: x\r\n\r\n",
            lambda: (
                f"POST /{token}/stop HTTP/1.1\r\nHost: x\r\nOrigin: http://evil\r\nContent-Length: 0\r\n\r\n".encode()
            ),
            lambda: b"POST /x/stop HTTP/1.1\r\nHost: x\r\nContent-Length: 99999999999\r\n\r\n",
            lambda: f"GET /{token}/ HTTP/1.1\r\nX: ".encode() + b"a" * 70_000 + b"\r\n\r\n",
            lambda: b"GET / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\nZZ\r\n",
            lambda: f"GET /{token}/?axis=%00%ff HTTP/1.1\r\nHost: x\r\n\r\n".encode() * 20,
        )
        return noise.choice(kinds)()

    async def run():
        sent = 0
        while sent < 100_000:
            await said(url, messages(), upgraded=True)
            sent += RUBBISH + 100
            await asyncio.gather(said(url, broken(), upgraded=True), *(said(url, requests()) for _ in range(3)))
            sent += 4
        await stays(url, process)

    with page_of() as (process, url):
        asyncio.run(run())
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        assert process.stderr.read() == ""
    assert bus.frames == []


def test_many_who_say_nothing_keep_nobody_out(bus):
    async def run():
        host, port, _ = place(url)
        idle = [await asyncio.open_connection(host, port) for _ in range(4 * CONNECTIONS)]
        for _, writer in idle[::2]:
            writer.write(b"POST /")
        await stays(url, process)
        for _, writer in idle:
            writer.close()

    with page_of() as (process, url):
        asyncio.run(run())


def test_one_who_reads_nothing_blocks_nobody(bus):
    """What is sent to it is bounded, however much the bus carries."""
    with page_of() as (process, url):
        host, port, _ = place(url)
        with socket.create_connection((host, port)) as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
            deaf.sendall(upgrade(url))

            async def run():
                for _ in range(20):
                    for k in range(100):
                        bus.deliver((0x182, struct.pack("<hhh", k, 250, 221)))
                    head, _ = await batch_of(url)
                assert head["controls"] is False  # the deaf one came first

            asyncio.run(run())
            assert process.poll() is None


@pytest.mark.thorough
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)")
def test_a_page_finds_the_server_again_after_that_was_killed(bus, tmp_path):
    async def run(first, url, port):
        async with Browser(url, str(tmp_path / "profile")) as browser:
            await browser.until("frames > 2 && one('role').textContent === 'in control'")
            first.kill()
            await browser.until("cut && document.body.classList.contains('cut')")
            assert "use `coulombus stop`" in await browser.text("said")
            with page_of(port=port):
                before = await browser.evaluate("frames")
                await browser.until(f"!cut && frames > {before} + 2 && one('said').hidden", 90)
                assert await browser.text("role") == "in control"

    with page_of() as (process, url):
        asyncio.run(run(process, url, place(url)[1]))
