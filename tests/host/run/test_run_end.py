"""The end of a run, and its markers: the watch over the host taken off, the frames that the markers
stand on.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clocks import Clock
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.realtime.shared_memory import PlaneStatus
from coulombus.host.run import realtime_sequence
from coulombus.host.run.markers import BitMarks, StruckKeys
from coulombus.host.run.run_recording import StampOrder
from coulombus.host.run.run_sequence import Course
from coulombus.host.setup.bringup import release, shut_down
from coulombus.lab.set_up import set_up
from coulombus.recording.reading import read
from coulombus.recording.recorder import Recorder
from coulombus.recording.trace import TRACE
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.system.sd_notify import Notifier
from coulombus.system.stop_signals import Signals
from coulombus.wire.address import parse_address
from coulombus.wire.frame import FRAME
from devices_bench import DevicesLink, Server

MS, S = 1_000_000, 1_000_000_000
SWITCH_ON_DISABLED, OPERATION_ENABLED = 0x0250, 0x0237


@pytest.mark.parametrize(
    ("phase", "trip", "statusword", "taken_off"),
    [
        (Phase.DONE, Trip.NONE, SWITCH_ON_DISABLED, True),
        (Phase.DONE, Trip.SPEED, SWITCH_ON_DISABLED, False),
        (Phase.DONE, Trip.NONE, OPERATION_ENABLED, False),
        (Phase.DISABLE, Trip.NONE, SWITCH_ON_DISABLED, False),
        (Phase.OFF, Trip.NONE, SWITCH_ON_DISABLED, False),
    ],
)
def test_only_a_normal_end_with_the_drive_disabled_takes_the_watch_off(phase, trip, statusword, taken_off):
    k, link = Controllers(load_rig("bench"), "hybrid"), DevicesLink()
    link.sdo_timeout_s = 0.1
    for node in (1, 2):
        Server(link, node, lambda request: [b"\x60" + request[1:4] + bytes(4)])
    k.host["phase"], k.host["trip"], k.host["image"][0, Image.STATUSWORD] = phase, trip, statusword
    release(k, link)
    assert link.sent[0] == (0x000, b"\x80\0")  # PRE-OPERATIONAL first
    assert link.sent[1:] == [(0x600 + node, b"\x23\x16\x10\x01" + bytes(4)) for node in (1, 2) if taken_off]


@pytest.mark.parametrize("orderly", [True, False])
def test_a_host_that_leaves_in_order_leaves_no_error_behind(orderly):
    """Both nodes told of a lost heartbeat after every run that had ended well.

    Of a host that dies they still do.
    """
    emcys = []

    def on_frames(frames):
        found = frames[(frames["can_id"] == 0x081) | (frames["can_id"] == 0x082)]
        emcys.extend(int(word) & 0xFFFF for word in found["word"])

    world = VirtualRig(load_rig("bench"), "hybrid", on_frames=on_frames)
    k = world.controllers
    set_up(world)
    world.start_host()
    world.run_until(world.t_ns + 5 * S, lambda: world.enabled_ns is not None)
    if orderly:
        k.stop()
        world.run_until(world.t_ns + 5 * S, lambda: k.done)
        release(k, world)
        assert k.done
    world.stop_host()
    if orderly:
        shut_down(world)
    world.run_until(world.t_ns + 1 * S, lambda: False)
    world.flush()
    assert (0x8130 in emcys) is not orderly
    assert bool(emcys) is not orderly


class PlaneClock(Clock):
    """A clock by which a data plane lives."""

    def __init__(self, plane):
        super().__init__()
        self.plane = plane

    def sleep(self, seconds):
        super().sleep(seconds)
        self.plane.live(self.ns)


class Plane:
    """A data plane: a frame each millisecond, the drive enabled at 1 s, safe 1 ms after a stop and
    done 600 ms later.

    The first batch that is taken from it takes 1.4 s, as what has to be compiled first does, or a
    machine that stands still.
    """

    status, alive, lost_text, real_time = PlaneStatus.CYCLING, True, "", ()

    def __init__(self, k, trip=Trip.NONE, enabled_s=(1,)):
        self.k, self.now, self.taken, self.trip, self.enabled_s = k, 0, 0, trip, enabled_s
        self.stop_ns = None
        self.batches = 0

    @property
    def cycles(self):
        return self.now // MS

    def wait_ready(self):
        pass

    def attend(self):
        pass

    def start_cycle(self, at_ns):
        self.k.host["phase"] = Phase.STILL

    def hold_deadman(self, until_ns):
        pass

    def stop(self, trip=Trip.NONE):
        self.stop_ns = self.stop_ns or self.now

    def live(self, t_ns):
        self.now, h = t_ns, self.k.host
        for axis, at_s in enumerate(self.enabled_s):
            if t_ns >= at_s * S and h["phase"][axis] == Phase.STILL:
                h["enabled_ns"][axis], h["phase"][axis] = at_s * S, Phase.RUN
        safe = self.stop_ns + MS if self.stop_ns is not None else 3 * S if self.trip else None
        if safe is not None and t_ns >= safe and h["phase"][0] < Phase.SAFE:
            h["trip"], h["trip_ns"], h["phase"] = self.trip, safe, Phase.SAFE
        if h["phase"][0] == Phase.SAFE and t_ns >= int(h["trip_ns"][0]) + 600 * MS:
            h["phase"] = Phase.DONE

    def take_frames(self):
        self.batches += 1
        if self.batches == self.slow_batch:
            self.clock.sleep(1.4)
        stamps = np.arange(self.taken + MS, self.now + 1, MS)
        self.taken = self.now // MS * MS
        frames = np.zeros(len(stamps), FRAME)
        frames["t_ns"], frames["can_id"] = stamps, 0x80
        return frames.view(np.recarray)

    def take_trace(self):
        return np.zeros(0, TRACE).view(np.recarray)


def marked(tmp_path, monkeypatch, **how):
    """Return the markers of a run of 5 s, in ms."""
    over(tmp_path, monkeypatch, **how)
    return [(round(t_s * 1000), text.partition(":")[0]) for t_s, text in read(tmp_path / "r.pcapng").markers]


def over(tmp_path, monkeypatch, *, slow_batch=1, trip=Trip.NONE, rig="bench", enabled_s=(1,), struck=b""):
    """Return a run of 5 s that has ended; keys were `struck` as it began.

    The drives of the axes are enabled at these times.
    """
    rig = load_rig(rig)
    run = object.__new__(realtime_sequence.RealCourse)
    run.world = SimpleNamespace(models=SimpleNamespace(take_rows=bytes), controlled=False, close=lambda: None)
    k = Controllers(rig, "hybrid")
    plane = Plane(k, trip, enabled_s)
    plane.clock, plane.slow_batch = PlaneClock(plane), slow_batch
    monkeypatch.setattr(realtime_sequence, "time", plane.clock)
    Course.__init__(run, k, tmp_path / "r.pcapng", None)
    run.rig, run.plane, run.zero_ns = rig, plane, 0
    run.notifier, run.buses = Notifier({}), "coulombus:bench"
    run.answers = SimpleNamespace(serve_status=lambda now_ns: None)
    run.control = SimpleNamespace(wait_ns=lambda ns: None)
    run.recorder = Recorder(tmp_path / "r.pcapng", rig, "hybrid")
    run.error, run.stopped_by, run._order = None, None, StampOrder(0)
    run._keys, run._bits = StruckKeys(plane.clock.monotonic_ns), BitMarks((), rig)
    run.deadman, run._seen = "none", (0, 0.0)
    run.signals = Signals()
    run.door = SimpleNamespace(stop_wanted=lambda: False)
    run.changes = SimpleNamespace(arm_key="")
    run._keys.strike(struck)
    with run.armed():
        run.display(5.0)
    run.drain()
    return run


@pytest.mark.parametrize("key", [b"q", b"\x1b"])
def test_a_key_makes_the_rig_safe_at_once(tmp_path, monkeypatch, key):
    run = over(tmp_path, monkeypatch, struck=key)
    assert run.stopped_by == "a key"
    assert run.controllers.done
    assert run.controllers.safe_ns < 2 * S  # the display would have ended at 6 s
    (tmp_path / "again").mkdir()
    assert over(tmp_path / "again", monkeypatch, struck=b"1").stopped_by is None


@pytest.mark.parametrize("slow_batch", [1, 95])
def test_markers_stand_on_their_frames_however_slow_the_recording_is(tmp_path, monkeypatch, slow_batch):
    """A first batch that was compiled while the drive was enabled put "phase rest" 0.9 s late;
    "safe" stood on the last frame.
    """
    found = marked(tmp_path, monkeypatch, slow_batch=slow_batch)
    assert [text for _, text in found] == ["phase rest", "phase hold", "phase stroke", "phase end", "safe"]
    assert [t for t, _ in found[:3]] == [1000, 2000, 6000][: len(found[:3])]
    end, safe = found[3][0], found[4][0]
    assert 6000 <= end <= 6020
    assert end <= safe <= end + 2


def test_a_trips_marker_stands_on_its_frame(tmp_path, monkeypatch):
    found = {text: t for t, text in marked(tmp_path, monkeypatch, slow_batch=300, trip=Trip.SPEED)}
    assert found["trip SPEED"] == 3000


@pytest.mark.parametrize("enabled_s", [(1, 3), (3, 1)])
def test_the_phases_of_each_axis_count_from_its_own_start(tmp_path, monkeypatch, enabled_s):
    found = {
        text: t
        for t, text in marked(tmp_path, monkeypatch, slow_batch=0, rig="two_axes", enabled_s=enabled_s)
        if "phase" in text
    }
    for axis, at_s in zip(("left", "right"), enabled_s, strict=True):
        assert found[f"{axis}.phase rest"] == 1000 * at_s
        assert found[f"{axis}.phase hold"] == 1000 * at_s + 1000
    last = max(enabled_s)  # the display lasts 5 s from the last one on
    assert all(1000 * last + 5000 <= found[f"{axis}.phase end"] <= 1000 * last + 5020 for axis in ("left", "right"))


def test_what_the_recording_needs_is_compiled_before_the_nodes_are_touched(monkeypatch):
    run = object.__new__(realtime_sequence.RealCourse)
    run.world = SimpleNamespace(models=SimpleNamespace(take_rows=bytes), controlled=False, close=lambda: None)
    rig = load_rig("bench")
    run.plane = Plane(Controllers(rig, "hybrid"))
    run.plane.slow_batch = 0
    Course.__init__(run, run.plane.k, None, None)
    run.zero_ns, run._order, run.deadman = 0, StampOrder(0), "key"
    run.address, run.buses = parse_address("coulombus:x"), "coulombus:x"
    run.control = SimpleNamespace(check_alone=lambda at: None, wait_ns=lambda ns: None)
    seen = []
    monkeypatch.setattr(realtime_sequence, "bring_up", lambda k, control: seen.append(run.plane.batches) or ())
    run.set_up()
    assert seen == [1]
