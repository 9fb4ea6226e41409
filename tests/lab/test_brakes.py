"""Brakes of other makers, armed: in virtual time, and in real time as processes on the built-in
bus.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from foreign_rigs import brake, drive, written
from real_bench import host, result, simulation

BUS = "coulombus:brakes"
RAW = {"404": 5200, "8ao": 12_000, "401": 6_000, "402": 1_500}
"""What a set-point of 3 Nm is, in the counts of each."""
BRAKES = pytest.mark.parametrize("kind", RAW)


def set_points(path, rig):
    """The brake's set-points of a recording [Nm], and their raw counts as they were on the wire."""
    recording = read(path, rig=rig)
    (pdo,) = (one for one in rig.pdos() if one.node == "brake" and one.layout.direction == "rpdo")
    k = next(k for k, one in enumerate(pdo.signals) if one.name == "brake.setpoint_Nm")
    entry, start = pdo.layout.entries[k], pdo.layout.starts[k]
    words = recording.frames["word"][recording.frames["can_id"] == pdo.layout.cob_id]
    return recording["brake.setpoint_Nm"].values, words >> start & (1 << entry.bits) - 1


@pytest.mark.thorough
@BRAKES
@pytest.mark.parametrize("motor", ["own", "D"])
def test_it_is_armed_and_brakes_by_its_own_counts(tmp_path, kind, motor):
    file, overrides = written(tmp_path, drive(motor), brake(kind))
    rig = load_rig(str(file), overrides)
    done = simulate(rig, "hybrid", 2.0, record=tmp_path / "r.pcapng", truth=tmp_path / "t.npz")
    assert (done.trip, done.exit_status) == (None, 0)
    torque, raw = set_points(tmp_path / "r.pcapng", rig)
    assert RAW[kind] in raw
    assert raw[-1] == 0
    assert np.max(torque) <= 4.5
    with np.load(tmp_path / "t.npz") as truth:
        assert np.max(np.abs(truth["brake_Nm"])) == pytest.approx(3.58, abs=0.02)  # F_s and the off-state torque


@pytest.mark.real_time
@pytest.mark.usefixtures("private_sockets")
@pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop")
@BRAKES
def test_it_is_armed_in_real_time(tmp_path, kind):
    file, overrides = written(tmp_path, drive("own"), brake(kind))
    record = tmp_path / "r.pcapng"
    rig = ("--rig", file)
    with (
        simulation(BUS, *rig, overrides=overrides),
        host(BUS, *rig, "--record", record, seconds=1.0, overrides=overrides) as run,
    ):
        status, data, err = result(run)
    assert status == 0, err
    assert data["trip"] is None
    assert data["cycles"] > 300
    _, raw = set_points(record, load_rig(str(file), overrides))
    assert RAW[kind] in raw
    assert raw[-1] == 0


@pytest.mark.parametrize(("gain", "trip"), [(1.0, None), (0.4, "HANDLE_TORQUE"), (1.8, "HANDLE_TORQUE")])
def test_a_wrong_belief_of_the_brake_is_noticed_by_the_transducer(tmp_path, gain, trip):
    file, overrides = written(tmp_path, drive("own"), brake("404"))
    done = simulate(load_rig(str(file), (*overrides, f"plant.brake_gain={gain}")), "hybrid", 3.0)
    assert (done.trip and done.trip.partition(":")[0]) == trip
