"""Call-backs for the signals of a bus, by name."""

from __future__ import annotations

import re
import threading

import pytest

from coulombus import live
from coulombus.monitor.callbacks import LiveBus
from coulombus.recording.signals import UnknownSignal
from coulombus.wire.address import BusUnavailable
from places import ROOT
from tiny_bus import tiny_bus

NAME = "motor.position_rad"
PAGE = ROOT / "docs" / "export.md"


@pytest.fixture
def bus(private_sockets):
    with tiny_bus("bench") as served:
        yield served


def frames_of(heard):
    """Return a PDO of the motor's position: identifier and length."""
    pdo = next(p for p in heard.rig.pdos() if any(s.name == NAME for s in p.signals))
    return pdo.layout.cob_id, bytes(pdo.layout.length)


def test_each_frame_calls_and_an_error_is_counted(bus):
    done = threading.Event()
    calls = []

    def good(t_s, value):
        calls.append((t_s, value, threading.current_thread().name))
        if len(calls) == 3:
            done.set()

    def bad(t_s, value):
        raise RuntimeError("mine")

    with live("bench") as heard:
        wrong = heard.on(NAME, bad)
        right = heard.on([NAME], good)
        ended = heard.on(NAME, good)
        ended.end()
        bus.deliver(*[frames_of(heard)] * 3)
        assert done.wait(5)
    assert (right.calls, right.errors, ended.calls) == (3, 0, 0)
    assert (wrong.calls, wrong.errors, str(wrong.error)) == (3, 3, "mine")
    assert {(value, name) for _, value, name in calls} == {(0.0, "bus call-backs")}
    assert heard.wait(0)


def test_a_callback_may_close_the_bus(bus):
    heard = live("bench")
    only = heard.on((NAME, "motor.statusword"), lambda t_s, angle, word: heard.close())
    for pdo in heard.rig.pdos():
        bus.deliver((pdo.layout.cob_id, bytes(pdo.layout.length)))
    assert heard.wait(5)
    assert only.calls == 1


def test_a_pdo_of_another_length_is_counted_and_told_once(bus, caplog):
    done = threading.Event()
    with live("bench") as heard:
        only = heard.on(NAME, lambda t_s, value: done.set())
        can_id, data = frames_of(heard)
        bus.deliver((can_id, data[:-1]), (can_id, data[:-2]), (can_id, data))
        assert done.wait(5)
        assert heard.malformed == {"motor.TPDO1": 2}
    assert only.calls == 1
    assert [record.getMessage() for record in caplog.records] == [
        "motor.TPDO1 came with 7 bytes, the rig has 8: is this the rig of this bus? reported once, then counted"
    ]


def test_frames_that_found_no_place_are_asked_for(bus, monkeypatch, caplog):
    monkeypatch.setattr("coulombus.monitor.callbacks.ASK_S", 0.0)
    with live("bench") as heard:
        assert heard.lost == 0
        bus.lost = 12
        for _ in range(100):
            bus.deliver(frames_of(heard))
            if heard.lost == 12 and caplog.records:
                break
            heard.wait(0.05)
        assert heard.lost == 12
    assert "12 frames were lost" in caplog.text


def test_what_is_wrong_is_said(bus):
    with live("coulombus:bench") as heard:
        with pytest.raises(UnknownSignal, match=r"no signal 'motor.positon_rad' .* there is motor.position_rad"):
            heard.on("motor.positon_rad", print)
        with pytest.raises(ValueError, match="no signal is named"):
            heard.on([], print)
        bus.close()
        with pytest.raises(BusUnavailable):
            heard.wait(5)


def test_the_page_s_script(bus, monkeypatch):
    script = re.search(r"```python\n(from coulombus import live.*?)```", PAGE.read_text(), re.DOTALL)[1]
    printed, done = [], threading.Event()

    def tell(*words):
        printed.append(words)
        done.set()

    def wait(heard, seconds):
        bus.deliver(*[(pdo.layout.cob_id, bytes(pdo.layout.length)) for pdo in heard.rig.pdos()])
        assert done.wait(seconds)

    monkeypatch.setattr(LiveBus, "wait", wait)
    exec(compile(script, str(PAGE), "exec"), {"print": tell})
    assert [torque_Nm for _, torque_Nm in printed] == [0.0]
