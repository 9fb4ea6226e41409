"""A drive without a rig turns its load: as the equation says, whoever reads, with SYNC and without."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from itertools import pairwise

import pytest

from coulombus.eds.cia301 import NmtCommand
from coulombus.node.drive402 import DRIVE402
from coulombus.node.emcy import DEVICE_FAULTS, FIRST_DEVICE_CAUSE
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.plant import encoder_rad
from coulombus.sim_bus.rig.shaft_load import Load, holding_pm

MOTOR, NODE_ID = "eds/motor.eds", 5
RATED_Nm = 0.18
COUNTS_RAD = 8192 / (2 * math.pi)
LOAD = Load(inertia_kg_m2=2e-4, friction_Nm=0.01, viscous_Nms_rad=2e-4)
MS = 1_000_000
PROFILE_VELOCITY, CST = 3, 10


class Bench:
    """A drive with a load on a bus of its own, and a client that knows SDO."""

    def __init__(self, load=LOAD, mode=CST, eds=MOTOR):
        self.network = VirtualNetwork(capacity=1)
        self.device = self.network.add(eds, NODE_ID, DRIVE402)
        self.network.attach_load(0, load.plant(self.device.dictionary))
        self.station = self.network.station({0x580 + NODE_ID, 0x180 + NODE_ID})
        self.network.power_on()
        self.network.wait_ns(2 * MS)
        self.station.send(0x000, bytes((NmtCommand.START, NODE_ID)))
        self.write(0x6072, 1000)
        self.write(0x6060, mode, "b")
        for word in (6, 7, 15):
            self.write(0x6040, word)
        self.until(50)

    @property
    def plant(self):
        return self.network.plant[0]

    def until(self, ms):
        self.network.run_until(ms * MS)

    def write(self, index, value, form="H", subindex=0):
        size = struct.calcsize("<" + form)
        head = struct.pack("<BHB", 0x23 | (4 - size) << 2, index, subindex)
        self.station.send(0x600 + NODE_ID, head + struct.pack("<" + form, value).ljust(4, b"\0"))
        answer = self.station.wait_for(0x580 + NODE_ID, 5 * MS)
        assert answer is not None
        assert answer.data[0] == 0x60

    def read(self, index, form):
        self.station.take()
        self.station.send(0x600 + NODE_ID, struct.pack("<BHB4x", 0x40, index, 0))
        answer = self.station.wait_for(0x580 + NODE_ID, 5 * MS)
        assert answer is not None
        return struct.unpack_from("<" + form, answer.data, 4)[0]


@pytest.mark.parametrize("torque_pm", [300, -300, 150, -90])
def test_a_constant_torque_gives_the_speed_of_the_equation(torque_pm):
    bench = Bench()
    bench.write(0x6071, torque_pm, "h")
    bench.until(80)  # the lag of the motor has decayed
    v0, x0 = bench.device[0x606C, 0] / COUNTS_RAD, bench.device[0x6064, 0] / COUNTS_RAD
    bench.until(180)
    friction = math.copysign(LOAD.friction_Nm, torque_pm)
    end = (torque_pm * 1e-3 * RATED_Nm - friction) / LOAD.viscous_Nms_rad
    tau = LOAD.inertia_kg_m2 / LOAD.viscous_Nms_rad
    decay = math.exp(-0.1 / tau)
    v1 = end + (v0 - end) * decay
    assert abs(v0) > 0.5
    assert bench.device[0x606C, 0] == pytest.approx(v1 * COUNTS_RAD, abs=2)
    way = end * 0.1 + (v0 - end) * tau * (1 - decay)
    assert bench.device[0x6064, 0] == pytest.approx((x0 + way) * COUNTS_RAD, abs=2)
    assert bench.device[0x6077, 0] == bench.device[0x6078, 0] == torque_pm
    assert bench.device[0x6079, 0] == 24_000


def test_a_torque_below_the_friction_moves_nothing():
    bench = Bench()
    assert holding_pm(bench.plant) == pytest.approx(1000 * LOAD.friction_Nm / RATED_Nm)
    bench.write(0x6071, 55, "h")
    bench.until(300)
    assert bench.device[0x6064, 0] == 0
    assert bench.read(0x6077, "h") == 55
    bench.write(0x6071, 56, "h")
    bench.until(900)
    assert bench.device[0x6064, 0] > 0


def test_values_are_those_of_the_moment_at_which_an_sdo_reads_them():
    bench = Bench()
    bench.write(0x6071, -400, "h")
    for ms in range(60, 160, 10):
        bench.until(ms)
        speed = bench.read(0x606C, "i")
        assert speed == pytest.approx(bench.plant.v * COUNTS_RAD, abs=80)  # an answer takes 0.2 ms
        position = bench.read(0x6064, "i")
        assert position == pytest.approx(encoder_rad(bench.plant) * COUNTS_RAD, abs=12)
        assert position < 0


def moved(events):
    """Return the plant's state after a torque from 60 ms on, with `events` on the bus: (ms, identifier, data)."""
    bench = Bench()
    bench.network.at(60 * MS, lambda _: bench.station.send(0x600 + NODE_ID, bytes.fromhex("2b7160002c010000")))
    for ms, can_id, data in events:
        bench.network.at(round(ms * MS), lambda _, can_id=can_id, data=data: bench.station.send(can_id, data))
    bench.until(200)
    return float(bench.plant.x), float(bench.plant.v)


READ = 0x600 + NODE_ID, struct.pack("<BHB4x", 0x40, 0x606C, 0)


def test_neither_readings_nor_sync_change_the_motion():
    once = moved([(150, *READ)])
    assert once[1] > 10
    assert moved([(70.03 + 1.3 * k, *READ) for k in range(90)]) == once
    assert moved([(70.03 + k, 0x080, b"") for k in range(120)]) == once


def test_the_velocity_loop_is_not_disturbed_by_readings():
    def driven(reads):
        bench = Bench(mode=PROFILE_VELOCITY)
        bench.network.at(60 * MS, lambda _: bench.station.send(0x600 + NODE_ID, bytes.fromhex("23ff6000b80b0000")))
        for k in range(reads):
            bench.network.at(round((70.03 + 0.7 * k) * MS), lambda _: bench.station.send(*READ))
        bench.until(200)
        return float(bench.plant.x), float(bench.plant.v)

    assert driven(0)[1] > 1
    assert driven(150) == driven(0)


def test_an_event_driven_tpdo_shows_the_moment_at_which_it_is_sent():
    bench = Bench()
    bench.write(0x1800, 0x80000180 + NODE_ID, "I", 1)
    bench.write(0x1A00, 0, "B")
    bench.write(0x1A00, 0x606C0020, "I", 1)
    bench.write(0x1A00, 1, "B")
    bench.write(0x1800, 255, "B", 2)
    bench.write(0x1800, 10, "H", 5)
    bench.write(0x1800, 0x180 + NODE_ID, "I", 1)
    bench.write(0x6071, 300, "h")
    bench.station.take()
    bench.until(150)
    frames = bench.station.take(0x180 + NODE_ID)
    speeds = [struct.unpack("<i", frame.data)[0] for frame in frames]
    assert len(speeds) >= 8
    steps = [after - before for before, after in pairwise(speeds[2:])]
    acceleration = (0.3 * RATED_Nm - LOAD.friction_Nm) / LOAD.inertia_kg_m2 * COUNTS_RAD
    assert steps == pytest.approx([0.01 * acceleration] * len(steps), rel=0.1)


def test_a_blocked_axis_stops_and_a_freed_one_follows_again():
    bench = Bench(mode=PROFILE_VELOCITY)
    bench.write(0x60FF, 20_000, "i")
    bench.until(500)
    assert bench.read(0x606C, "i") == pytest.approx(20_000, abs=200)
    bench.network.block(0)
    bench.until(600)
    held = bench.device[0x6064, 0]
    bench.until(900)
    assert bench.device[0x6064, 0] == held
    assert bench.read(0x606C, "i") == 0
    assert bench.read(0x6077, "h") == 1000  # it fails to follow, at its limit
    assert bench.read(0x6041, "H") & 0x0800
    assert math.isinf(holding_pm(bench.plant))
    bench.network.block(0, blocked=False)
    bench.until(1500)
    assert bench.read(0x606C, "i") == pytest.approx(20_000, abs=200)


def test_a_drive_that_is_off_or_in_fault_coasts():
    bench = Bench()
    bench.write(0x6071, 500, "h")
    bench.until(150)
    fault = 1 << DEVICE_FAULTS["over_current"] - FIRST_DEVICE_CAUSE
    bench.device.record["in_faults"] = fault
    bench.device.record["next_ns"] = bench.network.t_ns
    bench.until(160)
    v0 = float(bench.plant.v)
    bench.network.power_off(0)
    bench.until(260)
    assert 0 < bench.plant.v < v0
    tau, drop = LOAD.inertia_kg_m2 / LOAD.viscous_Nms_rad, LOAD.friction_Nm / LOAD.viscous_Nms_rad
    assert bench.plant.v == pytest.approx((v0 + drop) * math.exp(-0.1 / tau) - drop, rel=1e-2)


def test_defaults_follow_the_rated_torque_and_the_counts():
    bench = Bench(load=Load())
    plant = bench.plant
    assert plant.motor_Nm_pm == pytest.approx(0.18e-3)
    assert plant.inertia * 2 * math.pi * 50 / 0.1 == pytest.approx(0.18)
    assert plant.coulomb == pytest.approx(0.02 * 0.18)
    assert plant.viscous * 2 * math.pi * 50 == pytest.approx(0.05 * 0.18)
    assert plant.counts_rad == pytest.approx(COUNTS_RAD)
    assert bench.device.record["load_counts_s2"] * 1000 * 0.1 == pytest.approx(50 * 8192)  # 3000 rpm in 0.1 s
    stronger = replace(Load(), rated_torque_Nm=2.0).plant(bench.device.dictionary)[0]
    assert stronger.inertia / plant.inertia == pytest.approx(2.0 / 0.18)


def test_drives_of_one_bus_have_loads_of_their_own():
    network = VirtualNetwork(capacity=3)
    devices = [network.add(MOTOR, node_id, DRIVE402) for node_id in (1, 2, 3)]
    for row in (0, 2):
        network.attach_load(row, LOAD.plant(devices[row].dictionary))
    network.power_on()
    network.wait_ns(MS)
    network.plant[0].v, network.plant[1].v = 3.0, -5.0
    network.wait_ns(10 * MS)
    speeds = [device[0x606C, 0] for device in devices]
    assert speeds[0] > 1000
    assert speeds[1] == 0
    assert speeds[2] < -2000


@pytest.mark.slow
def test_the_drive_of_a_rig_is_true_without_sync():
    rig = VirtualRig(load_rig("bench"), "active", seed=7)
    rig.power_on()
    rig.wait_ns(2 * MS)
    rig.plant[0].v = 3.0  # somebody turns the handle
    node = rig.canopen().add_node(1, MOTOR)
    last = 0
    for _ in range(3):
        rig.wait_ns(MS)
        position, speed = node.sdo[0x6064].raw, node.sdo[0x606C].raw
        assert speed == pytest.approx(rig.plant[0].v * rig.plant[0].counts_rad, abs=500)
        assert position > last
        last = position
