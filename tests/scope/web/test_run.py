"""``run --web`` and ``sim --web`` in real time: a hand at the sliders, a browser that is lost, STOP, and
a replay of it all.
"""

import asyncio
import re

import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install 'coulombus[web]'")

from chromium import CHROMIUM, Browser
from coulombus.host.run.control_socket import ask_status
from coulombus.lab.replay.host_replay import host_replay
from coulombus.recording.signals import read
from coulombus.wire.address import parse_address
from real_bench import PATIENCE_S, end, result, simulation, start

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)"),
]
BUS = "coulombus:page-run"
LENIENT = ("limits.missed_tpdo_cycles=1000",)


def address_of(process):
    """Return the page's address, which a process tells on stderr."""
    for line in process.stderr:
        if found := re.search(r"page: (http://\S+)", line):
            return found[1]
    raise AssertionError("the page was not served")


async def at_the_sliders(url, directory):
    async with Browser(url, str(directory / "first")) as browser:
        await browser.until("one('phase').textContent === 'running' && !action('set:F_s_Nm').disabled", PATIENCE_S)
        await browser.evaluate(
            "action('set:F_s_Nm').value = 3.2, action('set:F_s_Nm').dispatchEvent(new Event('change'))"
        )
        await browser.until("one('said').textContent === 'set F_s_Nm 3.5 -> 3.2 Nm in 0.5 s'")
        await browser.until("one('set:F_s_Nm').textContent === '3.2' && Math.max(...known.law.f) === 3.2")
        await browser.press("3", 51)
        await browser.until("one('said').textContent === 'mark 3'")
        await browser.evaluate("action('undo').click()")
        await browser.until("one('set:F_s_Nm').textContent === '3.5'")
        assert (await browser.text("subject"), await browser.text("trial")) == ("S01", "7")
        assert await browser.evaluate("document.querySelector('#wakeup-histogram .bars').getAttribute('d').length > 20")
        assert browser.errors == []
    # killed: the browser is lost


async def stop(url, directory):
    async with Browser(url, str(directory / "second")) as browser:
        await browser.until("one('role').textContent === 'control' && one('arm').textContent === 'armed'", PATIENCE_S)
        await browser.press("Escape", 27)
        await browser.until("one('said').textContent.includes('the host stopped safely')", PATIENCE_S)


def test_a_hand_at_the_sliders_and_stop_from_the_page(tmp_path):
    recording, address = tmp_path / "r.pcapng", parse_address(BUS)
    with simulation(BUS, overrides=LENIENT):
        words = ("--bus", BUS, "--mode", "hybrid", "--json", "--record", recording, "--web", "--web-port", "0")
        meta = ("--meta", "subject=S01", "--meta", "trial=7")
        process = start("run", *words, *meta, overrides=LENIENT)
        try:
            url = address_of(process)
            asyncio.run(at_the_sliders(url, tmp_path))
            before = ask_status(address)
            asyncio.run(stop(url, tmp_path))
            told = result(process)
        finally:
            end(process)
    assert told["trip"] is None
    assert told["cycles"] > before["cycles"] > 100  # it went on without the browser
    markers = [text.partition(" [")[0] for _, text in read(recording).markers]
    for text in ("set F_s_Nm 3.5 -> 3.2 Nm in 0.5 s", "mark 3", "set F_s_Nm 3.2 -> 3.5 Nm in 0.5 s (undo)"):
        assert text in markers
    replayed = host_replay(recording)
    assert (replayed.difference, replayed.exit_status) == (None, 0)


def test_sim_serves_the_page_beside_it(tmp_path):
    with simulation(BUS, "--web", "--web-port", "0") as process:
        url = address_of(process)

        async def look():
            async with Browser(url, str(tmp_path / "profile")) as browser:
                await browser.until("frames > 5 && one('mode').textContent === 'no host'", PATIENCE_S)
                await browser.until("one('state:motor').textContent === 'pre-operational'")
                await browser.press("Escape", 27)
                await browser.until("one('said').textContent.includes('no host runs on bus')")
                assert browser.errors == []

        asyncio.run(look())
        assert process.poll() is None
