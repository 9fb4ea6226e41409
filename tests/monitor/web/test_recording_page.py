"""``coulombus watch FILE --web``: a recording in the page."""

import asyncio
import json
from contextlib import asynccontextmanager

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

import tornado.httpserver
from tornado.httpclient import AsyncHTTPClient, HTTPClientError

from chromium import CHROMIUM, Browser
from coulombus.cli.main import main
from coulombus.explain.explained import explain
from coulombus.kernels.records import new_records
from coulombus.monitor.web.recording_page import PIECES, RecordingPage, recording_application
from coulombus.monitor.web.server import listening
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame, data_word
from web_bench import BEGIN_NS, MS, TOKEN, cycles

MILLISECONDS, FAULT = 4000, 3000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Four seconds of the bench; after three the drive reports an error, and a marker says so."""
    rig = load_rig("bench")
    frames = cycles(0, MILLISECONDS)
    for k in range(0, MILLISECONDS, 50):
        frames += [(BEGIN_NS + k * MS + 600_000, 0x700 + node, 1, b"\5" + bytes(7)) for node in (1, 2, 127)]
    emergency = (BEGIN_NS + FAULT * MS + 700_000, 0x081, 8, bytes.fromhex("1042010000000000"))
    frames = sorted([*frames, emergency])
    table = new_records(Frame, len(frames))
    table[:] = [(t_ns, can_id, length, data_word(data[:length]), 0) for t_ns, can_id, length, data in frames]
    made = tmp_path_factory.mktemp("recording") / "run.pcapng"
    attachments = {"rig.toml": rig.effective().encode()} | {n: t.encode() for n, t in rig.eds_texts.items()}
    with PcapngWriter(made, attachments=attachments) as writer:
        writer.write(table, {frames.index(emergency): "mark 3"})
    return made


@pytest.fixture(scope="module")
def shown(path):
    recording = read(path)
    return RecordingPage(recording, explain(path, rig=recording.rig), TOKEN)


@asynccontextmanager
async def served(page):
    sockets = listening("127.0.0.1", 0)
    server = tornado.httpserver.HTTPServer(recording_application(page))
    server.add_sockets(sockets)
    try:
        yield f"http://127.0.0.1:{sockets[0].getsockname()[1]}/{TOKEN}/"
    finally:
        server.stop()
        await server.close_all_connections()


def test_the_document_has_the_live_plots_all_signals_markers_and_incidents(shown):
    document = shown.document()
    assert [plot["title"] for plot in document["plots"]] == ["torque", "position"]
    assert document["plots"][0]["signals"][0] == "brake.handle_torque_Nm"
    assert {"motor.statusword", "brake.coil_current_A"} <= {signal["name"] for signal in document["signals"]}
    assert document["markers"] == [[pytest.approx(3.0, abs=0.001), "mark 3"]]
    (incident,) = document["incidents"]
    assert incident["title"].startswith("motor (node 1): ")
    assert incident["t"] == pytest.approx(3.0007, abs=1e-6)
    assert (document["begin"], document["end"]) == (
        pytest.approx(0.0002, abs=1e-6),
        pytest.approx(3.9995, abs=1e-6),
    )
    json.dumps(document, allow_nan=False)


def test_a_stretch_is_as_recorded_and_many_samples_keep_their_extremes(shown):
    series = shown.recording["brake.handle_torque_Nm"]
    few = shown.samples("brake.handle_torque_Nm", 1.0, 1.5)
    inside = [t for t in few["t"] if 1.0 <= t <= 1.5]
    assert len(inside) == 500
    assert len(few["t"]) == 502  # one before, one after: the line goes through the edges
    first = int(np.searchsorted(series.t_s, few["t"][0]))
    assert few["y"] == series.values[first : first + 502].tolist()
    many = shown.samples("brake.handle_torque_Nm", 0, 10)
    assert len(many["t"]) == 2 * PIECES < len(series)
    assert (min(many["y"]), max(many["y"])) == (series.values.min(), series.values.max())
    assert sorted(many["t"]) == many["t"]
    assert shown.samples("brake.nothing", 0, 1) is None
    assert shown.samples("motor.torque_Nm", 20, 30)["t"] == [series_end(shown)]


def series_end(shown):
    return float(shown.recording["motor.torque_Nm"].t_s[-1])


def test_values_at_a_time_are_the_last_ones_before(shown):
    assert shown.at(-1)["motor.statusword"] is None
    values = shown.at(2.0001)
    assert values["motor.statusword"] == 0x0237
    position = shown.recording["motor.position_rad"]
    assert values["motor.position_rad"] == position.values[1999]


def test_only_who_has_the_token_is_answered(shown):
    async def run():
        async with served(shown) as url:

            async def status(address):
                try:
                    return (await AsyncHTTPClient().fetch(address)).code
                except HTTPClientError as error:
                    return error.code

            assert await status(url) == 200
            assert await status(url + "recording") == 200
            assert await status(url + "samples?s=motor.torque_Nm&a=0&b=1") == 200
            assert await status(url + "samples?s=none&a=0&b=1") == 404
            for query in ("s=motor.torque_Nm&a=x&b=1", "s=motor.torque_Nm&a=nan&b=1", "a=0&b=1"):
                assert await status(url + "samples?" + query) == 400, query
            assert await status(url + "at?t=inf") == 400
            assert await status(url.replace(TOKEN, "b" * 32)) == 403
            assert await status(url + "static/page.py") == 404
            assert await status(url + "stop") == 403  # nothing is stopped from here

    asyncio.run(run())


def test_the_verb_wants_web_and_no_bus(path):
    done = CliRunner().invoke(main, ["watch", str(path)])
    assert done.exit_code == 2
    assert "--web" in done.output
    done = CliRunner().invoke(main, ["watch", str(path), "--web", "--bus", "coulombus:x"])
    assert done.exit_code == 2
    assert "choose one" in done.output


def test_the_verb_serves_until_its_time_is_over(path):
    words = ["watch", str(path), "--web", "--web-port", "0", "--seconds", "0.01", "--json"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0
    assert json.loads(done.stdout.splitlines()[0])["event"] == "ready"


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)")
@pytest.mark.parametrize("size", [(1280, 720), (390, 844)])
def test_cursor_zoom_and_choice_in_a_browser(tmp_path, shown, size):
    async def run():
        async with served(shown) as url, Browser(url, str(tmp_path / "profile"), size) as browser:
            await browser.until("plots.length === 2 && lines.size === 5 && one('cursor').textContent === '3.001 s'")
            assert await browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
            await browser.evaluate("setCursor(2.0001), 0")
            torque = "document.querySelector('output[data-name=\"brake.handle_torque_Nm\"]').textContent"
            value = shown.at(2.0001)["brake.handle_torque_Nm"]
            await browser.until(f"{torque} === '{value:.5g} Nm'")
            await browser.press("+", 187)
            await browser.until("one('shown').textContent === '1.000 s to 3.000 s'")
            await browser.until("lines.get('motor.torque_Nm').t[0] > 0.99")  # fetched anew, finer
            await browser.press("z", 90)
            await browser.until("times.recording.zoom === null")
            await browser.evaluate("action('choose:brake.coil_current_A').click()")
            await browser.until("plots.length === 3 && lines.get('brake.coil_current_A').t.length > 0")
            await browser.evaluate("document.querySelector('#marker-list button').click()")
            await browser.until("one('cursor').textContent === '3.001 s'")
            await browser.press("ArrowLeft", 37)
            await browser.until("one('cursor').textContent === '2.981 s'")
            assert await browser.evaluate("document.querySelectorAll('#incident-list li details').length") == 1
            assert browser.errors == []

    asyncio.run(run())
