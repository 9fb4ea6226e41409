"""Conditions of rates: a small grammar, never evaluated by Python, with figures that may be unknown."""

from __future__ import annotations

import pytest

from coulombus.lab.simulate import simulate
from coulombus.lab.sweep.expressions import ConditionError, RunCondition
from coulombus.lab.sweep.figures import FIGURES, figures_of, known_figures
from coulombus.rigs.rig import load_rig

KNOWN = {"a": float, "b": int, "name": str, "counters.lost": int}


@pytest.mark.parametrize(
    ("text", "figures", "holds"),
    [
        ("a <= 2", {"a": 2.0}, True),
        ("a < 2", {"a": 2.0}, False),
        ("a >= 2 and b != 3", {"a": 2.0, "b": 4}, True),
        ("a > 2 or b == 4", {"a": 2.0, "b": 4}, True),
        ("not a > 2", {"a": 2.0}, True),
        ("0 < a <= 2", {"a": 2.0}, True),
        ("0 < a <= 2", {"a": 0.0}, False),
        ("(a + b) / 2 - 1 >= -a * 0.5", {"a": 2.0, "b": -2}, True),
        ("name == 'agreed'", {"name": "agreed"}, True),
        ("name != 'agreed'", {"name": "agreed"}, False),
        ("name == none", {"name": None}, True),
        ("name == none", {"name": "x"}, False),
        ("name != null", {"name": "x"}, True),
        ("counters.lost == 0", {"counters.lost": 0}, True),
        ("a == a", {"a": 1.0}, True),
        ("true == (a > 0)", {"a": 1.0}, True),
    ],
)
def test_a_condition_is_what_it_says(text, figures, holds):
    assert RunCondition.from_text(text, KNOWN).holds(figures) is holds


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("a <= 2", False),
        ("not a <= 2", False),
        ("not (a <= 2 and b == 1)", False),
        ("a <= 2 or b == 1", True),
        ("a <= 2 and b == 2", False),
        ("not (a <= 2 and b == 2)", True),
        ("a + 1 > 0", False),
        ("b / 0 > 0", False),
        ("-a < 0", False),
        ("a == none", True),
        ("0 < a < 3", False),
        ("3 < b < a", False),
        ("not 3 < b < a", True),
    ],
)
def test_of_an_unknown_figure_nothing_is_claimed(text, holds):
    assert RunCondition.from_text(text, KNOWN).holds({"a": None, "b": 1}) is holds


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "cannot be read"),
        ("a <=", "cannot be read"),
        ("a", "not a comparison"),
        ("a + 1", "not a comparison"),
        ("c <= 2", "no figure 'c'; expected one of a, b"),
        ("nam == 'x'", "did you mean 'name'"),
        ("counters.lots == 0", "did you mean 'counters.lost'"),
        ("name <= 2", "'name' is not a number"),
        ("name == 2", "compares a text with a number"),
        ("a and b > 1", "'a' is not a comparison"),
        ("not a", "'a' is not a comparison"),
        ("a in (1, 2)", "not allowed"),
        ("a ** 2 > 1", "not allowed"),
        ("a % 2 == 1", "not allowed"),
        ("abs(a) > 1", "not allowed"),
        ("a[0] > 1", "not allowed"),
        ("(lambda: 1)() > 0", "not allowed"),
        ("__import__('os').getcwd() == 'x'", "not allowed"),
        ("().__class__ == none", "not allowed"),
        ("a if b > 1 else b > 2", "not allowed"),
        ("a is none", "not allowed"),
        ("(a := 1) > 0", "not allowed"),
        ("f'{a}' == 'x'", "not allowed"),
        ("a > 1j", "not allowed"),
        ("a > 1e999", "not allowed"),
        ("a > " + "9" * 400, "not allowed"),
        ("a > b'x'", "not allowed"),
        ("not " * 60 + "a > 1", "within each other"),
        ("(" * 240 + "a" + ")" * 240, "cannot be read"),
        ("a > 1 or " * 100 + "a > 1", "at most 500"),
        ("a > 1\nb > 1", "cannot be read"),
        ("a > 1\0", "cannot be read"),
    ],
)
def test_nothing_else_is_allowed(text, told):
    with pytest.raises(ConditionError) as caught:
        RunCondition.from_text(text, KNOWN)
    assert told in str(caught.value)


def test_a_condition_knows_its_figures():
    assert RunCondition.from_text("a > 1 and counters.lost == 0 and a < none_", {**KNOWN, "none_": float}).figures == (
        "a",
        "counters.lost",
        "none_",
    )


def test_the_figures_are_those_that_simulate_prints():
    rig = load_rig("bench")
    told = simulate(rig, "hybrid", 0.01, measured=True).as_dict()
    for name in FIGURES:
        owner = told
        *above, last = name.split(".")
        for part in above:
            owner = owner[part]
        assert last in owner, name
    assert "hold_counts_p2p" in FIGURES
    assert set(told["counters"]) == {name.removeprefix("counters.") for name in FIGURES if name.startswith("counters.")}


def test_each_axis_has_its_figures():
    rig = load_rig("two_axes")
    result = simulate(rig, "hybrid", 3.0, measured=True)
    known = known_figures(rig)
    assert known["axes.left.hold_counts_p2p"] is int
    found = figures_of(result, rig)
    assert found.keys() == known.keys()
    assert [found[f"axes.{axis}.hold_counts_p2p"] for axis in rig.axis_names] == [
        result.axes[axis]["hold_counts_p2p"] for axis in rig.axis_names
    ]
    assert None not in (found["axes.left.hold_counts_p2p"], found["axes.right.cycles"])
