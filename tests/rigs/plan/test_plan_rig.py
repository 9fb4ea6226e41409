"""The plan of a rig: its messages, the verdict, what would fit, the command, the picture; and a rig
in virtual time under its bounds.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.errors import DeviceMismatch
from coulombus.lab.set_up import set_up
from coulombus.rigs.plan.response_times import Errors
from coulombus.rigs.plan.rig_plan import Assumptions, bitrates_that_fit, largest_axes, plan, plans, shortest_period_ns
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.bits import frame_bits
from coulombus.wire.frame import data_bytes

AT_ONCE = Assumptions(node_ns=0)
KEYS = {"name", "can_id", "bits", "response_us", "deadline_us", "period_us", "jitter_us", "blocking_us"}


def call(*arguments):
    return CliRunner().invoke(main, ["plan", *(str(a) for a in arguments)])


@pytest.fixture(scope="module")
def bench():
    """The bench rig with devices that answer at once."""
    return plan(load_rig("bench"), assumptions=AT_ONCE)


def test_the_messages_of_the_bench_rig(bench):
    assert {m.can_id: m.bits for m in bench.messages} == {
        0x000: 75,
        0x080: 55,
        0x081: 135,
        0x082: 135,
        0x181: 135,
        0x182: 115,
        0x201: 95,
        0x202: 75,
        0x581: 135,
        0x582: 135,
        0x601: 135,
        0x602: 135,
        0x701: 65,
        0x702: 65,
        0x77F: 65,
    }
    ids = [r.message.can_id for r in bench.responses]
    assert ids == sorted(ids)
    assert bench.busy_ns == 475_000
    assert bench.fits
    assert bench.reasons == ()


def test_the_worst_cycle_by_hand(bench):
    sdo, sync, tpdos = 135, 55, 135 + 115
    ends = {f.message.name: f.end_ns // 1000 for f in bench.cycle.frames}
    assert ends["SYNC"] == sdo + sync
    assert ends["brake TPDO1"] == bench.cycle.latest_ns("tpdo") // 1000 == sdo + sync + tpdos
    assert ends["brake RPDO1"] == bench.latest_rpdo_ns // 1000 == sdo + sync + tpdos + 95 + 75
    assert bench.interference_ns == {"cycle": 475_000, "heartbeats": 540_000, "sdo": 610_000, "emcy_nmt": 955_000}


def test_a_cycle_of_1_ms_needs_1_mbit_and_says_which_frames_are_late(bench):
    rig = load_rig("bench")
    assert bitrates_that_fit(rig, bench) == (800_000, 1_000_000)
    slow = plan(rig, bitrate_bit_s=500_000)
    assert not slow.fits
    assert slow.utilisation > 1.0
    assert "brake RPDO1 (202h)" in slow.verdict()
    window = plan(load_rig("bench", ["bus.tpdo_window_s=500e-6"]), bitrate_bit_s=800_000, assumptions=AT_ONCE)
    assert [f.message.name for f in window.cycle.frames if not f.fits] == ["brake TPDO1"]
    watches = {m.name: m.deadline_ns for m in window.messages}
    assert all(
        r.response_ns <= watches[r.message.name] for r in window.responses
    )  # nothing trips, and yet the host waits in vain
    assert [r.message.name for r in window.responses if not r.fits] == ["brake TPDO1"]


def test_the_shortest_period_is_the_shortest(bench):
    rig = load_rig("bench")
    shortest = shortest_period_ns(rig, bench)
    assert shortest is not None
    assert 595_000 <= shortest < 765_000  # the TPDOs need 440 us, and the window is 0.74 of the period
    assert plan(rig, period_ns=shortest, assumptions=AT_ONCE).fits
    assert not plan(rig, period_ns=shortest - 1000, assumptions=AT_ONCE).fits


def test_axes(bench):
    rig = load_rig("bench")
    assert largest_axes(rig, bench) == 1
    two = plan(rig, axes=2, period_ns=2_000_000)
    assert two.fits
    assert {m.can_id for m in two.messages if m.stage == "rpdo"} == {0x201, 0x202, 0x203, 0x204}
    assert largest_axes(rig, two) == 3
    assert not plan(rig, axes=4, period_ns=2_000_000).fits
    assert plan(rig, axes=4, period_ns=3_000_000).fits
    with pytest.raises(ValueError, match="127"):
        plan(rig, axes=64, period_ns=1_000_000_000)


def test_a_rig_of_two_axes_is_two_of_one():
    own, copied = plan(load_rig("two_axes")), plan(load_rig("bench"), axes=2, period_ns=2_000_000)
    assert own.fits
    assert [(m.can_id, m.bits) for m in own.messages] == [(m.can_id, m.bits) for m in copied.messages]
    assert own.latest_rpdo_ns == copied.latest_rpdo_ns


def test_axes_on_two_buses_are_two_plans():
    rig = load_rig("two_axes", ["axis.left.bus.channel=l", "axis.right.bus.channel=r"])
    by_bus = plans(rig)
    assert list(by_bus) == ["l", "r"]
    assert [p.busy_ns for p in by_bus.values()] == [475_000, 475_000]
    with pytest.raises(ValueError, match="l, r"):
        plan(rig)
    document = json.loads(
        call(
            "--rig", "two_axes", "--set", "axis.left.bus.channel=l", "--set", "axis.right.bus.channel=r", "--json"
        ).stdout
    )
    assert [bus["bus"] for bus in document["buses"]] == ["l", "r"]


def test_time_to_compute_and_errors_cost_what_they_cost():
    rig = load_rig("bench")
    assert plan(rig, assumptions=Assumptions(0, 60_000)).latest_rpdo_ns == (610 + 57 + 135) * 1000
    late = plan(rig, assumptions=Assumptions(20_000))
    assert late.cycle.latest_ns("tpdo") == (440 + 17 + 135) * 1000
    assert late.fits
    assert not plan(rig, assumptions=Assumptions(180_000)).fits
    assert plan(rig, assumptions=Assumptions(0, errors=Errors(1, 10_000_000))).latest_rpdo_ns == (610 + 31 + 135) * 1000


def test_the_bench_fits_with_devices_of_150_us_and_a_host_of_50_us():
    slow = ["motor.response_us=150", "brake.response_us=150", "host.compute_s=50e-6"]
    bench_plan = plan(load_rig("bench", slow))
    assert bench_plan.fits
    assert bench_plan.timing.period_ns == 1_000_000
    ends = {f.message.name: f.end_ns // 1000 for f in bench_plan.cycle.frames}
    # an SDO frame, SYNC, 150 us less the inter-frame space and an SDO frame that began in it, the
    # TPDOs; the same of 50 us; the RPDOs
    tpdos = 135 + 55 + (147 + 135) + 135 + 115
    assert ends["brake TPDO1"] == tpdos
    assert ends["brake RPDO1"] == tpdos + (47 + 135) + 95 + 75
    assert not plan(load_rig("bench", ["motor.response_us=180", *slow[1:]])).fits


def test_each_device_has_its_own_response_time():
    bench_plan = plan(load_rig("bench", ["motor.response_us=150", "brake.response_us=40"]))
    jitter = {m.name: m.jitter_ns for m in bench_plan.messages}
    assert (jitter["motor TPDO1"], jitter["brake TPDO1"]) == (150_000, 40_000)
    assert bench_plan.timing.node_ns == 150_000


def test_an_rpdo_that_is_on_the_wire_when_sync_is_released_is_in_time():
    """An RPDO is due to have begun then: SYNC waits for it as for any frame from outside, and not
    longer.
    """
    bench_plan = plan(load_rig("bench"), assumptions=AT_ONCE)
    due = {f.message.name: f.deadline_ns for f in bench_plan.cycle.frames}
    assert due["motor RPDO1"] == 1_000_000 + 94_000
    assert due["brake RPDO1"] == 1_000_000 + 74_000
    alone = bench_plan.cycle_under(
        lambda message: False
    )  # nothing from outside: nothing that SYNC is reckoned to wait for
    assert {f.deadline_ns for f in alone.frames if f.message.stage == "rpdo"} == {1_000_000}


# the command


def test_json_is_the_contract():
    result = call("--rig", "bench", "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert (document["bitrate"], document["period_us"], document["fits"]) == (1_000_000, 1000.0, True)
    assert all(row.keys() >= KEYS for row in document["messages"])
    rows = {row["name"]: row for row in document["messages"]}
    assert rows["SYNC"]["bits"] == 55
    assert rows["SYNC"]["response_us"] == 135 + 75 + 55  # an SDO has begun, NMT goes first
    assert document["utilisation"] == pytest.approx(sum(row["bits"] / row["period_us"] for row in document["messages"]))
    assert all(row["response_us"] <= row["deadline_us"] for row in document["messages"])


def test_what_does_not_fit_ends_with_1_and_names_the_frames():
    result = call("--bitrate", 500_000)
    assert result.exit_code == 1
    assert "brake RPDO1 (202h) is through 1504 us" in result.output
    assert "LATE" in result.output
    assert "no bound" in result.output
    document = json.loads(call("--set", "bus.bitrate_bit_s=500000", "--json").stdout)
    assert document["fits"] is False
    assert any("brake TPDO1 (182h)" in reason for reason in document["reasons"])


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("--errors", "often"), 2, "1/10ms"),
        (("--bitrate", "5"), 2, "--bitrate"),
        (("--period-us", "1"), 2, "--period-us"),
        (("--axes", "0"), 2, "--axes"),
        (("--gantt", "plan.txt"), 2, ".png"),
        (("--rig", "bnch"), 3, "did you mean 'bench'"),
    ],
)
def test_mistakes(arguments, status, text):
    result = call(*arguments)
    assert result.exit_code == status
    assert text in result.output


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["bench", "two_axes"])
def test_the_picture_names_every_frame_of_the_cycle(tmp_path, rig):
    path = tmp_path / "plan.svg"
    assert call("--rig", rig, "--gantt", path).exit_code == 0
    drawn = path.read_text()
    for frame in plan(load_rig(rig)).cycle.frames:
        assert f"{frame.message.name} {frame.message.can_id:03X}h" in drawn  # matplotlib tells each text in a comment


def test_check_shows_the_verdict():
    result = CliRunner().invoke(
        main, ["check", "--set", "bus.bitrate_bit_s=800000", "--set", "bus.tpdo_window_s=0.00055"]
    )
    assert result.exit_code == 1
    assert re.search(r"FAIL: .*brake TPDO1 \(182h\) is through 735 us", result.output)


# a rig in virtual time


def test_bring_up_refuses_and_names_the_frame():
    world = VirtualRig(load_rig("bench", ["bus.bitrate_bit_s=800000", "bus.tpdo_window_s=0.00055"]), "hybrid")
    with pytest.raises(DeviceMismatch, match=r"does not fit.*brake TPDO1 \(182h\)"):
        set_up(world)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bench", "two_axes"])
def test_no_frame_of_a_rig_is_later_than_its_bound(name):
    """Two seconds with an SDO transfer every few milliseconds, begun at every part of the cycle."""
    rig = load_rig(name)
    batches = []
    world = VirtualRig(rig, "hybrid", on_frames=lambda log: batches.append(log.copy()))
    set_up(world)
    world.flush()
    batches.clear()
    world.start_host()
    rng = np.random.default_rng(3)
    for _ in range(100):
        world.wait_ns(int(rng.integers(10_000_000, 20_000_000)))
        world.send(0x601, b"\x40\x64\x60\x00\x00\x00\x00\x00")
    world.flush()
    log = np.concatenate(batches)
    bounds = plan(rig)
    period, bit = bounds.timing.period_ns, 1_000_000_000 // bounds.timing.bitrate_bit_s
    due = {f.message.can_id: f.end_ns for f in bounds.cycle.frames}
    worst = dict.fromkeys(due, 0)
    release = None
    for frame in log:
        can_id, t = int(frame["can_id"]), int(frame["t_ns"])
        if can_id == 0x80:
            release = t // period * period
        if can_id in due and release is not None:
            worst[can_id] = max(worst[can_id], t + 3 * bit - release)
    assert {0x581, 0x601, 0x701} <= set(log["can_id"])  # they did interfere
    for can_id, late in worst.items():
        assert 0 < late <= due[can_id], hex(can_id)
    longest = max(frame_bits(0x601, data_bytes(int(f["word"]), 8)) for f in log if f["can_id"] == 0x601)
    assert worst[0x80] > (longest // 2) * bit  # SYNC was blocked for a good part of one
