"""The page's model: samples, words, batches, guards. No bus, no browser."""

import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.monitor.live_incidents import IncidentRow
from coulombus.monitor.web.access import ControlLock, kept_token, new_token, right_token, same_origin, served_as
from coulombus.monitor.web.batch import IN_FLIGHT, Flow, batch, layout, unpacked
from coulombus.monitor.web.capture import LiveCapture
from coulombus.monitor.web.page_state import HostView, arm_state, document, drive_words, incident_dicts
from coulombus.rigs.rig import load_rig
from web_bench import BEGIN_NS, FACTS, MS, STATUS, cycles


@pytest.fixture
def capture():
    live_capture = LiveCapture(load_rig("bench"))
    live_capture.snapshot(BEGIN_NS)
    for first in range(0, 2000, 33):
        live_capture.add_frames(cycles(first, min(33, 2000 - first)))
    return live_capture


def view():
    return HostView(lambda trip: "1. Turn the handle." if "SPEED" in trip else None)


def test_signals_are_kept_in_si_units(capture):
    t, angle = capture.track("motor.position_rad").last(2)
    scale = capture.rig.pdos()[1].signals[1].scale
    np.testing.assert_allclose(angle, (-100 - 3 * np.array([1998, 1999])) * scale)
    assert t[-1] == BEGIN_NS + 1999 * MS + 200_000
    _, speed = capture.track("handle.velocity_rad_s").last(100)
    np.testing.assert_allclose(speed, -3 * scale / 1e-3)
    _, low, high = capture.track("brake.handle_torque_Nm").bins_since(
        capture.track("brake.handle_torque_Nm").bins.newest - 5
    )
    np.testing.assert_allclose(low[:-1], -1.2)
    np.testing.assert_allclose(high[:-1], -1.194)


def test_the_friction_is_paired_by_time_and_lasts_two_seconds(capture):
    axis = capture.rig.one_axis()
    v, f = capture.friction(axis)
    assert 150 < len(v) == len(f) <= 201
    assert v.max() < 0
    assert -1.2 <= f.min() <= f.max() <= -1.194


def test_the_state_says_what_the_bus_carries(capture):
    now = BEGIN_NS + 2000 * MS
    host = view()
    host.update(STATUS)
    state = document(capture, capture.snapshot(now), FACTS, host)
    assert state["arm"] == "armed"
    assert state["host"]["phase"] == "running"
    assert 30 < state["load_percent"] < 60  # 5 frames and 22 bytes of data a millisecond
    row = next(row for row in state["pdos"] if row["name"] == "motor.TPDO1")
    assert row["raw"] == "37 02 2F E8 FF FF EC FF"
    assert row["jitter_ms"] == pytest.approx(0, abs=1e-6)
    assert [s["value"] for s in row["signals"]][:1] == ["0237h"]


def test_nothing_that_the_bus_carries_raises(capture):
    rng = np.random.default_rng(5)
    frames = [
        (int(rng.integers(0, 2**62)), int(rng.integers(0, 2**32)), int(rng.integers(0, 9)), rng.bytes(8))
        for _ in range(2000)
    ]
    frames += [(BEGIN_NS, pdo.layout.cob_id, n, rng.bytes(8)) for pdo in capture.rig.pdos() for n in range(9)]
    capture.add_frames(frames)
    document(capture, capture.snapshot(BEGIN_NS), FACTS, view())
    batch(capture, capture.rig.one_axis(), Flow(), {})


def test_the_time_of_a_trip_is_the_host_s_and_lasts_until_the_next_run():
    host = view()
    assert host.tripped_ns is None
    host.update({**STATUS, "trip": "SPEED: too fast", "tripped": "2027-01-15T08:00:00.300001Z"})
    assert host.tripped_ns == 1_800_000_000_300_001_000
    host.update({**STATUS, "trip": "SPEED: too fast", "tripped": "yesterday"})
    assert host.tripped_ns is None
    host.ended({"trip": "SPEED: too fast", "tripped": "2027-01-15T08:00:01.000000Z"})
    assert host.tripped_ns == 1_800_000_001_000_000_000
    host.update(None)
    host.update(STATUS)
    assert host.tripped_ns is None


def test_equal_incidents_are_one_with_a_count():
    row = IncidentRow(1, "a-1-7", "warning", "SYNC came late", 7 * 10**9, 8 * 10**9, "load", "likely", (), ())
    rows = [
        row,
        replace(row, number=2, key="b", title="other"),
        replace(row, number=3, key="a-1-3", begin_ns=3 * 10**9),
    ]
    rows.append(replace(row, number=4, key="a-1-9", status="unresolved", end_ns=None))
    shown = incident_dicts(rows)
    assert [(entry["title"], entry["status"], entry["count"]) for entry in shown] == [
        ("SYNC came late", "warning", 2),
        ("other", "warning", 1),
        ("SYNC came late", "unresolved", 1),
    ]
    assert (shown[0]["key"], shown[0]["t"], shown[0]["end"]) == ("a-1-3", 3.0, 8.0)
    assert shown[2]["end"] is None


def test_a_trip_stays_with_the_runbooks_line_until_the_next_run():
    host = view()
    host.update({**STATUS, "trip": "SPEED: too fast"})
    host.update(None)
    state = host.as_dict()
    assert (state["runs"], state["trip"], state["entry"]) == (False, "SPEED: too fast", "1. Turn the handle.")
    host.update(STATUS)
    assert host.as_dict()["trip"] == ""


@pytest.mark.parametrize(
    "rubbish", [{}, {"mode": 3, "axes": "no", "trip": [], "display_s": float("nan")}, {"axes": [None, {"phase": 1}]}]
)
def test_a_hosts_rubbish_is_as_if_not_told(rubbish):
    host = view()
    host.update(rubbish)
    assert (host.as_dict()["mode"], host.as_dict()["trip"], host.as_dict()["display_s"]) == ("", "", None)


def test_a_drive_that_is_not_heard_is_neither_armed_nor_disarmed():
    live_capture = LiveCapture(load_rig("bench"))
    assert arm_state(live_capture.snapshot(BEGIN_NS)) == "unknown"


@pytest.mark.parametrize(
    ("nmt", "silent", "arm", "words"),
    [
        ("operational", False, "armed", "operation enabled"),
        (None, False, "armed", "operation enabled"),
        ("pre-operational", False, "unknown", "last seen operation enabled"),
        ("stopped", False, "unknown", "last seen operation enabled"),
        ("operational", True, "unknown", "silent, last seen operation enabled"),
    ],
)
def test_a_state_is_the_last_seen_once_its_drive_sends_no_more(nmt, silent, arm, words):
    """A node that is not OPERATIONAL sends no statusword: nobody knows whether it is armed."""
    drive = SimpleNamespace(power_state="operation enabled", state=nmt, silent=silent, name="motor", emergency=None)
    snapshot = SimpleNamespace(nodes=[drive])
    assert (arm_state(snapshot), drive_words(snapshot)) == (arm, words)


def test_batches_bring_each_bin_and_wait_for_the_page(capture):
    axis, flow = capture.rig.one_axis(), Flow()
    head, numbers = unpacked(batch(capture, axis, flow, {}))
    whole = {
        part["s"]: (part["first"], rows)
        for part, rows in zip(head["parts"], numbers, strict=True)
        if part["k"] == "envelope"
    }
    assert set(whole) == {name for row in layout(capture, axis) for name in row["signals"]}
    first, (low, _) = whole["motor.position_rad"]
    assert np.isfinite(low[-100:]).all()
    capture.add_frames(cycles(2000, 40))
    head, numbers = unpacked(batch(capture, axis, flow, {}))
    part = next(part for part in head["parts"] if part["k"] == "envelope" and part["s"] == "motor.position_rad")
    assert part["first"] == first + len(low) - 1  # the bin that may have grown, and the new ones
    assert part["n"] <= 4
    assert not flow.free
    assert flow.sent == IN_FLIGHT
    assert [flow.acknowledge(n) for n in (3, 0, 2, 2)] == [False, False, True, False]
    assert flow.free


def test_tokens_are_kept_private_and_compared_whole(tmp_path):
    path = tmp_path / "token"
    token = kept_token(path)
    assert kept_token(path) == token
    assert os.stat(path).st_mode & 0o777 == 0o600
    assert right_token(token, token)
    assert not any(right_token(wrong, token) for wrong in ("", token[:-1], token + "x", new_token(), "\udcff"))
    path.chmod(0o644)  # others may have read it
    assert kept_token(path) != token
    path.write_text("short\n")
    assert len(kept_token(path)) == 32
    link = tmp_path / "link"
    link.symlink_to(path)
    with pytest.raises(OSError, match="link"):
        kept_token(link)


@pytest.mark.parametrize(
    ("origin", "right"),
    [
        ("http://h:1", True),
        ("https://h:1", True),
        (None, False),
        ("null", False),
        ("http://h:2", False),
        ("http://h:1.evil", False),
    ],
)
def test_the_origin_is_the_page_itself(origin, right):
    assert same_origin(origin, "h:1") is right
    assert not same_origin("http://", None)


@pytest.mark.parametrize(
    ("host", "address", "port", "name", "right"),
    [
        ("192.168.1.7:8642", "192.168.1.7", 8642, "", True),
        ("lab-pc:8642", "192.168.1.7", 8642, "Lab-PC", True),  # --web-host, or this machine's name
        ("lab-pc:8642", "192.168.1.7", 8642, "", False),
        ("localhost:8642", "192.168.1.7", 8642, "lab-pc", False),  # the network's address is no loopback
        ("192.168.1.8:8642", "192.168.1.7", 8642, "", False),
        ("[fe80::7]:8642", "fe80::7%eth0", 8642, "", True),
        ("192.168.1.7:8642", "::ffff:192.168.1.7", 8642, "", True),
        ("[::1]:8642", "127.0.0.1", 8642, "", True),
        ("127.0.0.1:8642", "::1", 8642, "", True),
        ("127.0.0.1", "127.0.0.1", 80, "", True),  # a browser leaves this port out
        ("127.0.0.1", "127.0.0.1", 8642, "", False),
        (":8642", "127.0.0.1", 8642, "", False),
        ("", "127.0.0.1", 80, "", False),
        (None, "127.0.0.1", 8642, "", False),
    ],
)
def test_the_host_is_the_address_that_is_served(host, address, port, name, right):
    assert served_as(host, address, port, name) is right


def test_one_controls_and_the_others_look_on():
    lock = ControlLock()
    assert [lock.acquire(1), lock.acquire(2), lock.acquire(1)] == [True, False, True]
    lock.release(2)
    assert lock.holder == 1
    lock.release(1)
    assert lock.acquire(2)
