"""What goes through PDOs: the limit cycle on the bus, friction identified and compensated, hold and
stroke; Figs. 12 to 14.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.figures.rig import (
    write_bus_figure,
    write_fig12,
    write_fig13,
    write_fig14,
    write_map,
    write_stick_figure,
)
from coulombus.analysis.rig.friction_study import EXPERIMENT, friction_study
from coulombus.analysis.rig.hold import hold_study
from coulombus.analysis.rig.maps import oscillation_map
from coulombus.analysis.rig.through_bus import BENCH_HARDWARE, bus_cycle, through_bus
from coulombus.analysis.theory.karnopp import karnopp_study
from coulombus.analysis.theory.orbits import orbits
from coulombus.analysis.theory.parameters import Parameters
from coulombus.cli.main import main
from coulombus.lab.simulate import simulate
from coulombus.recording.friction.identify import identify
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import FRAME

PNG, SVG = b"\x89PNG", b"<?xml"


@pytest.fixture(scope="module")
def cycles():
    return through_bus()


@pytest.fixture(scope="module")
def friction():
    return friction_study()


@pytest.fixture(scope="module")
def hold():
    return hold_study()


# the limit cycle through the bus


@pytest.mark.thorough
@pytest.mark.parametrize(("actuation", "frequency"), [("next_sync", 125.0), ("on_reception", 500 / 3)])
def test_the_limit_cycle_on_the_bus_is_that_of_the_delayed_loop(cycles, actuation, frequency):
    found = next(c for c in cycles if c.actuation == actuation and c.hardware == "rig paper")
    assert found.frequency_Hz == pytest.approx(frequency, rel=1e-4)  # exact orbits of 8 and of 6 samples
    assert found.loop_frequency_Hz == pytest.approx(frequency, rel=1e-4)
    assert found.frequency_Hz == pytest.approx(1 / (4 * (1e-3 + found.delay_s)), rel=0.08)  # describing function


def test_next_sync_is_one_cycle_and_on_reception_is_what_the_frames_need(cycles):
    synced, soon = cycles[:2]
    assert synced.delay_s == pytest.approx(1e-3, abs=1e-12)
    assert synced.delay_range_s == pytest.approx((1e-3, 1e-3), abs=1e-12)  # no jitter
    # SYNC ... three TPDOs and two RPDOs of 1 Mbit/s: about 400 bits
    assert 0.3e-3 < soon.delay_range_s[0] <= soon.delay_s <= soon.delay_range_s[1] < 0.5e-3


@pytest.mark.thorough
def test_the_delay_of_the_stamps_is_the_plants(tmp_path):
    """The motor's true torque changes its sign that long after the SYNC at which it was decided."""
    from coulombus.analysis.rig.through_bus import loop_delay
    from coulombus.recording.reading import read

    for actuation in ("next_sync", "on_reception"):
        record, truth = tmp_path / f"{actuation}.pcapng", tmp_path / f"{actuation}.npz"
        rig = load_rig("paper").variant('phase=[{kind="rest", duration_s=2.5}]', f"bus.actuation={actuation}")
        simulate(rig, "active", 2.4, record=record, truth=truth)
        recording = read(record)
        stated = loop_delay(recording, 2.0, 2.3).median_s
        with np.load(truth) as file:
            t, torque = file["t_s"], file["motor_Nm"]
        changed = t[1:][np.diff(np.sign(torque)) != 0]
        changed = (
            changed[(changed > 2.0) & (changed < 2.3)] - rig.one_axis().simulation.plant.step_s
        )  # a row is the step that ends there
        sync = recording.t_s[recording.frames["can_id"] == 0x80]
        since = changed - sync[np.searchsorted(sync, changed) - 1]
        apart = (
            since - stated + 0.5e-3
        ) % 1e-3 - 0.5e-3  # whole cycles are not told apart here, the limit cycle's frequency does
        assert len(apart) > 50
        assert abs(np.median(apart)) < 2e-5


def test_with_the_benchs_encoder_and_lag_it_is_not_on_the_curve(cycles):
    for ideal, coarse in zip(cycles[:2], cycles[2:], strict=True):
        assert coarse.hardware == BENCH_HARDWARE
        assert coarse.actuation == ideal.actuation
        assert 0 < coarse.frequency_Hz < 0.6 * ideal.frequency_Hz
        assert coarse.amplitude_m_s > 2 * ideal.amplitude_m_s
        counts = coarse.v_m_s * 1e-3 / coarse.count_m
        assert np.max(np.abs(counts - np.rint(counts))) < 1e-6
        assert np.mean(counts == 0) > 0.5  # a relay with a dead zone


# identification


@pytest.mark.thorough
def test_friction_identified_compensated_and_identified_again(friction):
    assert friction.coulomb_before_Nm == pytest.approx(0.14, abs=0.001)
    assert abs(friction.coulomb_after_Nm) <= 0.005
    assert friction.viscous_Nms_rad == pytest.approx(0.005, abs=5e-4)
    assert friction.compensation_Nm == pytest.approx(0.97 * friction.coulomb_before_Nm)
    for run in (friction.before, friction.after):
        assert run.coil_off
        assert run.device.coulomb_Nm.value == pytest.approx(0.14, abs=0.001)  # the motor's torque told
        assert run.felt.inertia_kg_m2.value == pytest.approx(2.5e-3, rel=0.05)
        assert run.felt.stribeck_Nm is None  # the plant has none
        assert run.felt.inertia_kg_m2.low * 0.999 < 2.5e-3 < run.felt.inertia_kg_m2.high * 1.001
    interval = friction.before.felt.coulomb_Nm
    assert interval.value == pytest.approx(0.14, abs=2e-4)
    assert interval.high - interval.low < 4e-4
    json.dumps(friction.as_dict(), allow_nan=False)


def test_identify_tells_what_a_recording_lacks(tmp_path):
    path, rig = tmp_path / "torn.pcapng", load_rig("bench")
    texts = {"rig.toml": rig.effective(), **rig.eds_texts}
    with PcapngWriter(path, attachments={name: text.encode() for name, text in texts.items()}) as writer:
        writer.write(np.zeros(2, FRAME))
    path.write_bytes(path.read_bytes()[:-5])
    told = CliRunner().invoke(main, ["identify", str(path)])
    assert told.exit_code == 1
    assert "the last block is unfinished: 43 bytes were left out" in told.stderr


@pytest.mark.thorough
def test_identify_on_the_command_line(tmp_path):
    still, moved, plot = tmp_path / "still.pcapng", tmp_path / "moved.pcapng", tmp_path / "friction.png"
    simulate("bench", "hybrid", 0.05, record=still)
    simulate("bench", "active", 13.0, record=moved)
    runner = CliRunner()
    refused = runner.invoke(main, ["identify", str(still)])
    assert refused.exit_code == 1
    assert "samples slide" in refused.output
    told = runner.invoke(main, ["identify", str(moved), "--json", "--figure", str(plot)])
    assert told.exit_code == 0
    found = json.loads(told.stdout)
    # at one speed, 2 rad/s, the viscous 0.01 Nm count to Coulomb's; the motor's torque is known, so
    # its chatter is too
    assert found["viscous_Nms_rad"] is None
    assert found["device"]["coulomb_Nm"] == pytest.approx(0.14 + 0.01, abs=1e-3)
    assert found["coulomb_Nm"] == pytest.approx(1.0, abs=0.1)  # what is displayed
    assert found["coulomb_Nm_ci95"][0] < found["coulomb_Nm"] < found["coulomb_Nm_ci95"][1]
    assert plot.read_bytes().startswith(PNG)
    text = runner.invoke(main, ["identify", str(moved)])
    assert "the device's own" in text.output
    assert identify(moved).as_dict() == found


def test_samples_in_which_the_sign_check_drives_are_not_fitted(tmp_path):
    """The device has 0.20 Nm, and the motor of the sign check moves it: fitted with it, it was
    0.2145 Nm, and Stribeck's.
    """
    path = tmp_path / "run.pcapng"
    values = ("compensation=0.0", "motor_limit_Nm=0.24", "F_s_Nm=0.0", "F_d_Nm=0.0")
    rig = load_rig("bench").variant(
        f"phase=[{EXPERIMENT}]",
        "plant.coulomb_Nm=0.12",
        "mechanics.friction_Nm=0.2",
        *(f"mode.hybrid.{value}" for value in values),
    )
    assert simulate(rig, "hybrid", 11.4, record=path).trip is None
    found = identify(path)
    for fit in (found.felt, found.device):
        assert fit.coulomb_Nm.value == pytest.approx(0.20, abs=5e-4)
        assert fit.coulomb_Nm.low < 0.20 < fit.coulomb_Nm.high
        assert fit.stribeck_Nm is None
    assert found.left_out["not in the display at full gain (arming, gain ramp, after the end)"] > 1000


@pytest.mark.thorough
def test_more_friction_than_believed_is_identified_and_compensated():
    found = friction_study(load_rig("bench").variant("plant.coulomb_Nm=0.12"))
    assert found.coulomb_before_Nm == pytest.approx(0.20, abs=1e-3)
    assert abs(found.coulomb_after_Nm) <= 0.01


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "status", "told"),
    [
        (
            ("analyse", "hold", "--set", "plant.coulomb_Nm=0.12"),
            7,
            "identify first: mechanics.friction_Nm is 0.14 Nm",
        ),
        (("analyse", "hold", "--set", "mode.hybrid.F_s_Nm=0", "--set", "mode.hybrid.F_d_Nm=0"), 3, "set it above 0"),
        (("analyse", "--set", "limits.travel_rad=0.5"), 7, "identification experiment (before compensation)"),
    ],
)
def test_a_trip_in_a_study_is_told_with_its_exit_status(arguments, status, told):
    refused = CliRunner().invoke(main, list(arguments))
    assert refused.exit_code == status
    assert isinstance(refused.exception, SystemExit)  # no traceback
    assert told in refused.stderr


# hold, stroke, stick entry


def test_active_oscillates_and_hybrid_holds_still_with_the_papers_values(hold):
    active, hybrid = hold.row("active"), hold.row("hybrid")
    assert (active.K_p_Nm_rad, active.F_s_Nm, active.F_d_Nm) == (100.0, 1.2, 1.0)
    assert (hybrid.K_p_Nm_rad, hybrid.F_s_Nm, hybrid.F_d_Nm) == (10000.0, 3.5, 3.0)
    assert active.hold_velocity_rms_rad_s == pytest.approx(0.5, abs=0.2)
    assert hybrid.hold_velocity_rms_rad_s == 0.0
    assert hybrid.hold_counts_p2p == 0
    assert hybrid.hold_push_Nm > 0.5 * 3.5
    json.dumps(hold.as_dict(), allow_nan=False)


def test_the_stick_phase_decides_when_a_fast_push_breaks_away(hold):
    held, spring, printed = (
        hold.row("hybrid", *way) for way in (("continuous", "hold"), ("continuous", "spring"), ("paper", "spring"))
    )
    # everything at the handle: F_s, the brake's off-state and the device's friction, less what is
    # compensated in slip
    assert 1.0 <= held.fast.share_of_F_s <= 1.15
    assert held.fast.crept_rad == 0.0
    assert printed.fast.share_of_F_s < 0.3 < 0.9 < spring.fast.share_of_F_s <= held.fast.share_of_F_s
    assert printed.fast.crept_rad > 5e-3
    for row in (held, spring, printed):
        assert 1.0 <= row.slow.share_of_F_s <= 1.1  # slow enough, all three hold
    assert held.slow.crept_rad == 0.0
    assert spring.slow.crept_rad > 0.0
    assert held.stick_velocity_rms_rad_s == 0.0


# Fig. 12


def test_fig_12_saturates_and_the_literal_maximum_does_not_rest():
    data = karnopp_study()
    assert np.all(data.corrected_rad == 0.0)
    assert np.ptp(data.printed_rad) > 0.01
    assert np.sum(np.diff(np.sign(np.diff(data.printed_rad, 2))) != 0) > 20  # kicked again and again
    assert np.all(np.abs(data.corrected_Nm) <= data.F_s_Nm)
    assert data.corrected_Nm == pytest.approx(np.clip(data.load_Nm, -1.2, 1.2))
    assert data.printed_Nm == pytest.approx(np.maximum(data.load_Nm, 1.2))
    inside = np.abs(data.v_rad_s) <= data.band_rad_s + 1e-12
    assert np.all(np.isnan(data.slip_Nm) == inside)
    assert data.slip_Nm[~inside] == pytest.approx(np.sign(data.v_rad_s[~inside]))
    assert data.band_rad_s == pytest.approx(0.16, abs=1e-4)


@pytest.mark.thorough
def test_figures_are_written_and_are_the_same_bytes_again(tmp_path, cycles, friction, hold):
    small = {
        "operator_inertia_kg_m2": np.geomspace(3e-4, 0.05, 4),
        "operator_damping_Nms_rad": np.geomspace(0.02, 10.0, 4),
        "delay_s": [0.0, 1e-3],
    }
    found = oscillation_map(small)
    directory = tmp_path / "a"
    written = (
        *(*write_fig12(directory), *write_map(directory, found), *write_fig14(directory, hold)),
        *write_fig13(directory, friction),
        *write_stick_figure(directory, hold),
        *write_bus_figure(directory, cycles),
    )
    assert len(written) == 12
    for path in written:
        assert path.read_bytes().startswith(PNG if path.suffix == ".png" else SVG)
    again = (*write_fig12(tmp_path / "b"), *write_map(tmp_path / "b", found), *write_fig14(tmp_path / "b", hold))
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in written[: len(again)]]
    with pytest.raises(ValueError, match="have both among the axes"):
        write_map(tmp_path, oscillation_map({"delay_s": [0.0]}))


@pytest.mark.parametrize(("cycles", "frequency"), [(2, 250 / 3), (3, 62.5)])
def test_a_delay_of_whole_cycles_gives_one_of_the_predicted_orbits_through_the_bus(cycles, frequency):
    rig = load_rig("paper").variant(f"bus.delay_cycles={cycles}")
    found = bus_cycle(rig, "paper", settle_s=1.5, window_s=1.0)
    assert found.delay_s == pytest.approx(cycles * 1e-3, abs=1e-9)
    assert found.loop_frequency_Hz == pytest.approx(frequency, rel=1e-3)
    exact = orbits(Parameters(delay_s=found.delay_s))
    assert frequency == pytest.approx(exact.found[0].frequency_Hz)
    nearest = min(exact.found, key=lambda orbit: abs(orbit.frequency_Hz - found.frequency_Hz))
    assert found.frequency_Hz == pytest.approx(nearest.frequency_Hz, rel=0.005)
    assert nearest.stable
    assert 60 < nearest.frequency_Hz < 85
