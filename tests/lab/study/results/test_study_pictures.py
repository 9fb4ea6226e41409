"""The psychometric figure: chance level, band, points by their number of answers, and the point of
subjective equality.
"""

import numpy as np
import pytest
from scipy.special import ndtr

from coulombus.lab.study.results.fit import QUARTER, Fit, fit_answers
from coulombus.lab.study.results.pictures import CHANCE, LARGEST_POINT, draw_conditions, draw_psychometric
from coulombus.lab.study.results.report import _condition
from coulombus.recording.pictures.style import figure

REFERENCE, JND = 2.0, 0.15
LEVELS = (1.7, 1.85, 1.95, 2.05, 2.15, 2.3)
COUNTS = (10, 20, 40, 40, 20, 10)


def answers(shift, seed):
    """Return levels and answers of a simulated subject."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(LEVELS, COUNTS)
    larger = rng.random(len(levels)) < ndtr((levels - REFERENCE - shift) / (JND / QUARTER))
    return levels, larger, rng.integers(1, 3, len(levels))


@pytest.fixture(scope="module")
def shown():
    levels, larger, first = answers(0.05, 4)
    rows = [
        {"level": str(x), "reference": str(REFERENCE), "first": str(f), "answer": str(f if took else 3 - f)}
        for x, took, f in zip(levels, larger, first, strict=True)
    ]
    return {"hybrid": _condition(rows, "constant")[0]}


@pytest.fixture(scope="module")
def drawn(shown):
    with figure(6, 4) as (_, axes):
        draw_psychometric(axes, shown, "level: F_s [Nm]", "Nm")
    return axes


def test_the_area_of_a_point_is_its_number_of_answers(drawn):
    points = drawn.collections[0]
    assert np.asarray(points.get_offsets())[:, 0].tolist() == pytest.approx(list(LEVELS))
    assert points.get_sizes().tolist() == pytest.approx([LARGEST_POINT * n / max(COUNTS) for n in COUNTS])


def test_the_chance_level_and_the_point_of_subjective_equality_are_marked(drawn, shown):
    fit = Fit(**shown["hybrid"]["fit"])
    lines = [(np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)) for line in drawn.lines]
    assert any(len(y) == 2 and (y == CHANCE).all() for _, y in lines)
    at_pse = [y for x, y in lines if len(x) == 2 and (x == fit.pse).all()]
    assert at_pse[0][1] == pytest.approx(0.5, abs=0.03)
    assert any(len(x) == 2 and tuple(x) == tuple(fit.pse_95) for x, _ in lines)
    assert "PSE 2.0" in drawn.get_legend_handles_labels()[1][0]


def test_the_band_holds_the_function_and_is_drawn(drawn, shown):
    band = shown["hybrid"]["band_95"]
    low, high = np.array(band["low"]), np.array(band["high"])
    fitted = Fit(**shown["hybrid"]["fit"]).chance(np.array(band["level"]))
    assert (low < fitted).all()
    assert (fitted < high).all()
    assert 0.02 < (high - low).max() < 0.4
    outline = drawn.collections[1].get_paths()[0].vertices
    assert outline[:, 1].max() == pytest.approx(high.max())
    assert outline[:, 1].min() == pytest.approx(low.min())


@pytest.mark.thorough
def test_bands_of_95_percent_hold_the_true_function_of_most_subjects():
    grid = np.linspace(LEVELS[0], LEVELS[-1], 9)
    truth = ndtr((grid - REFERENCE - 0.05) / (JND / QUARTER))
    held = []
    for seed in range(30):
        levels, larger, _ = answers(0.05, seed)
        low, high = fit_answers(levels, larger, REFERENCE)[1].chance_at(grid - REFERENCE, (0.025, 0.975)).T
        held.append((low < truth) & (truth < high))
    assert 0.88 < np.mean(held) < 1.0


@pytest.mark.parametrize(("jnds", "scale"), [((0.1, 1.5), "log"), ((0.1, 0.5), "linear")])
def test_conditions_have_a_logarithmic_axis_beyond_a_decade(jnds, scale):
    subjects = {f"S{k}": {"a": {"fit": {"jnd": jnd}}} for k, jnd in enumerate(jnds)}
    whole = {"jnd": 0.3, "jnd_95": (0.2, 0.5), "subjects": 2, "left_out": {}}
    results = {"subjects": subjects, "conditions": {"a": whole}, "level": {"quantity": "F_s", "unit": "Nm"}}
    with figure(6, 4) as (_, axes):
        draw_conditions(axes, results, "Nm")
    assert axes.get_yscale() == scale
