"""The tip of an arm on the page: from the joints' PDOs to path, speed and force, and the law's ring."""

from __future__ import annotations

import asyncio
import math
import struct

import numpy as np
import pytest

pytest.importorskip("tornado", reason="the page needs Tornado: pip install -e '.[web]'")

from chromium import CHROMIUM, Browser
from coulombus.host.run.law_curve import DIRECTIONS, law_ring
from coulombus.monitor.web.batch import Flow, batch, unpacked
from coulombus.monitor.web.capture import LiveCapture
from coulombus.monitor.web.page_state import HostView
from coulombus.monitor.web.tip import tip_track
from coulombus.rigs.rig import load_rig
from web_bench import BEGIN_NS, Door, page, served

MS = 1_000_000
PERIOD_NS = 2 * MS
OPAQUE = """(() => {
  const {canvas, drawn} = plots[6], data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  const at = ([x, y]) => data[4 * (Math.round(drawn.py(y)) * canvas.width + Math.round(drawn.px(x))) + 3];
  return [known.arm[0], known.arm[2]].map(at);
})()"""
"""What the canvas has at the base and at the tip."""
RADIUS_M, TURN_S = 0.05, 2.0
FORCE_N = 3.0


def counts_rad(rig):
    (pdo,) = (pdo for pdo in rig.pdos() if pdo.name == "TPDO1" and pdo.signals[0].name == "shoulder.motor.statusword")
    return pdo.signals[1].scale


def angles(x, y, l1=0.2, l2=0.2):
    """Return the joints' angles that bring the tip there, the elbow to the right [rad]."""
    elbow = math.acos((x * x + y * y - l1 * l1 - l2 * l2) / (2 * l1 * l2))
    return math.atan2(y, x) - math.atan2(l2 * math.sin(elbow), l1 + l2 * math.cos(elbow)), elbow


def frames_of_a_circle(rig, first=0, count=1500, still=False):
    """Return frames of a tip that circles about (0.23, 0) against the clock, against 3 N of friction."""
    scale, start, frames = counts_rad(rig), rig.kinematics.start_rad, []
    for k in range(first, first + count):
        t_ns = BEGIN_NS + k * PERIOD_NS
        turn = 0.0 if still else 2 * math.pi * k * PERIOD_NS * 1e-9 / TURN_S
        x, y = 0.23 + RADIUS_M * math.cos(turn), RADIUS_M * math.sin(turn)
        q = angles(x, y)
        both = q[0] + q[1]
        x2, y2 = 0.2 * math.cos(both), 0.2 * math.sin(both)
        hand = -FORCE_N * math.sin(turn), FORCE_N * math.cos(turn)
        torque = (-y * hand[0] + x * hand[1], -y2 * hand[0] + x2 * hand[1])
        for i in range(2):
            raw = round((q[i] - start[i]) / scale)
            frames.append((t_ns + 300_000 + i, 0x181 + 2 * i, 8, struct.pack("<Hih", 0x0237, raw, 0)))
            data = struct.pack("<hhh", round(1000 * torque[i]), 0, 220)
            frames.append((t_ns + 400_000 + i, 0x182 + 2 * i, 6, data.ljust(8, b"\0")))
    return frames


def capture_of(rig, frames):
    capture = LiveCapture(rig)
    capture.snapshot(BEGIN_NS)
    capture.add_frames(frames)
    return capture


@pytest.fixture(scope="module")
def rig():
    return load_rig("plane")


def test_the_tip_is_where_the_joints_are_and_the_hand_is_resisted(rig):
    frames, kept = frames_of_a_circle(rig), []
    capture = LiveCapture(rig)
    capture.snapshot(BEGIN_NS)
    track = tip_track(capture)
    for first in range(0, len(frames), 132):  # a batch each 66 ms
        capture.add_frames(frames[first : first + 132])
        track.update()
        kept.append(len(track.parts()[0][1][0]))
    assert kept[-1] == max(kept) == pytest.approx(200, abs=2)
    (path, velocity, force) = (pair for _, pair in track.parts())
    x, y = path[0] - 0.23, path[1]
    assert np.hypot(x, y) == pytest.approx(RADIUS_M, abs=1e-4)
    assert np.hypot(*velocity[:, 1:]) == pytest.approx(2 * math.pi * RADIUS_M / TURN_S, rel=0.05)
    assert np.hypot(*force) == pytest.approx(FORCE_N, rel=0.02)
    along = (force * velocity).sum(axis=0)[1:] / np.hypot(*velocity[:, 1:])
    assert along == pytest.approx(-FORCE_N, rel=0.02)  # against the motion


def test_the_arm_ends_at_the_tip(rig):
    capture = capture_of(rig, frames_of_a_circle(rig, count=300))
    track = tip_track(capture)
    assert track.arm() == []
    track.update()
    base, elbow, tip = track.arm()
    assert base == [0.0, 0.0]
    assert (math.dist(base, elbow), math.dist(elbow, tip)) == pytest.approx((0.2, 0.2))
    assert tip == pytest.approx(track.parts()[0][1][:, -1].tolist())


def test_a_host_that_starts_later_counts_from_its_own_start(rig):
    capture = capture_of(rig, frames_of_a_circle(rig, count=800, still=True))
    track = tip_track(capture)
    view = HostView()
    row = {"phase": "run", "parameters": []}
    view.update(
        {"axes": [{"axis": "shoulder", "position_rad": 0.01, **row}, {"axis": "elbow", "position_rad": -0.02, **row}]}
    )
    track.align(view.positions())
    track.update()
    start = rig.kinematics.start_rad
    assert track.q_rad == pytest.approx([start[0] + 0.01, start[1] - 0.02])
    capture.add_frames(frames_of_a_circle(rig, first=800, count=300))  # it moves: the positions are of other times
    track.align({"shoulder": 0.5, "elbow": 0.5})
    track.update()
    q = angles(*track.parts()[0][1][:, -1])
    assert track.q_rad == pytest.approx(q, abs=1e-6)
    assert abs(track.q_rad[0] - start[0]) < 0.4


def test_positions_are_those_of_a_running_host():
    view = HostView()
    assert view.positions() == {}
    view.update({"axes": [{"axis": "shoulder", "position_rad": 0.25}, {"axis": "elbow", "position_rad": "x"}, 3]})
    assert view.positions() == {"shoulder": 0.25}
    view.update(None)
    assert view.positions() == {}


def test_a_batch_has_the_tip_behind_the_other_parts(rig):
    capture = capture_of(rig, frames_of_a_circle(rig, count=400))
    track = tip_track(capture)
    track.update()
    head, rows = unpacked(batch(capture, rig.axes[0], Flow(), {"arm": track.arm()}, track.parts()))
    kinds = [part["k"] for part in head["parts"]]
    assert kinds[-3:] == ["tip", "tip_velocity", "tip_force"]
    assert rows[-3] == pytest.approx(track.parts()[0][1].astype(np.float32))
    assert len(head["arm"]) == 3


def test_rigs_of_independent_axes_have_no_tip():
    assert tip_track(LiveCapture(load_rig("two_axes"))) is None
    assert law_ring(load_rig("bench"), "hybrid", {}) is None


def test_the_ring_is_the_laws_force_in_each_direction(rig):
    x, y = law_ring(rig, "hybrid", {"F_d_N": 2.5, "F_s_N": 2.6})
    angle = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    assert np.array(x) == pytest.approx(-2.5 * np.cos(angle), abs=0.01)
    assert np.array(y) == pytest.approx(-2.5 * np.sin(angle), abs=0.01)
    ellipse = law_ring(rig, "hybrid", {"ratio": 0.5})
    size = np.hypot(*ellipse)
    assert size.max() == pytest.approx(3.0, rel=0.01)
    assert size.min() == pytest.approx(1.5, rel=0.01)


@pytest.mark.parametrize("law", ["plane_viscous", "plane_wall"])
def test_a_law_of_speed_or_place_has_no_ring(law):
    rig = load_rig("plane", (f"law.function={law}",))
    assert law_ring(rig, "hybrid", {}) is None


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium: apt install chromium (some 300 MB)")
def test_the_page_of_an_arm_draws_its_tip(tmp_path, rig):
    async def run():
        shown = page("plane", Door())
        ring = law_ring(rig, "hybrid", {})
        shown.ring = lambda: ring
        shown.capture.add_frames(frames_of_a_circle(rig))
        async with served(shown) as url:
            ticking = asyncio.create_task(tick(shown))
            async with Browser(url, str(tmp_path / "profile")) as browser:
                await browser.until("plots.length === 8 && plots[7].held.size === 48")
                size = "[...plots[7].held.values()].map(([x, y]) => Math.hypot(x, y))"
                assert await browser.evaluate(size) == pytest.approx([FORCE_N] * 48, rel=0.02)
                assert await browser.evaluate("known.ring[0].length") == DIRECTIONS
                assert await browser.evaluate("plots[7].rangeX.high") >= FORCE_N
                assert await browser.evaluate("document.getElementById('friction-plot').clientWidth") == 0
                a = await browser.evaluate("[plots[6].drawn.sx, plots[6].drawn.sy, plots[6].drawn.x, plots[6].drawn.y]")
                assert a[0] == pytest.approx(a[1])  # the same scale along both axes
                assert a[2][0] < 0 < 0.28 < a[2][1]  # the base and all of the path
                assert await browser.evaluate(OPAQUE) == [255, 255]
                assert browser.errors == []
            ticking.cancel()

    asyncio.run(run())


async def tick(shown):
    while True:
        shown.tick(shown.capture.newest_ns)
        await asyncio.sleep(0.03)
