"""How the page tells what went wrong, and how a run ended; in a headless Chromium, without a bus."""

import asyncio
import struct
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from chromium import CHROMIUM, Browser
from coulombus.monitor.live_incidents import IncidentReader
from coulombus.monitor.web import WebError
from coulombus.monitor.web.last_page import LastPage
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.recording.wall_clock import utc
from web_bench import BEGIN_NS, MS, TOKEN, Door, cycles, page, served

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)"),
]
WORD = {
    "mode": "hybrid",
    "cycles": 7,
    "trip": None,
    "stopped_by": "coulombus stop",
    "ended": "2026-11-27T10:31:02.000000Z",
    "lost_pdos": 95,
    "missed_deadlines": 431,
}


class Scene:
    """A page, its host and its bus, which a test changes while a browser looks."""

    def __init__(self, word=None):
        self.door, self.k, self.status, self.extra, self.armed = Door(), 400, {}, [], True
        self.word = word
        self.door.door = replace(
            self.door.door, last=lambda: self.word, entry=lambda trip: f"Why.\n\n1. Check it. {trip}\n2. More."
        )
        self.page = page(door=self.door)
        self.incidents = IncidentReader(KnownBus(self.page.capture.rig))
        self.page.incidents = lambda: self.incidents.rows
        self._take(cycles(0, 400))

    def _take(self, frames):
        if not self.armed:
            frames = [f for f in frames if f[1] != 0x181]
            frames += [(BEGIN_NS + self.k * MS, 0x181, 8, struct.pack("<Hih", 0x0250, 0, 0))]
        self.page.capture.add_frames(frames)
        self.incidents.add_frames(frames)

    async def going_on(self):
        while True:
            with self.page.lock:
                extra, self.extra = self.extra, []
                self._take([*cycles(self.k, 33), *((BEGIN_NS + self.k * MS, *frame) for frame in extra)])
                self.k += 33
                self.incidents.update(BEGIN_NS + self.k * MS)
                ended = self.status is None
                self.page.host.update(None if ended else self.door.status() | self.status, self.word if ended else None)
            self.page.tick(BEGIN_NS + self.k * MS)
            await asyncio.sleep(0.02)


def shown(tmp_path, use, **options):
    async def run():
        scene = Scene(**options)
        async with served(scene.page) as url:
            task = asyncio.create_task(scene.going_on())
            async with Browser(url, str(tmp_path / "profile")) as browser:
                await browser.until("plots.length === 7 && frames > 3 && one('mode').textContent !== '-'")
                await use(browser, scene)
                assert browser.errors == []
            task.cancel()

    asyncio.run(run())


VISIBLE = "document.getElementById('{}').checkVisibility()"


RAW = "Array.from(frozen.raw.get('motor.position_rad')[{}])"


def test_a_trip_shows_its_first_step_and_each_sample_around_it(tmp_path):
    async def use(browser, scene):
        assert not await browser.evaluate(VISIBLE.format("trip"))
        trip_ns = BEGIN_NS + scene.k * MS
        scene.status = {"trip": "SPEED: too fast", "tripped": utc(trip_ns)}
        await browser.until("one('trip').textContent.endsWith(': SPEED: too fast')")
        assert await browser.text("step") == "First: Check it. SPEED: too fast"
        await browser.evaluate("action('runbook').click()")
        assert await browser.evaluate("one('entry').checkVisibility()")
        await browser.until("frozen !== null")
        assert await browser.evaluate("action('freeze').getAttribute('aria-pressed')") == "true"
        times, values = [await browser.evaluate(RAW.format(row)) for row in (0, 1)]
        assert len(times) >= 600
        assert (times[0], times[-1]) == (pytest.approx(-0.4998, abs=2e-3), pytest.approx(0.2, abs=2e-3))
        assert np.diff(times) == pytest.approx(1e-3, abs=1e-6)  # full rate
        track = scene.page.capture.track("motor.position_rad")
        _, angles = track.since(trip_ns + round(times[0] * 1e9) - 1000)
        assert values == pytest.approx(angles[: len(values)], rel=1e-5)
        await browser.press("f", 70)
        await browser.until("known.nowBin > 60 && frozen === null && times.raw.all[1] === 0")
        assert not await browser.evaluate("document.body.classList.contains('trip')")

    shown(tmp_path, use)


@pytest.mark.thorough
def test_the_page_of_a_trip_is_served_again_without_bus_and_host(tmp_path):
    kept = []

    async def use(browser, scene):
        scene.door.door = replace(scene.door.door, keep=kept.append)
        scene.page.door = scene.door.door
        tripped = utc(BEGIN_NS + scene.k * MS)
        scene.word = WORD | {"trip": "SPEED: too fast", "tripped": tripped}
        scene.status = None
        await browser.until("frozen !== null")
        seen = [await browser.evaluate(RAW.format(row)) for row in (0, 1)]
        last = LastPage.from_file(kept[-1], TOKEN)
        async with served(last) as url, Browser(url, str(tmp_path / "later")) as later:
            await later.until("plots.length === 7 && frozen !== null")
            assert [await later.evaluate(RAW.format(row)) for row in (0, 1)] == seen
            assert (await later.text("trip")).endswith(": SPEED: too fast")
            assert (await later.text("mode"), await later.text("lost_pdos")) == ("hybrid", "95")
            await later.press("Escape", 27)
            await later.until("one('said').textContent.startsWith('STOP: no host runs here')")

    shown(tmp_path, use)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b'{"rig": "bench", "axes": {}}',
        b'{"rig": 1, "axes": {"": {"layout": {}, "batches": ["AAA"]}}}',
    ],
)
def test_a_kept_page_that_is_damaged_is_refused(content):
    with pytest.raises(WebError, match="the page of the last trip cannot be read"):
        LastPage.from_file(content, TOKEN)


@pytest.mark.thorough
def test_an_orderly_end_is_told_without_alarm_with_the_hosts_counts(tmp_path):
    async def use(browser, scene):
        assert await browser.text("lost_pdos") == "-"
        scene.word, scene.status = WORD, None
        await browser.until("one('end').textContent.includes('stopped by coulombus stop. Start it again:')")
        assert await browser.evaluate("document.getElementById('end').className") == ""
        assert not await browser.evaluate(VISIBLE.format("trip"))
        counts = [await browser.text(name) for name in ("lost", "lost_pdos", "missed")]
        assert counts == ["0", "95", "431"]
        assert await browser.evaluate("document.body.classList.contains('ended')")
        assert await browser.text("mode") == "hybrid"  # the last one, greyed
        await browser.call("Browser.grantPermissions", permissions=["clipboardReadWrite"])
        await browser.evaluate("action('copy').click()")
        await browser.until("one('said').textContent.startsWith('cop') || one('said').textContent.includes('selected')")
        scene.word, scene.status = None, {}
        await browser.until("!document.getElementById('end').checkVisibility()")
        scene.status = None
        await browser.until("document.getElementById('end').className === 'lost'")
        assert "left no word" in await browser.text("end")

    shown(tmp_path, use)


@pytest.mark.thorough
def test_no_host_yet_shows_the_command_that_starts_one(tmp_path):
    async def use(browser, scene):
        scene.page.host.__init__()
        scene.status = None
        await browser.until(VISIBLE.format("end"))
        assert (await browser.text("end")).startswith("No host runs on this bus")
        assert await browser.text("start") == "coulombus run"
        assert await browser.text("mode") == "no host"

    shown(tmp_path, use)


def test_stop_is_green_when_the_drive_says_that_it_is_disarmed(tmp_path):
    async def use(browser, scene):
        await browser.press("Escape", 27)
        await browser.until("one('said').textContent === 'the host stopped safely; the drive has not said so yet'")
        assert await browser.evaluate("one('said').className") == "busy"
        scene.armed = False
        await browser.until("one('said').className === 'good'")
        assert await browser.evaluate(
            "/^stopped safely, [0-9]+\\.[0-9] s: the drive is disarmed$/.test(one('said').textContent)"
        )
        assert await browser.text("drives") == "switch on disabled"

    shown(tmp_path, use)


@pytest.mark.thorough
def test_the_list_of_incidents_follows_and_opens(tmp_path):
    async def use(browser, scene):
        assert await browser.text("incidents") == "none"
        scene.extra = [(0x081, 8, bytes.fromhex("1042010000000000"))]
        await browser.until("one('incidents').textContent === '1, 1 unresolved'")
        await browser.evaluate("document.querySelector('#incident-list summary').click()")
        assert await browser.evaluate("document.querySelectorAll('#incident-list .checks li').length") == 3
        scene.extra = [(0x081, 8, bytes(8))]
        await browser.until("document.querySelector('#incident-list > li').className === 'recovered'")
        assert await browser.evaluate("document.querySelector('#incident-list details').open")  # it stays open

    shown(tmp_path, use)


@pytest.mark.thorough
def test_a_line_is_hidden_and_shown_by_its_name(tmp_path):
    async def use(browser, scene):
        torque = "plots.find((p) => p.row.signals.length === 4)"
        points = f"{torque}.lines(known).map(([x]) => x.length > 0)"
        assert await browser.evaluate(points) == [True] * 4
        await browser.evaluate("action('show:brake.setpoint_Nm').click()")
        assert await browser.evaluate(points) == [True, False, True, True]
        await browser.evaluate("action('show:brake.setpoint_Nm').click()")
        assert await browser.evaluate(points) == [True] * 4

    shown(tmp_path, use)


@pytest.mark.thorough
def test_the_server_says_goodbye_with_the_last_word(tmp_path):
    async def use(browser, scene):
        scene.word = WORD | {"trip": "SPEED: too fast"}
        scene.page.door = scene.door.door
        await scene.page.say_goodbye(BEGIN_NS + scene.k * MS)
        await browser.until("cut")
        assert await browser.text("said") == "The run is over, and the page's server with it. This is the last state."
        assert "SPEED: too fast" in await browser.text("trip")
        assert await browser.evaluate("one('said').className") == ""

    shown(tmp_path, use)
