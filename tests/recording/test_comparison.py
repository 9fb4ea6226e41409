"""Two recordings side by side, and recordings as tables and pictures."""

import numpy as np
import pytest

from bench_recording import MS, record
from coulombus.recording.comparison import compare, only_in
from coulombus.recording.extras import MissingExtra
from coulombus.recording.pictures.differences import draw_differences
from coulombus.recording.pictures.plot import (
    BINS,
    MOST_SAMPLES,
    Envelope,
    Trace,
    _manners,
    plot,
    save_picture,
    traces_of,
)
from coulombus.recording.pictures.style import QUANTITIES
from coulombus.recording.reading import blocks, read
from coulombus.recording.signals import Recording, UnknownSignal
from coulombus.recording.time_search import SpanError, parse_span
from coulombus.rigs.arguments import WrongCall


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Recording:
    return read(record(tmp_path_factory.mktemp("run") / "run.pcapng"))


def test_same_bytes_are_equal(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng"))
    assert (comparison.same_bytes, comparison.equal, comparison.remarks) == (True, True, ())


def test_the_same_run_at_another_time_is_equal(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", late=64 * MS))
    assert (comparison.same_bytes, comparison.equal) == (False, True)
    assert {signal.max for signal in comparison.signals} == {0.0}
    assert {signal.samples for signal in comparison.signals} == {400}


def test_one_sample_that_differs_is_found_with_its_time(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", push=50))
    assert not comparison.equal
    (other,) = (signal for signal in comparison.signals if not signal.equal)
    assert other.name == "brake.setpoint_Nm"
    assert other.max == pytest.approx(0.05)
    assert other.rms == pytest.approx(0.05 / np.sqrt(400))
    assert other.at_s == pytest.approx(0.153200007)
    assert other.phase == "hold"


@pytest.mark.parametrize(
    ("tolerances", "equal"),
    [
        ({"": 0.051}, True),
        ({"": 0.049}, False),
        ({"Nm": 0.049}, False),
        ({"Nm": 0.051}, True),
        ({"brake.setpoint_Nm": 0.051}, True),
        ({"rad": 0.0}, True),  # the others are not judged
        ({"Nm": 0.0, "brake.setpoint_Nm": 0.051}, True),
    ],
)
def test_signals_are_judged_by_their_tolerance(tmp_path, tolerances, equal):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", push=50), tolerances=tolerances)
    assert comparison.equal == equal


def test_a_run_that_is_shorter_is_not_equal_and_that_is_told(tmp_path):
    paths = record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", 300)
    comparison = compare(*paths)
    assert not comparison.equal
    assert any("phase hold: 0.39" in text and "0.29" in text for text in comparison.remarks)
    assert compare(*paths, tolerances={"Nm": 1e-9}).equal


def test_a_run_without_its_phases_is_told(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", 1), tolerances={"": 9.0})
    assert not comparison.equal
    assert "only one of the recordings has phases" in comparison.remarks


def test_a_signal_that_has_no_time_in_common_is_not_equal(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", 2), tolerances={"Nm": 9.0})
    assert not comparison.equal


def test_another_mode_is_told(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", mode="active"))
    assert "recordings of different modes: hybrid and active" in comparison.remarks


def test_another_rig_is_told(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", rig="paper"))
    assert "recordings of different rigs: bench and paper" in comparison.remarks


def test_of_many_signals_that_one_has_alone_a_few_are_named():
    assert only_in("a", list("wxyz")) == "only in a: w, x, y, z"
    assert only_in("a", list("uvwxyz")) == "only in a: u, v, w, x and 2 more"


def test_an_empty_recording_is_not_equal_to_another(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", 0))
    assert not comparison.equal
    assert any("it has no frame" in text for text in comparison.remarks)


def test_a_tolerance_of_nothing_is_told(tmp_path):
    path = record(tmp_path / "a.pcapng")
    with pytest.raises(UnknownSignal, match=r"motor.positon_rad.*motor.position_rad.*or a unit: A, Nm, degC, rad"):
        compare(path, path, tolerances={"motor.positon_rad": 1.0})


@pytest.mark.thorough
def test_the_differences_as_a_picture(tmp_path):
    comparison = compare(record(tmp_path / "a.pcapng"), record(tmp_path / "b.pcapng", push=50), tolerances={"Nm": 0.01})
    made = draw_differences(comparison)
    legend = made.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["A: a.pcapng", "B: b.pcapng"]
    assert made.axes[1].get_title(loc="left") == "A - B"
    row = [axes.get_ylabel() for axes in made.axes].index("brake.setpoint_Nm\n[Nm]")
    assert made.axes[row + 1].lines[0].get_ydata().min() == pytest.approx(-0.05)
    save_picture(made, tmp_path / "diff.png")
    assert (tmp_path / "diff.png").stat().st_size > 10_000


def test_an_envelope_keeps_the_spike_of_one_sample():
    t_s = np.linspace(0.0, 10.0, 50_000)
    values = np.sin(t_s)
    values[31_234] = 7.0
    gathered = Envelope(0.0, 10.0)
    for part in np.array_split(np.arange(len(t_s)), 7):
        gathered.add(t_s[part], values[part])
    trace = gathered.trace("x", "rad")
    assert trace.is_envelope
    assert (len(trace.t_s), trace.samples) == (BINS, 50_000)
    assert trace.high.max() == 7.0
    assert trace.t_s[np.argmax(trace.high)] == pytest.approx(t_s[31_234], abs=10 / BINS)
    assert trace.low.min() == pytest.approx(-1.0, abs=1e-6)


def test_few_samples_are_drawn_as_they_are(recording):
    data = traces_of(recording, ["motor.position_rad"], (0.1, 0.2))
    (trace,) = data.traces
    inside = (recording["motor.position_rad"].t_s >= 0.1) & (recording["motor.position_rad"].t_s <= 0.2)
    assert not trace.is_envelope
    assert trace.samples < MOST_SAMPLES
    assert np.array_equal(trace.low, recording["motor.position_rad"].values[inside])
    assert data.markers == ()


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_plot_has_a_panel_for_each_unit_and_the_same_bytes_again(recording, tmp_path, suffix):
    made = recording.plot()
    assert [axes.get_ylabel() for axes in made.axes] == [
        "torque [Nm]",
        "angle [rad]",
        "current [A]",
        "temperature [degC]",
    ]
    assert made.axes[0].texts[0].get_text() == "hold"
    save_picture(made, tmp_path / f"a{suffix}")
    save_picture(plot(blocks(recording.path)), tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_axes_of_a_rig_have_shades_of_a_quantitys_colour():
    names = [f"{axis}.motor.{name}" for axis in ("left", "right", "middle") for name in ("position_rad", "torque_Nm")]
    t_s = np.linspace(0.0, 1.0, 3)
    colours = [colour for colour, _ in _manners([Trace(name, "", t_s, t_s, t_s, 3) for name in names])]
    assert colours[:2] == [QUANTITIES["position_rad"], QUANTITIES["torque_Nm"]]
    assert len(set(colours)) == len(names)


def test_what_cannot_be_plotted_is_told(recording, tmp_path):
    with pytest.raises(WrongCall, match=r"expected a list, as in signals=\['motor.position_rad'\]"):
        recording.plot("motor.position_rad")
    with pytest.raises(UnknownSignal, match=r"there is motor.position_rad"):
        recording.plot(["motor.positon_rad"])
    with pytest.raises(SpanError, match=r"it goes from 0.003 s to 0.402 s"):
        recording.plot(span=(5.0, None))
    with pytest.raises(SpanError, match="nothing can be drawn"):
        read(record(tmp_path / "empty.pcapng", 0)).plot()


@pytest.mark.parametrize(("text", "span"), [("3:5", (3.0, 5.0)), ("2.5:", (2.5, None)), (":10", (None, 10.0))])
def test_a_span(text, span):
    assert parse_span(text) == span


@pytest.mark.parametrize("text", ["3", "5:3", "a:b", "nan:3", "3:3"])
def test_a_span_that_is_none(text):
    with pytest.raises(ValueError, match="expected A:B in s"):
        parse_span(text)


def test_a_table_of_pandas(recording):
    pytest.importorskip("pandas")
    table = recording.to_pandas()
    assert list(table.columns) == list(recording.signals)
    assert table.index.name == "t_s"
    assert table.index.is_monotonic_increasing
    for name, series in recording.signals.items():
        column = table[name].dropna()
        assert np.array_equal(column.index, series.t_s)
        assert np.array_equal(column, series.values)
        assert table.attrs["units"][name] == series.unit


def test_a_table_on_a_grid_holds_the_values(recording):
    pytest.importorskip("pandas")
    table = recording.to_pandas(["brake.setpoint_Nm"], grid_s=0.001)
    assert np.allclose(np.diff(table.index), 0.001)
    assert np.isnan(table["brake.setpoint_Nm"].iloc[0])  # at 3 ms nothing had come yet
    assert table["brake.setpoint_Nm"].iloc[100] == recording["brake.setpoint_Nm"].values[99]
    with pytest.raises(ValueError, match=r"grid_s=0\.001"):
        recording.to_pandas(grid_s=0.0)


def test_a_dataset_of_xarray(recording):
    pytest.importorskip("xarray")
    data = recording.to_xarray(["motor.position_rad", "brake.setpoint_Nm"])
    angle = data["motor.position_rad"]
    assert angle.dims == ("t_s.motor.TPDO1",)
    assert angle.attrs["units"] == "rad"
    assert np.array_equal(angle.values, recording["motor.position_rad"].values)
    assert np.array_equal(data["t_s.motor.TPDO1"], recording["motor.position_rad"].t_s)
    assert recording.to_xarray(grid_s=0.01)["motor.position_rad"].dims == ("t_s",)


def test_a_library_that_is_absent_is_named_with_its_extra(recording, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(MissingExtra, match=r"to_pandas\(\) needs pandas.*'\.\[export\]'"):
        recording.to_pandas()


def test_a_recording_shows_itself_in_a_line_and_in_a_table(recording):
    assert repr(recording).endswith("run.pcapng of rig bench: 0.399 s, 2004 frames, 9 signals, 3 markers>")
    html = recording._repr_html_()
    assert "<td>motor.position_rad</td><td>rad</td><td>400</td>" in html
    assert html.count("<tr>") == 10
