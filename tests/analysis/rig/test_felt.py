"""The display's error at the hand, and a compensation that would drive: by the plant's truth."""

from __future__ import annotations

import numpy as np
import pytest

from cases import thorough
from coulombus.analysis.rig import display_errors
from coulombus.analysis.rig.display_errors import Felt, FeltStudy, broke_away, felt_control, iron_of, slid
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import load_rig

KICK = (
    'phase=[{kind="rest", duration_s=2.0}, {kind="file", duration_s=5.0, '
    "t_s=[0.0, 0.02, 0.04, 0.06, 5.0], torque_Nm=[0.0, 0.25, 0.25, 0.0, 0.0]}]"
)


@pytest.fixture(scope="module")
def bench():
    return load_rig("bench")


@pytest.mark.parametrize("rate", [1.0, *thorough(30.0, -30.0)])
@pytest.mark.parametrize("F_s", [1.0, 4.0])
def test_the_handle_breaks_away_at_F_s_to_2_percent(bench, F_s, rate):
    assert broke_away(felt_control(bench), F_s, rate) == pytest.approx(F_s, rel=0.02)


def test_with_the_papers_level_the_devices_friction_is_felt_beside_it(bench):
    assert broke_away(bench, 1.0, 1.0) == pytest.approx(1.14, abs=0.01)


def test_sliding_is_felt_as_F_d_to_3_percent_from_20_mrad_s_on(bench):
    for speed, torque in slid(felt_control(bench), 1.0, (0.02, 0.1, 1.0)):
        assert abs(speed) >= 0.02
        assert torque == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize("F_s", [1.0, 4.0])
def test_a_friction_that_falls_is_felt_as_F_d_however_slow(bench, F_s):
    for speed, torque in slid(felt_control(bench), 0.75 * F_s, (0.02, 1.0), F_s_Nm=F_s):
        assert abs(speed) >= 0.02
        assert torque == pytest.approx(0.75 * F_s, rel=0.03)


@pytest.mark.parametrize("window", [1, 6])
def test_a_speed_within_the_band_is_held_as_stick(bench, window):
    """2 counts of 80 urad in 6 cycles of 1 ms are 0.027 rad/s."""
    rig = felt_control(bench).variant(f"law.velocity_window_cycles={window}")
    for speed, _ in slid(rig, 1.5, (0.02,), F_s_Nm=2.0):
        assert speed == pytest.approx(0.0, abs=1e-6)


def test_the_study_sees_that_the_papers_control_holds_slow_sliding(bench, monkeypatch):
    monkeypatch.setattr(display_errors, "SPEEDS_RAD_S", (0.05,))
    rows = {
        name: list(display_errors.falling_rows(rig, name, 2.0, 0))
        for name, rig in (("brake", bench), ("felt", felt_control(bench)))
    }
    assert all(row.error >= 1 / 3 - 1e-9 for row in rows["brake"])
    assert all(abs(row.error) < 0.01 for row in rows["felt"])
    assert [row.of for row in rows["felt"]] == [0.05, -0.05]


IRON = (0.1, 0.4), (0.2, 0.2)


@pytest.mark.parametrize("mode", ["passive", "hybrid"])
@pytest.mark.parametrize("rate", [30.0, -30.0])
def test_a_brake_with_hysteresis_breaks_away_at_F_s_when_its_iron_is_known(bench, mode, rate):
    truth = bench.variant(*iron_of("plant", *IRON))
    assert broke_away(felt_control(truth), 1.0, rate, mode=mode) == pytest.approx(1.0, rel=0.02)
    unknown = felt_control(bench).variant(*iron_of("plant", *IRON))
    assert broke_away(unknown, 1.0, rate, mode=mode) < 0.93


def test_sliding_in_passive_is_felt_as_F_d_through_a_hysteresis(bench):
    truth = bench.variant(*iron_of("plant", *IRON))
    for speed, torque in slid(felt_control(truth), 1.0, (0.021, 1.0), mode="passive"):
        assert abs(speed) >= 0.02
        assert torque == pytest.approx(1.0, rel=0.03)


def kicked(bench, belief_Nm, tmp_path, *more, mode="hybrid"):
    """Return the run and the handle's speed [rad/s] in the kick's phase, of a hand that kicks and lets go."""
    rig = bench.variant(
        KICK,
        f"mechanics.friction_Nm={belief_Nm}",
        f"mode.hybrid.motor_limit_Nm={1.2 * belief_Nm}",
        "mode.hybrid.F_s_Nm=0.0",
        "mode.hybrid.F_d_Nm=0.0",
        *(f"operator.{name}=0.0" for name in ("inertia_kg_m2", "damping_Nms_rad", "stiffness_Nm_rad", "tremor_Nm")),
        *more,
    )
    result = simulate(rig, mode, 7.0, truth=tmp_path / "truth.npz", force=True)
    with np.load(tmp_path / "truth.npz") as truth:
        speed = np.abs(truth["speed_rad_s"])
    return result, speed


@pytest.mark.parametrize("share", [1.11, 1.23, 1.43])
def test_a_kicked_handle_stops_whatever_friction_is_believed(bench, share, tmp_path):
    result, speed = kicked(bench, 0.14 * share, tmp_path)
    assert result.trip is None
    assert speed.max() > 2.0
    assert speed[-40_000:].max() == 0.0  # 2 s
    assert result.counters["withheld_compensation"] > 0
    assert any("withheld_compensation" in text for text in result.remarks)


def test_without_the_observer_it_turns_for_ever(bench, tmp_path):
    result, speed = kicked(bench, 0.14 * 1.11, tmp_path, "limits.passivity_J=1e6")
    assert result.trip is None
    assert speed[-100_000:-30_000].min() > 1.0


@pytest.mark.parametrize("mode", ["active", "hybrid"])
def test_no_kicked_handle_turns_for_ever_whatever_is_believed(bench, mode, tmp_path):
    rng = np.random.default_rng(15)
    for seed in range(4):
        friction, viscous, inertia = rng.uniform((0.08, 0.001, 0.0015), (0.2, 0.01, 0.005))
        too_much = rng.uniform(1.1, 1.4, 3)
        kick_Nm = friction + 2.0 * inertia / 0.05
        rig = bench.variant(
            f"plant.coulomb_Nm={friction - 0.08}",
            f"plant.viscous_Nms_rad={viscous}",
            f"plant.inertia_kg_m2={inertia}",
            f"mechanics.friction_Nm={friction * too_much[0]}",
            f"mechanics.viscous_Nms_rad={viscous * too_much[1]}",
            f"mechanics.inertia_kg_m2={inertia * too_much[2]}",
            f"mode.{mode}.F_s_Nm=0.0",
            f"mode.{mode}.F_d_Nm=0.0",
            f"mode.{mode}.motor_limit_Nm={1.2 * friction * too_much[0]}",
            *(f"operator.{name}=0.0" for name in ("inertia_kg_m2", "damping_Nms_rad", "stiffness_Nm_rad", "tremor_Nm")),
            'phase=[{kind="rest", duration_s=2.0}, {kind="file", duration_s=6.0, t_s=[0.0, 0.01, 0.06, 6.0], '
            f"torque_Nm=[0.0, {kick_Nm}, 0.0, 0.0]}}]",
        )
        result = simulate(rig, mode, 8.0, truth=tmp_path / "truth.npz", seed=seed, force=True)
        with np.load(tmp_path / "truth.npz") as truth:
            speed = np.abs(truth["speed_rad_s"])
        assert result.trip is None
        assert speed.max() > 0.5
        assert speed[-20_000:].max() == 0.0  # 1 s
        assert result.counters["withheld_compensation"] > 0


def test_a_handle_that_swings_in_a_detent_comes_to_rest_on_the_motor(bench, tmp_path):
    detents = ('law.function="detent"', "law.detent.A_Nm=0.2", "law.detent.F_c_Nm=0.0", "law.detent.period_rad=1.0")
    result, speed = kicked(bench, 0.17, tmp_path, *detents, mode="active")
    assert result.trip is None
    assert speed.max() > 1.0
    assert speed[-20_000:].max() == 0.0
    assert result.counters["withheld_compensation"] > 0


def test_a_right_belief_has_nothing_withheld_though_the_brake_chatters(bench):
    rig = felt_control(bench).variant('law.function="regularised"')
    assert simulate(rig, "hybrid", 13.0).counters["withheld_compensation"] == 0


@pytest.mark.parametrize("law", ["karnopp", "coulomb"])
def test_the_limit_cycle_on_the_motor_has_nothing_withheld(bench, law):
    result = simulate(bench.variant(f"law.function={law!r}"), "active", 13.0, measured=True)
    assert result.hold_velocity_rms_rad_s > 0.1
    assert result.counters["withheld_compensation"] == 0


def test_a_right_belief_has_nothing_withheld(bench, tmp_path):
    result, _ = kicked(bench, 0.14, tmp_path)
    assert result.counters["withheld_compensation"] == 0


def test_the_worst_error_is_that_by_size():
    rows = tuple(Felt("felt", "sliding", 1.0, 2.0, felt) for felt in (2.01, 1.9))
    study = FeltStudy("bench", rows)
    assert study.worst() == {("felt", "sliding"): pytest.approx(0.05)}
    assert [row["error"] for row in study.as_dict()["rows"]] == pytest.approx([0.005, -0.05])


@pytest.mark.parametrize(
    ("entry", "taps", "rms"),
    [
        ("continuous", "[0.6, 2.1]", 0.54),
        ("continuous", "[]", 0.031),
        ("paper", "[0.6, 2.1]", 0.035),
        ("paper", "[]", 0.031),
    ],
)
def test_the_active_display_oscillates_by_a_tap_and_the_continuous_entry(bench, entry, taps, rms):
    rig = bench.variant(f'law.stick_entry="{entry}"', f"phase.1.taps_s={taps}")
    found = simulate(rig, "active", 5.0, measured=True).hold_velocity_rms_rad_s
    assert found == pytest.approx(rms, rel=0.03)
