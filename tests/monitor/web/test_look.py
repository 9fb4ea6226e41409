"""What a person needs of the page: contrast, room, the keyboard alone, zoom and freeze, a tab that
sleeps. In a headless Chromium, against a server in this process.
"""

import asyncio
import re

import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from chromium import CHROMIUM, Browser
from coulombus.recording.wall_clock import utc
from web_bench import BEGIN_NS, CONTRAST, MS, Door, going_on, page, served

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)"),
]


async def with_page(tmp_path, use, *, size=(1280, 720), dark=False, door=None, rig="bench", status=None):
    """Serve a page whose bus goes on, and let `use` look at it in a browser."""
    door = door or Door()
    shown = page(rig, door)
    async with (
        served(shown) as url,
        going_on(shown, lambda: door.status() | (status or {})),
        Browser(url, str(tmp_path / "profile"), size, dark) as browser,
    ):
        await browser.until("plots.length === 7 && action('set:F_s_Nm') && frames > 3")
        await use(browser, shown)
        assert browser.errors == []


@pytest.mark.thorough
@pytest.mark.parametrize("dark", [False, True])
def test_all_text_has_the_contrast_of_wcag_aa(tmp_path, dark):
    """Also of a trip, of what is stale or silent, and of controls that are disabled."""

    async def use(browser, shown):
        await browser.evaluate("say('something'), action('control').hidden = false")
        await browser.until("!one('trip').hidden && document.querySelector('#nodes tr')")
        await browser.evaluate(
            "document.querySelectorAll('#pdos tr')[1].className = 'stale', document.querySelector('#nodes tr').className = 'grave'"
        )
        for change in ("0", "document.querySelectorAll('button, input').forEach((e) => e.disabled = true)", "freeze()"):
            await browser.evaluate(f"{change}, 0")
            contrasts = await browser.evaluate(CONTRAST)
            assert len(contrasts) > 80
            wrong = [row for row in contrasts if row[1] < row[2] or row[3] < 11 or row[4] < 1]
            assert wrong == []
        await browser.evaluate("document.body.className = 'cut', 0")
        assert [row for row in await browser.evaluate(CONTRAST) if row[1] < row[2] or row[4] < 1] == []
        colours = "Object.values(colours).flat().every((one) => /^#[0-9a-f]{6}$/.test(one))"
        assert await browser.evaluate(colours)  # those of the canvases are the legends'

    asyncio.run(with_page(tmp_path, use, dark=dark, door=Door("123456"), status={"trip": "SPEED: too fast"}))


@pytest.mark.thorough
@pytest.mark.parametrize("size", [(1920, 1080), (1366, 768), (1280, 720), (768, 1024), (390, 844)])
def test_the_samples_at_a_trip_have_room_beside_the_last_ten_seconds(tmp_path, size):
    async def use(browser, shown):
        await browser.until("document.body.classList.contains('trip')")
        assert await browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
        widths = "plots.filter((p) => ['raw', 'envelope'].includes(p.kind)).map((p) => p.place.clientWidth)"
        assert min(await browser.evaluate(widths)) > 150
        assert await browser.evaluate("plots[0].place.querySelector('.legend').checkVisibility()")
        if size[0] == 1366:
            last = "document.querySelector('#pdos tr:last-child').getBoundingClientRect().bottom"
            assert await browser.evaluate(f"{last} <= document.querySelector('.pdos').getBoundingClientRect().bottom")
            assert await browser.evaluate("document.documentElement.scrollHeight <= innerHeight")

    trip = {"trip": "SPEED: too fast", "tripped": utc(BEGIN_NS + 300 * MS)}
    asyncio.run(with_page(tmp_path, use, size=size, status=trip))


@pytest.mark.thorough
@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (1024, 768), (768, 1024), (390, 844)])
def test_everything_has_room(tmp_path, size):
    """Nothing is beyond the window's side, nothing of the top, the tables and the parameters is cut
    off, and STOP is always in the window; with a long EMCY and many events, too.
    """

    async def use(browser, shown):
        t_ns = shown.capture.newest_ns
        heard = [(t_ns, 0x701, 1, b"\5" + bytes(7)), (t_ns, 0x702, 1, b"\x7f" + bytes(7))]
        emergency = bytes.fromhex("3081110000000000")
        shown.capture.add_frames([*heard, *((t_ns + k, 0x081 + k % 2, 8, emergency) for k in range(60))])
        await browser.until("one('power:brake').textContent.includes('heartbeat')")
        assert await browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
        if size == (1280, 720):
            assert await browser.evaluate("document.documentElement.scrollHeight <= innerHeight")
        cut_off = (
            "[...document.querySelectorAll('dd, button, .times h2, .times p, .legend, #sliders b, #live')]"
            ".filter((e) => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1 && e.clientWidth)"
            ".map((e) => e.dataset.signal || e.dataset.action || e.textContent)"
        )
        assert await browser.evaluate(cut_off) == []
        overlapping = (
            "plots.filter((p) => p.place.checkVisibility()).filter((p) => {"
            " const box = (name) => p.place.querySelector(name)?.getBoundingClientRect(), title = box('.title'), legend = box('.legend');"
            " const low = (legend || title).bottom - p.place.getBoundingClientRect().top;"
            " return (legend && title.bottom > legend.top + 1) || low > p.drawn.top - 4; }).map((p) => p.place.id)"
        )
        assert await browser.evaluate(overlapping) == []
        tables = "[...document.querySelectorAll('footer .table')].map((one) => one.scrollWidth - one.clientWidth)"
        assert await browser.evaluate(tables) == [0, 0, 0, 0]
        await browser.evaluate("scrollTo(0, 1e6), 0")
        stop = "(({top, bottom, height}) => top >= 0 && bottom <= innerHeight && height > 40)(action('stop').getBoundingClientRect())"
        assert await browser.evaluate(stop)
        drawn = "plots.filter((p) => p.place.checkVisibility()).every((p) => p.canvas.width > 100 && p.drawn.bottom - p.drawn.top > 40)"
        assert await browser.evaluate(drawn)

    asyncio.run(with_page(tmp_path, use, size=size))


@pytest.mark.thorough
def test_the_keyboard_alone_reaches_and_does_everything(tmp_path):
    door = Door()

    async def use(browser, shown):
        actions = await browser.evaluate(
            "[...document.querySelectorAll('button, input')].filter((e) => e.checkVisibility() && !e.disabled)"
            ".map((e) => e.dataset.action)"
        )
        assert {"stop", "freeze", "zoom-in", "undo", "mark:9", "set:F_s_Nm", "value:K_p_Nm_rad"} <= set(actions)
        reached = []
        for _ in range(len(actions) + 8):
            await browser.press("Tab", 9)
            name, ring = await browser.evaluate(
                "[document.activeElement.dataset.action || document.activeElement.ariaLabel,"
                " getComputedStyle(document.activeElement).outlineStyle]"
            )
            reached.append(name)
            assert ring == "solid" or name is None, name  # None: it has left the page
        assert set(actions) <= set(reached)
        await browser.evaluate("action('set:F_s_Nm').focus()")
        await browser.press("ArrowLeft", 37)
        await browser.until("one('said').textContent === 'set F_s_Nm 3.5 -> 3.48 Nm in 0.5 s'")
        await browser.evaluate("action('undo').focus()")
        await browser.press("Enter", 13, "\r")
        await browser.until("one('said').textContent.includes('3.48 -> 3.5 Nm')")
        await browser.evaluate("action('mark:4').focus()")
        await browser.press("Enter", 13, "\r")
        await browser.until("one('said').textContent === 'mark 4'")
        await browser.evaluate("action('value:F_s_Nm').focus()")
        await browser.press("Escape", 27)  # also in a field
        await browser.until("one('said').textContent.includes('stopped safely')")
        assert door.stops == 1

    asyncio.run(with_page(tmp_path, use, door=door))


@pytest.mark.thorough
def test_zoom_and_freeze(tmp_path):
    async def use(browser, shown):
        envelope = "plots.find((p) => p.kind === 'envelope')"
        await browser.until(f"{envelope}.drawn.x[0] === -10")
        await browser.press("+", 187)
        await browser.until(f"{envelope}.drawn.x.join() === '-5,0'")
        await browser.press("f", 70)
        assert await browser.evaluate("action('freeze').getAttribute('aria-pressed')") == "true"
        still = await browser.evaluate("frozen.nowBin")
        await browser.press("ArrowLeft", 37)
        await browser.until(f"{envelope}.drawn.x.join() === '-6.25,-1.25'")
        await browser.until(f"known.nowBin > {still} + 2")  # it goes on behind
        assert await browser.evaluate("frozen.nowBin") == still
        await browser.press("f", 70)
        assert await browser.evaluate("frozen") is None
        box = await browser.evaluate(f"(({{x, y}}) => [x, y])({envelope}.canvas.getBoundingClientRect())")
        at = {"x": box[0] + 150, "y": box[1] + 50}
        await browser.call("Input.dispatchMouseEvent", type="mouseWheel", **at, deltaX=0, deltaY=-100)
        await browser.until(f"{envelope}.drawn.x[1] - {envelope}.drawn.x[0] < 4.5")
        for kind, dx in (("mousePressed", 0), ("mouseMoved", 60), ("mouseReleased", 60)):
            here = {"x": at["x"] + dx, "y": at["y"] + dx / 3}
            await browser.call("Input.dispatchMouseEvent", type=kind, **here, button="left", buttons=1, clickCount=1)
        await browser.until(f"{envelope}.zoomY !== null && {envelope}.drawn.x[1] - {envelope}.drawn.x[0] < 1")
        await browser.press("z", 90)
        await browser.until(f"{envelope}.zoomY === null && {envelope}.drawn.x.join() === '-10,0'")

    asyncio.run(with_page(tmp_path, use))


@pytest.mark.thorough
def test_a_tab_that_sleeps_is_sent_nothing_and_misses_nothing(tmp_path):
    async def use(browser, shown):
        (session,) = shown.sessions
        await browser.call("Debugger.enable")
        await browser.call("Debugger.pause")  # no script of the page runs
        while session.flow.free:
            await asyncio.sleep(0.01)
        sent = session.flow.sent
        begun = shown.capture.newest_ns
        while shown.capture.newest_ns < begun + 1500 * MS:
            await asyncio.sleep(0.01)
        assert session.flow.sent <= sent + 1
        await browser.call("Debugger.resume")
        await browser.until("known.nowBin * 20 > " + str(shown.capture.newest_ns // MS))
        holes = (
            "(({low, newest}) => { let n = 0; for (let bin = newest - 100; bin < newest; bin++) n += isNaN(low[bin % BINS]); return n; })"
            "(known.envelopes.get('brake.handle_torque_Nm'))"
        )
        assert await browser.evaluate(holes) == 0

    asyncio.run(with_page(tmp_path, use))


@pytest.mark.thorough
@pytest.mark.parametrize("law", ["karnopp", "lugre"])
def test_each_parameter_and_each_signal_has_its_element(tmp_path, law):
    door = Door(overrides=(f"law.function='{law}'",), mode="active")

    async def use(browser, shown):
        rows = door.changes.rows()[0]
        assert {"karnopp": "K_p_Nm_rad", "lugre": "sigma_0_Nm_rad"}[law] in [row["name"] for row in rows]
        for row in rows:
            name = row["name"]
            bounds = await browser.evaluate(
                f"(({{min, max, step, type}}) => [Number(min), Number(max), Number(step), type])(action('set:{name}'))"
            )
            likely = 10 * row["value"] if row["high"] > 20 * row["value"] > 0 else row["high"]
            assert bounds == [row["low"], pytest.approx(likely), row["step"], "range"], name
            assert (likely - row["low"]) / row["step"] >= 100
            assert await browser.evaluate(f"action('value:{name}').inputMode") == "decimal"  # the host judges it
            assert float(await browser.text(f"set:{name}")) == pytest.approx(row["now"], rel=1e-3)
        for pdo in shown.capture.rig.pdos():
            for signal in pdo.signals:
                assert await browser.text(signal.name) not in (None, "-"), signal.name
        for name in ("motor.RPDO1", "motor.TPDO1", "brake.RPDO1", "brake.TPDO1"):
            assert [await browser.text(f"{what}:{name}") for what in ("rate", "jitter")] == ["1000", "0.00"]
            assert re.fullmatch(r"([0-9A-F]{2} ?)+", await browser.text(f"raw:{name}"))
        assert await browser.text("bits:motor.position_rad") == "16-47"
        assert await browser.text("meaning:motor.statusword") == "operation enabled; remote"
        assert (await browser.text("subject"), await browser.text("trial")) == ("S01", "7")
        bars = await browser.evaluate("document.querySelector('#wakeup-histogram .bars').getAttribute('d')")
        assert bars.count("M") == 4

    asyncio.run(with_page(tmp_path, use, door=door))
