"""Title and size of a picture, the curves that others cover, and the signals that are not drawn."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from bench_recording import record
from coulombus.cli.main import main
from coulombus.recording.pictures.plot import WIDE, Look, Plot, Trace, figure_of, hidden, traces_of
from coulombus.recording.reading import blocks

T_S = np.linspace(0.0, 1.0, 50)


def trace(name, values, unit="Nm", t_s=T_S):
    values = np.asarray(values, float)
    return Trace(name, unit, t_s, values, values, len(values))


def plot_of(*traces):
    return Plot("a", 0.0, 1.0, traces, ())


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return record(tmp_path_factory.mktemp("run") / "run.pcapng")


def test_a_curve_under_a_later_one_of_its_panel_is_named_and_drawn_wide():
    wave = np.sin(7 * T_S)
    later = trace("later", wave + 1e-3, t_s=T_S + 1e-4)
    data = plot_of(trace("first", wave), trace("apart", wave + 0.2), later, trace("angle", wave, "rad"))
    assert hidden(data) == (("first", "later"),)
    widths = {line.get_label(): line.get_linewidth() for axes in figure_of(data).axes for line in axes.lines}
    assert widths["first"] == WIDE > widths["later"]
    assert widths["apart"] == widths["angle"] == widths["later"]


def test_a_curve_that_leaves_the_other_one_for_a_tenth_of_the_time_is_visible():
    wave = np.sin(7 * T_S)
    assert hidden(plot_of(trace("a", wave + 0.5 * (T_S > 0.9)), trace("b", wave))) == ()


def test_without_named_signals_the_picture_has_the_names_of_the_others(path):
    data = traces_of(blocks(path))
    assert "motor.statusword" in data.left_out
    assert not set(data.left_out) & {trace.name for trace in data.traces}
    assert traces_of(blocks(path), ["motor.position_rad"]).left_out == ()


def test_title_size_and_resolution_are_those_that_are_given(path, tmp_path):
    out = tmp_path / "a.png"
    words = ["plot", str(path), "--title", "Subject 3", "--size", "12.7x7.62", "--dpi", "200", "-o", str(out)]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    with Image.open(out) as picture:
        assert picture.size == (1000, 600)
    (line,) = [line for line in result.output.splitlines() if line.startswith("not drawn: ")]
    assert "motor.statusword" in line
    made = figure_of(traces_of(blocks(path)), Look(title="Subject 3"))
    assert made.axes[0].get_title(loc="left") == "Subject 3"
    plain = figure_of(replace(traces_of(blocks(path)), title="b"))
    assert plain.axes[0].get_title(loc="left") == "b"


@pytest.mark.parametrize("size", ["16", "16x", "0x9", "nanx9", "16x9x2", "1x1", "1000x5"])
def test_a_size_that_is_none_is_refused(path, tmp_path, size):
    result = CliRunner().invoke(main, ["plot", str(path), "--size", size, "-o", str(tmp_path / "a.png")])
    assert result.exit_code == 2
    assert "expected WIDTHxHEIGHT in cm, as 16x9" in result.output
