"""The page in a headless Chromium, against a server in this process; there is no bus."""

import asyncio

import pytest

from coulombus.wire.frame import Frame

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from chromium import CHROMIUM, Browser
from coulombus.kernels.records import new_records
from coulombus.monitor.web.reader import CurveReader
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import read
from coulombus.wire.frame import data_word
from web_bench import BEGIN_NS, MS, Door, cycles, page, served

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)"),
]


def recorded(path, frames, rig):
    table = new_records(Frame, len(frames))
    table[:] = [(t_ns, can_id, length, data_word(data[:length]), 0) for t_ns, can_id, length, data in frames]
    with PcapngWriter(
        path, attachments={"rig.toml": rig.effective().encode()} | {n: t.encode() for n, t in rig.eds_texts.items()}
    ) as writer:
        writer.write(table)
    return read(path)


def test_the_page_shows_the_bus_stops_the_host_and_comes_back(tmp_path):
    door = Door()

    async def run():
        shown = page(door=door)
        frames = cycles(0, 400)
        shown.capture.add_frames(frames)
        recording = recorded(tmp_path / "run.pcapng", frames, shown.capture.rig)
        async with served(shown) as url:
            ticking = asyncio.create_task(tick(shown))
            async with Browser(url, str(tmp_path / "profile")) as browser:
                await browser.until(
                    "plots.length === 7 && document.querySelector('[data-signal=\"motor.position_rad\"]')"
                )
                for name in ("motor.position_rad", "brake.handle_torque_Nm", "motor.torque_Nm", "brake.setpoint_Nm"):
                    assert float(await browser.text(name)) == pytest.approx(recording[name].values[-1], abs=6e-6), name
                    raw = await browser.evaluate(f"Array.from(known.raw.get('{name}')[1])")
                    assert raw == pytest.approx(recording[name].values[-len(raw) :], rel=1e-6)
                assert await browser.text("arm") == "armed"
                assert (await browser.text("mode"), await browser.text("phase")) == ("hybrid", "running")
                await browser.press("f", 70)
                assert await browser.evaluate("action('freeze').getAttribute('aria-pressed')") == "true"
                await browser.press("Escape", 27)
                await browser.until("one('said').textContent.includes('stopped safely')")
                assert door.stops == 1
                await browser.evaluate("action('stop').click()")
                while door.stops < 2:
                    await asyncio.sleep(0.01)

                async with Browser(url, str(tmp_path / "second")) as other:
                    await other.until("one('role').textContent === 'viewing'")
                    await other.evaluate("action('control').click()")
                    await other.until("one('said').textContent.includes('another page is in control')")

                port = int(url.split(":")[2].split("/")[0])
                hosts = {
                    address.partition("://")[2].partition("/")[0] for address in browser.requested if "://" in address
                }
                assert hosts == {f"127.0.0.1:{port}"}  # nothing comes from anywhere else
                assert browser.errors == []
                await gone_and_back(shown, port, browser, ticking)

    async def gone_and_back(shown, port, browser, ticking):
        for session in list(shown.sessions):
            session.close()
        await browser.until("cut")
        await browser.until("!cut && one('said').hidden")
        ticking.cancel()

    asyncio.run(run())


def moved(name, value):
    """What a script does that moves a slider."""
    place = f"action('{name}')"
    return f"{place}.value = {value}, {place}.dispatchEvent(new Event('change'))"


def typed(name, text):
    """What a script does that types into a field and leaves it."""
    return moved(name, repr(text))


@pytest.mark.thorough
def test_sliders_change_parameters_and_keys_mark(tmp_path):
    door = Door(arm_key="004711")

    async def run():
        shown = page(door=door)
        shown.capture.add_frames(cycles(0, 400))
        async with served(shown) as url:
            ticking = asyncio.create_task(tick(shown, door))
            async with Browser(url, str(tmp_path / "profile")) as browser:
                await browser.until("action('set:F_s_Nm') && !action('set:F_s_Nm').disabled")
                slider = "['min', 'max', 'value'].map((name) => Number(action('set:F_s_Nm')[name]))"
                assert await browser.evaluate(slider) == [0, 4.5, 3.5]
                assert await browser.evaluate("Number(action('set:K_p_Nm_rad').max)") == 1e5  # ten times the value
                assert await browser.text("set:F_s_Nm") == "3.5"
                assert await browser.text("wakeup_us") == "12 / 40 / 95 us"

                await browser.evaluate(moved("set:F_s_Nm", 3.2))
                await browser.until("one('said').textContent.includes('a change needs the arm key')")
                await browser.until("Number(action('set:F_s_Nm').value) === 3.5")  # as it was: nothing is changed
                await browser.evaluate("action('arm-key').value = '004711'")
                await browser.evaluate(moved("set:F_s_Nm", 3.2))
                await browser.until("one('said').textContent === 'set F_s_Nm 3.5 -> 3.2 Nm in 0.5 s'")
                door.controllers.axes["law"]["F_s"] = 3.25  # on its way
                await browser.until(
                    "Math.abs(Math.max(...known.law.f) - 3.25) < 1e-9 && one('set:F_s_Nm').textContent === '3.25'"
                )
                await browser.evaluate(moved("value:K_p_Nm_rad", 250000))
                await browser.until("one('said').textContent.includes('K_p_Nm_rad 10000 -> 250000')")
                await browser.until("Number(action('set:K_p_Nm_rad').max) === 2.5e6")
                for spelled in ("0,3", "0.3", " 3e-1 "):  # a field of type number made 3 of the first
                    await browser.evaluate(typed("value:F_d_Nm", spelled))
                    await browser.until("one('said').textContent.includes('F_d_Nm 3 -> 0.3 Nm')")
                    await browser.evaluate("action('undo').click()")
                    await browser.until("one('said').textContent.includes('F_d_Nm 0.3 -> 3 Nm')")
                orders = len(door.orders)
                for nonsense in ("1.234,5", "0,3,4", "3 Nm", "", "0x3", "Infinity"):
                    await browser.evaluate(typed("value:F_d_Nm", nonsense))
                assert await browser.evaluate("action('value:F_d_Nm').validationMessage") == (
                    "Infinity: expected a number, as 0.3"
                )
                assert len(door.orders) == orders
                await browser.evaluate("document.activeElement.blur()")  # the field that is wrong has the focus
                await browser.evaluate(moved("set:F_d_Nm", 4.4))
                await browser.until("one('said').textContent.includes('expected F_d_Nm at most F_s_Nm')")
                for _ in range(2):
                    await browser.evaluate("action('undo').click()")
                await browser.until("Number(action('value:F_s_Nm').value) === 3.5")
                assert [sorted(order) for order in door.orders[-2:]] == [["axis", "key", "undo"]] * 2

                await browser.press("3", 51)
                await browser.until("one('said').textContent === 'mark 3'")
                await browser.evaluate("action('value:F_s_Nm').focus()")
                await browser.press("4", 52)  # typed into a field
                orders = len(door.orders)
                async with Browser(url, str(tmp_path / "second")) as other:
                    await other.until("action('set:F_s_Nm') && action('set:F_s_Nm').disabled")
                    await other.evaluate(moved("set:F_s_Nm", 3.3))
                    await other.until("one('said').textContent.includes('this page is viewing')")
                    await other.press("5", 53)
                    await other.until("one('said').textContent.startsWith('mark 5: this page is viewing')")
                assert (door.marks, len(door.orders)) == (["3"], orders)
                assert browser.errors == []
            ticking.cancel()

    asyncio.run(run())


async def tick(shown, door=None):
    k = 0
    rig = shown.capture.rig
    reader = CurveReader(shown.door, shown.host, rig, shown.lock)
    shown.curves = reader.curves
    while True:
        if door is not None:
            with shown.lock:
                shown.host.update(door.status())
            reader.make(rig.one_axis(), shown.host.mode, shown.host.live(""))
        shown.tick(BEGIN_NS + (400 + 120 * k) * MS)
        k += 1
        await asyncio.sleep(0.033)
