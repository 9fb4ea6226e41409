"""The devices' response times, measured by the host in virtual time: the truth is recovered, no
drive is enabled, and what is wrong with the bus is said.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.eds.cia301 import Abort, CobId, NmtState
from coulombus.eds.cia402 import PowerState
from coulombus.host.errors import DeviceMismatch, NodeMissing, SafetyTrip, SdoAborted
from coulombus.host.setup.device_response import SILENT_ROUNDS, Stamped, measure_devices, responses_ns
from coulombus.node.profile import SdoAbort
from coulombus.node.sdo_service import Access
from coulombus.rigs.rig import load_rig, load_rig_text
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.address import BusUnavailable
from coulombus.wire.bits import frame_bits
from eds_edit import SENSOR, edit, fixed
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text()
MOTOR, BRAKE = ((ROOT / "eds" / name).read_text() for name in ("motor.eds", "mr_brake.eds"))


class VirtualWire:
    """The host's station on a bus in virtual time."""

    def __init__(self, world, delay_ns=0):
        self.world, self.delay_ns = world, delay_ns
        self.heard = []
        self.station = world.station(None, self._hear)
        self.sent = []

    def _hear(self, frame):
        self.heard.append(Stamped(frame.t_ns, frame.can_id, frame.data[: frame.length]))

    def send(self, can_id, data):
        self.sent.append(can_id)
        self.world.send(can_id, data)

    def listen(self, duration_ns, until=()):
        wanted, world = set(until), self.world
        world.run_until(world.t_ns + duration_ns, lambda: bool(wanted) and wanted <= {f.can_id for f in self.heard})
        taken, self.heard = self.heard, []
        return taken


class Bench:
    def __init__(self, rig=None, mode="passive"):
        self.frames = []
        self.world = VirtualRig(rig or load_rig("bench"), mode, on_frames=lambda log: self.frames.append(log.copy()))
        self.wire = VirtualWire(self.world)
        self.world.boot()
        self.states = set()

    def truth(self, **response_us):
        for name, value in response_us.items():
            self.world.nodes["processing_ns"][self.world.rows[name]] = round(value * 1e3)

    def measure(self, rounds=20, progress=None):
        def look(name, done):
            self.states.add(tuple(int(device.record["nmt"]) for device in self.world.devices))
            if progress is not None:
                progress(name, done)

        found = measure_devices(self.world.controllers, self.world, self.wire, rounds, look)
        self.world.wait_ns(2_000_000)
        self.world.flush()
        return {one.plan.name: one for one in found}

    def identifiers(self):
        return {int(can_id) for log in self.frames for can_id in log["can_id"]}


def longest_us(device):
    return max(max(pdo.times_ns) for pdo in device.pdos) / 1e3


@pytest.mark.parametrize("truth", [{"motor": 20, "brake": 20}, {"motor": 150, "brake": 35}, {"motor": 5, "brake": 400}])
def test_the_truth_is_recovered(truth):
    bench = Bench()
    bench.truth(**truth)
    found = bench.measure()
    for name, true_us in truth.items():
        (pdo,) = found[name].pdos
        assert (len(pdo.times_ns), pdo.missed) == (20, 0)
        assert abs(longest_us(found[name]) - true_us) <= 50
        assert np.median(pdo.times_ns) / 1e3 == pytest.approx(true_us, abs=1)


def test_no_set_point_is_sent_no_drive_enabled_and_all_end_in_pre_operational():
    bench = Bench()
    found = bench.measure()
    assert len(found) == 2
    host = {*(0x200 + node for node in (1, 2)), *(0x300 + node for node in (1, 2)), CobId.HEARTBEAT + 127}
    assert not host & bench.identifiers()
    assert set(bench.wire.sent) == {CobId.SYNC}
    operational, rest = NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL
    assert {(operational, rest), (rest, operational)} <= bench.states  # one at a time
    assert (operational, operational) not in bench.states
    assert [int(device.record["nmt"]) for device in bench.world.devices] == [rest, rest]
    assert bench.world.motor.record["power_state"] <= PowerState.SWITCH_ON_DISABLED
    assert not any(device.record["causes"] for device in bench.world.devices)  # the end of SYNC is no fault


def test_a_device_with_several_tpdos_does_not_wait_for_itself():
    """The second TPDO waits for the first on the wire, which is no time of the device's."""
    bench = Bench(load_rig("bench", ["role.velocity.object=606C", "role.velocity.scale_rad_s=0.01"]))
    bench.truth(motor=80)
    motor = bench.measure()["motor"]
    assert [pdo.name for pdo in motor.pdos] == ["TPDO1", "TPDO2"]
    for pdo in motor.pdos:
        assert max(pdo.times_ns) / 1e3 == pytest.approx(80, abs=1)


def test_a_sensor_of_its_own_is_measured_and_a_brake_without_tpdo_is_told():
    rig = load_rig_text(
        BENCH + SENSOR + '[role.coil_current]\nobject = "none"\n[role.coil_temperature]\nobject = "none"\n',
        "r.toml",
        {"motor.eds": MOTOR, "mr_brake.eds": BRAKE, "cell.eds": BRAKE},
    )
    bench = Bench(rig)
    bench.truth(cell=120)
    found = bench.measure()
    assert longest_us(found["cell"]) == pytest.approx(120, abs=1)
    assert (found["brake"].pdos, found["brake"].why) == ((), "it has no TPDO")


def test_a_device_whose_tpdos_come_by_its_own_timer_has_no_response_to_sync():
    motor = edit(edit(MOTOR, "1800sub2", AccessType="const", DefaultValue=255), "1800sub5", DefaultValue=1)
    motor = fixed(motor, 0x1A00, 0x1A01, 0x1A02, 0x1A03)
    found = Bench(load_rig_text(BENCH, "r.toml", {"motor.eds": motor, "mr_brake.eds": BRAKE})).measure()
    assert (found["motor"].pdos, found["motor"].why) == ((), "no TPDO follows SYNC")
    assert len(found["brake"].pdos) == 1


def test_an_emergency_is_told_and_ends_nothing():
    bench = Bench()

    def break_down(name, done):
        if (name, done) == ("brake", 3):
            bench.world.inject(bench.world.rows["brake"], "supply_low", True)

    found = bench.measure(progress=break_down)
    assert found["motor"].emergencies == ()
    assert found["brake"].emergencies == (0x3120,)
    assert len(found["brake"].pdos[0].times_ns) == 20


def test_a_node_that_falls_silent_is_told_with_what_to_look_at():
    bench = Bench()

    def unplug(name, done):
        if (name, done) == ("brake", 8):
            bench.world.power_off(bench.world.rows["brake"])

    begin_ns = bench.world.t_ns
    with pytest.raises(NodeMissing, match=r"brake \(node 2\) is OPERATIONAL and sends no TPDO1 .*its supply"):
        bench.measure(rounds=60, progress=unplug)
    assert bench.world.t_ns - begin_ns < 30_000_000_000  # not for each of the rounds that are left
    bench = Bench()
    bench.world.power_off(bench.world.rows["brake"])
    with pytest.raises(NodeMissing, match=r"brake \(node 2\) does not answer SDO"):
        bench.measure()
    assert int(bench.world.motor.record["nmt"]) == NmtState.PRE_OPERATIONAL


def test_a_tpdo_that_does_not_come_is_told():
    bench = Bench()
    bench.world.nodes["processing_ns"][bench.world.rows["brake"]] = 300_000_000
    with pytest.raises(NodeMissing, match=r"brake \(node 2\) is OPERATIONAL and sends no TPDO1 \(182h\) within 250 ms"):
        bench.measure()


def test_a_node_that_aborts_or_is_another_ends_it_before_any_sync(monkeypatch):
    bench = Bench()
    bench.world.motor[0x1018, 2] = 0x99
    with pytest.raises(DeviceMismatch, match="product code 1018h:02"):
        bench.measure()
    assert bench.wire.sent == []
    bench = Bench()
    download = Access.download

    def refuse(self, index, subindex, data):
        if index == 0x1A00:
            raise SdoAbort(Abort.HARDWARE)
        download(self, index, subindex, data)

    monkeypatch.setattr(Access, "download", refuse)
    with pytest.raises(SdoAborted, match=r"1A00h:00.*abort 06060000h"):
        bench.measure()
    assert bench.wire.sent == []
    assert {int(device.record["nmt"]) for device in bench.world.devices} == {NmtState.PRE_OPERATIONAL}


def test_another_host_on_the_bus_ends_it():
    bench = Bench()

    def begin(name, done):
        if done == 5:
            bench.world.station(()).send(CobId.SYNC)

    with pytest.raises(SafetyTrip, match="another host is on the bus"):
        bench.measure(progress=begin)
    bench.world.wait_ns(2_000_000)
    assert {int(device.record["nmt"]) for device in bench.world.devices} == {NmtState.PRE_OPERATIONAL}


def test_ctrl_c_at_any_step_leaves_the_nodes_in_pre_operational():
    for at in (("motor", 0), ("motor", 3), ("brake", 0), ("brake", 20)):
        bench = Bench()

        def stop(name, done, at=at):
            if (name, done) == at:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            bench.measure(progress=stop)
        bench.world.wait_ns(2_000_000)
        assert {int(device.record["nmt"]) for device in bench.world.devices} == {NmtState.PRE_OPERATIONAL}


class DeafWire(VirtualWire):
    """A station whose frames get no acknowledgement."""

    def send(self, can_id, data):
        self.sent.append(can_id)


def test_a_bus_that_takes_no_frame_is_told_as_such():
    bench = Bench()
    bench.wire = DeafWire(bench.world)
    with pytest.raises(BusUnavailable, match="no SYNC gets through"):
        bench.measure()
    assert len(bench.wire.sent) == SILENT_ROUNDS


# the reckoning


def frames(*rows, rate=1_000_000, start_us=1000.0):
    """Frames on the wire: (identifier, data, idle time before it [us]), each with the stamp of its
    end.
    """
    t, found = start_us, []
    for can_id, data, idle_us in rows:
        bits = frame_bits(can_id, data)
        t += idle_us + (bits - 3) * 1e6 / rate
        found.append(Stamped(round(t * 1e3), can_id, data))
        t += 3 * 1e6 / rate
    return found


@pytest.mark.parametrize("rate", [1_000_000, 500_000, 125_000])
def test_other_frames_on_the_wire_are_no_time_of_the_device(rate):
    heard = frames(
        (0x705, b"\5", 0), (0x80, b"", 0), (0x701, b"\5", 17), (0x181, bytes(8), 30), (0x281, b"\1", 0), rate=rate
    )
    gap_us = 3 * 1e6 / rate  # between SYNC's end and the first bit that may follow
    found = responses_ns(heard, {0x181, 0x281, 0x381}, rate)
    assert found == {0x181: round((47 + gap_us) * 1e3), 0x281: round((47 + gap_us) * 1e3)}


def test_what_stands_before_sync_and_what_comes_twice_does_not_count():
    heard = frames((0x181, b"\1", 0), (0x80, b"", 0), (0x181, b"\1", 20), (0x181, b"\1", 500))
    assert responses_ns(heard, {0x181}, 1_000_000) == {0x181: 23_000}
    assert responses_ns(heard[:1], {0x181}, 1_000_000) == {}
    assert responses_ns(heard[:2], {0x181}, 1_000_000) == {}


def test_stamps_that_run_backwards_give_no_negative_time():
    heard = [Stamped(1000, 0x80, b""), Stamped(1000, 0x181, bytes(8))]  # one message of a virtual bus
    assert responses_ns(heard, {0x181}, 1_000_000) == {0x181: 0}


def test_error_frames_and_remote_frames_disturb_nothing():
    heard = frames((0x80, b"", 0), (0x181, b"\1", 20))
    remote = Stamped(heard[0].t_ns + 1000, 0x40000702, b"\0")
    error = Stamped(heard[0].t_ns + 1000, 0x20000004, bytes(8))
    assert responses_ns([heard[0], error, heard[1]], {0x181}, 1_000_000) == {0x181: 23_000}
    assert responses_ns([heard[0], remote, heard[1]], {0x181}, 1_000_000)[0x181] < 23_000
