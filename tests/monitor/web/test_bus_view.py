"""The simulated bus in the page: a click breaks a node or the cable, a further click repairs it. Against a server in
this process, whose faults are only noted.
"""

import asyncio

import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")


from chromium import CHROMIUM, Browser
from coulombus.cli.page_options import LOOPBACK, PageOptions, _fault_door
from coulombus.monitor.live_incidents import IncidentRow
from coulombus.monitor.web.page import fault_of
from coulombus.monitor.web.reader import FaultReader
from coulombus.wire.address import BusUnavailable, parse_address
from web_bench import BEGIN_NS, CONTRAST, MS, Door, Faults, answer_of, going_on, page, served, socket_of

BREAK_BRAKE = 'inject {"fault": "power_off", "on": "brake"}'
in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)")


def breakable(faults, door=None):
    shown = page(door=door)
    shown.faults, shown.fault_state = faults.door, faults.state
    return shown


def test_the_page_in_control_breaks_and_repairs_and_is_told_why_not():
    faults = Faults()

    async def run():
        shown = breakable(faults)
        async with served(shown) as url:
            first = await socket_of(url)
            assert await answer_of(shown, first, BREAK_BRAKE, 1) == "inject power_off on brake"
            assert faults.acting == [("power_off", "brake")]
            unknown = 'inject {"fault": "fire", "on": "brake"}'
            assert await answer_of(shown, first, unknown, 2) == "not broken: there is no fault 'fire'"
            clear = 'clear {"fault": "", "on": "brake"}'
            assert await answer_of(shown, first, clear, 3) == "clear power_off on brake"
            assert faults.acting == []
            first.close()

    asyncio.run(run())


def test_a_page_that_only_views_breaks_nothing():
    faults = Faults()

    async def run():
        shown = breakable(faults)
        async with served(shown) as url:
            first, second = await socket_of(url), await socket_of(url)
            answer = await answer_of(shown, second, BREAK_BRAKE, 1)
            assert answer == "not broken: this page is viewing; take control first"
            assert faults.acting == []
            first.close()
            second.close()

    asyncio.run(run())


@pytest.mark.parametrize(
    "message",
    [
        *("inject", "inject {", "inject []", 'inject {"fault": "noise"}', 'inject {"fault": 3, "on": "bus"}'),
        *('inject {"fault": "noise", "on": "bus", "for_s": 1}', 'break {"fault": "noise", "on": "bus"}', "clear {}"),
    ],
)
def test_what_names_no_fault_and_place_is_none(message):
    assert fault_of(message) is None


def test_a_bus_without_simulated_nodes_has_no_faults():
    faults = Faults()
    reader = FaultReader(faults.door, lambda: True)
    reader.read(faults.door)
    assert [node["name"] for node in reader.state["nodes"]] == ["motor", "brake"]
    faults.state = None  # as when the process of the nodes has ended
    reader.read(type(faults.door)(lambda: faults.state(), faults.inject, faults.clear, {}))
    assert reader.state is None


@pytest.mark.parametrize(
    ("bus", "host", "breaks"),
    [
        *(("coulombus:nowhere", LOOPBACK, True), ("coulombus:nowhere", "0.0.0.0", False)),
        ("socketcan:can0", LOOPBACK, False),
    ],
)
def test_only_a_virtual_bus_on_a_page_of_the_loopback_can_be_broken(bus, host, breaks):
    door = _fault_door(parse_address(bus), PageOptions(True, 0, host))
    assert (door is not None) == breaks
    if door is not None:
        with pytest.raises(BusUnavailable, match="no simulated node is on bus coulombus:nowhere"):
            door.inject("power_off", "brake")


def incident(number, begin_ms):
    times = {"begin_ns": BEGIN_NS + begin_ms * MS, "end_ns": None}
    return IncidentRow(
        number, f"key-{number}", "unresolved", f"incident {number}", **times, cause="", sure="", checks=(), course=()
    )


async def with_bus(tmp_path, use, faults, *, size=(1366, 768), dark=False, place="#bus", incidents=()):
    """Serve a page whose bus goes on and can be broken, and look at it."""
    door = Door()
    shown = breakable(faults, door)
    shown.incidents = lambda: incidents
    async with (
        served(shown) as url,
        going_on(shown, door.status),
        Browser(url + place, str(tmp_path / "profile"), size, dark) as browser,
    ):
        await browser.until("!action('bus').hidden && frames > 3")
        await use(browser, door)
        assert browser.errors == []


@pytest.mark.slow
@in_a_browser
def test_a_click_breaks_a_node_and_a_further_click_repairs_it(tmp_path):
    faults = Faults()

    async def use(browser, door):
        await browser.until("action('node:brake') && !action('node:brake').disabled")
        await browser.evaluate("action('node:brake').click()")
        await browser.evaluate("action('fault:power_off').click()")
        await browser.until("one('acts:brake').textContent === 'power_off'")
        assert faults.acting == [("power_off", "brake")]
        assert "no supply" in await browser.text("bus:brake")
        faults.inject("noise", "bus")  # as by the verb
        await browser.until("action('cable:motor').classList.contains('broken') && one('acting').textContent === '2'")
        assert "noise on bus, since 2 s" in await browser.evaluate("document.getElementById('acting-list').textContent")
        await browser.evaluate("action('node:brake').click()")
        await browser.until("one('acts:brake').textContent === ''")
        await browser.evaluate("action('cable:brake').click()")
        await browser.until("one('acting').textContent === 'none'")
        await browser.evaluate("action('cable:brake').click(), action('fault:cut').click()")
        await browser.until("action('cable:brake').classList.contains('cut')")
        assert faults.acting == [("cut", "brake")]
        await browser.evaluate("action('repair-all').click()")
        await browser.until("action('repair-all').hidden")
        assert faults.acting == []

    asyncio.run(with_bus(tmp_path, use, faults))


@pytest.mark.thorough
@pytest.mark.slow
@in_a_browser
def test_the_keyboard_alone_breaks_a_node_and_escape_closes_its_faults_first(tmp_path):
    faults = Faults()

    async def use(browser, door):
        await browser.until("action('node:motor') && !action('node:motor').disabled")
        spoken = await browser.evaluate("action('node:motor').getAttribute('aria-label')")
        assert spoken.startswith("motor, node 1: ")
        await browser.evaluate("action('cable:motor').focus()")
        await browser.press("Tab", 9)
        assert await browser.evaluate("document.activeElement.dataset.action") == "node:motor"
        await browser.press("Enter", 13, "\r")
        await browser.until("document.activeElement.dataset.action === 'fault:power_off'")
        await browser.press("Escape", 27)
        await browser.until("!document.body.classList.contains('choosing')")
        assert await browser.evaluate("document.activeElement.dataset.action") == "node:motor"
        assert (door.stops, faults.acting) == (0, [])
        await browser.press("Enter", 13, "\r")
        await browser.until("document.activeElement.dataset.action === 'fault:power_off'")
        await browser.press("ArrowDown", 40)
        await browser.press("Enter", 13, "\r")
        await browser.until("one('acts:motor').textContent === 'cut'")
        await browser.press("Escape", 27)
        await browser.until("one('said').textContent.includes('stopped safely')")
        assert door.stops == 1

    asyncio.run(with_bus(tmp_path, use, faults))


@pytest.mark.thorough
@pytest.mark.slow
@in_a_browser
@pytest.mark.parametrize(("size", "dark"), [((1366, 768), False), ((1366, 768), True), ((400, 800), False)])
def test_the_bus_has_room_and_contrast(tmp_path, size, dark):
    faults = Faults()
    faults.acting = [("power_off", "brake"), ("noise", "bus"), ("cut", "motor")]

    async def use(browser, door):
        await browser.until("one('acts:brake') && one('acts:brake').textContent")
        assert await browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
        await browser.evaluate("listFaults(action('node:motor'), spots.get(action('node:motor')))")
        inside = "(({left, right}) => left >= 0 && right <= innerWidth)(document.getElementById('faults').getBoundingClientRect())"
        assert await browser.evaluate(inside)
        assert await browser.evaluate("document.querySelectorAll('#faults button').length") == 1  # `cut` acts
        text = [row for row in await browser.evaluate(CONTRAST) if not row[0].endswith("border")]
        assert [row for row in text if row[1] < row[2] or row[3] < 11 or row[4] < 1] == []

    asyncio.run(with_bus(tmp_path, use, faults, size=size, dark=dark))


@pytest.mark.thorough
@pytest.mark.slow
@in_a_browser
def test_the_newest_incident_is_first_and_open_beside_the_bus(tmp_path):
    incidents = [incident(1, 5), incident(2, 300)]
    shown = "[...document.querySelectorAll('#incident-list > li')].map((e) => [e.dataset.key, e.firstChild.open])"

    async def use(browser, door):
        await browser.until("document.querySelector('#incident-list details[open]')")
        assert await browser.evaluate(shown) == [["key-2", True], ["key-1", False]]
        incidents.append(incident(3, 350))
        await browser.until("document.querySelectorAll('#incident-list > li').length === 3")
        assert await browser.evaluate(shown) == [["key-3", True], ["key-2", False], ["key-1", False]]

    asyncio.run(with_bus(tmp_path, use, Faults(), incidents=incidents))


@pytest.mark.thorough
@pytest.mark.slow
@in_a_browser
def test_the_plots_are_there_without_the_bus_in_the_address(tmp_path):
    async def use(browser, door):
        assert not await browser.evaluate("document.getElementById('bus').checkVisibility()")
        await browser.press("b", 66)
        await browser.until("document.getElementById('bus').checkVisibility() && location.hash === '#bus'")
        await browser.press("b", 66)
        await browser.until("plots[0].place.clientWidth > 0")

    asyncio.run(with_bus(tmp_path, use, Faults(), place=""))
