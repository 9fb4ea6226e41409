"""The demo's runs, its verdict, and what its picture shows."""

from __future__ import annotations

import re

import numpy as np
import pytest

from coulombus.lab.demo import real_demo
from coulombus.lab.demo.demo import DEMO_MODES, SAME, displays, run_demo
from coulombus.lab.demo.traces import BINS, DemoTraces, draw_traces, share_labels, traces
from coulombus.recording.pictures.style import figure
from coulombus.recording.reading import blocks
from coulombus.rigs.rig import load_rig

HOLD = 'kind="hold", duration_s=2.0, push_F_s=0.6, frequency_Hz=0.5, taps_s=[0.6], tap_Nm=0.5, tap_s=0.02'
STROKE = '{kind="stroke", duration_s=8.0, speed_rad_s=2.0, move_s=1.0, dwell_s=0.5}'
SCHEDULE = f'phase=[{{kind="rest", duration_s=1.0}}, {{{HOLD}}}]'


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    rig = load_rig("bench", (SCHEDULE,))
    return rig, run_demo(rig, folder), folder


def test_the_same_friction_is_displayed_by_both(shown):
    rig, demo, _ = shown
    assert list(demo.results) == [*DEMO_MODES, SAME, "passive"]
    same, active = (displays(rig)[name].rig.one_axis().mode for name in (SAME, "active"))
    assert (same["hybrid"].F_s_Nm, same["hybrid"].F_d_Nm) == (active["active"].F_s_Nm, active["active"].F_d_Nm)
    assert same["hybrid"].K_p_Nm_rad == rig.one_axis().mode["hybrid"].K_p_Nm_rad


def test_hybrid_holds_at_the_active_displays_friction(shown):
    _, demo, _ = shown
    (found,) = (one for one in demo.criteria if "at the active display's friction" in one.text)
    assert found.holds
    assert found.found == "0 counts"
    assert demo.results["active"].hold_counts_p2p > 1000


def test_a_rig_without_the_brake_alone_is_shown_without_it(tmp_path):
    text = load_rig("bench").text
    (tmp_path / "rig.toml").write_text(re.sub(r"\[mode\.passive\]\n(?:[^\[\n]+\n)+", "", text))
    assert list(displays(load_rig(tmp_path / "rig.toml"))) == [*DEMO_MODES, SAME]


def test_each_panel_says_what_it_displays(shown):
    rig, _, folder = shown
    for name, one in displays(rig).items():
        data = traces(blocks(folder / f"{name}.pcapng"), one.mode)
        friction = one.rig.one_axis().mode[one.mode]
        assert f"F_s = {friction.F_s_Nm:g} Nm, F_d = {friction.F_d_Nm:g} Nm" in data.title
        assert set(data.commands) == {"active": {"motor"}, "passive": {"brake"}}.get(one.mode, {"motor", "brake"})


def test_a_limit_cycle_is_the_band_that_it_fills(shown):
    _, _, folder = shown
    data = traces(blocks(folder / "active.pcapng"), "active")
    with figure(4, 4, 2) as (_, (torque, speed)):
        draw_traces(torque, speed, data, "active")
        (line,) = (line for line in torque.lines if line.get_label() == "motor, commanded")
        band = torque.collections[0]
    _, values = data.commands["motor"]
    drawn = band.get_paths()[0].vertices
    assert (drawn[:, 1].min(), drawn[:, 1].max()) == (values.min(), values.max())
    assert len(drawn) <= 2 * BINS + 3
    assert len(line.get_ydata()) <= BINS


def test_the_mean_is_drawn_over_the_band_of_a_limit_cycle():
    t_s = np.arange(20_000) * 1e-3
    slow = 0.3 * np.sin(t_s)
    none = np.zeros(0)
    data = DemoTraces(
        "a", t_s, slow, none, none, {"motor": (t_s, slow + np.where(np.arange(len(t_s)) % 2, 0.7, -0.7))}, ()
    )
    with figure(4, 4, 2) as (_, (torque, speed)):
        draw_traces(torque, speed, data, "active")
        share_labels(torque.figure, np.array([[torque], [speed]]))
    (line,) = (line for line in torque.lines if line.get_label() == "motor, commanded")
    x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    assert y == pytest.approx(0.3 * np.sin(x + 0.025), abs=0.02)
    assert torque.collections[0].get_paths()[0].vertices[:, 1].max() == pytest.approx(1.0, abs=1e-3)
    legend = [text.get_text() for text in torque.figure.legends[0].get_texts()]
    assert legend == ["motor, commanded", "hand, not measured", "band: smallest to largest; line: mean"]


@pytest.mark.parametrize(
    ("overrides", "seconds"),
    [
        ((), 1.0 + 4.0 + 2 * (1.0 + 1.0)),
        (("phase.2.duration_s=2.5",), 1.0 + 4.0 + 2.5),
        ((f"phase=[{STROKE}, {{{HOLD}}}]",), 8.0 + 2.0),
        ((f"phase=[{STROKE}, {STROKE}]",), 8.0 + 3.0),
        (("phase.0.duration_s=3.0", "phase.2.move_s=0.5"), 3.0 + 4.0 + 2 * (0.5 + 1.0)),
    ],
)
def test_a_display_in_real_time_shows_the_last_stroke_once_there_and_back(overrides, seconds):
    assert real_demo.shown_s(load_rig("bench", overrides)) == pytest.approx(seconds)


def test_without_a_stroke_the_whole_schedule_is_displayed():
    assert real_demo.shown_s(load_rig("bench", (SCHEDULE,))) == 3.0


def test_all_is_compiled_before_a_simulation_starts(monkeypatch, tmp_path):
    class Compiles(Exception):
        pass

    def warm_up(scope):
        assert scope == "run"
        raise Compiles

    monkeypatch.setattr(real_demo, "warm_up", warm_up)
    monkeypatch.setattr(real_demo, "SimProcess", None)
    with pytest.raises(Compiles):
        real_demo.run_real_demo(load_rig("bench"), "bench", tmp_path)
