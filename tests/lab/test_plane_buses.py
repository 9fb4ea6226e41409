"""An arm with a bus for each joint, in one cycle of 1 kHz: virtual time, recordings, replays, a bus that is lost."""

from __future__ import annotations

import re
import socket
import threading

import numpy as np
import pytest

from coulombus.eds.cia301 import CobId
from coulombus.host.run.real_run import real_run
from coulombus.host.run.run import Outputs, Run
from coulombus.lab.replay.host_replay import host_replay
from coulombus.lab.replay.virtual_replay import virtual_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.buses import bus_addresses
from coulombus.rigs.overrides import shared_machine
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.can_bus.records import STATION_MASK
from coulombus.sim_bus.faults.fault_file import FaultError
from coulombus.sim_bus.server.clients import STATION
from coulombus.sim_bus.server.rig_server import SimServer
from plane_buses import ONE_CYCLE

SYNC = int(CobId.SYNC)


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The packaged arm's schedule on two buses, and its recording."""
    path = tmp_path_factory.mktemp("buses") / "two.pcapng"
    return simulate("plane", "hybrid", 8.0, seed=1, overrides=ONE_CYCLE, record=path), path


def test_the_arm_displays_friction_at_1_kHz(shown):
    result, _ = shown
    assert (result.trip, result.period_ns, result.lost_pdos) == (None, 1_000_000, 0)
    assert [axis["hold_counts_p2p"] for axis in result.axes.values()] == [0, 0]
    figures = result.plane
    assert figures["angle_error_deg"]["median"] <= 2.0
    assert figures["angle_error_deg"]["p95"] <= 12.0
    assert abs(figures["force_ratio"] - 1.0) <= 0.02
    assert figures["force_ratio_p95"] <= 0.05


def test_each_bus_has_its_own_frames_and_sync_at_the_same_instant(shown):
    recording = read(shown[1])
    frames, channels = recording.frames, np.array(recording.capture.channels)
    on_bus = channels[frames["source"]]
    assert set(on_bus) == {"a", "b"}
    nodes = {bus: set((frames["can_id"][on_bus == bus] & 0x7F).tolist()) - {0, 127} for bus in ("a", "b")}
    assert nodes == {"a": {1, 2}, "b": {3, 4}}
    syncs = [frames["t_ns"][(on_bus == bus) & (frames["can_id"] == SYNC)] for bus in ("a", "b")]
    assert np.array_equal(*syncs)


@pytest.mark.thorough
def test_both_replays_of_two_buses_agree(shown):
    _, path = shown
    assert host_replay(path).difference is None
    assert virtual_replay(path).identical


def test_the_same_seed_gives_the_same_bytes(shown, tmp_path):
    again = tmp_path / "again.pcapng"
    simulate("plane", "hybrid", 8.0, seed=1, overrides=ONE_CYCLE, record=again)
    assert again.read_bytes() == shown[1].read_bytes()


@pytest.mark.thorough
def test_a_wrong_set_point_on_the_second_bus_is_found_by_the_replay(shown, tmp_path):
    data, broken = bytearray(shown[1].read_bytes()), tmp_path / "broken.pcapng"
    packets = [found.end() for found in re.finditer(rb"\x00\x00\x02\x03\x04\x00\x00\x00", data)]
    assert len(packets) == np.count_nonzero(read(shown[1]).frames["can_id"] == 0x203)
    data[packets[6000] + 2] ^= 1  # 6071h
    broken.write_bytes(data)
    difference = host_replay(broken).difference
    assert difference is not None
    assert difference.name == "elbow.motor.RPDO1"


def test_faults_strike_an_arm_of_one_bus_only(tmp_path):
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "noise"\nbus = "a"\nrate = 1e-4\n')
    with pytest.raises(FaultError, match=r"faults strike a host's only bus, and the arm has the buses a, b"):
        simulate("plane", "hybrid", 1.0, overrides=ONE_CYCLE, faults=faults)


@pytest.mark.thorough
@pytest.mark.real_time
@pytest.mark.patient
def test_a_lost_bus_trips_both_joints_and_the_other_brake_is_ramped_off(private_sockets, tmp_path):
    rig = load_rig("plane", (*ONE_CYCLE, "bus.period_s=0.005", "bus.tpdo_window_s=4e-3"))
    rig = rig.variant(*shared_machine(rig))
    server = SimServer(rig, tuple(bus_addresses(rig).values()))
    thread = threading.Thread(target=lambda: server.run(120))
    thread.start()
    path, cut = tmp_path / "lost.pcapng", []

    def cut_second_bus(t_s, axes):
        if t_s > 4.0 and not cut:
            halves = server.world.bus[0].stations["half"]
            for slot, client in list(server._admission.sockets.items()):
                if halves[STATION + slot & STATION_MASK] == 1:
                    client.shutdown(socket.SHUT_RDWR)
                    cut.append(slot)

    try:
        result = real_run(Run(rig, "hybrid", 30.0, outputs=Outputs(record=path)), progress=cut_second_bus)
    finally:
        server.stop()
        thread.join()
        server.close()
    assert cut, (result.trip, result.cycles)
    assert result.exit_status == 7
    assert result.trip.split(": ")[1] == "BUS_LOST"
    assert f"{bus_addresses(rig)['b']}" in result.trip
    assert all(axis["trip"].startswith("BUS_LOST") for axis in result.axes.values())
    assert result.sync_skew_us is not None
    recording = read(path)
    trip_s = next(t_s for t_s, text in recording.markers if text.startswith("trip"))
    brake = recording["shoulder.brake.setpoint_Nm"]
    ramp = brake.values[brake.t_s > trip_s]
    assert len(ramp) > 100  # cycles after the trip, on the bus that is left
    assert ramp[-1] == 0.0
    assert np.diff(ramp).max() <= 0.0
    assert host_replay(path).difference is None
