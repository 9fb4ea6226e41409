"""The whole stack in virtual time: bring-up, arming, display, safe end - over real PDOs on the
exact bus.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from coulombus.host.errors import DeviceMismatch, NodeMissing
from coulombus.lab.set_up import set_up
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import FaultError
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.wire.bits import frame_bits
from coulombus.wire.frame import data_bytes
from places import ROOT


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One full run of each demo mode, with truth."""
    directory = tmp_path_factory.mktemp("runs")
    results = {}
    for mode in ("active", "hybrid", "passive"):
        record, truth = directory / f"{mode}.pcapng", directory / f"{mode}.npz"
        result = simulate("bench", mode, 13.0, record=record, truth=truth)
        with np.load(truth) as file:
            results[mode] = (result, read(record), dict(file))
    return results


def test_active_oscillates_in_the_hold(runs):
    result, _, _ = runs["active"]
    assert result.trip is None
    assert 0.1 <= result.hold_velocity_rms_rad_s <= 3.0
    assert result.torque_flips_per_s >= 20
    assert 20 <= result.hold_peak_Hz <= 200


def test_hybrid_holds_still_under_a_push(runs):
    result, _, _ = runs["hybrid"]
    assert result.trip is None
    assert result.hold_counts_p2p <= 2
    assert result.hold_velocity_rms_rad_s <= 0.005
    assert result.hold_push_Nm >= 0.5 * 3.5
    assert result.stick_velocity_rms_rad_s <= 0.005


@pytest.mark.parametrize("mode", ["active", "hybrid", "passive"])
def test_every_cycle_was_kept(runs, mode):
    result, _, _ = runs[mode]
    assert result.cycles == pytest.approx(13_000, abs=2)
    assert result.period_ns == 1_000_000
    assert result.lost_pdos == 0
    assert result.missed_deadlines == 0
    assert result.wakeup_us is None
    assert result.cpu_us_per_cycle is None
    json.dumps(dataclasses.asdict(result), allow_nan=False)


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["active", "hybrid", "passive"])
def test_truth_balances_and_neither_brake_nor_friction_pushes(runs, mode):
    _, _, truth = runs[mode]
    t, v = truth["t_s"], truth["speed_rad_s"]
    assert np.all(np.diff(t) == pytest.approx(50e-6))
    rig = load_rig("bench")
    axis = rig.one_axis()
    plant = axis.simulation.plant
    work = sum(truth[f"{name}_work_J"] for name in ("operator", "motor", "brake", "friction"))
    lost = np.concatenate(([0.0], np.cumsum(plant.viscous_Nms_rad * 0.5 * (v[1:] ** 2 + v[:-1] ** 2) * np.diff(t))))
    kinetic = 0.5 * plant.inertia_kg_m2 * v**2
    scale = np.sum(np.abs(truth["operator_Nm"] * v)) * 50e-6
    assert np.max(np.abs(work - lost - kinetic)) <= 0.01 * scale
    for name in ("brake", "friction"):
        assert np.all(truth[f"{name}_Nm"] * v <= 0)
        assert np.all(np.diff(truth[f"{name}_work_J"]) <= 0)


def test_the_recording_shows_what_was_true(runs):
    _, recording, truth = runs["hybrid"]
    angle = recording["motor.position_rad"]
    true = np.interp(angle.t_s, truth["t_s"], truth["angle_rad"])
    count = 2 * np.pi / (8192 * 9.587)
    # a TPDO is on the bus up to half a millisecond after the encoder was read at SYNC
    assert np.max(np.abs(angle.values - true)) <= 2.5 * 0.6e-3 + count
    handle = recording["brake.handle_torque_Nm"]
    still = np.abs(np.interp(handle.t_s, truth["t_s"], truth["speed_rad_s"])) == 0
    felt = np.interp(handle.t_s, truth["t_s"], truth["operator_Nm"])
    assert np.median(np.abs(handle.values - felt)[still]) < 0.01


def test_frames_do_not_overlap_and_last_as_long_as_their_bits(runs):
    _, recording, _ = runs["hybrid"]
    frames = recording.frames[:4000]
    ends = frames["t_ns"]
    lasts = [frame_bits(int(f["can_id"]), data_bytes(int(f["word"]), int(f["length"]))) * 1000 for f in frames[1:]]
    gaps = np.diff(ends)
    assert np.all(gaps >= np.array(lasts))
    assert np.any(gaps == np.array(lasts))  # and some follow each other without a pause


def test_markers_tell_the_phases(runs):
    _, recording, _ = runs["active"]
    texts = [text for _, text in recording.markers]
    assert texts == ["run active", "phase rest", "phase hold", "phase stroke", "phase end", "safe"]
    t = {text: t for t, text in recording.markers}
    assert t["phase hold"] - t["phase rest"] == pytest.approx(1.0, abs=2e-3)
    assert t["phase end"] - t["phase rest"] == pytest.approx(13.0, abs=2e-3)
    # the schedule starts when the drive says Operation Enabled
    status = recording["motor.statusword"]
    enabled = status.t_s[np.argmax(status.values.astype(int) & 0x6F == 0x27)]
    assert enabled == pytest.approx(t["phase rest"], abs=2e-3)


@pytest.mark.parametrize("mode", ["active", "hybrid", "passive"])
def test_the_motor_stays_within_its_limit_and_the_drive_has_it_too(runs, mode):
    _, recording, _ = runs[mode]
    limit = {"active": 1.5, "hybrid": 1.2 * 0.14, "passive": 0.0}[mode]
    target = recording["motor.target_torque_Nm"].values
    assert np.max(np.abs(target)) <= limit + 1e-9
    assert (np.max(np.abs(target)) > 0.5 * limit) or mode == "passive"


def test_same_seed_same_bytes_and_another_seed_other_bytes(tmp_path):
    paths = [tmp_path / name for name in ("a.pcapng", "b.pcapng", "c.pcapng")]
    results = [
        simulate("bench", "active", 2.0, record=path, seed=seed) for path, seed in zip(paths, (1, 1, 2), strict=True)
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert results[0].recording_sha256 == results[1].recording_sha256 != results[2].recording_sha256


def test_figures_are_null_without_markers_or_recording(tmp_path):
    result = simulate("bench", "hybrid", 0.5, record=tmp_path / "short.pcapng")
    assert result.hold_counts_p2p is None
    assert result.torque_flips_per_s is None
    assert simulate("bench", "hybrid", 0.5).recording is None


@pytest.mark.parametrize(("actuation", "frequency"), [("next_sync", 125.0), ("on_reception", 166.7)])
def test_the_papers_plant_chatters_at_its_delayed_limit_cycle(tmp_path, actuation, frequency):
    """Undelayed, the exact orbit is 4 samples long; a cycle of delay makes it 8, half a cycle 6
    (250, 125, 166.7 Hz).
    """
    overrides = ("phase.0.duration_s=4", f"bus.actuation={actuation}")
    result = simulate("paper", "active", 4.0, record=tmp_path / "paper.pcapng", overrides=overrides)
    assert result.trip is None
    angle = read(tmp_path / "paper.pcapng")["motor.position_rad"]
    v = np.diff(angle.values[(angle.t_s > angle.t_s[0] + 2.5) & (angle.t_s < angle.t_s[0] + 3.9)])
    spectrum = np.abs(np.fft.rfft(v * np.hanning(len(v))))
    assert np.fft.rfftfreq(len(v), 1e-3)[np.argmax(spectrum)] == pytest.approx(frequency, abs=1.0)


def test_on_reception_actuates_sooner_and_still_works(tmp_path):
    result = simulate("bench", "hybrid", 6.0, record=tmp_path / "r.pcapng", overrides=("bus.actuation='on_reception'",))
    assert result.trip is None
    assert result.hold_counts_p2p <= 2


def test_500_kbit_is_refused_before_arming():
    with pytest.raises(DeviceMismatch, match="does not fit"):
        simulate("bench", "hybrid", 1.0, overrides=("bus.bitrate_bit_s=500000",))


@pytest.mark.parametrize(
    ("part", "key"), [("motor", "vendor_id"), ("motor", "product_code"), ("brake", "product_code")]
)
def test_wrong_identity_is_refused_and_named(part, key):
    with pytest.raises(DeviceMismatch, match=rf"{part}.*1018h.*0x0000.*rig file says 0x00000123"):
        simulate("bench", "hybrid", 1.0, overrides=(f"{part}.{key}=0x123",))


def test_a_missing_node_is_named():
    def unplug(world):
        world.at(500_000, lambda w: w.power_off(1))

    with pytest.raises(NodeMissing, match=r"brake \(node 2\) does not answer"):
        simulate("bench", "hybrid", 1.0, script=unplug)


def test_python_is_entered_for_services_only():
    """A steady second costs a handful of the kernel's exits."""
    world = VirtualRig(load_rig("bench"), "hybrid")
    set_up(world)
    world.start_host()
    world.wait_ns(2_000_000_000)
    before = sum(world.exits.values())
    world.wait_ns(1_000_000_000)
    assert sum(world.exits.values()) - before <= 10


@pytest.mark.thorough
def test_plain_python_gives_the_same_bytes_as_the_compiled_kernels(tmp_path):
    """The whole stack without the compiler: what is debugged there is what runs."""
    compiled = simulate("bench", "active", 0.2, record=tmp_path / "a.pcapng")
    code = f"from coulombus.lab.simulate import simulate; simulate('bench', 'active', 0.2, record={str(tmp_path / 'b.pcapng')!r})"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, timeout=300)
    assert compiled.trip is None
    assert (tmp_path / "a.pcapng").read_bytes() == (tmp_path / "b.pcapng").read_bytes()


def test_on_the_papers_rig_the_gain_is_1_before_the_hand_pushes(tmp_path):
    told = simulate("paper", "active", 2.1, record=tmp_path / "paper.pcapng").as_dict()
    assert 0.5 < told["full_gain_s"] < 2.0  # the first phase is a rest of 2 s


def test_a_fault_of_no_node_is_refused_before_an_old_recording_is_overwritten(tmp_path):
    record, truth, faults = tmp_path / "r.pcapng", tmp_path / "t.npz", tmp_path / "faults.toml"
    record.write_bytes(b"old")
    truth.write_bytes(b"old")
    faults.write_text('[[fault]]\nkind = "babble"\nnode = "nobody"\ncan_id = 100\n')
    with pytest.raises(FaultError, match="there is no node 'nobody'"):
        simulate("bench", "hybrid", 0.1, record=record, truth=truth, faults=faults, force=True)
    assert (record.read_bytes(), truth.read_bytes()) == (b"old", b"old")
